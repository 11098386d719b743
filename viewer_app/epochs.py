"""Epochs of a monitored network to be seen: where points went, exaggerated and with their ellipsoids, epoch by epoch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solvers import PhotogrammetryError
from solvers.workflows_monitoring import Monitored, Movements, read_comparison

from . import theme
from .acting import Action, handles
from .ground import nice, site, symbol_size
from .state import State
from .values import Ellipsoid, Label, PointCloud, Scene, Segments

MOST = 80
"""Ellipsoids drawn at most; those of moved points come first."""
EXAGGERATIONS = tuple(float(f * 10**k) for k in range(5) for f in (1, 2, 5))


@dataclass(frozen=True, eq=False)
class Epochs:
    """What is compared (None before it was read), the epoch shown (0 is the first), its exaggeration (0: made to fit), and
    whether ellipsoids are drawn; said: why nothing is shown."""

    compared: Monitored | None = None
    epoch: int = 0
    exaggeration: float = 0.0
    ellipsoids: bool = True
    said: str = ""

    @property
    def last(self) -> int:
        return 0 if self.compared is None else len(self.compared.later)

    @property
    def shown(self) -> Movements | None:
        """The epoch shown; None for the first, from which all movements count."""
        return self.compared.later[self.epoch - 1] if self.compared is not None and 0 < self.epoch <= self.last else None


@dataclass(frozen=True)
class ShowComparison(Action):
    """A comparison that was read, or why there is none."""

    compared: Monitored | None
    said: str = ""


@dataclass(frozen=True)
class GoToEpoch(Action):
    """An epoch by its number, or relative to the one shown."""

    epoch: int
    relative: bool = False


@dataclass(frozen=True)
class Exaggerate(Action):
    """Factor of displacements and ellipsoids; 0 makes the longest of them visible."""

    factor: float


@dataclass(frozen=True)
class DrawEllipsoids(Action):
    drawn: bool


@handles(ShowComparison)
def _show(state: State, action: ShowComparison) -> State:
    room = replace(state.room(Epochs), compared=action.compared, said=action.said)
    return state.with_room(replace(room, epoch=room.last))


@handles(GoToEpoch)
def _go(state: State, action: GoToEpoch) -> State:
    room = state.room(Epochs)
    epoch = min(max(action.epoch + (room.epoch if action.relative else 0), 0), room.last)
    return state if epoch == room.epoch else state.with_room(replace(room, epoch=epoch))


@handles(Exaggerate)
def _exaggerate(state: State, action: Exaggerate) -> State:
    factor = float(action.factor)
    if not 0 <= factor <= EXAGGERATIONS[-1]:
        return state
    return state.with_room(replace(state.room(Epochs), exaggeration=factor))


@handles(DrawEllipsoids)
def _draw_ellipsoids(state: State, action: DrawEllipsoids) -> State:
    return state.with_room(replace(state.room(Epochs), ellipsoids=bool(action.drawn)))


def reopened(state: State) -> Action:
    """The latest comparison of the project that is open, or why there is none."""
    folder = state.assets.folder
    try:
        found = None if folder is None else read_comparison(folder)
    except PhotogrammetryError as error:
        return ShowComparison(None, str(error))
    return ShowComparison(found, "" if found else "This project holds no comparison.")


def exaggeration(state: State) -> float:
    """The factor that is drawn: the one chosen, or one that makes the longest displacement of all epochs a sixth of the site."""
    room = state.room(Epochs)
    if room.exaggeration > 0 or room.compared is None:
        return room.exaggeration or 1.0
    longest = max((float(np.linalg.norm(m.d, axis=1).max(initial=0.0)) for m in room.compared.later), default=0.0)
    low, high = site(state)
    return min(nice(max(float((high - low).max()) / 6 / longest, 1.0)), EXAGGERATIONS[-1]) if longest > 0 else 1.0


def scene(state: State) -> Scene:
    """Points of the first epoch, displacement vectors of the epoch shown, ellipsoids at their ends, and a scale for both."""
    room, found = state.room(Epochs), Scene()
    if room.compared is None or not room.compared.places:
        return found
    names = tuple(room.compared.places)
    at = state.assets.frame.to_local(np.array([room.compared.places[n] for n in names]))
    size = symbol_size(state)
    found["/epochs/points"] = PointCloud(at, np.tile(np.array(theme.INITIAL, np.uint8), (len(at), 1)), 0.35 * size)
    shown = room.shown
    if shown is None:
        return found
    factor, place = exaggeration(state), {n: x for n, x in zip(names, at, strict=True)}
    start = np.array([place[n] for n in shown.names])
    end = start + factor * shown.d
    for path, which, colour, thick in (("moved", shown.moved, theme.RESIDUAL, 4.0), ("still", ~shown.moved, theme.CHECK, 1.5)):
        if which.any():
            found[f"/epochs/vectors/{path}"] = Segments(np.stack([start, end], axis=1)[which], colour, thick)
    if room.ellipsoids:
        for i in np.argsort(~shown.moved, kind="stable")[:MOST]:
            colour = theme.RESIDUAL if shown.moved[i] else theme.CHECK
            found[f"/epochs/ellipsoids/{shown.names[i].replace('/', '_')}"] = Ellipsoid(
                end[i], _rotation(shown.directions[i]), factor * shown.axes[i], colour, 0.3)
    for i in np.flatnonzero(shown.moved):
        words = f"{shown.names[i]}: {1e3 * float(np.linalg.norm(shown.d[i])):.1f} mm"
        found[f"/epochs/labels/{shown.names[i].replace('/', '_')}"] = Label(words, end[i] + np.array([0, 0, size]), 0.9)
    return found | _scale(at, factor, state)


def _rotation(directions: np.ndarray) -> np.ndarray:
    """(3, 3) axes as columns, right-handed."""
    axes = directions.T.copy()
    axes[:, 2] *= np.sign(np.linalg.det(axes)) or 1.0
    return axes


def _scale(at: np.ndarray, factor: float, state: State) -> Scene:
    """A bar below the points that is as long as a round number of millimetres of movement, and its words."""
    low, high = at.min(axis=0), at.max(axis=0)
    length = nice(max(float((high - low).max()) / 5 / factor, 1e-6))
    begin = np.array([low[0], low[1] - 0.08 * float((high - low)[:2].max()), low[2]])
    end = begin + np.array([factor * length, 0, 0])
    tick = np.array([0, 0.1 * factor * length, 0])
    bar = np.array([[begin, end], [begin - tick, begin + tick], [end - tick, end + tick]])
    words = f"{1e3 * length:g} mm of movement ({factor:g} times)"
    return {"/epochs/scale/bar": Segments(bar, theme.foreground(state.view.dark), 2.0),
            "/epochs/scale/label": Label(words, end + np.array([0.05 * factor * length, 0, 0]), 0.9, "center-left")}
