"""Measuring on the chosen photo: the mark, observations, and places asked for their ground coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from solvers.block import Observations

from .acting import Action, edit, handles, undone
from .state import Mark, Spot, State

SPOTS = 50
"""Places kept at most."""


@dataclass(frozen=True)
class Clicking(Action):
    """What a click on the photo does: measure or monoplot."""

    what: str


@dataclass(frozen=True)
class Plot(Action):
    """Ask for the ground coordinates of a pixel of the chosen photo."""

    col: float
    row: float


@dataclass(frozen=True)
class ForgetSpots(Action):
    pass


@dataclass(frozen=True)
class Aim(Action):
    """Put the mark for a point on the chosen photo; point None keeps the one chosen."""

    col: float
    row: float
    point: str | None = None


@dataclass(frozen=True)
class Place(Action):
    """The mark becomes the observation."""


@dataclass(frozen=True)
class Unmark(Action):
    pass


@handles(Clicking)
def _clicking(state: State, action: Clicking) -> State:
    return replace(state, click=action.what, mark=None) if action.what in ("measure", "monoplot") else state


@handles(Plot, ForgetSpots)
def _plot(state: State, action: Plot | ForgetSpots) -> State:
    if isinstance(action, ForgetSpots):
        return replace(state, spots=())
    if not state.block.images or not bool(state.block.camera_of(state.image).inside(np.array([action.col, action.row]))):
        return state
    return replace(state, spots=(*state.spots, Spot(state.image, float(action.col), float(action.row)))[-SPOTS:], message="")


undone("spots", Plot, ForgetSpots, get=lambda state: state.spots, put=lambda state, spots: replace(state, spots=spots))


@handles(Aim, Place, Unmark)
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
    said = f"{state.mark.point} is measured in {state.image}; N chooses the next point."
    return replace(edit(state, block=_observed(state, state.mark)), mark=None, message=said)


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
