"""Work in its own process: values come home in order, what is unwanted stops, a crash is a sentence and the next task works."""

from __future__ import annotations

import io
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from solvers import compiled
from solvers.errors import DegenerateGeometry
from tests.viewer.conftest import make_block, make_state
from viewer_app.acting import Action
from viewer_app.actions import Failed, Say, Solved, update
from viewer_app.frames import Receiver, Sender
from viewer_app.jobs import GRACE, Jobs
from viewer_app.solving import solving_tasks
from viewer_app.tasks import Task
from viewer_app.worker import NICE


@dataclass(frozen=True)
class Came(Action):
    value: Any


def count(n: int, pause: float = 0.0) -> Iterator[int]:
    for i in range(n):
        time.sleep(pause)
        yield i


def sleep(seconds: float) -> Iterator[str]:
    time.sleep(seconds)
    yield "slept"


def die() -> Iterator[int]:
    os.kill(os.getpid(), signal.SIGKILL)
    yield 1


def degenerate() -> Iterator[int]:
    raise DegenerateGeometry("control points 3, 5, 9 lie on one line")
    yield 1


class Reader:
    """Becomes the name of the thread that reads it."""

    def __reduce__(self) -> Any:
        return thread, ()


def thread() -> str:
    return threading.current_thread().name


def echo(value: Any) -> Iterator[Any]:
    yield value


def wrong() -> Iterator[float]:
    yield 1 / 0


def compiles(seconds: float) -> Iterator[int]:
    for tell in compiled.tell:
        tell("the kernels")
    time.sleep(seconds)
    yield 5


def noisy() -> Iterator[int]:
    print("a library speaks")
    os.write(1, b"and writes")
    yield 7


def task(key: str, call: Callable[..., Iterator[Any]], *arguments: Any, lane: str = "solve") -> Task:
    return Task(key, call, arguments, Came, Say, key, lane)


class Desk:
    """Jobs whose actions are kept."""

    def __init__(self) -> None:
        self.came: list[Action] = []
        self.jobs = Jobs(self.came.append)

    def wait(self, done: Callable[[], bool], seconds: float = 60.0) -> None:
        end = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < end, self.came
            time.sleep(0.005)

    def values(self) -> list[Any]:
        return [a.value for a in self.came if isinstance(a, Came)]

    def said(self) -> list[str]:
        return [a.message for a in self.came if isinstance(a, Say)]


@pytest.fixture(scope="module")
def shared() -> Iterator[Desk]:
    made = Desk()
    made.jobs.want((task("warm", count, 1),))
    made.wait(lambda: made.values() == [0])
    yield made
    made.jobs.close()


@pytest.fixture
def desk(shared: Desk) -> Desk:
    shared.jobs.want(())
    shared.came.clear()
    return shared


def test_values_come_home_in_order_and_a_finished_task_is_not_done_again(desk: Desk) -> None:
    tasks = (task("a", count, 5), task("b", count, 2))
    desk.jobs.want(tasks)
    desk.wait(lambda: len(desk.came) == 7)
    desk.jobs.want((*tasks, task("c", count, 1)))
    desk.wait(lambda: len(desk.came) == 8)
    assert desk.values() == [0, 1, 2, 3, 4, 0, 1, 0]


def test_the_solver_answers_for_every_image(desk: Desk) -> None:
    state = make_state()
    desk.jobs.want(solving_tasks(state))
    desk.wait(lambda: sum(isinstance(a, Solved | Failed) for a in desk.came) == 4)
    solved = [a for a in desk.came if isinstance(a, Solved)]
    assert len(solved) == 4 and all(a.orientation.trace.converged for a in solved)
    truth = state.assets.truth["left"]
    found = next(a.orientation for a in solved if a.job.image == "left" and a.job.model == "perspective")
    assert np.linalg.norm(found.exterior.centre - truth.shifted(-state.assets.frame.origin).centre) < 1.0


def test_what_is_unwanted_stops_whether_it_listens_or_not(desk: Desk) -> None:
    """How soon: benchmarks/viewer.py."""
    for call, arguments in ((count, (10**6, 0.001)), (sleep, (600.0,))):
        desk.came.clear()
        [lane] = desk.jobs._lanes.values()
        begun = lane._number
        desk.jobs.want((task("first", count, 1), task("long", call, *arguments)))
        desk.wait(lambda: len(desk.came) >= 1 and lane._number == begun + 2)  # noqa: B023
        [number] = desk.jobs.processes()
        desk.jobs.want((task("next", count, 1),))
        desk.wait(lambda: desk.values()[-1:] == [0] and len(desk.came) >= 2)
        if call is sleep:
            assert desk.jobs.processes() != (number,)  # it was ended
        assert not desk.said()


