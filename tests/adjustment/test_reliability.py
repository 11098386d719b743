"""Covariance, redundancy numbers, standardized residuals and what a blunder must be to be found."""

import numpy as np
import pytest

from solvers import DegenerateGeometry
from solvers.adjustment import Dense, Linear, precision
from solvers.adjustment.precision import BAARDA_DELTA0


def line(n: int = 9, correlated: bool = False, seed: int = 1) -> Linear:
    """A straight line through pairs of observations, (n, 2) of them, weights of different size."""
    rng = np.random.default_rng(seed)
    t = np.arange(n, dtype=float)
    j = np.zeros((n, 2, 2))
    j[:, :, 0], j[:, 0, 1], j[:, 1, 1] = 1, t, t + 0.5
    root = rng.standard_normal((n, 2, 2)) if correlated else np.eye(2) * rng.uniform(0.5, 2, (n, 1, 1))
    p = np.linalg.inv(root @ np.swapaxes(root, 1, 2) + 0.2 * np.eye(2))
    return Linear(rng.standard_normal((n, 2)), j, p)


def dense(linear: Linear) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The whole design, weights and residuals as plain matrices."""
    n, b, u = linear.j.shape
    p = np.zeros((n * b, n * b))
    for i in range(n):
        p[i * b:(i + 1) * b, i * b:(i + 1) * b] = linear.p[i]
    return linear.j.reshape(-1, u), p, linear.v.ravel()


@pytest.mark.parametrize("correlated", [False, True])
def test_against_the_plain_matrices(correlated):
    linear = line(correlated=correlated)
    j, p, v = dense(linear)
    q = np.linalg.inv(j.T @ p @ j)
    qv = np.linalg.inv(p) - j @ q @ j.T
    got = precision(linear)
    assert np.allclose(got.covariance, q) and got.dof == 16
    assert np.allclose(got.redundancy.ravel(), np.diag(qv @ p))
    assert got.redundancy.sum() == pytest.approx(got.dof)
    pqp = np.diag(p @ qv @ p)
    assert np.allclose(got.w.ravel(), (p @ v) / np.sqrt(pqp))
    assert np.allclose(got.detectable.ravel(), BAARDA_DELTA0 / np.sqrt(pqp))
    assert got.sigma0 == pytest.approx(np.sqrt(v @ p @ v / 16))


def test_standardized_residuals_are_standard_normal_and_a_detectable_blunder_shifts_them_by_delta0():
    base = line()
    j, p, _ = dense(base)
    q = np.linalg.inv(j.T @ p @ j)
    rng = np.random.default_rng(3)
    root = np.linalg.cholesky(np.linalg.inv(p))
    detectable = precision(base).detectable[4, 1]
    w, shifted = [], []
    for _ in range(400):
        e = root @ rng.standard_normal(18)
        w.append(precision(Linear((e - j @ q @ j.T @ p @ e).reshape(9, 2), base.j, base.p)).w)
        e[9] += detectable
        shifted.append(precision(Linear((e - j @ q @ j.T @ p @ e).reshape(9, 2), base.j, base.p)).w[4, 1])
    assert np.abs(np.mean(w, axis=0)).max() < 0.2 and np.abs(np.std(w, axis=0) - 1).max() < 0.13
    assert np.mean(shifted) == pytest.approx(BAARDA_DELTA0, abs=0.2)


def test_an_unchecked_observation_has_no_test():
    linear = line()
    j = np.concatenate([linear.j, np.zeros((9, 2, 1))], axis=2)
    j[0, 0, 2] = 1  # an unknown that only one observation knows
    got = precision(Linear(linear.v, j, linear.p))
    assert got.redundancy[0, 0] == pytest.approx(0, abs=1e-12)
    assert np.isnan(got.w[0, 0]) and np.isinf(got.detectable[0, 0]) and np.isfinite(got.w[1:]).all()


def test_no_redundancy_has_no_sigma0():
    linear = line(1)
    got = precision(linear)
    assert got.dof == 0 and got.sigma0 is None


def test_singular_is_named_and_a_constraint_cures_it():
    linear = line()
    j = np.concatenate([linear.j, linear.j[:, :, :1]], axis=2)
    with pytest.raises(DegenerateGeometry, match="the shift is singular"):
        precision(Linear(linear.v, j, linear.p), "the shift")
    held = precision(Linear(linear.v, j, linear.p, np.array([[0.0, 0, 1]]), np.zeros(1)))
    assert held.dof == 16 and np.abs(held.covariance[2]).max() < 1e-12
    assert np.allclose(held.covariance[:2, :2], precision(linear).covariance)


def test_units_of_the_parameters_do_not_matter():
    linear = line()
    scale = np.array([1e5, 1e-5])
    got = precision(Linear(linear.v, linear.j * scale, linear.p))
    want = precision(linear)
    assert np.allclose(got.covariance * np.outer(scale, scale), want.covariance) and np.allclose(got.w, want.w)
    assert got.condition == pytest.approx(want.condition)


def test_bordered_step_solves_helmerts_system():
    rng = np.random.default_rng(4)
    a = rng.standard_normal((8, 5))
    n, g, h, w = a.T @ a, rng.standard_normal(5), rng.standard_normal((2, 5)), rng.standard_normal(2)
    dx, _ = Dense(n, g, h, w).step(0.0)
    assert np.allclose(h @ dx, w)
    null = np.linalg.svd(h)[2][2:]
    assert np.allclose(null @ (n @ dx - g), 0, atol=1e-10)
