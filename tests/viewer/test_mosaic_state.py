"""The Mosaic tab without a browser: its work run in place, what actions make of it, what the scene then shows."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solvers import BadProject, Unsupported
from solvers.geometry import Grid
from viewer_app.acting import update
from viewer_app.actions import Undo
from viewer_app.bundle_actions import RunBundle
from viewer_app.bundle_scene import scene as bundle_scene
from viewer_app.bundle_tasks import tasks as bundle_tasks
from viewer_app.loading import bring, open_project
from viewer_app.matching_actions import Accept
from viewer_app.matching_state import Matching
from viewer_app.matching_tasks import tasks as matching_tasks
from viewer_app.mosaic_actions import (
    CancelMosaic,
    Choose,
    ClickMosaic,
    ForgetPlaces,
    GoToRow,
    Look,
    MakeMosaic,
    OpenLayer,
    Progressing,
    WriteMosaic,
)
from viewer_app.mosaic_layer import assembled, csv_of, offsets
from viewer_app.mosaic_scene import _warped, clicked, drift, measured, outlines, scene
from viewer_app.mosaic_state import Layer, Mosaic
from viewer_app.mosaic_tasks import tasks
from viewer_app.mosaic_work import MOST, request_of
from viewer_app.panels.mosaic import on_click
from viewer_app.panels.mosaic_words import (
    drift_html,
    layer_html,
    measured_html,
    progress_html,
    residuals_html,
    summary_html,
    written_html,
)
from viewer_app.rerun_mosaic import pieces
from viewer_app.session import from_json, to_json
from viewer_app.state import State
from viewer_app.values import Label, Picture, Segments

DEMO = Path(__file__).parents[2] / "assets" / "demo"


def work(state: State, which: Any = tasks) -> State:
    """All that is wanted, done here instead of in another process."""
    for _ in range(40):
        todo = which(state)
        if not todo:
            return state
        task, why = todo[0], None
        try:
            for value in task.call(*task.arguments):
                state = update(state, task.arrive(value))
        except (BadProject, Unsupported) as error:
            why = str(error)
        if why is not None:
            state = update(state, task.failed(why))
    raise AssertionError("the work does not end")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mosaic") / "demo"
    shutil.copytree(DEMO, out, ignore=shutil.ignore_patterns("runs"))
    return out


@pytest.fixture(scope="module")
def both(folder: Path) -> State:
    state = open_project(folder)
    for action in bring(state):
        state = update(state, action)
    return work(update(state, MakeMosaic("both")))


def room(state: State) -> Mosaic:
    return state.room(Mosaic)


def test_tiles_lie_north_up_at_their_places(both: State) -> None:
    made = room(both).made["simultaneous"]
    assert made.done and len(made.tiles) == made.total and sum(t.rgba[..., 0].size for t in made.tiles.values()) < 1.2 * MOST
    found = scene(both)
    pictures = {p: v for p, v in found.items() if isinstance(v, Picture)}
    assert set(pictures) == {f"/mosaic/simultaneous/tiles/{n}" for n in made.tiles}
    for value in pictures.values():
        a, b, c, _ = value.corners
        assert b[0] > a[0] and abs(b[1] - a[1]) < 1e-6 and c[1] < b[1]  # first row north, columns to the east
    r, grid = made.registration, made.grid
    whole, names = assembled(made.tiles, grid), list(both.assets.photos) or r.names
    block = both.block
    from solvers.io.photos import thumbnail

    # what a photo shows at a place of the plane, the mosaic shows there too
    k = 0
    picture = thumbnail(folder_of(both) / str(block.images[block.image_index(r.names[k])].file), 1200)
    scale = picture.pixels.shape[1] / r.interiors[k].width
    rng, off = np.random.default_rng(1), []
    corners = r.footprint(k)
    for _ in range(300):
        u, v = rng.uniform(0.3, 0.7, 2)
        xy = (1 - u) * ((1 - v) * corners[0] + v * corners[3]) + u * ((1 - v) * corners[1] + v * corners[2])
        col, row = np.round(grid.to_pixels(r.frame.to_map(np.append(xy, r.heights(xy)))[:2])).astype(int)
        pc, pr = np.round((r.to_pixels(k, xy) + 0.5) * scale - 0.5).astype(int)
        off.append((whole[row, col, :3].mean(), picture.pixels[pr, pc].mean()))
    assert np.corrcoef(np.array(off).T)[0, 1] > 0.7 and names


def folder_of(state: State) -> Path:
    assert state.assets.folder is not None
    return state.assets.folder


def test_outlines_grow_with_the_steps_and_end_where_the_mosaic_lies(both: State) -> None:
    for method in ("sequential", "simultaneous"):
        r = room(both).made[method].registration
        names, at = outlines(r, len(r.trace.rows) - 1)
        final = np.array([r.footprint(r.names.index(n)) for n in names])
        np.testing.assert_allclose(at, final, atol=0.05)
    r = room(both).made["sequential"].registration
    counts = [len(outlines(r, k)[0]) for k in range(len(r.trace.rows))]
    assert counts == [1, 2, 3, 4, 5]
    first = update(update(both, Look("shown", "sequential")), GoToRow(0))
    found = scene(first)
    label, lines = found["/mosaic/sequential/box_label"], found["/mosaic/sequential/outlines"]
    assert isinstance(label, Label) and "1 photos" in label.text and isinstance(lines, Segments) and len(lines.points) == 4
    assert not any("tiles" in p for p in found)
    later = scene(update(first, GoToRow(1, relative=True)))["/mosaic/sequential/box"]
    box = found["/mosaic/sequential/box"]
    assert isinstance(later, Segments) and isinstance(box, Segments) and np.ptp(later.points, axis=(0, 1))[0] > np.ptp(
        box.points, axis=(0, 1))[0]
    early = scene(update(update(both, Look("shown", "simultaneous")), GoToRow(0)))["/mosaic/simultaneous/outlines"]
    assert isinstance(early, Segments) and np.ptp(early.points[..., 0]) < 2000  # laid on the mosaic


def test_drift_and_residuals_are_drawn_as_exaggerated_as_their_bars_say(both: State) -> None:
    found, d = scene(both), drift(room(both))
    assert d is not None and d.lengths.max() > 1.0
    vectors, bar, words = (found[f"/mosaic/{n}"] for n in ("drift/vectors", "scale/drift", "scale/drift_label"))
    assert isinstance(vectors, Segments) and isinstance(bar, Segments) and isinstance(words, Label)
    factor = float(words.text.rpartition("× ")[2])
    length = np.linalg.norm(np.diff(vectors.points, axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(length, factor * np.linalg.norm(d.off.reshape(-1, 2), axis=1), rtol=1e-6)
    metres = float(words.text.split()[0]) * (0.01 if " cm" in words.text else 1)
    assert np.linalg.norm(bar.points[0, 1] - bar.points[0, 0]) == pytest.approx(factor * metres)
    ten = update(both, Look("exaggeration", 10.0))
    control = scene(ten)["/mosaic/residuals/control"]
    points = room(both).made["simultaneous"].points
    assert isinstance(control, Segments) and len(control.points) == points.roles.count("control")
    np.testing.assert_allclose(np.diff(control.points, axis=1)[:, 0, :2],
                               10 * points.off[[r == "control" for r in points.roles]], atol=1e-9)
    assert "Drift" in drift_html(room(both)) and "control points rms" in residuals_html(room(both))
    assert "sequential" in summary_html(room(both))


def test_the_bars_of_mosaic_and_bundle_lie_below_each_other(both: State) -> None:
    run = work(update(both, RunBundle()), bundle_tasks)

    def bars(state: State) -> list[np.ndarray]:
        found = scene(state) | bundle_scene(state)
        return [v.points[0] for p, v in found.items() if "/scale/" in p and isinstance(v, Segments)]

    lines = bars(run)
    longest = max(float(np.ptp(line[:, 0])) for line in lines)
    y = np.sort([line[0, 1] for line in lines])
    assert len(lines) == 4 and np.diff(y).min() > 0.2 * longest and np.ptp([line[0, 2] for line in lines]) < 1e-9
    alone = bars(update(update(run, Look("drift", False)), Look("residuals", False)))
    assert len(alone) == 2 and np.diff([line[0, 1] for line in alone])[0] != 0


def test_swipe_cuts_both_and_fade_lays_one_over_the_other(both: State) -> None:
    swiped = update(update(both, Look("shown", "swipe")), Look("swipe", 0.37))
    found = {p: v for p, v in scene(swiped).items() if isinstance(v, Picture)}
    west = max(v.corners[1, 0] for p, v in found.items() if "/sequential/" in p)
    east = min(v.corners[0, 0] for p, v in found.items() if "/simultaneous/" in p)
    assert abs(west - east) < 2 * room(both).made["simultaneous"].gsd
    again = scene(update(swiped, Look("swipe", 0.38)))
    same = [p for p, v in found.items() if again.get(p) is v]
    assert len(same) > 0.6 * len(found)  # only the tiles that the line crosses are sent anew
    level = {round(float(v.corners[:, 2].mean()), 3) for v in found.values()}
    assert len(level) == 1  # or an oblique view shows a gap along the line


def test_fade_is_one_picture_of_both(both: State) -> None:
    """Pictures over each other would hide parts of each other in a browser, once they are transparent."""
    fade = update(update(both, Look("shown", "fade")), Look("swipe", 0.25))
    faded = scene(fade)["/mosaic/faded"]
    assert isinstance(faded, Picture) and not any("/tiles" in p for p in scene(fade))
    assert scene(fade)["/mosaic/faded"] is faded  # nothing is sent anew

    def seen(share: float, at: np.ndarray) -> np.ndarray:
        p = scene(update(fade, Look("swipe", share)))["/mosaic/faded"]
        assert isinstance(p, Picture)
        col, row = (at - p.corners[0, :2]) / (p.corners[2, :2] - p.corners[0, :2]) * p.rgba.shape[1::-1]
        return p.rgba[int(row), int(col)].astype(float)

    middle = scene(update(both, Look("shown", "simultaneous")))
    tiles = [v for p, v in middle.items() if "/tiles/" in p and isinstance(v, Picture)]
    tile = max(tiles, key=lambda p: (p.rgba[..., 3] == 255).mean())
    at = tile.corners[:, :2].mean(axis=0)
    under, half, over = (seen(share, at) for share in (0.0, 0.5, 1.0))
    h, w = tile.rgba.shape[:2]
    np.testing.assert_allclose(under[:3], tile.rgba[h // 2 - 2:h // 2 + 2, w // 2 - 2:w // 2 + 2, :3].mean((0, 1)), atol=25)
    np.testing.assert_allclose(half[:3], (under[:3] + over[:3]) / 2, atol=2)
    assert under[3] == half[3] == over[3] == 255


def test_clicks_measure_places_with_their_errors(both: State) -> None:
    state = update(both, Look("click", "measure"))
    made = room(state).made["simultaneous"]
    r = made.registration
    middle = r.footprint(0).mean(axis=0)
    for step in ((0, 0), (10, 0), (10, 10)):
        xy = middle + step
        eye = np.array([xy[0] + 30, xy[1] - 40, 200.0])
        ground = np.array([*xy, r.heights(xy)])
        at = clicked(state, eye, ground - eye)
        assert at is not None and np.abs(np.array(at) - xy).max() < 1e-6
        action = on_click(state, eye, ground - eye, 0.01)
        assert isinstance(action, ClickMosaic)
        state = update(state, action)
    found = measured(room(state))
    assert found is not None and found.area is not None and found.area.value == pytest.approx(50, abs=1e-6)
    words = measured_html(state, room(state))
    assert "50.0" in words and "±" in words and "length 20.0" in words and "/mosaic/measured/3" in scene(state)
    assert on_click(both, np.array([0, 0, 100.0]), np.array([0, 0, -1.0]), 0.01) is None  # a look is left to the core
    assert room(update(update(state, ForgetPlaces(all=False)), ForgetPlaces())).places == ()


def test_a_conjugate_point_enters_the_block_and_only_what_moved_is_made_anew(both: State) -> None:
    state = update(update(both, Look("shown", "simultaneous")), Look("click", "conjugate point"))
    r, before = room(state).made["simultaneous"].registration, len(state.block.observations)
    state = update(state, CancelMosaic())
    state = state.with_room(replace(room(state), wanted={k: v for k, v in room(both).wanted.items() if k == "simultaneous"}))
    x, y = np.mean([r.footprint(k).mean(axis=0) for k in range(len(r.names))], axis=0)
    state = update(state, ClickMosaic(float(x) + 24.0, float(y) + 11.0))
    assert len(state.room(Matching).asked) >= 3
    state = work(state, matching_tasks)
    good = [f for f in state.room(Matching).found if f.ok]
    assert len(good) >= 2, [f.why for f in state.room(Matching).found]
    assert "Conjugate point: found in" in progress_html(room(state), state.room(Matching), False)
    state = update(state, Accept(all=True))
    assert len(state.block.observations) == before + 1 + len(good) and tasks(state)
    state = work(state)
    made = room(state).made["simultaneous"]
    assert made.block is state.block and made.done and len(made.tiles) == made.total and made.renewed < 0.3 * made.total
    state = work(update(state, Undo()))
    assert len(state.block.observations) == before and room(state).made["simultaneous"].block is state.block


def test_a_map_is_compared_and_its_shift_found(both: State, folder: Path) -> None:
    state = work(update(both, WriteMosaic("ours.png")))
    assert (folder / "ours.png").is_file() and (folder / "ours.pgw").is_file() and "px of" in room(state).message
    assert room(state).wrote == room(state).message and room(state).wrote in written_html(room(state))
    asked = update(state, WriteMosaic("ours.tif"))
    assert "starting…" in written_html(room(asked)) and "tile 3…" in written_html(room(update(asked, Progressing("tile 3"))))
    assert "Cancelled." in written_html(room(update(asked, CancelMosaic())))
    state = work(update(state, WriteMosaic("ours.tif")))
    import rasterio
    from rasterio.enums import ColorInterp

    with rasterio.open(folder / "ours.tif") as data:
        bands, profile = data.read(), data.profile
    moved = profile["transform"] * rasterio.Affine.translation(5, -3)
    with rasterio.open(folder / "map.tif", "w", driver="GTiff", width=bands.shape[2], height=bands.shape[1], count=bands.shape[0],
                       dtype="uint8", transform=moved, crs=profile["crs"]) as out:
        out.write(bands)
        out.colorinterp = [ColorInterp[n] for n in ("red", "green", "blue", "alpha")[:bands.shape[0]]]
    pixel = profile["transform"].a
    state = work(update(state, OpenLayer("map.tif")))
    layer = room(state).layer
    assert layer is not None and len(layer.off) > 30
    np.testing.assert_allclose(layer.mean, [5 * pixel, 3 * pixel], atol=0.1 * pixel)
    assert layer.rms == pytest.approx(np.hypot(5, 3) * pixel, rel=0.02) and "mean +0." in layer_html(room(state))
    assert csv_of(layer).count("\n") == len(layer.off) + 1
    found = scene(state)
    assert "/mosaic/layer/offsets" in found and isinstance(found["/mosaic/layer/picture"], Picture)
    assert "no such file" in room(work(update(state, OpenLayer("none.tif")))).message
    for outside in ("../map.tif", "/etc/passwd", "maps/../../map.tif", "a\0b.tif", "x" * 1999):
        assert "within the project's folder only" in room(work(update(state, OpenLayer(outside)))).message
    assert state.assets.folder is not None
    (state.assets.folder / "words.tif").write_text("no picture")
    assert "is no TIFF" in room(work(update(state, OpenLayer("words.tif")))).message
    for outside in ("../x.tif", "a\0b.tif"):
        assert "within the project" in room(work(update(state, WriteMosaic(outside)))).message
    [photo, *_] = (folder / "images").glob("*.jpg")
    assert "px of" in room(work(update(state, WriteMosaic("ours.tif")))).message  # an earlier mosaic may be replaced
    (folder / "notes.tfw").write_text("mine")
    (folder / "areas.footprints.geojson").write_text("[]")
    for name in (f"images/{photo.name}", "map.tif", "words.tif", "notes.tif", "areas.png"):
        before = {f: f.read_bytes() for f in folder.rglob("*") if f.is_file()}
        assert "no mosaic of this program's" in room(work(update(state, WriteMosaic(name)))).message
        assert {f: f.read_bytes() for f in folder.rglob("*") if f.is_file()} == before
    assert room(update(state, OpenLayer(""))).layer is None
    nothing = np.zeros((200, 200, 4), np.uint8)
    blank = offsets(Layer("x"), nothing, nothing, Grid((200, 200), (1, 0, 0, 0, -1, 0)))
    assert "nothing to compare" in blank.words


def test_what_cannot_be_is_said_in_one_sentence(both: State, folder: Path) -> None:
    assert update(both, Choose("kind", "better")) is both and update(both, Look("opacity", 7.0)) is both
    assert update(both, MakeMosaic("sideways")) is both and update(both, Look("swipe", float("nan"))) is both
    with pytest.raises(BadProject, match="no height grid"):
        request_of(replace(room(both).ask, plane="height grid"), "")
    state = update(open_project(folder), WriteMosaic("a.tif"))
    assert "make one first" in room(state).message == room(state).wrote and tasks(state) == ()
    assert room(update(state, MakeMosaic("both"))).wrote == ""
    cancelled = update(update(open_project(folder), MakeMosaic("both")), CancelMosaic())
    assert tasks(cancelled) == () and room(cancelled).wanted == {}
    failed = work(update(update(open_project(folder), Choose("model", "plane")), MakeMosaic("simultaneous")))
    assert room(failed).made or room(failed).message


def test_after_a_restart_every_tile_is_made_again_as_it_was(both: State, folder: Path) -> None:
    fresh = open_project(folder)
    for action in bring(fresh):
        fresh = update(fresh, action)
    back = work(from_json(fresh, json.loads(json.dumps(to_json(both, fresh.block)))))
    assert set(room(back).made) == set(room(both).made) == {"sequential", "simultaneous"}
    for method, was in room(both).made.items():
        now = room(back).made[method]
        assert now.grid == was.grid and set(now.tiles) == set(was.tiles) and len(was.tiles) > 3
        for name, tile in was.tiles.items():
            assert np.array_equal(now.tiles[name].rgba, tile.rgba), (method, name)


@pytest.mark.parametrize("degrees", [0, 30, 135, -100])
def test_a_turned_photo_fills_its_picture_and_lies_as_the_photo_does(degrees: float) -> None:
    """A browser hides what is under transparent corners, so that there must be next to none."""
    photo = np.zeros((60, 80, 3), np.uint8)
    quarters = {(0.25, 0.25): (255, 0, 0), (0.75, 0.25): (0, 255, 0), (0.25, 0.75): (0, 0, 255), (0.75, 0.75): (255, 255, 0)}
    for (x, y), colour in quarters.items():
        photo[int(60 * y) - 15:int(60 * y) + 15, int(80 * x) - 20:int(80 * x) + 20] = colour
    a = np.deg2rad(degrees)
    ring = np.array([[0, 60], [80, 60], [80, 0], [0, 0.0]]) @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) + 5
    made = _warped(photo, ring.tobytes())
    assert made is not None
    rgba, box = made
    assert (rgba[..., 3] == 255).mean() > 0.94
    for (x, y), colour in quarters.items():
        place = ring[0] + x * (ring[1] - ring[0]) + y * (ring[3] - ring[0])
        across, down = np.linalg.solve(np.stack([box[1] - box[0], box[3] - box[0]], axis=1), place - box[0])
        assert tuple(rgba[int(down * len(rgba)), int(across * rgba.shape[1]), :3]) == colour


def test_a_recording_leaves_out_what_is_transparent() -> None:
    corners, quads = pieces(np.ones((40, 60), bool))
    assert len(quads) == 1 and np.ptp(corners, axis=0).tolist() == [1, 1]
    opaque = np.zeros((43, 60), bool)
    opaque[:, :30] = True
    corners, quads = pieces(opaque)
    x = corners[quads][:, :, 0]
    assert x.max() == pytest.approx(32 / 60) and x.min() == 0 and len(quads) == 4 * 6
    sides = np.ptp(corners[quads], axis=1) * [60, 43]
    assert sides.prod(axis=1).sum() == pytest.approx(32 * 43)
    assert len(pieces(np.zeros((20, 20), bool))[1]) == 0
