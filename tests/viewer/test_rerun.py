"""Recordings: what is in the file is what is in the trace, and rerun's viewer shows it without speaking to anyone else."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import numpy as np
import pytest
import rerun as rr
from PIL import Image
from rerun.chunk import RrdReader

from solvers import Block, Exterior
from solvers.adjustment import SCALARS
from solvers.cameras import project
from solvers.errors import BadProject, Unsupported
from solvers.geometry import LocalFrame, rotation, to_opencv
from solvers.orientation import Orientation, Request, orient
from tests.browser import chromium_page, require_chromium, wait_until
from tests.synthetic import REAL_CAMERA, block_of, prior_of, scene
from tests.viewer.test_actions import solve_all  # type: ignore[import-not-found]
from viewer_app import rerun_server, theme
from viewer_app.bundle_state import Bundle
from viewer_app.paint_rerun import layout, record
from viewer_app.replay import Replay
from viewer_app.rerun_layout import TABS, blueprint, hidden_in_space
from viewer_app.rerun_server import Served, growing, serve
from viewer_app.rerun_shown import EVERYTHING, Shown, bundle_shown, shown
from viewer_app.state import State

ORIGIN = np.array([412000.0, 5400000.0, 250.0])
NAME = "DSC 1/left.jpg"
PART = r"DSC\ 1_left.jpg"
CHECKS = ("P34", "P35", "P36")
MODELS = ("perspective", "orthogonal")


class Site:
    """A tilted image of 33 control and 3 check points at UTM-size coordinates, and both its orientations."""

    def __init__(self) -> None:
        points, seen = scene(np.random.default_rng(8), n=36, m=rotation(0.15, -0.1, 1.6), interior=REAL_CAMERA)
        self.true = Exterior(seen.m, seen.centre + ORIGIN)
        prior = prior_of(self.true, 1.0, 2.0, np.random.default_rng(1))
        block = block_of(points + ORIGIN, self.true, REAL_CAMERA, noise_px=0.5, sigma_px=0.5, seed=2, prior=prior)
        for name in CHECKS:
            block = block.with_role(name, "check")
        self.block: Block = replace(block, images=(replace(block.images[0], name=NAME),))
        self.frame = LocalFrame.around(self.block.points.xyz, "local")
        self.orientations: list[Orientation] = [orient(self.block, Request(NAME, model)) for model in MODELS]
        elements = [*self.true.centre, *np.degrees(self.true.angles)]
        keys = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg")
        self.truth: dict[str, Any] = {"images": {NAME: dict(zip(keys, elements, strict=True))}}
        rows, cols = np.mgrid[:200, :300]
        self.photo = np.stack([rows % 256, cols % 256, (rows + cols) % 256], axis=-1).astype(np.uint8)

    def record(self, path: Path) -> None:
        record(path, self.block, self.orientations, {NAME: self.photo}, self.truth)


class Recorded:
    """The values of a recording, or of a blueprint, by entity path and component: (iterations or None where static, values)."""

    def __init__(self, path: Path) -> None:
        self.timelines: set[str] = set()
        self.values: dict[tuple[str, str], list[tuple[int | None, Any]]] = {}
        reader = RrdReader(path)
        store = (*reader.recordings(), *reader.blueprints())[0]
        for chunk in reader.stream(store=store):
            self.timelines |= set(chunk.timeline_names)
            batch = chunk.to_record_batch()
            index = batch["iteration"].to_pylist() if "iteration" in batch.schema.names else [None] * batch.num_rows
            for name in batch.schema.names:
                if ":" in name:  # a component, not a timeline
                    found = self.values.setdefault((chunk.entity_path, name), [])
                    found += [(i, v) for i, v in zip(index, batch[name].to_pylist(), strict=True) if v is not None]

    def rows(self, path: str, component: str) -> tuple[list[int], np.ndarray]:
        """Iterations and values, in the order of the iterations."""
        found = sorted(self.values[path, component])
        return [i for i, _ in found if i is not None], np.array([v for _, v in found], float)

    def one(self, path: str, component: str) -> Any:
        """The only, static, value."""
        ((index, value),) = self.values[path, component]
        assert index is None
        return value


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    rr.set_strict_mode(True)  # a wrong argument raises instead of warning
    yield Site()
    rr.set_strict_mode(False)


@pytest.fixture(scope="module")
def path(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "recording.rrd"
    site.record(path)
    return path


@pytest.fixture(scope="module")
def recorded(path: Path) -> Recorded:
    return Recorded(path)


# -- the recording


def test_rerun_itself_finds_no_fault(path: Path) -> None:
    command = [rerun_server.program(), "rrd", "verify", str(path)]
    done = subprocess.run(command, env={**os.environ, "CI": "1"}, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_only_the_iterations_are_a_timeline(recorded: Recorded) -> None:
    assert recorded.timelines == {"iteration"}


@pytest.mark.parametrize("k", [0, 1])
@pytest.mark.parametrize("name", SCALARS)
def test_scalars_are_those_of_the_trace(site: Site, recorded: Recorded, k: int, name: str) -> None:
    expected = np.asarray(site.orientations[k].trace.column(name), float)
    known = np.flatnonzero(np.isfinite(expected))
    index, values = recorded.rows(f"/plots/{PART}/{MODELS[k]}/{name}", "Scalars:scalars")
    assert len(known) >= 3 and index == known.tolist()
    np.testing.assert_array_equal(values[:, 0], expected[known])


@pytest.mark.parametrize("k", [0, 1])
def test_elements_end_at_zero_and_start_where_the_trace_did(site: Site, recorded: Recorded, k: int) -> None:
    trace = site.orientations[k].trace
    first, last = (Exterior.from_vector(row.x) for row in (trace.rows[0], trace.last))
    for kind, difference in (("position", first.centre - last.centre), ("attitude", np.degrees(first.angles - last.angles))):
        _, values = recorded.rows(f"/plots/{PART}/{MODELS[k]}/{kind}", "Scalars:scalars")
        np.testing.assert_allclose(values[0], difference, atol=1e-9)
        assert values.shape == (len(trace), 3) and not values[-1].any() and np.abs(difference).max() > 1e-3


@pytest.mark.parametrize("k", [0, 1])
def test_logarithms_are_drawn_in_the_colours_of_the_model(site: Site, recorded: Recorded, k: int) -> None:
    path, trace = f"/plots/{PART}/{MODELS[k]}/log10", site.orientations[k].trace
    _, values = recorded.rows(path, "Scalars:scalars")
    expected = np.log10(np.stack([trace.column(name) for name in ("cost", "sigma0", "step")], axis=1))
    np.testing.assert_array_equal(values, expected)
    red, green, blue = theme.MODELS[MODELS[k]]
    assert recorded.one(path, "SeriesLines:colors")[0] >> 8 == (red << 16) + (green << 8) + blue
    assert recorded.one(path, "SeriesLines:names") == [f"{MODELS[k]} log10 {name}" for name in ("cost", "sigma0", "step")]


@pytest.mark.parametrize("k", [0, 1])
def test_cameras_stand_where_the_rows_say(site: Site, recorded: Recorded, k: int) -> None:
    rows, camera = site.orientations[k].trace.rows, f"/images/{PART}/{MODELS[k]}/camera"
    index, places = recorded.rows(camera, "Transform3D:translation")
    _, turns = recorded.rows(camera, "Transform3D:mat3x3")
    assert index == [row.index for row in rows]
    assert np.abs(places).max() < 2000  # the local frame: UTM numbers would lose their centimetres in float32
    np.testing.assert_allclose(places[:, 0], [row.x[:3] for row in rows], atol=1e-4)
    looks = [to_opencv(Exterior.from_vector(row.x))[0][2] for row in rows]  # the optical axis in the local frame
    np.testing.assert_allclose(turns.reshape(-1, 3, 3)[:, 2], looks, atol=1e-6)  # column-major: the third column


def test_truth_prior_and_start_are_there(site: Site, recorded: Recorded) -> None:
    prior = site.block.images[0].prior
    assert prior is not None and prior.centre is not None
    for who, centre in (("truth", site.frame.to_local(site.true.centre)), ("georeferenced", site.frame.to_local(prior.centre)),
                        ("initial", site.orientations[0].trace.rows[0].x[:3])):
        np.testing.assert_allclose(recorded.one(f"/images/{PART}/{who}/camera", "Transform3D:translation")[0], centre, atol=1e-4)
    colours = {who: recorded.one(f"/images/{PART}/{who}/camera", "Pinhole:color")[0] >> 8
               for who in ("initial", "truth", "georeferenced", *MODELS)}
    assert colours == {name: (r << 16) + (g << 8) + b for name, (r, g, b) in theme.legend().items() if name in colours}


def test_points_carry_their_names(site: Site, recorded: Recorded) -> None:
    for kind in ("control", "check"):
        rows = [i for i, role in enumerate(site.block.points.role) if role == kind]
        assert recorded.one(f"/points/{kind}", "Points3D:labels") == [site.block.points.names[i] for i in rows]
        xyz = recorded.one(f"/points/{kind}", "Points3D:positions")
        np.testing.assert_allclose(xyz, site.block.points.xyz[rows] - site.frame.origin, atol=1e-4)


@pytest.mark.parametrize("k", [0, 1])
def test_photo_shows_measured_and_projected_points(site: Site, recorded: Recorded, k: int) -> None:
    photo, trace = f"/images/{PART}/photo", site.orientations[k].trace
    names = recorded.values[f"{photo}/observed", "Points2D:labels"][0][1]
    observed = np.array(recorded.values[f"{photo}/observed", "Points2D:positions"][0][1])
    order = [site.block.point_index(name) for name in names]
    assert sorted(order) == list(range(36))
    np.testing.assert_allclose(observed, site.block.observations.pixel[order] + 0.5, atol=1e-3)  # rerun counts from the corner
    index, projected = recorded.rows(f"{photo}/{MODELS[k]}/projected", "Points2D:positions")
    xyz = site.frame.to_local(site.block.points.xyz[order])
    for i, row in enumerate(trace.rows):
        np.testing.assert_allclose(projected[i], project(REAL_CAMERA, Exterior.from_vector(row.x), xyz) + 0.5, atol=2e-3)
    assert index == [row.index for row in trace.rows]


def test_residual_vectors_of_both_models_share_their_exaggeration(site: Site, recorded: Recorded) -> None:
    photo, last = f"/images/{PART}/photo", max(len(o.trace) for o in site.orientations) - 1
    words = dict(recorded.values[f"{photo}/scale", "Points2D:labels"])[last][0]
    factor = float(words.split("×")[1].split(",")[0])
    for model, orientation in zip(MODELS, site.orientations, strict=True):
        index, _ = recorded.rows(f"{photo}/{model}/residuals", "LineStrips2D:strips")
        assert index == list(range(last + 1))  # the shorter trace keeps its last row
        strips = np.array(dict(recorded.values[f"{photo}/{model}/residuals", "LineStrips2D:strips"])[last])
        np.testing.assert_allclose((strips[:33, 1] - strips[:33, 0]) / factor, orientation.residuals, atol=1e-3)


@pytest.mark.parametrize("k", [0, 1])
def test_rays_go_from_the_centre_through_the_measured_point(site: Site, recorded: Recorded, k: int) -> None:
    trace = site.orientations[k].trace
    strips = np.array(dict(recorded.values[f"/images/{PART}/{MODELS[k]}/rays", "LineStrips3D:strips"])[trace.last.index])
    exterior = Exterior.from_vector(trace.last.x)
    np.testing.assert_allclose(strips[:, 0], np.tile(exterior.centre, (33, 1)), atol=1e-4)
    np.testing.assert_allclose(project(REAL_CAMERA, exterior, strips[:, 1]), trace.manifest["pixels"], atol=5e-3)
    control = site.frame.to_local(site.block.points.xyz[:33])
    assert np.linalg.norm(strips[:, 1] - control, axis=1).max() < 0.2  # metres: they end at their points


def test_normal_matrix_inverts_to_the_correlations(site: Site, recorded: Recorded) -> None:
    orientation = site.orientations[0]
    tensor = dict(recorded.values[f"/normal/{PART}/perspective", "Tensor:data"])[orientation.trace.last.index][0]
    assert [int(n) for n in tensor["shape"]] == [6, 6]
    q = np.linalg.inv(np.reshape(tensor["buffer"], (6, 6)))
    found, expected = (c / np.sqrt(np.outer(np.diag(c), np.diag(c))) for c in (q, orientation.covariance))
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_log_says_every_row_and_why_it_stopped(site: Site, recorded: Recorded) -> None:
    for model, orientation in zip(MODELS, site.orientations, strict=True):
        said = recorded.values[f"/log/{PART}/{model}", "TextLog:text"]
        assert [i for i, _ in said][:len(orientation.trace)] == [row.index for row in orientation.trace.rows]
        assert any(str(text[0]).endswith(f"stopped by {orientation.trace.last.stop}") for _, text in said)
        assert all(any(warning in text[0] for _, text in said) for warning in orientation.warnings)


def test_about_tells_the_origin(site: Site, recorded: Recorded) -> None:
    text = recorded.one("/about", "TextDocument:text")[0]
    assert all(f"{v:.10g}" in text for v in site.frame.origin)


def test_it_opens_with_space_photo_curves_normal_matrices_and_log(site: Site) -> None:
    import rerun.blueprint as rrb

    replays = [Replay.of(o.trace, site.block, site.frame) for o in site.orientations]
    made = blueprint(replays, site.frame.to_local(site.block.points.xyz))

    def views(part: Any) -> Iterator[Any]:
        for inner in part.contents:
            yield from views(inner) if isinstance(inner, rrb.Container) else [inner]

    found = list(views(made.root_container))
    kinds = [type(v).__name__.removesuffix("View") for v in found]
    assert kinds.count("Spatial3D") == kinds.count("Spatial2D") == kinds.count("TextLog") == 1
    assert kinds.count("Tensor") == len(MODELS) and kinds.count("TimeSeries") == 3
    assert next(v for v in found if type(v).__name__ == "Spatial2DView").origin == f"/images/{PART}/photo"
    shown = [p for v in found if type(v).__name__ == "TimeSeriesView" for p in v.contents]
    assert {f"/plots/{PART}/{m}/{what}" for m in MODELS for what in ("log10", "position", "attitude")} == set(shown)


def test_a_block_of_many_images_is_laid_out_about_the_chosen_one(site: Site) -> None:
    replay = Replay.of(site.orientations[0].trace, site.block, site.frame)
    many = [replace(replay, image=f"I{k}") for k in range(300)]
    made: Any = blueprint(many, site.frame.to_local(site.block.points.xyz), Shown("I290"))
    space, tabs = made.root_container.contents[0].contents[0], made.root_container.contents[1].contents
    assert [t.name for t in tabs[:12]] == [f"I{k % 300}" for k in range(290, 302)] and len(tabs) == TABS + 1
    out = [c for c in space.contents if c.endswith("/rays/**")]
    assert len(out) == 299 and "- /images/I290/perspective/rays/**" not in out and not space.visualizer_overrides


def test_same_run_same_recording(site: Site, path: Path, recorded: Recorded, tmp_path: Path) -> None:
    site.record(tmp_path / "again.rrd")
    again = Recorded(tmp_path / "again.rrd").values
    assert {k: repr(v) for k, v in again.items()} == {k: repr(v) for k, v in recorded.values.items()}  # as text: NaN is NaN
    first, second = (RrdReader(p).recordings()[0].recording_id for p in (path, tmp_path / "again.rrd"))
    assert first == second


def test_a_failure_leaves_nothing_behind(site: Site, tmp_path: Path) -> None:
    kept = tmp_path / "recording.rrd"
    kept.write_bytes(b"an earlier run")
    with pytest.raises(KeyError):
        record(kept, site.block, site.orientations, {}, {"images": {NAME: {"X": 0.0}}})
    assert kept.read_bytes() == b"an earlier run" and list(tmp_path.iterdir()) == [kept]


def test_normal_matrix_leaves_out_what_lies_behind_the_camera(site: Site) -> None:
    replay = Replay.of(site.orientations[0].trace, site.block, site.frame)
    low = replace(replay.rows[0], x=np.concatenate([replay.xyz.mean(axis=0), replay.rows[0].x[3:]]))
    assert np.isnan(replay.projected(low)).any() and np.isfinite(replay.normal(low)).all()


# -- rerun's viewer


def _get(url: str, host: str | None = None) -> tuple[int, dict[str, str], bytes]:
    request = urllib.request.Request(url, headers={"Host": host} if host else {})
    try:
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.status, dict(answer.headers), answer.read()
    except urllib.error.HTTPError as error:
        return error.code, dict(error.headers), error.read()


def test_server_gives_page_and_recording_to_this_machine_alone(path: Path) -> None:
    with serve(path) as served:
        status, headers, body = _get(served.url)
        assert status == 200 and b"https://" not in b"".join(line for line in body.splitlines() if b"<link" in line)
        assert "connect-src 'self' data:;" in headers["Content-Security-Policy"]
        assert "frame-ancestors 'self' http://127.0.0.1:* http://localhost:*" in headers["Content-Security-Policy"]
        assert _get(f"{served.origin}/re_viewer_bg.wasm")[2][:4] == b"\0asm"
        assert _get(f"{served.origin}/recording.rrd")[2] == path.read_bytes()
        assert _get(f"{served.origin}/../{path.name}")[0] == _get(f"{served.origin}/etc/passwd")[0] == 404
        assert _get(f"{served.origin}/recording.rrd", host="rebound.example")[0] == 403
        assert served.origin.startswith("http://127.0.0.1:")
    served.close()
    with pytest.raises(urllib.error.URLError):
        _get(served.url)


def test_the_program_ends_with_the_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    class Watched(subprocess.Popen):
        def __init__(self, *args: Any, **options: Any) -> None:
            super().__init__(*args, **options)
            started.append(self)

    monkeypatch.setattr(rerun_server.subprocess, "Popen", Watched)
    rerun_server.web_viewer.cache_clear()
    assert set(rerun_server.web_viewer()) == set(rerun_server.PAGE)
    assert len(started) == 1 and started[0].returncode is not None


def test_process_ends_while_it_serves(path: Path) -> None:
    code = f"from viewer_app.rerun_server import serve; print(serve({str(path)!r}).url)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and done.stdout.startswith("http://127.0.0.1:") and not done.stderr


def test_errors_are_one_sentence(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadProject, match=r"none\.rrd: there is no recording; solve the project first"):
        serve(tmp_path / "none.rrd")
    rerun_server.web_viewer.cache_clear()
    monkeypatch.setattr(rerun_server.shutil, "which", lambda *_, **__: None)
    with pytest.raises(Unsupported, match="rerun program is missing"):
        serve(path)
    monkeypatch.setattr(rerun_server, "program", lambda: sys.executable)  # a program that ends at once
    with pytest.raises(Unsupported, match="ended with code"):
        serve(path)


@pytest.mark.browser
@pytest.mark.timeout(600)  # seconds on a graphics card; on two busy cores without one, minutes
def test_it_opens_in_a_browser_follows_the_scene_and_speaks_to_nobody_else(site: Site, path: Path) -> None:
    require_chromium()
    with serve(path, follows=True) as served, chromium_page(served.url, size=(800, 560)) as (page, log):
        def drawn(name: str = "rerun") -> list[int]:
            """Pixels of each model's colour in the view of the block, which is on the left, above the log."""
            picture = np.asarray(Image.open(BytesIO(page.screenshot(timeout=120_000))).convert("RGB"), int)
            if os.environ.get("COLLINEA_SHOTS"):
                Image.fromarray(picture.astype(np.uint8)).save(Path(os.environ["COLLINEA_SHOTS"]) / f"{name}.png")
            block = picture[60:300, :395]
            return [int((np.abs(block - c).sum(axis=2) < 30).sum()) for c in (theme.PERSPECTIVE, theme.ORTHOGONAL)]

        wait_until(page, lambda: min(drawn()) > 50, "rerun to draw both models in their colours", timeout=500)
        for hidden, there in (({"orthogonal"}, (True, False)), ({"perspective"}, (False, True)), (set(), (True, True))):
            served.lay_out(layout(site.block, site.orientations, Shown(NAME, frozenset(hidden))))
            wait_until(page, lambda t=there: tuple(n > 20 for n in drawn(f"rerun {t}")) == t, f"rerun without {hidden}", 300)
        assert log.external == []
        assert f"{served.origin}/recording.rrd" in log.answered
        assert all(url.startswith(served.origin) for url in log.answered)
        assert not [error for error in log.errors if "Failed to fetch" not in error]  # its refused calls home


