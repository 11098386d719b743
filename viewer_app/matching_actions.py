"""What can happen in the Matching tab, and what follows from it; pure. Accepting is an edit like any other: it can be undone."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from solvers import Block
from solvers.block import Observations, Points
from solvers.matching.ties import SIGMA_PX

from .acting import Action, Report, edit, handles, undone
from .matching_state import COLOURS, SIDES, Ask, Found, Look, Matching, Network
from .sighting import exterior_of, sees, where
from .state import State

SNAP = 0.02
"""Of a pane's width: a click this near to a measured point means that point."""
CLOSE = 12.0
"""px of the pane per pixel of the photo, the most that zooming gives."""
WINDOWS = range(7, 64, 2)


@dataclass(frozen=True)
class Pair(Action):
    side: str
    image: str


@dataclass(frozen=True)
class LookAt(Action):
    side: str
    col: float
    row: float
    across: float


@dataclass(frozen=True)
class Zoom(Action):
    """across changes by the factor; 0: the whole photo."""

    side: str
    factor: float


@dataclass(frozen=True)
class Click(Action):
    """Left: the template's place. Right: about where it is, when the prediction is wrong."""

    side: str
    col: float
    row: float


@dataclass(frozen=True)
class MatchPoint(Action):
    """Which point is matched; None: a new tie point at every click."""

    point: str | None


@dataclass(frozen=True)
class Tune(Action):
    """window, search or threshold."""

    name: str
    value: float


@dataclass(frozen=True)
class Propose(Action):
    """Look for the point in all other photos that may see it."""


@dataclass(frozen=True)
class ShowFound(Action):
    index: int


@dataclass(frozen=True)
class MatchRow(Action):
    row: int


@dataclass(frozen=True)
class Accept(Action):
    """The match in view, or all that were found, become observations."""

    all: bool = False


@dataclass(frozen=True)
class Reject(Action):
    pass


@dataclass(frozen=True)
class ColourTies(Action):
    by: str


@dataclass(frozen=True)
class Start(Action):
    """Long work: "ties" finds tie points in all photos, "adjust" places them by a bundle; "" stops it."""

    task: str


@dataclass(frozen=True, eq=False)
class Matched(Report):
    found: Found


@dataclass(frozen=True)
class Working(Report):
    """How far the long work is; task "" when it ended."""

    task: str
    words: str


@dataclass(frozen=True, eq=False)
class Tied(Report):
    """Tie points were found: the block `before` with them is `block`."""

    before: Block
    block: Block
    words: str


@dataclass(frozen=True, eq=False)
class Placed(Report):
    network: Network


@dataclass(frozen=True)
class Sharper(Report):
    """A finer picture of a photo has been read."""


@handles(Pair, LookAt, Zoom, Click, MatchPoint, Tune, Propose, ShowFound, MatchRow, Reject, ColourTies, Start)
def _said(state: State, action: Action) -> State:
    m = chosen(state)
    match action:
        case Pair(side, image):
            m = _paired(state, m, side, image)
        case LookAt() | Zoom():
            m = _looked(state, m, action)
        case Click(side, col, row):
            m = _clicked(state, m, side, (float(col), float(row)))
        case MatchPoint(point) if point is None or point in state.block.points.names:
            m = _aimed(state, m, point)
        case Tune(name, value):
            m = _asked(_tuned(m, name, value))
        case Propose():
            m = _proposed(state, m)
        case ShowFound(index) if 0 <= index < len(m.found):
            m = _shown(state, m, index)
        case MatchRow(row):
            m = replace(m, row=min(max(int(row), 0), m.last_row))
        case Reject():
            m = _dropped(state, m, (m.shown,))
        case ColourTies(by) if by in COLOURS:
            m = replace(m, colour=by)
        case Start(task) if task in ("", "ties", "adjust"):
            m = replace(m, task=task, serial=m.serial + 1, progress="" if task or not m.task else "Stopped.")
    return state.with_room(m)


