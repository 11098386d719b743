"""The stepped match: its Jacobian, its agreement with the compiled batch, its trace."""

import numpy as np
import pytest

from solvers.adjustment import Options, solve
from solvers.errors import DegenerateGeometry
from solvers.matching import LsmOptions, lsm_problem, match_lsm, prepare

from .test_lsm import pair


def test_jacobian_is_the_derivative_of_the_warped_window():
    left, right, at, truth = pair(11)
    problem, x = lsm_problem(left, right, at[5], truth[5] + 0.3)
    x = x + np.array([0, 0.02, -0.01, 0, 0.01, 0.03, 4, -0.1])
    j = problem.jacobian(x)
    for k in range(8):
        h = np.zeros(8)
        h[k] = 1e-5
        numeric = (problem.warped(problem.retract(x, h)) - problem.warped(problem.retract(x, -h))).ravel() / 2e-5
        assert np.abs(numeric - j[:, k]).max() < 1e-4 * max(1, np.abs(j[:, k]).max())
    normal = problem.normal(x)
    assert np.allclose(normal.n, j.T @ j)
    assert np.allclose(normal.gradient, j.T @ (problem.template - problem.warped(x)).ravel())


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_the_engine_and_the_compiled_batch_agree(noise: float):
    left, right, at, truth = pair(12, noise=noise)
    left, right = prepare(left), prepare(right)
    start = truth + np.array([0.4, -0.4])
    batch = match_lsm(left, right, at, start, options=LsmOptions(step=1e-4))
    for i in range(0, len(at), 25):
        problem, x0 = lsm_problem(left, right, at[i], start[i])
        trace = solve(problem, x0, Options(max_iterations=40, step_tolerance=1e-6))
        assert trace.converged
        allowed = 1e-3 if noise == 0 else 0.5 * batch.sigma[i]
        assert (np.abs(trace.last.x[[0, 3]] - batch.pixel[i]) < allowed).all()
        assert np.abs(trace.last.x[[1, 2, 4, 5]].reshape(2, 2) - batch.shape[i]).max() < (2e-3 if noise == 0 else 0.02)
        assert (np.diff(trace.column("cost")) <= 0).all()


def test_a_template_outside_its_image_is_refused_and_a_step_outside_is_not_taken():
    left, right, at, truth = pair(13)
    with pytest.raises(DegenerateGeometry, match="leaves the image"):
        lsm_problem(left, right, np.array([4.0, 100.0]), truth[0])
    problem, _ = lsm_problem(left, right, at[0], truth[0])
    assert not np.isfinite(problem.cost(np.array([2.0, 1, 0, 100, 0, 1, 0, 0])))
