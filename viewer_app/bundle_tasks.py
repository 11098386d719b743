"""What the Bundle tab wants done now, pure."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from solvers import BadProject, Block

from .acting import Action
from .bundle_actions import BundleCame, BundleFailed
from .bundle_state import LEAST_SQUARES, Bundle, taking_part
from .bundle_work import adjusted_of, bundle_work, follow_work, keep_work
from .kept import by_identity
from .rerun_shown import bundle_shown
from .state import State
from .tasks import Task

if TYPE_CHECKING:
    from solvers.orientation import Adjusted


def tasks(state: State) -> tuple[Task, ...]:
    """The adjustment, or the run it is to leave."""
    room = state.room(Bundle)
    if not room.task or room.block is None:
        return ()
    block, options, serial = _without(room.block, room.asked[-1]), _options(room.asked, room.block), room.serial

    def came(value: Any) -> Action:
        return BundleCame(serial, value)

    def failed(why: str) -> Action:
        return BundleFailed(serial, why)

    if room.task == "keep" and state.assets.folder is not None:
        manifest = room.layout.manifest if room.layout is not None else {}
        arguments = (block, options, room.rows, state.assets.folder, manifest, bundle_shown(state))
        return (Task(("keep", serial), keep_work, arguments, came, failed, "writing the run", "bundle"),)
    if room.task == "follow":
        arguments = (block, state.assets.folder, state.assets.frame)
        return (Task(("follow", serial), follow_work, arguments, came, failed, "following the run", "bundle"),)
    begun = None
    if room.layout is not None and len(room.rows) == room.base + 1:  # it goes on from there
        begun = room.layout.manifest, room.rows[0].x, room.rows[-1].x
    wanted = block, options, state.assets.frame, begun, room.upto
    return (Task(("bundle", serial), bundle_work, wanted, came, failed, "the bundle", "bundle"),)


def _options(asked: tuple[Any, ...], block: Block) -> dict[str, Any]:
    model, transform, datum, free, loss, start, own, images, shutter, _ = asked
    return {"model": model, "transform": transform, "datum": datum, "free": free,
            "loss": None if loss == LEAST_SQUARES else loss, "start": start, "images": taking_part(block, images),
            "rolling_shutter": shutter, "per_image": bool(own) if set(own) == set(free) else own}


@by_identity(2)
def _without(block: Block, off: frozenset[str]) -> Block:
    """Control that is switched off only checks."""
    if not off:
        return block
    points = block.points
    roles = tuple("check" if n in off and r == "control" else r for n, r in zip(points.names, points.role, strict=True))
    return replace(block, points=replace(points, role=roles))


def adjusted_bundle(state: State) -> tuple[Block, Adjusted]:
    """The bundle's block and all that its last row says, worked out again here and now. Raises PhotogrammetryError."""
    room = state.room(Bundle)
    if room.block is None or room.layout is None or not room.rows:
        raise BadProject(f"{state.block.name}: there is no bundle yet; run it first")
    block = _without(room.block, room.asked[-1])
    return block, adjusted_of(block, _options(room.asked, room.block), room.rows, room.layout.manifest)
