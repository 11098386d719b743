"""One least squares match as a problem of the adjustment engine: its iterations can be stepped, like any other adjustment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..adjustment import Dense
from ..errors import DegenerateGeometry
from . import batch
from .patches import SMOOTH, Photo, prepare

NAMES = ("a1", "a2", "a3", "b1", "b2", "b3", "r0", "r1")
"""Parameters: a1, b1 col, row in the target (px); a2, a3, b2, b3 shape; r0 grey values, r1 gain - 1."""


@dataclass(frozen=True)
class LsmProblem:
    """f(x0, y0) = r0 + (1 + r1) g(a1 + a2 x0 + a3 y0, b1 + b2 x0 + b3 y0), (x0, y0) px from the point.

    template (side, side) grey values f, around the whole pixel next to the point, which lies `rest` (2,) px further (col, row);
    target: the other photo. x is (8,), in the order of `NAMES`.
    free: which of them are adjusted; the shaping ones count in the template's axes, so that with `base` (2, 2), the shape at the
    start, a change d of them makes base @ (I + d): what a window cannot determine does not depend on how it is turned.
    Reference: Gruen 1985, eq. 9 with the factors x0, y0 of its shaping columns.
    """

    template: np.ndarray
    target: Photo
    free: tuple[bool, ...] = (True,) * 8
    base: np.ndarray = field(default_factory=lambda: np.eye(2))
    rest: np.ndarray = field(default_factory=lambda: np.zeros(2))

    @property
    def dof(self) -> int:
        return self.template.size - sum(self.free)

    def offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """x0, y0 (side, side) px."""
        half = self.template.shape[0] // 2
        y0, x0 = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
        return x0 - self.rest[0], y0 - self.rest[1]

    def places(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """col, row (side, side) of the window's pixels in the target."""
        x0, y0 = self.offsets()
        return x[0] + x[1] * x0 + x[2] * y0, x[3] + x[4] * x0 + x[5] * y0

    def warped(self, x: np.ndarray) -> np.ndarray:
        """(side, side) the target's window as the template should look; NaN where it leaves the image."""
        return x[6] + (1 + x[7]) * spline(self.target, *self.places(x))[0]

    def cost(self, x: np.ndarray) -> float:
        return 0.5 * float(((self.template - self.warped(x)) ** 2).sum())

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """(side^2, free) derivatives of the warped window."""
        x0, y0 = self.offsets()
        g, gx, gy = spline(self.target, *self.places(x))
        gx, gy = (1 + x[7]) * gx, (1 + x[7]) * gy
        u, v = gx * self.base[0, 0] + gy * self.base[1, 0], gx * self.base[0, 1] + gy * self.base[1, 1]
        columns = (gx, u * x0, u * y0, gy, v * x0, v * y0, np.ones_like(g), g)
        return np.stack([c.ravel() for c in columns], 1)[:, list(self.free)]

    def normal(self, x: np.ndarray) -> Dense:
        j = self.jacobian(x)
        return Dense(j.T @ j, j.T @ (self.template - self.warped(x)).ravel())

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        d = np.zeros(8)
        d[list(self.free)] = dx
        shape = self.base @ d[[1, 2, 4, 5]].reshape(2, 2)
        return x + np.array([d[0], *shape[0], d[3], *shape[1], *d[6:]])


def lsm_problem(template_image: np.ndarray | Photo, target_image: np.ndarray | Photo, at: np.ndarray, start: np.ndarray,
                window: int = 21, shape: np.ndarray | None = None, smooth: float = SMOOTH,
                free: np.ndarray | None = None) -> tuple[LsmProblem, np.ndarray]:
    """The problem and its start x0 for one point; arguments as in `match_lsm`, free (6,) the geometric parameters adjusted.

    Raises DegenerateGeometry when the template window leaves its image.
    """
    at, (x, y) = batch.points(at, "at")[0], batch.points(start, "start")[0]
    matrix, half = batch.shapes(shape, 1)[0], batch.half_window(window)
    whole = np.floor(at + 0.5)
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    f = spline(prepare(template_image, smooth), whole[0] + u, whole[1] + v)[0]
    if not np.isfinite(f).all():
        raise DegenerateGeometry(f"the template window at {at[0]:g}, {at[1]:g} leaves the image or its data: choose another "
                                 "point")
    kept = (True,) * 8 if free is None else (*(bool(k) for k in free), True, True)
    problem = LsmProblem(f, prepare(target_image, smooth), kept, matrix, at - whole)
    return problem, np.array([x, *matrix[0], y, *matrix[1], 0.0, 0.0])


def spline(photo: Photo, col: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values and slopes to col and row of the photo's spline; NaN outside it."""
    c = photo.coefficients
    inside = (col >= 1) & (row >= 1) & (col < c.shape[1] - 2) & (row < c.shape[0] - 2)
    x, y = np.where(inside, col, 1.0), np.where(inside, row, 1.0)
    ix, iy = np.floor(x).astype(int), np.floor(y).astype(int)
    wx, dx = _weights(x - ix)
    wy, dy = _weights(y - iy)
    k = np.arange(-1, 3)
    nodes = c[(iy[..., None] + k)[..., :, None], (ix[..., None] + k)[..., None, :]].astype(float)
    outside = np.where(inside, 0.0, np.nan)

    def weighted(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...ij,...j->...", a, nodes, b) + outside

    return weighted(wy, wx), weighted(wy, dx), weighted(dy, wx)


def _weights(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic B-spline weights and their derivatives, (..., 4)."""
    m = 1 - t
    w = np.stack([m**3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], -1) / 6
    return w, np.stack([-m * m, 3 * t * t - 4 * t, -3 * t * t + 2 * t + 1, t * t], -1) / 2
