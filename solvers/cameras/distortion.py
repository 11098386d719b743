"""The ten-parameter correction of image coordinates (Australis model), its inverse and derivatives.

Everything here works on coordinates reduced to the principal point, in millimetres, and is a *correction*:
ideal = measured + delta(measured). Reference: docs/formulas.md 9; Fraser 1997, "Digital camera self-calibration".
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

TERMS = ("k1", "k2", "k3", "p1", "p2", "b1", "b2")
"""Order of the coefficients everywhere: mm^-2, mm^-4, mm^-6, mm^-1, mm^-1, -, -."""

_MAX_INVERSE_STEPS = 50


def correct(coefficients: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Ideal coordinates (..., 2) mm of measured coordinates (..., 2) mm, both reduced to the principal point."""
    k1, k2, k3, p1, p2, b1, b2 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = r2 * (k1 + r2 * (k2 + r2 * k3))
    dx = x * radial + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y + b1 * x + b2 * y
    dy = y * radial + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    return np.stack([x + dx, y + dy], axis=-1)


def correct_jacobian(coefficients: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """d ideal / d measured, (..., 2, 2), no unit."""
    k1, k2, k3, p1, p2, b1, b2 = coefficients
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d radial / d(r^2) * 2
    xx = 1 + radial + slope * x * x + 6 * p1 * x + 2 * p2 * y + b1
    xy_ = slope * x * y + 2 * p1 * y + 2 * p2 * x + b2
    yx = slope * x * y + 2 * p2 * x + 2 * p1 * y
    yy = 1 + radial + slope * y * y + 6 * p2 * y + 2 * p1 * x
    return np.stack([np.stack([xx, xy_], -1), np.stack([yx, yy], -1)], axis=-2)


def correct_derivatives(xy: np.ndarray) -> np.ndarray:
    """d ideal / d(k1, k2, k3, p1, p2, b1, b2), (..., 2, 7); units mm per unit of each coefficient."""
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    zero = np.zeros_like(x)
    row_x = [x * r2, x * r2**2, x * r2**3, r2 + 2 * x * x, 2 * x * y, x, y]
    row_y = [y * r2, y * r2**2, y * r2**3, 2 * x * y, r2 + 2 * y * y, zero, zero]
    return np.stack([np.stack(row_x, -1), np.stack(row_y, -1)], axis=-2)


@lru_cache(maxsize=64)
def fold(k1: float, k2: float, k3: float) -> float:
    """Square of the measured radius [mm^2] at which the radial correction folds back on itself; inf where it never does."""
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])  # d ideal radius / d measured radius = 0
    real = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return float(real.min(initial=np.inf))


def distort(coefficients: np.ndarray, ideal: np.ndarray) -> np.ndarray:
    """Measured coordinates (..., 2) mm of ideal coordinates (..., 2) mm: the inverse of `correct`, by Newton.

    Points beyond the range in which the correction can be inverted come back as NaN; nothing is guessed.
    """
    if not np.any(coefficients):
        return np.array(ideal, float)
    shape = np.shape(ideal)
    target = np.asarray(ideal, float).reshape(-1, 2)
    xy = target.copy()
    scale = 1.0 + np.abs(target).max(axis=1)
    live = np.ones(len(target), bool)
    for _ in range(_MAX_INVERSE_STEPS):
        at = xy[live]
        error = target[live] - correct(coefficients, at)
        j = correct_jacobian(coefficients, at)
        det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
        with np.errstate(all="ignore"):
            step = np.stack([j[:, 1, 1] * error[:, 0] - j[:, 0, 1] * error[:, 1],
                             j[:, 0, 0] * error[:, 1] - j[:, 1, 0] * error[:, 0]], -1) / det[:, None]
        xy[live] = at + step
        moved = np.abs(step).max(axis=1) > 1e-15 * scale[live]
        live[live] = moved & np.isfinite(step).all(axis=1)
        if not live.any():
            break
    j = correct_jacobian(coefficients, xy)
    unfolded = j[:, 0, 0] * j[:, 1, 1] > j[:, 0, 1] * j[:, 1, 0]
    unfolded &= (xy**2).sum(axis=1) < fold(*map(float, coefficients[:3]))
    missed = np.abs(correct(coefficients, xy) - target).max(axis=1) > 1e-9 * scale
    xy[missed | ~unfolded | ~np.isfinite(xy).all(axis=1)] = np.nan
    return xy.reshape(shape)
