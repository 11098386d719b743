"""Many single images at once: `resect_many`, and every minimum of one image: `solve_candidates`, `three_point`.

The compiled kernels (numba) are loaded at the first call; they are compiled once per machine (some seconds) and cached.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from ..cameras import Interior
from ..compiled import kernels as load
from ..errors import DegenerateGeometry


class Status(IntEnum):
    """What became of one image of a batch; `words` says it to a person."""

    OK = 0
    AMBIGUOUS = 1
    TOO_FEW = 2
    COLLINEAR = 3
    DIVERGED = 4
    NOT_FINITE = 5
    BEHIND_CAMERA = 6
    OUTLIER = 7
    WEAK = 8
    SINGULAR = 9

    @property
    def words(self) -> str:
        return _WORDS[self]

    @property
    def has_pose(self) -> bool:
        """Whether a pose is given; only OK may be used without a second look."""
        return self in (Status.OK, Status.AMBIGUOUS, Status.OUTLIER, Status.WEAK)


_WORDS = {
    Status.OK: "oriented",
    Status.AMBIGUOUS: "ambiguous: another orientation fits as well, see solutions(); more points or a prior decide",
    Status.TOO_FEW: "fewer than three valid points",
    Status.COLLINEAR: "the points lie on one line or at one place and leave a rotation free",
    Status.DIVERGED: "no start converged",
    Status.NOT_FINITE: "a coordinate is NaN or infinite; mask the point with valid",
    Status.BEHIND_CAMERA: "no orientation has all points in front of the camera",
    Status.OUTLIER: "residuals far above sigma_px: a gross error is likely (largest residual: `worst`), or sigma_px is too small",
    Status.WEAK: "a rotation has a standard deviation above 5 degrees, or the error region is far from an ellipsoid: the "
    "geometry hardly determines the orientation and its covariance says too little",
    Status.SINGULAR: "the normal matrix is singular (camera on the danger cylinder, or points nearly on a line)",
}


@dataclass(frozen=True)
class Candidates:
    """All distinct minima of one image in order of cost: rotation (K, 3, 3), centre (K, 3) m, cost (K,) sum of (v / sigma)^2."""

    rotation: np.ndarray
    centre: np.ndarray
    cost: np.ndarray

    def __len__(self) -> int:
        return len(self.cost)


@dataclass(frozen=True)
class ResectMany:
    """Exterior orientations of B images.

    rotation: (B, 3, 3) M, object axes -> photo axes. centre: (B, 3) m. covariance: (B, 6, 6) of (centre, left rotation vector d:
    M <- exp([d]x) M), m and rad, from the given sigmas. sigma0: (B,) relative to them, NaN without redundancy.
    status: (B,) `Status`. discrimination: (B,) square root of the chi-square by which the runner-up fits worse (inf: none found).
    worst: (B,) point with the largest residual where an outlier is suspected, else -1. No pose: NaN.
    """

    rotation: np.ndarray
    centre: np.ndarray
    covariance: np.ndarray
    sigma0: np.ndarray
    status: np.ndarray
    discrimination: np.ndarray
    worst: np.ndarray
    _given: tuple = field(repr=False)

    def __len__(self) -> int:
        return len(self.status)

    def solutions(self, image: int) -> Candidates:
        """Every perspective minimum of one image of the batch (all roots of three points, both reversal solutions)."""
        interior, points, pixels, valid, sigma = self._given
        use = valid[image]
        ideal = interior.ideal(pixels[image][use])
        pitch = float(np.sqrt(np.prod(interior.pitch)))
        return solve_candidates(points[image][use], ideal, interior.c, 1.0 / (sigma[image][use] * pitch) ** 2)


def resect_many(
    interior: Interior,
    points: np.ndarray,
    pixels: np.ndarray,
    model: str = "perspective",
    valid: np.ndarray | None = None,
    sigma_px: float | np.ndarray = 0.5,
    threads: int | None = None,
) -> ResectMany:
    """Exterior orientation of B independent images from any attitude, without approximate values.

    points: (B, n, 3) m. pixels: (B, n, 2) col, row. valid: (B, n) mask, None = all. sigma_px: one number or (B, n).
    model: "perspective" (least squares) or "orthogonal" (fixed point of the iterated, re-centred orthogonal projection, depth
    form, next to the perspective minimum, with its sandwich covariance; DIVERGED where there is none, as with flat control seen
    square on, whose tilt the orthogonal model does not see). threads: None = all cores.
    A vertical start is tried first and believed only when its perspective residuals are at noise level; else scaled orthography
    of the re-centred bundle (both reversal solutions), else three-point poses. Impossible images get a status, not an exception.
    Pixels of unequal pitch are weighed by the geometric mean of the two.

    Raises ValueError on shapes that do not fit together. Reference: Grunert 1841; DeMenthon & Davis 1995; Oberkampf et al. 1996.
    """
    kernels = load("solvers.orientation._kernels", "the batch resection")

    X, uv = np.ascontiguousarray(points, float), np.ascontiguousarray(pixels, float)
    if X.ndim != 3 or X.shape[2] != 3 or uv.shape != (*X.shape[:2], 2):
        raise ValueError(f"points are {X.shape} and pixels {uv.shape}, expected (B, n, 3) and (B, n, 2)")
    if model not in ("perspective", "orthogonal"):
        raise ValueError(f"model is {model!r}, expected 'perspective' or 'orthogonal'")
    shape = X.shape[:2]
    use = np.ones(shape, bool) if valid is None else np.array(np.broadcast_to(np.asarray(valid, bool), shape))
    sigma = np.full(shape, sigma_px, float) if np.ndim(sigma_px) == 0 else np.array(np.broadcast_to(sigma_px, shape), float)
    if not np.all(sigma[use] > 0):
        raise ValueError("sigma_px must be positive, in pixels")
    camera = np.concatenate([interior.parameters, interior.pitch, [(interior.width - 1) / 2, (interior.height - 1) / 2]])
    B = len(X)
    poses = np.empty((B, 3, 3)), np.empty((B, 3)), np.empty((B, 6, 6))
    out = (*poses, np.empty(B), np.empty(B), np.empty(B, np.int64), np.empty(B, np.int64))

    def run(kernel):
        def work(start: int, stop: int) -> None:
            n = shape[1]
            buffers = kernels.workspace(), np.empty((6, n)), np.empty(n, np.int64), np.empty(3)
            kernel(*buffers, X, uv, use, sigma, camera, start, stop, *out)

        _spread(work, B, threads)

    run(kernels.resect_images)
    if model == "orthogonal":
        run(kernels.orthogonal_images)
    M, C, cov, sigma0, chi, status, worst = out
    return ResectMany(M, C, cov, sigma0, status, chi, worst, (interior, X, uv, use, sigma))


def _spread(work, count: int, threads: int | None) -> None:
    """work(start, stop) over `count` images; the kernels release the lock, so threads are enough."""
    cores = threads or len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else threads or os.cpu_count() or 1
    if cores == 1 or count < 64:
        work(0, count)
        return
    edges = np.linspace(0, count, min(4 * cores, count // 32) + 1).astype(int)
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))


def solve_candidates(points: np.ndarray, xy: np.ndarray, c: float, weights: np.ndarray | None = None) -> Candidates:
    """Every distinct local minimum of one image found from all starts without a prior, refined, in order of cost.

    points: (n, 3) m. xy: (n, 2) mm, ideal photo coordinates. c: mm. weights: (n,) 1 / mm^2, None = 1.
    With three points: all real roots. Raises DegenerateGeometry naming the cause when there is none.
    """
    kernels = load("solvers.orientation._kernels", "the batch resection")

    Y, mean = _reduced(points, xy, c, weights)
    workspace = kernels.workspace()
    status, count = kernels.orient(Y, Y.shape[1], 2, workspace)
    if count == 0:
        raise DegenerateGeometry(f"resection of {Y.shape[1]} points: {Status(status).words}")
    R, t, cost = workspace[-1]
    return _candidates(R[:count], t[:count], cost[:count], mean)


def three_point(points: np.ndarray, xy: np.ndarray, c: float) -> Candidates:
    """All three-point poses (P3P), unrefined, in order of their residuals; points (3, 3) m, xy (3, 2) mm ideal, c mm."""
    kernels = load("solvers.orientation._kernels", "the batch resection")

    Y, mean = _reduced(points, xy, c, None)
    if Y.shape[1] != 3:
        raise ValueError(f"three_point takes three points, {Y.shape[1]} came")
    R, t, small = np.empty((8, 3, 3)), np.empty((8, 3)), np.empty((3, 3, 3))
    count = kernels.three_point(Y, 0, 1, 2, R, t, small[0], small[1], small[2], np.empty(4))
    if count == 0:
        raise DegenerateGeometry("three-point resection: no pose in front of the camera, or the three points lie on one line")
    found = _candidates(R[:count], t[:count], np.zeros(count), mean)
    P = np.einsum("kij,knj->kni", found.rotation, np.asarray(points, float) - found.centre[:, None])
    cost = np.sum((np.asarray(xy, float) + c * P[..., :2] / P[..., 2:]) ** 2, axis=(1, 2))
    order = np.argsort(cost)
    return Candidates(found.rotation[order], found.centre[order], cost[order])


def _candidates(R: np.ndarray, t: np.ndarray, cost: np.ndarray, mean: np.ndarray) -> Candidates:
    """Photo-frame values of kernel poses (camera frame x right, y down, z forward)."""
    return Candidates(R * np.array([1.0, -1.0, -1.0])[:, None], mean - np.einsum("kji,kj->ki", R, t), cost.copy())


def _reduced(points, xy, c: float, weights) -> tuple[np.ndarray, np.ndarray]:
    """The kernel's (6, n) image and the mean of the points."""
    X, p = np.asarray(points, float), np.asarray(xy, float)
    if X.ndim != 2 or X.shape[1:] != (3,) or p.shape != (len(X), 2):
        raise ValueError(f"points are {X.shape} and xy {p.shape}, expected (n, 3) and (n, 2)")
    w = np.ones(len(X)) if weights is None else np.asarray(weights, float)
    if len(X) < 3:
        raise DegenerateGeometry(f"resection needs three points, {len(X)} came")
    if not (np.isfinite(X).all() and np.isfinite(p).all() and np.isfinite(w).all() and (w >= 0).all() and c > 0):
        raise DegenerateGeometry("resection: a coordinate is not finite or a weight is negative; leave that point out")
    mean = X.mean(0)
    Y = np.empty((6, len(X)))
    Y[:3], Y[3], Y[4], Y[5] = (X - mean).T, p[:, 0] / c, -p[:, 1] / c, np.sqrt(w) * c
    return Y, mean
