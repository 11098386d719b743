"""A function that reports how far it is, as a task's generator: words, then its value."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

from solvers.execution import Progress


def followed(work: Callable[[Callable[[Progress], object]], Any], title: str) -> Iterator[Any]:
    """Words on the progress that a function reports, then its value; it ends at its next report when nobody asks any more."""
    said: queue.Queue[Any] = queue.Queue()
    stop = threading.Event()

    class Stopped(Exception):
        pass

    def report(at: Progress) -> None:
        if stop.is_set():
            raise Stopped
        said.put(f"{title}, {at.stage}: {at.done} of {at.total}, about {at.left:.0f} s left")

    def run() -> None:
        try:
            said.put(("done", work(report)))
        except BaseException as error:  # it crosses over to the caller's thread
            said.put(error)

    threading.Thread(target=run, daemon=True).start()
    try:
        yield f"{title}: preparing"
        while True:
            value = said.get()
            if isinstance(value, BaseException):
                raise value
            if isinstance(value, tuple):
                yield value[1]
                return
            yield value
    finally:
        stop.set()
