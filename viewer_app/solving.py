"""What the solver is asked for one image and model, and what its answers mean."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import partial
from typing import Any

from solvers.adjustment import Iteration, Trace
from solvers.orientation import Advice, Orientation, Request

from .acting import Action
from .actions_solve import Advised, Failed, Rows, Solved
from .state import ADVICE, ONE_PASS, PRINTED, WITH_PRIOR, Job, State, wanted
from .tasks import Task

EVERY = 0.05
"""Seconds between two looks at a running adjustment."""
Answer = tuple[Iteration, ...] | Orientation | Advice
_last: list[Any] = []
"""The last start: its candidates serve the image's other models."""


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


def solve(job: Job) -> Iterator[Answer]:
    """The rows so far from time to time, then the orientation; or the advice."""
    from solvers.orientation import advise, conclude, prepare
    from solvers.orientation.single import rows

    if job.model == ADVICE:
        yield advise(job.block, job.image, job.points)
        return
    start = prepare(job.block, request(job), _last[0] if _last else None)
    _last[:] = [start]
    seen: list[Iteration] = []
    shown = time.monotonic()
    for row in rows(start):
        seen.append(row)
        if time.monotonic() - shown > EVERY:
            shown = time.monotonic()
            yield tuple(seen)
    yield conclude(start, Trace(tuple(seen), start.manifest))


def request(job: Job) -> Request:
    """What a job asks of the solver: by the settings, or, where the model takes the image's prior, by the model itself."""
    s, image, points = job.settings, job.image, job.points
    if job.model == ONE_PASS:
        return Request(image, "orthogonal", points, robust=s.robust, one_pass=True)
    if job.model == PRINTED:
        return Request(image, "orthogonal", points, robust=s.robust, one_pass=True, form="printed", recentre=False)
    if job.model == WITH_PRIOR:
        return Request(image, "perspective", points, robust=s.robust, prior="weighted")
    model: Any = job.model
    return Request(image, model, points, robust=s.robust, prior=s.prior, one_pass=s.one_pass, form=s.form, recentre=s.recentre)
