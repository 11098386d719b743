"""Which matches of two photos agree with one geometry: an essential or fundamental matrix, or a homography."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..cameras import Interior

_CONFIDENCE, _TRIALS = 0.9999, 20000


@dataclass(frozen=True)
class Verified:
    """What two photos share. kind: "essential", "fundamental" or "homography" (a plane, or no base between the photos);
    inlier (M,) of the matches given; homography (3, 3) first -> second photo px, of the dominant plane: it predicts how a
    window of one photo looks in the other."""

    kind: str
    inlier: np.ndarray
    homography: np.ndarray


def verify(a: np.ndarray, b: np.ndarray, interiors: tuple[Interior | None, Interior | None], threshold: float,
           least: int = 16) -> Verified | None:
    """The geometry of matches a, b (M, 2) px by locally optimised RANSAC (OpenCV's USAC), or None where too few agree.

    With both interior orientations an essential matrix, which a plane does not mislead. Without them a fundamental matrix
    counts only where a homography does not explain nearly as many matches: from a plane alone it is arbitrary.
    threshold: px. Reference: Chum, Matas & Kittler 2003 (LO-RANSAC); Chum, Werner & Matas 2005 (plane degeneracy).
    """
    if len(a) < least:
        return None
    plane, on_plane = _homography(a, b, threshold)
    known = interiors[0] is not None and interiors[1] is not None
    rigid = _essential(a, b, interiors, threshold) if known else _fundamental(a, b, threshold)
    if plane is not None and (rigid is None or on_plane.sum() >= (0.95 if known else 0.8) * rigid.sum()):
        kind, inlier = "homography", on_plane
    elif rigid is not None:
        kind, inlier = ("essential" if known else "fundamental"), rigid
    else:
        return None
    if inlier.sum() < max(least, 8 + 0.04 * len(a)):
        return None
    mean, _ = _homography(a[inlier], b[inlier], 20 * threshold)
    mean = plane if mean is None else mean
    if mean is None:
        return None
    # A wrong match may lie on its epipolar line by chance, far from where all the others are.
    far = np.linalg.norm(apply(mean, a) - b, axis=1)
    inlier = inlier & (far < max(6 * float(np.median(far[inlier])), 10 * threshold))
    return Verified(kind, inlier, mean) if inlier.sum() >= least else None


def apply(homography: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """(N, 2) places of pixels (N, 2) in the other photo."""
    p = pixel @ homography[:, :2].T + homography[:, 2]
    return p[:, :2] / p[:, 2:]


def derivative(homography: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """(N, 2, 2) how offsets at pixels (N, 2) map to offsets in the other photo."""
    p = pixel @ homography[:, :2].T + homography[:, 2]
    w = p[:, 2, None, None]
    return homography[:2, :2] / w - p[:, :2, None] * homography[2, :2] / w**2


def _homography(a: np.ndarray, b: np.ndarray, threshold: float) -> tuple[np.ndarray | None, np.ndarray]:
    """A homography that neither folds nor squeezes the photo at its inliers, and those (transfer errors both ways)."""
    import cv2

    nothing = np.zeros(len(a), bool)
    if len(a) < 4:
        return None, nothing
    matrix = _sampled(cv2.findHomography, a, b, cv2.USAC_ACCURATE, threshold, None, _TRIALS, _CONFIDENCE)
    if matrix is None or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-12:
        return None, nothing
    depth = a @ matrix[2, :2] + matrix[2, 2]
    error = np.maximum(np.linalg.norm(apply(matrix, a) - b, axis=1), np.linalg.norm(apply(np.linalg.inv(matrix), b) - a, axis=1))
    inlier = (error < threshold) & (depth * np.median(depth) > 0)
    if inlier.sum() < 4:
        return None, nothing
    singular = np.linalg.svd(derivative(matrix, a[inlier]), compute_uv=False)
    turned = np.linalg.det(derivative(matrix, a[inlier])) < 0
    if turned.any() or (singular[:, 0] > 6 * singular[:, 1]).any():
        return None, nothing
    return matrix, inlier


def _essential(a: np.ndarray, b: np.ndarray, interiors: tuple[Interior | None, Interior | None],
               threshold: float) -> np.ndarray | None:
    """(M,) inliers of the essential matrix between ideal directions; the error is Sampson's, in px."""
    import cv2

    first, second = interiors
    assert first is not None and second is not None
    p, q = first.ideal(a) / first.c, second.ideal(b) / second.c
    known = np.isfinite(p).all(1) & np.isfinite(q).all(1)
    pitch = 0.5 * (first.pitch.mean() / first.c + second.pitch.mean() / second.c)  # of a pixel, as a tangent
    if known.sum() < 8:
        return None
    matrix = _sampled(cv2.findEssentialMat, p[known], q[known], np.eye(3), cv2.USAC_ACCURATE, _CONFIDENCE, threshold * pitch,
                      _TRIALS)
    if matrix is None or matrix.shape != (3, 3):
        return None
    return np.nan_to_num(_sampson(matrix, p, q), nan=np.inf) < threshold * pitch


def _fundamental(a: np.ndarray, b: np.ndarray, threshold: float) -> np.ndarray | None:
    import cv2

    if len(a) < 8:
        return None
    matrix = _sampled(cv2.findFundamentalMat, a, b, cv2.USAC_ACCURATE, threshold, _CONFIDENCE, _TRIALS)
    return None if matrix is None or matrix.shape != (3, 3) else _sampson(matrix, a, b) < threshold


def _sampled(estimate: Callable[..., Any], *arguments: Any) -> np.ndarray | None:
    """The matrix OpenCV's RANSAC finds, the same in every run; None where there is none, which USAC may say by a failed assertion
    (a polished model without a solution: wrong matches only)."""
    import cv2

    cv2.setRNGSeed(0)
    try:
        return estimate(*arguments)[0]
    except cv2.error:
        return None


def _sampson(matrix: np.ndarray, p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(N,) first-order distance of the pairs (N, 2), (N, 2) to q' matrix p = 0. Reference: Hartley & Zisserman 2004, eq. 11.9."""
    right = p @ matrix[:, :2].T + matrix[:, 2]
    left = q @ matrix[:2] + matrix[2]
    value = (q * right[:, :2]).sum(1) + right[:, 2]
    return np.abs(value) / np.sqrt(np.maximum((right[:, :2] ** 2).sum(1) + (left[:, :2] ** 2).sum(1), 1e-300))
