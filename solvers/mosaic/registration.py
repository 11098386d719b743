"""Where every photo of a mosaic lies: the value that registration gives and composition takes.

Mosaic plane: X to the right (east), Y up (north), in the unit of the registration, from the local origin of `frame`.
Undistorted pixels are what an ideal camera with the same principal distance, principal point and pitch would have measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from ..adjustment import Trace
from ..cameras import Interior, project
from ..geometry import Exterior, LocalFrame
from .bends import bent, straightened

Kind = Literal["plane", "exterior"]
Level = Literal["uncontrolled", "semicontrolled", "controlled"]
Method = Literal["sequential", "simultaneous"]


def undistorted(interior: Interior, pixels: np.ndarray) -> np.ndarray:
    """(..., 2) undistorted pixels of measured pixels (..., 2)."""
    return interior.pixels(interior.ideal(pixels) + interior.principal_point) if interior.coefficients.any() else np.array(pixels)


def distorted(interior: Interior, pixels: np.ndarray) -> np.ndarray:
    """(..., 2) measured pixels of undistorted ones: the inverse of `undistorted`, NaN beyond the distortion's range."""
    if not interior.coefficients.any():
        return np.array(pixels)
    return interior.measured(interior.photo(pixels) - interior.principal_point)


@dataclass(frozen=True)
class Registration:
    """Photos registered to one mosaic plane.

    kind: "plane" (eight plane coefficients per photo) or "exterior" (exterior orientations). names, interiors: of the n photos
    that are used; the interior carries the distortion (of kind "plane" without a known camera: an ideal one of the photo's
    size). homographies (n, 3, 3), kind "plane": mosaic plane X, Y, 1 -> UNDISTORTED pixel col, row, 1 up to scale, positive
    where the photo sees the plane. exteriors, kind "exterior": in the local frame [m]. plane (3,): z0, zx, zy of the mosaic
    plane Z = z0 + zx X + zy Y, local. frame: the local frame; local + frame.origin (or frame.to_map) is the map. unit: of X
    and Y, "m", or "px" of the reference photo where nothing gives the scale. covariance (n, k, k): of each photo, k = 8 for
    plane coefficients: d11 d12 d13 d21 d22 d23 d31 d32 of H <- (I + D) H, H from the mosaic plane to ideal photo coordinates
    over c (x right, y up), or k = 14 these and the bend [px], or k = 6 centre and left rotation vector; NaN of a sequential
    registration. trace: every step.
    corner_sigma (n,): predicted standard error [unit] of the photo's corners on the mosaic, the
    noise alone. unused: photos that take no part, and why. rejected: control points left out. rms_px:
    of the tie points. bends (n, 6), kind "plane": what each photo differs by from a central projection, see `bends`; None: not.
    """

    kind: Kind
    level: Level
    method: Method
    names: tuple[str, ...]
    interiors: tuple[Interior, ...]
    homographies: np.ndarray | None
    exteriors: tuple[Exterior, ...]
    plane: np.ndarray
    frame: LocalFrame
    unit: Literal["m", "px"]
    covariance: np.ndarray
    corner_sigma: np.ndarray
    rms_px: float
    trace: Trace
    warnings: tuple[str, ...] = ()
    unused: Mapping[str, str] = field(default_factory=dict)
    rejected: tuple[str, ...] = ()
    bends: np.ndarray | None = None

    @property
    def crs(self) -> str:
        """EPSG code of the map, or "local"."""
        return self.frame.crs

    @cached_property
    def warps(self) -> np.ndarray:
        """(n, 3, 3) mosaic plane X, Y, 1 -> undistorted pixel col, row, 1 up to scale, whatever the kind; the third component
        is positive where the photo sees the plane (docs/formulas.md 6.1)."""
        if self.homographies is not None:
            return self.homographies
        return np.array([plane_warp(i, e, self.plane) for i, e in zip(self.interiors, self.exteriors, strict=True)])

    def heights(self, xy: np.ndarray) -> np.ndarray:
        """(...,) local Z of the mosaic plane at X, Y (..., 2)."""
        xy = np.asarray(xy, float)
        return self.plane[0] + xy @ self.plane[1:]

    def to_pixels(self, photo: int, at: np.ndarray) -> np.ndarray:
        """(..., 2) measured pixels (col, row) of a photo for X, Y (..., 2) on the mosaic plane or, of kind "exterior", X, Y, Z
        (..., 3) anywhere, local; NaN where the photo cannot see them."""
        at, interior = np.asarray(at, float), self.interiors[photo]
        if at.shape[-1] == 3:
            return project(interior, self.exteriors[photo], at)
        q = at @ self.warps[photo][:, :2].T + self.warps[photo][:, 2]
        w = np.where(q[..., 2:] > 0, q[..., 2:], np.nan)
        straight = q[..., :2] / w
        return distorted(interior, straight if self.bends is None else bent(self.bends[photo], interior, straight))

    def on_plane(self, photo: int, pixels: np.ndarray) -> np.ndarray:
        """(..., 2) X, Y on the mosaic plane of measured pixels (..., 2); NaN at and beyond the horizon."""
        p = self.straight(photo, np.asarray(pixels, float))
        inverse = np.linalg.inv(self.warps[photo])
        q = p @ inverse[:, :2].T + inverse[:, 2]
        return q[..., :2] / np.where(q[..., 2:] > 0, q[..., 2:], np.nan)

    def straight(self, photo: int, pixels: np.ndarray) -> np.ndarray:
        """(..., 2) pixels of a central projection for measured ones: undistorted, and without the photo's bend."""
        p = undistorted(self.interiors[photo], pixels)
        return p if self.bends is None else straightened(self.bends[photo], self.interiors[photo], p)

    def footprint(self, photo: int) -> np.ndarray:
        """(4, 2) X, Y of the photo's outer corners (pixel edges): top left, top right, bottom right, bottom left; NaN for a
        corner beyond the horizon."""
        i = self.interiors[photo]
        return self.on_plane(photo, np.array([[0, 0], [i.width, 0], [i.width, i.height], [0, i.height]]) - 0.5)


def plane_warp(interior: Interior, exterior: Exterior, plane: np.ndarray) -> np.ndarray:
    """(3, 3) plane X, Y, 1 -> undistorted pixel col, row, 1 up to scale, its third component positive in front of the camera.

    plane (3,): z0, zx, zy. Reference: docs/formulas.md 6.1, eq. (13) of the planar collinearity equations.
    """
    onto = np.array([[1.0, 0, -exterior.centre[0]], [0, 1.0, -exterior.centre[1]],
                     [plane[1], plane[2], plane[0] - exterior.centre[2]]])
    (px, py), (xp, yp) = interior.pitch, interior.principal_point
    # photo (x, y) = -c (U, V) / W + principal point; -W > 0 in front
    camera = np.array([[interior.c / px, 0, -(xp / px + (interior.width - 1) / 2)],
                       [0, -interior.c / py, -(-yp / py + (interior.height - 1) / 2)], [0, 0, -1.0]])
    return camera @ exterior.m @ onto
