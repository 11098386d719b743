"""Normalized cross-correlation: where, to about a tenth of a pixel, a template lies in a search window."""

from __future__ import annotations

import numpy as np

from ..compiled import kernels
from . import batch
from .patches import SMOOTH, Photo, smoothing
from .result import NccResult, Status

RIVAL = 0.75
"""Peaks above this part of the best score are rivals."""

VAGUE = 0.25
"""px, standard deviation of a peak beyond which its place is not believed: noise then moves it by a pixel and more."""


_FLAT = 4.0
"""Times the variance of rounding, the least that is texture."""


def flat_variance(template: Photo, target: Photo) -> float:
    """Grey values squared: a window that varies by no more is flat, its correlation is not defined."""
    return _FLAT * max(template.quantum, target.quantum) ** 2 / 12 * smoothing(target.smooth).value


def peak_sigma(score: np.ndarray, curvature: np.ndarray, independent: float) -> np.ndarray:
    """(N,) px, standard deviation along the flattest direction of a correlation's peak, of its score, least curvature (1/px^2)
    and number of independent values: sqrt((1 - score^2) / (score curvature independent)); inf where the peak is flat.

    The slope of the correlation scatters by sqrt((1 - score^2) curvature / (score independent)) about its top; on the safe side,
    about twice the scatter, for smoothed noise counts as independent only once every few pixels.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        variance = (1 - np.clip(score, 0, 1) ** 2) / (np.clip(score, 0, 1) * np.maximum(curvature, 0) * independent)
    return np.where(np.isfinite(variance), np.sqrt(variance), np.inf)


def match_ncc(template_image: np.ndarray | Photo, target_image: np.ndarray | Photo, at: np.ndarray, start: np.ndarray,
              window: int = 21, search: int = 12, threshold: float = 0.5, *, shape: np.ndarray | None = None,
              uniqueness: float = 0.95, smooth: float = SMOOTH, workers: int = 1) -> NccResult:
    """Best places of N template windows in the target image.

    at, start (N, 2) col, row (pixel centres are integers): window centres in the template image, predicted places in the
    target. window, search: px, side of the template and reach of the search around the start. threshold: least
    correlation (0.5 to 0.7 is usual). shape (2, 2) or (N, 2, 2): template -> target offsets (col, row), from an
    orientation, a homography or earlier ties; the template is warped by it first. uniqueness: largest score of the
    second peak over that of the best; the two must also differ by two standard deviations (Fisher); above 1 no test.
    smooth: px, presmoothing of raw images.

    Raises Unsupported for nonsense input. Reference: Lewis 1995, Fast normalized cross-correlation.
    """
    at, start = batch.points(at, "at"), batch.points(start, "start")
    matrices, half = batch.shapes(shape, len(at)), batch.half_window(window)
    margin = half + search + 2
    if batch.is_sparse(template_image, at, margin) or batch.is_sparse(target_image, start, margin):
        parts = [match_ncc(template_image, target_image, at[i], start[i], window, search, threshold, shape=matrices[i],
                           uniqueness=uniqueness, smooth=smooth) for i in range(len(at))]
        return NccResult(*(np.concatenate([getattr(part, name) for part in parts]) for name in NccResult.__dataclass_fields__))
    reach = int(np.ceil(half * np.abs(np.linalg.inv(matrices)).sum(2).max(initial=1.0))) + 2
    template, corner = batch.cut(template_image, at, reach, smooth)
    target, origin = batch.cut(target_image, start, margin, smooth)
    compiled = kernels("solvers.matching._kernels", "image matching")
    peaks = compiled.RIVALS
    flat = flat_variance(template, target)
    gap = 2 * np.sqrt(2 / (window**2 * smoothing(target.smooth).value))  # two sigmas of Fisher's z, independent values only
    out = np.full((len(at), 6 + 3 * peaks), np.nan)

    def kernel(part: slice) -> None:
        compiled.correlate_batch(template.coefficients, target.coefficients, at[part] - corner, start[part] - origin,
                                 matrices[part], half, search, threshold, RIVAL, gap, flat, out[part])

    batch.spread(kernel, len(at), workers)
    status, score = out[:, 3].astype(int), out[:, 2]
    rivals = out[:, 5:-1].reshape(-1, peaks, 3)
    second = np.where(np.isfinite(rivals[:, 0, 2]), rivals[:, 0, 2], -1.0)
    apart = np.arctanh(np.clip(score, -1, 1 - 1e-9)) - np.arctanh(np.clip(second, -1 + 1e-9, 1 - 1e-9))
    same = (second > uniqueness * score) | (apart < gap)
    status[(status == Status.OK) & same & (uniqueness <= 1)] = Status.NOT_UNIQUE
    vague = peak_sigma(score, out[:, -1], window**2 * smoothing(target.smooth).value) > VAGUE
    status[(status == Status.OK) & vague & (uniqueness <= 1)] = Status.UNCERTAIN
    pixel = np.where((status == Status.OK)[:, None], out[:, :2] + origin, np.nan)
    return NccResult(pixel, score, out[:, 4].astype(int), rivals[:, :, :2] + origin, rivals[:, :, 2], status,
                     out[:, :2] + origin)
