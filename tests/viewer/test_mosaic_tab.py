"""The Mosaic tab in a real browser, on the demo project: make, see, step, measure, match; waits on state and never on time."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.browser import ViserPage
from tests.viewer.sessions import DEMO, HEAVY, Session, act, camera_arrived, downloaded, settle, until, viewed
from viewer_app.actions import Action
from viewer_app.app import App
from viewer_app.bars import rectangle
from viewer_app.flying import Fly, flight, sees_mosaic
from viewer_app.home import home_beside
from viewer_app.mosaic_actions import Choose, ForgetPlaces, Look, Progressing
from viewer_app.mosaic_place import to_scene
from viewer_app.mosaic_state import Mosaic
from viewer_app.mosaic_tasks import LANE
from viewer_app.panels.mosaic import working

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


@contextlib.contextmanager
def held(app: App, v: ViserPage, *words: str) -> Iterator[Callable[[], contextlib.AbstractContextManager[None]]]:
    """Stops the process that makes mosaics where it says words, one after the other: each time until the block of what is given
    here ends."""
    jobs, todo, stopped = app._jobs, list(words), threading.Event()

    def emit(action: Action) -> None:
        app.emit(action)
        if todo and isinstance(action, Progressing) and re.match(todo[0], action.words):
            todo.pop(0)
            os.kill(jobs._lanes[LANE].pid, signal.SIGSTOP)
            stopped.set()

    @contextlib.contextmanager
    def go_on() -> Iterator[None]:
        v.wait_until(stopped.is_set, "the words", 250)
        process = jobs._lanes[LANE].pid
        yield
        stopped.clear()
        with contextlib.suppress(ProcessLookupError):  # ended meanwhile
            os.kill(process, signal.SIGCONT)

    for user in (jobs, *jobs._lanes.values()):
        user._emit = emit
    yield go_on
    for user in (jobs, *jobs._lanes.values()):
        user._emit = app.emit


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("mosaic") / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    with viewed(folder, hidden=(*HEAVY, "rays", "bundle", "perspective", "orthogonal")) as (app, v):
        v.open_tab("Mosaic")
        camera = next(iter(app.server.get_clients().values())).camera
        camera.position, camera.look_at = np.array([900.0, 0.0, 40.0]), np.array([1900.0, 0.0, 40.0])  # somebody looks elsewhere
        v.wait_until(lambda: camera_arrived(app, v) and camera.position[0] > 800, "the view away from it")
        words = ("Registering 5 photos, simultaneous", r"Tiles: \d+ of \d+, about \d+ s left", "Registering 5 photos, sequential")
        with held(app, v, *words) as go_on:
            v.click_button("Make both, to compare")
            for each in words:
                with go_on():  # the work says what it does, how long still, and can be cancelled
                    v.page.get_by_text(re.compile(each)).first.wait_for()
                    v.page.get_by_role("button", name="Cancel mosaic work", exact=True).wait_for()
        until(app, v, lambda: len(room(app).made) == 2, "both mosaics", 250)
        yield app, v


def test_a_mosaic_made_out_of_view_is_flown_to_and_one_in_view_is_not(session: Session) -> None:
    app, v = session
    camera = next(iter(app.server.get_clients().values())).camera

    def seen() -> bool:
        looks = np.array(camera.position), np.array(camera.look_at), float(camera.fov), camera.image_width / camera.image_height
        return sees_mosaic(app.state, *looks)

    v.wait_until(lambda: camera_arrived(app, v) and seen(), "the mosaic in view")
    here = np.array(camera.position)
    assert flight(app.state, Fly("mosaic", ""), here, np.array(camera.look_at)) is not None
    assert not sees_mosaic(app.state, here, 2 * here - camera.look_at, float(camera.fov), 1.2)  # the other way round
    ring = rectangle(app.state, room(app).made["simultaneous"])
    for size in ((866.0, 800.0), (2146.0, 1440.0)):  # H knows it
        eye, at = home_beside(app.state, *size, np.radians(45))
        assert sees_mosaic(app.state, eye, at, np.radians(45), size[0] / size[1])
        assert np.linalg.norm(at - ring.mean(axis=0)) < np.linalg.norm(eye - at)


def room(app: App) -> Mosaic:
    return app.state.room(Mosaic)


def test_tiles_are_shown_and_the_steps_show_the_mosaic_growing(session: Session) -> None:
    app, v = session
    made = room(app).made["simultaneous"]
    v.wait_nodes(*(f"/mosaic/simultaneous/tiles/{n}" for n in made.tiles), "/mosaic/drift/vectors", "/mosaic/residuals/control")
    v.page.get_by_role("table", name="Drift").wait_for()
    act(app, v, Look("shown", "sequential"))
    v.wait_nodes(f"/mosaic/sequential/tiles/{next(iter(room(app).made['sequential'].tiles))}")
    v.nudge_slider("Registration step", "Home")
    v.page.get_by_text("step 1 of 5").wait_for()
    v.wait_nodes("/mosaic/sequential/box", f"/mosaic/sequential/photos/{room(app).made['sequential'].registration.names[0]}")
    v.nudge_slider("Registration step", "End")
    v.page.get_by_text("step 5 of 5").wait_for()
    act(app, v, Look("shown", "simultaneous"))


def opaque(v: ViserPage, node: str) -> float:
    """How opaque the most opaque pixel of a picture in the page's scene is, 0..1; 0 where there is none."""
    return v.page.evaluate(
        """n => { let most = 0; window.__viserMutable.nodeRefFromName[n]?.traverse(o => {
            const i = o.material?.map?.image; if (!i) return;
            const c = new OffscreenCanvas(i.width, i.height).getContext('2d');
            c.drawImage(i, 0, 0);
            const rgba = c.getImageData(0, 0, i.width, i.height).data;
            for (let k = 3; k < rgba.length; k += 4) most = Math.max(most, rgba[k]);
            most *= o.material.opacity; });
            return most / 255; }""", node)


