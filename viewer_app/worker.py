"""The other process: does one task after the other, says what each yields, stops between two yields when told to.

It ends by itself when the viewer does. What it prints goes to the viewer's terminal.
"""

from __future__ import annotations

import importlib
import logging
import os
import queue
import sys
import threading
from contextlib import suppress
from typing import Any, BinaryIO

from solvers import PhotogrammetryError, compiled

from .frames import Receiver, Sender

NICE = 10
"""How much the worker steps back behind the viewer and its page, which must answer at once while it computes."""


def main() -> None:
    """Serve the viewer at the other end of standard input and output."""
    with suppress(OSError, AttributeError):  # a system without niceness
        os.nice(NICE)
    source = sys.stdin.buffer
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # a library that prints must not speak between the messages
    Worker(source, out).serve()


class Worker:
    """messages in: ("do", number, task), task being call and arguments, packed, and ("stop", number); out: (kind, number, value).

    "compiling" says that from here to the task's next word nothing can stop it, and what for. One thread imports (a task's parts
    when it begins): two that meet in a package lock each other out.
    """

    def __init__(self, source: BinaryIO, out: BinaryIO) -> None:
        self._receiver, self._sender = Receiver(source), Sender(out)
        self._todo: queue.Queue[tuple[int, bytes]] = queue.Queue()
        self._stopped = self._number = -1
        threading.Thread(target=self._listen, daemon=True).start()

    def serve(self) -> None:
        for name in ("viewer_app.solving_work", "numba", "scipy.linalg", "scipy.special"):  # what the first task will want
            importlib.import_module(name)
        compiled.tell.append(lambda what: self._sender.send(("compiling", self._number, compiled.compiling(what))))
        self._sender.send(("ready", -1, None))
        while True:
            self._do(*self._todo.get())

    def _listen(self) -> None:
        while True:
            try:
                kind, number, *packed = self._receiver.receive()
            except (EOFError, OSError):
                os._exit(0)  # the viewer is gone
            except Exception:
                logging.getLogger("collinea").exception("a task did not arrive")
                os._exit(3)
            if kind == "stop":
                self._stopped = max(self._stopped, number)
            else:
                self._todo.put((number, *packed))

    def _do(self, number: int, packed: bytes) -> None:
        self._number = number
        call: Any = "that could not be read"
        try:
            call, arguments = self._receiver.unpack(packed)
            for value in call(*arguments):
                if number <= self._stopped:
                    break
                self._sender.send(("value", number, value))
            self._sender.send(("done", number, None))
        except PhotogrammetryError as error:
            self._sender.send(("failed", number, str(error)))
        except MemoryError:
            self._sender.send(("failed", number, "the memory is not enough; close other programs or work on fewer images"))
        except Exception as error:
            logging.getLogger("collinea").exception("task %s", getattr(call, "__name__", call))
            self._sender.send(("broken", number, f"{type(error).__name__}: {error}"))


if __name__ == "__main__":
    main()
