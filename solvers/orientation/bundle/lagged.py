"""Cameras with a rolling shutter: every row of a photo is seen from where the camera is when that row is read.

An image moves evenly while it is read: at the time t after its middle row the centre is X + v t and the rotation exp(w t) M, or
exp(w t) T(t) M where a gyroscope has recorded how it turns, T: w is then what the record lacks.
It is seen as a still camera sees a point that is moved instead; velocity v and rate w stand in the border of the normal
equations, which are made sparse and whole: the compiled kernels know no unknowns of an image beside its pose.
Reference: Vautherin et al. 2016, "Photogrammetric accuracy and modeling of rolling shutter cameras".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...adjustment.losses import COSTS, LOSSES
from ...cameras import Interior, project, project_derivatives
from ...geometry import Exterior
from ...geometry.rotation import exp_many
from .datum import Inner, motions
from .network import Network

CHUNK = 4000
"""Observations whose redundancy is made at once."""


@dataclass(frozen=True)
class Seen:
    """Derivatives of pixels (n, 2, ..) by centre, rotation, point and interior orientation."""

    pixels: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    point: np.ndarray
    interior: np.ndarray


def lags(net: Network, i: int, rows: np.ndarray) -> np.ndarray:
    """(n,) seconds after the middle row at which the observations `rows` of image i were read."""
    height = net.interiors[net.camera[i]].height
    return net.extras.readout[i] * (net.pixels[rows, 1] - (height - 1) / 2) / height


def recorded(net: Network, i: int, rows: np.ndarray) -> np.ndarray:
    """(n, 3, 3) turns T of image i when the observations `rows` were read, between the recorded instants."""
    turning = net.extras.turning[i]
    at = (lags(net, i, rows) / max(net.extras.readout[i], 1e-12) + 0.5) * (len(turning) - 1)
    k = np.clip(at.astype(int), 0, len(turning) - 2)
    return exp_many(turning[k] + (at - k)[:, None] * (turning[k + 1] - turning[k]))


def _moved(net: Network, x: np.ndarray, i: int, rows: np.ndarray) -> tuple[np.ndarray, ...]:
    """Lags (n,), M (3, 3), the turn of each observation E (n, 3, 3), and what was turned (n, 3): M (P - X - v t)."""
    poses, _, points = net.split(x)
    at, motion, t = Exterior.from_vector(poses[i]), net.motion_at(x)[i], lags(net, i, rows)
    seen = (points[net.point[rows]] - at.centre - t[:, None] * motion[:3]) @ at.m.T
    turn = recorded(net, i, rows)
    if len(motion) > 3:
        turn = exp_many(t[:, None] * motion[3:]) @ turn
    return t, at.m, turn, seen


def virtual(net: Network, x: np.ndarray, i: int, rows: np.ndarray) -> np.ndarray:
    """(n, 3) points that the camera of image i, standing still, sees where it sees those of `rows` in motion."""
    _, m, turn, seen = _moved(net, x, i, rows)
    return net.split(x)[0][i, :3] + np.einsum("nij,nj->ni", turn, seen) @ m


def lagged_derivatives(net: Network, x: np.ndarray, i: int, rows: np.ndarray, interior: Interior) -> tuple[Seen, np.ndarray]:
    """Derivatives of the pixels of image i, and (n, 2, 3 or 6) those by its motion."""
    t, m, turn, seen = _moved(net, x, i, rows)
    still = project_derivatives(interior, Exterior.from_vector(net.split(x)[0][i]), virtual(net, x, i, rows))
    camera = still.point @ m.T  # by the point in camera axes
    by_seen = camera @ turn
    point = by_seen @ m
    motion = [-t[:, None, None] * point]
    if net.extras.moving > 3:
        after = np.einsum("nij,nj->ni", turn, seen)
        motion.append(-camera @ _cross(after) @ _left(t[:, None] * net.motion_at(x)[i, 3:]) * t[:, None, None])
    return Seen(still.pixels, -point, -by_seen @ _cross(seen), point, still.interior), np.concatenate(motion, axis=2)


def _cross(v: np.ndarray) -> np.ndarray:
    """(n, 3, 3) matrices of the cross product with v (n, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - np.swapaxes(out, 1, 2)


def _left(w: np.ndarray) -> np.ndarray:
    """(n, 3, 3) left Jacobians of small rotation vectors w (n, 3), to the fourth order."""
    k = _cross(w)
    return np.eye(3) + k / 2 + k @ k / 6 + k @ k @ k / 24 + k @ k @ k @ k / 120


@dataclass(frozen=True)
class Bordered:
    """Normal equations whose points are taken out for every damping, with the inner constraints beside them. n (c, c): of all
    that is no point; e (c + k, 3 live) sparse: how it, and the constraints, go with the points; v (live, 3, 3): of the points; h
    (k, c): constraints; right (u,): right side, gradient (u,) without what the constraints take from it."""

    gradient: np.ndarray
    scale: np.ndarray
    n: np.ndarray
    e: Any
    v: np.ndarray
    h: np.ndarray
    right: np.ndarray

    def parts(self, damping: float) -> tuple[np.ndarray, Any]:
        """The reduced system, bordered (c + k, c + k), and the sparse inverse of the points' blocks."""
        from scipy.sparse import bsr_matrix

        v = self.v.copy()
        v[:, np.arange(3), np.arange(3)] *= 1 + damping
        live = len(v)
        inverse = bsr_matrix((np.linalg.inv(v), np.arange(live), np.arange(live + 1)), shape=(3 * live, 3 * live)).tocsr()
        c, k = len(self.n), len(self.h)
        s = np.zeros((c + k, c + k))
        s[:c, :c] = self.n
        s[np.arange(c), np.arange(c)] *= 1 + damping
        s[c:, :c], s[:c, c:] = self.h, self.h.T
        return s - (self.e @ inverse @ self.e.T).toarray(), inverse

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        c, k = len(self.n), len(self.h)
        s, inverse = self.parts(damping)
        g, q = self.right[:c], self.right[c:]
        scale = np.concatenate([self.scale[:c], np.ones(k)])
        right = np.concatenate([g, np.zeros(k)]) - self.e @ (inverse @ q)
        try:
            dx = np.linalg.solve(s / scale / scale[:, None], right / scale) / scale
        except np.linalg.LinAlgError:
            return np.full(len(self.right), np.nan), np.zeros(0)
        return np.concatenate([dx[:c], inverse @ (q - self.e.T @ dx)]), np.zeros(0)

    def inverse(self) -> tuple[np.ndarray, Any]:
        """Its inverse (c + k, c + k) under the constraints, and that of the points' blocks. Raises LinAlgError."""
        s, inverse = self.parts(0.0)
        scale = np.concatenate([self.scale[:len(self.n)], np.ones(len(self.h))])
        scaled = s / scale / scale[:, None]
        if not np.isfinite(scaled).all() or np.linalg.cond(scaled) > 1e15:
            raise np.linalg.LinAlgError("the reduced system is singular")
        q = np.linalg.inv(scaled) / scale / scale[:, None]
        if (np.diag(q)[:len(self.n)] <= 0).any():
            raise np.linalg.LinAlgError("the reduced system is not positive")
        return q, inverse


@dataclass(frozen=True)
class Lagged:
    """Normal equations and statistics of a network whose images move while they are read; stands where `Compiled` stands."""

    network: Network

    def cost(self, x: np.ndarray) -> float:
        """Cost of the image observations; inf where a point cannot be seen."""
        net = self.network
        t = np.linalg.norm(self._residuals(x), axis=1) / net.sigma
        return float((COSTS[net.loss](t) if net.loss else t**2 / 2).sum()) if np.isfinite(t).all() else float("inf")

    def _residuals(self, x: np.ndarray) -> np.ndarray:
        net, interiors, out = self.network, self.network.interiors_at(x), np.empty_like(self.network.pixels)
        for i in range(len(net.images)):
            rows = net.seen_in(i)
            at = Exterior.from_vector(net.split(x)[0][i])
            out[rows] = net.pixels[rows] - project(interiors[net.camera[i]], at, virtual(net, x, i, rows))
        return out

    def design(self, x: np.ndarray) -> tuple[np.ndarray, Any]:
        """Whitened residuals (2 o,) of the image observations and their sparse derivatives (2 o, u)."""
        from scipy.sparse import csr_matrix

        net = self.network
        m, f, live = net.sizes
        interiors, k = net.interiors_at(x), net.extras.moving
        v, at, values, columns = np.empty_like(net.pixels), [], [], []
        for i in range(m):
            rows = net.seen_in(i)
            camera = net.camera[i]
            seen, moved = lagged_derivatives(net, x, i, rows, interiors[camera])
            v[rows] = net.pixels[rows] - seen.pixels
            free = int(net.first[camera]) + np.arange(int(net.count[camera]))
            own = [6 * i + np.arange(6), 6 * m + net.tie[free], 6 * m + f - net.extras.motions + k * i + np.arange(k)]
            columns.append(np.hstack([np.tile(np.concatenate(own), (len(rows), 1)), net.point_columns[net.point[rows]]]))
            parts = [seen.centre, seen.rotation, seen.interior[:, :, net.which[free]], moved, seen.point]
            values.append(np.concatenate(parts, axis=2))
            at.append(rows)
        t = np.linalg.norm(v, axis=1) / net.sigma
        w = (np.sqrt(LOSSES[net.loss](t)) if net.loss else np.ones(len(v))) / net.sigma
        data, row, column = [], [], []
        for rows, value, of in zip(at, values, columns, strict=True):
            known = np.broadcast_to(of[:, None, :] >= 0, value.shape)
            data.append((value * w[rows, None, None])[known])
            row.append(np.broadcast_to(2 * rows[:, None, None] + np.arange(2)[:, None], value.shape)[known])
            column.append(np.broadcast_to(of[:, None, :], value.shape)[known])
        at_ = np.concatenate(row), np.concatenate(column)
        a = csr_matrix((np.concatenate(data), at_), shape=(v.size, 6 * m + f + 3 * live))
        return (v * w[:, None]).ravel(), a

    def _others(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, Any]:
        """The same of weighted coordinates, priors and all that touches the border only."""
        from scipy.sparse import csr_matrix, lil_matrix, vstack

        net = self.network
        m, f, live = net.sizes
        u = 6 * m + f + 3 * live
        n, c = np.nonzero(net.weight[:live] > 0)
        root = np.sqrt(net.weight[n, c])
        coordinates = csr_matrix((root, (np.arange(len(n)), 6 * m + f + 3 * n + c)), shape=(len(n), u))
        (images, *_), (v, d) = net.prior_arrays, priors
        given = lil_matrix((6 * len(images), u))
        for row, i in enumerate(images):
            given[6 * row:6 * row + 6, 6 * i:6 * i + 6] = d[row]
            if (at := net.shift_columns[i]) is not None:
                given[6 * row:6 * row + 6, 6 * m + at] = d[row, :, :3]
        more, border = net.border_rows(x)
        wide = csr_matrix(np.hstack([np.zeros((len(more), 6 * m)), border]))
        wide.resize((len(more), u))
        return (np.concatenate([root * (net.known - net.split(x)[2])[n, c], v.ravel(), more]),
                vstack([coordinates, given.tocsr(), wide]).tocsr())

    def normal(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None) -> Bordered:
        from scipy.sparse import csr_matrix, vstack

        net = self.network
        m, f, live = net.sizes
        c = 6 * m + f
        (v1, a1), (v2, a2) = self.design(x), self._others(x, priors)
        a = vstack([a1, a2]).tocsc()
        g = a.T @ np.concatenate([v1, v2])
        cameras, points = a[:, :c], a[:, c:]
        blocks = np.zeros((live, 3, 3))
        square = (points.T @ points).tocoo()
        blocks[square.row // 3, square.row % 3, square.col % 3] = square.data
        h = np.zeros((0, c + 3 * live))
        if inner:
            h = inner.rows_of(net, motions(net, x))
            h = np.linalg.qr(h.T)[0].T
        n = (cameras.T @ cameras).toarray()
        scale = np.sqrt(np.concatenate([np.diag(n), np.einsum("nii->ni", blocks).ravel()]))
        floor = max(float(scale.max(initial=0.0)) * 1e-12, np.finfo(float).tiny)
        e = vstack([cameras.T @ points, csr_matrix(h[:, c:])]).tocsr()
        return Bordered(g - h.T @ (h @ g), np.maximum(scale, floor), n, e, blocks, h[:, :c], g)

    def loose(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None) -> np.ndarray:
        """Unknown points whose rays leave their depth open: none here, such points are refused."""
        return np.zeros(0, int)

    def judge(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None) -> tuple[np.ndarray, ...]:
        """As `Compiled.judge`. Raises numpy.linalg.LinAlgError where the network is singular."""
        net = self.network
        m, f, live = net.sizes
        c, o = 6 * m + f, len(net.image)
        normal = self.normal(x, priors, inner)
        q, inverse = normal.inverse()
        t = (normal.e @ inverse).tocsr()  # (c + k, 3 live)
        v, a = self.design(x)
        own, of_points = a[:, :c].tocsr(), a[:, c:].tocsr()
        computed = np.empty((o, 2, 2))
        still = (of_points @ inverse).multiply(of_points).tocsr()
        for start in range(0, 2 * o, 2 * CHUNK):
            rows = slice(start, min(start + 2 * CHUNK, 2 * o))
            b = -(of_points[rows] @ t.T).toarray()
            b[:, :c] += own[rows].toarray()
            pairs = b.reshape(-1, 2, b.shape[1])
            computed[rows.start // 2:rows.stop // 2] = (pairs @ q) @ np.swapaxes(pairs, 1, 2)
        alone = np.asarray(still.sum(axis=1)).ravel().reshape(-1, 2)
        across = np.asarray((of_points[0::2] @ inverse).multiply(of_points[1::2]).sum(axis=1)).ravel()
        computed[:, 0, 0] += alone[:, 0]
        computed[:, 1, 1] += alone[:, 1]
        computed[:, 0, 1] += across
        computed[:, 1, 0] += across
        points = np.empty((live, 3, 3))
        for start in range(0, live, CHUNK):
            rows = slice(start, min(start + CHUNK, live))
            part = t[:, 3 * rows.start:3 * rows.stop].toarray().reshape(len(q), -1, 3).swapaxes(0, 1)  # (n, c + k, 3)
            points[rows] = np.swapaxes(part, 1, 2) @ (q @ part) + np.linalg.inv(normal.v[rows])
        poses = q[:6 * m, :6 * m].reshape(m, 6, m, 6)[np.arange(m), :, np.arange(m), :]
        return poses, q[6 * m:c, 6 * m:c], points, v.reshape(-1, 2), computed, q[:6 * m, 6 * m:c].reshape(m, 6, f)

    def weakest(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None, null: float) -> list[np.ndarray]:
        """(u,) null vectors of the scaled reduced normal matrix, points aside."""
        net = self.network
        m, f, live = net.sizes
        c = 6 * m + f
        normal = self.normal(x, priors, inner)
        s = normal.parts(1e-14)[0][:c, :c] / normal.scale[:c] / normal.scale[:c, None]
        if not np.isfinite(s).all():
            return []
        values, vectors = np.linalg.eigh(s)
        return [np.concatenate([vectors[:, k], np.zeros(3 * live)]) for k in np.flatnonzero(values < 100 * null * values[-1])]


__all__ = ["Bordered", "Lagged", "lagged_derivatives", "lags", "virtual"]