def test_what_compiles_says_so_and_is_not_ended_for_it_would_begin_anew(desk: Desk) -> None:
    desk.jobs.want((task("first use", compiles, 3 * GRACE),))
    desk.wait(lambda: bool(desk.said()))
    [number] = desk.jobs.processes()
    desk.jobs.want((task("next", count, 1),))
    desk.wait(lambda: desk.values() == [0])  # what was no longer wanted came to nothing
    assert [*desk.jobs.processes()] == [number]
    [words] = [a for a in desk.came if isinstance(a, Say) and a.message]
    assert words.message == "Compiling the kernels for this machine; once, it takes some seconds"
    assert Say("", instead=words.message) in desk.came
    state = update(make_state(), words)
    assert update(state, Say("", instead=words.message)).message == ""
    assert update(update(state, Say("another")), Say("", instead=words.message)).message == "another"


def test_cancel_ends_even_what_compiles(desk: Desk) -> None:
    desk.jobs.want((task("first use", compiles, 60.0),))
    desk.wait(lambda: bool(desk.said()))
    [number] = desk.jobs.processes()
    desk.jobs.want(())
    desk.wait(lambda: desk.jobs.processes() != (number,))
    assert desk.said()[1:] == [""]  # nor is it said any more


def test_a_crash_is_one_sentence_and_the_next_task_works(desk: Desk) -> None:
    desk.jobs.want((task("deadly", die), task("after", count, 2)))
    desk.wait(lambda: desk.values() == [0, 1])
    [sentence] = desk.said()
    assert sentence.startswith("deadly stopped: its process was ended by signal 9") and "\n" not in sentence


def test_a_process_ended_while_idle_is_replaced_without_a_word(desk: Desk) -> None:
    [number] = desk.jobs.processes()
    os.kill(number, signal.SIGKILL)
    desk.wait(lambda: desk.jobs.processes() != (number,))
    desk.jobs.want((task("after", count, 2),))
    desk.wait(lambda: desk.values() == [0, 1])
    assert not desk.said()


def test_errors_are_sentences(desk: Desk) -> None:
    desk.jobs.want((task("line", degenerate), task("zero", wrong), task("unsent", count, open(os.devnull))))
    desk.wait(lambda: len(desk.came) == 3)
    known, unknown, unsent = desk.said()
    assert known == "control points 3, 5, 9 lie on one line"
    assert unknown.startswith("zero stopped with ZeroDivisionError") and unsent.startswith("unsent could not be handed on")


def test_the_process_steps_back_behind_the_viewer(desk: Desk) -> None:
    [number] = desk.jobs.processes()
    desk.jobs.want((task("warm", count, 1),))
    desk.wait(lambda: desk.values() == [0])
    assert os.getpriority(os.PRIO_PROCESS, number) == min(os.getpriority(os.PRIO_PROCESS, 0) + NICE, 19)


def test_what_a_library_prints_does_no_harm(desk: Desk) -> None:
    desk.jobs.want((task("noise", noisy),))
    desk.wait(lambda: desk.values() == [7])


def test_a_task_is_read_by_the_thread_that_does_it(desk: Desk) -> None:
    """Reading imports, and two threads that import parts of one package may lock each other out."""
    desk.jobs.want((task("echo", echo, Reader()),))
    desk.wait(lambda: desk.values() == [threading.main_thread().name])


def test_a_long_task_of_a_tab_does_not_hold_up_the_solver(desk: Desk) -> None:
    desk.jobs.want((task("long", count, 10**6, 0.02, lane="tab"), task("quick", count, 3)))
    desk.wait(lambda: desk.values().count(2) >= 2)
    assert len(desk.jobs.processes()) == 2


def test_a_block_crosses_once() -> None:
    stream = io.BytesIO()
    sender, block = Sender(stream), make_block()[0]
    sizes = []
    for _ in range(2):
        sender.send(("do", block))
        sizes.append(stream.tell())
    assert sizes[1] - sizes[0] < 100 < sizes[0]
    for i in range(10):  # more blocks than are kept
        sender.send(make_block(i)[0])
    sender.send(block)
    stream.seek(0)
    receiver = Receiver(stream)
    one, two = receiver.receive()[1], receiver.receive()[1]
    assert one is two and np.array_equal(one.points.xyz, block.points.xyz)
    others = [receiver.receive() for _ in range(11)]
    assert np.array_equal(others[-1].observations.pixel, block.observations.pixel)
    with pytest.raises(EOFError):
        receiver.receive()
