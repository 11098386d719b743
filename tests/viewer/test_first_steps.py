"""What a project says that has no points, no marks, no solution yet: what to do, never an empty table; and warnings said once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import Observations, Points, Prior
from solvers.io import write_project
from solvers.orientation import Orientation
from viewer_app.actions import Say, Solved, UseOnly, update
from viewer_app.bridge import Wire
from viewer_app.bundle_actions import RunBundle
from viewer_app.bundle_state import Bundle
from viewer_app.loading import open_project
from viewer_app.panels.bundle_tables import summary
from viewer_app.panels.compare import solutions_table
from viewer_app.panels.tables import point_table, status, words
from viewer_app.solving import solve
from viewer_app.state import MODELS, State, wanted

WIRE = object.__new__(Wire)
WIRE.works = True


def without(state: State, points: bool) -> State:
    """Nothing is measured; points: and there is nothing to be measured."""
    none = Observations(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros(0))
    block = replace(state.block, observations=none)
    if points:
        block = replace(block, points=Points((), np.zeros((0, 3)), np.zeros((0, 3)), ()))
    return replace(state, work=replace(state.work, block=block))


@pytest.mark.parametrize("points", [False, True])
def test_a_bundle_of_nothing_says_at_once_what_to_do(state: State, points: bool) -> None:
    bare = without(state, points)
    assert "tab Matching" in summary(bare) and "choose, then Run bundle" in summary(state)
    asked = update(bare, RunBundle())
    assert not asked.room(Bundle).task and "find tie points in the tab Matching" in asked.room(Bundle).error


CASES = [("control", True, "control"), ("tie", True, "prior"), ("tie", False, "free")]


@pytest.mark.parametrize(("role", "placed", "datum"), CASES)
def test_the_datum_is_taken_from_what_the_project_has(tmp_path: Path, state: State, role: str, placed: bool, datum: str) -> None:
    block = state.block
    prior = Prior(np.array([500100.0, 5400200.0, 400.0]), None, np.full(3, 2.0)) if placed else None
    images = tuple(replace(i, prior=prior) for i in block.images)
    points = replace(block.points, role=(role,) * len(block.points))
    write_project(replace(block, images=images, points=points), tmp_path / "p")
    opened = open_project(tmp_path / "p")
    assert opened.room(Bundle).datum == datum


def test_why_a_bundle_failed_is_said_in_the_words_of_the_tab(state: State) -> None:
    failed = state.with_room(Bundle(error=f"{state.block.name}: nothing gives the datum; take --datum free"))
    assert "Nothing gives the datum; take datum free." in summary(failed)


def test_without_marks_or_control_every_tab_says_what_to_do(state: State) -> None:
    bare, empty = without(state, False), without(state, True)
    assert "mark at least three control points" in solutions_table(bare) and "this project has none" in solutions_table(empty)
    assert "N chooses a point" in words(bare) and "This project has no points" in words(empty)
    assert point_table(empty, WIRE) == "" and 'data-point="G01"' in point_table(bare, WIRE)


def test_what_both_models_are_warned_of_is_said_once_with_both_colours(state: State) -> None:
    for job in (j for j in wanted(state) if j.image == "left" and j.model in MODELS):
        *_, found = solve(job)
        assert isinstance(found, Orientation)
        own = f"{job.model} alone"
        state = update(state, Solved(job, found.trace, replace(found, warnings=("the control lies in a plane", own))))
    html = words(state)
    assert html.count("the control lies in a plane") == 1 and all(html.count(f"{m} alone") == 1 for m in MODELS)
    before = html[: html.index("the control lies in a plane")]
    assert before.count("background:#") == 2


def test_a_subset_says_how_many_are_left_and_the_way_back(state: State) -> None:
    chosen = update(state, UseOnly(("G01", "G02", "G03", "G04")))
    assert chosen.message == "4 of 13 control points are used now; Ctrl+Z takes that back."
    line = status(chosen)
    assert "Ctrl+Z takes that back." in line and "Solving left" in line


def test_what_is_said_over_the_tabs_moves_nothing_below(state: State) -> None:
    heights = {line.split("min-height:")[1].split(";")[0] for line in (status(state), status(update(state, Say("words"))))}
    assert len(heights) == 1
