"""Widths of the panels: they follow the page, every browser has its own, and nothing that fits is said twice."""

from __future__ import annotations

from dataclasses import replace

import pytest

from viewer_app.acting import Action, update
from viewer_app.actions import Undo
from viewer_app.desktop import FITS, PANELS, PHOTOS, Desktop, OpenedTab, SizePanel, SizePhoto
from viewer_app.state import State
from viewer_app.widths import CHROME, EDGE, FULL, NARROW, OVER, SCENE, TALL, WIDEST, Widths, panel_width, photo_width


def test_the_panel_follows_the_page() -> None:
    assert panel_width(FITS, 1280) == NARROW and panel_width(FITS, 2560) == FULL
    assert NARROW < panel_width(FITS, 1920) < FULL
    assert panel_width("wide", 1280) == FULL and panel_width("very wide", 1600) == WIDEST
    assert panel_width("narrow", 3840) == NARROW < panel_width("wide", 3840) < panel_width("very wide", 3840)


@pytest.mark.parametrize("page", [300, 700, 1280, 1920, 3840])
def test_the_scene_keeps_room(page: int) -> None:
    widths = [panel_width(choice, page) for choice in PANELS]
    assert all(NARROW <= w <= max(NARROW, page - SCENE) for w in widths)


@pytest.mark.parametrize("canvas", [(870.0, 800.0), (1800.0, 1440.0), (2900.0, 2160.0), (420.0, 500.0)])
@pytest.mark.parametrize("aspect", [1.5, 0.75])
def test_the_photo_grows_within_the_scene(canvas: tuple[float, float], aspect: float) -> None:
    small, large, whole = (photo_width(choice, canvas, aspect) for choice in PHOTOS)
    assert small == OVER and (large <= whole or whole == OVER)
    if whole > OVER:
        picture = whole - EDGE
        assert picture <= canvas[0] - 2 * EDGE + 1 and picture / aspect <= TALL * canvas[1] - CHROME + 1


def test_the_key_widens_and_comes_back(state: State) -> None:
    seen = []
    for _ in range(3):
        state = update(state, SizePanel())
        seen.append(state.room(Desktop).panel)
    assert seen == ["wide", "very wide", FITS]
    photos = []
    for _ in PHOTOS:
        state = update(state, SizePhoto())
        photos.append(state.room(Desktop).photo)
    assert photos == ["whole scene", "small", "large"]


@pytest.mark.parametrize("action", [SizePanel("enormous"), SizePhoto("enormous"), SizePanel(FITS), SizePhoto("large"), Undo()])
def test_nonsense_and_what_is_so_already_change_nothing(state: State, action: Action) -> None:
    assert update(state, action).room(Desktop) == state.room(Desktop) == Desktop()


def test_a_size_is_no_edit(state: State) -> None:
    assert update(update(state, SizePanel("wide")), SizePhoto("small")).past == state.past


def test_every_browser_has_its_own_widths_and_hears_of_them_once(state: State) -> None:
    said: list[tuple[int, str, int]] = []
    widths = Widths(lambda *what: said.append(what))
    widths.fit(state)
    assert not said  # nobody there
    for client, page in ((1, 1280.0), (2, 2560.0)):
        widths.sized(client, (page - panel_width(FITS, page), 1440.0), page)
    widths.fit(state)
    widths.fit(state)
    assert said == [(1, "side", NARROW), (1, "below", OVER), (2, "side", FULL), (2, "below", OVER)]
    said.clear()
    widths.opened(2, "Photo")
    widths.fit(state)
    assert said == [(2, "below", photo_width("large", (1800.0, 1440.0), 1.5))] and said[0][2] > 1300
    said.clear()
    state = update(state, SizePanel("wide"))
    widths.fit(state)
    assert said == [(1, "side", panel_width("wide", 1280)), (2, "side", panel_width("wide", 2560))]
    said.clear()
    widths.left(2)
    widths.fit(update(state, SizePhoto("small")))
    assert not said and widths.shows(1, state) == "" and widths.shows(2, update(state, OpenedTab("below", "Photo"))) == "Photo"


def test_a_project_without_images_has_no_photo_to_grow(state: State) -> None:
    said: list[tuple[int, str, int]] = []
    widths = Widths(lambda *what: said.append(what))
    widths.sized(1, (870.0, 800.0), 1280.0)
    widths.opened(1, "Photo")
    widths.fit(replace(state, work=replace(state.work, block=replace(state.block, images=()))))
    assert said == [(1, "side", NARROW), (1, "below", OVER)]
