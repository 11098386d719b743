"""Mapping a function over items: here, in threads, in processes, or on dask.distributed; same code, same result."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

from .errors import Unsupported

Item = TypeVar("Item")
Value = TypeVar("Value")


@dataclass(frozen=True)
class Progress:
    """How far a stage of a long work is: done of total items, seconds spent and, by the rate so far, left."""

    stage: str
    done: int
    total: int
    seconds: float
    left: float


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def each(function: Callable[[Item], Value], items: Iterable[Item], workers: int = 1, scheduler: str | None = None,
         threads: bool = False) -> Iterator[tuple[int, Value]]:
    """(index, function(item)) of every item, in the order in which they are done.

    workers: 1 runs here; more run in as many processes (function and items must be picklable), or threads of this process,
    which share its memory (for functions that leave the interpreter's lock alone). scheduler: address of a
    dask.distributed scheduler ("tcp://host:8786"), whose workers are used instead. Items are taken as they are needed, so
    that a generator of large ones is never held as a whole. An exception of the function ends the mapping.
    Raises Unsupported when workers die, dask is not installed or its scheduler is not reached.
    """
    if scheduler is not None:
        yield from _on_dask(function, items, scheduler)
    elif workers > 1 and threads:
        yield from _in_threads(function, items, workers)
    elif workers > 1:
        yield from _in_processes(function, items, workers)
    else:
        for index, item in enumerate(items):
            yield index, function(item)


def timed(stage: str, results: Iterable[Value], total: int, report: Callable[[Progress], object] | None) -> Iterator[Value]:
    """The results, reporting progress after each of them."""
    start = time.monotonic()
    for done, result in enumerate(results, 1):
        yield result
        if report is not None:
            seconds = time.monotonic() - start
            report(Progress(stage, done, total, seconds, seconds * max(total - done, 0) / done))


def _in_threads(function: Callable[[Item], Value], items: Iterable[Item], workers: int) -> Iterator[tuple[int, Value]]:
    from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

    numbered = enumerate(items)
    pool = ThreadPoolExecutor(workers)
    running: dict[Future[Value], int] = {}
    try:
        while True:
            for index, item in itertools.islice(numbered, workers + 1 - len(running)):
                running[pool.submit(function, item)] = index
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _in_processes(function: Callable[[Item], Value], items: Iterable[Item], workers: int) -> Iterator[tuple[int, Value]]:
    import multiprocessing
    from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
    from concurrent.futures.process import BrokenProcessPool

    numbered = enumerate(items)
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), initializer=_one_thread)
    running: dict[Future[Value], int] = {}
    try:
        while True:
            for index, item in itertools.islice(numbered, 2 * workers - len(running)):
                running[pool.submit(function, item)] = index
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except BrokenProcessPool:
        raise Unsupported("a worker process was ended by the system, most likely for want of memory; give fewer workers or "
                          "smaller photos") from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _one_thread() -> None:
    """A worker leaves the other cores to the other workers."""
    import cv2

    cv2.setNumThreads(1)


def _on_dask(function: Callable[[Item], Value], items: Iterable[Item], scheduler: str) -> Iterator[tuple[int, Value]]:
    import importlib

    try:
        dask: Any = importlib.import_module("distributed")  # an optional extra
    except ImportError:
        raise Unsupported("work over several machines needs dask.distributed; install it with: pip install distributed") from None
    try:
        client = dask.Client(scheduler, timeout="10s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise Unsupported(f"scheduler {scheduler}: it is not reached ({error}); start it with: dask scheduler") from None
    with client:
        numbered, index_of = enumerate(items), {}
        done = dask.as_completed(loop=client.loop)
        limit = 2 * max(sum(client.nthreads().values()), 1)
        while True:
            for index, item in itertools.islice(numbered, limit - len(index_of)):
                future = client.submit(function, item, pure=False)
                index_of[future.key] = index
                done.add(future)
            if not index_of:
                return
            future = next(done)
            yield index_of.pop(future.key), future.result()
