"""The four image corners as control, from onboard GPS and IMU alone, and what control of each grade is worth.

The method of "image registration by onboard GPS" (International Archives XXXIX-B7, 2012, p. 495): ground coordinates of the four
corners of every photo are computed from its GPS position and used as control. Printed for vertical photos, where
F = F_0 + (H_p/2 - 1/2) S_p H_g/c; here through the whole rotation, with the covariance that belongs to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..block import Block, Image, Observations, Points
from ..cameras import Interior, project
from ..errors import DegenerateGeometry
from ..geometry import Exterior, exp
from .footprint import CORNERS, corner_pixels
from .intersection import intersect
from .monoplot import Plane, partials, trace_ray
from .oriented import Known, Oriented, frame_of, local, vector_covariance
from .single import Request, orient


@dataclass(frozen=True)
class CornerControl:
    """Corners of one image as control. names: image and corner F1 to F4 (`CORNERS`); xyz (4, 3): project coordinates [m];
    covariance (12, 12) m^2 of X1, Y1, Z1, X2 ...: the four move together with the image's orientation; pixels (4, 2)."""

    image: str
    names: tuple[str, ...]
    xyz: np.ndarray
    covariance: np.ndarray
    pixels: np.ndarray

    @property
    def sigma(self) -> np.ndarray:
        """(4, 3) standard errors of the single coordinates [m]: alone they hide that the corners move together."""
        return np.sqrt(np.diag(self.covariance)).reshape(4, 3)


def corner_control(block: Block, oriented: Oriented, z: float, sigma_z: float, sigma_px: float = 0.5) -> CornerControl:
    """Ground coordinates of the corner pixels' centres on level ground, with their whole covariance.

    z: height of the ground; sigma_z: how far the single corners' ground departs from it (relief), independent; sigma_px: how
    sharply a corner is taken to be measured. Both keep the covariance regular. Raises DegenerateGeometry (horizon).
    """
    interior, frame = block.camera_of(oriented.image), frame_of(block, {oriented.image: oriented})
    at, covariance = local(oriented, frame), vector_covariance(oriented)
    pixels = corner_pixels(interior)
    cov, by_orientation, xyz = np.zeros((12, 12)), np.zeros((12, 6)), np.zeros((4, 3))
    for k, p in enumerate(pixels):
        hit, rows = trace_ray(oriented.image, interior, at, frame, (p[0], p[1]), Plane(z)), slice(3 * k, 3 * k + 3)
        by = partials(interior, at, p, hit.distance, np.array([0.0, 0.0, 1.0]))
        xyz[k], by_orientation[rows] = hit.ground, by.orientation
        cov[rows, rows] = by.pixel @ by.pixel.T * sigma_px**2 + np.outer(by.height, by.height) * sigma_z**2
    if covariance is not None:
        cov += by_orientation @ covariance @ by_orientation.T
    return CornerControl(oriented.image, tuple(f"{oriented.image} F{k + 1} {c}" for k, c in enumerate(CORNERS)), xyz,
                         (cov + cov.T) / 2, pixels)


def vertical_corners(interior: Interior, centre: np.ndarray, kappa: float, z: float) -> np.ndarray:
    """(4, 3) the printed formula, for a vertical photo: the corners scaled by height over c and turned by kappa [rad] only."""
    xy = interior.photo(corner_pixels(interior)) * (centre[2] - z) / interior.c
    turned = xy @ np.array([[np.cos(kappa), np.sin(kappa)], [-np.sin(kappa), np.cos(kappa)]])
    return np.column_stack([centre[:2] + turned, np.full(4, z)])


# -- what control of each grade is worth ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Flight:
    """A simulated flight with its truth. exteriors: one per image, local metres; control (n, 3), check (k, 3) m on the ground;
    z: mean height of the ground, relief: its departure from it [m]."""

    interior: Interior
    exteriors: tuple[Exterior, ...]
    control: np.ndarray
    check: np.ndarray
    z: float
    relief: float
    image_px: float = 0.5


@dataclass(frozen=True)
class Grade:
    """Errors at independent check points [m]: horizontal and vertical root mean square, the same as the covariances predict
    (None where a method states none), how many check points, and failed images."""

    method: str
    rms_horizontal: float
    rms_vertical: float
    predicted_horizontal: float | None
    predicted_vertical: float | None
    points: int
    images: int


