"""Raster geometry as a value, heights on it, and where a path through space meets them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Grid:
    """Geometry of a raster. shape: rows, columns. affine: a, b, c, d, e, f of GDAL's pixel EDGES, x = a col + b row + c,
    y = d col + e row + f, so that the top-left corner of the top-left pixel is (c, f). crs: EPSG code or "local"."""

    shape: tuple[int, int]
    affine: tuple[float, float, float, float, float, float]
    crs: str = "local"

    @cached_property
    def _matrix(self) -> np.ndarray:
        a, b, _, d, e, _ = self.affine
        return np.array([[a, b], [d, e]])

    def to_map(self, pixels: np.ndarray) -> np.ndarray:
        """Map coordinates (..., 2) of pixels (..., 2) (col, row), (0, 0) = centre of the top-left pixel."""
        return (np.asarray(pixels, float) + 0.5) @ self._matrix.T + np.array([self.affine[2], self.affine[5]])

    def to_pixels(self, xy: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of map coordinates (..., 2): the inverse of `to_map`."""
        return (np.asarray(xy, float) - [self.affine[2], self.affine[5]]) @ np.linalg.inv(self._matrix).T - 0.5

    @property
    def corners(self) -> np.ndarray:
        """(4, 2) map coordinates of the outer corners: top left, top right, bottom right, bottom left."""
        rows, columns = self.shape
        return self.to_map(np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) - 0.5)


@dataclass(frozen=True)
class Surface:
    """Heights z (rows, columns) m at the pixel centres of a grid, bilinear between them, NaN where there are none.

    sigma: standard error of a height [m]; sigma_xy: standard error of the grid's own position [m]; name: file or what it is.
    """

    grid: Grid
    z: np.ndarray
    sigma: float = 0.0
    sigma_xy: float = 0.0
    name: str = "DEM"

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height."""
        return float(np.nanmin(self.z)), float(np.nanmax(self.z))

    def _patch(self, col: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, ...]:
        """The four heights of cells whose top-left node is (col, row); NaN outside the nodes."""
        rows, columns = self.z.shape
        inside = (col >= 0) & (row >= 0) & (col <= columns - 2) & (row <= rows - 2)
        c, r = np.where(inside, col, 0), np.where(inside, row, 0)
        return tuple(np.where(inside, self.z[r + dr, c + dc], np.nan) for dr in (0, 1) for dc in (0, 1))

    def _cells(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Cell (col, row) of map positions and the place u, v in 0..1 within it; the last node belongs to the last cell."""
        p = self.grid.to_pixels(xy)
        last = np.array([self.z.shape[1] - 1, self.z.shape[0] - 1])
        finite = np.where(np.isfinite(p), np.clip(p, -2, last + 2), -2)
        finite = np.where((finite < 0) & (finite >= -1e-9), 0.0, finite)  # the outer nodes themselves, to round-off
        cell = np.floor(finite).astype(int)
        cell = np.where((finite <= last + 1e-9) & (cell >= last), last - 1, cell)
        return cell[..., 0], cell[..., 1], finite[..., 0] - cell[..., 0], finite[..., 1] - cell[..., 1]

    def sample(self, xy: np.ndarray) -> np.ndarray:
        """Height (...,) at map positions (..., 2); NaN outside the outer nodes and beside a void."""
        col, row, u, v = self._cells(xy)
        return _bilinear(self._patch(col, row), u, v)

    def slope(self, xy: np.ndarray) -> np.ndarray:
        """(..., 2) dz/dx, dz/dy of the bilinear patch at map positions (..., 2)."""
        col, row, u, v = self._cells(xy)
        a, b, c, d = self._patch(col, row)
        by_pixel = np.stack([(b - a) * (1 - v) + (d - c) * v, (c - a) * (1 - u) + (d - b) * u], -1)
        return by_pixel @ np.linalg.inv(self.grid._matrix)

    def crossings(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where a path of straight pieces through map space, vertices (k, 3), meets the surface: parameters (n,), increasing,
        whole part = piece, fraction = place on it; and (n,) whether it goes below there. Exact: in a cell the height above a
        bilinear patch along a straight line is a parabola, whose roots are taken."""
        pixel = self.grid.to_pixels(path[:, :2])
        found, down = [np.zeros(0)], [np.zeros(0, bool)]
        for k in range(len(path) - 1):
            at, below = self._piece(np.append(pixel[k], path[k, 2]), np.append(pixel[k + 1], path[k + 1, 2]))
            found.append(at + k)
            down.append(below)
        s, below = np.concatenate(found), np.concatenate(down)
        order = np.argsort(s, kind="stable")
        s, below = s[order], below[order]
        once = np.append(True, (np.diff(s) > 1e-9) | (below[1:] != below[:-1])) if len(s) else np.zeros(0, bool)
        return s[once], below[once]

    def _piece(self, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Crossings of one straight piece from (col, row, height) to (col, row, height)."""
        step = end - start
        cuts = [np.array([0.0, 1.0])]
        for axis in (0, 1):
            low, high = sorted((start[axis], end[axis]))
            lines = np.arange(max(np.ceil(low), 0), min(np.floor(high), self.z.shape[1 - axis] - 1) + 1)
            if step[axis] != 0:
                cuts.append((lines - start[axis]) / step[axis])
        s = np.unique(np.clip(np.concatenate(cuts), 0, 1))
        s0, s1 = s[:-1], s[1:]
        middle = (s0 + s1) / 2
        cell = np.floor(start[:2] + middle[:, None] * step[:2]).astype(int)
        patch = self._patch(cell[:, 0], cell[:, 1])

        def above(t: np.ndarray) -> np.ndarray:
            p = start + t[:, None] * step
            return p[:, 2] - _bilinear(patch, p[:, 0] - cell[:, 0], p[:, 1] - cell[:, 1])

        f0, fm, f1 = above(s0), above(middle), above(s1)
        a, b = 2 * (f0 - 2 * fm + f1), 4 * fm - 3 * f0 - f1
        roots = _parabola(a, b, f0)  # (cells, 2) in 0..1 of each piece in a cell
        slope = 2 * a[:, None] * roots + b[:, None]
        ok = np.isfinite(roots) & (roots >= -1e-9) & (roots <= 1 + 1e-9) & (slope != 0)
        return (s0[:, None] + roots * (s1 - s0)[:, None])[ok], (slope < 0)[ok]


def _bilinear(patch: tuple[np.ndarray, ...], u: np.ndarray, v: np.ndarray) -> np.ndarray:
    a, b, c, d = patch
    return (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v


def _parabola(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Real roots (n, 2) of a t^2 + b t + c, NaN where there are none, without cancellation."""
    with np.errstate(all="ignore"):
        flat = np.abs(a) <= 1e-12 * (np.abs(b) + np.abs(c))
        q = -(b + np.where(b >= 0, 1.0, -1.0) * np.sqrt(b * b - 4 * a * c)) / 2
        first, second = np.where(flat, -c / b, q / a), np.where(flat, np.nan, c / q)
    return np.stack([first, second], -1)
