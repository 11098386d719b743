"""What the solver is asked for one image and model, and what its answers mean."""

from __future__ import annotations

from functools import partial

from solvers.orientation import Advice, Orientation

from .acting import Action
from .actions_solve import Advised, Failed, Rows, Solved
from .solving_work import Answer, solve
from .state import Job, State, wanted
from .tasks import Task


def solving_tasks(state: State) -> tuple[Task, ...]:
    """Every orientation that is wanted."""
    return tuple(_task(job) for job in wanted(state))


def _task(job: Job) -> Task:
    title = f"{job.image}: the work on '{job.model}'"
    return Task(job.key, solve, (job,), partial(arrived, job), partial(Failed, job), title, "solve")


def arrived(job: Job, answer: Answer) -> Action:
    if isinstance(answer, Advice):
        return Advised(job, answer)
    if isinstance(answer, Orientation):
        return Solved(job, answer.trace, answer)
    return Rows(job, answer)
