"""Which of the tabs' own values belong to the session, as JSON and back: what was chosen, asked and measured there.

What took work to make (bundle, mosaics, a comparison of epochs) is not kept but made or read again, to the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, replace
from typing import Any, TypeVar

import numpy as np

from solvers import Block, Exterior
from solvers.adjustment import Iteration

from .acting import update
from .actions_measure import SPOTS
from .bundle_actions import OPTIONS, RunBundle
from .bundle_state import Bundle, bundle_choices, bundle_of_choices
from .desktop import FITS, LONGEST, PANELS, PHOTOS, TYPED, Desktop
from .epochs import Epochs, GoToEpoch, reopened
from .figures import FIGURES, Figure
from .kept_run import KeptRun
from .lists import Tables
from .looking import Looking
from .matching_state import COLOURS, SIDES, Look, Matching
from .matching_state import Ask as AskMatch
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
    Mosaic,
)
from .photo_view import PhotoView
from .state import MODELS as ORIENTED
from .state import Solution, Spot, State

Kind = TypeVar("Kind", bound=type)
KEPT_ROOMS: dict[str, tuple[type, Callable[[Any], Any], Callable[[Any], Any]]] = {}
AGAIN: dict[str, Callable[[State, Any], State]] = {}


def kept(
    to_json: Callable[[Any], Any] = asdict,
    from_json: Callable[[Any], Any] | None = None,
    again: Callable[[State, Any], State] | None = None,
) -> Callable[[Kind], Kind]:
    """Marks a tab's own value (`State.room` or `Work.room`) as part of the session. from_json may raise anything: then it is left
    out. again: asks for the work of which only the question is kept, once the state has its project and edits."""

    def mark(kind: Kind) -> Kind:
        KEPT_ROOMS[kind.__name__] = kind, to_json, from_json or (lambda said: kind(**said))
        if again is not None:
            AGAIN[kind.__name__] = again
        return kind

    return mark


def rooms_to_json(rooms: Mapping[type, Any]) -> dict[str, Any]:
    known = {kind: (name, write) for name, (kind, write, _) in KEPT_ROOMS.items()}
    return {known[kind][0]: known[kind][1](value) for kind, value in rooms.items() if kind in known}


def rooms_of(said: Mapping[str, Any]) -> dict[type, Any]:
    """Raises whatever a value that does not hold gives rise to."""
    return {KEPT_ROOMS[name][0]: KEPT_ROOMS[name][2](value) for name, value in said.items() if name in KEPT_ROOMS}


def asked_again(state: State, said: Mapping[str, Any]) -> State:
    """The state with the work wanted that the session's rooms had the results of."""
    for name, again in AGAIN.items():
        if name in said:
            state = again(state, said[name])
    return state


