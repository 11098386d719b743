"""The surface a mosaic lies on: a level or tilted plane, or a height grid; and the way from the map to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import BadProject, DegenerateGeometry
from ..geometry import LocalFrame, Surface

FLATNESS = 1e-6
"""Least ratio of the spread of points across to that along, below which no tilted plane is fitted to them."""


@dataclass(frozen=True)
class MosaicPlane:
    """Plane Z = z + slope_x X + slope_y Y in the local frame [m]; sigma: standard deviation of the points it fits [m]."""

    z: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    sigma: float = 0.0

    def heights(self, xy: np.ndarray) -> np.ndarray:
        """(...,) local Z at local X, Y (..., 2)."""
        return self.z + self.slope_x * xy[..., 0] + self.slope_y * xy[..., 1]


def fit_plane(points: np.ndarray, weights: np.ndarray | None = None, tilted: bool = True) -> MosaicPlane:
    """The plane that fits points (n, 3) m, local, best: least squares in Z, with weights (n,).

    tilted False: a level one. Raises DegenerateGeometry when fewer than three points, or points on one line, would tilt it.
    """
    p = np.asarray(points, float)
    w = np.ones(len(p)) if weights is None else np.asarray(weights, float)
    if not len(p) or not w.sum() > 0:
        raise DegenerateGeometry("no point gives the mosaic plane its height; give it in metres")
    mean = w @ p / w.sum()
    if not tilted:
        level, d = float(mean[2]), p[:, 2] - mean[2]
        return MosaicPlane(level, sigma=float(np.sqrt(d @ (w * d) / max((w > 0).sum() - 1, 1) / w.mean())))
    a = (p - mean)[:, :2] * np.sqrt(w)[:, None]
    spread = np.linalg.svd(a, compute_uv=False)
    if len(p) < 3 or spread[1] <= FLATNESS * spread[0]:
        raise DegenerateGeometry(f"{len(p)} points on one line do not tilt a plane; give its height in metres, or points beside "
                                 "the line")
    b = (p[:, 2] - mean[2]) * np.sqrt(w)
    slope = np.linalg.lstsq(a, b, rcond=None)[0]
    sigma = np.sqrt(((b - a @ slope) ** 2).sum() / max(len(p) - 3, 1) / w.mean())
    return MosaicPlane(float(mean[2] - slope @ mean[:2]), float(slope[0]), float(slope[1]), float(sigma))


@dataclass(frozen=True)
class Ground:
    """A surface and the frame that map and photos meet in. surface: in the local frame (plane) or on the map (height grid)."""

    frame: LocalFrame
    surface: MosaicPlane | Surface

    def __post_init__(self) -> None:
        if isinstance(self.surface, Surface) and "local" not in (self.frame.crs, self.surface.grid.crs) and \
                self.surface.grid.crs != self.frame.crs:
            raise BadProject(f"{self.surface.name}: its crs is '{self.surface.grid.crs}' and the mosaic's is '{self.frame.crs}'; "
                             "warp the DEM to the crs of the mosaic")

    @property
    def flat(self) -> bool:
        """Whether local and map coordinates of a level plane differ by a shift only."""
        return self.frame.cartesian and isinstance(self.surface, MosaicPlane)

    def local(self, xy: np.ndarray) -> np.ndarray:
        """Local points (..., 3) m of the surface at map positions (..., 2) m; NaN where it has no height."""
        xy = np.asarray(xy, float)
        if isinstance(self.surface, Surface):
            return self.frame.to_local(np.concatenate([xy, self.surface.sample(xy)[..., None]], -1))
        out = np.concatenate([xy, np.full((*xy.shape[:-1], 1), self.frame.origin[2])], -1)
        at = out
        for _ in range(1 if self.frame.cartesian else 2):  # the plane is local: its height over the map bends with the earth
            at = self.frame.to_local(out)
            at[..., 2] = self.surface.heights(at[..., :2])
            if not self.frame.cartesian:
                out[..., 2] = self.frame.to_map(at)[..., 2]
        return at

    def meet(self, centre: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Map positions (n, 2) where local rays (n, 3) from a centre (3,) meet the surface; NaN for those that do not go down.

        A plane exactly; a height grid by steps on its height under the ray, good to a fraction of a cell: for outlines.
        """
        down = np.where(rays[:, 2:] < 0, rays, np.nan)
        if isinstance(self.surface, MosaicPlane):
            s = self.surface
            normal = np.array([-s.slope_x, -s.slope_y, 1.0])
            fall = down @ normal
            t = (s.z - centre @ normal) / np.where(fall < 0, fall, np.nan)
            return self.frame.to_map(centre + np.where(t > 0, t, np.nan)[:, None] * down)[:, :2]
        low, high = self.surface.range
        z = np.full(len(down), (low + high) / 2)
        for step in range(20):
            at = self._level(centre, down, z)
            below = self.surface.sample(at)
            z = z + (1.0 if step < 5 else 0.5) * np.where(np.isfinite(below), below - z, 0.0)
        return self._level(centre, down, z)

    def _level(self, centre: np.ndarray, down: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Map positions (n, 2) of rays at map heights (n,)."""
        t = (z - self.frame.origin[2] - centre[2]) / down[:, 2]
        at = centre + t[:, None] * down
        if not self.frame.cartesian:
            off = self.frame.to_map(at)[:, 2] - z
            at = centre + (t - off / down[:, 2])[:, None] * down
        return self.frame.to_map(at)[:, :2]
