"""Thousands of single images at once, as plain arrays: the estimators that the studies compare.

points (B, n, 3) m, xy (B, n, 2) mm ideal photo coordinates; orientations are m (B, 3, 3) and centre (B, 3).
They follow `orientation.resection` and `orientation.orthogonal` and are tested against them; the loops are compiled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import skew
from ..orientation.orthogonal import Form


@dataclass(frozen=True)
class Poses:
    """m (B, 3, 3), centre (B, 3), ok (B,) whether an orientation was reached (and came to rest)."""

    m: np.ndarray
    centre: np.ndarray
    ok: np.ndarray

    @classmethod
    def same(cls, m: np.ndarray, centre: np.ndarray, runs: int) -> Poses:
        """One orientation, m (3, 3) and centre (3,), for all runs."""
        return cls(np.broadcast_to(m, (runs, 3, 3)), np.broadcast_to(centre, (runs, 3)), np.ones(runs, bool))

    def error(self, m: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """(B, 6) differences from other orientations: centre [m] and left rotation vector [rad]."""
        d = self.m @ np.swapaxes(m, -1, -2)
        vee = np.stack([d[:, 2, 1] - d[:, 1, 2], d[:, 0, 2] - d[:, 2, 0], d[:, 1, 0] - d[:, 0, 1]], axis=1) / 2
        sine = np.linalg.norm(vee, axis=1, keepdims=True)
        angle = np.arctan2(sine, ((np.trace(d, axis1=1, axis2=2) - 1) / 2)[:, None])
        return np.hstack([self.centre - centre, vee * np.where(sine > 1e-12, angle / np.where(sine > 0, sine, 1), 1.0)])

    def project(self, points: np.ndarray, c: float) -> np.ndarray:
        """(B, n, 2) mm, photo coordinates of points (n, 3); NaN behind the camera."""
        uvw = (points - self.centre[:, None]) @ np.swapaxes(self.m, 1, 2)
        return -c * uvw[..., :2] / np.where(uvw[..., 2:] < 0, uvw[..., 2:], np.nan)


def exponential(d: np.ndarray) -> np.ndarray:
    """Rotations (B, 3, 3) of rotation vectors (B, 3)."""
    theta = np.linalg.norm(d, axis=1)[:, None, None]
    safe = np.where(theta > 1e-9, theta, 1.0)
    a, b = np.where(theta > 1e-9, np.sin(safe) / safe, 1.0), np.where(theta > 1e-9, (1 - np.cos(safe)) / safe**2, 0.5)
    k = skew(d)
    return np.eye(3) + a * k + b * (k @ k)


def perspective(points: np.ndarray, xy: np.ndarray, c: float, sigma_mm: np.ndarray, start: Poses,
                prior: tuple[Poses, np.ndarray] | None = None, steps: int = 200) -> tuple[Poses, np.ndarray]:
    """Collinearity by damped least squares; sigma_mm (B, n). prior: orientations and the weights (6,), 1 / sigma^2, of
    (centre [m], rotation vector [rad]), the three of the rotation alike.

    Returns the orientations and their costs (B,), half the weighted sum of squares.
    """
    from . import _kernels

    given, weight = prior if prior is not None else (start, np.zeros(0))
    m, centre = np.array(start.m), np.array(start.centre)
    cost, rest = np.empty(len(m)), np.empty(len(m), bool)
    _kernels.perspective(_plain(points), _plain(xy), c, _plain(sigma_mm), m, centre, _plain(given.m), _plain(given.centre),
                         _plain(weight), steps, cost, rest)
    return Poses(m, centre, rest), cost


def best_of(*found: tuple[Poses, np.ndarray]) -> Poses:
    """Run by run the orientation of least cost."""
    pick = np.argmin(np.stack([np.where(np.isfinite(c), c, np.inf) for _, c in found]), axis=0)
    rows = np.arange(len(pick))
    return Poses(*(np.stack([getattr(p, name) for p, _ in found])[pick, rows] for name in ("m", "centre", "ok")))


def orthogonal_pass(points: np.ndarray, xy: np.ndarray, c: float, approximate: Poses, form: Form = "depth",
                    recentre: bool = True) -> Poses:
    """One pass of the orthogonal model through approximate orientations (docs/formulas.md 3.1 to 3.5)."""
    return _orthogonal(points, xy, c, approximate, form, recentre, 1)


def orthogonal_iterated(points: np.ndarray, xy: np.ndarray, c: float, start: Poses, form: Form = "depth", recentre: bool = True,
                        rounds: int = 200) -> Poses:
    """Transform again until nothing changes; ok tells which runs came to rest."""
    return _orthogonal(points, xy, c, start, form, recentre, rounds)


def _orthogonal(points: np.ndarray, xy: np.ndarray, c: float, start: Poses, form: Form, recentre: bool, rounds: int) -> Poses:
    from . import _kernels

    b = len(points)
    rays = np.concatenate([xy, np.full((*xy.shape[:2], 1), -c)], axis=2)
    r = _recentring(rays) if recentre else np.broadcast_to(np.eye(3), (b, 3, 3))
    rays = rays @ np.swapaxes(r, 1, 2)
    m, centre, ok = np.ascontiguousarray(r @ start.m), np.array(start.centre), np.empty(b, bool)
    x = _plain(-c * rays[..., :2] / rays[..., 2:])
    _kernels.orthogonal(_plain(points), x, c, m, centre, form == "printed", rounds, 40, ok)
    return Poses(np.swapaxes(r, 1, 2) @ m, centre, ok)


def _recentring(rays: np.ndarray) -> np.ndarray:
    z = -(rays / np.linalg.norm(rays, axis=2, keepdims=True)).mean(axis=1)
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    k = skew(np.cross(z, [0.0, 0.0, 1.0]))
    return np.eye(3) + k + k @ k / (1 + z[:, 2, None, None])


def _plain(a: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(a, float)
