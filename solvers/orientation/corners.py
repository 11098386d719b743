"""The four image corners as control, from onboard GPS and IMU alone.

The method of "image registration by onboard GPS" (International Archives XXXIX-B7, 2012, p. 495): ground coordinates of the four
corners of every photo are computed from its GPS position and used as control. Printed for vertical photos, where
F = F_0 + (H_p/2 - 1/2) S_p H_g/c; here through the whole rotation, with the covariance that belongs to it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from ..block import Block, Prior
from ..cameras import Interior
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, exp
from .footprint import CORNERS, corner_pixels
from .initial import candidates
from .monoplot import Plane, partials, trace_ray
from .oriented import Known, Oriented, frame_of, local, vector_covariance
from .resection import Resection


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


def corner_orientation(block: Block, corners: CornerControl) -> Known:
    """The orientation that four weighted corners give their image, and its covariance: (A^T Sigma^-1 A)^-1 with
    Sigma = J_X C_X J_X^T, all twelve coordinates together.

    No other image sees these corners, so that to eliminate them from a bundle leaves exactly this observation of the image's
    exterior orientation. Raises DegenerateGeometry.
    """
    interior = block.camera_of(corners.image)
    frame = frame_of(block, {corners.image: Known(corners.image, Exterior(np.eye(3), corners.xyz.mean(axis=0)))})
    ground = frame.to_local(corners.xyz)
    mean = ground.mean(axis=0)
    found = candidates(ground - mean, interior.ideal(corners.pixels), interior.c)
    if not found:
        raise DegenerateGeometry(f"image '{corners.image}': its corners are control that no camera can see; write them anew")
    at, covariance = found[0].exterior.shifted(-mean), np.zeros((6, 6))
    for _ in range(20):
        linear = Resection(interior, ground, corners.pixels, np.broadcast_to(np.eye(2), (4, 2, 2))).linear(at.vector)
        j, jx = linear.j.reshape(8, 6), np.zeros((8, 12))
        for k in range(4):
            jx[2 * k:2 * k + 2, 3 * k:3 * k + 3] = -linear.j[k, :, :3]
        weight = np.linalg.inv(jx @ corners.covariance @ jx.T)
        covariance = np.linalg.inv(j.T @ weight @ j)
        step = covariance @ j.T @ weight @ linear.v.ravel()
        at = Exterior(exp(step[3:]) @ at.m, at.centre + step[:3])
        if step @ np.linalg.solve(covariance, step) < 1e-12:
            break
    return Known(corners.image, Exterior(at.m, frame.to_map(at.centre)), at.angle_covariance(covariance))


def with_corners(block: Block, corners: Iterable[CornerControl]) -> Block:
    """A block in which corners stand as weighted control: each image's four, their covariance kept whole, in the form of the
    prior they amount to (`corner_orientation`). For `adjust` with datum "prior" or "both", and for a mosaic."""
    priors = {}
    for c in corners:
        if c.image in priors:
            raise BadProject(f"image '{c.image}' has its corners twice; keep one set")
        o = corner_orientation(block, c)
        was = block.images[block.image_index(c.image)].prior or Prior()
        priors[c.image] = replace(was, centre=o.exterior.centre, angles=o.exterior.angles, sigma_m=None, sigma_rad=None,
                                  covariance=o.covariance)
    return replace(block, images=tuple(replace(i, prior=priors.get(i.name, i.prior)) for i in block.images))


def vertical_corners(interior: Interior, centre: np.ndarray, kappa: float, z: float) -> np.ndarray:
    """(4, 3) the printed formula, for a vertical photo: the corners scaled by height over c and turned by kappa [rad] only."""
    xy = interior.photo(corner_pixels(interior)) * (centre[2] - z) / interior.c
    turned = xy @ np.array([[np.cos(kappa), np.sin(kappa)], [-np.sin(kappa), np.cos(kappa)]])
    return np.column_stack([centre[:2] + turned, np.full(4, z)])
