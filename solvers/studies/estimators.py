"""Thousands of single images at once, as plain arrays: the estimators that the studies compare.

points (B, n, 3) m, xy (B, n, 2) mm ideal photo coordinates; orientations are m (B, 3, 3) and centre (B, 3).
They follow `orientation.resection` and `orientation.orthogonal` and are tested against them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import skew


@dataclass(frozen=True)
class Poses:
    """m (B, 3, 3), centre (B, 3), ok (B,) whether an orientation was reached."""

    m: np.ndarray
    centre: np.ndarray
    ok: np.ndarray

    def error(self, m: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """(B, 6) differences from the truth: centre [m] and left rotation vector [rad]."""
        d = self.m @ np.swapaxes(m, -1, -2)
        vee = np.stack([d[:, 2, 1] - d[:, 1, 2], d[:, 0, 2] - d[:, 2, 0], d[:, 1, 0] - d[:, 0, 1]], axis=1) / 2
        sine = np.linalg.norm(vee, axis=1, keepdims=True)
        angle = np.arctan2(sine, ((np.trace(d, axis1=1, axis2=2) - 1) / 2)[:, None])
        return np.hstack([self.centre - centre, vee * np.where(sine > 1e-12, angle / np.where(sine > 0, sine, 1), 1.0)])


def exponential(d: np.ndarray) -> np.ndarray:
    """Rotations (B, 3, 3) of rotation vectors (B, 3)."""
    theta = np.linalg.norm(d, axis=1)[:, None, None]
    safe = np.where(theta > 1e-9, theta, 1.0)
    a, b = np.where(theta > 1e-9, np.sin(safe) / safe, 1.0), np.where(theta > 1e-9, (1 - np.cos(safe)) / safe**2, 0.5)
    k = skew(d)
    return np.eye(3) + a * k + b * (k @ k)


def perspective(points: np.ndarray, xy: np.ndarray, c: float, sigma_mm: np.ndarray, start: Poses,
                prior: tuple[Poses, np.ndarray] | None = None, steps: int = 60) -> tuple[Poses, np.ndarray]:
    """Collinearity by damped least squares; prior: orientations and the inverse covariance (6, 6) of (centre, rotation).

    Returns the orientations and their costs (B,), half the weighted sum of squares.
    """
    m, centre = start.m.copy(), start.centre.copy()
    damping = np.full(len(m), 1e-3)
    cost, v, j, gap = _collinearity(points, xy, c, sigma_mm, m, centre, prior)
    for _ in range(steps):
        n, g = np.swapaxes(j, 1, 2) @ j, (np.swapaxes(j, 1, 2) @ v[..., None])[..., 0]
        if prior is not None:
            n, g = n + prior[1], g + gap @ prior[1]
        d = np.sqrt(np.maximum(np.einsum("bii->bi", n), 1e-300))
        system = n / d[:, :, None] / d[:, None, :] + (damping[:, None, None] + 1e-14) * np.eye(6)
        dx = np.linalg.solve(system, (g / d)[..., None])[..., 0] / d
        trial = exponential(dx[:, 3:]) @ m, centre + dx[:, :3]
        tcost, tv, tj, tgap = _collinearity(points, xy, c, sigma_mm, *trial, prior)
        better = tcost <= cost
        m, centre = np.where(better[:, None, None], trial[0], m), np.where(better[:, None], trial[1], centre)
        v, j, gap = np.where(better[:, None], tv, v), np.where(better[:, None, None], tj, j), np.where(better[:, None], tgap, gap)
        cost, damping = np.where(better, tcost, cost), np.where(better, damping * 0.2, np.maximum(damping, 1e-9) * 8)
        if (np.linalg.norm(dx * d, axis=1)[better] < 1e-7).all() and better.mean() > 0.2:
            break
    return Poses(m, centre, np.isfinite(cost)), cost


def best_of(*found: tuple[Poses, np.ndarray]) -> Poses:
    """Run by run the orientation of least cost."""
    pick = np.argmin(np.stack([np.where(np.isfinite(c), c, np.inf) for _, c in found]), axis=0)
    rows = np.arange(len(pick))
    stack = [np.stack([getattr(p, name) for p, _ in found])[pick, rows] for name in ("m", "centre", "ok")]
    return Poses(*stack)


def _collinearity(points: np.ndarray, xy: np.ndarray, c: float, sigma_mm: np.ndarray, m: np.ndarray, centre: np.ndarray,
                  prior: tuple[Poses, np.ndarray] | None) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Cost (B,), whitened residuals (B, 2n), whitened Jacobian (B, 2n, 6) and the prior's misclosure (B, 6)."""
    uvw = (points - centre[:, None]) @ np.swapaxes(m, 1, 2)
    w = np.where(uvw[..., 2] < 0, uvw[..., 2], np.nan)
    x, y = uvw[..., 0] / w, uvw[..., 1] / w
    by = np.zeros((*uvw.shape[:2], 2, 3))
    by[..., 0, 0] = by[..., 1, 1] = -c / w
    by[..., 0, 2], by[..., 1, 2] = c * x / w, c * y / w
    j = np.concatenate([-by @ m[:, None], -by @ skew(uvw)], axis=-1) / sigma_mm[..., None, None]
    v = (xy + c * np.stack([x, y], axis=-1)) / sigma_mm[..., None]
    b, n = uvw.shape[:2]
    cost = 0.5 * (v**2).sum(axis=(1, 2))
    gap = np.zeros((b, 6))
    if prior is not None:
        gap = -Poses(m, centre, np.ones(b, bool)).error(prior[0].m, prior[0].centre)
        cost = cost + 0.5 * np.einsum("bi,ij,bj->b", gap, prior[1], gap)
    return np.where(np.isfinite(cost), cost, np.inf), v.reshape(b, 2 * n), j.reshape(b, 2 * n, 6), gap


