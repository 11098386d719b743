"""What can happen, as values, and what follows from it: update(state, action) -> state, pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from solvers.adjustment import Iteration, Trace
from solvers.block import Observations
from solvers.geometry import Surface
from solvers.orientation import Advice, Orientation

from .scene import ellipsoid_scale
from .state import FORMS, HISTORY, MODELS, PRIORS, Job, Mark, Photo, Settings, Solution, Spot, State, Terrain, View, Work

SPOTS = 50
"""Places kept at most."""
STEPS = ("first", "previous", "next", "last")


@dataclass(frozen=True)
class ChooseImage:
    image: str


@dataclass(frozen=True)
class ChoosePoint:
    point: str | None


@dataclass(frozen=True)
class SwitchPoint:
    """On becomes off, off becomes on."""

    point: str


@dataclass(frozen=True)
class UsePoints:
    """Only the points of one group, or with "" all of them."""

    group: str


@dataclass(frozen=True)
class UseOnly:
    """Only the control points of these names; * and ? stand for any letters, any letter."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class UseBox:
    """Only the control points seen within a rectangle of the chosen photo, corners in pixels."""

    left: float
    top: float
    right: float
    bottom: float


@dataclass(frozen=True)
class Set:
    """One field of Settings."""

    name: str
    value: Any


@dataclass(frozen=True)
class Show:
    """One field of View."""

    name: str
    value: Any


@dataclass(frozen=True)
class Step:
    to: str


@dataclass(frozen=True)
class GoTo:
    row: int


@dataclass(frozen=True)
class Play:
    """Play becomes pause, pause becomes play (from the start when at the end)."""


@dataclass(frozen=True)
class Tick:
    """The clock while playing."""


@dataclass(frozen=True)
class Speed:
    rows_per_second: float


@dataclass(frozen=True)
class Solve:
    pass


@dataclass(frozen=True)
class Cancel:
    pass


@dataclass(frozen=True)
class Undo:
    pass


@dataclass(frozen=True)
class Redo:
    pass


@dataclass(frozen=True)
class Aim:
    """Put the mark for a point on the chosen photo; point None keeps the one chosen."""

    col: float
    row: float
    point: str | None = None


@dataclass(frozen=True)
class Clicking:
    """What a click on the photo does: measure or monoplot."""

    what: str


@dataclass(frozen=True)
class Plot:
    """Ask for the ground coordinates of a pixel of the chosen photo."""

    col: float
    row: float


@dataclass(frozen=True)
class ForgetSpots:
    pass


@dataclass(frozen=True)
class Place:
    """The mark becomes the observation."""


@dataclass(frozen=True)
class Unmark:
    pass


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of a running adjustment."""

    job: Job
    rows: tuple[Iteration, ...]


@dataclass(frozen=True, eq=False)
class Solved:
    job: Job
    trace: Trace
    orientation: Orientation


@dataclass(frozen=True, eq=False)
class Advised:
    job: Job
    advice: Advice


@dataclass(frozen=True, eq=False)
class Failed:
    job: Job
    why: str


@dataclass(frozen=True)
class Say:
    message: str


@dataclass(frozen=True, eq=False)
class Brought:
    """A photo, the terrain or the heights of the project's surface have been read."""

    what: Terrain | Photo | Surface
    image: str = ""


Action = (
    ChooseImage
    | ChoosePoint
    | SwitchPoint
    | UsePoints
    | UseOnly
    | UseBox
    | Set
    | Show
    | Step
    | GoTo
    | Play
    | Tick
    | Speed
    | Solve
    | Cancel
    | Undo
    | Redo
    | Aim
    | Clicking
    | Plot
    | ForgetSpots
    | Place
    | Unmark
    | Rows
    | Solved
    | Advised
    | Failed
    | Say
    | Brought
)


