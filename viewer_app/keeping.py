"""The session beside the project: written shortly after something changed, read when the project is opened again."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable
from pathlib import Path

from solvers import Block
from solvers.io.files import write_atomic

from .session import from_json, to_json
from .state import State

NAME = "viewer.json"
SOON = 0.7
"""Seconds without a change after which the session is written."""
LARGEST = 64 * 2**20
"""Bytes read at most."""


def resume(state: State) -> State:
    """The state as the project's last session left it; as opened where there was none."""
    path = None if state.assets.folder is None else state.assets.folder / NAME
    try:
        if path is None or not path.is_file() or path.stat().st_size > LARGEST:
            return state
        said = json.loads(path.read_text(encoding="utf-8"))
        json.dumps(said, ensure_ascii=False).encode()  # half a character could not be shown: no browser could open the project
    except (OSError, ValueError, RecursionError):
        return state
    return from_json(state, said)


class Keeper:
    """Writes the session of `state()` when `changed` was called and nothing happened for a moment; at the end at once."""

    def __init__(self, folder: Path | None, disk: Block, state: Callable[[], State]) -> None:
        self.disk = disk
        self._path, self._state = None if folder is None else folder / NAME, state
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()

    def changed(self) -> None:
        if self._path is None:
            return
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._timer = threading.Timer(SOON, self.write)
            self._timer.daemon = True
            self._timer.start()

    def write(self) -> None:
        """Now. A folder that cannot be written keeps no session."""
        if self._path is None:
            return
        text = json.dumps(to_json(self._state(), self.disk), ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        with self._lock, contextlib.suppress(OSError):
            write_atomic(self._path, lambda stream: stream.write(text.encode("utf-8")))

    def close(self) -> None:
        with self._lock:
            timer, self._timer = self._timer, None
        if timer is not None:
            timer.cancel()
            self.write()