def test_it_opens_with_what_the_scene_shows(state: State) -> None:
    solved = solve_all(state)
    replays = [Replay.of(o.trace, state.block, state.assets.frame) for i in ("left", "right") for m in MODELS
               if (s := solved.solution(m, i)) and (o := s.orientation)]  # fmt: skip
    assert len(replays) == 4
    right = {f"/images/right/{m}/rays" for m in MODELS}
    assert set(hidden_in_space(replays, shown(solved))) == right and hidden_in_space(replays, EVERYTHING) == []
    less = replace(solved, view=replace(solved.view, orthogonal=False, truth=False))
    hidden = {f"/images/{i}/{layer}" for i in ("left", "right") for layer in ("orthogonal", "truth")}
    assert set(hidden_in_space(replays, shown(less))) == right | hidden
    none = replace(solved, view=replace(solved.view, rays=False, dark=True))
    assert len(hidden_in_space(replays, shown(none))) == 4 and shown(none).dark
    bare = solved.with_room(replace(solved.room(Bundle), draw_ellipsoids=False))
    assert bundle_shown(bare).hidden == {"draw_ellipsoids"} and shown(bare) == shown(solved)


def test_a_recording_that_grows_is_handed_on_as_it_grows(tmp_path: Path) -> None:
    """While its run is at work the answer stays open; what comes is sent; it ends with the run."""
    recording, running = tmp_path / "recording.rrd", tmp_path / "running"
    recording.write_bytes(b"first ")
    running.write_text(f"{os.getpid()}\n")
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with Served(recording, {}) as served, direct.open(f"{served.origin}/recording.rrd") as answer:
        assert answer.read(6) == b"first "
        with recording.open("ab") as stream:
            stream.write(b"second")
        assert answer.read(6) == b"second"
        running.unlink()
        assert answer.read() == b""
    running.write_text("999999999\n")
    assert not growing(recording)  # nobody makes rows any more


