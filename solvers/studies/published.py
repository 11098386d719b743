"""The published tables and what can be read from them without any of the paper's data.

Reference: Tjahjadi & Agustina, "Single image orientation of UAV's imagery using orthogonal projection model", Tables I to III.
"""

from __future__ import annotations

from math import erf

import numpy as np

from ..cameras import ideal_photo
from ..geometry import Exterior, angle_derivatives, log
from .design import CAMERA, PITCH, TABLE_I, ground, predict

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


def disc(middle: np.ndarray, angle_deg: float = 6.0, n: int = 24) -> np.ndarray:
    """(k, n, 3) m, level discs of an opening angle around ground points (k, 3)."""
    i = np.arange(n)
    r, azimuth = np.sqrt((i + 0.5) / n) * np.tan(np.radians(angle_deg / 2)), i * np.pi * (3 - np.sqrt(5))
    reach = np.linalg.norm(middle - [0, 0, 300], axis=1)
    return middle[:, None] + reach[:, None, None] * np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), np.zeros(n)])


def where(row: np.ndarray) -> tuple[float, float, float, np.ndarray]:
    """Photo position x, y [mm] and flying height [m] of the flat 6 degree disc that an orientation registers best, as
    its own least squares solution must, and the disc (n, 3)."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-10, 10.1, 0.25), np.arange(-6.5, 6.6, 0.25)))
    found = []
    for height in np.arange(250.0, 341, 5):
        sets = disc(ground(np.column_stack([x, y]), 300 - height))
        px = registration_px(row, sets)
        k = int(np.argmin(px))
        found.append((float(px[k]), float(x[k]), float(y[k]), float(height), sets[k]))
    return min(found, key=lambda f: f[0])[1:]


def chance(points: np.ndarray, sigma_px: float, within_deg: float, method: str = "O1_truth") -> float:
    """Probability by linear theory that the rotation of a cluster agrees with the reference to within_deg [degrees].

    The rotation vector is normal with the covariance of `predict`; its length is integrated over all directions.
    """
    back = np.linalg.inv(angle_derivatives(TABLE_I.m))
    variance = np.linalg.eigvalsh(back @ predict(points, sigma_px, ())[method][3:, 3:] @ back.T)
    z, weight = np.polynomial.legendre.leggauss(300)
    u = np.linspace(0, 2 * np.pi, 361)[:-1]
    flat = np.sqrt(1 - z**2)[:, None]
    q = z[:, None] ** 2 / variance[0] + flat**2 * (np.cos(u) ** 2 / variance[1] + np.sin(u) ** 2 / variance[2])
    r = np.radians(within_deg)
    root = r * np.sqrt(q / 2)
    bell = np.vectorize(erf)(root) * np.sqrt(np.pi / 2) / q**1.5 - r * np.exp(-(root**2)) / q
    return float((weight @ bell).mean() * 2 * np.pi / np.sqrt((2 * np.pi) ** 3 * variance.prod()))
