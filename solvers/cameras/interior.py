"""Interior orientation: one frozen value, and the way between pixels and the photo frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..errors import BadProject
from .distortion import TERMS, correct, correct_derivatives, correct_jacobian, distort

PARAMETERS = ("c", "xp", "yp", *TERMS)
"""The ten parameters (plus b1, b2) in their order everywhere; mm and powers of mm, see `distortion.TERMS`."""


@dataclass(frozen=True)
class Interior:
    """Interior orientation of a camera.

    c: principal distance [mm], > 0. xp, yp: principal point in the photo frame [mm] (origin at the format centre,
    x right, y up). k1..b2: ten-parameter correction, measured -> ideal, see `distortion`.
    pixel_mm: pixel pitch [mm], one number or (x, y). width, height: format [px].
    Raises BadProject when c, the pitch or the format is not positive and finite.
    """

    c: float
    xp: float = 0.0
    yp: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    b1: float = 0.0
    b2: float = 0.0
    pixel_mm: float | tuple[float, float] = field(kw_only=True)
    width: int = field(kw_only=True)
    height: int = field(kw_only=True)

    kind: ClassVar[str] = "correction"
    front: ClassVar[bool] = True  # only what lies in front is seen

    def __post_init__(self) -> None:
        pitch = tuple(float(p) for p in np.atleast_1d(np.asarray(self.pixel_mm, float)))
        pitch = pitch * 2 if len(pitch) == 1 else pitch
        object.__setattr__(self, "pixel_mm", pitch)
        if len(pitch) != 2 or not all(np.isfinite(p) and p > 0 for p in pitch):
            raise BadProject(f"pixel_mm is {self.pixel_mm}, expected one or two positive numbers in mm")
        if not (np.isfinite(self.c) and self.c > 0):
            raise BadProject(f"principal distance c is {self.c} mm, expected a positive number")
        if self.width < 1 or self.height < 1:
            raise BadProject(f"image format is {self.width} x {self.height} px, expected positive numbers of pixels")
        if not np.all(np.isfinite(self.parameters)):
            raise BadProject("an interior orientation parameter is not a finite number")

    @cached_property
    def pitch(self) -> np.ndarray:
        """(2,) pixel pitch in x and y, mm."""
        return np.array(np.broadcast_to(self.pixel_mm, (2,)), float)

    @cached_property
    def parameters(self) -> np.ndarray:
        """(10,) c, xp, yp, k1, k2, k3, p1, p2, b1, b2."""
        return np.array([getattr(self, name) for name in PARAMETERS], float)

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(7,) k1, k2, k3, p1, p2, b1, b2."""
        return self.parameters[3:]

    @cached_property
    def principal_point(self) -> np.ndarray:
        """(2,) mm, photo frame."""
        return np.array([self.xp, self.yp])

    @cached_property
    def _axes(self) -> np.ndarray:
        """(2,) mm of the photo frame per pixel: y goes up where rows go down."""
        return self.pitch * [1.0, -1.0]

    @cached_property
    def _centre(self) -> np.ndarray:
        """(2,) pixel of the format centre."""
        return np.array([self.width - 1, self.height - 1]) / 2

    def photo(self, pixels: np.ndarray) -> np.ndarray:
        """Photo coordinates (..., 2) mm of pixels (..., 2) (col, row), (0, 0) = centre of the top-left pixel."""
        return (np.asarray(pixels, float) - self._centre) * self._axes

    def pixels(self, photo: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of photo coordinates (..., 2) mm: the inverse of `photo`."""
        return np.asarray(photo, float) / self._axes + self._centre

    def ideal(self, pixels: np.ndarray) -> np.ndarray:
        """Ideal coordinates (..., 2) mm: pixels corrected for distortion and reduced to the principal point."""
        return self.undistorted(self.photo(pixels) - self.principal_point)

    def measured(self, ideal: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) at which ideal coordinates (..., 2) mm appear: the inverse of `ideal` (NaN where there is none)."""
        return self.pixels(self.distorted(np.asarray(ideal, float)) + self.principal_point)

    def distorted(self, ideal: np.ndarray) -> np.ndarray:
        """Measured coordinates (..., 2) mm, reduced, of ideal ones (..., 2) mm; NaN where there are none."""
        return distort(self.coefficients, ideal)

    def undistorted(self, reduced: np.ndarray) -> np.ndarray:
        """Ideal coordinates (..., 2) mm of measured, reduced ones (..., 2) mm."""
        return correct(self.coefficients, reduced)

    def slope(self, ideal: np.ndarray, reduced: np.ndarray) -> np.ndarray:
        """(n, 2, 2) d measured / d ideal."""
        return np.linalg.inv(correct_jacobian(self.coefficients, reduced))

    def by_parameters(self, ideal: np.ndarray, reduced: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """(n, 2, 8) d measured / d(c, k1 .. b2); the object point stays where it is."""
        by_c = slope @ (ideal / self.c)[:, :, None]
        return np.concatenate([by_c, -slope @ correct_derivatives(reduced)], axis=2)

    def inside(self, pixels: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """(...,) whether pixels lie on the format, pixel edges included, with a margin in pixels."""
        p = np.asarray(pixels, float)
        low, high = -0.5 - margin, np.array([self.width, self.height]) - 0.5 + margin
        return np.all((p >= low) & (p <= high), axis=-1)