def test_a_page_is_laid_out_anew_while_it_is_open(path: Path, tmp_path: Path) -> None:
    """Each blueprint comes as it is said; who opens the page later gets the last; at the end every page is let go."""
    direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with Served(path, {}, follows=True) as served:
        assert quote(f"{served.origin}/layout.rrd", safe="") in served.url
        with direct.open(f"{served.origin}/layout.rrd") as answer:
            for said in (b"first ", b"second"):
                served.lay_out(said)
                assert answer.read(6) == said
            with direct.open(f"{served.origin}/layout.rrd") as late:
                assert late.read(6) == b"second"
                served.close()
                assert answer.read() == late.read() == b""
    with serve(path) as served:
        assert "layout" not in served.url and _get(f"{served.origin}/layout.rrd")[0] == 404


def test_a_page_that_was_closed_keeps_nothing(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rerun_server._Layout.each, "__defaults__", (0.05,))
    before = set(threading.enumerate())
    with Served(path, {}, follows=True) as served:
        for _ in range(5):
            with socket.create_connection(("127.0.0.1", urlsplit(served.origin).port)) as page:
                page.sendall(f"GET /layout.rrd HTTP/1.1\r\nHost: {urlsplit(served.origin).netloc}\r\n\r\n".encode())
                assert page.recv(15) == b"HTTP/1.1 200 OK"
        deadline = time.monotonic() + 20
        while len(set(threading.enumerate()) - before) > 1:  # the server's own
            assert time.monotonic() < deadline, threading.enumerate()
            time.sleep(0.01)


