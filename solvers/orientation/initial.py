"""Initial values without any approximate value: every candidate attitude the control allows, refined and ranked.

Reference: FORMULAS section 4; Grunert 1841 and Haralick et al. 1994 (three points); DeMenthon & Davis 1995 (POSIT).
All functions take points (n, 3) m reduced to their centroid and ideal photo coordinates xy (n, 2) in the unit of c.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from ..geometry import Exterior, closest_rotation, skew

_PATIENCE = 8
"""Refining steps granted to every start."""


def recentring(xy: np.ndarray, c: float) -> np.ndarray:
    """R_v (3, 3): turns the photo so that the mean ray becomes the optical axis of a virtual camera (FORMULAS 3.2)."""
    rays = _rays(xy, c)
    mean = rays.mean(axis=0)
    z = -mean / np.linalg.norm(mean)
    axis = np.cross(z, [0.0, 0.0, 1.0])  # the smallest turn that brings z to (0, 0, 1)
    k = skew(axis)
    return np.eye(3) + k + k @ k / (1 + z[2])


def turned(xy: np.ndarray, c: float, r: np.ndarray) -> np.ndarray:
    """Photo coordinates (n, 2) in a camera turned by r (3, 3), same centre and principal distance."""
    v = np.concatenate([xy, np.full((len(xy), 1), -c)], axis=1) @ r.T
    return -c * v[:, :2] / v[:, 2:]


@dataclass(frozen=True)
class Candidate:
    """A local minimum, the start that first led to it and how that start was found; cost in the unit of c squared."""

    exterior: Exterior
    start: Exterior
    source: str
    cost: float


def candidates(points: np.ndarray, xy: np.ndarray, c: float) -> list[Candidate]:
    """All distinct local minima found from every start of FORMULAS section 4, best first; empty when none is in front.

    Attitudes closer than a hundredth of a degree count as one.
    """
    found = _different(starts(points, xy, c), points, xy, c)
    refined, cost = refine(points, xy, c, [e for _, e in found])
    out: list[Candidate] = []
    for i in np.argsort(cost, kind="stable"):
        if np.isfinite(cost[i]) and all(apart(refined[i], other.exterior) > np.radians(0.01) for other in out):
            led = [np.isfinite(cost[k]) and apart(refined[k], refined[i]) <= np.radians(0.01) for k in range(len(found))]
            first = led.index(True)
            out.append(Candidate(refined[i], found[first][1], found[first][0], float(cost[i])))
    return out


def starts(points: np.ndarray, xy: np.ndarray, c: float) -> list[tuple[str, Exterior]]:
    """Every start, the crudest first, with its name: parallel projection, three points, DLT, homography."""
    r_v = recentring(xy, c)
    out = [("parallel projection", Exterior(r_v.T @ e.m, e.centre)) for e in scaled_orthography(points, turned(xy, c, r_v), c)]
    out += [("three points", e) for rows in wide_triples(points) for e in three_points(points[rows], xy[rows], c)]
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) >= 6 and s[2] > 1e-3 * s[0]:
        out += [("direct linear transformation", e) for e in direct_linear(points, xy, c)]
    if len(points) >= 4 and s[2] < 0.1 * s[0]:
        out += [("plane homography", e) for e in plane_homography(points, xy, c)]
    return out


def _different(found: list[tuple[str, Exterior]], points: np.ndarray, xy: np.ndarray, c: float) -> list[tuple[str, Exterior]]:
    """The starts with all points in front; of those closer than half a degree to each other only the first, the crudest."""
    if not found:
        return []
    m, centre = np.stack([e.m for _, e in found]), np.stack([e.centre for _, e in found])
    front = ((points @ m[:, 2].T - np.einsum("ki,ki->k", m[:, 2], centre)) < 0).all(axis=0)
    flat = m.reshape(-1, 9)
    gap2 = 6 - 2 * flat @ flat.T  # squared Frobenius distance, 8 sin^2(angle / 2)
    keep: list[int] = []
    for i in np.flatnonzero(front):
        if (gap2[i, keep] > 2 * np.radians(0.5) ** 2).all():
            keep.append(int(i))
    return [found[i] for i in keep]


def scaled_orthography(points: np.ndarray, xy: np.ndarray, c: float, updates: int = 2,
                       kinds: tuple[str | float, ...] = ("affine", 1.0, -1.0)) -> list[Exterior]:
    """Orientations by parallel projection: the affine one (non-planar points) and both reversal solutions of the plane.

    xy must be near the optical axis (re-centred). Each is improved by `updates` POSIT steps. kinds: "affine", and the signs
    of the reversal solutions.
    """
    mean = points.mean(axis=0)
    reduced = points - mean
    u, s, vt = np.linalg.svd(reduced, full_matrices=False)
    out = []
    for kind in kinds:
        if kind == "affine" and s[2] < 1e-4 * s[0]:
            continue
        target = xy
        exterior = None
        for _ in range(updates + 1):
            centred = target - target.mean(axis=0)
            if kind == "affine":
                block = (vt.T @ ((u.T @ centred) / s[:, None])).T
            else:
                block = planar_block(centred, u, s, vt, float(kind))
            exterior = _from_block(block, target.mean(axis=0), mean, c)
            if exterior is None:
                break
            depth = -exterior.camera(points)[:, 2]
            if (depth <= 0).any():
                break
            target = xy * (depth / depth.mean())[:, None]
        if exterior is not None:
            out.append(exterior)
    return out


def planar_block(centred: np.ndarray, u: np.ndarray, s: np.ndarray, vt: np.ndarray, sign: float) -> np.ndarray:
    """The 2x3 block s M_12 of points in their plane, one of the two reversal solutions (FORMULAS section 3.4)."""
    g = ((u[:, :2].T @ centred) / s[:2, None]).T  # rows g1, g2 in the plane's axes
    ab = np.sqrt(complex(g[1] @ g[1] - g[0] @ g[0], -2 * (g[0] @ g[1])))
    third = sign * np.array([ab.real, ab.imag])
    normal = np.cross(vt[0], vt[1])
    return g @ vt[:2] + third[:, None] * normal


def pose_of_block(block: np.ndarray) -> tuple[np.ndarray, float]:
    """M (3, 3) and scale of a 2x3 block that need not fulfil the constraints: closest rotation, m3 = m1 x m2."""
    u, s, vt = np.linalg.svd(block, full_matrices=False)
    a, b = u @ vt
    m3 = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    return np.array([a, b, m3]), float(s[0] + s[1]) / 2


def _from_block(block: np.ndarray, t: np.ndarray, mean: np.ndarray, c: float) -> Exterior | None:
    m, scale = pose_of_block(block)
    if not (np.isfinite(m).all() and scale > 0):
        return None
    return Exterior(m, mean - m.T @ np.array([t[0] / scale, t[1] / scale, -c / scale]))


def three_points(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
    """All orientations (up to four) that project three points exactly; complex pairs close to real are kept."""
    f = _rays(xy, c)
    a2, b2, c2 = (float(((points[i] - points[j]) ** 2).sum()) for i, j in ((1, 2), (0, 2), (0, 1)))
    ca, cb, cg = float(f[1] @ f[2]), float(f[0] @ f[2]), float(f[0] @ f[1])
    if min(a2, b2, c2) <= 0:
        return []
    q, r = (a2 - c2) / b2, (a2 + c2) / b2
    quartic = [
        (q - 1) ** 2 - 4 * c2 / b2 * ca**2,
        4 * (q * (1 - q) * cb - (1 - r) * ca * cg + 2 * c2 / b2 * ca**2 * cb),
        2 * (q**2 - 1 + 2 * q**2 * cb**2 + 2 * (b2 - c2) / b2 * ca**2 - 4 * r * ca * cb * cg + 2 * (b2 - a2) / b2 * cg**2),
        4 * (-q * (1 + q) * cb + 2 * a2 / b2 * cg**2 * cb - (1 - r) * ca * cg),
        (1 + q) ** 2 - 4 * a2 / b2 * cg**2,
    ]
    distances = []
    for v in np.roots(quartic):
        if abs(v.imag) > 1e-3 * (1 + abs(v)) or v.real <= 0:
            continue
        s1 = np.sqrt(b2 / (1 + v.real**2 - 2 * v.real * cb))
        inner = cg**2 - 1 + c2 / s1**2  # 1 + u^2 - 2 u cos(gamma) = c^2 / s1^2
        roots = [cg + sign * np.sqrt(max(inner, 0.0)) for sign in (1, -1)]
        misfit = [abs(u**2 + v.real**2 - 2 * u * v.real * ca - a2 / s1**2) for u in roots]
        best = int(np.argmin(misfit))
        take = [roots[best]] if misfit[1 - best] > 1e-3 * a2 / s1**2 else roots
        distances += [(s1, s1 * u, s1 * v.real) for u in take if u > 0]
    if not distances:
        return []
    m, centre = _align(points, np.array(distances)[:, :, None] * f)
    return [Exterior(a, b) for a, b in zip(m, centre, strict=True)]


def _align(points: np.ndarray, camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M (k, 3, 3) and centres (k, 3) that carry three object points (3, 3) onto three camera points (k, 3, 3)."""
    corners = np.concatenate([points[None], camera])
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    z = np.cross(a, b)
    frame = np.stack([a, np.cross(z, a), z], axis=2)
    frame = frame / np.maximum(np.linalg.norm(frame, axis=1, keepdims=True), 1e-300)
    m = frame[1:] @ frame[0].T
    return m, points.mean(axis=0) - np.einsum("kji,kj->ki", m, camera.mean(axis=1))


