"""The solver's work for one image and model, done in another process."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from solvers.adjustment import Iteration, Trace
from solvers.orientation import Advice, Orientation, Request, advise, conclude, prepare
from solvers.orientation.single import rows

from .state import ADVICE, ONE_PASS, PRINTED, WITH_PRIOR, Job

EVERY = 0.05
"""Seconds between two looks at a running adjustment."""
Answer = tuple[Iteration, ...] | Orientation | Advice
_last: list[Any] = []
"""The last start: its candidates serve the image's other models."""


def solve(job: Job) -> Iterator[Answer]:
    """The rows so far from time to time, then the orientation; or the advice."""
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