@handles(Matched, Working, Tied, Placed, Sharper)
def _came(state: State, action: Action) -> State:
    """Results of work; those that nobody waits for any more are dropped."""
    m = chosen(state)
    match action:
        case Matched(found) if found.ask in m.asked:
            m = replace(m, asked=tuple(a for a in m.asked if a != found.ask), found=(*m.found, found))
            m = _shown(state, m, 0) if len(m.found) == 1 else m
        case Working(task, words) if m.task or not task:
            m = replace(m, task=task, progress=words)
        case Tied(before, block, words) if m.task == "ties":
            if before is not state.block:
                words = "Points were changed meanwhile: the tie points found are not taken over; find them again."
            else:
                state = edit(state, solve=False, block=block)
            m = replace(m, task="", progress=words)
        case Placed(network) if m.task == "adjust":
            m = replace(m, task="", progress=network.words, network=network)
        case Sharper():
            m = replace(m, read=m.read + 1)
    return state.with_room(m)


def chosen(state: State) -> Matching:
    """The tab's state with two photos chosen, as far as there are two."""
    m, names = state.room(Matching), [i.name for i in state.block.images]
    first = m.first if m.first in names else state.image
    if m.second in names and m.second != first:
        return m if first == m.first else replace(m, first=first)
    others = [n for n in names if n != first]
    after = [n for n in names[names.index(first) + 1 :] if n != first] if first in names else []
    return replace(m, first=first, second=(after or others or [""])[0])


def _paired(state: State, m: Matching, side: str, image: str) -> Matching:
    if side not in SIDES or all(i.name != image for i in state.block.images) or image == m.image(side):
        return m
    other = m.image("right" if side == "left" else "left")
    images = (image, other) if side == "left" else (other, image)
    if image == other:  # the two change places
        images = (m.second, m.first)
    m = replace(m, first=images[0], second=images[1], looks={}, found=(), asked=(), shown=0, row=0, start=None)
    return _aimed(state, replace(m, at=None), m.point) if m.point else replace(m, at=None)


def whole(state: State, image: str) -> Look:
    """All of a photo."""
    camera = state.block.camera_of(image)
    return Look((camera.width - 1) / 2, (camera.height - 1) / 2, 1.04 * max(camera.width, camera.height))


def _looked(state: State, m: Matching, action: LookAt | Zoom) -> Matching:
    if action.side not in SIDES or not m.image(action.side):
        return m
    all_of_it = whole(state, m.image(action.side))
    if isinstance(action, Zoom):
        old = m.looks.get(action.side, all_of_it)
        new = all_of_it if action.factor <= 0 else replace(old, across=old.across * action.factor)
    else:
        new = Look(action.col, action.row, action.across)
    if not all(map(math.isfinite, (new.col, new.row, new.across))):
        return m
    return replace(m, looks={**m.looks, action.side: _within(state, m.image(action.side), new)})


def _within(state: State, image: str, look: Look) -> Look:
    camera = state.block.camera_of(image)
    across = min(max(look.across, 500 / CLOSE), 1.5 * max(camera.width, camera.height))
    return Look(min(max(look.col, 0.0), camera.width - 1.0), min(max(look.row, 0.0), camera.height - 1.0), across)


def _clicked(state: State, m: Matching, side: str, at: tuple[float, float]) -> Matching:
    if side not in SIDES or not m.second or not bool(state.block.camera_of(m.image(side)).inside(np.array(at))):
        return m
    if side == "right":
        return (
            _asked(replace(m, start=at)) if m.at is not None else replace(m, message="First click the point in the left photo.")
        )
    across = m.looks.get(side, whole(state, m.first)).across
    near = _nearest(state, m.first, at, SNAP * across)
    if near is not None:
        name, own = near
        known = state.block.points.role[state.block.point_index(name)] != "tie"
        m = replace(m, point=name if known else m.point if m.point == name else name, at=own)
    else:
        taken = m.point is not None and sees(state, m.first, m.point) is not None
        m = replace(m, at=at, point=None if taken else m.point)
    return _asked(replace(m, start=None))


def _nearest(state: State, image: str, at: tuple[float, float], reach: float) -> tuple[str, tuple[float, float]] | None:
    of = state.block.observations
    rows = np.flatnonzero(of.image == state.block.image_index(image))
    if not len(rows):
        return None
    off = np.linalg.norm(of.pixel[rows] - at, axis=1)
    best = int(np.argmin(off))
    if not off[best] <= reach:
        return None
    col, row = of.pixel[rows[best]]
    return state.block.points.names[of.point[rows[best]]], (float(col), float(row))


