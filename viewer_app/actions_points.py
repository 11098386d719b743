"""Edits of object points: coordinates, standard errors, role. Every text comes from a browser and is checked here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from .acting import Action, edit, handles
from .state import State

FIELDS = ("X", "Y", "Z", "sX", "sY", "sZ")
"""Editable numbers of a point: map coordinates and their standard errors, metres."""
FARTHEST = 1e8
"""No coordinate on earth is larger, metres."""
FINEST = 1e-6
"""No standard error of a point is smaller, metres."""


@dataclass(frozen=True)
class Refused:
    """How many numbers were refused so far: whenever that changes the boxes are drawn anew, with what holds."""

    count: int = 0


@dataclass(frozen=True)
class EditPoint(Action):
    """One number of a point as somebody typed it; nothing typed as a standard error means the project's default."""

    point: str
    field: str
    text: str


@dataclass(frozen=True)
class SwitchRole(Action):
    """Control becomes check, check becomes control."""

    point: str


@handles(EditPoint)
def _edit_point(state: State, action: EditPoint) -> State:
    points = state.block.points
    if action.point not in points.names or action.field not in FIELDS:
        return state
    value = number(action.text)
    sigma = action.field.startswith("s")
    if not math.isfinite(value) and action.text.strip():
        return _refused(state, f"{action.point} {action.field}: '{action.text[:30]}' is not a number; write metres.")
    if math.isnan(value) and not sigma:
        return _refused(state, f"{action.point} {action.field}: a coordinate cannot be empty; write metres.")
    if (sigma and value < FINEST) or abs(value) > FARTHEST:
        wanted = "at least 1e-6 m and at most 1e8 m" if sigma else "a coordinate of at most 1e8 m"
        return _refused(state, f"{action.point} {action.field}: {value:g} does not do; write {wanted}.")
    j, axis = state.block.point_index(action.point), FIELDS.index(action.field) % 3
    old = points.sigma if sigma else points.xyz
    if old[j, axis] == value or (math.isnan(value) and math.isnan(old[j, axis])):
        return state
    new = old.copy()
    new[j, axis] = value
    changed = replace(points, sigma=new) if sigma else replace(points, xyz=new)
    return edit(replace(state, point=action.point), block=replace(state.block, points=changed))


def _refused(state: State, why: str) -> State:
    return replace(state.with_room(Refused(state.room(Refused).count + 1)), message=why)


@handles(SwitchRole)
def _switch_role(state: State, action: SwitchRole) -> State:
    points = state.block.points
    if action.point not in points.names:
        return state
    role = points.role[state.block.point_index(action.point)]
    other = {"control": "check", "check": "control"}.get(role)
    if other is None:
        return replace(state, message=f"{action.point} is a tie point; give it coordinates in points.csv to make it control.")
    return edit(replace(state, point=action.point), block=state.block.with_role(action.point, other))


def number(text: str) -> float:
    """The number a person wrote, with a point or a comma; NaN where it is none."""
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        return math.nan
