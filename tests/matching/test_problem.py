"""The stepped match: its Jacobian, its agreement with the compiled batch, its trace."""

import numpy as np
import pytest

from solvers.adjustment import solve
from solvers.errors import DegenerateGeometry
from solvers.matching import GAUSS_NEWTON, LsmOptions, LsmProblem, Photo, lsm_problem, match_lsm, prepare
from solvers.matching.problem import spline

from .test_lsm import pair


def check_design(problem: LsmProblem, x: np.ndarray, photo: Photo) -> None:
    """The design matrix is the derivative of the template warped by dx, less what offset and gain take; retract undoes that warp.

    photo: the template's, its middle the window's.
    """
    f = problem.template.ravel() - problem.template.mean()
    u, v = problem.offsets()
    for k in range(problem.jacobian.shape[1]):
        sides = []
        for h in (1e-4, -1e-4):
            dx = np.zeros(problem.jacobian.shape[1])
            dx[k] = h
            d = np.zeros(6)
            d[list(problem.free)] = dx
            warp, move = np.eye(2) + d[[1, 2, 4, 5]].reshape(2, 2), d[[0, 3]]
            places = np.stack([u, v], -1) @ warp.T + move
            found = problem.retract(x, dx)
            back = places @ found[[1, 2, 4, 5]].reshape(2, 2).T + found[[0, 3]]
            assert np.abs(back - (np.stack([u, v], -1) @ x[[1, 2, 4, 5]].reshape(2, 2).T + x[[0, 3]])).max() < 1e-9
            middle = photo.size[0] // 2 + problem.rest
            sides.append(spline(photo, places[..., 0] + middle[0], places[..., 1] + middle[1])[0].ravel())
        slope = (sides[0] - sides[1]) / 2e-4
        slope = slope - slope.mean()
        slope -= f * (f @ slope) / (f @ f)
        assert np.abs(slope - problem.jacobian[:, k]).max() < 1e-3 * max(1, np.abs(problem.jacobian[:, k]).max())


@pytest.mark.parametrize("between", [0.0, 0.3])
def test_the_design_matrix_is_the_derivative_of_the_template(between: float):
    left, right, at, truth = pair(11)
    problem, x = lsm_problem(left, right, at[5] + between, truth[5] + 0.3)
    x = x + np.array([0, 0.02, -0.01, 0, 0.01, 0.03, 4, -0.1])
    whole, reach = np.floor(at[5] + between + 0.5).astype(int), problem.template.shape[0] // 2 + 3
    photo = prepare(left)
    cut = photo.coefficients[whole[1] - reach:whole[1] + reach + 1, whole[0] - reach:whole[0] + reach + 1]
    check_design(problem, x, Photo(cut, photo.smooth, photo.quantum))
    normal, j = problem.normal(x), problem.jacobian
    assert np.allclose(normal.n, j.T @ j) and problem.dof == 21**2 - 8
    assert np.allclose(normal.gradient, j.T @ (problem.warped(x) - problem.template).ravel())


@pytest.mark.parametrize("noise", [0.0, 2.0, 5.0])
def test_the_engine_ends_where_the_compiled_batch_does(noise: float):
    left, right, at, truth = pair(12, noise=noise)
    left, right = prepare(left), prepare(right)
    at, start = at + np.array([0.37, -0.28]), truth + np.array([0.4, -0.4])  # points are as good between the pixels
    batch = match_lsm(left, right, at, start, options=LsmOptions(step=1e-5))
    for i in range(0, len(at), 25):
        problem, x0 = lsm_problem(left, right, at[i], start[i], free=batch.free[i])
        trace = solve(problem, x0, GAUSS_NEWTON)
        assert batch.ok[i] and trace.converged
        x = trace.last.x
        assert np.abs(x[[0, 3]] - batch.pixel[i]).max() < 1e-5  # the batch counts in single precision
        assert np.abs(x[[1, 2, 4, 5]].reshape(2, 2) - batch.shape[i]).max() < 1e-5
        assert np.allclose(x[6:], batch.radiometric[i], rtol=1e-4, atol=[2e-2, 1e-4])
        assert problem.cost(x) < problem.cost(x0) and np.abs(problem.normal(x).gradient).max() < 1e-3


def test_a_template_outside_its_image_is_refused_and_a_step_outside_is_not_taken():
    left, right, at, truth = pair(13)
    with pytest.raises(DegenerateGeometry, match="leaves the image"):
        lsm_problem(left, right, np.array([4.0, 100.0]), truth[0])
    problem, _ = lsm_problem(left, right, at[0], truth[0])
    assert not np.isfinite(problem.cost(np.array([2.0, 1, 0, 100, 0, 1, 0, 0])))