def direct_linear(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
    """Orientation of six or more non-planar points by the direct linear transformation, closest rotation."""
    mean, scale = points.mean(axis=0), np.sqrt(3) / np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean())
    x = np.concatenate([(points - mean) * scale, np.ones((len(points), 1))], axis=1)
    uv, zero = xy / c, np.zeros_like(x)
    rows = np.vstack([np.hstack([x, zero, uv[:, :1] * x]), np.hstack([zero, x, uv[:, 1:] * x])])
    p = np.linalg.svd(rows)[2][-1].reshape(3, 4)  # (u, v, -1) ~ P X
    p = p * np.sign(np.linalg.det(p[:, :3]) or 1.0)
    size = np.cbrt(max(np.linalg.det(p[:, :3]), 1e-300))
    try:
        centre = mean - np.linalg.solve(p[:, :3], p[:, 3]) / scale
    except np.linalg.LinAlgError:
        return []
    return [Exterior(closest_rotation(p[:, :3] / size), centre)]


def plane_homography(points: np.ndarray, xy: np.ndarray, c: float) -> list[Exterior]:
    """Orientation of four or more (nearly) coplanar points from the homography of their plane."""
    mean = points.mean(axis=0)
    _, s, vt = np.linalg.svd(points - mean)
    scale = np.sqrt(len(points)) / s[0]
    ab = np.concatenate([(points - mean) @ vt[:2].T * scale, np.ones((len(points), 1))], axis=1)
    uv, zero = xy / c, np.zeros_like(ab)
    rows = np.vstack([np.hstack([ab, zero, uv[:, :1] * ab]), np.hstack([zero, ab, uv[:, 1:] * ab])])
    h = np.linalg.svd(rows)[2][-1].reshape(3, 3)  # (u, v, -1) ~ H (a, b, 1)
    if h[2, 2] > 0:
        h = -h  # the plane's centre lies in front: W < 0
    length = (np.linalg.norm(h[:, 0]) + np.linalg.norm(h[:, 1])) / 2
    if length <= 0:
        return []
    r1, r2, t = h[:, 0] / length, h[:, 1] / length, h[:, 2] / (length * scale)
    axes = np.stack([vt[0], vt[1], np.cross(vt[0], vt[1])])
    m = closest_rotation(np.stack([r1, r2, np.cross(r1, r2)], axis=1) @ axes)
    return [Exterior(m, mean - m.T @ t)]


