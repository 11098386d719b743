"""Long work off the page's thread: what it yields comes home as actions; cancel = stop asking."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager

from solvers import PhotogrammetryError

from .acting import Action
from .tasks import Task


class Jobs:
    """One worker that does what was last wanted, first things first."""

    def __init__(self, emit: Callable[[Action], None]) -> None:
        self._emit = emit
        self._wanted: tuple[Task, ...] = ()
        self._finished: set[Hashable] = set()
        self._change = threading.Condition()
        self._held = False
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="collinea-jobs", daemon=True)
        self._thread.start()

    def want(self, tasks: tuple[Task, ...]) -> None:
        """From now on only these; a running one that is not among them stops."""
        with self._change:
            self._wanted = tasks
            self._finished &= {task.key for task in tasks}
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

    def _still(self, task: Task) -> bool:
        with self._change:
            return any(t.key == task.key for t in self._wanted)

    def _next(self) -> Task | None:
        with self._change:
            while True:
                if self._closed:
                    return None
                for task in () if self._held else self._wanted:
                    if task.key not in self._finished:
                        return task
                self._change.wait()

    def _work(self) -> None:
        while (task := self._next()) is not None:
            try:
                for value in task.call(*task.arguments):
                    if not self._still(task):
                        break
                    self._emit(task.arrive(value))
                else:
                    self._finished.add(task.key)
                continue
            except PhotogrammetryError as error:
                done = task.failed(str(error))
            except Exception as error:
                logging.getLogger("collinea").exception("%s", task.title)
                done = task.failed(f"{task.title} stopped with {type(error).__name__}: {error}; see the terminal")
            self._finished.add(task.key)
            self._emit(done)
