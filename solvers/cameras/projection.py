"""Collinearity: object points to pixels through an exterior and a ten-parameter interior orientation, with derivatives.

Reference: FORMULAS sections 2 and 9. With (U, V, W) = M (X - X_C), W < 0 in front:
ideal x = -c U / W, ideal y = -c V / W; the measured point is where the correction gives the ideal one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry import Exterior, skew
from .distortion import correct_derivatives, correct_jacobian, distort
from .interior import Interior


@dataclass(frozen=True)
class Projection:
    """Pixels (n, 2) and their derivatives; NaN where a point lies behind the camera or beyond the distortion's range.

    centre (n, 2, 3) px/m, rotation (n, 2, 3) px/rad (left rotation vector). camera, ideal (n, 2), reduced (n, 2) mm and
    by_ideal (n, 2, 2) px/mm are what the derivatives by the interior orientation are made of.
    """

    pixels: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    camera: Interior
    ideal: np.ndarray
    reduced: np.ndarray
    by_ideal: np.ndarray

    @property
    def point(self) -> np.ndarray:
        """(n, 2, 3) derivatives by the object point: moving the point is moving the camera the other way."""
        return -self.centre

    @cached_property
    def interior(self) -> np.ndarray:
        """(n, 2, 10) px per unit of each of `PARAMETERS`; made only when asked for."""
        out = np.empty((len(self.ideal), 2, 10))
        out[:, :, 0] = (self.by_ideal @ (self.ideal / self.camera.c)[:, :, None])[:, :, 0]
        out[:, :, 1:3] = np.diag([1.0, -1.0] / self.camera.pitch)
        out[:, :, 3:] = -self.by_ideal @ correct_derivatives(self.reduced)
        return out


def ideal_photo(c: float, exterior: Exterior, points: np.ndarray) -> np.ndarray:
    """Ideal photo coordinates (..., 2) mm of object points (..., 3) m; NaN behind the camera."""
    uvw = exterior.camera(points)
    w = np.where(uvw[..., 2] < 0, uvw[..., 2], np.nan)
    return -c * uvw[..., :2] / w[..., None]


def project(interior: Interior, exterior: Exterior, points: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of object points (..., 3) m; NaN behind the camera or beyond the distortion's range."""
    return interior.measured(ideal_photo(interior.c, exterior, points))


def project_derivatives(interior: Interior, exterior: Exterior, points: np.ndarray) -> Projection:
    """Pixels of object points (n, 3) m with all derivatives, exact for the ten-parameter model."""
    uvw = exterior.camera(points)
    c, n, w = interior.c, len(uvw), uvw[:, 2]
    per_depth = c / np.where(w < 0, -w, np.nan)
    ideal = uvw[:, :2] * per_depth[:, None]
    reduced = distort(interior.coefficients, ideal)  # measured, reduced to the principal point
    by_ideal = np.broadcast_to(np.diag([1.0, -1.0] / interior.pitch), (n, 2, 2))
    if interior.coefficients.any():
        by_ideal = by_ideal @ np.linalg.inv(correct_jacobian(interior.coefficients, reduced))
    by_uvw = np.zeros((n, 2, 3))
    by_uvw[:, 0, 0] = by_uvw[:, 1, 1] = per_depth
    by_uvw[:, :, 2] = ideal * (per_depth / c)[:, None]
    by_camera = by_ideal @ by_uvw
    return Projection(
        pixels=interior.pixels(reduced + interior.principal_point),
        centre=-by_camera @ exterior.m,
        rotation=-by_camera @ skew(uvw),
        camera=interior, ideal=ideal, reduced=reduced, by_ideal=by_ideal,
    )
