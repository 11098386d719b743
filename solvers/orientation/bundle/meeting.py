"""Where the rays of oriented images meet: object points of a whole block at once, what misses them, and rays that spoil them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...cameras import Interior, project
from ...cameras.distortion import fold
from ...geometry import Exterior
from .given import Given

FAR = 5.0
"""Times the typical residual beyond which an observation does not agree with the others."""
MANY_RAYS = 20
"""Rays of a point up to which a wrong one is looked for; among more it hardly moves the point."""
NEAR = 20.0
"""Residual, in standard errors, up to which a point lies beside where it was measured."""
PARALLEL = 1e-14
"""Least eigenvalue of the mean of what is across the rays of a point, below which they are parallel."""


def stacked(data: Given, poses: Mapping[int, Exterior]) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (m, 3, 3) and projection centres (m, 3) m of all images of the block, NaN where they are not oriented."""
    m, centre = np.full((len(data.block.images), 3, 3), np.nan), np.full((len(data.block.images), 3), np.nan)
    for i, e in poses.items():
        m[i], centre[i] = e.m, e.centre
    return m, centre


def points(data: Given, poses: Mapping[int, Exterior], wanted: np.ndarray | None = None) -> np.ndarray:
    """(n, 3) points nearest to the rays of all oriented images, NaN where fewer than two see them or the rays are parallel, and
    for those that are not wanted (n,)."""
    out = np.full((len(data.block.points), 3), np.nan)
    m, centre = stacked(data, poses)
    ok = np.isfinite(centre[:, 0])[data.image]
    if wanted is not None:
        ok &= wanted[data.point]
    ok &= np.bincount(data.point[ok], minlength=len(out))[data.point] >= 2
    rows = np.flatnonzero(ok)
    if not len(rows):
        return out
    names, point = np.unique(data.point[rows], return_inverse=True)
    across, toward = _rays(data, m, centre, rows)
    rays = np.bincount(point)
    n = _sums(across.reshape(-1, 9), point).reshape(-1, 3, 3) / rays[:, None, None]
    out[names] = _solved(n, _sums(toward, point) / rays[:, None])
    return out


def misses(data: Given, poses: Mapping[int, Exterior], xyz: np.ndarray) -> np.ndarray:
    """(o,) by how much the observations miss points (n, 3), in standard errors: infinite behind the photo, NaN where the image is
    not oriented or the point not known."""
    m, centre = stacked(data, poses)
    return _missed(data, m, centre, np.arange(len(data.image)), xyz[data.point])


def without_wrong_rays(data: Given, poses: Mapping[int, Exterior], xyz: np.ndarray) -> None:
    """Points (n, 3) that one ray keeps from where all their others meet go there; the ray stays an observation."""
    off = misses(data, poses, xyz)
    seen = ~np.isnan(off)
    typical = max(1.0, float(np.median(off[seen]))) if seen.any() else 1.0
    doubtful = np.zeros(len(xyz), bool)
    doubtful[data.point[seen & (off > 2 * FAR * typical)]] = True
    rays = np.bincount(data.point[seen], minlength=len(xyz))
    rows = np.flatnonzero(seen & doubtful[data.point])
    rows = rows[np.argsort(data.point[rows], kind="stable")]
    m, centre = stacked(data, poses)
    for k in range(3, MANY_RAYS + 1):  # points of k rays together
        of = rows[rays[data.point[rows]] == k].reshape(-1, k)
        if len(of):
            at, worst = _left_out(data, m, centre, of)
            best = np.argmin(worst, axis=1)
            pick = np.arange(len(of)), best
            good = worst[pick] < FAR * typical
            xyz[data.point[of[good, 0]]] = at[pick][good]


def behind(data: Given, poses: Mapping[int, Exterior], xyz: np.ndarray) -> None:
    """Points that lie behind an image that sees them, or beyond its lens, lose their start (NaN): such a bundle could not
    begin."""
    far = ~(misses(data, poses, xyz) < NEAR)  # what lies beside a measured pixel is seen, unless the lens folds
    for i, e in poses.items():
        rows = data.seen_in(i)
        at = data.point[rows[far[rows]] if _unfolded(data.camera(i)) else rows]
        if len(at):
            with np.errstate(invalid="ignore"):
                wrong = ~np.isfinite(project(data.camera(i), e, xyz[at])).all(axis=1)
            xyz[at[wrong]] = np.nan


def _unfolded(camera: Interior) -> bool:
    """Whether the correction of a lens can be inverted well beyond the format."""
    corner = np.hypot(camera.width, camera.height) * camera.pitch.max() / 2 + np.hypot(*camera.principal_point)
    return camera.kind == "correction" and fold(camera.k1, camera.k2, camera.k3) > (1.2 * corner) ** 2


def _left_out(data: Given, m: np.ndarray, centre: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of points with observations of (p, k): where all rays but one meet (p, k, 3), and the largest residual there (p, k)."""
    p, k = of.shape
    across, toward = (part.reshape(p, k, *part.shape[1:]) for part in _rays(data, m, centre, of.ravel()))
    at = _solved((across.sum(axis=1, keepdims=True) - across) / (k - 1), (toward.sum(axis=1, keepdims=True) - toward) / (k - 1))
    rows = np.broadcast_to(of[:, None, :], (p, k, k))
    off = _missed(data, m, centre, rows.reshape(-1), np.repeat(at.reshape(-1, 3), k, axis=0)).reshape(p, k, k)
    off = np.where(np.isnan(off), np.inf, off)
    off[:, np.arange(k), np.arange(k)] = 0.0
    return at, off.max(axis=2)


def _rays(data: Given, m: np.ndarray, centre: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of observations: the projectors across their rays (r, 3, 3), and these times the projection centres (r, 3)."""
    image = data.image[rows]
    ray = np.einsum("ri,rij->rj", np.column_stack([data.ideal[rows], -data.principal[image]]), m[image])
    ray /= np.sqrt((ray * ray).sum(axis=1))[:, None]
    across = np.eye(3) - ray[:, :, None] * ray[:, None, :]
    return across, np.einsum("rij,rj->ri", across, centre[image])


def _sums(values: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(n, c) sums of values (r, c) by point (r,)."""
    return np.column_stack([np.bincount(point, column) for column in values.T])


def _solved(n: np.ndarray, g: np.ndarray) -> np.ndarray:
    """(..., 3) points of normal equations (..., 3, 3), NaN where the rays are parallel."""
    out = np.full(g.shape, np.nan)
    ok = np.linalg.eigvalsh(n)[..., 0] > PARALLEL
    out[ok] = np.linalg.solve(n[ok], g[ok][..., None])[..., 0]
    return out


def _missed(data: Given, m: np.ndarray, centre: np.ndarray, rows: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """(r,) lengths of residuals of observations whose points are at xyz (r, 3), in standard errors."""
    image = data.image[rows]
    uvw = np.einsum("rij,rj->ri", m[image], xyz - centre[image])
    with np.errstate(divide="ignore", invalid="ignore"):
        v = data.ideal[rows] + data.principal[image][:, None] * uvw[:, :2] / uvw[:, 2:]
        off = np.sqrt((v * v).sum(axis=1)) / data.unit[rows]
    return np.where(uvw[:, 2] < 0, off, np.where(np.isnan(uvw[:, 2]), np.nan, np.inf))
