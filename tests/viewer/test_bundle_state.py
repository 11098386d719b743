"""The bundle as the viewer holds it: choices, rows that come, stepping, stopping, going on, residuals at any row; no browser."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from solvers import Interior
from solvers.adjustment import Iteration
from solvers.cameras import PARAMETERS
from solvers.errors import BadProject
from solvers.io import latest_run, write_project
from solvers.workflows_bundle import StoppedRun, adjust_project
from tests.orientation.test_bundle_lagged import flown
from viewer_app.acting import update
from viewer_app.actions import GoTo, Show, SwitchPoint
from viewer_app.bundle_actions import (
    BundleCame,
    BundleFailed,
    FollowBundle,
    FreeParameter,
    HoldBundle,
    KeepBundle,
    OfEveryImage,
    RunBundle,
    SetBundle,
    StopBundle,
)
from viewer_app.bundle_figures import Vectors, camera_figures, field, image_vectors, inside, profile
from viewer_app.bundle_rows import exterior, image_number, misfit, place, point_rms, ray_counts
from viewer_app.bundle_scene import MOST, ellipsoid_factor, judged, offsets, point_colours, scale_end, vector_factor
from viewer_app.bundle_scene import scene as bundle_scene
from viewer_app.bundle_state import FACTORS, Bundle, bundle_choices, bundle_of_choices
from viewer_app.bundle_tasks import adjusted_bundle, tasks
from viewer_app.ground import site
from viewer_app.loading import open_project
from viewer_app.panels.bundle import together
from viewer_app.panels.bundle_plots import vectors_svg
from viewer_app.panels.bundle_tables import marks, two_runs
from viewer_app.rerun_bundle import record_bundle
from viewer_app.rerun_shown import bundle_shown
from viewer_app.state import State
from viewer_app.tabs import whole_scene
from viewer_app.values import Ellipsoids, Frusta, Label, PointCloud, Segments


def run(state: State, rows: int | None = None, on: bool = False) -> State:
    """The state after a bundle, or after so many of its rows."""
    state = update(state, RunBundle(on=on))
    (task,) = tasks(state)
    for value in task.call(*task.arguments):
        state = update(state, task.arrive(value))
        if rows is not None and len(state.room(Bundle).rows) >= rows:
            break
    return state


@pytest.fixture(scope="module")
def done() -> Iterator[State]:
    from .conftest import make_state

    yield run(make_state())


def room(state: State) -> Bundle:
    return state.room(Bundle)


def test_choices_are_checked(state: State) -> None:
    for name, value in (("model", "fisheye"), ("datum", 3), ("vectors", -1.0), ("alone", "yes"), ("rows", ()), ("nothing", 1),
                        ("images", 3), ("images", "x" * 5000), ("shutter", "fast"), ("per_image", ("c",))):
        assert update(state, SetBundle(name, value)) is state
    now = update(update(state, SetBundle("model", "orthogonal")), SetBundle("datum", "free"))
    assert (room(now).model, room(now).datum) == ("orthogonal", "free")
    assert room(update(now, FreeParameter("all"))).free == PARAMETERS
    two = update(update(update(now, FreeParameter("k1")), FreeParameter("c")), FreeParameter("k9"))
    assert room(two).free == ("c", "k1") and room(update(two, FreeParameter("c", False))).free == ("k1",)


def test_rows_arrive_and_the_transport_follows(done: State) -> None:
    b = room(done)
    assert b.task == "" and b.result is not None and b.result.converged and b.rows[-1].stop
    assert done.last_row == b.steps == len(b.rows) - 1 and done.row == done.last_row
    assert b.result.sigma0 is not None and 0.7 < b.result.sigma0 < 1.4
    back = update(done, GoTo(0))
    assert back.row == 0 and judged(back) is None and judged(done) is b.result
    first, last = exterior(back, "left"), exterior(done, "left")
    truth = done.assets.truth["left"]
    assert first is not None and last is not None
    assert np.linalg.norm(last.centre - truth.centre) < 0.5


def test_residuals_of_the_last_row_are_those_of_the_adjustment(done: State) -> None:
    b, of = room(done), misfit(done)
    assert b.result is not None and b.layout is not None and of is not None
    a, c = np.lexsort((of.point, of.image)), np.lexsort((b.result.point, b.result.image))
    assert np.allclose(of.v[a], b.result.v[c], atol=1e-9)
    assert point_rms(b.layout, of) == pytest.approx(
        [np.sqrt((of.v[of.point == k] ** 2).sum(axis=1).mean()) for k in range(len(b.layout.points))])
    assert b.block is not None and (ray_counts(b.layout, b.block) == np.bincount(of.point)).all()
    mine = image_vectors(done, "right")
    assert mine is not None and np.allclose(mine.v, of.v[of.image == 1])
    assert image_vectors(done, "nobody") is None


def test_arrows_of_the_residual_plot_end_in_its_frame_and_that_is_said() -> None:
    camera = Interior(35.0, pixel_mm=0.0039, width=6000, height=4000)
    pixel = np.array([[3000.0, 2000.0], [5990.0, 10.0], [100.0, 3900.0], [2000.0, 1000.0]])
    v = np.array([[0.3, -0.2], [1.0, -1.0], [-2.0, 0.5], [0.0, 0.0]])
    svg = vectors_svg(Vectors(camera, pixel, v, ("A", "B", "C", "D")))
    x, y, w, h = (float(re.search(rf'<rect .*?{k}="(-?[\d.]+)"', svg)[1]) for k in ("x", "y", "width", "height"))  # type: ignore[index]
    lines = np.array(re.findall(r'<line x1="([\d.-]+)" y1="([\d.-]+)" x2="([\d.-]+)" y2="([\d.-]+)"', svg), float)
    assert len(lines) == 4 and "2 end at the frame" in svg
    assert (lines[:, 2::2] >= x - 0.1).all() and (lines[:, 2] <= x + w + 0.1).all()
    assert (lines[:, 3] >= y - 0.1).all() and (lines[:, 3] <= y + h + 0.1).all()
    whole = lines[np.isclose(lines[:, 0], x + 3000.5 * w / 6000, atol=0.1)][0]
    assert (whole[3] - whole[1]) / (whole[2] - whole[0]) == pytest.approx(-2 / 3, abs=0.05)
    assert inside(np.array([[1.0, 1.0]]), np.array([[np.nan, 5.0]]), (2, 2))[0] == pytest.approx(0.2)


def test_points_stand_where_the_bundle_has_them(done: State) -> None:
    found = offsets(done)
    assert found is not None
    control, check, _, off = found
    assert (len(control), len(check)) == (13, 2)  # one check point is in one image alone
    assert np.abs(off[control]).max() < 0.2 and 0 < np.abs(off[check]).max() < 2
    at = place(done, "G06")
    assert at is not None and np.linalg.norm(at - done.assets.frame.to_local(done.block.points.xyz[5])) < 2
    assert room(done).result is not None
    assert np.allclose(off, room(done).result.off, atol=1e-9, equal_nan=True)  # type: ignore[union-attr]


def test_the_scene_is_few_nodes_and_says_its_scales(done: State) -> None:
    found = whole_scene(done)
    mine = {path: value for path, value in found.items() if path.startswith("/bundle")}
    assert not [path for path in found if path.startswith("/images")] and len(mine) < 20
    assert isinstance(mine["/bundle/images"], Segments) and isinstance(mine["/bundle/points"], PointCloud)
    check = mine["/bundle/ellipsoids/check"]
    assert isinstance(check, Ellipsoids) and len(check.centres) == 2
    words = [v.text for p, v in mine.items() if isinstance(v, Label) and "scale" in p]
    assert all(any(w.endswith(f"× {factor:g}") for w in words) for factor in (vector_factor(done), ellipsoid_factor(done)))
    b = room(done)
    assert b.result is not None and b.layout is not None
    k = b.layout.points.index("G06")
    values = np.sort(np.sqrt(np.linalg.eigvalsh(b.result.covariance[k])))
    assert np.sort(check.radii[0]) == pytest.approx(2.7955 * ellipsoid_factor(done) * values, rel=1e-3)
    vectors = mine["/bundle/vectors/check"]
    found_offsets = offsets(done)
    assert isinstance(vectors, Segments) and found_offsets is not None
    assert np.allclose(vectors.points[:, 1] - vectors.points[:, 0], vector_factor(done) * found_offsets[3][found_offsets[1]])
    both = whole_scene(update(done, SetBundle("alone", False)))
    assert "/bundle/images" in both and [path for path in both if path.startswith("/points")]
    assert not [p for p in bundle_scene(update(done, GoTo(0))) if "ellipsoid" in p]  # they hold for the end alone


@pytest.mark.parametrize("layer, name", [("rays", "rays"), ("residuals", "vectors"), ("ellipsoids", "ellipsoids")])
def test_the_scene_tab_hides_of_the_bundle_as_well(done: State, layer: str, name: str) -> None:
    all_of, less = bundle_scene(done), bundle_scene(update(done, Show(layer, False)))
    gone = set(all_of) - set(less)
    assert gone >= {path for path in all_of if f"/{name}" in path} != set()
    assert all(f"/{name}" in path or "scale" in path for path in gone)
    hidden = bundle_shown(update(done, Show(layer, False))).hidden - bundle_shown(done).hidden
    assert hidden == ({f"draw_{name}"} if name != "rays" else set())


def test_many_images_are_one_batch(done: State) -> None:
    import viewer_app.bundle_scene as module

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "MANY", 1)
        assert isinstance(bundle_scene(done)["/bundle/images"], Frusta)


def test_colours_tell_residual_and_rays(done: State) -> None:
    b, of = room(done), misfit(done)
    assert b.layout is not None and b.block is not None and of is not None
    rms = point_rms(b.layout, of)
    colours = point_colours(b.layout, b.block, of, "residual", scale_end(done)).astype(int)
    worst, best = int(np.argmax(rms)), int(np.argmin(rms))
    assert tuple(colours[worst]) == (213, 94, 0) and colours[best, 2] > colours[worst, 2]
    by_rays = point_colours(b.layout, b.block, of, "number of rays", 1.0)
    assert {tuple(c) for c in by_rays[ray_counts(b.layout, b.block) == 2].tolist()} == {(230, 159, 0)}


def test_stop_keeps_the_last_row_and_one_can_go_on(state: State) -> None:
    half = update(run(state, rows=2), StopBundle())
    assert not tasks(half) and len(room(half).rows) == 2 and room(half).result is None and "kept" in room(half).progress
    late = update(half, BundleCame(room(half).serial, room(half).rows[0]))
    assert late is half  # what comes after a stop is not taken
    end = run(half, on=True)
    whole = run(state)
    assert [r.index for r in room(end).rows] == list(range(len(room(end).rows)))
    assert room(end).rows[1] is room(half).rows[1]
    assert room(end).rows[-1].cost == pytest.approx(room(whole).rows[-1].cost, rel=1e-9)
    assert np.allclose(room(end).rows[-1].x, room(whole).rows[-1].x, atol=1e-4)


def test_points_switched_off_only_check(state: State) -> None:
    off = run(update(state, SwitchPoint("G07")))
    found, b = offsets(off), room(off)
    assert b.result is not None and b.layout is not None and found is not None
    assert b.result.roles[b.layout.points.index("G07")] == "check"


def test_a_click_chooses_the_image_whose_picture_it_meets(done: State) -> None:
    from viewer_app.bundle_scene import click

    of = exterior(done, "right")
    assert of is not None
    above = of.centre + np.array([0, 0, 100.0])
    chosen = update(done, click(done, above, of.centre - of.m[2] * 20 - above, 0.01))  # type: ignore[arg-type]
    assert chosen.image == "right" and chosen.room(Bundle) is done.room(Bundle)
    assert click(done, above, np.array([0, 0, 1.0]), 0.01) is None
    assert click(update(done, SetBundle("alone", False)), above, of.centre - above, 0.01) is None


def test_choices_outlive_the_session(state: State) -> None:
    from viewer_app.session_rooms import KEPT_ROOMS

    kind, to_json, from_json = KEPT_ROOMS["Bundle"]
    now = room(update(update(state, SetBundle("datum", "free")), FreeParameter("k1")))
    again = from_json(to_json(now))
    assert kind is Bundle and again.datum == "free" and again.free == ("k1",) and again.rows == ()
    with pytest.raises(ValueError, match="datum"):
        from_json({**to_json(now), "datum": "moon"})


def test_a_failure_is_a_sentence(state: State) -> None:
    from solvers import PhotogrammetryError

    asked = update(update(state, SetBundle("datum", "prior")), RunBundle())
    (task,) = tasks(asked)
    with pytest.raises(PhotogrammetryError, match="no image has a prior") as error:
        list(task.call(*task.arguments))
    said = update(asked, task.failed(str(error.value)))
    assert room(said).task == "" and "another datum" in room(said).error
    assert update(said, BundleFailed(room(said).serial - 1, "late")) is said
    assert "run it first" in room(update(state, KeepBundle())).error
    assert "folder" in room(update(replace(run(state, rows=1)), KeepBundle())).error or room(state).rows == ()


def test_a_stopped_bundle_is_kept_as_a_run(state: State, tmp_path: Path) -> None:
    half = update(run(replace(state, assets=replace(state.assets, folder=tmp_path)), rows=2), StopBundle())
    wanted = update(half, KeepBundle(open=True))
    (task,) = tasks(wanted)
    (kept,) = task.call(*task.arguments)
    end = update(wanted, task.arrive(kept))
    where = latest_run(tmp_path, "trace.json", "adjust")
    assert where is not None and room(end).run == str(where) and room(end).opened == 1
    assert (where / "recording.rrd").stat().st_size > 1000
    said = json.loads((where / "result.json").read_text())["warnings"]
    assert said[0].startswith("stopped at row 1 before it converged: standard errors hold only for the minimum")
    assert not drawn(where / "recording.rrd", "/bundle/ellipsoids/")  # they hold only there


def drawn(recording: Path, under: str) -> list[str]:
    """Entities of a recording under a path."""
    return sorted({str(c.entity_path) for c in RrdReader(recording).stream() if str(c.entity_path).startswith(under)})


def uncertain(state: State, factor: float) -> State:
    """A bundle whose standard errors are so many times as large."""
    result = room(state).result
    assert result is not None
    worse = replace(result, covariance=result.covariance * factor**2, image_covariance=result.image_covariance * factor**2)
    return state.with_room(replace(room(state), result=worse))


def test_ellipsoids_larger_than_the_site_are_drawn_smaller_and_that_is_told(done: State) -> None:
    usual = ellipsoid_factor(done)
    state = uncertain(done, 20 * usual)
    factor = ellipsoid_factor(state)
    assert 0 < factor <= 0.1 and factor in FACTORS and {0.01, 0.1, 0.5} <= set(FACTORS)
    found = bundle_scene(state)
    assert any(isinstance(v, Label) and v.text.endswith(f"95 % ellipsoids × {factor:g}") for v in found.values())
    assert f"drawn × {factor:g}" in marks(state)
    low, high = site(state)
    ellipsoids = [v for p, v in found.items() if p.startswith("/bundle/ellipsoids/") and isinstance(v, Ellipsoids)]
    assert ellipsoids and all(np.percentile(v.radii.max(axis=1), 50) < (high - low).max() / 5 for v in ellipsoids)
    assert room(update(done, SetBundle("ellipsoid", 0.01))).ellipsoid == 0.01


def test_of_many_points_the_largest_ellipsoids_are_drawn_and_that_is_said(done: State, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "largest" not in marks(done) and MOST <= 300
    of = room(done).result
    assert of is not None
    kind, count = max(((k, of.roles.count(k)) for k in ("tie", "control", "check")), key=lambda k: k[1])
    monkeypatch.setattr("viewer_app.bundle_scene.MOST", count - 1)
    monkeypatch.setattr("viewer_app.panels.bundle_tables.MOST", count - 1)
    drawn = bundle_scene(done)[f"/bundle/ellipsoids/{kind}"]
    assert isinstance(drawn, Ellipsoids) and len(drawn.centres) == count - 1
    assert f"of {count} {kind} points only the {count - 1} largest ellipsoids are drawn" in marks(done)


def test_a_recording_shrinks_ellipsoids_that_are_larger_than_the_site(done: State, tmp_path: Path) -> None:
    block, adjusted = adjusted_bundle(done)
    worse = tuple(replace(p, covariance=1e10 * p.covariance) for p in adjusted.points)
    record_bundle(tmp_path / "r.rrd", block, replace(adjusted, points=worse))
    assert drawn(tmp_path / "r.rrd", "/bundle/ellipsoids/")
    said = [str(t) for c in RrdReader(tmp_path / "r.rrd").stream() if str(c.entity_path) == "/log/bundle"
            for t in c.to_record_batch().to_pydict().get("TextLog:text", [])]
    (words,) = [t for t in said if "95 % ellipsoids are drawn" in t]
    assert float(words.split("drawn ")[1].split(" times")[0]) < 1


def test_residuals_of_photos_that_move_while_they_are_read_are_those_of_the_adjustment(tmp_path: Path) -> None:
    write_project(flown(4)[0], tmp_path / "p")
    state = update(open_project(tmp_path / "p"), SetBundle("shutter", "translation"))
    state = run(state)
    of, result = misfit(state), room(state).result
    assert of is not None and result is not None and not of.live
    assert np.sqrt((of.v**2).sum(axis=1).mean()) == pytest.approx(result.rms_px, rel=1e-6)
    assert misfit(run(state, rows=1)) is None


def test_the_radial_profile_finds_a_radial_error(done: State) -> None:
    b = room(done)
    assert b.layout is not None
    interior = b.layout.interiors[0]
    rng = np.random.default_rng(5)
    pixel = rng.uniform(0, [interior.width - 1, interior.height - 1], (4000, 2))
    away = (pixel - interior.pixels(interior.principal_point)) * interior.pitch
    radius = np.linalg.norm(away, axis=1, keepdims=True)
    v = 0.01 * radius * away / radius + rng.normal(0, 0.1, pixel.shape)  # px: 0.01 a millimetre outwards
    found = profile(interior, pixel, v)
    assert (np.abs(found.mean - 0.01 * found.radius) < 4 * found.error + 0.002).all() and found.count.sum() > 3990
    cells = field(interior, pixel, v)
    outwards = ((cells.middle - interior.pixels(interior.principal_point)) * cells.mean).sum(axis=1)
    assert len(cells.count) == 48 and cells.count.sum() == 4000 and (outwards > 0).mean() > 0.9
    figures = camera_figures(done, 0)
    assert figures is not None and figures[0].count.sum() <= len(done.block.observations)


def test_a_bundle_set_aside_is_seen_beside_the_next(done: State) -> None:
    assert room(update(make(done), HoldBundle())).error.startswith("There is no finished bundle")
    aside = update(done, HoldBundle())
    again = run(update(update(aside, OfEveryImage("xp")), FreeParameter("c")))
    b = room(again)
    assert b.free == ("c", "xp") and b.per_image == ("xp",) and b.held is not None and b.held.result is room(done).result
    assert b.result is not None and b.result.freed == (("uav", "c"), ("uav@left", "xp"), ("uav@right", "xp"))
    said = two_runs(again)
    assert "xp" in said and "free" in said and f"{b.result.dof}" in said and f"{room(done).result.dof}" in said  # type: ignore[union-attr]
    assert isinstance(whole_scene(again)["/bundle/held"], Segments)
    joint = together(b.result, again.image, image_number(b, again.image) or 0, [0, 1])
    assert joint.shape == (8, 8) and np.linalg.eigvalsh(joint).min() > -1e-12 and np.abs(joint[:6, 6:]).max() > 0
    assert room(update(again, HoldBundle(on=False))).held is None


def make(state: State) -> State:
    """The state without its bundle."""
    return state.with_room(Bundle())


def test_some_images_only(state: State) -> None:
    none = update(update(state, SetBundle("images", "nobody*")), RunBundle())
    assert "means 0 image(s)" in room(none).error and not tasks(none)
    names = [i.name for i in state.block.images]
    some = run(update(state, SetBundle("images", f"{names[0]}, {names[1][:-1]}*")))
    assert room(some).layout is not None and set(room(some).layout.images) <= set(names)  # type: ignore[union-attr]
    assert room(bundle(some)).images == room(some).images


def bundle(state: State) -> State:
    """Through what a session keeps."""
    return state.with_room(bundle_of_choices(bundle_choices(room(state))))


def test_a_run_is_followed_and_continued(state: State, tmp_path: Path) -> None:
    folder = tmp_path / "project"
    write_project(state.block, folder)
    here = replace(state, assets=replace(state.assets, folder=folder))
    nothing = update(here, FollowBundle())
    (task,) = tasks(nothing)
    with pytest.raises(BadProject, match="no run of an adjustment to follow"):
        list(task.call(*task.arguments))
    rows: list[Iteration] = []

    class Stops:
        def __call__(self, *_: object) -> Stops:
            return self

        def row(self, row: Iteration) -> None:
            rows.append(row)
            if row.index == 1:
                raise KeyboardInterrupt

        def close(self) -> None:
            pass

    stopped = adjust_project(folder, live=Stops())
    assert isinstance(stopped, StoppedRun)
    state = here
    state = update(state, FollowBundle())
    (task,) = tasks(state)
    for value in task.call(*task.arguments):
        state = update(state, task.arrive(value))
    b = room(state)
    assert b.task == "" and len(b.rows) == 2 and b.result is None and "was stopped at row 1" in b.progress
    np.testing.assert_allclose(b.rows[1].x, rows[1].x, atol=1e-6)
    ended = run(update(state, GoTo(0)), on=True)
    assert room(ended).result is not None and room(ended).result.converged and room(ended).rows[0] is b.rows[0]  # type: ignore[union-attr]
