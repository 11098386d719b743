"""A terrain as a value: heights on a regular grid, the surface between them, and where rays meet it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DegenerateGeometry

_MAX_STEPS = 60


@dataclass(frozen=True)
class Terrain:
    """Heights (rows, columns) m; rows run NORTH to SOUTH, columns west to east; the surface is bilinear between the nodes.

    west, north: map coordinates [m] of the first node; cell: node spacing [m].
    """

    heights: np.ndarray
    west: float
    north: float
    cell: float

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the outermost nodes [m]."""
        rows, columns = self.heights.shape
        return self.west, self.north - (rows - 1) * self.cell, self.west + (columns - 1) * self.cell, self.north

    def contains(self, xy: np.ndarray) -> np.ndarray:
        """(...,) whether ground positions (..., 2) m lie on the grid."""
        west, south, east, north = self.bounds
        x, y = np.asarray(xy)[..., 0], np.asarray(xy)[..., 1]
        return (x >= west) & (x <= east) & (y >= south) & (y <= north)

    def height(self, xy: np.ndarray) -> np.ndarray:
        """(...,) heights [m] at ground positions (..., 2) m; beyond the grid the edge goes on level."""
        xy = np.asarray(xy, float)
        rows, columns = self.heights.shape
        u = np.clip((xy[..., 0] - self.west) / self.cell, 0, columns - 1)
        v = np.clip((self.north - xy[..., 1]) / self.cell, 0, rows - 1)
        i, j = np.minimum(v.astype(np.intp), rows - 2), np.minimum(u.astype(np.intp), columns - 2)
        a, b = v - i, u - j
        flat, first = self.heights.ravel(), i * columns + j
        top = flat[first] * (1 - b) + flat[first + 1] * b
        return top * (1 - a) + (flat[first + columns] * (1 - b) + flat[first + columns + 1] * b) * a

    def on_ground(self, xy: np.ndarray) -> np.ndarray:
        """Points (..., 3) m of the surface at ground positions (..., 2) m."""
        return np.concatenate([np.asarray(xy, float), self.height(xy)[..., None]], -1)

    def meet(self, centre: np.ndarray, directions: np.ndarray, tolerance: float = 1e-4) -> np.ndarray:
        """Points (..., 3) m where rays from `centre` (3,) along `directions` (..., 3) meet the surface, to `tolerance` [m] in Z.

        Secant steps on "ground under the ray minus ray" in height; they settle while the ground is flatter than the ray.
        Raises DegenerateGeometry for rays that do not point down, or where the ground is as steep as the ray.
        """
        if not np.all(directions[..., 2] < 0):
            raise DegenerateGeometry("a ray does not point down to the terrain; tilt the camera less")
        slope_x, slope_y = directions[..., 0] / directions[..., 2], directions[..., 1] / directions[..., 2]

        def ray(z: np.ndarray) -> np.ndarray:
            return np.stack([centre[0] + slope_x * (z - centre[2]), centre[1] + slope_y * (z - centre[2])], -1)

        before = np.full(directions.shape[:-1], float(self.heights.mean()))
        off_before = self.height(ray(before)) - before
        z = before + off_before
        for _ in range(_MAX_STEPS):
            xy = ray(z)
            off = self.height(xy) - z
            if np.abs(off).max() <= tolerance:
                return np.concatenate([xy, z[..., None]], -1)
            turn = off_before - off
            moved = np.abs(turn) > 1e-9
            gain = np.where(moved, (z - before) / np.where(moved, turn, 1.0), 1.0)
            before, off_before, z = z, off, z + off * np.clip(gain, 0.4, 2.5)
        raise DegenerateGeometry("rays do not settle on the terrain, it is as steep as they are; tilt the camera less")