def compare_control(flight: Flight, rng: np.random.Generator, *, gps_m: Sequence[float] = (3.0, 3.0, 5.0),
                    imu_deg: Sequence[float] = (1.0, 1.0, 3.0), coarse_m: Sequence[float] = (2.5, 2.5, 5.0),
                    surveyed_m: Sequence[float] = (0.02, 0.02, 0.03)) -> tuple[Grade, ...]:
    """Check points intersected from images oriented in five ways, one draw of all errors.

    Vertical corners (the printed formula), onboard GPS and IMU (whole rotation), the corners of it as correlated control
    (the same thing, as it must be), coarse control (map or satellite image grade) and surveyed control. The three onboard
    methods share one draw of GPS and IMU errors.
    """
    block, control_of = _simulated(flight, rng), len(flight.control)
    onboard = tuple(_disturbed(f"i{k}", e, np.array(gps_m), np.radians(imu_deg), rng) for k, e in enumerate(flight.exteriors))
    out = []
    vertical = [_from_corners(block, o.image,
                              vertical_corners(flight.interior, o.exterior.centre, float(o.exterior.angles[2]), flight.z), None)
                for o in onboard]
    out.append(_graded("vertical corners (printed formula)", block, vertical, flight))
    out.append(_graded("onboard GPS and IMU", block, onboard, flight))
    corners = [corner_control(block, o, flight.z, flight.relief) for o in onboard]
    out.append(_graded("onboard corners as correlated control", block,
                       [_from_corners(block, c.image, c.xyz, c.covariance) for c in corners], flight))
    for name, sigma in (("coarse control", coarse_m), ("surveyed control", surveyed_m)):
        moved = flight.control + np.array(sigma) * rng.standard_normal((control_of, 3))
        points = replace(block.points, xyz=np.vstack([moved, flight.check]),
                         sigma=np.vstack([np.broadcast_to(sigma, (control_of, 3)), np.full((len(flight.check), 3), np.nan)]))
        graded = replace(block, points=points)
        solved = [_resected(graded, i.name) for i in block.images]
        out.append(_graded(name, block, [o for o in solved if o is not None], flight))
    return tuple(out)


def _simulated(flight: Flight, rng: np.random.Generator) -> Block:
    """Measurements of everything each image sees; all points stated at their truth."""
    xyz, n = np.vstack([flight.control, flight.check]), len(flight.control)
    image, point, pixel = [], [], []
    for k, e in enumerate(flight.exteriors):
        at = project(flight.interior, e, xyz)
        seen = np.flatnonzero(np.isfinite(at).all(axis=1) & flight.interior.inside(at))
        image += [k] * len(seen)
        point += list(seen)
        pixel.append(at[seen] + flight.image_px * rng.standard_normal((len(seen), 2)))
    return Block("flight", "local", {"cam": flight.interior}, tuple(Image(f"i{k}", "cam") for k in range(len(flight.exteriors))),
                 Points(tuple(f"P{k}" for k in range(len(xyz))), xyz, np.full((len(xyz), 3), np.nan),
                        ("control",) * n + ("check",) * (len(xyz) - n)),
                 Observations(np.array(image, int), np.array(point, int), np.vstack(pixel), np.full(len(image), flight.image_px)))


def _disturbed(image: str, true: Exterior, sigma_m: np.ndarray, sigma_rad: np.ndarray, rng: np.random.Generator) -> Known:
    """An orientation with GPS and IMU errors (tilt about north, about east, yaw) and the covariance that says so."""
    d = sigma_rad * rng.standard_normal(3)
    given = Exterior(true.m @ exp(d), true.centre + sigma_m * rng.standard_normal(3))
    cov = np.zeros((6, 6))
    cov[:3, :3], cov[3:, 3:] = np.diag(sigma_m**2), given.m @ np.diag(sigma_rad**2) @ given.m.T
    return Known(image, given, given.angle_covariance(cov))


def _from_corners(block: Block, image: str, xyz: np.ndarray, covariance: np.ndarray | None) -> Known:
    """Orientation of an image by its four corners as control: weighted by their whole covariance, or each alike.

    The corners are exact images of themselves, so the adjustment with correlated control fits them without residual and its
    covariance is (A^T Sigma^-1 A)^-1 with A = d corners / d orientation through the projection.
    """
    from .resection import Resection

    interior = block.camera_of(image)
    single = Block("corners", "local", block.cameras, (Image(image, "cam"),),
                   Points(("F1", "F2", "F3", "F4"), xyz, np.full((4, 3), 1.0), ("control",) * 4),
                   Observations(np.zeros(4, int), np.arange(4), corner_pixels(interior), np.full(4, block.image_px)))
    at = orient(single, Request(image)).exterior
    if covariance is None:
        return Known(image, at)
    linear = Resection(interior, xyz, corner_pixels(interior), np.broadcast_to(np.eye(2), (4, 2, 2))).linear(
        np.concatenate([at.centre, at.m.ravel()]))
    j, jx = linear.j.reshape(8, 6), np.zeros((8, 12))
    for k in range(4):
        jx[2 * k:2 * k + 2, 3 * k:3 * k + 3] = -linear.j[k, :, :3]
    p = np.linalg.inv(jx @ covariance @ jx.T)
    return Known(image, at, at.angle_covariance(np.linalg.inv(j.T @ p @ j)))


def _resected(block: Block, image: str) -> Known | None:
    try:
        o = orient(block, Request(image))
    except DegenerateGeometry:
        return None
    return Known(image, o.exterior, o.covariance)


def _graded(method: str, block: Block, oriented: Sequence[Known], flight: Flight) -> Grade:
    """Errors of the check points that two or more images see."""
    names = block.points.names[len(flight.control):]
    try:
        points = [p for p in intersect(block, oriented).points if p.name in names]
    except DegenerateGeometry:
        points = []
    if not points:
        return Grade(method, float("nan"), float("nan"), None, None, 0, len(oriented))
    error = np.array([p.xyz - p.given for p in points])
    var = np.array([np.diag(p.covariance) for p in points]).mean(axis=0)
    stated = all(o.covariance is not None for o in oriented)
    rms = np.sqrt((error**2).mean(axis=0))
    return Grade(method, float(np.hypot(rms[0], rms[1])), float(rms[2]), float(np.sqrt(var[0] + var[1])) if stated else None,
                 float(np.sqrt(var[2])) if stated else None, len(points), len(oriented))
