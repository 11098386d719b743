"""A match to be looked at says the same as the match: peak, place, and a difference that melts away."""

import numpy as np
import pytest

from solvers.adjustment import solve
from solvers.matching import GAUSS_NEWTON, Status, lsm_problem, match_lsm, match_ncc, match_stepped, prepare

from .test_lsm import SHAPE, pair
from .test_problem import check_design


def test_it_agrees_with_the_batch_at_every_stage():
    left, right, at, truth = pair(21, noise=1.0)
    left, right = prepare(left), prepare(right)
    between = np.array([0.37, -0.28])  # points are as good between the pixels
    at, truth = at + between, truth + SHAPE @ between
    for i in range(0, len(at), 20):
        start = truth[i] + [3.3, -2.6]
        seen = match_stepped(left, right, at[i], start, search=8)
        ncc = match_ncc(left, right, at[i:i + 1], start[None], search=8, uniqueness=2.0)
        lsm = match_lsm(left, right, at[i:i + 1], start[None], search=8)
        assert np.abs(seen.lsm.pixel - lsm.pixel).max() < 1e-6 and np.abs(seen.lsm.sigma - lsm.sigma).max() < 1e-6
        assert seen.ncc.score == pytest.approx(ncc.score)
        peak = np.array(np.unravel_index(np.nanargmax(seen.surface), seen.surface.shape))[::-1] - 8 + seen.middle
        assert np.abs(peak - ncc.pixel[0]).max() <= 0.5 + 1e-9
        assert np.nanmax(seen.surface) == pytest.approx(ncc.score[0], abs=2e-5)
        assert seen.status == Status.OK
        last = seen.rows[-1]
        assert np.abs(last.x[[0, 3]] - lsm.pixel[0]).max() < 1e-5  # the same iterations, row for row
        assert (last.stop, last.index) == ("step", lsm.iterations[0])
        first, last = seen.patches(0), seen.patches(99)
        assert first is not None and last is not None
        assert last.score >= first.score and last.score == pytest.approx(lsm.score[0], abs=2e-3)
        assert np.std(last.difference) <= np.std(first.difference) + 1e-9


def test_what_is_not_found_is_shown_too():
    left, right, at, _ = pair(22)
    seen = match_stepped(left, np.full_like(right, 90.0), at[0], at[0], search=5)
    assert seen.status == Status.NO_TEXTURE and seen.rows == () and seen.patches(0) is None
    assert np.isnan(seen.surface).all()
    outside = match_stepped(left, right, np.array([2.0, 2.0]), at[0], search=5)
    assert outside.status == Status.OUTSIDE and outside.problem is None


def test_a_sliver_of_a_photo_holds_no_match():
    left, right, at, _ = pair(22)
    for sliver in (right[:2], right[:, :2], right[:2, :2], right[:3]):
        seen = match_stepped(left, sliver, at[0], np.array([1.0, 1.0]), search=5)
        assert seen.status != Status.OK and not np.isfinite(seen.lsm.pixel).any() and np.isnan(seen.surface).all()


def test_parameters_that_a_window_cannot_determine_are_held_in_the_template_axes():
    rng = np.random.default_rng(23)
    row, col = np.mgrid[:80, :80].astype(float)
    left = 120 + 80 * np.exp(-((col - 40.2) ** 2 + (row - 39.7) ** 2) / 50)  # a dot has no direction
    right = np.rot90(left) + rng.normal(0, 1.5, (80, 80))  # (col, row) -> (row, 79 - col)
    left = left + rng.normal(0, 1.5, (80, 80))
    shape = np.array([[0.0, 1.0], [-1.0, 0.0]])
    at = np.array([40.0, 40.0])
    start = np.array([at[1] + 0.3, 79 - at[0] - 0.3])
    found = match_lsm(left, right, at[None], start[None], 15, shape=shape)
    assert found.ok[0] and found.kept[0] < 6
    problem, x0 = lsm_problem(left, right, at, start, 15, shape, free=found.free[0])
    assert problem.dof == 15**2 - found.kept[0] - 2 and problem.jacobian.shape == (15**2, found.kept[0])
    trace = solve(problem, x0, GAUSS_NEWTON)
    assert trace.converged and np.abs(trace.last.x[[0, 3]] - found.pixel[0]).max() < 1e-3
    check_design(problem, x0, prepare(left[25:56, 25:56]))
    seen = match_stepped(left, right, at, start, 15, 4, shape=shape)
    assert seen.problem is not None and seen.problem.free == tuple(found.free[0])
