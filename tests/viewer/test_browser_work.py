"""The page while the solver works: it answers, cancels, and survives the solver's end. One server, one browser."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from solvers.adjustment import Trace
from tests.viewer.sessions import Session, act, camera_path, demo_session, has_pose, settle
from viewer_app import solving
from viewer_app.actions import ChooseImage, ChoosePoint, Solve, SwitchPoint, Undo
from viewer_app.solving_work import request
from viewer_app.state import Job

pytestmark = [pytest.mark.browser, pytest.mark.timeout(200)]
honest = solving.solve


def busy(job: Job) -> Iterator[Any]:
    """Takes all of its processor and never looks up."""
    end = time.monotonic() + 300
    while time.monotonic() < end:
        sum(i * i for i in range(100_000))
    yield ()


def deadly(job: Job) -> Iterator[Any]:
    if job.model == "perspective" and job.image == job.block.images[0].name:
        os.kill(os.getpid(), signal.SIGKILL)
    yield from honest(job)


def patient(gate: Path, job: Job) -> Iterator[Any]:
    """The solver, which shows its perspective rows one by one, as many as the file says."""
    from solvers.orientation import conclude, prepare
    from solvers.orientation.single import rows

    if job.model != "perspective":
        yield from honest(job)
        return
    start, seen = prepare(job.block, request(job)), []
    for row in rows(start):
        seen.append(row)
        yield tuple(seen)
        while int(gate.read_text() or 0) <= len(seen):
            time.sleep(0.005)
    yield conclude(start, Trace(tuple(seen), start.manifest))


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
    act(app, v, Undo(), Solve())
    assert all(s.orientation or s.advice for s in app.state.work.solutions.values())


def test_the_page_answers_during_a_solve_without_waiting_for_it(
    session: Session, solver: Callable[[Any], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    app, v = session
    solver(busy)
    app.emit(SwitchPoint(app.state.control()[0]))
    v.page.get_by_text("Solving ").first.wait_for()
    monkeypatch.setattr("viewer_app.app.PATIENCE", 1000.0)  # with this, a picture that waited for the solver would never come
    busy_ones, names = app._jobs.processes(), app.state.block.points.names
    for name in names[1:9]:
        app.emit(ChoosePoint(name))
        v.wait_until(lambda name=name: app.state.point == name and not app._actions.unfinished_tasks, "the answer")
    v.wait_until(lambda: names[8] in v.page.get_by_label("Point", exact=True).input_value(), "the point in the page")
    assert app._jobs.processes() == busy_ones and not app.settled()  # it solved all the while


def test_cancel_frees_the_processor(session: Session, solver: Callable[[Any], None]) -> None:
    app, v = session
    solver(busy)
    app.emit(SwitchPoint(app.state.control()[0]))
    v.page.get_by_text("Solving ").first.wait_for()
    v.page.get_by_role("button", name="Cancel", exact=True).wait_for()
    before = app._jobs.processes()
    v.click_button("Cancel")
    v.wait_until(lambda: app.state.held is not None, "the click")
    v.wait_until(lambda: app._jobs.processes() != before, "the process to end")  # how soon: benchmarks/viewer.py
    v.page.get_by_text("Cancelled").wait_for()
    v.wait_until(app.settled, "nothing more to solve")


def test_a_crash_is_one_sentence_and_the_viewer_lives_on(session: Session, solver: Callable[[Any], None]) -> None:
    app, v = session
    act(app, v, ChooseImage(app.state.block.images[0].name))
    solver(deadly)
    app.emit(SwitchPoint(app.state.control()[0]))
    v.page.get_by_text("its process was ended by signal 9").first.wait_for()
    settle(app, v)
    solution = app.state.solution("orthogonal")
    assert app.server.get_clients() and solution and solution.orientation


def test_rows_arrive_while_an_adjustment_runs_and_the_scene_follows(
    session: Session, solver: Callable[[Any], None], tmp_path: Path
) -> None:
    app, v = session
    gate = tmp_path / "rows"
    gate.write_text("1")
    solver(partial(patient, gate))
    app.emit(SwitchPoint(app.state.control()[0]))
    for count in (1, 2, 3):
        gate.write_text(f"{count} ")

        def arrived(count: int = count) -> bool:
            solution = app.state.solution("perspective")
            return solution is not None and not solution.done and len(solution.rows) == count

        v.wait_until(arrived, f"row {count} of the running adjustment")
        v.wait_until(lambda: app.state.row == app.state.last_row and has_pose(app, v, camera_path(app)), "the scene to follow")
        assert app.state.follow and not app.settled()
    gate.write_text("1000")
    settle(app, v)
    solution = app.state.solution("perspective")
    assert solution and solution.done and len(solution.rows) > 3


def test_stop_keeps_the_last_row_and_what_came_is_stepped(
    session: Session, solver: Callable[[Any], None], tmp_path: Path
) -> None:
    app, v = session
    gate = tmp_path / "rows"
    gate.write_text("3")
    solver(partial(patient, gate))
    app.emit(SwitchPoint(app.state.control()[1]))

    def rows() -> int:
        solution = app.state.solution("perspective")
        return 0 if solution is None or solution.done or solution.revision != app.state.work.revision else len(solution.rows)

    v.wait_until(lambda: rows() == 3, "three rows")
    v.hotkey("Escape")
    v.wait_until(lambda: app.state.held is not None, "the key")
    settle(app, v)
    assert rows() == 3 and app.state.row == app.state.last_row
    v.wait_until(lambda: has_pose(app, v, camera_path(app)), "the scene in the last row")
    v.page.get_by_text("Cancelled").first.wait_for()
    v.hotkey("Home")
    v.wait_until(lambda: app.state.row == 0 and has_pose(app, v, camera_path(app)), "row 0")
    v.hotkey("End")
    v.wait_until(lambda: app.state.row == app.state.last_row and has_pose(app, v, camera_path(app)), "the last row")
    assert rows() == 3
