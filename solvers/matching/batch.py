"""What both matchers share: checked points, photos cut to what is needed, the batch spread over cores."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from ..errors import Unsupported
from .patches import Photo, prepare

_FRAME = 14  # px around a cut-out: reach of the spline's inverse filter


def points(values: np.ndarray, name: str) -> np.ndarray:
    """(N, 2) finite col, row. Raises Unsupported for anything else."""
    array = np.ascontiguousarray(values, float)
    array = array.reshape(-1, 2) if array.size == 2 else array
    if array.ndim != 2 or array.shape[1] != 2:
        raise Unsupported(f"{name} has shape {np.shape(values)}: give (N, 2) col, row")
    if not np.isfinite(array).all():
        raise Unsupported(f"{name} {int(np.flatnonzero(~np.isfinite(array).all(1))[0])} is not finite: give col, row in pixels")
    return array


def shapes(shape: np.ndarray | None, count: int) -> np.ndarray:
    """(N, 2, 2) template -> target offsets from None (identity), one 2x2 or N of them. Raises Unsupported for others."""
    array = np.eye(2) if shape is None else np.asarray(shape, float)
    if array.shape not in ((2, 2), (count, 2, 2)):
        raise Unsupported(f"shape is {array.shape}: give one 2x2 matrix or one for each of the {count} points")
    if not np.isfinite(array).all() or (np.abs(np.linalg.det(array)) < 1e-3).any():
        raise Unsupported("shape must be finite and invertible: it maps template offsets to target offsets")
    return np.array(np.broadcast_to(array, (count, 2, 2)))


def half_window(window: int) -> int:
    """Half the side of an odd window. Raises Unsupported."""
    if window % 2 == 0 or not 5 <= window <= 101:
        raise Unsupported(f"window is {window}: give an odd number of pixels from 5 to 101")
    return window // 2


def cut(image: np.ndarray | Photo, at: np.ndarray, margin: int, smooth: float) -> tuple[Photo, np.ndarray]:
    """The photo around the points, prepared, and (2,) the col, row of its first pixel: a click does not filter a whole photo."""
    if isinstance(image, Photo) or len(at) == 0:
        return prepare(image, smooth), np.zeros(2)
    rows, cols = image.shape[:2]
    low = np.clip(np.floor(at.min(0)).astype(int) - margin - _FRAME, 0, [max(cols - 2, 0), max(rows - 2, 0)])
    high = np.clip(np.ceil(at.max(0)).astype(int) + margin + _FRAME + 1, low + 2, [cols, rows])
    return prepare(image[low[1] : high[1], low[0] : high[0]], smooth), low.astype(float)


def is_sparse(image: np.ndarray | Photo, at: np.ndarray, margin: int) -> bool:
    """Few points far apart on a raw photo: cheaper point by point."""
    if isinstance(image, Photo) or len(at) < 2:
        return False
    spread = np.prod(np.ptp(at, axis=0) + 2 * margin)
    return bool(len(at) * (2.0 * (margin + _FRAME)) ** 2 * 2 < spread)


def spread(kernel: Callable[[slice], None], count: int, workers: int) -> None:
    """Run a kernel that releases the interpreter on slices of the points, one thread a core."""
    if workers <= 1 or count < 64:
        kernel(slice(0, count))
        return
    edges = np.linspace(0, count, 4 * workers + 1).astype(int)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(kernel, [slice(a, b) for a, b in pairwise(edges)]))
