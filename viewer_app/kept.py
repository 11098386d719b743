"""Results kept by the identity of what they were made from: blocks and tables are frozen, so the same object means the same."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def by_identity(size: int) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """A decorator: the last `size` results are kept, found again when every argument is the very same object."""

    def wrap(function: Callable[P, R]) -> Callable[P, R]:
        found: OrderedDict[tuple[int, ...], tuple[Any, R]] = OrderedDict()

        @wraps(function)
        def inner(*args: P.args, **kwargs: P.kwargs) -> R:
            key = tuple(map(id, args))
            if key in found:
                found.move_to_end(key)
                return found[key][1]
            result = function(*args, **kwargs)
            found[key] = args, result  # the arguments are held, so that no other object takes their place
            while len(found) > size:
                found.popitem(last=False)
            return result

        return inner

    return wrap
