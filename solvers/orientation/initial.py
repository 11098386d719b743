"""Initial values without any approximate value: every candidate attitude the control allows, refined and ranked.

Reference: docs/formulas.md 4; Grunert 1841 and Haralick et al. 1994 (three points); DeMenthon & Davis 1995 (POSIT).
All functions take points (n, 3) m reduced to their centroid and ideal photo coordinates xy (n, 2) in the unit of c.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..geometry import Exterior, closest_rotation, skew
from .steps import improve, parallel

SAME = float(np.radians(0.01))
"""Attitudes closer than this [rad] are one minimum."""
_PATIENCE = 8
"""Refining steps granted to every start."""


def recentring(xy: np.ndarray, c: float) -> np.ndarray:
    """R_v (3, 3): turns the photo so that the mean ray becomes the optical axis of a virtual camera (docs/formulas.md 3.2)."""
    rays = _rays(xy, c)
    mean = rays.mean(axis=0)
    z = -mean / np.linalg.norm(mean)
    k = skew(np.array([z[1], -z[0], 0.0]))  # the smallest turn that brings z to (0, 0, 1)
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


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the control. photo (n,): of an ideal coordinate, unit of c; ground (n,): of an object
    coordinate [m]."""

    photo: np.ndarray
    ground: np.ndarray


def candidates(points: np.ndarray, xy: np.ndarray, c: float, noise: Noise | None = None) -> list[Candidate]:
    """All distinct local minima found from every start of docs/formulas.md 4, best first; empty when none is in front.

    noise: where one of the parallel projections (both reversal solutions among them) of six points or more leads to residuals
    at noise level, the other kinds of starts are not tried; nothing fits much better. Attitudes closer than a hundredth of a
    degree count as one.
    """
    s = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    crude = _different(parallel_starts(points, xy, c), points, xy, c)
    refined, cost = refine(points, xy, c, [e for _, e in crude])
    if (noise is None or not crude or len(_far_apart(points)) < 6
            or not _explained(points, xy, c, refined[int(np.argmin(cost))], noise)):
        more = _different([*crude, *other_starts(points, xy, c, s)], points, xy, c)[len(crude):]
        finer, its_cost = refine(points, xy, c, [e for _, e in more])
        crude, refined, cost = crude + more, refined + finer, np.append(cost, its_cost)
    out: list[Candidate] = []
    for i in np.argsort(cost, kind="stable"):
        if np.isfinite(cost[i]) and all(apart(refined[i], other.exterior) > SAME for other in out):
            led = [np.isfinite(cost[k]) and apart(refined[k], refined[i]) <= SAME for k in range(len(crude))]
            first = led.index(True)
            out.append(Candidate(refined[i], crude[first][1], crude[first][0], float(cost[i])))
    return out


def _explained(points: np.ndarray, xy: np.ndarray, c: float, at: Exterior, noise: Noise) -> bool:
    """Whether the residuals at an orientation are what the noise lets expect: below what chance exceeds in 3 of a million."""
    uvw = at.camera(points)
    scale = c / -uvw[:, 2]
    v2 = ((xy - scale[:, None] * uvw[:, :2]) ** 2).sum(axis=1)
    dof = 2 * len(points) - 6
    k = 2 / (9 * dof)  # Wilson & Hilferty 1931
    return bool((v2 / (noise.photo**2 + (scale * noise.ground) ** 2)).sum() < dof * (1 - k + 4.5 * np.sqrt(k)) ** 3)


def parallel_starts(points: np.ndarray, xy: np.ndarray, c: float) -> list[tuple[str, Exterior]]:
    """Scaled orthography of the re-centred bundle: affine and both reversal solutions."""
    r_v = recentring(xy, c)
    return [("parallel projection", Exterior(r_v.T @ e.m, e.centre)) for e in scaled_orthography(points, turned(xy, c, r_v), c)]


def other_starts(points: np.ndarray, xy: np.ndarray, c: float, s: np.ndarray) -> list[tuple[str, Exterior]]:
    """Starts by three points, DLT and homography, where the shape of the control (singular values s) allows them."""
    out = [("three points", e) for rows in wide_triples(points) for e in three_points(points[rows], xy[rows], c)]
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
    signs = [0.0 if k == "affine" else float(k) for k in kinds if k != "affine" or s[2] >= 1e-4 * s[0]]
    hand = np.array([1.0, 1.0, np.sign(np.linalg.det(vt))])  # the third axis is the plane's normal, right-handed
    along = u * hand / np.where(s > 0, s, np.inf)  # principal coordinates over squared extents
    found = parallel(reduced, xy, c, along, vt * hand[:, None], signs, updates)
    return [Exterior(m, mean - m.T @ t) for m, t in found]


