"""Long work as values: what is to be called, and what its results mean."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from typing import Any

from .acting import Action


@dataclass(frozen=True, eq=False)
class Task:
    """One piece of long work, done in another process.

    key: the same work has the same key; while a key stays wanted its work is done once.
    call: a generator function of a module, called with `arguments`; both can be pickled. It yields what should be seen while it
    runs, the result last; between two yields it may be stopped. It runs in another process, one per lane.
    arrive: what a yielded value means; failed: what one sentence on why there is no result means.
    """

    key: Hashable
    call: Callable[..., Iterator[Any]]
    arguments: tuple[Any, ...]
    arrive: Callable[[Any], Action]
    failed: Callable[[str], Action]
    title: str = "the work"
    lane: str = "tab"