PLACE = """n => { const root = window.__viserMutable.nodeRefFromName[''].matrixWorld.clone().invert(), at = [];
    window.__viserMutable.nodeRefFromName[n].traverse(o => { const p = o.geometry?.attributes?.position; if (!p) return;
        o.updateWorldMatrix(true, false);
        for (let i = 0; i < p.count; i++) {
            const v = o.position.clone().fromBufferAttribute(p, i).applyMatrix4(o.matrixWorld).applyMatrix4(root);
            at.push([v.x, v.y, v.z]); } });
    return at; }"""
"""Vertices of a node in the scene's coordinates, metres."""


def test_the_mosaic_is_as_opaque_as_asked(session: Session) -> None:
    app, v = session
    act(app, v, Look("shown", "simultaneous"))
    node = f"/mosaic/simultaneous/tiles/{next(iter(room(app).made['simultaneous'].tiles))}"
    v.wait_until(lambda: opaque(v, node) > 0.99, "the picture")
    made = room(app).made["simultaneous"]
    tile = made.tiles[next(iter(made.tiles))]
    corners = to_scene(app.state, made, tile.corners)
    drawn = np.array(v.page.evaluate(PLACE, node))  # at the true height
    assert np.allclose(drawn.min(axis=0), corners.min(axis=0), atol=0.05) and np.ptp(drawn[:, 2]) < 0.05
    v.set_slider("Mosaic opacity [share]", 0.4)
    until(app, v, lambda: room(app).opacity == 0.4, "the slider")
    v.wait_until(lambda: abs(opaque(v, node) - 0.4) < 0.01, "a paler picture")
    v.set_slider("Mosaic opacity [share]", 1)
    until(app, v, lambda: room(app).opacity == 1, "the slider")


def test_the_mosaic_is_handed_over_as_a_geotiff(session: Session, tmp_path: Path) -> None:
    import rasterio

    app, v = session
    file = tmp_path / "mosaic.tif"
    file.write_bytes(downloaded(app, v, "Mosaic as GeoTIFF", "tif"))
    v.open_tab("Mosaic")
    made = room(app).made["simultaneous"]
    with rasterio.open(file) as picture:
        low, high = np.array([picture.bounds.left, picture.bounds.bottom]), np.array([picture.bounds.right, picture.bounds.top])
        assert picture.count >= 3 and picture.overviews(1) and picture.read(2).std() > 5
    outline = np.concatenate([made.registration.footprint(k) for k in range(len(made.registration.names))])
    outline = made.registration.frame.to_map(np.column_stack([outline, np.zeros(len(outline))]))[:, :2]
    assert (low - 5 < outline.min(axis=0)).all() and (outline.max(axis=0) < high + 5).all()
    assert np.abs(high - low - np.ptp(outline, axis=0)).max() < 10


def test_a_click_measures_and_another_finds_a_conjugate_point(session: Session) -> None:
    app, v = session
    act(app, v, Look("click", "measure"))
    made = room(app).made["simultaneous"]
    r = made.registration
    want = np.mean([r.footprint(k).mean(axis=0) for k in range(len(r.names))], axis=0) + np.array([24.0, 11.0])
    place = to_scene(app.state, made, np.append(want, r.heights(want)))
    v.click_world(place)
    v.wait_until(lambda: len(room(app).places) == 1, "the place")
    assert np.linalg.norm(np.array(room(app).places[0]) - want) < 4.0  # metres; a screen pixel is about one
    v.page.get_by_role("table", name="Places measured").wait_for()
    v.wait_nodes("/mosaic/measured/lines")
    v.hotkey("Control+z")
    v.wait_until(lambda: not room(app).places, "undo")
    v.page.get_by_role("table", name="Places measured").wait_for(state="detached")
    v.hotkey("Control+y")
    v.wait_until(lambda: len(room(app).places) == 1, "redo")
    v.page.get_by_role("table", name="Places measured").wait_for()
    act(app, v, ForgetPlaces(), Look("click", "conjugate point"))
    before = len(app.state.block.observations)
    v.click_world(place)
    v.page.get_by_text("Conjugate point: found in").wait_for()
    settle(app, v)
    v.click_button("Accept conjugate point")
    until(app, v, lambda: len(app.state.block.observations) > before, "the point")
    made = room(app).made["simultaneous"]
    assert made.block is app.state.block and made.renewed < made.total
    v.click_button("Undo last measurement")
    until(app, v, lambda: len(app.state.block.observations) == before, "undo")


def test_making_is_cancelled_and_what_is_finished_stays(session: Session) -> None:
    app, v = session
    made = room(app).made["simultaneous"]
    act(app, v, Choose("blend", "none"))
    with held(app, v, "Registering 5 photos, sequential") as go_on:
        v.click_button("Make mosaic one by one")
        with go_on():
            v.click_button("Cancel mosaic work")
            v.wait_until(lambda: not working(app.state), "the end of the work")
    until(app, v, lambda: room(app).message == "Cancelled." and not working(app.state), "the end of the work")
    v.page.get_by_text("Cancelled.").first.wait_for()
    assert room(app).made["simultaneous"] is made and "sequential" not in room(app).wanted
