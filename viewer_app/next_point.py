"""From point to point while a photo is measured: which is next, and where the photo should show it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .acting import Action, handles, update
from .actions import ChoosePoint
from .photo_view import around, window
from .sighting import adjusted, sees, where
from .state import State, by_role


@dataclass(frozen=True)
class NextPoint(Action):
    """Choose the next control or check point that is not measured in the chosen photo; only points that it should show, where its
    orientation tells."""


def expected(state: State) -> tuple[float, float] | None:
    """Where the chosen photo should show the chosen point, col, row; None where it is measured or nobody knows."""
    if state.point is None or not state.block.images or sees(state, state.image, state.point) is not None:
        return None
    return where(state, state.image, state.point)


def missing(state: State) -> tuple[str, ...]:
    """Control and check points not measured in the chosen photo, from the one after the chosen point on."""
    points = state.block.points
    seen = set(state.block.observations.point[state.block.seen_in(state.image)].tolist())
    left = [j for j in by_role(points)["named"].tolist() if j not in seen]
    after = state.block.point_index(state.point) if state.point is not None else -1
    return tuple(points.names[j] for j in sorted(left, key=lambda j: (j <= after, j)))


@handles(NextPoint)
def _next(state: State, action: NextPoint) -> State:
    if not state.block.images:
        return state
    left = missing(state)
    shown = [name for name in left if where(state, state.image, name) is not None]
    if not shown and left and adjusted(state, state.image) is not None:
        return replace(state, message=f"Every control and check point that {state.image} should show is measured in it.")
    if not left:
        return replace(state, message=f"Every control and check point is measured in {state.image}.")
    state = update(state, ChoosePoint((shown or left)[0]))
    at = expected(state)
    ring = "" if at is None else "; the dashed ring is where it should be"
    said = f"{state.point}: click where you see it in {state.image}{ring}."
    shape = window(state)
    zoomed = at is not None and shape.width < state.block.camera_of(state.image).width
    return replace(around(state, *at, shape.width) if at is not None and zoomed else state, message=said)

