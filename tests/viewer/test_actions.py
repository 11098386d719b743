"""update(state, action): edits, undo and redo, stepping, measuring; nothing a browser can say breaks the state."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.adjustment import Trace, iterate
from solvers.orientation import Request, conclude, prepare
from tests.viewer.conftest import make_state
from viewer_app.actions import (
    Aim,
    Cancel,
    ChooseImage,
    ChoosePoint,
    Clicking,
    Failed,
    ForgetSpots,
    GoTo,
    Place,
    Play,
    Plot,
    Redo,
    Rows,
    Set,
    Show,
    Solve,
    Solved,
    Step,
    SwitchPoint,
    Tick,
    Undo,
    UseBox,
    UseOnly,
    UsePoints,
    update,
)
from viewer_app.state import ADVICE, Job, State, wanted


def solve_all(state: State, image: str | None = None) -> State:
    """The state once the solver answered everything that is wanted (of one image)."""
    for job in wanted(state):
        if job.model != ADVICE and image in (None, job.image):
            start = prepare(job.block, Request(job.image, job.model, job.points))  # type: ignore[arg-type]
            rows = tuple(iterate(start.problem, start.x0, start.options))
            orientation = conclude(start, Trace(rows, start.manifest))
            state = update(state, Solved(job, orientation.trace, orientation))
    return state


@pytest.fixture(scope="module")
def solved() -> State:
    return solve_all(make_state())


def test_everything_is_wanted_once_and_the_chosen_image_first(state: State) -> None:
    jobs = wanted(state)
    assert [(j.image, j.model) for j in jobs[:3]] == [
        (state.image, "perspective"),
        (state.image, "orthogonal"),
        (state.image, ADVICE),
    ]
    assert {j.image for j in jobs} == {"left", "right"}
    assert all(j.model == ADVICE for j in wanted(solve_all(state)))


def test_switching_a_point_is_an_edit_and_undo_brings_the_old_solution_back_unsolved(solved: State) -> None:
    off = update(solved, SwitchPoint("G02"))
    assert "G02" in off.work.off and "G02" not in off.control()
    assert "G02" not in wanted(off)[0].points and off.solution("perspective") is solved.solution("perspective")
    again = solve_all(off)
    assert again.solution("perspective") is not solved.solution("perspective")
    back = update(again, Undo())
    assert back.solution("perspective") is solved.solution("perspective")
    assert all(j.model == ADVICE for j in wanted(back))
    assert update(back, Redo()).solution("perspective") is again.solution("perspective")


def test_undo_goes_back_a_hundred_edits(state: State) -> None:
    names = state.block.points.names
    now = state
    for i in range(120):
        now = update(now, SwitchPoint(names[i % 16]))
    for _ in range(120):
        now = update(now, Undo())
    assert now.work is state.work and update(now, Undo()).message == "Nothing to undo."


def test_a_cluster_is_chosen_by_its_group(state: State) -> None:
    one = update(state, UsePoints("group B"))
    assert set(one.control()) == {"G05", "G07", "G08"}
    assert update(one, UsePoints("")).work.off == frozenset()
    assert update(state, UsePoints("no such group")) is state


def test_control_is_chosen_by_name(state: State) -> None:
    assert set(update(state, UseOnly(("G01", "G1*"))).control()) == {"G01", "G10", "G12", "G13", "G14", "G15"}
    nobody = update(state, UseOnly(("X?",)))
    assert nobody.work is state.work and "X?" in nobody.message
    assert update(state, UseOnly(())).message == "Name the control points to use, such as: G01, G1*."


def test_control_is_chosen_by_a_rectangle_on_the_photo(state: State) -> None:
    block = state.block
    rows = block.seen_in("left", ("control",))
    pixels, names = block.observations.pixel[rows], [block.points.names[j] for j in block.observations.point[rows]]
    low, high = np.median(pixels, axis=0), pixels.max(axis=0) + 1
    meant = {n for n, p in zip(names, pixels, strict=True) if (p >= low).all()}
    for corners in ((*low, *high), (*high, *low), (low[0], high[1], high[0], low[1])):
        assert set(update(state, UseBox(*corners)).control()) == meant and len(meant) > 1
    empty = update(state, UseBox(0.0, 0.0, 1.0, 1.0))
    assert empty.work is state.work and empty.message


def test_places_are_kept_within_the_photo_and_forgotten(state: State) -> None:
    one = update(update(state, Plot(100.0, 200.0)), Plot(-50.0, 3.0))
    assert len(one.spots) == 1 and update(one, ForgetSpots()).spots == ()
    assert update(state, Clicking("monoplot")).click == "monoplot" and update(state, Clicking("other")) is state


def test_late_rows_of_an_older_revision_are_dropped(solved: State) -> None:
    edited = update(solved, SwitchPoint("G02"))
    job = wanted(solve_all(make_state()))[0]
    old = Job("left", "perspective", solved.work.revision, solved.block, (), solved.work.settings)
    assert update(edited, Rows(old, ())) is edited
    assert job.model == ADVICE


def test_cancel_asks_for_nothing_until_the_next_edit(state: State) -> None:
    held = update(state, Cancel())
    assert wanted(held) == ()
    assert wanted(update(held, Solve())) and wanted(update(held, SwitchPoint("G02")))


def test_a_failure_is_one_sentence_and_is_not_tried_again(state: State) -> None:
    job = wanted(state)[0]
    failed = update(state, Failed(job, "too few points"))
    solution = failed.solution(job.model)
    assert solution and solution.error == "too few points"
    assert job.key not in [j.key for j in wanted(failed)]


def test_stepping(solved: State) -> None:
    assert solved.row == solved.last_row > 2
    first = update(solved, Step("first"))
    assert first.row == 0 and not first.follow
    assert update(first, Step("previous")).row == 0
    assert update(update(first, Step("next")), Step("next")).row == 2
    assert update(first, Step("last")).row == solved.last_row
    assert update(first, GoTo(10**6)).row == solved.last_row
    assert update(first, Step("sideways")) is first
    one, two = first.exterior("perspective"), solved.exterior("perspective")
    assert one and two and np.linalg.norm(one.centre - two.centre) > 1e-3


def test_play_runs_to_the_end_and_stops(solved: State) -> None:
    now = update(solved, Play())
    assert now.playing and now.row == 0
    for _ in range(solved.last_row + 1):
        now = update(now, Tick())
    assert now.row == solved.last_row and not now.playing
    assert update(now, Tick()) is now


def test_measuring_moves_an_observation_or_makes_one(solved: State) -> None:
    block = solved.block
    assert update(solved, Aim(10.0, 10.0)).message.startswith("Choose a point")
    chosen = update(solved, ChoosePoint("G03"))
    aimed = update(chosen, Aim(1234.25, 987.5))
    assert aimed.mark and aimed.block is block
    assert update(aimed, Aim(-3.0, 5.0)) is aimed  # outside the format
    placed = update(aimed, Place())
    i, j = block.image_index("left"), block.point_index("G03")
    of = placed.block.observations
    at = np.flatnonzero((of.image == i) & (of.point == j))
    assert np.allclose(of.pixel[at], [[1234.25, 987.5]]) and len(of) == len(block.observations) + (
        1 - len(np.flatnonzero((block.observations.image == i) & (block.observations.point == j)))
    )
    assert placed.mark is None and wanted(placed) and update(placed, Undo()).block is block


@pytest.mark.parametrize(
    "action",
    [
        ChooseImage("nobody"),
        ChoosePoint("nobody"),
        SwitchPoint("../../etc"),
        Set("prior", "guess"),
        Set("robust", "yes"),
        Set("points", ()),
        Show("vectors", float("nan")),
        Show("dark", 1),
        Show("no such", True),
        Set("image", "x"),
    ],
)
def test_nonsense_from_a_browser_changes_nothing(state: State, action: object) -> None:
    assert update(state, action) is state  # type: ignore[arg-type]


def test_exaggeration_is_kept_in_range(state: State) -> None:
    assert update(state, Show("vectors", -5)).view.vectors == 0.0 and update(state, Show("vectors", 1e12)).view.vectors == 1e5
