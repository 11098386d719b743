"""The published tables and what can be read from them without any of the paper's data.

Reference: Tjahjadi & Agustina, "Single image orientation of UAV's imagery using orthogonal projection model", Tables I to III.
"""

from __future__ import annotations

import numpy as np

from ..cameras import ideal_photo
from ..geometry import Exterior, log
from .design import CAMERA, PITCH, ground, predict

LEVEL = 494.8981  # m, the height that lies 300 m below the benchmark's camera
BENCHMARK = np.array([-2.6368, 3.9069, 88.933, 679421.0695, 9123785.2218, 794.8981])
STANDARD_ERROR = np.array([0.01162, 0.01633, 0.00203, 0.07492, 0.05419, 0.01085])
ORTHOGONAL = np.array([
    [-2.6368, 3.9068, 88.935, 679421.446, 9123785.460, 800.630],
    [-2.6379, 3.9107, 88.933, 679421.248, 9123785.322, 797.138],
    [-2.6268, 3.9062, 88.928, 679421.022, 9123785.187, 794.080],
    [-2.6136, 3.9066, 88.931, 679420.678, 9123784.958, 789.375],
    [-2.6403, 3.9019, 88.930, 679421.024, 9123785.203, 794.323],
])
PERSPECTIVE = np.array([
    [-4.4668, 4.9957, 89.025, 679425.859, 9123793.413, 790.991],
    [-4.7718, 1.6182, 89.217, 679410.428, 9123794.708, 792.101],
    [-1.8381, 4.4810, 89.037, 679423.539, 9123781.722, 793.019],
    [-0.4763, 1.3743, 88.748, 679409.653, 9123775.558, 791.549],
    [-1.4296, -2.6826, 88.755, 679391.125, 9123779.803, 794.032],
])
"""omega, phi, kappa [degrees], X, Y, Z [m] of the five clusters, Tables II and III."""


def exterior(row: np.ndarray) -> Exterior:
    """Orientation of a row in the local frame of `design`, whose origin lies 300 m below the benchmark's camera."""
    return Exterior.from_angles(*np.radians(row[:3]), centre=row[3:] - [BENCHMARK[3], BENCHMARK[4], LEVEL])


def turn_deg(a: np.ndarray, b: np.ndarray = BENCHMARK) -> float:
    """Angle between two printed attitudes [degrees]."""
    return float(np.degrees(np.linalg.norm(log(exterior(a).m @ exterior(b).m.T))))


def along_axis(row: np.ndarray) -> tuple[float, float]:
    """Offset of a printed centre from the benchmark's along the benchmark's optical axis, and across it [m]."""
    at = exterior(BENCHMARK)
    d = exterior(row).centre - at.centre
    shift = float(d @ at.m[2])
    return shift, float(np.linalg.norm(d - shift * at.m[2]))


def implied_sigma_px(points: np.ndarray) -> np.ndarray:
    """(6,) px, the measurement error at which all control points (n, 3) give each of Table I's standard errors."""
    sd = np.sqrt(np.diag(predict(points, 1.0, ())["P"]))[[3, 4, 5, 0, 1, 2]]
    return STANDARD_ERROR / np.concatenate([np.degrees(sd[:3]), sd[3:]])


def registration_px(row: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(k,) px, rms distance between the photo of control sets (k, n, 3) by a printed orientation and by the benchmark."""
    a, b = (ideal_photo(CAMERA.c, exterior(r), points.reshape(-1, 3)) for r in (row, BENCHMARK))
    return np.sqrt(((a - b) ** 2).sum(axis=1).reshape(points.shape[:2]).mean(axis=1)) / PITCH


def where(row: np.ndarray) -> tuple[float, float, float, np.ndarray]:
    """Photo position x, y [mm] and flying height [m] of the flat 6 degree cluster that an orientation registers best, as
    its own least squares solution must, and the cluster (4, 3)."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-10.5, 10.6, 0.25), np.arange(-6.5, 6.6, 0.25)))
    best: tuple[float, float, float, float, np.ndarray] | None = None
    for height in np.arange(250, 341, 5.0):
        middle = ground(np.column_stack([x, y]), 300 - height)
        azimuth = 0.3 + np.arange(4) * np.pi / 2
        reach = np.linalg.norm(middle - [0, 0, 300], axis=1) * np.tan(np.radians(3))
        ring = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(4)])
        sets = middle[:, None] + reach[:, None, None] * ring
        px = registration_px(row, sets)
        k = int(np.argmin(px))
        if best is None or px[k] < best[0]:
            best = float(px[k]), float(x[k]), float(y[k]), float(height), sets[k]
    assert best is not None
    return best[1], best[2], best[3], best[4]


def chance(points: np.ndarray, sigma_px: float, within_deg: float, method: str = "O1_truth") -> float:
    """Probability by linear theory that the tilt of a cluster agrees with the reference to within_deg [degrees].

    The tilt error is a normal pair with the covariance of `predict`; its distribution is integrated over directions.
    """
    c = predict(points, sigma_px, ())[method][3:5, 3:5]
    u = np.linspace(0, 2 * np.pi, 721)[:-1]
    d = np.stack([np.cos(u), np.sin(u)], axis=1)
    q = np.einsum("ki,ij,kj->k", d, np.linalg.inv(c), d)
    r = np.radians(within_deg)
    return float(((1 - np.exp(-q * r * r / 2)) / q).mean() / np.sqrt(np.linalg.det(c)))
