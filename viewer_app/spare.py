"""The process that will do the work, begun before everything else is loaded: by the time the page asks, it is ready."""

from __future__ import annotations

import subprocess
import sys

START = "import sys; sys.path[:] = {path!r}; from viewer_app.worker import main; main()"
_waiting: list[subprocess.Popen[bytes]] = []


def begin() -> subprocess.Popen[bytes]:
    """A process for tasks; it ends when its standard input does."""
    return subprocess.Popen([sys.executable, "-c", START.format(path=sys.path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def prepare() -> None:
    """Begin one for whoever takes it."""
    _waiting.append(begin())


def take() -> subprocess.Popen[bytes]:
    """The one that was prepared, or a new one."""
    return _waiting.pop() if _waiting else begin()
