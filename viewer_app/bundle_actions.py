"""What can happen to the bundle of all images, and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from solvers.adjustment import Iteration
from solvers.cameras import PARAMETERS

from .acting import Action, Report, follow, handles, undone
from .bundle_state import Bundle, Held, allowed, asked_of, taking_part
from .bundle_values import Ended, Judged, Kept, Layout, stopped_at
from .state import State


@dataclass(frozen=True)
class SetBundle(Action):
    """One field of what to adjust or to draw."""

    name: str
    value: Any


@dataclass(frozen=True)
class FreeParameter(Action):
    """An interior parameter becomes free or fixed; "all" and "none" mean every one."""

    name: str
    free: bool = True


@dataclass(frozen=True)
class OfEveryImage(Action):
    """A free interior parameter is one of every image by itself, or one of the camera."""

    name: str
    own: bool = True


@dataclass(frozen=True)
class HoldBundle(Action):
    """Set the bundle aside, to see the next one beside it; without `on`, put away what is held."""

    on: bool = True


@dataclass(frozen=True)
class FollowBundle(Action):
    """Show the rows of the project's latest run while they are made, or as they were."""


@dataclass(frozen=True)
class RunBundle(Action):
    """Adjust; with `on` go on from the row shown. upto: row to stop at, None for the end."""

    on: bool = False
    upto: int | None = None


@dataclass(frozen=True)
class StopBundle(Action):
    """Stop; the rows so far stay."""


@dataclass(frozen=True)
class KeepBundle(Action):
    """Leave it in the project as a run, with its recording; open: show that in rerun."""

    open: bool = False


@dataclass(frozen=True, eq=False)
class BundleCame(Report):
    """Something of the run `serial`: words, how rows are read, a row, what the end is worth, or where it was kept."""

    serial: int
    what: str | Layout | Iteration | Judged | Kept | Ended


@dataclass(frozen=True)
class BundleFailed(Report):
    serial: int
    why: str


@handles(SetBundle)
def _set(state: State, action: SetBundle) -> State:
    room, name, value = state.room(Bundle), action.name, action.value
    if not allowed(name, value) or getattr(room, name) == value:
        return state
    return follow(state.with_room(replace(room, **{name: value})))


@handles(FreeParameter)
def _free(state: State, action: FreeParameter) -> State:
    room = state.room(Bundle)
    if action.name in ("all", "none"):
        free = PARAMETERS if action.name == "all" else ()
    elif action.name in PARAMETERS:
        free = tuple(p for p in PARAMETERS if (action.free if p == action.name else p in room.free))
    else:
        return state
    return state.with_room(replace(room, free=free)) if free != room.free else state


@handles(OfEveryImage)
def _of_every_image(state: State, action: OfEveryImage) -> State:
    room = state.room(Bundle)
    if action.name not in PARAMETERS:
        return state
    own = tuple(p for p in PARAMETERS if (action.own if p == action.name else p in room.per_image))
    free = tuple(p for p in PARAMETERS if p in room.free or p in own)
    return state.with_room(replace(room, per_image=own, free=free)) if (own, free) != (room.per_image, room.free) else state


NOTHING = "Nothing is measured yet: find tie points in the tab Matching, or mark points in the tab Photo; then run the bundle."
OPTIONS = ("model", "transform", "datum", "free", "loss", "start", "per_image", "images", "shutter")


def _options(state: State) -> tuple[Any, ...]:
    room = state.room(Bundle)
    return tuple(getattr(room, name) for name in OPTIONS)


def _with_options(state: State, values: tuple[Any, ...]) -> State:
    return follow(state.with_room(replace(state.room(Bundle), **dict(zip(OPTIONS, values, strict=True)))))


undone("bundle", SetBundle, FreeParameter, OfEveryImage, get=_options, put=_with_options)


@handles(HoldBundle)
def _hold(state: State, action: HoldBundle) -> State:
    room = state.room(Bundle)
    if not action.on:
        return state.with_room(replace(room, held=None)) if room.held else state
    if room.result is None or room.layout is None:
        return state.with_room(replace(room, error="There is no finished bundle to set aside; run one first."))
    held = Held(room.asked, room.layout, room.rows[-1], room.result, room.steps)
    return state.with_room(replace(room, held=held, error=""))


