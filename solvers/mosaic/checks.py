"""Does the mosaic fit? Tie points judged on it, those that took part and those that were held out."""

from __future__ import annotations

import numpy as np

from ..block import Observations
from .models import through
from .registration import Registration


def discrepancies(h: np.ndarray, scale: np.ndarray, image: np.ndarray, point: np.ndarray, q: np.ndarray,
                  count: int) -> np.ndarray:
    """(o,) px from each observation q (over c) to where the mean place of its point on the mosaic appears in the photo; NaN where
    a photo has no place, a point is seen once or lies beyond a horizon. h (m, 3, 3), scale (m,): c in pixels."""
    ok = np.isfinite(h[image, 0, 0])
    p = np.full((len(image), 2), np.nan)
    p[ok] = through(np.linalg.inv(h[image[ok]]), q[ok])[0]
    ok &= np.isfinite(p[:, 0])
    n = np.bincount(point[ok], minlength=count)
    mean = np.stack([np.bincount(point[ok], p[ok, k], count) for k in (0, 1)], axis=1) / np.maximum(n, 1)[:, None]
    ok &= n[point] >= 2
    out = np.full(len(image), np.nan)
    back, _ = through(h[image[ok]], mean[point[ok]])
    out[ok] = np.linalg.norm(q[ok] - back, axis=1) * scale[image[ok]]
    return out


def check_ties(registration: Registration, names: tuple[str, ...], ties: Observations) -> np.ndarray:
    """(o,) px, `discrepancies` of tie points by a registration; image indices of the ties refer to names."""
    index = {n: k for k, n in enumerate(registration.names)}
    place = np.array([index.get(n, -1) for n in names])[ties.image]
    out = np.full(len(ties), np.nan)
    rows = np.flatnonzero(place >= 0)
    pixels = np.empty((len(rows), 2))
    for k in range(len(registration.names)):
        mine = place[rows] == k
        pixels[mine] = registration.straight(k, ties.pixel[rows[mine]])
    count = int(ties.point.max(initial=-1)) + 1
    out[rows] = discrepancies(registration.warps, np.ones(len(registration.names)), place[rows],
                              np.asarray(ties.point)[rows], pixels, count)
    return out