def _aimed(state: State, m: Matching, point: str | None) -> Matching:
    """The point is to be matched: its measurement in the left photo is the template, else the panes show where it should be."""
    m = replace(m, point=point, found=(), asked=(), shown=0, row=0, start=None, message="")
    if point is None:
        return replace(m, at=None)
    own = sees(state, m.first, point)
    looks = dict(m.looks)
    for side in SIDES:
        image = m.image(side)
        place = sees(state, image, point) or where(state, image, point) if image else None
        if place is not None:
            looks[side] = _within(state, image, Look(*place, min(looks.get(side, whole(state, image)).across, 600.0)))
    m = replace(m, looks=looks, at=own)
    if own is None:
        return replace(m, message=f"{point} is not measured in {m.first}: click it there.")
    return _asked(m)


def _tuned(m: Matching, name: str, value: float) -> Matching:
    if not math.isfinite(value):
        return m
    if name == "window" and int(value) in WINDOWS:
        return replace(m, window=int(value))
    if name == "search":
        return replace(m, search=min(max(int(value), 0), 100))
    return replace(m, threshold=min(max(float(value), 0.3), 0.95)) if name == "threshold" else m


def _asked(m: Matching) -> Matching:
    """A match of the place that is marked; what was found before is of yesterday."""
    m = replace(m, found=(), asked=(), shown=0, row=0, message="")
    if m.at is None or not m.second:
        return m
    ask = Ask(m.serial + 1, m.first, m.second, m.at, m.start, m.point, m.window, m.search, m.threshold)
    return replace(m, asked=(ask,), serial=ask.serial)


def _proposed(state: State, m: Matching) -> Matching:
    if m.at is None:
        return replace(m, message="First click a point in the left photo, or choose one that is measured there.")
    seen = [i.name for i in state.block.images if i.name != m.first and not (m.point and sees(state, i.name, m.point))]
    if m.point is not None and exterior_of(state, m.first) is not None:  # an oriented photo that does not see it is not asked
        seen = [name for name in seen if exterior_of(state, name) is None or not _beyond(state, name, m.point)]
    if not seen:
        return replace(m, message=f"{m.point} is measured in every photo that shows it.")
    asks = tuple(
        Ask(m.serial + 1 + n, m.first, image, m.at, None, m.point, m.window, m.search, m.threshold)
        for n, image in enumerate(sorted(seen, key=lambda name: name != m.second))
    )
    return replace(m, asked=asks, found=(), shown=0, row=0, start=None, serial=m.serial + len(asks), message="")


def _beyond(state: State, image: str, point: str) -> bool:
    """Whether a point of known coordinates lies outside an oriented photo."""
    known = state.block.points.xyz[state.block.point_index(point)]
    return bool(np.isfinite(known).all()) and where(state, image, point) is None


def _shown(state: State, m: Matching, index: int) -> Matching:
    """The panes at the template and at the place found, as near as needed to see the window."""
    found = m.found[index]
    m = replace(
        m,
        shown=index,
        second=found.ask.second,
        looks=dict(m.looks) if found.ask.second == m.second else {k: v for k, v in m.looks.items() if k == "left"},
    )
    m = replace(m, row=m.last_row)
    place = found.pixel if found.pixel is not None else None if found.guess is None else found.guess.place
    if place is None:
        return m
    left = m.looks.get("left", whole(state, m.first))
    old = m.looks.get("right")
    if old is None or max(abs(place[0] - old.col), abs(place[1] - old.row)) > 0.3 * old.across:
        scale = 1.0 if found.guess is None else math.sqrt(abs(float(np.linalg.det(found.guess.shape))))
        look = Look(float(place[0]), float(place[1]), left.across * scale)
        m = replace(m, looks={**m.looks, "right": _within(state, m.second, look)})
    return m


def _dropped(state: State, m: Matching, which: tuple[int, ...]) -> Matching:
    rest = tuple(f for n, f in enumerate(m.found) if n not in which)
    m = replace(m, found=rest, shown=0, row=0)
    if rest:
        return _shown(state, m, 0)
    new = m.point is None or m.point not in state.block.points.names
    return replace(m, start=None, at=None if new else m.at, message="")