def refine(points: np.ndarray, xy: np.ndarray, c: float, exteriors: list[Exterior],
           steps: int = 25) -> tuple[list[Exterior], np.ndarray]:
    """All starts improved together by Levenberg-Marquardt on the ideal coordinates.

    Returns orientations and costs (half the sum of squares, unit of c squared) in the given order; the cost of a start
    with a point behind the camera is inf.
    """
    if not exteriors:
        return [], np.zeros(0)
    m, centre = np.stack([e.m for e in exteriors]), np.stack([e.centre for e in exteriors])
    damping = np.full(len(m), 1e-3)
    v, j = _residuals(points, xy, c, m, centre)
    cost = 0.5 * (v**2).sum(axis=1)
    cost[~np.isfinite(cost)] = np.inf
    live = np.flatnonzero(np.isfinite(cost))
    v, j = v[live], j[live]
    for step in range(steps):
        if not len(live):
            break
        jt = np.swapaxes(j, 1, 2)
        n, g = jt @ j, (jt @ v[..., None])[..., 0]
        d = np.sqrt(np.maximum(np.einsum("kii->ki", n), 1e-300))
        scaled = n / d[:, :, None] / d[:, None, :] + (damping[live, None, None] + 1e-15) * np.eye(6)
        dx = np.linalg.solve(scaled, (g / d)[..., None])[..., 0] / d
        trial_m, trial_c = _exp_batch(dx[:, 3:]) @ m[live], centre[live] + dx[:, :3]
        tv, tj = _residuals(points, xy, c, trial_m, trial_c)
        tcost = 0.5 * (tv**2).sum(axis=1)
        better = tcost <= cost[live]
        won = live[better]
        m[won], centre[won], cost[won] = trial_m[better], trial_c[better], tcost[better]
        v, j = np.where(better[:, None], tv, v), np.where(better[:, None, None], tj, j)
        damping[live] = np.where(better, damping[live] * 0.1, np.maximum(damping[live], 1e-9) * 10)
        go = np.linalg.norm(dx * d, axis=1) >= 1e-7 * np.sqrt(cost[live]) + 1e-10 * c
        if step >= _PATIENCE:  # a start still on its way, a degree off in the photo and far behind the best, leads nowhere
            go &= cost[live] <= max(0.5 * len(points) * (0.02 * c) ** 2, 4 * cost.min())
        live, v, j = live[go], v[go], j[go]
    return [Exterior(a, b) for a, b in zip(m, centre, strict=True)], cost


