"""The page while the solver works: it answers, cancels, and survives the solver's end. One server, one browser."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.viewer.sessions import Session, demo_session, settle
from viewer_app import solving
from viewer_app.actions import ChooseImage, ChoosePoint, SwitchPoint
from viewer_app.state import Job

pytestmark = [pytest.mark.browser, pytest.mark.timeout(200)]
honest = solving.solve


def busy(job: Job) -> Iterator[Any]:
    """Takes all of its processor and never looks up."""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        sum(i * i for i in range(100_000))
    yield ()


def deadly(job: Job) -> Iterator[Any]:
    if job.model == "perspective" and job.image == job.block.images[0].name:
        os.kill(os.getpid(), signal.SIGKILL)
    yield from honest(job)


def slow(job: Job) -> Iterator[Any]:
    """The solver with a pause after each row, all rows so far shown."""
    from solvers.orientation import conclude, prepare
    from solvers.orientation.single import rows

    if job.model not in ("perspective", "orthogonal"):
        yield from honest(job)
        return
    start, seen = prepare(job.block, solving.request(job)), []
    for row in rows(start):
        seen.append(row)
        yield tuple(seen)
        time.sleep(0.15)
    yield conclude(start, solving.Trace(tuple(seen), start.manifest))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Session]:
    with demo_session(tmp_path_factory.mktemp("work") / "demo", size=(1000, 600)) as made:
        yield made


@pytest.fixture
def solver(session: Session, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[Any], None]]:
    """Gives the viewer another solver, and the honest one back."""
    app, v = session
    yield lambda call: monkeypatch.setattr(solving, "solve", call)
    monkeypatch.undo()
    v.click_button("Undo")
    v.click_button("Solve again")
    settle(app, v)
    assert v.log.errors == [] and v.log.external == []
    assert all(s.orientation or s.advice for s in app.state.work.solutions.values())


def test_the_page_answers_within_100_ms_during_a_solve(session: Session, solver: Callable[[Any], None]) -> None:
    app, v = session
    solver(busy)
    app.emit(SwitchPoint(app.state.control()[0]))
    v.page.get_by_text("Solving ").first.wait_for()
    names, taken = app.state.block.points.names, []
    for name in names[1:9]:
        began = time.perf_counter()
        app.emit(ChoosePoint(name))
        while app.state.point != name or app._actions.unfinished_tasks:
            time.sleep(0.0005)
        taken.append(time.perf_counter() - began)
    assert sorted(taken)[1] < 0.1, taken  # a loaded machine may hold up some; benchmarks/viewer.py measures it
    v.wait_until(lambda: names[8] in v.page.get_by_label("Point", exact=True).input_value(), "the point in the page")


def test_cancel_takes_half_a_second_and_frees_the_processor(session: Session, solver: Callable[[Any], None]) -> None:
    app, v = session
    solver(busy)
    app.emit(SwitchPoint(app.state.control()[0]))
    v.page.get_by_text("Solving ").first.wait_for()
    before = app._jobs.processes()
    v.click_button("Cancel")
    v.wait_until(lambda: app.state.held is not None, "the click")
    began = time.perf_counter()
    v.wait_until(lambda: app._jobs.processes() != before, "the process to end")
    assert time.perf_counter() - began < 2.0  # benchmarks/viewer.py measures it on a quiet machine
    v.page.get_by_text("Cancelled").wait_for()
    assert app.settled()


def test_a_crash_is_one_sentence_and_the_viewer_lives_on(session: Session, solver: Callable[[Any], None]) -> None:
    app, v = session
    app.emit(ChooseImage(app.state.block.images[0].name))
    solver(deadly)
    app.emit(SwitchPoint(app.state.control()[0]))
    v.page.get_by_text("its process was ended by signal 9").first.wait_for()
    settle(app, v)
    solution = app.state.solution("orthogonal")
    assert app.server.get_clients() and solution and solution.orientation


def test_rows_arrive_while_an_adjustment_runs_and_the_scene_follows(session: Session, solver: Callable[[Any], None]) -> None:
    app, v = session
    solver(slow)
    app.emit(SwitchPoint(app.state.control()[0]))
    revision = app.state.work.revision

    def running() -> int:
        solution = app.state.solution("perspective")
        fresh = solution is not None and solution.revision > revision - 1 and not solution.done
        return len(solution.rows) if solution and fresh else 0

    v.wait_until(lambda: running() >= 2, "the first rows", 20)
    assert app.state.follow and app.state.row == app.state.last_row
    seen = running()
    v.wait_until(lambda: running() > seen or not running(), "more rows", 20)
