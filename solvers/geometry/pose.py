"""Exterior orientation: where the perspective centre is and how the photo is turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .rotation import angle_derivatives, angles, rotation


@dataclass(frozen=True)
class Exterior:
    """Exterior orientation: m (3, 3) turns object axes into photo axes; centre (3,) [m] in the object frame."""

    m: np.ndarray
    centre: np.ndarray

    @classmethod
    def from_angles(cls, omega: float, phi: float, kappa: float, centre: np.ndarray) -> Exterior:
        """Exterior orientation of omega, phi, kappa [rad] and the perspective centre (3,) [m]."""
        return cls(rotation(omega, phi, kappa), np.asarray(centre, float))

    @classmethod
    def from_vector(cls, x: np.ndarray) -> Exterior:
        """From the 12 numbers X, Y, Z, m11, m12 ... m33 as traces store them."""
        return cls(np.asarray(x[3:12], float).reshape(3, 3), np.asarray(x[:3], float))

    @property
    def vector(self) -> np.ndarray:
        """(12,) X, Y, Z, m11, m12 ... m33."""
        return np.concatenate([self.centre, self.m.ravel()])

    @property
    def angles(self) -> np.ndarray:
        """(3,) omega, phi, kappa [rad]."""
        return angles(self.m)

    def camera(self, points: np.ndarray) -> np.ndarray:
        """(U, V, W) (..., 3) [m] of object points (..., 3) in the photo's axes; W < 0 in front of the camera."""
        return (np.asarray(points, float) - self.centre) @ self.m.T

    def shifted(self, origin: np.ndarray) -> Exterior:
        """The same orientation with the object frame's origin moved to `origin` (3,) [m]."""
        return Exterior(self.m, self.centre - origin)

    def angle_covariance(self, covariance: np.ndarray) -> np.ndarray:
        """Covariance (6, 6) of X, Y, Z, omega, phi, kappa from that of (centre, left rotation vector)."""
        j = np.eye(6)
        j[3:, 3:] = angle_derivatives(self.m)
        return j @ covariance @ j.T


def to_opencv(exterior: Exterior) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) object -> camera and centre (3,) with the camera axes x right, y down, z forward.

    The one place where the photo frame (y up, z back) meets the frame of computer vision and the viewer.
    """
    return np.diag([1.0, -1.0, -1.0]) @ exterior.m, exterior.centre


def from_opencv(r: np.ndarray, centre: np.ndarray) -> Exterior:
    """Inverse of `to_opencv`."""
    return Exterior(np.diag([1.0, -1.0, -1.0]) @ r, np.asarray(centre, float))
