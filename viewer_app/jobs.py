"""Solver work off the GUI's thread: rows come home as actions; cancel = stop asking for the next row."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from solvers import PhotogrammetryError
from solvers.adjustment import Trace
from solvers.orientation import Request, advise, conclude, prepare
from solvers.orientation.single import Start, rows

from .actions import Action, Advised, Failed, Rows, Solved
from .state import ADVICE, ONE_PASS, PRINTED, WITH_PRIOR, Job

EVERY = 0.05
"""Seconds between two looks at a running adjustment."""


class Jobs:
    """One worker that does what was last wanted, first things first."""

    def __init__(self, emit: Callable[[Action], None]) -> None:
        self._emit = emit
        self._wanted: tuple[Job, ...] = ()
        self._finished: set[tuple[str, str, int]] = set()
        self._change = threading.Condition()
        self._held = False
        self._closed = False
        self._last: Start | None = None  # its candidates serve the image's other models
        self._thread = threading.Thread(target=self._work, name="collinea-jobs", daemon=True)
        self._thread.start()

    def want(self, jobs: tuple[Job, ...]) -> None:
        """From now on only these; a running one that is not among them stops at its next row."""
        with self._change:
            self._wanted = jobs
            self._finished &= {job.key for job in jobs}
            self._change.notify()

    @contextmanager
    def held(self) -> Iterator[None]:
        """No new job begins meanwhile: what is being painted has the processor to itself."""
        with self._change:
            self._held = True
        try:
            yield
        finally:
            with self._change:
                self._held = False
                self._change.notify()

    def close(self) -> None:
        with self._change:
            self._wanted, self._closed = (), True
            self._change.notify()
        self._thread.join(timeout=10)

    def _still(self, job: Job) -> bool:
        with self._change:
            return any(j.key == job.key for j in self._wanted)

    def _next(self) -> Job | None:
        with self._change:
            while True:
                if self._closed:
                    return None
                for job in () if self._held else self._wanted:
                    if job.key not in self._finished:
                        return job
                self._change.wait()

    def _work(self) -> None:
        while (job := self._next()) is not None:
            try:
                done = self._run(job)
            except PhotogrammetryError as error:
                done = Failed(job, str(error))
            except Exception as error:
                logging.getLogger("collinea").exception("%s %s", job.image, job.model)
                done = Failed(
                    job, f"{job.image}: the work on '{job.model}' stopped with {type(error).__name__}: {error}; see the terminal"
                )
            if done is not None:
                self._finished.add(job.key)
                self._emit(done)

    def _run(self, job: Job) -> Action | None:
        if job.model == ADVICE:
            return Advised(job, advise(job.block, job.image, job.points))
        start = self._last = prepare(job.block, request(job), self._last)
        seen, shown = [], time.monotonic()
        for row in rows(start):
            if not self._still(job):
                return None
            seen.append(row)
            if time.monotonic() - shown > EVERY:
                shown = time.monotonic()
                self._emit(Rows(job, tuple(seen)))
        orientation = conclude(start, Trace(tuple(seen), start.manifest))
        return Solved(job, orientation.trace, orientation)


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
    return Request(
        image, model, points, robust=s.robust, prior=s.prior, one_pass=s.one_pass, form=s.form, recentre=s.recentre
    )