def update(state: State, action: Action) -> State:
    """The state after an action; the same state where the action means nothing (an unknown name, a value out of range)."""
    match action:
        case ChooseImage(image):
            known = any(i.name == image for i in state.block.images)
            return _follow(replace(state, image=image, mark=None)) if known and image != state.image else state
        case ChoosePoint(point):
            return replace(state, point=point, mark=None) if point is None or point in state.block.points.names else state
        case SwitchPoint(point):
            if point not in state.block.points.names:
                return state
            return _edit(replace(state, point=point), off=state.work.off ^ {point})
        case UsePoints(group):
            return _use(state, group)
        case UseOnly() | UseBox():
            return _only(state, action)
        case Set(name, value):
            settings = _settings(state.work.settings, name, value)
            return _edit(state, settings=settings) if settings != state.work.settings else state
        case Show(name, value):
            view = _view(state.view, name, value)
            return replace(state, view=view) if view != state.view else state
        case Step(to):
            return _step(state, to)
        case GoTo(row):
            return _at(replace(state, playing=False), row)
        case Play():
            return replace(
                _at(state, 0) if not state.playing and state.row >= state.last_row else state, playing=not state.playing
            )
        case Tick():
            return _tick(state)
        case Speed(rows):
            return replace(state, speed=float(min(max(rows, 0.5), 20.0))) if math.isfinite(rows) else state
        case Solve():
            fresh = replace(state.work, revision=state.next_revision)
            return replace(state, work=fresh, next_revision=state.next_revision + 1, held=None, follow=True, message="")
        case Cancel():
            return replace(state, held=state.work.revision, message="Cancelled; Solve again continues from the start.")
        case Undo():
            return _travel(state, "past", "future")
        case Redo():
            return _travel(state, "future", "past")
        case Clicking(what):
            return replace(state, click=what, mark=None) if what in ("measure", "monoplot") else state
        case Plot() | ForgetSpots():
            return _plot(state, action)
        case Aim() | Place() | Unmark():
            return _measure(state, action)
        case Rows() | Solved() | Advised() | Failed():
            return _arrive(state, action)
        case Say(message):
            return replace(state, message=message)
        case Brought(what, image):
            assets = state.assets
            if isinstance(what, Photo):
                return replace(state, assets=replace(assets, photos={**assets.photos, image: what}))
            read = {"terrain": what} if isinstance(what, Terrain) else {"surface": what}
            return replace(state, assets=replace(assets, **read))


def _edit(state: State, **changes: Any) -> State:
    """A change of the work: remembered for undo, and everything is to be solved anew. Old solutions show until the new come."""
    work = replace(state.work, revision=state.next_revision, **changes)
    return replace(
        state,
        work=work,
        next_revision=state.next_revision + 1,
        past=(*state.past, state.work)[-HISTORY:],
        future=(),
        held=None,
        follow=True,
        message="",
    )


def _travel(state: State, back: str, forth: str) -> State:
    stack: tuple[Work, ...] = getattr(state, back)
    if not stack:
        return replace(state, message="Nothing to undo." if back == "past" else "Nothing to redo.")
    other: tuple[Work, ...] = getattr(state, forth)
    changes: dict[str, Any] = {back: stack[:-1], forth: (*other, state.work)}
    return _follow(replace(state, work=stack[-1], mark=None, held=None, message="", **changes))


def _follow(state: State) -> State:
    row = state.last_row if state.follow else min(state.row, state.last_row)
    return replace(state, row=row) if row != state.row else state


def _at(state: State, row: int) -> State:
    row = min(max(int(row), 0), state.last_row)
    return replace(state, row=row, follow=row == state.last_row)


def _step(state: State, to: str) -> State:
    targets = dict(zip(STEPS, (0, state.row - 1, state.row + 1, state.last_row), strict=True))
    return _at(replace(state, playing=False), targets[to]) if to in targets else state


def _tick(state: State) -> State:
    if not state.playing:
        return state
    return replace(state, playing=False) if state.row >= state.last_row else _at(state, state.row + 1)


def _use(state: State, group: str) -> State:
    points = state.block.points
    if group and group not in points.group:
        return state
    off = frozenset(n for n, g in zip(points.names, points.group, strict=True) if g != group) if group else frozenset()
    return _edit(state, off=off) if off != state.work.off else state


