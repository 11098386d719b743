"""The two models that know no interior orientation: the direct linear transformation and the affine model.

Both are problems of the engine, so that their residuals are those of the image, with covariance, and not algebraic ones.
Reference: Abdel-Aziz & Karara 1971; Hartley & Zisserman 2004 (normalization); Ono & Hattori 2002, equation (8).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..adjustment import Dense, Linear, Precision, Trace, precision, solve
from ..errors import DegenerateGeometry
from ..geometry import Exterior, closest_rotation


@dataclass(frozen=True)
class DirectLinear:
    """x = L1 .. L11: u = (L1 X + L2 Y + L3 Z + L4) / w, v = (L5 X + L6 Y + L7 Z + L8) / w, w = L9 X + L10 Y + L11 Z + 1.

    points (n, 3) reduced and scaled by the caller, image (n, 2), weights (n, 2, 2).
    """

    points: np.ndarray
    image: np.ndarray
    weights: np.ndarray

    @property
    def dof(self) -> int:
        return 2 * len(self.points) - 11

    def start(self) -> np.ndarray:
        """The linear (algebraic) solution."""
        x = np.hstack([self.points, np.ones((len(self.points), 1))])
        zero, u, v = np.zeros_like(x), self.image[:, :1], self.image[:, 1:]
        rows = np.vstack([np.hstack([x, zero, -u * self.points]), np.hstack([zero, x, -v * self.points])])
        return np.linalg.lstsq(rows, np.concatenate([u[:, 0], v[:, 0]]), rcond=None)[0]

    def linear(self, x: np.ndarray) -> Linear:
        p = np.hstack([self.points, np.ones((len(self.points), 1))])
        w = self.points @ x[8:] + 1
        uv = np.stack([p @ x[:4], p @ x[4:8]], axis=1) / w[:, None]
        j = np.zeros((len(p), 2, 11))
        j[:, 0, :4] = j[:, 1, 4:8] = p / w[:, None]
        j[:, :, 8:] = -uv[:, :, None] * (self.points / w[:, None])[:, None]
        return Linear(self.image - uv, j, self.weights)

    def cost(self, x: np.ndarray) -> float:
        return self.linear(x).cost

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def normal(self, x: np.ndarray) -> Dense:
        return self.linear(x).normal()

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        return x + dx


@dataclass(frozen=True)
class DltSolution:
    """matrix (3, 4): (x, y, -1) ~ P (X, Y, Z, 1) in mm and m; the camera it implies: c_x, c_y (principal distance along x
    and y, mm), principal point (2,) mm, skew, exterior; precision of L1 .. L11 in reduced coordinates; trace."""

    matrix: np.ndarray
    c: tuple[float, float]
    principal_point: np.ndarray
    skew: float
    exterior: Exterior
    precision: Precision
    trace: Trace


def direct_linear_transformation(points: np.ndarray, photo: np.ndarray, sigma_mm: float | np.ndarray = 0.002) -> DltSolution:
    """The DLT of six or more points (n, 3) m and photo coordinates (n, 2) mm, and the camera behind it.

    Raises DegenerateGeometry for fewer than six points or (nearly) coplanar ones.
    """
    n = len(points)
    if n < 6:
        raise DegenerateGeometry(f"the direct linear transformation needs 6 points, there are {n}; measure more control")
    mean = points.mean(axis=0)
    s = np.linalg.svd(points - mean, compute_uv=False)
    if s[2] < 1e-4 * s[0]:
        raise DegenerateGeometry("the direct linear transformation needs points that are not in one plane; add control in height")
    scale, size = np.sqrt(n) / s[0], 2.0 ** np.round(np.log2(np.abs(photo).max()))  # a round unit, the same under noise
    weights = np.eye(2) * (size / np.broadcast_to(np.asarray(sigma_mm, float), (n,)))[:, None, None] ** 2
    problem = DirectLinear((points - mean) * scale, photo / size, weights)
    trace = solve(problem, problem.start())
    stats = precision(problem.linear(trace.last.x), "the direct linear transformation")
    rows = np.append(trace.last.x, 1.0)
    p = np.array([[*rows[:4]], [*rows[4:8]], [*rows[8:]]])
    p[:2] *= size
    p[2] *= -1.0  # (x, y, -1) ~ P X
    p[:, :3] *= scale
    p[:, 3] -= p[:, :3] @ mean
    return _camera_of(p, stats, trace)


def _camera_of(p: np.ndarray, stats: Precision, trace: Trace) -> DltSolution:
    """RQ decomposition of the left 3x3 block into an upper triangular interior and a rotation."""
    p = p * np.sign(np.linalg.det(p[:, :3]))
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ p[:, :3]).T)
    k, m = flip @ r.T @ flip, flip @ q.T
    signs = np.diag(np.sign(np.diag(k)))
    k, m = k @ signs, signs @ m
    k = k / k[2, 2]  # x = k00 U + k01 V + k02 W over -W: the principal point is -k02
    m = closest_rotation(m)
    centre = -np.linalg.solve(p[:, :3], p[:, 3])
    c, skew = (float(k[0, 0]), float(k[1, 1])), float(k[0, 1] / k[0, 0])
    return DltSolution(p, c, -k[:2, 2], skew, Exterior(m, centre), stats, trace)


@dataclass(frozen=True)
class AffineSolution:
    """a (2, 4): x = A1 X + A2 Y + A3 Z + A4, y = A5 X + ... with X reduced to `mean` (3,); covariance (8, 8) of a; sigma0."""

    a: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    sigma0: float | None
    residuals: np.ndarray

    def project(self, points: np.ndarray) -> np.ndarray:
        """Photo coordinates (n, 2) of points (n, 3)."""
        return (points - self.mean) @ self.a[:, :3].T + self.a[:, 3]


def affine(points: np.ndarray, photo: np.ndarray, sigma_mm: float = 0.002) -> AffineSolution:
    """The affine model (8 parameters, parallel rays) of four or more points not in one plane, by SVD on reduced coordinates.

    Raises DegenerateGeometry for fewer than four points or coplanar ones.
    """
    n, mean = len(points), points.mean(axis=0)
    if n < 4:
        raise DegenerateGeometry(f"the affine model needs 4 points, there are {n}; measure more control")
    u, s, vt = np.linalg.svd(points - mean, full_matrices=False)
    if s[2] < 1e-6 * s[0]:
        raise DegenerateGeometry("the affine model needs points that are not in one plane; add control in height")
    block = (vt.T @ ((u.T @ photo) / s[:, None])).T
    a = np.column_stack([block, photo.mean(axis=0)])
    v = photo - (points - mean) @ block.T - a[:, 3]
    q = np.zeros((4, 4))
    q[:3, :3], q[3, 3] = (vt.T / s**2) @ vt, 1 / n
    dof = 2 * n - 8
    sigma0 = float(np.sqrt((v**2).sum() / sigma_mm**2 / dof)) if dof else None
    return AffineSolution(a, mean, np.kron(np.eye(2), q) * sigma_mm**2, sigma0, v)