def orthogonal_pass(points: np.ndarray, xy: np.ndarray, c: float, approximate: Poses, form: str = "depth",
                    recentre: bool = True, steps: int = 40) -> Poses:
    """One pass of the orthogonal model through approximate orientations (FORMULAS sections 3.1 to 3.5)."""
    b = len(points)
    r = _recentring(xy, c) if recentre else np.broadcast_to(np.eye(3), (b, 3, 3))
    rays = np.concatenate([xy, np.full((*xy.shape[:2], 1), -c)], axis=2) @ np.swapaxes(r, 1, 2)
    x = -c * rays[..., :2] / rays[..., 2:]
    m0, mean = r @ approximate.m, points.mean(axis=1)
    if form == "depth":
        depth = -np.einsum("bni,bi->bn", points - approximate.centre[:, None], m0[:, 2])
        k = depth / -np.einsum("bi,bi->b", mean - approximate.centre, m0[:, 2])[:, None]
    else:
        q, m33c = np.einsum("bni,bi->bn", x, m0[:, :2, 2]), m0[:, 2, 2, None] * c
        k = (points[..., 2] - approximate.centre[:, None, 2]) / (mean - approximate.centre)[:, 2, None] * m33c / (m33c - q)
    xa = k[..., None] * x
    m, s = _scaled_rotation(points - mean[:, None], xa - xa.mean(axis=1, keepdims=True), m0, steps)
    t = xa.mean(axis=1)
    with np.errstate(all="ignore"):
        if form == "depth":
            local = np.stack([t[:, 0] / s, t[:, 1] / s, -c / s], axis=1)
            centre = mean - np.einsum("bji,bj->bi", m, local)
        else:
            z = mean[:, 2] + m[:, 2, 2] * c / s
            right = np.einsum("bij,bj->bi", m[:, :2], mean) - t / s[:, None] - m[:, :2, 2] * z[:, None]
            det = m[:, 0, 0] * m[:, 1, 1] - m[:, 0, 1] * m[:, 1, 0]
            xc = (right[:, 0] * m[:, 1, 1] - right[:, 1] * m[:, 0, 1]) / det
            yc = (m[:, 0, 0] * right[:, 1] - m[:, 1, 0] * right[:, 0]) / det
            centre = np.stack([xc, yc, z], axis=1)
    ok = (s > 0) & np.isfinite(centre).all(axis=1)
    return Poses(np.swapaxes(r, 1, 2) @ m, centre, ok)


