"""Stepping through the rows of the chosen image's traces."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from .acting import Action, Report, at_row, handles
from .state import State

STEPS = ("first", "previous", "next", "last")


@dataclass(frozen=True)
class Step(Action):
    to: str


@dataclass(frozen=True)
class GoTo(Action):
    row: int


@dataclass(frozen=True)
class Play(Action):
    """Play becomes pause, pause becomes play (from the start when at the end)."""


@dataclass(frozen=True)
class Tick(Report):
    """The clock while playing."""


@dataclass(frozen=True)
class Speed(Action):
    rows_per_second: float


@handles(Step)
def _step(state: State, action: Step) -> State:
    targets = dict(zip(STEPS, (0, state.row - 1, state.row + 1, state.last_row), strict=True))
    return at_row(replace(state, playing=False), targets[action.to]) if action.to in targets else state


@handles(GoTo)
def _go_to(state: State, action: GoTo) -> State:
    return at_row(replace(state, playing=False), action.row)


@handles(Play)
def _play(state: State, action: Play) -> State:
    started = at_row(state, 0) if not state.playing and state.row >= state.last_row else state
    return replace(started, playing=not state.playing)


@handles(Tick)
def _tick(state: State, action: Tick) -> State:
    if not state.playing:
        return state
    return replace(state, playing=False) if state.row >= state.last_row else at_row(state, state.row + 1)


@handles(Speed)
def _speed(state: State, action: Speed) -> State:
    rows = action.rows_per_second
    return replace(state, speed=float(min(max(rows, 0.5), 20.0))) if math.isfinite(rows) else state
