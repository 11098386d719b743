"""What joins a bundle beside image points, weighted coordinates and priors: scale bars, control known together, shifts of GPS.

All of it touches few unknowns that stand in the border of the normal equations: points that bars and common covariances tie
together are not eliminated but held there, and every strip's shift of its GPS positions is three more.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Extras:
    """held: so many points, right behind the unknown ones, stand in the border. bars (b, 2): points; lengths, bar_sigma (b,) m.
    correlated: (points (k,), root (3 k, 3 k) of the inverse of their common covariance) of control known together. shifts: names
    of strips; shift_of (m,): strip of each image, -1 for none; shift_sigma: of a shift [m]. levers (m, 3): from the projection
    centre to the antenna in the photo frame [m]. moving (m,): parameters of each image's motion while it is read, 0, 3 (velocity,
    m/s, local axes) or 6 (and the rate of its rotation, rad/s, photo axes); motion, motion_sigma (m, 6): what is known of them;
    readout (m,) [s] from the first row to the last; turning (m, k, 3): what is known of how they turn, see `Prior`, else 0."""

    held: int = 0
    bars: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), int))
    lengths: np.ndarray = field(default_factory=lambda: np.zeros(0))
    bar_sigma: np.ndarray = field(default_factory=lambda: np.zeros(0))
    correlated: tuple[tuple[np.ndarray, np.ndarray], ...] = ()
    shifts: tuple[str, ...] = ()
    shift_of: np.ndarray | None = None
    shift_sigma: float = 100.0
    levers: np.ndarray | None = None
    moving: int = 0
    motion: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    motion_sigma: np.ndarray = field(default_factory=lambda: np.zeros((0, 6)))
    readout: np.ndarray = field(default_factory=lambda: np.zeros(0))
    turning: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))

    @property
    def motions(self) -> int:
        """Unknowns of motion, of all images."""
        return self.moving * len(self.motion)

    @property
    def count(self) -> int:
        """Unknowns of the border that belong to it: held points, then shifts, then motions."""
        return 3 * (self.held + len(self.shifts)) + self.motions

    @property
    def observed(self) -> int:
        """Observations among it, weighted coordinates of held points aside."""
        return len(self.bars) + sum(3 * len(p) for p, _ in self.correlated) + 3 * len(self.shifts) + self.motions


def border_rows(extras: Extras, points: np.ndarray, known: np.ndarray, weight: np.ndarray, shifts: np.ndarray, live: int,
                interior: int, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(r,) misclosures and (r, f) derivatives, in standard deviations, of all that touches the border only.

    points, known, weight (n, 3); shifts (s, 3); motion (m, 0, 3 or 6); interior: parameters
    that stand before the held points in the border.
    """
    f = interior + extras.count
    v, d = [], []

    def columns(p: np.ndarray) -> np.ndarray:
        return interior + 3 * (np.asarray(p)[..., None] - live) + np.arange(3)

    held = np.arange(live, live + extras.held)
    n, c = np.nonzero(weight[held] > 0)
    root = np.sqrt(weight[held][n, c])
    rows = np.zeros((len(n), f))
    rows[np.arange(len(n)), columns(held)[n, c] if len(n) else []] = root
    v.append(root * (known - points)[held][n, c])
    d.append(rows)
    if len(extras.bars):
        a, b = extras.bars.T
        along = points[b] - points[a]
        length = np.linalg.norm(along, axis=1)
        along = along / (length * extras.bar_sigma)[:, None]
        rows = np.zeros((len(a), f))
        np.put_along_axis(rows, columns(b), along, 1)
        np.put_along_axis(rows, columns(a), -along, 1)
        v.append((extras.lengths - length) / extras.bar_sigma)
        d.append(rows)
    for p, whiten in extras.correlated:
        rows = np.zeros((3 * len(p), f))
        rows[:, columns(p).ravel()] = whiten
        v.append(whiten @ (known[p] - points[p]).ravel())
        d.append(rows)
    if extras.shifts:
        rows = np.zeros((3 * len(extras.shifts), f))
        first = interior + 3 * extras.held
        rows[:, first:first + len(rows)] = np.eye(3 * len(extras.shifts)) / extras.shift_sigma
        v.append(-shifts.ravel() / extras.shift_sigma)
        d.append(rows)
    if extras.moving:
        sigma = extras.motion_sigma[:, :extras.moving].ravel()
        rows = np.zeros((len(sigma), f))
        rows[:, f - len(sigma):] = np.diag(1 / sigma)
        v.append((extras.motion[:, :extras.moving] - motion).ravel() / sigma)
        d.append(rows)
    return np.concatenate(v), np.concatenate(d)


__all__ = ["Extras", "border_rows"]
