"""The Matching tab in a real browser: wheel, drag, click, step, accept, undo, propose; waits on state and never on time."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.browser import ViserPage
from tests.viewer.photo_project import conjugate, make_project
from tests.viewer.sessions import Session, act, settle, until, viewed
from viewer_app.app import App
from viewer_app.matching_actions import LookAt, Zoom
from viewer_app.matching_state import Matching

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    folder: Path = make_project(tmp_path_factory.mktemp("matching") / "wall")
    with viewed(folder, hidden=("terrain",)) as (app, v):
        v.open_tab("Matching")
        v.page.locator("#collinea-left").wait_for()
        yield app, v


def room(app: App) -> Matching:
    return app.state.room(Matching)


def middle(v: ViserPage, side: str) -> tuple[float, float]:
    """Of a pane, CSS pixels; it is made anew whenever an answer comes, so the page itself is asked."""
    box = v.page.wait_for_function(
        """id => { const r = document.getElementById(id)?.getBoundingClientRect();
                   return r && r.width > 0 && [r.x + r.width / 2, r.y + r.height / 2]; }""", arg=f"collinea-{side}")
    x, y = box.json_value()
    return x, y


def shows(app: App, v: ViserPage, side: str) -> bool:
    """Whether the browser shows what the state says, and the state all that was asked of it."""
    if not app.settled():
        return False
    look = room(app).looks.get(side)
    box = v.page.evaluate("id => document.getElementById(id)?.getAttribute('viewBox')", f"collinea-{side}")
    if look is None or box is None:
        return False
    x, _, w, _ = map(float, box.split())
    return abs(w - look.across) < 0.01 and abs(x + w / 2 - 0.5 - look.col) < 0.01


def test_wheel_zooms_about_the_pointer_and_dragging_pans(session: Session) -> None:
    app, v = session
    act(app, v, LookAt("left", 300, 200, 500))
    v.wait_until(lambda: shows(app, v, "left"), "the look")
    x, y = middle(v, "left")
    v.page.mouse.move(x, y)
    v.page.mouse.wheel(0, -400)
    v.wait_until(lambda: room(app).looks["left"].across < 400, "the wheel")
    settle(app, v)
    look = room(app).looks["left"]
    assert abs(look.col - 300) < 1.5 and abs(look.row - 200) < 1.5
    v.wait_until(lambda: shows(app, v, "left"), "the zoomed look")
    v.page.mouse.move(x, y)
    v.page.mouse.down()
    v.page.mouse.move(x + 30, y - 12, steps=3)
    v.page.mouse.up()
    v.wait_until(lambda: room(app).looks["left"].col < look.col - 5, "the drag")
    assert room(app).looks["left"].row > look.row + 2 and room(app).at is None  # a drag is no click
    v.wait_until(lambda: shows(app, v, "left"), "the dragged look")
    dragged = room(app).looks["left"].col
    v.page.locator("#collinea-left").focus()
    v.page.keyboard.press("ArrowRight")
    v.wait_until(lambda: room(app).looks["left"].col > dragged + 5, "the key")
    settle(app, v)
    v.page.get_by_title("all of one").click()
    v.wait_until(lambda: room(app).looks["left"].across > 640, "the whole photo")


def test_turning_the_wheel_outlives_the_pane_being_drawn_anew(session: Session) -> None:
    app, v = session
    act(app, v, LookAt("left", 300, 200, 400))
    v.wait_until(lambda: shows(app, v, "left"), "the look")
    x, y = middle(v, "left")
    v.page.evaluate(
        """async ([x, y]) => {
            const pane = () => document.getElementById('collinea-left');
            const turn = () => pane().dispatchEvent(
                new WheelEvent('wheel', {deltaY: -200, clientX: x, clientY: y, bubbles: true, cancelable: true}));
            turn();
            const anew = pane().cloneNode(true);  // as it was last told
            anew.setAttribute('viewBox', anew.dataset.box.split(' ').slice(-4).join(' '));
            pane().replaceWith(anew);
            await new Promise(done => setTimeout(done));
            turn(); }""", [x, y])
    v.wait_until(lambda: room(app).looks["left"].across < 400, "the wheel")
    settle(app, v)
    assert abs(room(app).looks["left"].across - 400 * np.exp(-0.64)) < 1.0
    v.wait_until(lambda: shows(app, v, "left"), "the zoomed look")


def test_a_click_is_matched_shown_stepped_accepted_and_undone(session: Session) -> None:
    app, v = session
    act(app, v, LookAt("left", 300, 240, 200))
    v.wait_until(lambda: shows(app, v, "left"), "the look")
    v.page.mouse.click(*middle(v, "left"))
    until(app, v, lambda: room(app).current is not None, "the match, for which the machine may have to compile", 250)
    v.page.get_by_text("found in two").wait_for()
    found, at = room(app).current, room(app).at
    assert found is not None and at is not None and found.pixel is not None
    assert np.abs(np.array(at) - [300, 240]).max() < 1.5  # a screen pixel
    assert np.abs(found.pixel - conjugate("two", np.array(at))).max() < 0.05
    for name in ("correlation", "template", "warped"):
        assert v.page.get_by_alt_text(name, exact=True).is_visible()
    table = v.page.get_by_role("table", name="Match")
    last = room(app).last_row
    assert f"LSM row {last}" in table.inner_text() and f"{found.pixel[0]:.2f}" in table.inner_text()
    warped = v.page.get_by_alt_text("warped", exact=True)
    before = warped.get_attribute("src")
    v.nudge_slider("LSM iteration", "Home")
    table.get_by_text("LSM row 0").wait_for()
    v.wait_until(lambda: warped.get_attribute("src") != before, "the warped template of row 0")
    v.page.get_by_role("button", name="Accept", exact=True).click()
    v.page.get_by_text("m1 is measured in two.").wait_for()
    settle(app, v)
    assert len(app.state.block.observations) == 2
    assert v.page.locator("#collinea-left [data-point=m1]").count() == 1
    v.hotkey("Control+z")
    v.wait_until(lambda: len(app.state.block.observations) == 0, "undo")
    v.page.locator("#collinea-left [data-point=m1]").wait_for(state="detached")
    v.hotkey("Control+y")
    v.wait_until(lambda: len(app.state.block.observations) == 2, "redo")
    v.page.locator("#collinea-left [data-point=m1]").wait_for()
    v.hotkey("Control+z")
    v.wait_until(lambda: len(app.state.block.observations) == 0, "undo")


def test_a_point_proposes_itself_in_all_photos(session: Session) -> None:
    app, v = session
    act(app, v, LookAt("left", 250, 200, 200))
    v.wait_until(lambda: shows(app, v, "left"), "the look")
    v.page.mouse.click(*middle(v, "left"))
    until(app, v, lambda: room(app).current is not None, "the match")
    v.page.get_by_text("found in two").wait_for()
    v.click_button("Propose in the other photos")
    v.wait_until(lambda: len(room(app).found) == 2 and not room(app).asked, "the proposals", 200)
    v.page.get_by_role("table", name="Proposals").get_by_role("button", name="three").click()
    v.wait_until(lambda: room(app).second == "three", "the third photo")
    v.page.get_by_label("right photo three").wait_for()
    v.click_button("Accept all found")
    v.page.get_by_text("m1 is measured in two, three.").wait_for()
    settle(app, v)
    v.page.get_by_text("1 tie points").wait_for()
    pixels = app.state.block.observations.pixel
    for image, pixel in zip(("two", "three"), pixels[1:], strict=True):
        assert np.abs(pixel - conjugate(image, pixels[0])).max() < 0.05
    act(app, v, Zoom("left", 0))
