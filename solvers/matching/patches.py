"""Photos as cubic B-splines: grey values, presmoothing and what both do to the noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import Unsupported

SMOOTH = 0.6
"""px, standard deviation of the Gaussian applied to both images; without it noise biases the sub-pixel shift."""

_REACH = 12  # taps on either side: the spline's inverse filter falls by 3.7 a tap, 0.268^12 = 1.4e-7


@dataclass(frozen=True)
class Photo:
    """One photo ready for matching. coefficients (rows, cols) float32 of the smoothed cubic spline; smooth: px;
    quantum: grey values of one digital step (0 for floating-point images), the least noise there is is quantum^2 / 12."""

    coefficients: np.ndarray
    smooth: float
    quantum: float

    @property
    def size(self) -> tuple[int, int]:
        """(cols, rows)"""
        rows, cols = self.coefficients.shape
        return cols, rows


@dataclass(frozen=True)
class Smoothing:
    """How white noise of variance 1 passes: taps (m,) of the kernel between pixel and spline value at the pixel,
    and the variances of value, slope, second difference, of the value after `extra` (3,) and of the slope smoothed by taps."""

    taps: np.ndarray
    extra: np.ndarray
    value: float
    slope: float
    laplacian: float
    extra_value: float
    spread: float


def gray(image: np.ndarray) -> np.ndarray:
    """(rows, cols) float32 grey values of a grey, colour (rows, cols, 3: red, green, blue) or colour + alpha image.

    Raises Unsupported for anything else.
    """
    image = np.asarray(image)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        return image[..., :3].astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    if image.ndim != 2 or min(image.shape) < 2:
        raise Unsupported(f"an image of shape {image.shape} cannot be matched: give (rows, cols) or (rows, cols, 3)")
    return np.ascontiguousarray(image, np.float32)


def prepare(image: np.ndarray | Photo, smooth: float = SMOOTH) -> Photo:
    """The photo as spline coefficients, its Gaussian presmoothing (px, 0 = none) done in the same exact filter.

    Prepare a photo once when it is matched several times.
    Reference: Unser, Aldroubi & Eden 1993, B-spline signal processing, part II.
    """
    if isinstance(image, Photo):
        return image
    import cv2

    kernel = _prefilter(smooth)
    coefficients = cv2.sepFilter2D(gray(image), cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return Photo(coefficients, smooth, float(np.issubdtype(np.asarray(image).dtype, np.integer)))


@lru_cache
def smoothing(smooth: float) -> Smoothing:
    """Noise gains of the spline of `prepare(..., smooth)` at the pixels."""
    c = _prefilter(smooth)
    value = np.convolve(c, [1 / 6, 4 / 6, 1 / 6])
    slope = np.convolve(c, [0.5, 0, -0.5])
    extra = np.array([0.2, 0.6, 0.2])
    reach = max(1, int(np.ceil(4 * smooth)))
    middle = len(value) // 2
    energy = float((value**2).sum())
    return Smoothing(
        taps=value[middle - reach : middle + reach + 1].astype(np.float32),
        extra=extra.astype(np.float32),
        value=energy**2,
        slope=float((slope**2).sum()) * energy,
        laplacian=float((np.convolve(value, [1, -2, 1]) ** 2).sum()) ** 2,
        extra_value=float((np.convolve(value, extra) ** 2).sum()) ** 2,
        spread=float((np.convolve(slope, value) ** 2).sum() * (np.convolve(value, value) ** 2).sum()),
    )


@lru_cache
def _prefilter(smooth: float) -> np.ndarray:
    """(25,) the spline's inverse filter, [1 4 1]/6 inverted, times a Gaussian."""
    pole = np.sqrt(3) - 2
    k = np.arange(-2 * _REACH, 2 * _REACH + 1)
    kernel = -6 * pole / (1 - pole * pole) * pole ** np.abs(k)
    if smooth > 0:
        bell = np.exp(-0.5 * (k / smooth) ** 2)
        kernel = np.convolve(kernel, bell / bell.sum(), "same")
    kernel = kernel[_REACH:-_REACH]
    return kernel / kernel.sum()
