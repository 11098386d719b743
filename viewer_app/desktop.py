"""How the page was left: which tabs were open, how wide the panels, and from where one looked; so that it is found again. Nothing
of it is an edit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from .acting import Action, Report, handles
from .state import State

FITS = "fits the page"
PANELS = (FITS, "narrow", "wide", "very wide")
"""How wide the main panel is (`widths.panel_width`)."""
PHOTOS = ("small", "large", "whole scene")
"""How large the panel over the scene is while it shows the photo (`widths.photo_width`)."""
TYPED = {"Names of GCPs": "", "Map file": "", "Mosaic file": "mosaic.tif"}
"""Text boxes whose words wait for a button, by their label, and what is in them at first."""
LONGEST = 4000
"""Characters of one, at most."""


@dataclass(frozen=True)
class Desktop:
    """side, below: names of the tabs opened last in the main panel and in that over the scene, "" for the first. view: position
    and point looked at (6,) m, local frame, of who moved last; () before anybody did. panel, photo: of PANELS and PHOTOS; every
    browser makes of them what its own page has room for. typed: words in the boxes of TYPED."""

    side: str = ""
    below: str = ""
    view: tuple[float, ...] = ()
    panel: str = FITS
    photo: str = "large"
    typed: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class OpenedTab(Report):
    """Somebody opened a tab of a place, "side" or "below"."""

    place: str
    name: str


@dataclass(frozen=True)
class SizePanel(Action):
    """The main panel as wide as this; "" for the next that is wider, after the widest as the page has it."""

    name: str = ""


@dataclass(frozen=True)
class SizePhoto(Action):
    """The photo as large as this; "" for the next, after the largest the smallest."""

    name: str = ""


@dataclass(frozen=True)
class Type(Action):
    """Words typed into a box of TYPED."""

    box: str
    words: str


@handles(OpenedTab)
def _opened(state: State, action: OpenedTab) -> State:
    room = state.room(Desktop)
    if action.place not in ("side", "below") or getattr(room, action.place) == action.name:
        return state
    return state.with_room(replace(room, **{action.place: action.name}))


@handles(SizePanel)
def _panel(state: State, action: SizePanel) -> State:
    room = state.room(Desktop)
    after = {FITS: "wide", "wide": "very wide"}
    name = action.name or after.get(room.panel, FITS)
    return state.with_room(replace(room, panel=name)) if name in PANELS and name != room.panel else state


@handles(SizePhoto)
def _photo(state: State, action: SizePhoto) -> State:
    room = state.room(Desktop)
    name = action.name or PHOTOS[(PHOTOS.index(room.photo) + 1) % len(PHOTOS)]
    return state.with_room(replace(room, photo=name)) if name in PHOTOS and name != room.photo else state


@handles(Type)
def _type(state: State, action: Type) -> State:
    room = state.room(Desktop)
    if action.box not in TYPED or len(action.words) > LONGEST or typed(state, action.box) == action.words:
        return state
    return state.with_room(replace(room, typed={**room.typed, action.box: action.words}))


def typed(state: State, box: str) -> str:
    """The words in a box of TYPED."""
    return state.room(Desktop).typed.get(box, TYPED[box])
