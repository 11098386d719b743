"""Nested dissection and the reduced system: against dense algebra."""

import numpy as np
import pytest

from solvers.adjustment.fronts import Factor, Indefinite, Pattern
from solvers.adjustment.schur import Reduced, Schur


def matrix(m: int, reach: float, s: int, seed: int, pieces: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of a well-conditioned matrix over m nodes of a plane that touch within a reach, and the matrix itself."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, np.sqrt(m), (m, 2))
    near = (np.abs(xy[:, None] - xy[None]).max(axis=2) < reach) & (np.arange(m)[:, None] % pieces == np.arange(m) % pieces)
    i, j = np.nonzero(near & (np.arange(m)[:, None] <= np.arange(m)))
    blocks = 0.1 * rng.normal(size=(len(i), s, s))
    own = i == j
    degree = np.bincount(np.r_[i, j], minlength=m)
    blocks[own] = (blocks[own] + np.swapaxes(blocks[own], 1, 2)) / 2 + np.eye(s) * degree[i[own], None, None]
    whole = np.zeros((m, s, m, s))
    whole[j, :, i, :] = np.swapaxes(blocks, 1, 2)
    whole[i, :, j, :] = blocks
    return i, j, blocks, whole.reshape(m * s, m * s)


@pytest.mark.parametrize(("m", "leaf", "pieces"), [(12, 96, 1), (90, 8, 1), (150, 20, 3), (40, 1, 1)])
def test_factor_solves_and_inverts_where_the_matrix_is_not_zero(m, leaf, pieces):
    i, j, blocks, whole = matrix(m, 2.6, 3, m, pieces)
    pattern = Pattern.of(m, 3, i, j, leaf)
    assert (len(pattern.fronts) > 1) == (m > leaf)
    assert sorted(np.concatenate([f.own for f in pattern.fronts])) == list(range(m))
    factor = Factor(pattern, blocks)
    b = np.random.default_rng(1).normal(size=(3 * m, 4))
    np.testing.assert_allclose(whole @ factor.solve(b), b, atol=1e-11)
    inverse = np.linalg.inv(whole).reshape(m, 3, m, 3)
    np.testing.assert_allclose(factor.selected_inverse(), inverse[i, :, j, :], atol=1e-12)


def test_a_matrix_that_is_not_positive_is_factored_too():
    i, j, blocks, whole = matrix(90, 2.6, 3, 1)
    sign = np.where(np.arange(270) % 2, -1.0, 1.0)  # saddle: every other unknown is a multiplier
    whole = whole + np.diag(np.diag(whole) * (sign - 1))
    blocks = whole.reshape(90, 3, 90, 3)[i, :, j, :]
    assert (np.linalg.eigvalsh(whole) < 0).sum() == 135
    pattern = Pattern.of(90, 3, i, j, 8)
    with pytest.raises(np.linalg.LinAlgError):
        Factor(pattern, blocks)
    factor, b = Indefinite(pattern, blocks), np.random.default_rng(1).normal(size=(270, 4))
    np.testing.assert_allclose(whole @ factor.solve(b), b, atol=1e-10)
    np.testing.assert_allclose(factor.selected_inverse(), np.linalg.inv(whole).reshape(90, 3, 90, 3)[i, :, j, :], atol=1e-11)


def test_dissection_keeps_the_work_of_a_long_strip_linear():
    """A strip of images whose neighbours touch: no front grows with the length of the strip."""
    largest = []
    for m in (200, 800):
        i = np.repeat(np.arange(m), 6)
        j = i + np.tile(np.arange(6), m)
        inside = j < m
        pattern = Pattern.of(m, 6, i[inside], j[inside], 30)
        largest.append(max(len(f.own) + len(f.border) for f in pattern.fronts))
    assert largest[1] <= largest[0] + 5 <= 45


def test_a_singular_matrix_is_refused_and_a_step_is_nan():
    i, j, blocks, _ = matrix(20, 2.0, 3, 5)
    blocks[(i == j) & (i == 7)] = 0.0
    pattern = Pattern.of(20, 3, i, j, 6)
    with pytest.raises(np.linalg.LinAlgError):
        Factor(pattern, blocks)
    empty = np.zeros((60, 0))
    reduced = Reduced(pattern, blocks, empty, np.zeros((0, 0)), np.ones(60), np.zeros(0))
    normal = Schur(np.ones(60), np.ones(60), lambda damping: reduced, lambda *_: np.zeros(0))
    assert np.isnan(normal.step(0.0)[0]).all()


def test_border_of_shared_unknowns():
    i, j, blocks, whole = matrix(30, 2.5, 3, 3)
    rng = np.random.default_rng(4)
    border, corner = 0.3 * rng.normal(size=(90, 5)), 40 * np.eye(5)
    full = np.block([[whole, border], [border.T, corner]])
    reduced = Reduced(Pattern.of(30, 3, i, j, 8), blocks, border, corner, rng.normal(size=90), rng.normal(size=5))
    images, shared = reduced.solve(reduced.g[:, None], reduced.h[:, None])
    expected = np.linalg.solve(full, np.r_[reduced.g, reduced.h])
    np.testing.assert_allclose(np.r_[images[:, 0], shared[:, 0]], expected, atol=1e-12)
    q, qb, qc = reduced.inverse()
    inverse = np.linalg.inv(full)
    np.testing.assert_allclose(q, inverse[:90, :90].reshape(30, 3, 30, 3)[i, :, j, :], atol=1e-12)
    np.testing.assert_allclose(qb, inverse[:90, 90:], atol=1e-12)
    np.testing.assert_allclose(qc, inverse[90:, 90:], atol=1e-12)
