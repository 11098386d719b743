"""Checks shared by the tests of all rooms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from solvers import Exterior
from solvers.geometry import log


def central(f: Callable[[np.ndarray], np.ndarray], u: int, steps: np.ndarray | float) -> np.ndarray:
    """d f / d x (..., u) at x = 0 by central differences; steps (u,) in the unit of each parameter."""
    out = []
    for i, h in enumerate(np.broadcast_to(steps, (u,))):
        e = np.zeros(u)
        e[i] = h
        out.append((f(e) - f(-e)) / (2 * h))
    return np.stack(out, axis=-1)


def check_jacobian(problem, x: np.ndarray, rtol: float = 1e-6, step: float = 3e-4) -> None:
    """A problem's `linear` (residuals v, derivatives j of the computed values) against differences through its `retract`.

    Steps are `step` fixed-others standard deviations of each parameter, so that no unit matters.
    """
    linear = problem.linear(x)
    h = step / linear.normal().scale
    numeric = -central(lambda e: problem.linear(problem.retract(x, e)).v, len(h), h)
    size = np.linalg.norm(linear.j, axis=(0, 1))
    error = np.abs(numeric - linear.j).max(axis=(0, 1)) / size
    assert (error < rtol).all(), f"columns off by {error}"
    gradient = central(lambda e: np.array(problem.cost(problem.retract(x, e))), len(h), h)
    expected = -linear.normal().gradient
    assert np.allclose(gradient * h, expected * h, atol=rtol * np.abs(expected * h).max() + 1e-9 * h.max())


def angle_between(a: Exterior, b: Exterior) -> float:
    """Angle [rad] between two attitudes."""
    return float(np.linalg.norm(log(a.m @ b.m.T)))


def assert_same(a: Exterior, b: Exterior, metres: float, radians: float) -> None:
    """Two exterior orientations agree within the given tolerances."""
    assert np.abs(a.centre - b.centre).max() <= metres, f"centres apart: {a.centre - b.centre}"
    assert angle_between(a, b) <= radians, f"attitudes apart by {np.degrees(angle_between(a, b))} degrees"


def chi_square_band(values: np.ndarray, dof: int, level: float = 0.99) -> None:
    """The sum of independent chi-square values lies in its two-sided band: the covariance predicts the scatter."""
    from scipy.stats import chi2

    tail, total, d = (1 - level) / 2, float(np.sum(values)), dof * len(values)
    low, high = chi2.ppf([tail, 1 - tail], d)
    assert low <= total <= high, f"chi-square per degree of freedom {total / d:.3f}, expected {low / d:.3f} .. {high / d:.3f}"


def normalised_error(orientation, truth: Exterior) -> np.ndarray:
    """(6,) error of centre and angles against a truth, angles wrapped."""
    gap = orientation.exterior.angles - truth.angles
    return np.concatenate([orientation.exterior.centre - truth.centre, (gap + np.pi) % (2 * np.pi) - np.pi])
