"""The Mosaic tab in a real browser, on the demo project: make, see, step, measure, match; waits on state and never on time."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import numpy as np
import pytest

from tests.viewer.sessions import DEMO, HEAVY, Session, act, settle, until, viewed
from viewer_app.app import App
from viewer_app.mosaic_actions import ForgetPlaces, Look
from viewer_app.mosaic_place import to_scene
from viewer_app.mosaic_state import Mosaic

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder = tmp_path_factory.mktemp("mosaic") / "demo"
    shutil.copytree(DEMO, folder, ignore=shutil.ignore_patterns("runs"))
    with viewed(folder, hidden=(*HEAVY, "rays", "bundle", "perspective", "orthogonal")) as (app, v):
        v.open_tab("Mosaic")
        v.click_button("Both")
        until(app, v, lambda: len(room(app).made) == 2, "both mosaics", 250)
        yield app, v


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


def test_a_click_measures_and_another_finds_a_conjugate_point(session: Session) -> None:
    app, v = session
    act(app, v, Look("click", "measure"))
    made = room(app).made["simultaneous"]
    r = made.registration
    want = np.mean([r.footprint(k).mean(axis=0) for k in range(len(r.names))], axis=0) + np.array([24.0, 11.0])
    place = to_scene(app.state, made, np.append(want, r.heights(want)))
    v.click_world(place)
    v.wait_until(lambda: len(room(app).places) == 1, "the place")
    assert np.linalg.norm(np.array(room(app).places[0]) - want) < 2.0  # metres; a screen pixel is about half of one
    v.page.get_by_role("table", name="Places measured").wait_for()
    v.wait_nodes("/mosaic/measured/lines")
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
