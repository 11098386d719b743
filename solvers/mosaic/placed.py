"""A photo with its place: where a point of the ground appears in it, and what of the ground it shows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..cameras import Interior, project
from ..errors import DegenerateGeometry
from ..geometry import Exterior
from .bends import bent, straightened
from .registration import distorted, undistorted
from .surface import Ground

LOWEST = np.cos(np.radians(75.0))
"""Rays flatter than this (cosine of 75 degrees from the vertical) are left out: there the horizon begins."""
FARTHEST = 4.0
"""A photo placed by plane coefficients is used to this many times the depth of its centre."""
_EDGE = 24


@dataclass(frozen=True)
class Placed:
    """A photo with its interior orientation and either its exterior orientation (local frame) or a warp (3, 3): local X, Y, 1 on
    the plane -> undistorted pixel, third component positive where the photo sees the plane, and perhaps a bend."""

    name: str
    interior: Interior
    exterior: Exterior | None = None
    warp: np.ndarray | None = None
    bend: np.ndarray | None = None

    @cached_property
    def middle(self) -> np.ndarray:
        """(2,) undistorted pixel of the format's centre."""
        return undistorted(self.interior, np.array([self.interior.width - 1.0, self.interior.height - 1.0]) / 2)

    @cached_property
    def _deepest(self) -> float:
        assert self.warp is not None
        at = np.linalg.solve(self.warp, np.append(self.middle, 1.0))
        if not at[2] > 0:
            raise DegenerateGeometry(f"image '{self.name}': its centre looks above the horizon of the mosaic plane; leave it out")
        return FARTHEST / float(at[2])

    def pixels(self, local: np.ndarray) -> np.ndarray:
        """(..., 2) measured pixels of local points (..., 3) m; NaN behind the camera, near and beyond the horizon, beyond the
        distortion's range, and where the point is not finite."""
        if self.exterior is not None:
            ray = local - self.exterior.centre
            with np.errstate(invalid="ignore"):
                steep = -ray[..., 2] >= LOWEST * np.sqrt((ray**2).sum(-1))
            return project(self.interior, self.exterior, np.where(steep[..., None], local, np.nan))
        assert self.warp is not None
        q = local[..., :2] @ self.warp[:, :2].T + self.warp[:, 2]
        w = np.where((q[..., 2:] > 0) & (q[..., 2:] <= self._deepest), q[..., 2:], np.nan)
        straight = q[..., :2] / w
        return distorted(self.interior, straight if self.bend is None else bent(self.bend, self.interior, straight))

    def on_map(self, pixels: np.ndarray, ground: Ground) -> np.ndarray:
        """Map positions (n, 2) that pixels (n, 2) show; NaN near and beyond the horizon."""
        if self.exterior is not None:
            ideal = self.interior.ideal(pixels)
            rays = np.column_stack([ideal, np.full(len(ideal), -self.interior.c)]) @ self.exterior.m
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            return ground.meet(self.exterior.centre, np.where(rays[:, 2:] <= -LOWEST, rays, np.nan))
        assert self.warp is not None
        p = undistorted(self.interior, pixels)
        p = p if self.bend is None else straightened(self.bend, self.interior, p)
        q = np.column_stack([p, np.ones(len(p))]) @ np.linalg.inv(self.warp).T
        at = q[:, :2] / np.where(q[:, 2:] * self._deepest >= 1, q[:, 2:], np.nan)
        heights = np.zeros((len(at), 1))
        return ground.frame.to_map(np.concatenate([at, heights], 1))[:, :2]

    def outline(self, ground: Ground) -> tuple[np.ndarray, bool]:
        """Map positions (k, 2) around what the photo shows, not closed, and whether it is whole (no horizon in it).

        Raises DegenerateGeometry when it shows no ground.
        """
        at, whole = self.on_map(self._grid, ground).reshape(_EDGE + 1, _EDGE + 1, 2), True
        rim = np.concatenate([at[0, :-1], at[:-1, -1], at[-1, :0:-1], at[:0:-1, 0]])
        if not np.isfinite(rim).all():
            import cv2

            seen = at[np.isfinite(at).all(-1)]
            if len(seen) < 3:
                raise DegenerateGeometry(f"image '{self.name}': it shows the sky, or ground near the horizon only; leave it out")
            origin = seen.mean(0)
            rim = cv2.convexHull((seen - origin).astype(np.float32))[:, 0].astype(float) + origin
            whole = False
        return rim, whole

    @cached_property
    def _grid(self) -> np.ndarray:
        """Pixels of a net over the format, on its outer edges too."""
        t = np.linspace(0, 1, _EDGE + 1)
        x, y = np.meshgrid(t * self.interior.width - 0.5, t * self.interior.height - 0.5)
        return np.stack([x.ravel(), y.ravel()], -1)

    def resolution(self, ground: Ground) -> float:
        """Ground size of a pixel [m] at the photo's centre: the square root of its area; NaN where it shows no ground."""
        i = self.interior
        c = np.array([(i.width - 1) / 2, (i.height - 1) / 2])
        at = self.on_map(c + np.array([[-0.5, 0], [0.5, 0], [0, -0.5], [0, 0.5]]) * 8, ground)
        a, b = (at[1] - at[0]) / 8, (at[3] - at[2]) / 8
        return float(np.sqrt(abs(a[0] * b[1] - a[1] * b[0])))

    def foot(self, ground: Ground, outline: np.ndarray) -> np.ndarray:
        """(2,) map position that this photo shows best: below the camera where the photo shows it, else its middle."""
        middle = outline.mean(0)
        if self.exterior is None:
            i = self.interior
            at = self.on_map(np.array([[(i.width - 1) / 2, (i.height - 1) / 2]]), ground)[0]
            return at if np.isfinite(at).all() else middle
        below = ground.frame.to_map(self.exterior.centre)[:2]
        seen = self.pixels(ground.local(below[None]))[0]
        return below if np.isfinite(seen).all() and self.interior.inside(seen) else middle
