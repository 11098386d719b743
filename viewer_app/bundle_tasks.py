"""What the Bundle tab wants done now, pure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from solvers import Block

from .acting import Action
from .bundle_state import LEAST_SQUARES, Bundle, BundleCame, BundleFailed
from .bundle_work import bundle_work, keep_work
from .kept import by_identity
from .state import State
from .tasks import Task


def tasks(state: State) -> tuple[Task, ...]:
    """The adjustment, or the run it is to leave."""
    room = state.room(Bundle)
    if not room.task or room.block is None:
        return ()
    block, options, serial = _without(room.block, room.asked[-1]), _options(room.asked), room.serial

    def came(value: Any) -> Action:
        return BundleCame(serial, value)

    def failed(why: str) -> Action:
        return BundleFailed(serial, why)

    if room.task == "keep" and state.assets.folder is not None:
        arguments = (block, options, room.rows, state.assets.folder)
        return (Task(("keep", serial), keep_work, arguments, came, failed, "writing the run", "bundle"),)
    x0 = room.rows[room.base].x if room.base else None
    wanted = block, options, state.assets.frame, x0
    return (Task(("bundle", serial), bundle_work, wanted, came, failed, "the bundle", "bundle"),)


def _options(asked: tuple[Any, ...]) -> dict[str, Any]:
    model, transform, datum, free, loss, start, _ = asked
    return {"model": model, "transform": transform, "datum": datum, "free": free,
            "loss": None if loss == LEAST_SQUARES else loss, "start": start}


@by_identity(2)
def _without(block: Block, off: frozenset[str]) -> Block:
    """Control that is switched off only checks."""
    if not off:
        return block
    points = block.points
    roles = tuple("check" if n in off and r == "control" else r for n, r in zip(points.names, points.role, strict=True))
    return replace(block, points=replace(points, role=roles))
