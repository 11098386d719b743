"""Rotations of the field: M = M_kappa M_phi M_omega turns object axes into photo axes.

Inside, a rotation is the 3x3 matrix M and its tangent is the left rotation vector d: M <- exp([d]x) M, which has no
singular attitude; omega, phi, kappa are only for people. Reference: docs/formulas.md 2.
"""

from __future__ import annotations

import numpy as np


def rotation(omega: float, phi: float, kappa: float) -> np.ndarray:
    """M (3, 3) of omega, phi, kappa [rad]."""
    so, co, sp, cp, sk, ck = np.sin(omega), np.cos(omega), np.sin(phi), np.cos(phi), np.sin(kappa), np.cos(kappa)
    return np.array([
        [cp * ck, so * sp * ck + co * sk, -co * sp * ck + so * sk],
        [-cp * sk, -so * sp * sk + co * ck, co * sp * sk + so * ck],
        [sp, -so * cp, co * cp],
    ])


def angles(m: np.ndarray) -> np.ndarray:
    """(3,) omega, phi, kappa [rad] of M; kappa is set to 0 where phi is +-90 degrees and omega and kappa fall together."""
    horizontal = np.hypot(m[2, 1], m[2, 2])
    phi = np.arctan2(m[2, 0], horizontal)  # atan2 keeps the digits that asin loses near +-90 degrees
    if horizontal < 1e-12:
        return np.array([np.arctan2(m[1, 2], m[1, 1]), phi, 0.0])
    return np.array([np.arctan2(-m[2, 1], m[2, 2]), phi, np.arctan2(-m[1, 0], m[0, 0])])


def skew(v: np.ndarray) -> np.ndarray:
    """[v]x (..., 3, 3) of v (..., 3): skew(v) w = v x w."""
    v = np.asarray(v, float)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp(d: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of the rotation vector d (3,) [rad] (Rodrigues)."""
    theta2 = float(np.dot(d, d))
    k = skew(d)
    if theta2 < 1e-10:
        a, b = 1 - theta2 / 6, 0.5 - theta2 / 24
    else:
        theta = np.sqrt(theta2)
        a, b = np.sin(theta) / theta, (1 - np.cos(theta)) / theta2
    return np.eye(3) + a * k + b * (k @ k)


def exp_many(d: np.ndarray) -> np.ndarray:
    """(m, 3, 3) rotations of rotation vectors (m, 3) [rad]."""
    theta2 = (d**2).sum(axis=1)
    small = theta2 < 1e-10
    theta = np.sqrt(np.where(small, 1.0, theta2))
    a = np.where(small, 1 - theta2 / 6, np.sin(theta) / theta)
    b = np.where(small, 0.5 - theta2 / 24, (1 - np.cos(theta)) / theta**2)
    k = np.zeros((len(d), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -d[:, 2], d[:, 1], -d[:, 0]
    k -= np.swapaxes(k, 1, 2)
    return np.eye(3) + a[:, None, None] * k + b[:, None, None] * (k @ k)


def log(m: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad], length at most pi, of a rotation (3, 3), by its quaternion: exact digits up to pi.

    Reference: Shepperd 1978, "Quaternion from rotation matrix" (the largest component first).
    """
    t = np.trace(m)
    vee = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    outer = np.empty((4, 4))  # 4 q q^T, scalar first
    outer[0, 0], outer[0, 1:], outer[1:, 0] = 1 + t, vee, vee
    outer[1:, 1:] = m + m.T + (1 - t) * np.eye(3)
    q = outer[np.argmax(np.diag(outer))]
    q = q / np.linalg.norm(q) * (1 if q[0] >= 0 else -1)
    s = float(np.linalg.norm(q[1:]))
    return q[1:] * (2 * np.arctan2(s, q[0]) / s if s > 0 else 2.0)


def log_many(m: np.ndarray) -> np.ndarray:
    """(n, 3) rotation vectors [rad] of rotations (n, 3, 3), as `log`."""
    n = len(m)
    t = np.einsum("naa->n", m)
    vee = np.stack([m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1)
    outer = np.empty((n, 4, 4))
    outer[:, 0, 0], outer[:, 0, 1:], outer[:, 1:, 0] = 1 + t, vee, vee
    outer[:, 1:, 1:] = m + np.swapaxes(m, 1, 2) + (1 - t)[:, None, None] * np.eye(3)
    q = outer[np.arange(n), np.argmax(np.einsum("naa->na", outer), axis=1)]
    q = q / np.linalg.norm(q, axis=1, keepdims=True) * np.where(q[:, :1] >= 0, 1, -1)
    s = np.linalg.norm(q[:, 1:], axis=1)
    return q[:, 1:] * np.where(s > 0, 2 * np.arctan2(s, q[:, 0]) / np.where(s > 0, s, 1.0), 2.0)[:, None]


def closest_rotation(a: np.ndarray) -> np.ndarray:
    """The rotation (3, 3) closest to a (3, 3) in the Frobenius norm, determinant +1 (SVD)."""
    u, _, vt = np.linalg.svd(a)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt


def angle_derivatives(m: np.ndarray) -> np.ndarray:
    """d(omega, phi, kappa) / d(left rotation vector), (3, 3); large, as it must be, near phi = +-90 degrees."""
    _, phi, kappa = angles(m)
    sk, ck, sp, cp = np.sin(kappa), np.cos(kappa), np.sin(phi), np.cos(phi)
    # columns: left rotation vectors of unit rates of omega, phi, kappa
    rates = np.array([[-cp * ck, -sk, 0.0], [cp * sk, -ck, 0.0], [-sp, 0.0, -1.0]])
    return np.linalg.inv(rates) if abs(cp) > 1e-6 else np.linalg.pinv(rates, rcond=1e-9)
