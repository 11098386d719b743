"""Results kept by the identity of what they were made from: blocks and tables are frozen, so the same object means the same."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def by_identity(size: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator: the last `size` results are kept, found again when every argument is the very same object, or an equal word,
    number or bytes. From any thread."""

    def wrap(function: Callable[P, R]) -> Callable[P, R]:
        found: OrderedDict[tuple[Hashable, ...], tuple[Any, R]] = OrderedDict()
        lock = Lock()

        @wraps(function)
        def inner(*args: P.args, **kwargs: P.kwargs) -> R:
            given = (*args, *kwargs.items())
            key = tuple(map(_same, (*args, *kwargs.values()))) + tuple(kwargs)
            with lock:
                if key in found:
                    found.move_to_end(key)
                    return found[key][1]
            result = function(*args, **kwargs)
            with lock:
                found[key] = given, result  # the arguments are held, so that no other object takes their place
                while len(found) > size:
                    found.popitem(last=False)
            return result

        return inner

    return wrap


def _same(value: object) -> Hashable:
    """Equal for arguments that are the same."""
    return (type(value), value) if isinstance(value, str | bytes | int | float | bool | None) else id(value)