def laid_out(made: bytes, folder: Path) -> dict[str, Any]:
    """What a blueprint overrides in space, by entity and component."""
    (folder / "made.rbl").write_bytes(made)
    found = {}
    for (path, name), values in Recorded(folder / "made.rbl").values.items():
        if "/ViewContents/overrides/" in path and "/photo" not in path:
            entity = path.split("/ViewContents/overrides")[1].split("/visualizers")[0]
            found[f"{entity} {name.split(':')[1]}"] = values[-1][1]
    return found


def test_an_open_recording_follows_the_scene(site: Site, state: State, tmp_path: Path) -> None:
    solved = solve_all(state)
    done = [s.orientation for m in MODELS if (s := solved.solution(m, "left")) and s.orientation]
    bare = replace(solved, view=replace(solved.view, orthogonal=False, labels=False))
    with_all, less = (laid_out(layout(s.block, done, shown(s)), tmp_path) for s in (solved, bare))
    said = {"/images/left/orthogonal visible": [False], "/points/control show_labels": [False]}
    assert said.items() <= less.items() and not said.keys() & with_all.keys()


def test_frustums_of_a_bundle_end_at_the_corners_of_their_photos() -> None:
    from viewer_app.rerun_bundle import _Scene

    rng, interior = np.random.default_rng(3), REAL_CAMERA
    poses = [Exterior.from_angles(*rng.normal(0, 0.3, 3), centre=rng.uniform(-50, 50, 3)) for _ in range(5)]
    block = block_of(np.eye(3), poses[0], interior)
    block = replace(block, images=tuple(replace(block.images[0], name=f"I{k}") for k in range(5)))
    manifest = {"images": [i.name for i in block.images], "cameras": list(block.cameras), "points": (), "origin": np.zeros(3)}
    x = np.concatenate([np.concatenate([*(np.r_[e.centre, e.m.ravel()] for e in poses)]), np.zeros(10)])
    strips = np.asarray(_Scene(None, block, manifest, x)._frustums(x[:60].reshape(-1, 12)))
    plain = replace(interior, xp=0.0, yp=0.0, k1=0.0, k2=0.0, k3=0.0, p1=0.0, p2=0.0, b1=0.0, b2=0.0)
    w, h = interior.width, interior.height
    corners = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
    for strip, exterior in zip(strips, poses, strict=True):
        np.testing.assert_allclose(project(plain, exterior, strip[[0, 1, 3, 7]].astype(float)), corners, atol=0.5)  # as float32
        np.testing.assert_allclose(strip[[2, 5, 8]], np.tile(exterior.centre, (3, 1)), atol=1e-4)