@handles(FollowBundle)
def _follow(state: State, action: FollowBundle) -> State:
    room = state.room(Bundle)
    if room.task:
        return state
    if state.assets.folder is None:
        return state.with_room(replace(room, error="This project has no folder, so no run to follow."))
    room = replace(room, base=0, rows=(), layout=None, block=state.block, asked=(*room.options, state.work.off), opened=0,
                   task="follow", serial=room.serial + 1, upto=None, result=None, error="", run="",
                   progress="Looking for a run …")
    return follow(replace(state, follow=True, playing=False).with_room(room))


@handles(RunBundle)
def _run(state: State, action: RunBundle) -> State:
    room = state.room(Bundle)
    if not len(state.block.observations):
        return state.with_room(replace(room, error=NOTHING))
    taken = taking_part(state.block, room.images)
    if taken is not None and len(taken) < 2 and not action.on:
        return state.with_room(replace(room, error=f"'{room.images.strip()}' means {len(taken)} image(s); a bundle takes two or "
                                       "more."))
    if not action.on:
        room = replace(room, base=0, rows=(), layout=None, block=state.block, asked=(*room.options, state.work.off), opened=0)
    elif not room.rows:
        return state.with_room(replace(room, error="There is no row to go on from; run the bundle first."))
    else:
        base = min(state.row, len(room.rows) - 1)
        room = replace(room, base=base, rows=room.rows[: base + 1])
    room = replace(room, task="run", serial=room.serial + 1, result=None, progress="Looking for a start …", error="", run="",
                   upto=action.upto)
    return follow(replace(state, follow=True, playing=False).with_room(room))


@handles(StopBundle)
def _stop(state: State, action: StopBundle) -> State:
    room = state.room(Bundle)
    if not room.task:
        return state
    said = stopped_at(room.steps) if room.rows else "Stopped before the first row."
    upto = room.steps if room.task == "run" and room.rows else room.upto
    return state.with_room(replace(room, task="", upto=upto, progress=said if room.task != "keep" else "", then_open=False))


@handles(KeepBundle)
def _keep(state: State, action: KeepBundle) -> State:
    room = state.room(Bundle)
    if room.task:
        return state
    if room.run:
        return state.with_room(replace(room, opened=room.opened + 1)) if action.open else state
    why = ("There is no bundle yet; run it first." if not room.rows else
           "This project has no folder to keep a run in; save it as a project first." if state.assets.folder is None else "")
    if why:
        return state.with_room(replace(room, error=why))
    said = "Writing the run …"
    return state.with_room(replace(room, task="keep", serial=room.serial + 1, progress=said, error="", then_open=action.open))


@handles(BundleCame)
def _came(state: State, action: BundleCame) -> State:
    room, what = state.room(Bundle), action.what
    if action.serial != room.serial or not room.task:
        return state
    if isinstance(what, str):
        room = replace(room, progress=what)
    elif isinstance(what, Layout):
        room = replace(room, layout=what)
        if room.task == "follow":  # it may begin anew
            room = replace(room, rows=(), asked=(*asked_of(what.manifest), state.work.off))
    elif isinstance(what, Iteration):
        if what.index == 0 and room.rows:
            return state  # it goes on from a row that is there already
        row = replace(what, index=room.base + what.index)
        room = replace(room, rows=(*room.rows, row), progress=f"Iteration {row.index}, σ0 {row.sigma0:.4g}")
    elif isinstance(what, Judged):
        room = replace(room, result=what, task="", upto=None, progress="")
    elif isinstance(what, Ended):
        room = replace(room, task="", progress=what.said)
    else:
        room = replace(room, run=what.run, worst=what.worst, task="", progress="", opened=room.opened + room.then_open,
                       then_open=False)
    return follow(state.with_room(room))


@handles(BundleFailed)
def _failed(state: State, action: BundleFailed) -> State:
    room = state.room(Bundle)
    if action.serial != room.serial:
        return state
    return state.with_room(replace(room, task="", progress="", error=action.why, then_open=False))
