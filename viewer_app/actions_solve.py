"""Solving: asking for it, stopping it, and what comes home from the solver."""

from __future__ import annotations

from dataclasses import dataclass, replace

from solvers.adjustment import Iteration, Trace
from solvers.orientation import Advice, Orientation

from .acting import Action, Report, follow, handles
from .scene import ellipsoid_scale
from .state import MODELS, Job, Solution, State


@dataclass(frozen=True)
class Solve(Action):
    pass


@dataclass(frozen=True)
class Cancel(Action):
    pass


@dataclass(frozen=True, eq=False)
class Rows(Report):
    """Rows of a running adjustment."""

    job: Job
    rows: tuple[Iteration, ...]


@dataclass(frozen=True, eq=False)
class Solved(Report):
    job: Job
    trace: Trace
    orientation: Orientation


@dataclass(frozen=True, eq=False)
class Advised(Report):
    job: Job
    advice: Advice


@dataclass(frozen=True, eq=False)
class Failed(Report):
    job: Job
    why: str


@handles(Solve)
def _solve(state: State, action: Solve) -> State:
    fresh = replace(state.work, revision=state.next_revision)
    return replace(state, work=fresh, next_revision=state.next_revision + 1, held=None, follow=True, message="")


@handles(Cancel)
def _cancel(state: State, action: Cancel) -> State:
    return replace(state, held=state.work.revision, message="Cancelled; Solve again continues from the start.")


@handles(Rows, Solved, Advised, Failed)
def _arrive(state: State, action: Rows | Solved | Advised | Failed) -> State:
    """Results of a job that is still wanted; late ones of an older revision are dropped."""
    job = action.job
    if job.revision != state.work.revision:
        return state
    match action:
        case Rows(_, rows):
            solution = Solution(job.revision, rows)
        case Solved(_, trace, orientation):
            solution = Solution(job.revision, trace.rows, trace.manifest, orientation)
        case Advised(_, advice):
            solution = Solution(job.revision, advice=advice)
        case Failed(_, why):
            solution = Solution(job.revision, error=why)
    solutions = {**state.work.solutions, (job.image, job.model): solution}
    state = replace(state, work=replace(state.work, solutions=solutions))
    if solution.orientation is not None and job.model in MODELS and state.view.ellipsoid == 0:
        state = replace(state, view=replace(state.view, ellipsoid=ellipsoid_scale(state, solution.orientation)))
    return follow(state)
