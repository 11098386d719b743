"""Compiled kernels are loaded at first use; the first time ever they are compiled, and a person is told why it takes a while."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType


def _print(what: str) -> None:
    print(f"collinea: {compiling(what)}", file=sys.stderr)


tell: list[Callable[[str], None]] = [_print]
"""Who is told what is compiled: the terminal, and in a process that works for a viewer, its page too."""


def compiling(what: str) -> str:
    """The words for a person who waits."""
    return f"compiling {what} for this machine; once, it takes some seconds"


def kernels(module: str, what: str) -> ModuleType:
    """A module of numba kernels, by its absolute name; says a word (`tell`) when it was never compiled here."""
    if module not in sys.modules:
        spec = find_spec(module)
        assert spec is not None and spec.origin is not None, module
        source = Path(spec.origin)
        if not any((source.parent / "__pycache__").glob(f"{source.stem}.*.nbi")):
            for each in tell:
                each(what)
    return import_module(module)