@handles(Accept)
def _accepted(state: State, action: Accept) -> State:
    m = chosen(state)
    which = tuple(n for n, f in enumerate(m.found) if f.ok and (action.all or n == m.shown))
    if not which:
        return state.with_room(replace(m, message="There is nothing to accept: the match was refused."))
    block, point = state.block, m.found[which[0]].ask.point
    if point is None:
        point = new_name(block)
        block = with_point(block, point)
    for n in which:
        block = _with_match(block, point, m.found[n])
    images = ", ".join(m.found[n].ask.second for n in which)
    # What is still to be judged belongs to the point just made.
    found = tuple(replace(f, ask=replace(f.ask, point=point)) for f in m.found)
    asked = tuple(replace(a, point=point) for a in m.asked)
    control = block.points.role[block.point_index(point)] == "control"
    state = edit(state, solve=control, block=block)
    m = _dropped(state, replace(m, found=found, asked=asked), which)
    m = replace(m, point=point if m.found or m.asked else m.point, message=f"{point} is measured in {images}.")
    return state.with_room(m)


def _with_match(block: Block, point: str, found: Found) -> Block:
    """The block with a match as observations of the point: in the first photo where there is none yet, and in the second."""
    pixel, sigma = found.pixel, found.sigma
    assert pixel is not None and sigma is not None
    if sees_in(block, found.ask.first, point) is None:
        block = with_observation(block, found.ask.first, point, np.array(found.ask.at), SIGMA_PX)
    return with_observation(block, found.ask.second, point, pixel, float(np.hypot(SIGMA_PX, sigma.max())))


def new_name(block: Block) -> str:
    """A name for a point matched by hand that no point has."""
    taken, number = set(block.points.names), 1
    while f"m{number}" in taken:
        number += 1
    return f"m{number}"


def sees_in(block: Block, image: str, point: str) -> np.ndarray | None:
    """Where a point is measured in an image, (2,) px."""
    of = block.observations
    at = np.flatnonzero((of.image == block.image_index(image)) & (of.point == block.point_index(point)))
    return of.pixel[at[0]] if len(at) else None


def with_point(block: Block, name: str) -> Block:
    """The block with a tie point of unknown coordinates."""
    p, nothing = block.points, np.full((1, 3), np.nan)
    points = Points(
        (*p.names, name),
        np.vstack([p.xyz.reshape(-1, 3), nothing]),
        np.vstack([p.sigma.reshape(-1, 3), nothing]),
        (*p.role, "tie"),
        (*p.group, "") if p.group else (),
    )
    return replace(block, points=points)


def with_observation(block: Block, image: str, point: str, pixel: np.ndarray, sigma: float) -> Block:
    """The block in which a point is measured at a pixel (2,) of an image, in place of an earlier measurement."""
    of, i, j = block.observations, block.image_index(image), block.point_index(point)
    stay = ~((of.image == i) & (of.point == j))
    new = Observations(
        np.append(of.image[stay], i),
        np.append(of.point[stay], j),
        np.vstack([of.pixel[stay].reshape(-1, 2), np.round(pixel, 4)]),
        np.append(of.sigma[stay], round(sigma, 4)),
    )
    return replace(block, observations=new)


TUNED = ("window", "search", "threshold")
undone(
    "matching",
    Tune,
    get=lambda s: tuple(getattr(s.room(Matching), name) for name in TUNED),
    put=lambda s, v: s.with_room(replace(s.room(Matching), **dict(zip(TUNED, v, strict=True)))),
)


def heard(value: str) -> Action | None:
    """What a pane's message means: "left|look|col|row|across", "left|click|col|row", "left|zoom|factor", "found|2"."""
    side, *parts = value.split("|")
    if side == "found" and len(parts) == 1 and parts[0].isdecimal() and len(parts[0]) < 6:
        return ShowFound(int(parts[0]))
    if side not in SIDES or not parts:
        return None
    try:
        numbers = [float(v) for v in parts[1:]]
    except ValueError:
        return None
    if not all(map(math.isfinite, numbers)):
        return None
    match parts[0], numbers:
        case "look", [col, row, across]:
            return LookAt(side, col, row, across)
        case "click", [col, row]:
            return Click(side, col, row)
        case "zoom", [factor]:
            return Zoom(side, factor)
    return None
