"""The other direction of distortion: ideal -> measured, in pixels, as OpenCV, Metashape, Pix4D and COLMAP have it.

x, y are normalised camera coordinates (x right, y down, z forward, divided by z). With r^2 = x^2 + y^2 and
s = (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) / (1 + d1 r^2 + d2 r^4 + d3 r^6):
x' = s x + 2 p1 x y + p2 (r^2 + 2 x^2),  y' = s y + p1 (r^2 + 2 y^2) + 2 p2 x y,  col = cx + fx x' + skew y',  row = cy + fy y'.
Reference: OpenCV 4 documentation, "Camera Calibration and 3D Reconstruction" (p1, p2 are swapped in Metashape and Bentley).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import BadProject

RADIAL = ("k1", "k2", "k3", "k4")
RATIONAL = ("d1", "d2", "d3")
DECENTRING = ("p1", "p2")
COEFFICIENTS = (*RADIAL, *RATIONAL, *DECENTRING)


@dataclass(frozen=True)
class Brown:
    """Camera of another tool. fx, fy, cx, cy, skew: pixels, (0, 0) = centre of the top-left pixel. k1..p2: no unit.

    pixel_mm: pitch (x, y) where the tool states it, else None. Raises BadProject for numbers that no camera has.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    skew: float = 0.0
    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    d1: float = 0.0
    d2: float = 0.0
    d3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    width: int = field(kw_only=True)
    height: int = field(kw_only=True)
    pixel_mm: tuple[float, float] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        numbers = [self.fx, self.fy, self.cx, self.cy, self.skew, *self.coefficients]
        if not np.isfinite(numbers).all():
            raise BadProject("a camera parameter is not a finite number")
        if self.fx <= 0 or self.fy <= 0:
            raise BadProject(f"the focal length is {self.fx:g}, {self.fy:g} px, expected positive numbers")
        if self.width < 1 or self.height < 1:
            raise BadProject(f"image format is {self.width} x {self.height} px, expected positive numbers of pixels")
        if self.pixel_mm is not None and not (np.isfinite(self.pixel_mm).all() and min(self.pixel_mm) > 0):
            raise BadProject(f"the pixel size is {self.pixel_mm} mm, expected positive numbers")

    @cached_property
    def coefficients(self) -> np.ndarray:
        """(9,) in the order of `COEFFICIENTS`."""
        return np.array([getattr(self, name) for name in COEFFICIENTS], float)

    @property
    def distorts(self) -> bool:
        """Whether any coefficient is not zero."""
        return bool(np.any(self.coefficients))

    def measured(self, xy: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of normalised ideal coordinates (..., 2), y down."""
        x, y = np.moveaxis(self._distorted(np.asarray(xy, float)), -1, 0)
        return np.stack([self.cx + self.fx * x + self.skew * y, self.cy + self.fy * y], -1)

    def ideal(self, pixels: np.ndarray) -> np.ndarray:
        """Normalised ideal coordinates (..., 2) of pixels (..., 2): the inverse of `measured`, NaN where there is none."""
        p = np.asarray(pixels, float)
        y = (p[..., 1] - self.cy) / self.fy
        target = np.stack([(p[..., 0] - self.cx - self.skew * y) / self.fx, y], -1)
        if not self.distorts:
            return target
        xy, h, det = target.copy(), 1e-7, np.ones(target.shape[:-1])
        right, down = np.array([h, 0.0]), np.array([0.0, h])
        with np.errstate(all="ignore"):
            for _ in range(60):
                at = self._distorted(xy)
                jx = (self._distorted(xy + right) - self._distorted(xy - right)) / (2 * h)
                jy = (self._distorted(xy + down) - self._distorted(xy - down)) / (2 * h)
                det = jx[..., 0] * jy[..., 1] - jx[..., 1] * jy[..., 0]
                e = target - at
                step = np.stack([jy[..., 1] * e[..., 0] - jy[..., 0] * e[..., 1],
                                 jx[..., 0] * e[..., 1] - jx[..., 1] * e[..., 0]], -1) / det[..., None]
                xy = xy + step
                if np.nanmax(np.abs(step), initial=0.0) < 1e-15:
                    break
            lost = ~(np.abs(self._distorted(xy) - target).max(axis=-1) < 1e-9) | ~(det > 0)
        xy[lost] = np.nan
        return xy

    def _distorted(self, xy: np.ndarray) -> np.ndarray:
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        s = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * (self.k3 + r2 * self.k4)))
        if self.d1 or self.d2 or self.d3:
            s = s / (1 + r2 * (self.d1 + r2 * (self.d2 + r2 * self.d3)))
        return np.stack([s * x + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                         s * y + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y], -1)

    def inside(self, pixels: np.ndarray, margin: float = 0.0) -> np.ndarray:
        """(...,) whether pixels lie on the format, pixel edges included, with a margin in pixels."""
        p = np.asarray(pixels, float)
        return np.all((p >= -0.5 - margin) & (p <= np.array([self.width, self.height]) - 0.5 + margin), axis=-1)
