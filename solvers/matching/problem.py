"""One least squares match as a problem of the adjustment engine: its iterations can be stepped, like any other adjustment."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..adjustment import Dense, Options
from ..errors import DegenerateGeometry
from . import batch
from .patches import SMOOTH, Photo, prepare

NAMES = ("a1", "a2", "a3", "b1", "b2", "b3", "r0", "r1")
"""Parameters: a1, b1 col, row in the target (px); a2, a3, b2, b3 shape; r0 grey values, r1 gain - 1."""


GAUSS_NEWTON = Options.gauss_newton(40, step_tolerance=1e-7)
"""How `LsmProblem` is iterated to its end: every step is taken, for its rest is no minimum of half the squares (see there)."""


@dataclass(frozen=True)
class LsmProblem:
    """f(x0, y0) = r0 + (1 + r1) g(a1 + a2 x0 + a3 y0, b1 + b2 x0 + b3 y0), (x0, y0) px from the point, by inverse composition.

    template (side, side) grey values f, around the whole pixel next to the point, which lies `rest` (2,) px further (col, row);
    slopes (2, side, side) of f to col and row, per px; target: the other photo. x is (8,), in the order of `NAMES`.
    free (6,): which of a1 .. b3 are adjusted, counted in the template's axes: what a window cannot determine does not depend on
    how it is turned.

    The design matrix is Gruen's with the factors x0, y0 of its shaping columns, of the template's slopes, its columns made
    orthogonal to 1 and f: r0 and r1 are eliminated, and are what gives both windows the same mean and the same contrast. A step
    warps the template; its inverse is joined to the affine (`retract`). It comes to rest where the template's slopes see no
    difference, which with noise is not quite where half the squares, `cost`, are least: iterate it by `GAUSS_NEWTON`.
    Reference: Gruen 1985, eq. 9; Baker & Matthews 2004, 3.2 (inverse composition).
    """

    template: np.ndarray
    slopes: np.ndarray
    target: Photo
    free: tuple[bool, ...] = (True,) * 6
    rest: np.ndarray = field(default_factory=lambda: np.zeros(2))

    @property
    def dof(self) -> int:
        return self.template.size - sum(self.free) - 2

    def offsets(self) -> tuple[np.ndarray, np.ndarray]:
        """x0, y0 (side, side) px."""
        half = self.template.shape[0] // 2
        y0, x0 = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
        return x0 - self.rest[0], y0 - self.rest[1]

    def window(self, x: np.ndarray) -> np.ndarray:
        """(side, side) grey values g of the target where x puts the window; NaN where it leaves the image."""
        x0, y0 = self.offsets()
        return spline(self.target, x[0] + x[1] * x0 + x[2] * y0, x[3] + x[4] * x0 + x[5] * y0)[0]

    def middle(self, x: np.ndarray) -> np.ndarray:
        """(2,) col, row of the window's middle in the target: of the whole pixel next to the point."""
        return x[[0, 3]] - x[[1, 2, 4, 5]].reshape(2, 2) @ self.rest

    def warped(self, x: np.ndarray) -> np.ndarray:
        """(side, side) the target's window as the template should look; NaN where it leaves the image."""
        return x[6] + (1 + x[7]) * self.window(x)

    def cost(self, x: np.ndarray) -> float:
        return 0.5 * float(((self.template - self.warped(x)) ** 2).sum())

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """(side^2, free) derivatives of the template by a warp of its own, whatever x; offset and gain eliminated."""
        x0, y0 = self.offsets()
        gx, gy = self.slopes
        columns = np.stack([c.ravel() for c in (gx, gx * x0, gx * y0, gy, gy * x0, gy * y0)], 1)[:, list(self.free)]
        f = self.template.ravel() - self.template.mean()
        columns -= columns.mean(axis=0)
        return columns - np.outer(f, f @ columns / max(float(f @ f), 1e-300))

    def normal(self, x: np.ndarray) -> Dense:
        j = self.jacobian
        return Dense(j.T @ j, j.T @ (self.warped(x) - self.template).ravel())

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        """The affine before, after the inverse of the template's own warp by dx; offset and gain anew."""
        d = np.zeros(6)
        d[list(self.free)] = dx
        warp, move = np.eye(2) + d[[1, 2, 4, 5]].reshape(2, 2), d[[0, 3]]
        if abs(np.linalg.det(warp)) < 1e-6:
            return np.full(8, np.nan)
        shape = x[[1, 2, 4, 5]].reshape(2, 2) @ np.linalg.inv(warp)
        return self.matched(x[[0, 3]] - shape @ move, shape)

    def matched(self, place: np.ndarray, shape: np.ndarray) -> np.ndarray:
        """(8,) x of the window at place (2,) px with shape (2, 2), its mean and contrast those of the template."""
        x = np.array([place[0], *shape[0], place[1], *shape[1], 0.0, 0.0])
        g = self.window(x)
        spread = float(g.std())
        gain = float(self.template.std()) / spread if spread > 0 else np.nan
        x[6], x[7] = self.template.mean() - gain * g.mean(), gain - 1
        return x


