"""The conventions in which tools differ, each an enum that says it in words, and the way between them and ours.

Ours: M turns object axes into photo axes (x right, y up, z back), a position is the perspective centre, angles are omega, phi,
kappa, pixel (0, 0) is the centre of the top-left pixel, distortion coefficients correct measured coordinates.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from ...errors import BadTable
from ...geometry import Exterior
from ...geometry.rotation import angles as opk_of
from ...geometry.rotation import closest_rotation, rotation
from . import exact


class CameraAxes(Enum):
    """The axes of the camera that a rotation refers to."""

    PHOTO = "x right, y up, z back: the camera looks along -z (photogrammetry, OpenGL, Bundler, nerfstudio)"
    VISION = "x right, y down, z forward: the camera looks along z (OpenCV, COLMAP, OpenSfM, Metashape XML, MicMac, Bentley)"


class RotationDirection(Enum):
    """What a rotation matrix, a quaternion or a rotation vector turns into what."""

    OBJECT_TO_CAMERA = "object axes into camera axes: x = R (X - C) (Metashape OPK text, Bundler, COLMAP, OpenSfM, Bentley)"
    CAMERA_TO_OBJECT = "camera axes into object axes: X = C + R x (Metashape XML, nerfstudio, MicMac, Pix4D angles, PATB)"


class Position(Enum):
    """What the position of a camera is."""

    CENTRE = "the perspective centre in object coordinates"
    TRANSLATION = "the object origin in camera axes: t = -R C (COLMAP, Bundler, BAL, OpenSfM)"


class AngleOrder(Enum):
    """How three angles make the rotation; all turn the camera axes x right, y up, z back."""

    OPK = "omega about x, then phi about the turned y, then kappa about the twice turned z: M = Mk Mp Mo (primary omega)"
    POK = "phi about y, then omega about the turned x, then kappa about z: M = Mk Mo Mp (primary phi, right-handed)"
    POK_LEFT = "as phi-omega-kappa, with phi counted the other way round (Chinese textbooks)"


class AngleUnit(Enum):
    """The unit of angles; the value is radians per unit."""

    DEGREES = np.pi / 180
    GON = np.pi / 200
    RADIANS = 1.0


class PixelOrigin(Enum):
    """What pixel (0, 0) is; the value is what is subtracted to come to the centre."""

    CENTER = 0.0
    """The centre of the top-left pixel: OpenCV, Bentley, OPF marks, ours."""
    CORNER = 0.5
    """The outer corner of the top-left pixel, whose centre is (0.5, 0.5): COLMAP, Metashape, OPF and Pix4D principal points."""


class DistortionDirection(Enum):
    """What the distortion coefficients are applied to."""

    CORRECTS = "measured coordinates, giving ideal ones (Australis, ours, MicMac's DistM2C)"
    DISTORTS = "ideal coordinates, giving measured ones (OpenCV, Metashape, Pix4D, COLMAP, Bundler, OpenSfM, Bentley)"


_TO_PHOTO = {CameraAxes.PHOTO: np.eye(3), CameraAxes.VISION: np.diag([1.0, -1.0, -1.0])}


def exterior_from(r: np.ndarray, at: exact.Numbers, axes: CameraAxes, direction: RotationDirection, position: Position,
                  ) -> Exterior:
    """Our exterior orientation of another tool's rotation (3, 3) and position (3,).

    The rotation is made orthogonal to round-off. Raises BadTable where it is no rotation.
    """
    r = np.asarray(r, float).reshape(3, 3)
    if not np.isfinite(r).all() or np.abs(r @ r.T - np.eye(3)).max() > 1e-3 or np.linalg.det(r) < 0:
        raise BadTable("its rotation is not one (rows of length 1, at right angles, determinant +1); correct it")
    if position is Position.TRANSLATION:
        return exterior_of(exact.of_matrix(r if direction is RotationDirection.OBJECT_TO_CAMERA else r.T), at, axes)
    r = closest_rotation(r)
    r = r if direction is RotationDirection.OBJECT_TO_CAMERA else r.T
    return Exterior(_TO_PHOTO[axes] @ r, np.asarray(at, float))


def exterior_of(r: exact.Rows, t: exact.Numbers, axes: CameraAxes) -> Exterior:
    """Our exterior orientation of a rotation object to camera and t = -R C, both with all their digits."""
    return Exterior(_TO_PHOTO[axes] @ exact.floats(r), exact.centre(r, t))


def exterior_as(exterior: Exterior, axes: CameraAxes, direction: RotationDirection, position: Position,
                ) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (3, 3) and position (3,) as another tool has them: the inverse of `exterior_from`."""
    r = _TO_PHOTO[axes] @ exterior.m
    if position is Position.TRANSLATION:
        at = np.array([float(v) for v in exact.translation(exact.of_matrix(r), exterior.centre)])
    else:
        at = exterior.centre
    return (r if direction is RotationDirection.OBJECT_TO_CAMERA else r.T), at


def rotation_from(angles: np.ndarray, order: AngleOrder, unit: AngleUnit) -> np.ndarray:
    """M (3, 3) of three angles in the order in which the order names them (POK: phi, omega, kappa)."""
    first, second, kappa = np.asarray(angles, float) * unit.value
    if order is AngleOrder.OPK:
        return rotation(first, second, kappa)
    phi = first if order is AngleOrder.POK else -first
    return rotation(0, 0, kappa) @ rotation(second, 0, 0) @ rotation(0, phi, 0)


def angles_as(m: np.ndarray, order: AngleOrder, unit: AngleUnit) -> np.ndarray:
    """(3,) angles of M: the inverse of `rotation_from`; the last is 0 where the middle one is +-90 degrees."""
    if order is AngleOrder.OPK:
        return opk_of(m) / unit.value
    # m[2] = row z of M: (cos w sin p, -sin w, cos w cos p); m[:, 1] = (cos w sin k, cos w cos k, -sin w)
    level = np.hypot(m[2, 0], m[2, 2])
    omega = np.arctan2(-m[2, 1], level)
    if level < 1e-12:
        phi, kappa = np.arctan2(-m[0, 2], m[0, 0]), 0.0
    else:
        phi, kappa = np.arctan2(m[2, 0], m[2, 2]), np.arctan2(m[0, 1], m[1, 1])
    return np.array([phi if order is AngleOrder.POK else -phi, omega, kappa]) / unit.value


def quaternion_as(r: np.ndarray) -> np.ndarray:
    """(w, x, y, z), w >= 0, of a rotation (3, 3): the inverse of `exact.of_quaternion` (Shepperd 1978)."""
    t = np.trace(r)
    vee = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    outer = np.empty((4, 4))
    outer[0, 0], outer[0, 1:], outer[1:, 0] = 1 + t, vee, vee
    outer[1:, 1:] = r + r.T + (1 - t) * np.eye(3)
    q = outer[np.argmax(np.diag(outer))]
    return q / np.linalg.norm(q) * (1 if q[0] >= 0 else -1)