def _only(state: State, action: UseOnly | UseBox) -> State:
    """Only the control points that are meant; where there are none, a sentence instead."""
    block, points = state.block, state.block.points
    control = {n for n, r in zip(points.names, points.role, strict=True) if r == "control"}
    if isinstance(action, UseOnly):
        meant = {n for n in control if any(fnmatchcase(n, pattern) for pattern in action.names)}
        why = f"No control point is called {', '.join(action.names) or 'nothing'}; write names such as G01, G1*."
    else:
        of, rows = block.observations, block.seen_in(state.image, ("control",)) if block.images else np.zeros(0, int)
        low, high = np.sort([[action.left, action.top], [action.right, action.bottom]], axis=0)
        within = rows[((of.pixel[rows] >= low) & (of.pixel[rows] <= high)).all(axis=1)]
        meant, why = {points.names[j] for j in of.point[within]}, "No control point was measured within this rectangle."
    if not meant:
        return replace(state, message=why)
    off = frozenset(control - meant)
    return _edit(state, off=off) if off != state.work.off else state


def _plot(state: State, action: Plot | ForgetSpots) -> State:
    if isinstance(action, ForgetSpots):
        return replace(state, spots=())
    if not state.block.images or not bool(state.block.camera_of(state.image).inside(np.array([action.col, action.row]))):
        return state
    return replace(state, spots=(*state.spots, Spot(state.image, float(action.col), float(action.row)))[-SPOTS:], message="")


def _settings(settings: Settings, name: str, value: Any) -> Settings:
    allowed = {"prior": PRIORS, "form": FORMS}
    if name in allowed:
        ok = value in allowed[name]
    else:
        ok = name in ("robust", "one_pass", "recentre") and isinstance(value, bool)
    return replace(settings, **{name: value}) if ok else settings


def _view(view: View, name: str, value: Any) -> View:
    kinds = {f.name: type(getattr(view, f.name)) for f in fields(view)}
    if kinds.get(name) is bool and isinstance(value, bool):
        return replace(view, **{name: value})
    if kinds.get(name) is float and isinstance(value, (int, float)) and math.isfinite(value):
        return replace(view, **{name: float(min(max(value, 0.0), 1e5))})
    return view


def _measure(state: State, action: Aim | Place | Unmark) -> State:
    if isinstance(action, Unmark):
        return replace(state, mark=None)
    if isinstance(action, Aim):
        point = action.point or (state.mark.point if state.mark else state.point)
        camera = state.block.camera_of(state.image)
        if point not in state.block.points.names:
            return replace(state, message="Choose a point first, then click the photo where you see it.")
        if not bool(camera.inside(np.array([action.col, action.row]))):
            return state
        return replace(state, point=point, mark=Mark(point, float(action.col), float(action.row)), message="")
    if state.mark is None:
        return state
    return replace(_edit(state, block=_observed(state, state.mark)), mark=None)


def _observed(state: State, mark: Mark) -> Any:
    """The block in which the mark is the observation of its point in the chosen image."""
    block, of = state.block, state.block.observations
    i, j = block.image_index(state.image), block.point_index(mark.point)
    pixel = np.array([mark.col, mark.row])
    at = np.flatnonzero((of.image == i) & (of.point == j))
    if len(at):
        pixels = of.pixel.copy()
        pixels[at[0]] = pixel
        new = replace(of, pixel=pixels)
    else:
        new = Observations(
            np.append(of.image, i),
            np.append(of.point, j),
            np.vstack([of.pixel.reshape(-1, 2), pixel]),
            np.append(of.sigma, block.image_px),
        )
    return replace(block, observations=new)


def _arrive(state: State, action: Rows | Solved | Advised | Failed) -> State:
    """Results of a job that is still wanted; late ones of an older revision are dropped."""
    job = action.job
    if job.revision != state.work.revision:
        return state
    match action:
        case Rows(_, rows):
            solution = Solution(job.revision, rows)
        case Solved(_, trace, orientation):
            solution = Solution(job.revision, trace.rows, trace.manifest, orientation)
        case Advised(_, advice):
            solution = Solution(job.revision, advice=advice)
        case Failed(_, why):
            solution = Solution(job.revision, error=why)
    solutions = {**state.work.solutions, (job.image, job.model): solution}
    state = replace(state, work=replace(state.work, solutions=solutions))
    if solution.orientation is not None and job.model in MODELS and state.view.ellipsoid == 0:
        state = replace(state, view=replace(state.view, ellipsoid=ellipsoid_scale(state, solution.orientation)))
    return _follow(state)