def planar_block(centred: np.ndarray, u: np.ndarray, s: np.ndarray, vt: np.ndarray, sign: float) -> np.ndarray:
    """The 2x3 block s M_12 of points in their plane, one of the two reversal solutions (docs/formulas.md 3.4)."""
    g = ((u[:, :2].T @ centred) / s[:2, None]).T  # rows g1, g2 in the plane's axes
    ab = np.sqrt(complex(g[1] @ g[1] - g[0] @ g[0], -2 * (g[0] @ g[1])))
    third = sign * np.array([ab.real, ab.imag])
    normal = np.cross(vt[0], vt[1])
    return g @ vt[:2] + third[:, None] * normal


def pose_of_block(block: np.ndarray) -> tuple[np.ndarray, float]:
    """M (3, 3) and scale of a 2x3 block that need not fulfil the constraints: closest rotation, m3 = m1 x m2."""
    (a0, a1, a2), (b0, b1, b2) = block.tolist()
    aa, ab, bb = a0 * a0 + a1 * a1 + a2 * a2, a0 * b0 + a1 * b1 + a2 * b2, b0 * b0 + b1 * b1 + b2 * b2
    area = sqrt(max(aa * bb - ab * ab, 0.0))  # product of the singular values; their sum is 2 s
    both = sqrt(aa + bb + 2 * area)
    if not area > 1e-14 * (aa + bb):  # the rows are nearly parallel: the singular vectors still tell
        u, s, vt = np.linalg.svd(block, full_matrices=False)
        (a0, a1, a2), (b0, b1, b2) = (u @ vt).tolist()
        both = float(s[0] + s[1])
    else:
        f, g, h = (bb + area) / (area * both), -ab / (area * both), (aa + area) / (area * both)  # (B B^T)^(-1/2)
        a0, a1, a2, b0, b1, b2 = (f * a0 + g * b0, f * a1 + g * b1, f * a2 + g * b2,
                                  g * a0 + h * b0, g * a1 + h * b1, g * a2 + h * b2)
    return np.array([[a0, a1, a2], [b0, b1, b2], [a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0]]), both / 2


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
    p = np.linalg.svd(rows, full_matrices=len(rows) < 12)[2][-1].reshape(3, 4)  # (u, v, -1) ~ P X
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
    _, s, vt = np.linalg.svd(points - mean, full_matrices=False)
    scale = np.sqrt(len(points)) / s[0]
    ab = np.concatenate([(points - mean) @ vt[:2].T * scale, np.ones((len(points), 1))], axis=1)
    uv, zero = xy / c, np.zeros_like(ab)
    rows = np.vstack([np.hstack([ab, zero, uv[:, :1] * ab]), np.hstack([zero, ab, uv[:, 1:] * ab])])
    h = np.linalg.svd(rows, full_matrices=len(rows) < 9)[2][-1].reshape(3, 3)  # (u, v, -1) ~ H (a, b, 1)
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
    with a point behind the camera is inf. From step _PATIENCE on a start still a degree off in the photo and far behind the best
    is given up: it leads nowhere.
    """
    if not exteriors:
        return [], np.zeros(0)
    m = np.stack([e.m for e in exteriors])
    t = -np.stack([e.m @ e.centre for e in exteriors])  # the camera sees M X + t; the tangent is (t, left rotation vector)
    cost = improve(points, xy, c, m, t, steps, _PATIENCE, 0.5 * len(points) * (0.02 * c) ** 2)
    return [Exterior(a, -a.T @ b) for a, b in zip(m, t, strict=True)], cost


def apart(a: Exterior, b: Exterior) -> float:
    """Angle between two attitudes [rad]."""
    return float(2 * np.arcsin(min(1.0, np.linalg.norm(a.m - b.m) / np.sqrt(8))))


def _rays(xy: np.ndarray, c: float) -> np.ndarray:
    v = np.concatenate([xy, np.full((len(xy), 1), -c)], axis=1)
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def wide_triples(points: np.ndarray, count: int = 4) -> list[list[int]]:
    """Index triples of large area among the points furthest from the centroid and from each other."""
    pool = _far_apart(points) if len(points) > 6 else range(len(points))
    pool = range(len(points)) if len(pool) < 3 else pool
    triples = list(itertools.combinations(pool, 3))
    p = points[np.array(triples)]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    return [list(triples[i]) for i in np.argsort(-area)[:count]]


def _far_apart(points: np.ndarray, count: int = 6) -> list[int]:
    """Indices of up to `count` points, each the furthest from those before; fewer where the rest lie within 5 % of the rms
    extent of one of them."""
    out2 = ((points - points.mean(axis=0)) ** 2).sum(axis=1)
    least, nearest = 0.0025 * out2.mean(), np.full(len(points), np.inf)
    pool = [int(np.argmax(out2))]
    while len(pool) < min(count, len(points)):
        nearest = np.minimum(nearest, ((points - points[pool[-1]]) ** 2).sum(axis=1))
        pool.append(int(np.argmax(nearest)))
        if not nearest[pool[-1]] > least:
            return pool[:-1]
    return pool