def lsm_problem(template_image: np.ndarray | Photo, target_image: np.ndarray | Photo, at: np.ndarray, start: np.ndarray,
                window: int = 21, shape: np.ndarray | None = None, smooth: float = SMOOTH,
                free: np.ndarray | None = None) -> tuple[LsmProblem, np.ndarray]:
    """The problem of one point and its start x0, for `solve(problem, x0, GAUSS_NEWTON)`, which ends where `match_lsm` does.

    Arguments as in `match_lsm`; free (6,): the geometric parameters adjusted. Raises DegenerateGeometry when the template window
    leaves its image.
    """
    at, place = batch.points(at, "at")[0], batch.points(start, "start")[0]
    matrix, half = batch.shapes(shape, 1)[0], batch.half_window(window)
    whole = np.floor(at + 0.5)
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    f, *slopes = spline(prepare(template_image, smooth), whole[0] + u, whole[1] + v)
    if not np.isfinite(f).all():
        raise DegenerateGeometry(f"the template window at {at[0]:g}, {at[1]:g} leaves the image or its data: choose another "
                                 "point")
    kept = (True,) * 6 if free is None else tuple(bool(k) for k in free)
    problem = LsmProblem(f, np.stack(slopes), prepare(target_image, smooth), kept, at - whole)
    return problem, problem.matched(place, matrix)


def spline(photo: Photo, col: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values and slopes to col and row of the photo's spline; NaN outside it."""
    c = photo.coefficients
    inside = (col >= 1) & (row >= 1) & (col < c.shape[1] - 2) & (row < c.shape[0] - 2)
    x, y = np.where(inside, col, 1.0), np.where(inside, row, 1.0)
    ix, iy = np.floor(x).astype(int), np.floor(y).astype(int)
    wx, dx = _weights(x - ix)
    wy, dy = _weights(y - iy)
    k = np.arange(-1, 3)
    down, right = (np.minimum(i[..., None] + k, n - 1) for i, n in ((iy, c.shape[0]), (ix, c.shape[1])))  # of a sliver, too
    nodes = c[down[..., :, None], right[..., None, :]].astype(float)
    outside = np.where(inside, 0.0, np.nan)

    def weighted(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.einsum("...i,...ij,...j->...", a, nodes, b) + outside

    return weighted(wy, wx), weighted(wy, dx), weighted(dy, wx)


def _weights(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cubic B-spline weights and their derivatives, (..., 4)."""
    m = 1 - t
    w = np.stack([m**3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3], -1) / 6
    return w, np.stack([-m * m, 3 * t * t - 4 * t, -3 * t * t + 2 * t + 1, t * t], -1) / 2