def orthogonal_iterated(points: np.ndarray, xy: np.ndarray, c: float, start: Poses, form: str = "depth", recentre: bool = True,
                        rounds: int = 100) -> Poses:
    """Transform again until nothing changes; ok tells which runs came to rest."""
    m, centre = start.m.copy(), start.centre.copy()
    ok, moving = np.zeros(len(points), bool), np.arange(len(points))
    for _ in range(rounds):
        now = Poses(m[moving], centre[moving], np.ones(len(moving), bool))
        nxt = orthogonal_pass(points[moving], xy[moving], c, now, form, recentre)
        change = np.linalg.norm(nxt.error(now.m, now.centre)[:, 3:], axis=1)
        m[moving], centre[moving] = nxt.m, nxt.centre
        ok[moving] = nxt.ok & (change < 1e-7)
        moving = moving[nxt.ok & (change >= 1e-7)]
        if not len(moving):
            break
    return Poses(m, centre, ok)


def _recentring(xy: np.ndarray, c: float) -> np.ndarray:
    rays = np.concatenate([xy, np.full((*xy.shape[:2], 1), -c)], axis=2)
    z = -(rays / np.linalg.norm(rays, axis=2, keepdims=True)).mean(axis=1)
    z = z / np.linalg.norm(z, axis=1, keepdims=True)
    k = skew(np.cross(z, [0.0, 0.0, 1.0]))
    return np.eye(3) + k + k @ k / (1 + z[:, 2, None, None])


def _scaled_rotation(reduced: np.ndarray, xa: np.ndarray, m: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """min |xa - s M_12 X| over rotations and scales (the constrained adjustment of FORMULAS 3.3), damped, near the start m."""
    def model(m: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        cam = reduced @ np.swapaxes(m, 1, 2)
        v = xa - s[:, None, None] * cam[..., :2]
        j = np.concatenate([-s[:, None, None, None] * skew(cam)[..., :2, :], cam[..., :2, None]], axis=-1)
        return v, j, (v**2).sum(axis=(1, 2))

    flat_model = (reduced @ np.swapaxes(m, 1, 2))[..., :2]
    s = (xa * flat_model).sum(axis=(1, 2)) / (flat_model**2).sum(axis=(1, 2))
    damping = np.full(len(m), 1e-6)
    v, j, cost = model(m, s)
    b = len(m)
    for _ in range(steps):
        flat = j.reshape(b, -1, 4)
        n, g = np.swapaxes(flat, 1, 2) @ flat, (np.swapaxes(flat, 1, 2) @ v.reshape(b, -1, 1))[..., 0]
        d = np.sqrt(np.maximum(np.einsum("bii->bi", n), 1e-300))
        system = n / d[:, :, None] / d[:, None, :] + (damping[:, None, None] + 1e-14) * np.eye(4)
        dx = np.linalg.solve(system, (g / d)[..., None])[..., 0] / d
        tm, ts = exponential(dx[:, :3]) @ m, s + dx[:, 3]
        tv, tj, tcost = model(tm, ts)
        better = tcost <= cost
        m, s = np.where(better[:, None, None], tm, m), np.where(better, ts, s)
        v, j = np.where(better[:, None, None], tv, v), np.where(better[:, None, None, None], tj, j)
        cost = np.where(better, tcost, cost)
        damping = np.where(better, damping * 0.2, np.maximum(damping, 1e-9) * 8)
        if (np.abs(dx[:, :3]).max(axis=1)[better] < 1e-10).all() and better.mean() > 0.2:
            break
    return m, s
