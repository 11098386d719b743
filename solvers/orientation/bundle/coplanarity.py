"""How much parallel rays tell of relative orientation: the coplanarity of Ono & Hattori 2002, equations (17) to (19).

An image of parallel rays is A (2, 4): x_a = A (X, Y, Z, 1). A point seen in images l, r, .. makes the rows (A1 A2 A3 A4 - x_a),
(A5 A6 A7 A8 - y_a) of all of them meet in one solution: the stacked matrix has rank 3, every 4 by 4 minor of it is zero.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from ...geometry import exp


def stacked(a: np.ndarray, xa: np.ndarray) -> np.ndarray:
    """(n, 2 I, 4) matrices of (19), rows scaled to unit directions, of images a (I, 2, 4) and coordinates xa (I, n, 2)."""
    rows = np.broadcast_to(a[:, None], (len(a), xa.shape[1], 2, 4)).copy()
    rows[..., 3] -= xa
    rows /= np.linalg.norm(rows[..., :3], axis=-1, keepdims=True)
    return np.moveaxis(rows, 0, 1).reshape(xa.shape[1], -1, 4)


def determinants(a: np.ndarray, xa: np.ndarray) -> np.ndarray:
    """(n, pairs) determinants (17) of all pairs of images, in the unit of the object."""
    rows = stacked(a, xa)
    pairs = itertools.combinations(range(len(a)), 2)
    return np.stack([np.linalg.det(rows[:, [2 * i, 2 * i + 1, 2 * k, 2 * k + 1]]) for i, k in pairs], axis=1)


def minors(a: np.ndarray, xa: np.ndarray) -> np.ndarray:
    """(n, m) all 4 by 4 minors of (19): zero together where its rank is 3."""
    rows = stacked(a, xa)
    return np.stack([np.linalg.det(rows[:, list(k)]) for k in itertools.combinations(range(rows.shape[1]), 4)], axis=1)


def relation(xa: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(18): B1 .. B4 of x_l = B1 y_l + B2 x_r + B3 y_r + B4 for a pair xa (2, n, 2), the residuals (n,), and the singular
    values
    (4,) of the equations over the largest, columns scaled: four numbers, no more, are what a pair tells."""
    design = np.column_stack([xa[0, :, 1], xa[1], np.ones(xa.shape[1])])
    b = np.linalg.lstsq(design, xa[0, :, 0], rcond=None)[0]
    s = np.linalg.svd(design / np.linalg.norm(design, axis=0), compute_uv=False)
    return b, xa[0, :, 0] - design @ b, s / s[0]


def determined(s: np.ndarray, m: np.ndarray, t: np.ndarray, xa: np.ndarray,
               condition: Callable[[np.ndarray, np.ndarray], np.ndarray] = determinants,
               by_c: np.ndarray | None = None) -> np.ndarray:
    """Singular values, over the largest, of the derivatives of a condition by the orientation of the images: scales s (I,)
    [mm/m],
    rotations m (I, 3, 3), t (I, 2) mm; six for each, and one more, c, where by_c (I, n, 2) = d x_a / d c is given. As many as
    are not
    zero are determined; the rest of them is left to the absolute orientation."""
    steps = np.full(6 * len(s) + (by_c is not None), 1e-5)

    def at(e: np.ndarray) -> np.ndarray:
        each = e[:6 * len(s)].reshape(-1, 6)
        a = np.array([np.column_stack([s[i] * (1 + d[3]) * (exp(d[:3]) @ m[i])[:2], t[i] + s[i] * d[4:]])
                      for i, d in enumerate(each)])
        return condition(a, xa if by_c is None else xa + by_c * e[-1] * 1e3).ravel()

    columns = []
    for k, h in enumerate(steps):
        e = np.zeros(len(steps))
        e[k] = h
        columns.append((at(e) - at(-e)) / (2 * h))
    j = np.stack(columns, axis=1)
    size = np.linalg.norm(j, axis=0)
    values = np.linalg.svd(j / np.where(size > 0, size, 1), compute_uv=False)
    return values / values[0]


def count(values: Sequence[float] | np.ndarray, zero: float = 1e-6) -> int:
    """How many singular values are not zero."""
    return int((np.asarray(values) > zero).sum())


__all__ = ["count", "determinants", "determined", "minors", "relation", "stacked"]
