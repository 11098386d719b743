"""Collinearity: object points to pixels through an exterior and a ten-parameter interior orientation, with derivatives.

Reference: FORMULAS sections 2 and 9. With (U, V, W) = M (X - X_C), W < 0 in front:
ideal x = -c U / W, ideal y = -c V / W; the measured point is where the correction gives the ideal one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import Exterior, skew
from .distortion import correct_derivatives, correct_jacobian, distort
from .interior import Interior


@dataclass(frozen=True)
class Projection:
    """Pixels (n, 2) and their derivatives; NaN where a point lies behind the camera or beyond the distortion's range.

    centre (n, 2, 3) px/m, rotation (n, 2, 3) px/rad (left rotation vector), point (n, 2, 3) px/m,
    interior (n, 2, 10) px per unit of each of `PARAMETERS`.
    """

    pixels: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    interior: np.ndarray

    @property
    def point(self) -> np.ndarray:
        """(n, 2, 3) derivatives by the object point: moving the point is moving the camera the other way."""
        return -self.centre


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
    u, v = uvw[:, 0], uvw[:, 1]
    w = np.where(uvw[:, 2] < 0, uvw[:, 2], np.nan)
    c, n = interior.c, len(uvw)
    by_uvw = np.zeros((n, 2, 3))
    by_uvw[:, 0, 0] = by_uvw[:, 1, 1] = -c / w
    by_uvw[:, 0, 2], by_uvw[:, 1, 2] = c * u / w**2, c * v / w**2
    ideal = np.stack([-c * u / w, -c * v / w], -1)
    coefficients = interior.coefficients
    reduced = distort(coefficients, ideal)  # measured, reduced to the principal point
    to_pixel = np.array([1.0, -1.0]) / interior.pitch
    if coefficients.any():
        inverse = np.linalg.inv(correct_jacobian(coefficients, reduced))
    else:
        inverse = np.broadcast_to(np.eye(2), (n, 2, 2))
    through = to_pixel[:, None] * inverse  # d pixel / d ideal
    by_camera = through @ by_uvw
    by_interior = np.empty((n, 2, 10))
    by_interior[:, :, 0] = (through @ (ideal / c)[:, :, None])[:, :, 0]
    by_interior[:, :, 1:3] = np.diag(to_pixel)
    by_interior[:, :, 3:] = -through @ correct_derivatives(reduced)
    return Projection(
        pixels=interior.pixels(reduced + interior.principal_point),
        centre=-by_camera @ exterior.m,
        rotation=-by_camera @ skew(uvw),
        interior=by_interior,
    )
