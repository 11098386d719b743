"""The numpy side of the bundle's kernels: work cut among threads, the reduced system, its inverse where it is stored."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ...adjustment.losses import LOSSES
from ...adjustment.schur import Pattern, Reduced, Schur
from ...cameras import project, project_derivatives
from ...geometry import Exterior
from .datum import Inner, motions, pins
from .network import Network

KINDS = {None: 0, "huber": 1, "cauchy": 2, "danish": 3}


LOOSE = 1e-9
"""Share by which the normal matrix of a point whose rays are parallel is raised to be inverted."""


@dataclass(frozen=True)
class Gathered:
    """Normal equations at x before elimination, priors and weighted points in them; V (n, 6) lower, q (n, 3)."""

    at: tuple[Any, ...]
    U: np.ndarray
    B: np.ndarray
    C: np.ndarray
    g: np.ndarray
    h: np.ndarray
    V: np.ndarray
    q: np.ndarray


class Compiled:
    """Kernels over one network; threads: how many work at once (None: one for each core)."""

    def __init__(self, network: Network, threads: int | None = None) -> None:
        self.network = network
        self.threads = threads or len(os.sched_getaffinity(0)) if hasattr(os,
                                                                          "sched_getaffinity") else threads or os.cpu_count() or 1
        self._pool = ThreadPoolExecutor(self.threads)
        n = np.diff(network.start).astype(float)
        work = np.cumsum(n * (n + 12.0))
        self._cuts = [int(c) for c in np.searchsorted(work, work[-1] * np.arange(1, self.threads) / self.threads)]
        self.longest = int(n.max(initial=1))
        self.image = network.image.astype(np.int32)
        self.weight = 1.0 / network.sigma

    @cached_property
    def _kernels(self) -> Any:
        from . import _kernels

        return _kernels

    @cached_property
    def pattern(self) -> Pattern:
        """Which images share points."""
        from scipy.sparse import csr_matrix

        net = self.network
        m = len(net.images)
        live = net.point < net.live
        seen = csr_matrix((np.ones(int(live.sum()), np.int32), (net.image[live], net.point[live])), shape=(m, len(net.points)))
        shared = (seen @ seen.T + csr_matrix((np.ones(m, np.int32), (np.arange(m), np.arange(m))), shape=(m, m))).tocoo()
        upper = shared.row <= shared.col
        row, column = shared.row[upper].astype(np.int64), shared.col[upper].astype(np.int64)
        order = np.lexsort((column, row))
        return Pattern.of(m, 6, row[order], column[order], threads=self.threads)

    @cached_property
    def lut(self) -> np.ndarray:
        """(m, m) block of each pair of images, -1 for none."""
        p = self.pattern
        out = np.full((p.count, p.count), -1, np.int32)
        out[p.row, p.column] = np.arange(len(p.row), dtype=np.int32)
        return out

    def _each(self, work: Callable[[int, int, int], Any], end: int | None = None) -> list[Any]:
        """work(thread, p0, p1) over all points (those below `end`), each thread a share."""
        end = len(self.network.points) if end is None else end
        cuts = [0, *(min(c, end) for c in self._cuts), end]
        if end - cuts[0] < 64 or self.threads == 1:
            return [work(0, 0, end)]
        return list(self._pool.map(work, range(self.threads), cuts[:-1], cuts[1:]))

    def _at(self, x: np.ndarray) -> tuple[Any, ...]:
        """The arguments that all kernels share."""
        net = self.network
        poses, interiors, points = net.split(x)
        return (net.start, self.image, net.camera, net.pixels, self.weight, KINDS[net.loss], poses, net.camera_rows(interiors),
                points)

    def cost(self, x: np.ndarray) -> float:
        """Cost of the image observations; inf where a point cannot be seen."""
        at = self._at(x)
        return float(sum(self._each(lambda _, a, b: self._kernels.cost(a, b, *at))))

    def gather(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None) -> Gathered:
        """Normal equations at x. A free network gets a minimal datum, of which nothing is left once `retract` restores the inner
        one: what the inner constraints take out of a step would be large where points are far, and spoil its prediction."""
        net, t = self.network, self.threads
        m, _, live = net.sizes
        f = len(net.border)
        photo = np.empty((len(net.image), 2))  # filled by this pass, read by those after it
        at = (*self._at(x), photo, net.first, net.count, net.border)
        parts = [np.zeros((t, *shape)) for shape in ((m, 6, 6), (m, f, 6), (f, 10), (m, 6), (len(net.count), 10))]
        v, q = np.zeros((live, 6)), np.zeros((live, 3))
        self._each(lambda k, a, b: self._kernels.gather(a, b, live, *at, *(p[k] for p in parts), v, q))
        u, b, c, g, h = (p.sum(axis=0) if t > 1 else p[0] for p in parts)
        b, c, h = self._merged(np.swapaxes(b, 1, 2), 2), self._freed(c), self._of(h)
        rows, (misclosure, d) = net.prior_arrays[0], priors
        u[rows] += np.swapaxes(d, 1, 2) @ d
        g[rows] += (np.swapaxes(d, 1, 2) @ misclosure[..., None])[..., 0]
        if net.extras.count:
            self._extra(x, misclosure, d, (u, b, c, g, h))
        given = net.weight[:live]
        v[:, [0, 2, 5]] += given
        q += np.where(given > 0, given * (net.known - net.split(x)[2])[:live], 0.0)
        if inner:
            first, second, axis = pins(net, x)
            u[first] += np.diag(np.diag(u[first]))
            if not inner.scaled:
                u[second, axis, axis] *= 2
        return Gathered(at, u, b, c, g, h, v, q)

    def _held(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Observations of the points held in the border: rows (r,), whitened derivatives by the pose (r, 2, 6) and by the whole
        border (r, 2, f)."""
        net = self.network
        rows = np.flatnonzero((net.point >= net.live) & (net.point < net.unknown))
        poses, _, points = net.split(x)
        j, border = np.zeros((len(rows), 2, 6)), np.zeros((len(rows), 2, net.sizes[1]))
        interiors = net.interiors_at(x)
        for i in np.unique(net.image[rows]):
            k = np.flatnonzero(net.image[rows] == i)
            o = rows[k]
            at = project_derivatives(interiors[net.camera[i]], Exterior.from_vector(poses[i]), points[net.point[o]])
            v = np.linalg.norm(net.pixels[o] - at.pixels, axis=1) / net.sigma[o]
            w = (np.sqrt(LOSSES[net.loss](v)) if net.loss else np.ones(len(o))) / net.sigma[o]
            j[k, :, :3], j[k, :, 3:] = at.centre * w[:, None, None], at.rotation * w[:, None, None]
            s = slice(net.first[net.camera[i]], net.first[net.camera[i]] + net.count[net.camera[i]])
            border[k[:, None, None], np.arange(2)[:, None], net.tie[s]] = at.interior[:, :, net.which[s]] * w[:, None, None]
            place = net.point_columns[net.point[o]] - 6 * len(net.images)
            for c in range(3):
                border[k, :, place[:, c]] = at.point[:, :, c] * w[:, None]
        return rows, j, border

    def _extra(self, x: np.ndarray, misclosure: np.ndarray, d: np.ndarray, into: tuple[np.ndarray, ...]) -> None:
        """Add to the normal equations what the kernels do not see: held points, shifts, bars, common covariances."""
        net = self.network
        _, b, c, _, h = into
        if net.extras.held:
            rows, j, border = self._held(x)
            held = border.copy()
            held[:, :, :net.freed] = 0.0  # what belongs to the interior orientation alone is there already
            np.add.at(b, net.image[rows], np.swapaxes(j, 1, 2) @ held)
            flat, own = border.reshape(-1, border.shape[2]), held.reshape(-1, border.shape[2])
            c += flat.T @ flat - (flat - own).T @ (flat - own)
            h += own.T @ self._residual(x, rows).ravel()
        for row, i in enumerate(net.prior_arrays[0]):
            at = net.shift_columns[i]
            if at is not None:
                shift = d[row, :, :3]
                b[i][:, at] += d[row].T @ shift
                c[np.ix_(at, at)] += shift.T @ shift
                h[at] += shift.T @ misclosure[row]
        v, rows = net.border_rows(x)
        c += rows.T @ rows
        h += rows.T @ v

    def _residual(self, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """(r, 2) weighted residuals of some observations."""
        net = self.network
        poses, _, points = net.split(x)
        interiors, out = net.interiors_at(x), np.empty((len(rows), 2))
        for i in np.unique(net.image[rows]):
            k = np.flatnonzero(net.image[rows] == i)
            o = rows[k]
            v = net.pixels[o] - project(interiors[net.camera[i]], Exterior.from_vector(poses[i]), points[net.point[o]])
            t = np.linalg.norm(v, axis=1) / net.sigma[o]
            out[k] = v * ((np.sqrt(LOSSES[net.loss](t)) if net.loss else np.ones(len(o))) / net.sigma[o])[:, None]
        return out

    @cached_property
    def _owner(self) -> np.ndarray:
        """(f,) camera of each freed parameter."""
        return np.repeat(np.arange(len(self.network.count)), self.network.count)

    def _freed(self, c: np.ndarray) -> np.ndarray:
        """(f, f) of the freed parameters, from (raw, 10): each one's with the ten of its camera."""
        owner, which, n = self._owner, self.network.which, len(self._owner)
        out = np.zeros((len(c), len(c)))
        out[:n, :n] = np.where(owner[:, None] == owner, c[:n, which[:n]], 0.0)
        return self._merged(self._merged(out, 0), 1)

    def _merged(self, a: np.ndarray, axis: int) -> np.ndarray:
        """An axis over all freed parameters of all cameras and `extras` made one over the border: what is shared, summed."""
        net = self.network
        if not net.sharing:
            return a
        out = np.zeros((net.sizes[1], *np.moveaxis(a, axis, 0).shape[1:]))
        np.add.at(out, self._columns, np.moveaxis(a, axis, 0))
        return np.ascontiguousarray(np.moveaxis(out, 0, axis))

    @cached_property
    def _columns(self) -> np.ndarray:
        """(raw,) place in the border of every freed parameter of every camera and of `extras`."""
        net = self.network
        return np.concatenate([net.tie, net.freed + np.arange(net.extras.count)])

    def _of(self, ten: np.ndarray) -> np.ndarray:
        """(f, ...) of the border, from (cameras, 10, ...)."""
        out = np.zeros((self.network.sizes[1], *ten.shape[2:]))
        np.add.at(out, self.network.tie, ten[self._owner, self.network.which])
        return out

    def _ten(self, shared: np.ndarray) -> np.ndarray:
        """(cameras, r, 10) from the border's (f, r): nothing where a parameter is not freed."""
        out = np.zeros((len(self.network.count), shared.shape[1], 10))
        out[self._owner, :, self.network.which] = shared[self.network.tie]
        return out

    def reduce(self, made: Gathered, damping: float) -> Reduced:
        """The points eliminated, all diagonals raised by the damping."""
        net, t, p = self.network, self.threads, self.pattern
        m, f, live = net.sizes
        raw = len(net.border)
        shapes = ((len(p.row), 6, 6), (m, raw, 6), (raw, raw), (m, 6), (raw,))
        parts = [[np.zeros(shape) for shape in shapes] for _ in range(t)]
        self._each(lambda k, a, b: self._kernels.eliminate(a, b, self.longest, *made.at, made.V, made.q, damping, self.lut,
                                                           *parts[k]), live)
        s, b, c, g, h = parts[0]
        while len(parts) > 1:  # a thread's share is given back as soon as it is in
            for whole, part in zip(parts[0], parts.pop(), strict=True):
                whole += part
        b, c, h = self._merged(b, 1), self._merged(self._merged(c, 0), 1), self._merged(h, 0)
        diagonal = self.lut[np.arange(m), np.arange(m)]
        s[diagonal] += made.U
        s[diagonal[:, None], np.arange(6), np.arange(6)] += damping * np.einsum("mii->mi", made.U)
        c += made.C + damping * np.diag(np.diag(made.C))
        return Reduced(p, s, (np.swapaxes(b, 1, 2) + made.B).reshape(6 * m, f), c, (g + made.g).ravel(), h + made.h)

    def expand(self, made: Gathered, images: np.ndarray, shared: np.ndarray, q: np.ndarray, damping: float) -> np.ndarray:
        """(live, r, 3) points that belong to images (6 m, r) and border (f, r); right sides q (live, r, 3)."""
        m, _, live = self.network.sizes
        out = np.empty((live, images.shape[1], 3))
        steps, ten = np.ascontiguousarray(images.reshape(m, 6, -1).swapaxes(1, 2)), self._ten(shared)
        self._each(lambda _, a, b: self._kernels.expand(a, b, *made.at, made.V, q, damping, steps, ten, out), live)
        return out

    def normal(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None) -> Schur:
        made = self.gather(x, priors, inner)
        diagonal = np.concatenate([np.einsum("mii->mi", made.U).ravel(), np.diag(made.C), made.V[:, [0, 2, 5]].ravel()])
        scale = np.sqrt(np.maximum(diagonal, max(float(diagonal.max(initial=0.0)) * 1e-24, np.finfo(float).tiny)))

        def expand(images: np.ndarray, shared: np.ndarray, damping: float) -> np.ndarray:
            return self.expand(made, images[:, None], shared[:, None], made.q[:, None, :], damping).ravel()

        return Schur(np.concatenate([made.g.ravel(), made.h, made.q.ravel()]), scale, lambda damping: self.reduce(made, damping),
                     expand)

    def loose(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None) -> np.ndarray:
        """Unknown points whose rays leave their depth open; `judge` gives them lower bounds of their standard errors."""
        return loose(self.gather(x, priors, inner).V)

    def judge(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None,
              observations: bool = True) -> tuple[np.ndarray, ...]:
        """Covariances a priori: of every pose (m, 6, 6), all freed interior parameters (f, f) and every unknown point
        (live, 3, 3); with `observations` the standardized residuals (o, 2) and the covariance (o, 2, 2) of what is computed for
        them, over their own variances, and the covariance of every pose with the border (m, 6, f).

        Raises numpy.linalg.LinAlgError where the network is singular.
        """
        net = self.network
        m, f, live = net.sizes
        made = self.gather(x, priors, inner)
        made.V[loose(made.V)[:, None], [0, 2, 5]] *= 1 + LOOSE
        reduced = self.reduce(made, 0.0)
        q, qb, qc = reduced.inverse()
        qb = qb.reshape(m, 6, f)
        turned, corner = np.ascontiguousarray(np.swapaxes(qb, 1, 2)[:, self._columns]), qc[np.ix_(self._columns, self._columns)]
        points = np.empty((live, 3, 3))
        o = len(net.image) if observations else 0
        computed, residual = np.empty((o, 2, 2)), np.empty((o, 2))
        self._each(lambda _, a, b: self._kernels.judge(a, b, live, self.longest, *made.at, made.V, self.lut, q, turned, corner,
                                                       points, computed, residual))
        if not np.isfinite(points).all():
            raise np.linalg.LinAlgError("a point is not determined by its rays")
        poses = q[self.lut[np.arange(m), np.arange(m)]]
        if observations and net.extras.held:
            rows, j, border = self._held(x)
            i = net.image[rows]
            t = j @ qb[i] + border @ qc
            mixed = j @ poses[i] + border @ np.swapaxes(qb[i], 1, 2)
            computed[rows] = mixed @ np.swapaxes(j, 1, 2) + t @ np.swapaxes(border, 1, 2)
        if inner:
            poses, points, qc, qb = self._transformed(x, inner, made, reduced, (poses, points, qc, qb))
        return poses, qc, points, residual, computed, qb

    def _transformed(self, x: np.ndarray, inner: Inner, made: Gathered, reduced: Reduced,
                     covariances: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        """Covariances under the inner constraints from those of the minimal datum (S-transformation)."""
        net, (poses, points, qc, cross) = self.network, covariances
        m, f, live = net.sizes
        motion = motions(net, x)
        h = inner.rows_of(net, motion)
        motion = motion[:, :inner.count]
        k7 = inner.count
        right = np.ascontiguousarray(h[:, 6 * m + f:].reshape(k7, live, 3).swapaxes(0, 1))
        border = h[:, 6 * m:6 * m + f].T
        g, b = np.zeros((self.threads, m, k7, 6)), np.zeros((self.threads, len(net.count), k7, 10))
        self._each(lambda k, a, e: self._kernels.carry(a, e, *made.at, made.V, right, g[k], b[k]), live)
        images, shared = reduced.solve(g.sum(axis=0).swapaxes(1, 2).reshape(6 * m, k7),
                                       self._of(b.sum(axis=0).swapaxes(1, 2)) + border)
        objects = self.expand(made, images, shared, right, 0.0)  # (live, 7, 3)
        small = np.linalg.inv(h @ motion)
        drift = (small @ images.T).reshape(k7, m, 6).swapaxes(0, 1)  # (m, 7, 6): what every datum direction shares with a pose
        drifts = small @ objects  # (live, 7, 3)
        centre = small @ (np.tensordot(right, objects, ((0, 2), (0, 2))) + border.T @ shared) @ small.T
        out = []
        for covariance, d, way in ((poses, drift, motion[:6 * m].reshape(m, 6, k7)),
                                   (points, drifts, motion[6 * m + f:].reshape(live, 3, k7)),
                                   (qc[None], (small @ shared.T)[None], motion[None, 6 * m:6 * m + f])):
            part = way @ d
            out.append(covariance - part - np.swapaxes(part, 1, 2) + way @ centre @ np.swapaxes(way, 1, 2))
        way, shift, along = motion[:6 * m].reshape(m, 6, k7), motion[6 * m:6 * m + f].T, small @ shared.T
        cross = cross - way @ along - np.swapaxes(drift, 1, 2) @ shift + way @ centre @ shift
        return out[0], out[1], out[2][0], cross

    def weakest(self, x: np.ndarray, priors: tuple[np.ndarray, np.ndarray], inner: Inner | None, null: float) -> list[np.ndarray]:
        """(u,) null vectors of the scaled normal matrix, by inverse iteration on a slightly damped one; none where
        it is regular."""
        made = self.gather(x, priors, inner)
        m, f, live = self.network.sizes
        v = made.V[:, [0, 2, 5]]
        scale = np.sqrt(np.concatenate([np.einsum("mii->mi", made.U).ravel(), np.diag(made.C)]))
        y = np.random.default_rng(0).standard_normal((6 * m + f, min(12, 6 * m)))
        weak = 100 * null
        try:
            reduced = self.reduce(made, weak)
            z = y
            for _ in range(4):
                y = np.linalg.qr(z)[0]
                z = np.concatenate(reduced.solve(*np.split(y * scale[:, None], [6 * m]))) * scale[:, None]
        except np.linalg.LinAlgError:
            return []
        values, turn = np.linalg.eigh((z.T @ y + y.T @ z) / 2)
        vectors = y @ turn[:, values > 0.3 / weak]
        images, shared = np.split(vectors / scale[:, None], [6 * m])
        points = self.expand(made, images, shared, np.zeros((live, images.shape[1], 3)), weak).swapaxes(1, 2)
        whole = np.concatenate([vectors, (np.sqrt(v)[:, :, None] * points).reshape(3 * live, -1)])
        return list(whole.T)



def loose(v: np.ndarray) -> np.ndarray:
    """Points, among normal blocks (n, 6) lower, that are singular to round-off although each diagonal is not."""
    scale = np.sqrt(np.maximum(v[:, [0, 2, 5]], np.finfo(float).tiny))
    a, b, c = v[:, 1] / scale[:, 1] / scale[:, 0], v[:, 3] / scale[:, 2] / scale[:, 0], v[:, 4] / scale[:, 2] / scale[:, 1]
    determinant = 1 + 2 * a * b * c - a * a - b * b - c * c
    return np.flatnonzero((determinant < 1e-12) & (v[:, [0, 2, 5]] > 0).all(axis=1))
