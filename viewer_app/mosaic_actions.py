"""What can happen in the Mosaic tab, and what follows from it; pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solvers import Block
from solvers.mosaic import seen_by

from . import matching_actions as matching
from .acting import Action, Report, edit, handles, undone, update
from .matching_state import Matching
from .mosaic_state import (
    BLENDS,
    CLICKS,
    EXAGGERATIONS,
    KINDS,
    METHODS,
    MODELS,
    PLACES,
    PLANES,
    SHOWN,
    Ask,
    Layer,
    Made,
    Mosaic,
    Tile,
)
from .sighting import exterior_of
from .state import State

ALLOWED = {"kind": KINDS, "model": MODELS, "plane": PLANES, "blend": BLENDS}
SWITCHES = ("outlines", "thumbnails", "drift", "residuals", "layer_shown")


@dataclass(frozen=True)
class Choose(Action):
    """One field of Ask."""

    name: str
    value: Any


@dataclass(frozen=True)
class MakeMosaic(Action):
    """Make a mosaic as asked by a method, or "both"."""

    method: str


@dataclass(frozen=True)
class CancelMosaic(Action):
    """Whatever the tab is doing ends; what is finished stays."""


@dataclass(frozen=True)
class Look(Action):
    """One field of what is shown: shown, swipe, opacity, exaggeration, click, or a switch."""

    name: str
    value: Any


@dataclass(frozen=True)
class GoToRow(Action):
    """A row of the trace shown, or relative to it."""

    row: int
    relative: bool = False


@dataclass(frozen=True)
class ClickMosaic(Action):
    """A click on the mosaic plane at x, y [unit of the registration]."""

    x: float
    y: float


@dataclass(frozen=True)
class ForgetPlaces(Action):
    """Measured places: the last, or all."""

    all: bool = True


@dataclass(frozen=True)
class OpenLayer(Action):
    """A map or orthophoto (GeoTIFF) as a layer under the mosaic; "" takes it away."""

    path: str


@dataclass(frozen=True)
class WriteMosaic(Action):
    """Write the mosaic shown, at full resolution, to a file that ends with .tif, .png or .jpg."""

    path: str


@dataclass(frozen=True, eq=False)
class Registered(Report):
    made: Made


@dataclass(frozen=True, eq=False)
class TilesCame(Report):
    """Tiles of the mosaic made by a method; last: there are no more."""

    method: str
    tiles: tuple[Tile, ...]
    last: bool


@dataclass(frozen=True, eq=False)
class TiesFound(Report):
    """Tie points that a mosaic needed: the block `before` with them is `block`."""

    before: Block
    block: Block
    words: str


@dataclass(frozen=True)
class Progressing(Report):
    words: str


@dataclass(frozen=True)
class Ended(Report):
    """Work ended: of a method, of the layer or of writing; words: what came of it, or why nothing did. file: one was written."""

    what: str
    words: str
    file: bool = False


@dataclass(frozen=True, eq=False)
class LayerCame(Report):
    layer: Layer


@handles(Choose)
def _choose(state: State, action: Choose) -> State:
    room, value = state.room(Mosaic), action.value
    ok = value in ALLOWED[action.name] if action.name in ALLOWED else False
    if action.name == "gsd":
        ok = isinstance(value, (int, float)) and math.isfinite(value) and 0 <= value <= 1e4
        value = float(value) if ok else value
    if action.name in ("seams", "gain"):
        ok = isinstance(value, bool)
    return state.with_room(replace(room, ask=replace(room.ask, **{action.name: value}))) if ok else state


@handles(MakeMosaic, CancelMosaic)
def _make(state: State, action: MakeMosaic | CancelMosaic) -> State:
    room = state.room(Mosaic)
    if isinstance(action, CancelMosaic):
        stay = {m: a for m, a in room.wanted.items() if m in room.made and room.made[m].done and room.made[m].ask == a}
        wrote = "Cancelled." if any(b.startswith("write|") for b in room.busy) else room.wrote
        return state.with_room(replace(room, wanted=stay, busy=(), progress="", message="Cancelled.", wrote=wrote))
    if action.method not in (*METHODS, "both"):
        return state
    if state.assets.folder is None:
        return state.with_room(replace(room, message="These photos have no folder; open a project to make a mosaic."))
    methods = METHODS if action.method == "both" else (action.method,)
    wanted = {**room.wanted, **{m: replace(room.ask, method=m) for m in methods}}
    shown = methods[0] if room.shown in METHODS or len(room.made) < 2 else room.shown
    return state.with_room(replace(room, wanted=wanted, shown=shown, row=None, progress="", message="", wrote=""))


@handles(Look)
def _look(state: State, action: Look) -> State:
    room, name, value = state.room(Mosaic), action.name, action.value
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    ok = {
        "shown": value in SHOWN,
        "click": value in CLICKS,
        "swipe": number and 0 <= value <= 1,
        "opacity": number and 0 <= value <= 1,
        "exaggeration": number and 0 <= value <= EXAGGERATIONS[-1],
    }
    if not ok.get(name, name in SWITCHES and isinstance(value, bool)):
        return state
    room = replace(room, **{name: value})
    return state.with_room(replace(room, row=None) if name == "shown" else room)


@handles(GoToRow)
def _row(state: State, action: GoToRow) -> State:
    room = state.room(Mosaic)
    row = min(max(int(action.row) + (room.shown_row if action.relative else 0), 0), room.last_row)
    return state.with_room(replace(room, row=None if row == room.last_row else row))


@handles(ClickMosaic)
def _click(state: State, action: ClickMosaic) -> State:
    room, made = state.room(Mosaic), state.room(Mosaic).current
    if made is None or not (math.isfinite(action.x) and math.isfinite(action.y)):
        return state
    if room.click == "measure" and len(room.places) < PLACES:
        return state.with_room(replace(room, places=(*room.places, (float(action.x), float(action.y)))))
    if room.click == "conjugate point":
        return _conjugate(state, room, made, np.array([action.x, action.y]))
    return state


def _conjugate(state: State, room: Mosaic, made: Made, at: np.ndarray) -> State:
    """The Matching tab looks for the place in all photos that show it, from the one that shows it best."""
    names = {i.name for i in state.block.images}
    seen = [k for k in seen_by(made.registration, at) if made.registration.names[k] in names]
    if len(seen) < 2:
        words = "one photo shows" if seen else "no photo shows"
        return state.with_room(
            replace(
                room,
                message=f"A conjugate point needs two photos and {words} this place; click nearer to the middle of the mosaic.",
            )
        )
    first, others = made.registration.names[seen[0]], [made.registration.names[k] for k in seen[1:]]
    col, row = (float(v) for v in made.registration.to_pixels(seen[0], at))
    for step in (
        matching.Pair("left", first),
        matching.Pair("right", others[0]),
        matching.MatchPoint(None),
        matching.LookAt("left", col, row, 600.0),  # close up: only a point measured right here is meant by the click
        matching.Click("left", col, row),
    ):
        state = update(state, step)
    m = state.room(Matching)
    if m.point is not None:  # the click met a measured point
        state = update(state, matching.Propose())
    elif m.asked:  # in every other photo that shows the place; where no orientation predicts it, the mosaic does
        asks = []
        for n, k in enumerate(seen[1:9]):
            name = made.registration.names[k]
            known = exterior_of(state, first) is not None and exterior_of(state, name) is not None
            x, y = made.registration.to_pixels(k, at)
            asks.append(replace(m.asked[0], serial=m.serial + 1 + n, second=name, start=None if known else (float(x), float(y))))
        state = state.with_room(replace(m, asked=tuple(asks), serial=m.serial + len(asks)))
    words = f"Looking for this place of {first} in {', '.join(others[:8])}; accept what is right here or in the Matching tab."
    return state.with_room(replace(room, conjugate=(first, float(at[0]), float(at[1])), message=words))


@handles(ForgetPlaces)
def _forget(state: State, action: ForgetPlaces) -> State:
    room = state.room(Mosaic)
    return state.with_room(replace(room, places=() if action.all else room.places[:-1])) if room.places else state


undone("mosaic", Choose, get=lambda s: s.room(Mosaic).ask, put=lambda s, ask: s.with_room(replace(s.room(Mosaic), ask=ask)))
undone(
    "places",
    ClickMosaic,
    ForgetPlaces,
    get=lambda s: s.room(Mosaic).places,
    put=lambda s, places: s.with_room(replace(s.room(Mosaic), places=places)),
)


@handles(OpenLayer, WriteMosaic)
def _file(state: State, action: OpenLayer | WriteMosaic) -> State:
    room = state.room(Mosaic)
    what = "layer" if isinstance(action, OpenLayer) else "write"
    if what == "layer" and not action.path:
        return state.with_room(replace(room, layer=None, under="", busy=tuple(b for b in room.busy if not b.startswith("layer"))))
    if room.current is None or not room.current.done:
        why = "There is no finished mosaic yet; make one first."
        return state.with_room(replace(room, message=why, wrote=why if what == "write" else room.wrote))
    busy = (*(b for b in room.busy if not b.startswith(what)), f"{what}|{action.path}")
    room = replace(room, under=action.path) if what == "layer" else replace(room, wrote="")
    return state.with_room(replace(room, busy=busy, message="", progress=""))


@handles(Registered)
def _registered(state: State, action: Registered) -> State:
    room, made = state.room(Mosaic), action.made
    if room.wanted.get(made.ask.method) != made.ask:
        return state
    old = room.made.get(made.ask.method)
    if old is not None and old.grid == made.grid and _same_frame(old, made):
        made = replace(made, tiles=old.tiles)  # until their successors come
    if not room.made and state.view.terrain:  # it would hide the plane wherever the ground is higher
        state = replace(state, view=replace(state.view, terrain=False))
    places = room.places if old is None or _same_frame(old, made) else ()
    return state.with_room(replace(room, made={**room.made, made.ask.method: made}, places=places, progress=""))


def _same_frame(a: Made, b: Made) -> bool:
    return np.array_equal(a.registration.frame.origin, b.registration.frame.origin) and a.registration.unit == b.registration.unit


@handles(TilesCame)
def _tiles(state: State, action: TilesCame) -> State:
    room = state.room(Mosaic)
    made = room.made.get(action.method)
    if made is None or action.method not in room.wanted:
        return state
    tiles = {**made.tiles, **{t.number: t for t in action.tiles}}
    made = replace(made, tiles=tiles, done=made.done or action.last, renewed=made.renewed + len(action.tiles))
    return state.with_room(replace(room, made={**room.made, action.method: made}))


@handles(TiesFound)
def _ties(state: State, action: TiesFound) -> State:
    if action.before is state.block:
        state = edit(state, solve=False, block=action.block)
    room = state.room(Mosaic)
    return state.with_room(replace(room, message=action.words, progress="")) if room.wanted else state


@handles(Progressing)
def _progress(state: State, action: Progressing) -> State:
    return state.with_room(replace(state.room(Mosaic), progress=action.words))


@handles(Ended)
def _ended(state: State, action: Ended) -> State:
    room = state.room(Mosaic)
    room = replace(
        room, busy=tuple(b for b in room.busy if b.partition("|")[0] != action.what), progress="", message=action.words
    )
    if action.what == "write":
        room = replace(room, wrote=action.words)
    if action.file:
        room = replace(room, written=room.written + 1)
    if action.what in METHODS:  # it failed: not to be asked again before something changes
        room = replace(room, wanted={m: a for m, a in room.wanted.items() if m != action.what})
    return state.with_room(room)


@handles(LayerCame)
def _layer(state: State, action: LayerCame) -> State:
    room = state.room(Mosaic)
    if not any(b.startswith("layer|") for b in room.busy):
        return state
    return state.with_room(replace(room, layer=action.layer))


__all__ = [
    "Ask",
    "CancelMosaic",
    "Choose",
    "ClickMosaic",
    "Ended",
    "ForgetPlaces",
    "GoToRow",
    "LayerCame",
    "Look",
    "MakeMosaic",
    "OpenLayer",
    "Progressing",
    "Registered",
    "TiesFound",
    "TilesCame",
    "WriteMosaic",
]