def _number(value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{value!r} is not between {low} and {high}")
    return float(value)


def _one(value: Any, offered: Iterable[Any]) -> Any:
    if not any(value == o and type(value) is type(o) for o in offered):
        raise ValueError(f"{value!r} is not offered")
    return value


# -- tables, and what the photo pane shows


def _tables(said: Any) -> Tables:
    sorting = {str(k): (str(c), bool(d)) for k, (c, d) in said["sorting"].items()}
    return Tables(sorting, str(said["shown"])[:80])


def _photo(said: Any) -> PhotoView:
    left, top, width = (_number(said[k], 0.0, 1e6) for k in ("left", "top", "width"))
    return PhotoView(str(said["image"]), left, top, width, _number(said["pane"], 50.0, 10_000.0))


kept(from_json=_tables)(Tables)
kept(lambda room: {k: getattr(room, k) for k in ("image", "left", "top", "width", "pane")}, _photo)(PhotoView)
kept(lambda room: {"opacity": room.opacity}, lambda said: Looking("", _number(said["opacity"], 0.0, 1.0)))(Looking)


def _desktop(said: Any) -> Desktop:
    view = tuple(_number(v, -1e9, 1e9) for v in said["view"])
    panel, photo = _one(said.get("panel", FITS), PANELS), _one(said.get("photo", Desktop.photo), PHOTOS)
    typed = {box: words[:LONGEST] for box, words in said.get("typed", {}).items() if box in TYPED and isinstance(words, str)}
    return Desktop(str(said["side"])[:80], str(said["below"])[:80], view if len(view) == 6 else (), panel, photo, typed)


kept(from_json=_desktop)(Desktop)


# -- which figure is shown, and the run kept beside those that follow


def _figure(said: Any) -> Figure:
    return Figure(_one(said["name"], FIGURES))


def _run_json(room: KeptRun) -> dict[str, Any]:
    solutions = {m: [_row_json(r) for r in s.rows] for m, s in room.solutions.items()}
    return {"image": room.image, "solutions": solutions}


def _row_json(row: Iteration) -> list[Any]:
    """NaN has no JSON."""
    numbers = [float(getattr(row, name)) for name in ROW]
    return [[float(v) for v in row.x], [None if v != v else v for v in numbers], row.trials, row.stop]


def _run_again(state: State, said: Any) -> State:
    """The traces themselves: what they were made from may have been edited since. One that does not hold is left out."""
    try:
        solutions = {
            m: Solution(-1, tuple(_row(i, *row) for i, row in enumerate(said["solutions"][m])))
            for m in ORIENTED
            if said["solutions"].get(m)
        }
    except (TypeError, ValueError, KeyError, AttributeError):
        return state
    known = any(i.name == said["image"] for i in state.block.images)
    return state.with_room(KeptRun(said["image"], solutions)) if known and solutions else state


def _row(index: int, x: Any, numbers: Any, trials: Any, stop: Any) -> Iteration:
    vector = np.array([_number(v, -1e12, 1e12) for v in x])
    Exterior.from_vector(vector)
    values = {name: math.nan if v is None else float(v) for name, v in zip(ROW, numbers, strict=True)}
    return Iteration(index, vector, trials=int(trials), stop=None if stop is None else str(stop)[:80], **values)


ROW = ("cost", "sigma0", "step", "gradient", "damping")
kept(from_json=_figure)(Figure)
kept(_run_json, lambda _: KeptRun(), _run_again)(KeptRun)


# -- matching


def _matching_json(room: Matching) -> dict[str, Any]:
    """matched: the photos in which the place at is, or was, looked for; placed: whether tie points are, or are being."""
    names = ("first", "second", "point", "at", "start", "window", "search", "threshold", "colour")
    said = {n: getattr(room, n) for n in names} | {"looks": {side: asdict(look) for side, look in room.looks.items()}}
    matched = [a.second for a in (*(f.ask for f in room.found), *room.asked)]
    return {**said, "matched": matched, "placed": room.network is not None or room.task == "adjust"}


def _matching(said: Any) -> Matching:
    parts = {s: said["looks"][s] for s in SIDES if s in said["looks"]}
    looks = {s: Look(*(_number(part[k], -1e6, 1e6) for k in ("col", "row", "across"))) for s, part in parts.items()}
    window, search = int(_number(said["window"], 7, 61)), int(_number(said["search"], 0, 60))
    return Matching(str(said["first"]), str(said["second"]), looks, window=window, search=search,
                    threshold=_number(said["threshold"], 0.3, 0.95), colour=_one(said["colour"], COLOURS))


def _matching_again(state: State, said: Any) -> State:
    """The same matches and the same bundle of tie points are asked for; photos and points that are no more are left out."""
    room, names = state.room(Matching), {i.name for i in state.block.images}
    gone = [s for s in SIDES if room.image(s) not in names]
    looks = {s: look for s, look in room.looks.items() if s not in gone}
    first, second = ("" if s in gone else room.image(s) for s in SIDES)
    room = replace(room, first=first, second=second, looks=looks, task="adjust" if said.get("placed") is True else "")
    try:
        point, at, start = said.get("point"), _pair(said.get("at")), _pair(said.get("start"))
        if not gone and at is not None and (point is None or point in state.block.points.names):
            others = [n for n in said.get("matched", ()) if n in names and n != first][:100]
            asked = tuple(AskMatch(room.serial + 1 + k, first, other, at, start, point, room.window, room.search,
                                   room.threshold) for k, other in enumerate(others))
            room = replace(room, point=point, at=at, start=start, asked=asked, serial=room.serial + len(asked))
    except (TypeError, ValueError):
        pass  # what somebody wrote by hand
    return state.with_room(room)


def _pair(said: Any) -> tuple[float, float] | None:
    if said is None:
        return None
    col, row = (_number(v, -1e6, 1e6) for v in said)
    return col, row


kept(_matching_json, _matching, _matching_again)(Matching)


# -- bundle


def _bundle_json(room: Bundle) -> dict[str, Any]:
    """adjusted: whether there is a bundle that answers to what is chosen; stopped: the row at which somebody stopped it."""
    answered = bool(room.asked) and room.asked[:-1] == room.options
    going = answered and (room.result is not None or room.task == "run")
    return {**bundle_choices(room), "adjusted": going, "stopped": room.upto if answered else None}


def _bundle_again(state: State, said: Any) -> State:
    """A bundle that was stopped is stopped at the same row."""
    row = said.get("stopped")
    upto = row if isinstance(row, int) and not isinstance(row, bool) and row >= 0 else None
    return update(state, RunBundle(upto=upto)) if said.get("adjusted") is True or upto is not None else state


kept(_bundle_json, bundle_of_choices, _bundle_again)(Bundle)


# -- mosaics

SWITCH = (True, False)
SHOWS = ("outlines", "thumbnails", "drift", "residuals", "layer_shown")


def _mosaic_json(room: Mosaic) -> dict[str, Any]:
    wanted = {method: asdict(ask) for method, ask in room.wanted.items()}
    names = ("shown", "swipe", "opacity", "row", "exaggeration", "click", "under", "conjugate", *SHOWS)
    return {"ask": asdict(room.ask), "wanted": wanted, "places": room.places} | {name: getattr(room, name) for name in names}


def _mosaic(said: Any) -> Mosaic:
    wanted = {m: replace(_ask(said["wanted"][m]), method=m) for m in METHODS if m in said["wanted"]}
    places = tuple((_number(x, -1e9, 1e9), _number(y, -1e9, 1e9)) for x, y in said["places"][:PLACES])
    row = None if said["row"] is None else int(_number(said["row"], 0, 1e6))
    room = Mosaic(_ask(said["ask"]), wanted, {}, _one(said["shown"], SHOWN), _number(said["swipe"], 0, 1),
                  _number(said["opacity"], 0, 1), row, exaggeration=_number(said["exaggeration"], 0, EXAGGERATIONS[-1]),
                  click=_one(said["click"], CLICKS), places=places)
    under, conjugate = str(said.get("under", ""))[:1000], said.get("conjugate")
    if conjugate is not None:
        image, x, y = conjugate
        room = replace(room, conjugate=(str(image), _number(x, -1e9, 1e9), _number(y, -1e9, 1e9)))
    room = replace(room, under=under, busy=(f"layer|{under}",) if under and wanted else ())  # read again over the mosaic
    return replace(room, **{name: _one(said[name], (True, False)) for name in SHOWS})


def _ask(said: Any) -> Ask:
    offered = {"method": METHODS, "kind": KINDS, "model": MODELS, "plane": PLANES, "blend": BLENDS}
    offered |= {"seams": SWITCH, "gain": SWITCH}
    return Ask(**{name: _one(said[name], values) for name, values in offered.items()}, gsd=_number(said["gsd"], 0, 1e4))


kept(_mosaic_json, _mosaic)(Mosaic)


# -- epochs


def _epochs_json(room: Epochs) -> dict[str, Any]:
    said = {"epoch": room.epoch, "exaggeration": room.exaggeration, "ellipsoids": room.ellipsoids}
    return {**said, "read": room.compared is not None}


def _epochs(said: Any) -> Epochs:
    factor = _number(said["exaggeration"], 0, EXAGGERATIONS[-1])
    return Epochs(exaggeration=factor, ellipsoids=_one(said["ellipsoids"], (True, False)))


def _epochs_again(state: State, said: Any) -> State:
    if said.get("read") is not True:
        return state
    epoch = said.get("epoch")
    return update(update(state, reopened(state)), GoToEpoch(epoch if isinstance(epoch, int) and math.isfinite(epoch) else 0))


kept(_epochs_json, _epochs, _epochs_again)(Epochs)


# -- choices that undo takes back (`acting.undone`)


def _spots(said: Any, block: Block) -> tuple[Spot, ...]:
    images = {i.name for i in block.images}
    spots = [Spot(str(s["image"]), _number(s["col"], -1e6, 1e6), _number(s["row"], -1e6, 1e6)) for s in said[:SPOTS]]
    return tuple(s for s in spots if s.image in images)


def _places(said: Any, _: Block) -> tuple[tuple[float, float], ...]:
    return tuple((_number(x, -1e9, 1e9), _number(y, -1e9, 1e9)) for x, y in said[:PLACES])


def _options(said: Any, _: Block) -> tuple[Any, ...]:
    room = bundle_of_choices(said)
    return tuple(getattr(room, name) for name in OPTIONS)


def _tuned(said: Any, _: Block) -> tuple[int, int, float]:
    window, search, threshold = said
    return int(_number(window, 7, 61)), int(_number(search, 0, 60)), _number(threshold, 0.3, 0.95)


ASIDE: dict[str, tuple[Callable[[Any], Any], Callable[[Any, Block], Any]]] = {
    "spots": (lambda spots: [asdict(s) for s in spots], _spots),
    "places": (list, _places),
    "mosaic": (asdict, lambda said, _: _ask(said)),
    "bundle": (lambda values: dict(zip(OPTIONS, values, strict=True)), _options),
    "matching": (list, _tuned),
}


def aside_to_json(name: str, value: Any) -> list[Any]:
    return [name, ASIDE[name][0](value)]


def aside_of(said: Any, block: Block) -> tuple[str, Any]:
    """Raises whatever a value that does not hold gives rise to."""
    name, value = said
    return name, ASIDE[name][1](value, block)


__all__ = ["AGAIN", "ASIDE", "KEPT_ROOMS", "aside_of", "aside_to_json", "asked_again", "kept", "rooms_of", "rooms_to_json"]
