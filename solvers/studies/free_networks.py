"""Many free networks at once, as plain arrays: the perspective and the orthogonal adjustment of Ono & Hattori's kind.

R networks of I images that all see the same n points; mm throughout. The points are eliminated, the datum is found numerically:
the
directions that the normal equations leave free are constrained on the object points (inner constraints), the seven of a
similarity
and, for an orthogonal stereo pair, one more. Follows `orientation.bundle` and is tested against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import skew
from .estimators import exponential

ENOUGH = 1e-4
"""Change of a coordinate [mm] below which a network has come to rest."""


@dataclass(frozen=True)
class Networks:
    """c (R,) mm; m (R, I, 3, 3); centre (R, I, 3) mm; points (R, n, 3) mm."""

    c: np.ndarray
    m: np.ndarray
    centre: np.ndarray
    points: np.ndarray

    def take(self, rows: np.ndarray) -> Networks:
        """Some of the networks."""
        return Networks(self.c[rows], self.m[rows], self.centre[rows], self.points[rows])

    def camera(self) -> np.ndarray:
        """(R, I, n, 3) mm, points in the photos' axes."""
        return (self.points[:, None] - self.centre[:, :, None]) @ np.swapaxes(self.m, 2, 3)

    def project(self) -> np.ndarray:
        """(R, I, n, 2) mm, photo coordinates; NaN behind the camera."""
        uvw = self.camera()
        return -self.c[:, None, None, None] * uvw[..., :2] / np.where(uvw[..., 2:] < 0, uvw[..., 2:], np.nan)


@dataclass(frozen=True)
class Solved:
    """What came of every network. sigma0 (R,) mm; converged (R,); iterations (R,); internal (R, 3) mm: root mean square of the
    standard errors of the points, a posteriori; residual (R,) mm: root mean square of the perspective residuals."""

    networks: Networks
    sigma0: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    internal: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class _Normal:
    """Points eliminated: scaled reduced system s (R, k, k), right side g (R, k), scale (R, k), y (R, k, n, 3) = W V^-1, points'
    own inverse vi (R, n, 3, 3) and right side h (R, n, 3); square (R,): sum of squared residuals."""

    s: np.ndarray
    g: np.ndarray
    scale: np.ndarray
    y: np.ndarray
    vi: np.ndarray
    h: np.ndarray
    square: np.ndarray


def adjust(xy: np.ndarray, start: Networks, model: str, free_c: bool, defect: int, most: int = 100,
           turn: float = np.inf) -> Solved:
    """Adjust networks to photo coordinates xy (R, I, n, 2) mm by Gauss-Newton.

    model: "perspective"; "orthogonal", the rays made parallel anew in every iteration; "frozen", where xy are orthogonal
    coordinates already. defect: directions that stay free (7; 8 for an orthogonal stereo pair). turn: largest rotation [rad] of
    an image in one step, by which the whole step is shortened.
    """
    r, i, n = xy.shape[:3]
    if r == 0:
        return Solved(start, *(np.zeros(shape) for shape in (0, 0, 0, (0, 3), 0)))
    now = Networks(start.c.copy(), start.m.copy(), start.centre.copy(), start.points.copy())
    converged, lost, count = np.zeros(r, bool), np.zeros(r, bool), np.zeros(r, int)
    with np.errstate(all="ignore"):  # what runs away may overflow before it is noticed
        for _ in range(most):
            rows = np.flatnonzero(~converged & ~lost)
            if not len(rows):
                break
            part, moved, good = _stepped(xy[rows], now.take(rows), model, free_c, defect, turn)
            count[rows] += 1
            for name in ("c", "m", "centre", "points"):
                getattr(now, name)[rows[good]] = getattr(part, name)[good]
            lost[rows[~good]] = True
            converged[rows[good]] = moved[good] < ENOUGH
        sigma0, internal = _judged(xy, now, model, free_c, defect)
        residual = np.sqrt(((xy - now.project()) ** 2).mean(axis=(1, 2, 3)))
    dof = 2 * i * n - 6 * i - 3 * n - free_c + defect
    return Solved(now, np.sqrt(sigma0 / dof), converged, count, internal * np.sqrt(sigma0 / dof)[:, None], residual)


