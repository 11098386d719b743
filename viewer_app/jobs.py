"""Long work in processes of its own: what it yields comes home as actions; cancel = stop asking, and a deaf one is ended."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from contextlib import suppress
from typing import Any

from . import spare
from .acting import Action
from .actions import Say
from .frames import Receiver, Sender
from .tasks import Task

GRACE = 0.25
"""How long a task that is wanted no more may take to reach its next yield, seconds; then its process is ended."""


class Jobs:
    """Lanes of work, each with its own process that does what was last wanted, first things first."""

    def __init__(self, emit: Callable[[Action], None]) -> None:
        self._emit = emit
        self._lanes = {"solve": Lane(emit)}

    def want(self, tasks: tuple[Task, ...]) -> None:
        """From now on only these; a running one that is not among them stops."""
        for name in {task.lane for task in tasks} - set(self._lanes):
            self._lanes[name] = Lane(self._emit)
        for name, lane in self._lanes.items():
            lane.want(tuple(task for task in tasks if task.lane == name))

    def processes(self) -> tuple[int, ...]:
        """Their process numbers, for whoever wants to look at them."""
        return tuple(lane.pid for lane in self._lanes.values())

    def close(self) -> None:
        for lane in self._lanes.values():
            lane.leave()
        for lane in self._lanes.values():
            lane.close()


class Lane:
    """One process and the thread that speaks with it."""

    def __init__(self, emit: Callable[[Action], None]) -> None:
        self._emit = emit
        self._wanted: tuple[Task, ...] = ()
        self._finished: set[Hashable] = set()
        self._change = threading.Condition()
        self._inbox: deque[tuple[int, str, int, Any]] = deque()  # (generation, kind, number, value)
        self._generation = self._number = 0
        self._closed = False
        self._start()
        self._thread = threading.Thread(target=self._work, name="collinea-jobs", daemon=True)
        self._thread.start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def want(self, tasks: tuple[Task, ...]) -> None:
        with self._change:
            self._wanted = tasks
            self._finished &= {task.key for task in tasks}
            self._change.notify_all()

    def leave(self) -> None:
        """Stop soon, without waiting for it."""
        with self._change:
            self._wanted, self._closed = (), True
            self._change.notify_all()

    def close(self) -> None:
        self.leave()
        self._thread.join(timeout=10)
        self._end()

    # -- the process

    def _start(self) -> None:
        self._generation += 1
        self._process = spare.take()
        streams: Any = self._process
        self._sender, receiver = Sender(streams.stdin), Receiver(streams.stdout)
        arguments = (receiver, self._generation)
        threading.Thread(target=self._read, args=arguments, name="collinea-answers", daemon=True).start()

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            with suppress(OSError, ValueError):
                stream.close()  # type: ignore[union-attr]

    def _read(self, receiver: Receiver, generation: int) -> None:
        kind = ""
        while kind != "gone":
            try:
                kind, number, value = receiver.receive()
            except Exception:  # closed, ended, or damaged: the process is of no use any more
                kind, number, value = "gone", -1, None
            with self._change:
                self._inbox.append((generation, kind, number, value))
                self._change.notify_all()

    # -- one task after the other

    def _work(self) -> None:
        while (task := self._next()) is not None:
            self._number += 1
            try:
                self._sender.send(("do", self._number, self._sender.pack((task.call, task.arguments))))
            except OSError:  # ended while it had nothing to do
                self._end()
                self._start()
                continue
            except Exception as error:
                logging.getLogger("collinea").exception("%s", task.title)
                self._finish(task, task.failed(f"{task.title} could not be handed on ({type(error).__name__}: {error})"))
                continue
            self._follow(task)

    def _next(self) -> Task | None:
        with self._change:
            while not self._closed:
                gone = any(kind == "gone" and generation == self._generation for generation, kind, _, _ in self._inbox)
                self._inbox.clear()
                if gone:
                    self._end()
                    self._start()
                for task in self._wanted:
                    if task.key not in self._finished:
                        return task
                self._change.wait()
        return None

    def _follow(self, task: Task) -> None:
        """Until the task is done, failed, stopped or gone with its process. One that compiles is let finish that where something
        else is wanted, which would begin it anew; where nothing is, as after Cancel, it is ended all the same."""
        told: float | None = None
        busy = ""
        while True:
            with self._change:
                while not self._inbox:
                    if told is None and not any(t.key == task.key for t in self._wanted):
                        told = time.monotonic()
                        with suppress(OSError):
                            self._sender.send(("stop", self._number))
                    if told is not None and time.monotonic() - told > GRACE and not (busy and self._wanted):
                        break
                    self._change.wait(None if told is None else 0.02)
                deaf: tuple[int, str, int, Any] = self._generation, "deaf", self._number, ""
                generation, kind, number, value = self._inbox.popleft() if self._inbox else deaf
                still = any(t.key == task.key for t in self._wanted)
            if generation != self._generation or (number != self._number and kind != "gone"):
                continue
            if busy:
                self._emit(Say("", instead=busy))
                busy = ""
            if kind == "deaf":
                self._end()
                self._start()
                return
            if kind == "compiling":
                busy = value[:1].upper() + value[1:]
                self._emit(Say(busy))
            elif kind == "value":
                if still:
                    self._emit(task.arrive(value))
            elif kind == "gone":
                self._crashed(task)
                return
            else:
                if kind == "done":
                    if told is None:
                        self._finish(task)
                elif still:
                    why = value if kind == "failed" else f"{task.title} stopped with {value}; see the terminal"
                    self._finish(task, task.failed(why))
                return

    def _finish(self, task: Task, action: Action | None = None) -> None:
        with self._change:
            self._finished.add(task.key)
        if action is not None:
            self._emit(action)

    def _crashed(self, task: Task) -> None:
        self._process.wait()
        code = self._process.returncode
        how = f"by signal {-code}" if code < 0 else f"with code {code}"
        self._end()
        self._start()
        why = f"{task.title} stopped: its process was ended {how}; change something or press Solve again"
        self._finish(task, task.failed(why))