def apart(a: Exterior, b: Exterior) -> float:
    """Angle between two attitudes [rad]."""
    return float(2 * np.arcsin(min(1.0, np.linalg.norm(a.m - b.m) / np.sqrt(8))))


def _rays(xy: np.ndarray, c: float) -> np.ndarray:
    v = np.concatenate([xy, np.full((len(xy), 1), -c)], axis=1)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _residuals(points: np.ndarray, xy: np.ndarray, c: float, m: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (k, 2n) and Jacobian (k, 2n, 6) of k orientations; NaN behind the camera."""
    uvw = (points - centre[:, None]) @ np.swapaxes(m, 1, 2)
    w = np.where(uvw[..., 2] < 0, uvw[..., 2], np.nan)
    xh, yh = uvw[..., 0] / w, uvw[..., 1] / w
    by = np.zeros((*uvw.shape[:2], 2, 3))
    by[..., 0, 0] = by[..., 1, 1] = -c / w
    by[..., 0, 2], by[..., 1, 2] = c * xh / w, c * yh / w
    j = np.concatenate([-by @ m[:, None], -by @ skew(uvw)], axis=-1)
    v = xy - np.stack([-c * xh, -c * yh], axis=-1)
    k, n = uvw.shape[:2]
    return v.reshape(k, 2 * n), j.reshape(k, 2 * n, 6)


def _exp_batch(d: np.ndarray) -> np.ndarray:
    theta = np.linalg.norm(d, axis=1)[:, None, None]
    k = skew(d)
    safe = np.where(theta > 1e-8, theta, 1.0)
    a = np.where(theta > 1e-8, np.sin(safe) / safe, 1.0)
    b = np.where(theta > 1e-8, (1 - np.cos(safe)) / safe**2, 0.5)
    return np.eye(3) + a * k + b * (k @ k)


def wide_triples(points: np.ndarray, count: int = 4) -> list[list[int]]:
    """Index triples of large area among the points furthest from the centroid and from each other."""
    n = len(points)
    if n <= 6:
        pool = list(range(n))
    else:
        pool = [int(np.argmax(((points - points.mean(axis=0)) ** 2).sum(axis=1)))]
        nearest = np.full(n, np.inf)
        while len(pool) < 6:
            nearest = np.minimum(nearest, ((points - points[pool[-1]]) ** 2).sum(axis=1))
            pool.append(int(np.argmax(nearest)))
    triples = list(itertools.combinations(pool, 3))
    p = points[np.array(triples)]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return [list(triples[i]) for i in np.argsort(-area)[:count]]
