"""Collinearity: object points to pixels through an exterior and a ten-parameter interior orientation, with derivatives.

Reference: docs/formulas.md 2 and 9. With (U, V, W) = M (X - X_C), W < 0 in front:
ideal x = -c U / W, ideal y = -c V / W; the measured point is where the correction gives the ideal one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry import Exterior, skew
from .interior import Interior


@dataclass(frozen=True)
class Projection:
    """Pixels (n, 2) and their derivatives; NaN where a point lies behind the camera or beyond the distortion's range.

    centre (n, 2, 3) px/m, rotation (n, 2, 3) px/rad (left rotation vector). camera, ideal (n, 2), reduced (n, 2) mm and
    slope (n, 2, 2) d reduced / d ideal are what the derivatives by the interior orientation are made of.
    """

    pixels: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    camera: Interior
    ideal: np.ndarray
    reduced: np.ndarray
    slope: np.ndarray

    @property
    def point(self) -> np.ndarray:
        """(n, 2, 3) derivatives by the object point: moving the point is moving the camera the other way."""
        return -self.centre

    @cached_property
    def interior(self) -> np.ndarray:
        """(n, 2, 10) px per unit of each of `PARAMETERS`; made only when asked for."""
        to_pixels = np.diag([1.0, -1.0] / self.camera.pitch)
        out = np.empty((len(self.ideal), 2, 10))
        out[:, :, 1:3] = to_pixels
        out[:, :, [0, *range(3, 10)]] = to_pixels @ self.camera.by_parameters(self.ideal, self.reduced, self.slope)
        return out


def ideal_photo(c: float, exterior: Exterior, points: np.ndarray, front: bool = True) -> np.ndarray:
    """Ideal photo coordinates (..., 2) mm of object points (..., 3) m; NaN behind the camera (unless told not to)."""
    uvw = exterior.camera(points)
    w = _depths(uvw[..., 2], front)
    return -c * uvw[..., :2] / w[..., None]


def project(interior: Interior, exterior: Exterior, points: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of object points (..., 3) m; NaN behind the camera or beyond the distortion's range."""
    return interior.measured(ideal_photo(interior.c, exterior, points, interior.front))


def _depths(w: np.ndarray, front: bool) -> np.ndarray:
    """Coordinates along the axis, NaN where nothing is seen."""
    return np.where(w < 0 if front else w != 0, w, np.nan)


def project_derivatives(interior: Interior, exterior: Exterior, points: np.ndarray) -> Projection:
    """Pixels of object points (n, 3) m with all derivatives, exact for the ten-parameter model."""
    uvw = exterior.camera(points)
    c, n, w = interior.c, len(uvw), uvw[:, 2]
    per_depth = -c / _depths(w, interior.front)
    ideal = uvw[:, :2] * per_depth[:, None]
    reduced = interior.distorted(ideal)
    slope = np.broadcast_to(np.eye(2), (n, 2, 2))
    by_camera = np.zeros((n, 2, 3))  # of the ideal coordinates first
    by_camera[:, 0, 0] = by_camera[:, 1, 1] = per_depth
    by_camera[:, :, 2] = ideal * (per_depth / c)[:, None]
    if interior.coefficients.any():
        slope = interior.slope(ideal, reduced)
        by_camera = slope @ by_camera
    by_camera *= ([1.0, -1.0] / interior.pitch)[:, None]
    return Projection(
        pixels=interior.pixels(reduced + interior.principal_point),
        centre=-by_camera @ exterior.m,
        rotation=-by_camera @ skew(uvw),
        camera=interior, ideal=ideal, reduced=reduced, slope=slope,
    )
