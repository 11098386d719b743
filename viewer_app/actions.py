"""What can happen, as values, and what follows from it: update(state, action) -> state, pure.

Here: what is chosen, which points are used, settings, what is shown, undo. Stepping, solving and measuring have own files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from solvers import Block
from solvers.geometry import Surface

from .acting import Action, Report, edit, follow, handles, travel, update
from .actions_measure import SPOTS, Aim, Clicking, ForgetSpots, Place, Plot, Unmark
from .actions_solve import Advised, Cancel, Failed, Rows, Solve, Solved
from .actions_trace import STEPS, GoTo, Play, Speed, Step, Tick
from .state import FORMS, PRIORS, Photo, Settings, State, Terrain, View

__all__ = [
    "SPOTS",
    "STEPS",
    "Action",
    "Advised",
    "Aim",
    "Brought",
    "Cancel",
    "ChooseImage",
    "ChoosePoint",
    "Clicking",
    "Failed",
    "ForgetSpots",
    "GoTo",
    "Place",
    "Play",
    "Plot",
    "Redo",
    "Rows",
    "Saved",
    "Say",
    "Set",
    "Show",
    "Solve",
    "Solved",
    "Speed",
    "Step",
    "SwitchPoint",
    "Tick",
    "Undo",
    "Unmark",
    "UseBox",
    "UseOnly",
    "UsePoints",
    "update",
]


@dataclass(frozen=True)
class ChooseImage(Action):
    image: str


@dataclass(frozen=True)
class ChoosePoint(Action):
    point: str | None


@dataclass(frozen=True)
class SwitchPoint(Action):
    """On becomes off, off becomes on."""

    point: str


@dataclass(frozen=True)
class UsePoints(Action):
    """Only the points of one group, or with "" all of them."""

    group: str


@dataclass(frozen=True)
class UseOnly(Action):
    """Only the control points of these names; * and ? stand for any letters, any letter."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class UseBox(Action):
    """Only the control points seen within a rectangle of the chosen photo, corners in pixels."""

    left: float
    top: float
    right: float
    bottom: float


@dataclass(frozen=True)
class Set(Action):
    """One field of Settings."""

    name: str
    value: Any


@dataclass(frozen=True)
class Show(Action):
    """One field of View."""

    name: str
    value: Any


@dataclass(frozen=True)
class Undo(Action):
    pass


@dataclass(frozen=True)
class Redo(Action):
    pass


@dataclass(frozen=True)
class Say(Report):
    """instead: the words these replace; where others were said since, they stay."""

    message: str
    instead: str | None = None


@dataclass(frozen=True, eq=False)
class Saved(Report):
    """The block was written to the project's files."""

    block: Block
    where: str


@dataclass(frozen=True, eq=False)
class Brought(Report):
    """A photo, the terrain or the heights of the project's surface have been read."""

    what: Terrain | Photo | Surface
    image: str = ""


@handles(ChooseImage)
def _choose_image(state: State, action: ChooseImage) -> State:
    known = any(i.name == action.image for i in state.block.images)
    return follow(replace(state, image=action.image, mark=None)) if known and action.image != state.image else state


@handles(ChoosePoint)
def _choose_point(state: State, action: ChoosePoint) -> State:
    known = action.point is None or action.point in state.block.points.names
    return replace(state, point=action.point, mark=None) if known else state


@handles(SwitchPoint)
def _switch(state: State, action: SwitchPoint) -> State:
    if action.point not in state.block.points.names:
        return state
    return edit(replace(state, point=action.point), off=state.work.off ^ {action.point})


@handles(UsePoints)
def _use(state: State, action: UsePoints) -> State:
    points, group = state.block.points, action.group
    if group and group not in points.group:
        return state
    off = frozenset(n for n, g in zip(points.names, points.group, strict=True) if g != group) if group else frozenset()
    return edit(state, off=off) if off != state.work.off else state


@handles(UseOnly, UseBox)
def _only(state: State, action: UseOnly | UseBox) -> State:
    """Only the control points that are meant; where there are none, a sentence instead."""
    block, points = state.block, state.block.points
    control = {n for n, r in zip(points.names, points.role, strict=True) if r == "control"}
    if isinstance(action, UseOnly):
        meant = {n for n in control if any(fnmatchcase(n, pattern) for pattern in action.names)}
        why = f"No control point is called {', '.join(action.names)}; write names such as G01, G1*."
        why = why if action.names else "Name the control points to use, such as: G01, G1*."
    else:
        of, rows = block.observations, block.seen_in(state.image, ("control",)) if block.images else np.zeros(0, int)
        low, high = np.sort([[action.left, action.top], [action.right, action.bottom]], axis=0)
        within = rows[((of.pixel[rows] >= low) & (of.pixel[rows] <= high)).all(axis=1)]
        meant, why = {points.names[j] for j in of.point[within]}, "No control point was measured within this rectangle."
    if not meant:
        return replace(state, message=why)
    off = frozenset(control - meant)
    said = f"{len(meant)} of {len(control)} control points are used now; Ctrl+Z takes that back."
    return replace(edit(state, off=off), message=said) if off != state.work.off else state


@handles(Set)
def _set(state: State, action: Set) -> State:
    settings = _settings(state.work.settings, action.name, action.value)
    return edit(state, settings=settings) if settings != state.work.settings else state


@handles(Show)
def _show(state: State, action: Show) -> State:
    view = _view(state.view, action.name, action.value)
    return replace(state, view=view) if view != state.view else state


@handles(Undo, Redo)
def _travel(state: State, action: Undo | Redo) -> State:
    return travel(state, "past", "future") if isinstance(action, Undo) else travel(state, "future", "past")


@handles(Say)
def _say(state: State, action: Say) -> State:
    return replace(state, message=action.message) if action.instead in (None, state.message) else state


@handles(Saved)
def _saved(state: State, action: Saved) -> State:
    return replace(state, saved=action.block, message=f"Saved in {action.where}.")


@handles(Brought)
def _brought(state: State, action: Brought) -> State:
    assets, what = state.assets, action.what
    if isinstance(what, Photo):
        return replace(state, assets=replace(assets, photos={**assets.photos, action.image: what}))
    read = {"terrain": what} if isinstance(what, Terrain) else {"surface": what}
    return replace(state, assets=replace(assets, **read))


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