def _stepped(xy: np.ndarray, now: Networks, model: str, free_c: bool, defect: int,
             turn: float) -> tuple[Networks, np.ndarray, np.ndarray]:
    """Networks one step on, the largest change of a coordinate (R,), and which of them are still networks."""
    normal = _normal(xy, now, model, free_c)
    sound = np.asarray(np.isfinite(normal.s).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(np.where(sound[:, None, None], normal.s, np.eye(normal.s.shape[1])))
    z = np.einsum("rkl,rl,rml,rm->rk", vectors[:, :, defect:], 1 / values[:, defect:], vectors[:, :, defect:], normal.g)
    dx = np.einsum("rpab,rpb->rpa", normal.vi, normal.h) - np.einsum("rkpa,rk->rpa", normal.y, z / normal.scale)
    k = vectors[:, :, :defect] / normal.scale[:, :, None]  # directions that stay free: images, then points
    kx = -np.einsum("rkpa,rkf->rpaf", normal.y, k)
    flat = kx.reshape(len(xy), -1, defect)
    flat, mix = _orthonormal(flat)
    share = np.einsum("ruf,ru->rf", flat, dx.reshape(len(xy), -1))
    dx -= np.einsum("ruf,rf->ru", flat, share).reshape(dx.shape)
    da = z / normal.scale - np.einsum("rkf,rfg,rg->rk", k, mix, share)
    if np.isfinite(turn):
        angle = da[:, :-1 if free_c else None].reshape(len(da), -1, 6)[..., 3:] if model == "perspective" else (
            da[:, :-1 if free_c else None].reshape(len(da), -1, 6)[..., :3])
        short = np.minimum(1.0, turn / np.maximum(np.linalg.norm(angle, axis=2).max(axis=1), 1e-300))
        da, dx = da * short[:, None], dx * short[:, None, None]
    moved = _retracted(now, da, dx, model, free_c)
    good = sound & np.isfinite(da).all(axis=1) & np.isfinite(dx).all(axis=(1, 2)) & (np.abs(moved.c) < 1e6)
    good &= np.abs(dx).max(axis=(1, 2)) < 1e7
    if model == "perspective":  # the orthogonal iteration may lead through impossible places and back
        good &= (moved.camera()[..., 2] < 0).all(axis=(1, 2))
    return moved, np.abs(dx).max(axis=(1, 2)), good


def _orthonormal(k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal columns (R, u, f) spanning those of k, and the (R, f, f) matrix that makes them: q = k mix."""
    gram = np.swapaxes(k, 1, 2) @ k
    size = np.sqrt(np.maximum(np.einsum("rff->rf", gram), 1e-300))
    values, vectors = np.linalg.eigh(np.nan_to_num(gram / size[:, :, None] / size[:, None]))
    mix = vectors / np.sqrt(np.maximum(values, 1e-300))[:, None] / size[:, :, None]
    return k @ mix, mix


def _normal(xy: np.ndarray, now: Networks, model: str, free_c: bool) -> _Normal:
    v, a, b = _perspective(xy, now, free_c) if model == "perspective" else _orthogonal(xy, now, free_c, model == "frozen")
    r, i, n = xy.shape[:3]
    k = 6 * i + free_c
    bt = np.swapaxes(b, 3, 4)
    vi = np.linalg.inv(np.nan_to_num((bt @ b).sum(axis=1)) + 1e-30 * np.eye(3))
    h = (bt @ v[..., None]).sum(axis=1)[..., 0]
    w = np.zeros((r, k, n, 3))
    s, g = np.zeros((r, k, k)), np.zeros((r, k))
    at = np.swapaxes(a, 3, 4)
    each, own, right = at @ a, at @ b, (at @ v[..., None])[..., 0]
    for j in range(i):
        rows = np.r_[6 * j:6 * j + 6, 6 * i:k]
        s[:, rows[:, None], rows] += each[:, j].sum(axis=1)
        g[:, rows] += right[:, j].sum(axis=1)
        w[:, rows] += np.swapaxes(own[:, j], 1, 2)
    y = np.einsum("rkpa,rpab->rkpb", w, vi)
    scale = np.sqrt(np.maximum(np.einsum("rkk->rk", s), 1e-300))
    s = s - y.reshape(r, k, -1) @ np.swapaxes(w.reshape(r, k, -1), 1, 2)
    g = g - np.einsum("rkpa,rpa->rk", y, h)
    return _Normal(s / scale[:, :, None] / scale[:, None], g / scale, scale, y, vi, h, (v**2).sum(axis=(1, 2, 3)))


def _perspective(xy: np.ndarray, now: Networks, free_c: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (R, I, n, 2) and derivatives by image (centre, rotation, c) and point (R, I, n, 2, 3)."""
    cam = now.camera()
    f = -now.c[:, None, None] / np.where(cam[..., 2] < 0, cam[..., 2], np.nan)
    computed = f[..., None] * cam[..., :2]
    by_cam = np.zeros((*cam.shape[:3], 2, 3))
    by_cam[..., 0, 0] = by_cam[..., 1, 1] = f
    by_cam[..., 2] = -computed / cam[..., 2:]
    b = by_cam @ now.m[:, :, None]
    parts = [-b, -by_cam @ skew(cam)]
    if free_c:
        parts.append((computed / now.c[:, None, None, None])[..., None])
    return xy - computed, np.concatenate(parts, axis=-1), b


def _parallel(now: Networks) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scales s (R, I), image points t (R, I, 2) of the middle of the points and points q (R, I, n, 3) about it in photo
    axes."""
    middle = now.points.mean(axis=1, keepdims=True)
    to = np.einsum("riab,rib->ria", now.m, middle - now.centre)
    s = now.c[:, None] / -to[..., 2]
    return s, s[..., None] * to[..., :2], (now.points - middle)[:, None] @ np.swapaxes(now.m, 2, 3)


def _orthogonal(xy: np.ndarray, now: Networks, free_c: bool, frozen: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residuals x_a - g and derivatives by image (rotation, log s, t, c) and point; c by the total derivative."""
    s, t, q = _parallel(now)
    per_c = s[:, :, None] / now.c[:, None, None] * q[..., 2]
    v = (1.0 if frozen else (1 - per_c)[..., None]) * xy - s[:, :, None, None] * q[..., :2] - t[:, :, None]
    a = np.zeros((*q.shape[:3], 2, 6 + free_c))
    a[..., :3] = -s[:, :, None, None, None] * skew(q)[..., :2, :]
    a[..., 3] = s[:, :, None, None] * q[..., :2]
    a[..., 0, 4] = a[..., 1, 5] = 1.0
    if free_c:
        a[..., 6] = -(per_c / now.c[:, None, None])[..., None] * xy
    b = np.broadcast_to((s[..., None, None] * now.m[:, :, :2])[:, :, None], (*q.shape[:3], 2, 3))
    return v, a, b


def _retracted(now: Networks, da: np.ndarray, dx: np.ndarray, model: str, free_c: bool) -> Networks:
    i = now.m.shape[1]
    step = da[:, :6 * i].reshape(len(da), i, 6)
    c = now.c + (da[:, 6 * i] if free_c else 0.0)
    turn = step[..., 3:] if model == "perspective" else step[..., :3]
    m = exponential(np.nan_to_num(turn).reshape(-1, 3)).reshape(now.m.shape) @ now.m
    points = now.points + dx
    if model == "perspective":
        return Networks(c, m, now.centre + step[..., :3], points)
    s, t, _ = _parallel(now)
    s, t = s * np.exp(np.clip(step[..., 3], -5, 5)), t + step[..., 4:]
    to = np.concatenate([t / s[..., None], -(c[:, None] / s)[..., None]], axis=-1)
    middle = now.points.mean(axis=1, keepdims=True)  # of the step's start: s and t belong to it
    return Networks(c, m, middle - np.einsum("riba,rib->ria", m, to), points)


def _judged(xy: np.ndarray, now: Networks, model: str, free_c: bool, defect: int) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squared residuals (R,) and root mean square cofactors (R, 3) of the points with inner constraints."""
    normal = _normal(xy, now, model, free_c)
    r, n = xy.shape[0], xy.shape[2]
    sound = np.asarray(np.isfinite(normal.s).all(axis=(1, 2)))
    values, vectors = np.linalg.eigh(np.where(sound[:, None, None], normal.s, np.eye(normal.s.shape[1])))
    y = (normal.y / normal.scale[:, :, None, None]).reshape(r, -1, 3 * n)
    root = np.swapaxes(y, 1, 2) @ (vectors[:, :, defect:] / np.sqrt(np.maximum(values[:, None, defect:], 1e-300)))
    q = root @ np.swapaxes(root, 1, 2)
    for p in range(n):
        q[:, 3 * p:3 * p + 3, 3 * p:3 * p + 3] += normal.vi[:, p]
    k, _ = _orthonormal(-np.swapaxes(y, 1, 2) @ vectors[:, :, :defect])
    kq = np.swapaxes(k, 1, 2) @ q
    diagonal = np.einsum("ruu->ru", q) - 2 * np.einsum("ruf,rfu->ru", k, kq) + np.einsum("ruf,rfg,rug->ru", k, kq @ k, k)
    return np.where(sound, normal.square, np.nan), np.sqrt(diagonal.reshape(r, n, 3).mean(axis=1))


def parallel_coordinates(now: Networks, xy: np.ndarray) -> np.ndarray:
    """(R, I, n, 2) mm, orthogonal coordinates x_a of photo coordinates xy with the depths of the networks."""
    s, _, q = _parallel(now)
    return (1 - s[:, :, None] / now.c[:, None, None] * q[..., 2])[..., None] * xy


def free_steps(now: Networks, model: str, defect: int) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal steps on the points (R, 3 n, f) that the observations leave free, and the images' part (R, 6 I, f) of
    each."""
    normal = _normal(now.project(), now, model, False)
    k = np.linalg.eigh(normal.s)[1][:, :, :defect] / normal.scale[:, :, None]
    flat, mix = _orthonormal(-np.einsum("rkpa,rkf->rpaf", normal.y, k).reshape(len(k), -1, defect))
    return flat, k @ mix


def stepped(now: Networks, images: np.ndarray, points: np.ndarray, model: str) -> Networks:
    """Networks moved by a step of the images (R, 6 I) and the points (R, n, 3), c held."""
    return _retracted(now, images, points, model, False)


def spectrum(now: Networks, model: str, free_c: bool = False) -> np.ndarray:
    """(R, k) eigenvalues, over the largest, of the scaled reduced normal matrix of the images at exact photo coordinates,
    smallest first: as many as are zero are left free by the observations."""
    values = np.linalg.eigvalsh(_normal(now.project(), now, model, free_c).s)
    return values / values[:, -1:]


# -- how far a network is from the truth ---------------------------------------------------------------------------------------


def after_similarity(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(R, 3) root mean square differences from the truth (R, n, 3) after the similarity of least squares."""
    a, b = points.mean(axis=1, keepdims=True), truth.mean(axis=1, keepdims=True)
    u, d, vt = np.linalg.svd(np.swapaxes(truth - b, 1, 2) @ (points - a))
    sign = np.ones_like(d)
    sign[:, 2] = np.sign(np.linalg.det(u @ vt))
    turn = (u * sign[:, None]) @ vt
    scale = (d * sign).sum(axis=1) / ((points - a) ** 2).sum(axis=(1, 2))
    moved = scale[:, None, None] * (points - a) @ np.swapaxes(turn, 1, 2) + b
    return np.sqrt(((moved - truth) ** 2).mean(axis=1))


def after_affinity(points: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(R, 3) the same after the affine transformation of least squares (12 parameters)."""
    a = points - points.mean(axis=1, keepdims=True)
    b = truth - truth.mean(axis=1, keepdims=True)
    at = np.swapaxes(a, 1, 2)
    off = a @ (np.linalg.pinv(at @ a, rcond=1e-14) @ (at @ b)) - b
    return np.sqrt((off**2).mean(axis=1))


def pooled(axes: np.ndarray) -> np.ndarray:
    """(R,) one number of three: root mean square over the axes."""
    return np.sqrt((axes**2).mean(axis=-1))


__all__ = ["Networks", "Solved", "adjust", "after_affinity", "after_similarity", "free_steps", "parallel_coordinates", "pooled",
           "spectrum", "stepped"]
