"""How the state changes, pure: every action is a value, one function handles its type, and `update` finds that function.

A tab brings actions of its own: a frozen dataclass that is an `Action`, and a function marked with `handles`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from .state import HISTORY, MODELS, State, Work


class Action:
    """Something that can happen; its kinds are frozen dataclasses. A person did it, unless it is a `Report`."""


class Report(Action):
    """What work, the clock or the page itself tells, and nothing a person did to the project: what was said last stays."""


Handler = TypeVar("Handler", bound=Callable[[State, Any], State])
HANDLERS: dict[type[Action], Callable[[State, Any], State]] = {}


def handles(*kinds: type[Action]) -> Callable[[Handler], Handler]:
    """Marks the function (state, action) -> state that handles these kinds of actions; a kind has one handler."""

    def mark(handler: Handler) -> Handler:
        for kind in kinds:
            if HANDLERS.setdefault(kind, handler) is not handler:
                raise TypeError(f"{kind.__name__} is handled twice")
        return handler

    return mark


UNDONE: dict[type[Action], str] = {}
CHOICES: dict[str, tuple[Callable[[State], Any], Callable[[State, Any], State]]] = {}


def undone(name: str, *kinds: type[Action], get: Callable[[State], Any], put: Callable[[State, Any], State]) -> None:
    """From now on undo takes back what these kinds of actions change outside the work: a choice by a name of its own, that get
    reads (values that compare by ==) and put writes. Nothing is solved anew for it."""
    CHOICES[name] = get, put
    UNDONE.update(dict.fromkeys(kinds, name))


def update(state: State, action: Action) -> State:
    """The state after an action; the same state where the action means nothing (an unknown name, a value out of range).

    What was said before goes once a person does something, unless that says something itself.
    """
    handler = HANDLERS.get(type(action))
    if handler is None:
        raise TypeError(f"nothing handles {type(action).__name__}")
    silent = state if isinstance(action, Report) or not state.message else replace(state, message="")
    after, name = handler(silent, action), UNDONE.get(type(action))
    if after is silent:
        return state
    if name is None or (before := CHOICES[name][0](state)) == CHOICES[name][0](after):
        return after
    return replace(after, past=(*after.past, replace(state.work, aside=(name, before)))[-HISTORY:], future=())


def edit(state: State, *, solve: bool = True, **changes: Any) -> State:
    """A change of the work, remembered for undo. With `solve` everything is solved anew; old solutions show until the new come.

    Without it the solutions stay as they are.
    """
    if not solve:
        return replace(state, work=replace(state.work, **changes), past=_remember(state), future=(), message="")
    work = replace(state.work, revision=state.next_revision, **changes)
    return replace(
        state,
        work=work,
        next_revision=state.next_revision + 1,
        past=_remember(state),
        future=(),
        held=None,
        follow=True,
        message="",
    )


def edit_room(state: State, value: Any, *, solve: bool = False) -> State:
    """A change of a tab's own value that undo brings back; orientations are solved anew only where asked for."""
    return edit(state, solve=solve, rooms={**state.work.rooms, type(value): value})


def _remember(state: State) -> tuple[Work, ...]:
    return (*state.past, state.work)[-HISTORY:]


def travel(state: State, back: str, forth: str) -> State:
    """One step along the edits, from the stack `back` onto the stack `forth`."""
    stack: tuple[Work, ...] = getattr(state, back)
    if not stack:
        return replace(state, message="Nothing to undo." if back == "past" else "Nothing to redo.")
    other: tuple[Work, ...] = getattr(state, forth)
    changes: dict[str, Any]
    work = stack[-1]
    if work.aside is not None:
        name, value = work.aside
        get, put = CHOICES[name]
        changes = {back: stack[:-1], forth: (*other, replace(state.work, aside=(name, get(state))))}
        return replace(put(state, value), message="", **changes)
    if work.revision == state.work.revision:  # the same observations: what was solved since still holds
        work = replace(work, solutions=state.work.solutions)
    changes = {back: stack[:-1], forth: (*other, state.work)}
    return follow(replace(state, work=work, mark=None, held=None, message="", **changes))


def follow(state: State) -> State:
    """The row shown stays at the end where it was there, and within what there is."""
    if not state.follow and not all((s := state.solution(m)) and s.done for m in MODELS):
        return state  # more rows may come
    if not state.follow and any(getattr(room, "coming", False) for room in state.rooms.values()):
        return state  # a tab's too
    row = state.last_row if state.follow else min(state.row, state.last_row)
    return replace(state, row=row) if row != state.row else state


def at_row(state: State, row: int) -> State:
    """The row nearest to the one asked for is shown."""
    row = min(max(int(row), 0), state.last_row)
    return replace(state, row=row, follow=row == state.last_row)
