"""Two mosaics faded into one picture: a browser does not show through a transparent picture what lies under it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .values import Picture

LONGEST = 1600
"""px of the longer side of the picture, at most."""


@lru_cache(maxsize=2)
def faded(under: tuple[Picture, ...], over: tuple[Picture, ...], share: float, opacity: float) -> Picture:
    """One picture of both, level, as high as `under`; share: 0 shows `under` alone, 1 `over` alone. Pictures lie along the axes.

    Where only one of them is seen it is as opaque as its share.
    """
    corners = np.concatenate([p.corners for p in (*under, *over)])
    (west, south), (east, north) = corners[:, :2].min(axis=0), corners[:, :2].max(axis=0)
    pixel = min(float(np.linalg.norm(p.corners[1] - p.corners[0])) / p.rgba.shape[1] for p in (*under, *over))
    pixel = max(pixel, float(max(east - west, north - south)) / LONGEST)
    shape = max(1, round((north - south) / pixel)), max(1, round((east - west) / pixel))
    box = float(west), float(south), float(east), float(north)
    a, b = (_spread(of, box, shape).astype(np.float32) for of in (under, over))
    weights = (1 - share) * a[..., 3:], share * b[..., 3:]
    total = weights[0] + weights[1]
    rgb = (weights[0] * a[..., :3] + weights[1] * b[..., :3]) / np.maximum(total, 1e-3)
    level = float(np.mean([p.corners[:, 2].mean() for p in under or over]))
    ring = np.array([[west, north, level], [east, north, level], [east, south, level], [west, south, level]])
    return Picture(ring, np.round(np.concatenate([rgb, total], axis=2)).astype(np.uint8), opacity)


@lru_cache(maxsize=4)
def _spread(pictures: tuple[Picture, ...], box: tuple[float, float, float, float], shape: tuple[int, int]) -> np.ndarray:
    """Pictures on one raster (h, w, 4) uint8 over a box west, south, east, north."""
    import cv2

    west, south, east, north = box
    out = np.zeros((*shape, 4), np.uint8)
    for p in pictures:
        col = np.round((p.corners[[0, 1], 0] - west) / (east - west) * shape[1]).astype(int)
        row = np.round((north - p.corners[[0, 3], 1]) / (north - south) * shape[0]).astype(int)
        if col[1] > col[0] and row[1] > row[0]:
            small = cv2.resize(p.rgba, (int(col[1] - col[0]), int(row[1] - row[0])), interpolation=cv2.INTER_AREA)
            out[row[0]:row[1], col[0]:col[1]] = small
    return out
