"""The tables in a real browser: by mouse and by keyboard alone. One server, one browser."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from playwright.sync_api import Locator

from tests.browser import ViserPage
from tests.viewer.sessions import Session, act, demo_session, photo_drawn, settle, until
from viewer_app.actions import ChooseImage, ChoosePoint, SwitchPoint, Undo
from viewer_app.actions_points import EditPoint, Refused
from viewer_app.desktop import FITS, Desktop
from viewer_app.flying import BESIDE
from viewer_app.home import PANEL
from viewer_app.lists import SortBy, rows_of
from viewer_app.panels.widgets import MORE
from viewer_app.photo_view import ShowWhole, percent
from viewer_app.scene import sight
from viewer_app.widths import FULL, NARROW

SKY = """() => { const r = window.__viserMutable.canvas.getBoundingClientRect(); return [r.x + 0.7 * r.width, r.y + 12]; }"""
"""A place of the canvas where nothing is drawn and no panel lies."""

pytestmark = [pytest.mark.browser, pytest.mark.timeout(200)]


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with demo_session(tmp_path_factory.mktemp("tables") / "demo", size=(1150, 760)) as made:
        yield made


@pytest.fixture(autouse=True)
def everything_is_taken_back(session: Session) -> Iterator[None]:
    app, v = session
    before = app.state.work
    yield
    settle(app, v)
    for _ in range(20):
        if app.state.work is not before:
            act(app, v, Undo())
    assert app.state.work.block is before.block


def table(v: ViserPage, tab: str = "Points", name: str = "Points") -> Locator:
    v.open_tab(tab)
    found = v.page.get_by_role("table", name=name, exact=True)
    found.wait_for()
    return found


def focused(v: ViserPage) -> str:
    return v.page.evaluate("() => document.activeElement?.dataset?.focus ?? ''")


def shown_names(v: ViserPage, name: str) -> list[str]:
    script = "n => [...document.querySelectorAll(`table[aria-label='${n}'] tbody tr`)].map(r => r.dataset.row)"
    return v.page.evaluate(script, name)


def test_every_column_is_reached_in_a_narrow_panel_and_seen_in_a_wide_one(session: Session) -> None:
    app, v = session
    box = table(v).locator("xpath=..")
    last, first = box.locator("th").last, box.locator(f"[data-focus='points/name/{app.state.control()[0]}']")
    hint = v.page.get_by_text(MORE, exact=True).locator("visible=true")

    def seen(cell: Locator) -> bool:
        a, b = v.box(cell), v.box(box)
        return a["x"] >= b["x"] - 1 and a["x"] + a["width"] <= b["x"] + b["width"] + 1

    assert app.state.room(Desktop).panel == FITS and v.box(box)["width"] < NARROW and not seen(last)
    hint.wait_for()
    box.evaluate("e => { e.scrollLeft = e.scrollWidth; }")
    v.wait_until(lambda: seen(last) and seen(first), "the last column beside the names")
    v.hotkey("t")
    until(app, v, lambda: app.state.room(Desktop).panel == "wide", "the wide panel")
    v.wait_until(lambda: v.box(box)["width"] > FULL - 40 and seen(last) and seen(first), "every column")
    v.wait_until(lambda: hint.count() == 0, "the hint to go")
    v.open_tab("Project")
    v.choose("Panel width", FITS)
    until(app, v, lambda: app.state.room(Desktop).panel == FITS, "the panel as the page has it")
    v.open_tab("Points")
    v.wait_until(lambda: v.box(box)["width"] < NARROW, "the narrow panel")


def test_a_heading_sorts_up_down_and_back(session: Session) -> None:
    app, v = session
    points = table(v)
    first = shown_names(v, "Points")
    heading = points.locator("th", has_text="Z").first.get_by_role("button")
    heading.click()
    v.wait_until(lambda: points.locator("th[aria-sort=ascending]").count() == 1, "sorted")
    settle(app, v)
    assert shown_names(v, "Points") == [r.name for r in rows_of(app.state, "points")[0]] != first
    z = [float(box.input_value()) for box in points.locator("input[data-focus^='points/Z/']").all()]
    assert z == sorted(z)
    heading.click()
    v.wait_until(lambda: points.locator("th[aria-sort=descending]").count() == 1, "the other way")
    heading.click()
    v.wait_until(lambda: shown_names(v, "Points") == first, "as in the file")


def test_a_standard_error_typed_solves_again(session: Session) -> None:
    app, v = session
    name = app.state.control()[1]
    old = app.state.solution("perspective")
    box = table(v).locator(f"input[data-focus='points/sZ/{name}']")
    box.fill("0.5")
    box.press("Enter")
    j = app.state.block.point_index(name)
    until(app, v, lambda: app.state.block.points.sigma[j, 2] == 0.5, "the standard error")
    new = app.state.solution("perspective")
    assert old and new and old.orientation and new.orientation
    assert not np.allclose(new.orientation.covariance, old.orientation.covariance, rtol=1e-6)
    v.wait_until(lambda: focused(v) == f"points/sZ/{name}", "the focus to stay")
    before = app.state.past[-1].block.points.sigma[j, 2]
    v.hotkey("Control+z")
    v.wait_until(lambda: np.array_equal(app.state.block.points.sigma[j, 2], before, equal_nan=True), "undo")
    v.wait_until(lambda: box.input_value() == ("" if np.isnan(before) else f"{before:.6g}"), "the box as it was")
    assert app.state.solution("perspective") is old  # brought back, not solved anew
    v.hotkey("Control+y")
    v.wait_until(lambda: app.state.block.points.sigma[j, 2] == 0.5 and box.input_value() == "0.5", "redo")
    v.hotkey("Control+z")
    v.wait_until(lambda: app.state.block.points.sigma[j, 2] != 0.5 and box.input_value() != "0.5", "undo again")
    settle(app, v)  # the table has the focus again
    v.hotkey("Control+Shift+Z")
    v.wait_until(lambda: app.state.block.points.sigma[j, 2] == 0.5, "redo by the other key")


def test_nonsense_typed_is_a_sentence_and_the_box_shows_what_holds(session: Session) -> None:
    app, v = session
    name, other = app.state.control()[1:3]
    box = table(v).locator(f"input[data-focus='points/X/{name}']")
    holds = box.input_value()
    box.fill("<b>here")
    box.press("Enter")
    v.wait_until(lambda: app.state.message.startswith(f"{name} X: '<b>here' is not a number"), "the sentence")
    v.wait_until(lambda: box.input_value() == holds and focused(v) == f"points/X/{name}", "the number that holds")
    v.open_tab("Orientation")
    v.page.get_by_text(f"{name} X: '<b>here' is not a number").wait_for()
    v.open_tab("Points")
    box.fill("67935")
    act(app, v, EditPoint(other, "sX", "-1"))  # another box's refusal overwrites nobody who is typing
    v.wait_until(lambda: v.page.locator(f"[data-refused='{app.state.room(Refused).count}']").count() == 1, "the boxes drawn anew")
    v.wait_until(lambda: box.input_value() == "67935" and focused(v) == f"points/X/{name}", "what was being typed")
    box.press("Escape")
    v.wait_until(lambda: box.input_value() == holds, "the number that holds")


def test_a_click_on_the_photo_or_the_scene_leaves_the_box_and_keys_mean_the_photo(session: Session) -> None:
    app, v = session
    name = app.state.control()[1]
    j, before = app.state.block.point_index(name), len(app.state.block.observations)
    dark, sigma = v.page.get_by_label("Dark", exact=True), app.state.block.points.sigma[:, 0]
    act(app, v, ChoosePoint(name))
    v.open_tab("Photo")
    photo_drawn(app, v)
    box, photo = table(v).locator(f"input[data-focus='points/sX/{name}']"), v.page.get_by_role("img", name="Photo ")

    def click_photo(share: float) -> None:
        at = v.box(photo)
        v.page.mouse.click(at["x"] + share * at["width"], at["y"] + 0.5 * at["height"])

    box.click()
    box.fill("0.75")
    click_photo(0.3)
    until(app, v, lambda: app.state.mark is not None and app.state.block.points.sigma[j, 0] == 0.75, "the number and the mark")
    mark = app.state.mark
    assert focused(v) == ""
    v.page.keyboard.press("m")
    until(app, v, lambda: app.state.mark is None, "the mark to be placed")
    of = app.state.block.observations
    assert mark and len(of) == before and [mark.col, mark.row] in of.pixel[of.point == j].tolist()
    assert box.input_value() == "0.75"
    v.open_tab("Project")
    dark.focus()
    click_photo(0.3)
    until(app, v, lambda: app.state.mark is not None, "another mark")
    v.page.keyboard.press("m")
    until(app, v, lambda: app.state.mark is None, "the other mark to be placed")
    v.open_tab("Points")
    box.click()
    box.fill("0.5")
    v.page.mouse.click(*v.page.evaluate(SKY))
    until(app, v, lambda: app.state.block.points.sigma[j, 0] == 0.5, "the number")
    assert v.page.evaluate("() => document.activeElement === document.body")
    v.page.keyboard.press("8")
    until(app, v, lambda: percent(app.state) > 700, "the photo at 800 %")
    assert box.input_value() == "0.5" and np.array_equal(np.delete(app.state.block.points.sigma[:, 0], j), np.delete(sigma, j))
    act(app, v, ShowWhole())


def test_the_keyboard_alone_walks_switches_and_edits(session: Session) -> None:
    app, v = session
    table(v)
    names = shown_names(v, "Points")
    v.page.locator(f"[data-focus='points/on/{names[0]}']").focus()
    for name in names[1:3]:
        v.page.keyboard.press("ArrowDown")
        v.wait_until(lambda name=name: focused(v) == f"points/on/{name}", "the focus one row down")
    v.page.keyboard.press("Space")
    until(app, v, lambda: names[2] in app.state.work.off and not app.state.playing, "the point to be off")
    v.wait_until(lambda: focused(v) == f"points/on/{names[2]}", "the focus to stay")
    v.page.keyboard.press("ArrowUp")
    v.wait_until(lambda: focused(v) == f"points/on/{names[1]}", "the focus one row up")
    v.page.keyboard.press("Enter")
    v.wait_until(lambda: names[1] in app.state.work.off, "the other point to be off")


def test_typing_outlives_the_table_being_drawn_anew(session: Session) -> None:
    app, v = session
    name = app.state.control()[1]
    box = table(v).locator(f"input[data-focus='points/Y/{name}']")
    box.click()
    box.fill("123.")
    other = app.state.control()[4]
    act(app, v, SwitchPoint(other))  # at once: a hand that clicked and typed is no hand that leaves
    v.wait_until(lambda: v.page.locator(f"[data-focus='points/on/{other}']").inner_text() == "☐", "the table drawn anew")
    v.wait_until(lambda: box.input_value() == "123." and focused(v) == f"points/Y/{name}", "what was being typed")
    box.press("Escape")
    v.wait_until(lambda: box.input_value() != "123.", "the old value")
    assert app.state.block.points.xyz[app.state.block.point_index(name), 1] != 123.0


@pytest.mark.parametrize("leave", ["by Tab", "by a click elsewhere"])
def test_what_was_typed_is_taken_when_the_box_is_left(session: Session, leave: str) -> None:
    app, v = session
    name = app.state.control()[1]
    j = app.state.block.point_index(name)
    box = table(v).locator(f"input[data-focus='points/sY/{name}']")
    box.click()
    box.fill("0.25")
    if leave == "by Tab":
        box.press("Tab")
    else:
        v.page.get_by_role("tab", name="Points", exact=True).click()
    until(app, v, lambda: app.state.block.points.sigma[j, 1] == 0.25, "the standard error")


def test_the_place_scrolled_to_stays(session: Session) -> None:
    app, v = session
    points = table(v)
    last = shown_names(v, "Points")[-1]
    points.locator(f"tr[data-row='{last}']").scroll_into_view_if_needed()
    top = v.page.evaluate("() => document.querySelector('[data-keep=points]').scrollTop")
    v.page.locator(f"[data-focus='points/on/{last}']").click()
    until(app, v, lambda: last in app.state.work.off, "the point to be off")
    v.wait_until(lambda: v.page.locator(f"[data-focus='points/on/{last}']").inner_text() == "☐", "the table drawn anew")
    v.wait_until(lambda: v.page.evaluate("() => document.querySelector('[data-keep=points]').scrollTop") == top, "its place")


def test_a_button_drawn_anew_between_press_and_release_is_pressed_once(session: Session) -> None:
    app, v = session
    name, other = app.state.control()[2], app.state.control()[5]
    table(v)
    v.page.locator(f"[data-focus='points/on/{name}']").hover()  # waits until it lies still
    v.page.mouse.down()
    act(app, v, SwitchPoint(other))
    v.wait_until(lambda: v.page.locator(f"[data-focus='points/on/{other}']").inner_text() == "☐", "the table drawn anew")
    v.page.mouse.up()
    until(app, v, lambda: name in app.state.work.off, "the press")
    assert app.state.work.off == {name, other} and len(app.state.past) >= 2


def test_a_point_shows_its_residuals_in_every_image_and_leads_there(session: Session) -> None:
    app, v = session
    first, name = app.state.image, app.state.control()[2]
    act(app, v, ChoosePoint(name))
    v.open_tab("Orientation")
    shown = v.page.get_by_role("table", name="Residuals of the point")
    shown.wait_for()
    of, j = app.state.block.observations, app.state.block.point_index(name)
    images = [app.state.block.images[i].name for i in np.unique(of.image[of.point == j])]
    rows = [r.split() for r in shown.locator("tbody tr").all_inner_texts()]
    assert [r[0] for r in rows] == images and len(images) > 2
    for row in rows:
        seen = sight(app.state, "perspective", row[0])
        assert seen is not None
        assert np.allclose([float(c) for c in row[1:3]], seen.residuals[seen.names.index(name)], atol=0.0051)
    other = next(i for i in images if i != first)
    shown.get_by_role("button", name=other).click()
    until(app, v, lambda: app.state.image == other, "the image")
    act(app, v, ChooseImage(first), ChoosePoint(None))


def test_control_becomes_check(session: Session) -> None:
    app, v = session
    name = app.state.control()[3]
    table(v)
    v.page.locator(f"[data-focus='points/role/{name}']").click()
    until(app, v, lambda: name not in app.state.control(), "the check point")
    solution = app.state.solution("perspective")
    assert solution and solution.orientation and name not in solution.orientation.points
    v.wait_until(lambda: v.page.locator(f"[data-focus='points/role/{name}']").inner_text() == "check", "the table")


def test_a_name_flies_there_in_the_browser_that_asked(session: Session) -> None:
    app, v = session
    name = app.state.control()[2]
    table(v)
    v.page.locator(f"[data-focus='points/name/{name}']").click()
    at = app.state.assets.frame.to_local(app.state.block.points.xyz[[app.state.block.point_index(name)]])[0]

    def there() -> bool:
        [(width, height)] = app._eyes.canvases.values()
        beside = (PANEL + width) / 2 if width / 2 < PANEL + BESIDE else width / 2  # where the panel does not hide it
        return app.state.point == name and bool(np.allclose(v.project(at), [beside, height / 2], atol=1))

    v.wait_until(there, "the flight")
    wider = "e => e.scrollWidth - e.clientWidth"
    assert [box.evaluate(wider) for box in v.page.locator(f"tr[data-row='{name}'] input").all()] == [0] * 6


def test_a_page_says_how_large_it_is_once_the_viewer_knows_it(session: Session) -> None:
    """What it says before that is lost."""
    app, v = session
    [number], [client] = app._eyes.canvases, app.server.get_clients().values()
    before = dict(app._widths._pages)
    app._widths.left(number)
    app._eyes.canvases.clear()
    app._came(client)
    until(app, v, lambda: number in app._eyes.canvases, "the sizes")
    assert app._widths._pages == before == {number: 1150.0}


def test_an_image_is_chosen_from_the_list(session: Session) -> None:
    app, v = session
    first, other = app.state.image, app.state.block.images[-1].name
    images = table(v, "Images", "Image list")
    assert all(s in ("✓ solved", "½ one model") for s in images.locator("tbody tr td:nth-child(2)").all_inner_texts())
    drawn = images.locator("tbody tr span[class^=collinea-t]").first.evaluate("e => getComputedStyle(e).backgroundImage")
    assert drawn.startswith('url("data:image/jpeg')
    v.page.locator(f"[data-focus='images/name/{other}']").press("Enter")
    v.wait_until(lambda: app.state.image == other, "the image")
    v.wait_until(lambda: "font-weight" in (images.locator(f"tr[data-row='{other}']").get_attribute("style") or ""), "its row")
    act(app, v, ChooseImage(first))


def test_every_orientation_stands_with_its_standard_errors(session: Session) -> None:
    app, v = session
    settle(app, v)
    words = table(v, "Images", "All orientations").inner_text()
    solution = app.state.solution("perspective")
    assert solution and solution.orientation and words.count("±") == 6 * len(app.state.block.images)
    assert f"{solution.orientation.exterior.centre[0]:.1f}" in words
    orientations = table(v, "Images", "All orientations")
    first = shown_names(v, "All orientations")
    orientations.locator("th", has_text="Z").get_by_role("button").press("Enter")
    v.wait_until(lambda: orientations.locator("th[aria-sort=ascending]").count() == 1, "sorted")
    settle(app, v)
    heights = {n: e.centre[2] for n in first if (e := app.state.exterior("perspective", n))}
    assert shown_names(v, "All orientations") == sorted(first, key=lambda n: heights[n])
    chosen, other = app.state.image, first[-1]
    v.page.locator(f"[data-focus='orientations/name/{other}']").press("Enter")
    until(app, v, lambda: app.state.image == other, "the image")
    exterior, seen = app.state.exterior("perspective"), next(iter(app.server.get_clients().values())).camera
    assert exterior is not None
    far = np.linalg.norm(exterior.centre - app.state.assets.frame.to_local(app.state.block.points.xyz).mean(axis=0))
    v.wait_until(lambda: np.linalg.norm(np.array(seen.look_at) - exterior.centre) < 0.3 * far, "the flight")
    act(app, v, ChooseImage(chosen), SortBy("orientations", "Z"), SortBy("orientations", "Z"))


def test_a_table_is_downloaded_as_csv(session: Session) -> None:
    _, v = session
    table(v)
    v.click_button("Points as CSV")
    link = v.page.locator("a[download='points.csv']")
    link.wait_for()
    with v.page.expect_download() as download:
        link.click()
    text = open(download.value.path(), encoding="utf-8").read()
    assert text.splitlines()[0].startswith("on,point,role,v [px]") and len(text.splitlines()) == 1 + len(shown_names(v, "Points"))
    v.dismiss_notifications()


def test_names_are_filtered(session: Session) -> None:
    _, v = session
    table(v)
    every = shown_names(v, "Points")
    v.set_text("Names shown", every[1])
    v.wait_until(lambda: shown_names(v, "Points") == [every[1]], "one row")
    v.set_text("Names shown", "")
    v.wait_until(lambda: shown_names(v, "Points") == every, "all rows")
