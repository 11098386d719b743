"""The bundle by the orthogonal projection model: Ono & Hattori's adjustment of free and controlled networks.

The rays of every image are made parallel with depths from the orientation and points at hand (docs/formulas.md 3.1, depth form),
x_a = (d / d_ref) x, and g = s M12 (X - C) is adjusted to them, s = c / d_ref, d_ref the depth of the middle of its points.
Made parallel anew in every iteration, x_a - g is the perspective residual times d / d_ref: the fixed point makes G^T P v = 0 with
the derivatives G of g, which see no change of depth. Kept as they are (frozen), the x_a are plain observations of g.

Reference: Ono & Hattori 2002; docs/formulas.md 3.1, 3.6, 3.7 and 3.8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ...adjustment import Dense, Linear
from ...adjustment.fronts import alone
from ...adjustment.losses import COSTS, LOSSES
from ...cameras import Interior, correct_jacobian
from ...geometry import Exterior, skew
from .datum import motions
from .network import Network
from .orthogonal_sparse import Equations, Sparse, SparseNormal, aim, left_free
from .problem import DENSE, Bundle

TURN = 0.1
"""Largest rotation of an image in one step of the repetition [rad]."""
NULL = 1e-11
"""Eigenvalue of the scaled normal matrix, over the largest, that counts as zero."""


@dataclass(frozen=True)
class Parallel:
    """One image at x: rows of its observations; ideal photo coordinates (r, 2) mm; k (r,) = d / d_ref; by_pixel (r, 2, 2) mm/px;
    uv (r, 2) camera coordinates and ahead (r,) = m3 (X - mean) [m]; scale s [mm/m]; exterior and interior."""

    rows: np.ndarray
    photo: np.ndarray
    k: np.ndarray
    by_pixel: np.ndarray
    uv: np.ndarray
    ahead: np.ndarray
    scale: float
    exterior: Exterior
    interior: Interior

    @property
    def transformed(self) -> np.ndarray:
        """(r, 2) mm, orthogonal image coordinates x_a."""
        return self.k[:, None] * self.photo

    @property
    def modelled(self) -> np.ndarray:
        """(r, 2) mm, g = s M12 (X - C)."""
        return self.scale * self.uv

    @property
    def by_c(self) -> np.ndarray:
        """(r, 2) d x_a / d c, total: with M, s and t held, the camera's distance follows c (docs/formulas.md 3.8)."""
        return self.photo * (self.scale * self.ahead / self.interior.c**2)[:, None]


@dataclass(frozen=True)
class Frozen:
    """Orthogonal coordinates that are kept: x_a (o, 2) mm, d x_a / d c (o, 2), k (o,) and by_pixel (o, 2, 2) of the
    transformation, c (cameras,) mm behind it."""

    xa: np.ndarray
    by_c: np.ndarray
    k: np.ndarray
    by_pixel: np.ndarray
    c: np.ndarray


@dataclass(frozen=True)
class OrthogonalBundle(Bundle):
    """A bundle of the orthogonal model; x, tangent and datum as in `Bundle`, except that a step of c takes the cameras with it.

    frozen: the transformation that is kept, None to transform anew at every iteration. extra: directions that the frozen normal
    equations leave free beyond the seven of the datum (one for a stereo pair); they are held by inner constraints, too.
    aimed: step straight at the fixed point (Newton) where plain repetition runs away from it. sparse: normal equations and
    statistics that keep to what is not zero, None for the plain dense path, which gives the same.
    """

    frozen: Frozen | None = None
    extra: int = 0
    aimed: bool = False
    sparse: Sparse | None = None

    @property
    def model(self) -> Literal["perspective", "orthogonal"]:
        return "orthogonal"

    @property
    def dof(self) -> int:
        return super().dof + self.extra

    @cached_property
    def seen(self) -> tuple[np.ndarray, ...]:
        """Rows of the observations of each image."""
        return tuple(np.flatnonzero(self.network.image == i) for i in range(len(self.network.images)))

    # -- the transformation ---------------------------------------------------------------------------------------------------

    def parallel(self, x: np.ndarray) -> list[Parallel]:
        """Every image at x, its rays made parallel."""
        net = self.network
        poses, _, points = net.split(x)
        interiors, out = net.interiors_at(x), []
        for i, rows in enumerate(self.seen):
            interior, exterior, at = interiors[net.camera[i]], Exterior.from_vector(poses[i]), points[net.point[rows]]
            cam = exterior.camera(at)
            depth, mean = -cam[:, 2], -cam[:, 2].mean()
            measured = interior.photo(net.pixels[rows]) - interior.principal_point
            out.append(Parallel(
                rows, interior.ideal(net.pixels[rows]), depth / mean,
                correct_jacobian(interior.coefficients, measured) * (interior.pitch * [1, -1]),
                cam[:, :2], mean - depth, float(interior.c / mean), exterior, interior))
        return out

    def kept(self, x: np.ndarray) -> Frozen:
        """The transformation at x."""
        net = self.network
        xa, by_c, k = np.empty_like(net.pixels), np.empty_like(net.pixels), np.empty(len(net.image))
        by_pixel = np.empty((len(net.image), 2, 2))
        for p in self.parallel(x):
            xa[p.rows], by_c[p.rows], k[p.rows], by_pixel[p.rows] = p.transformed, p.by_c, p.k, p.by_pixel
        return Frozen(xa, by_c, k, by_pixel, net.split(x)[1][:, 0].copy())

    def image_rows(self, x: np.ndarray, images: list[Parallel] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(o, 2) residuals px and (o, 2, 2) weights px^-2: those of orthogonal coordinates that weigh alike, before any loss.
        images: those at x, where they are known already."""
        net = self.network
        images = images or self.parallel(x)
        if self.frozen is None:
            v = super().residuals(x)
            k, by_pixel = np.empty(len(v)), np.empty((len(v), 2, 2))
            for p in images:
                k[p.rows], by_pixel[p.rows] = p.k, p.by_pixel
        else:
            f, c = self.frozen, net.split(x)[1][:, 0]
            k, by_pixel, va = f.k, f.by_pixel, f.xa + f.by_c * (c - f.c)[net.camera[net.image]][:, None]
            for p in images:
                va[p.rows] -= p.modelled
            v = np.linalg.solve(k[:, None, None] * by_pixel, va[..., None])[..., 0]
        pitch = np.array([np.prod(c.pitch) for c in net.interiors])[net.camera[net.image]]
        p = np.swapaxes(by_pixel, 1, 2) @ by_pixel * (k**2 / net.sigma**2 / pitch)[:, None, None]
        return v, p

    def cost(self, x: np.ndarray) -> float:
        net = self.network
        if not np.isfinite(x).all() or (net.split(x)[1][:, 0] <= 0).any():
            return float("inf")
        v, p = self.image_rows(x)
        t = np.sqrt(np.einsum("oa,oab,ob->o", v, p, v))
        total = self.given_cost(x) + float((COSTS[net.loss](t) if net.loss else t**2 / 2).sum())
        return total if np.isfinite(total) else float("inf")

    # -- the adjustment -----------------------------------------------------------------------------------------------------

    def linear(self, x: np.ndarray) -> Linear:
        """Residuals, derivatives of g carried back to pixels, weights; then weighted coordinates and priors; the datum."""
        net = self.network
        v, p = self.image_rows(x)
        j = self.derivatives(x)
        u = j.shape[2]
        p = p * self.factor(v, p)[:, None, None]
        more_v, more_j = self._whitened(x, u)
        h = w = None
        if self.inner:
            h = self.inner.rows_of(net, motions(net, x))
            w = np.zeros(len(h))
            if self.extra:
                h = np.concatenate([h, self._held(j, p, more_j, h)])
                w = np.zeros(len(h))
        n = len(more_v)
        return Linear(np.concatenate([v, more_v]), np.concatenate([j, more_j]),
                      np.concatenate([p, np.broadcast_to(np.eye(2), (n, 2, 2))]), h, w)

    def factor(self, v: np.ndarray, p: np.ndarray) -> np.ndarray:
        """(o,) share of its weight that the loss leaves to each image observation."""
        loss = self.network.loss
        return LOSSES[loss](np.sqrt(np.einsum("oa,oab,ob->o", v, p, v))) if loss else np.ones(len(v))

    def derivatives(self, x: np.ndarray) -> np.ndarray:
        """(o, 2, u) px: G. The middle of an image's points moves with them, so that the seven motions change nothing."""
        net = self.network
        m, f, live = net.sizes
        g = np.zeros((len(net.image), 2, 6 * m + f + 3 * live))
        for i, p in enumerate(self.parallel(x)):
            rows, of = p.rows, net.point[p.rows]
            r, mat, s, mean = len(rows), p.exterior.m, p.scale, p.interior.c / p.scale
            middle = np.concatenate([p.uv.mean(axis=0), [-mean]])  # camera coordinates of the middle
            block = np.zeros((r, 2, g.shape[2]))
            cam = np.column_stack([p.uv, p.ahead - mean])
            block[:, :, 6 * i:6 * i + 3] = -s * mat[:2] - (s / mean) * p.uv[:, :, None] * mat[2]
            turn = -skew(middle)[2]  # derivatives of the middle's third coordinate, minus the depth
            block[:, :, 6 * i + 3:6 * i + 6] = -s * skew(cam)[:, :2] + (s / mean) * p.uv[:, :, None] * turn
            unknown = np.flatnonzero(of < net.unknown)
            at = net.point_columns[of[unknown]]
            for c in range(3):
                block[:, :, at[:, c]] += (s / mean * mat[2, c] / r) * p.uv[:, :, None]
                block[unknown, :, at[:, c]] += s * mat[:2, c]
            camera = net.camera[i]
            if net.count[camera]:
                block[:, :, 6 * m + net.tie[net.first[camera]]] = -(self.frozen.by_c[rows] if self.frozen else p.by_c)
            k, by_pixel = (self.frozen.k[rows], self.frozen.by_pixel[rows]) if self.frozen else (p.k, p.by_pixel)
            g[rows] = np.linalg.solve(k[:, None, None] * by_pixel, block)
        return g

    def _held(self, j: np.ndarray, p: np.ndarray, more: np.ndarray, h: np.ndarray) -> np.ndarray:
        """(extra, u) constraints on the points for the directions that are free beyond the datum."""
        vectors = free_directions(j, p, more, motions_of=h)[1][:, :self.extra].T.copy()
        m, f, _ = self.network.sizes
        vectors[:, :6 * m + f] = 0.0
        return vectors

    def normal(self, x: np.ndarray) -> Dense | SparseNormal:
        if self.sparse:
            with alone():
                made = Equations(self, x)
                return SparseNormal(made, None if self.frozen else TURN, aim(made) if self.aimed else None)
        linear = self.linear(x)
        plain = linear.normal()
        if self.aimed:
            return Aimed(plain.n, plain.gradient, plain.h, plain.w, aim=self._aim(x, linear))
        return plain if self.frozen else Held(plain.n, plain.gradient, plain.h, plain.w, images=len(self.network.images))

    def _aim(self, x: np.ndarray, linear: Linear) -> np.ndarray:
        """Newton's step to the fixed point, in the tangent of `retract`: the residuals' own derivatives on one side."""
        j = self.steps_of(Bundle(self.network).linear(x).j, x)
        g, p = linear.j, linear.p
        scale = np.sqrt(np.maximum(np.einsum("oau,oab,obu->u", g, p, g), 1e-300))
        a = np.einsum("oau,oab,obw->uw", g / scale, p, j / scale)
        step = np.linalg.lstsq(a, np.einsum("oau,oab,ob->u", g / scale, p, linear.v), rcond=1e-10)[0]
        return step / scale

    def steps_of(self, j: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Derivatives (..., u) by the plain tangent turned into those by the steps of `retract`: cameras move with their c."""
        net = self.network
        m, j = len(net.images), j.copy()
        for i, p in enumerate(self.parallel(x)):
            if net.count[net.camera[i]]:
                j[..., 6 * m + net.tie[net.first[net.camera[i]]]] += j[..., 6 * i:6 * i + 3] @ (p.exterior.m[2] / p.scale)
        return j

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        net = self.network
        m, dx = len(net.images), dx.copy()
        if net.count.any():
            c, images = net.split(x)[1][:, 0], self.parallel(x)
            for camera, (first, count) in enumerate(zip(net.first, net.count, strict=True)):
                if count:  # a principal distance stays positive
                    at = 6 * m + net.tie[first]
                    dx[at] = max(dx[at], -0.9 * float(c[camera]))
            for i, p in enumerate(images):
                if net.count[net.camera[i]]:  # M, s and t are held while c changes: the camera backs off along its axis
                    dx[6 * i:6 * i + 3] += p.exterior.m[2] / p.scale * dx[6 * m + net.tie[net.first[net.camera[i]]]]
        return super().retract(x, dx)


@dataclass(frozen=True)
class Held(Dense):
    """Normal equations whose step is shortened where an image would turn by more than TURN: far from its fixed point, the
    repetition of the transformation runs away from steps that are too long (docs/studies/ono.md)."""

    images: int = 0

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        dx, multipliers = super().step(damping)
        turn = float(np.linalg.norm(dx[:6 * self.images].reshape(-1, 6)[:, 3:], axis=1).max(initial=0.0))
        return dx * min(1.0, TURN / max(turn, 1e-300)), multipliers


@dataclass(frozen=True)
class Aimed(Dense):
    """Normal equations whose step is known beforehand."""

    aim: np.ndarray | None = None

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        assert self.aim is not None
        return self.aim, np.zeros(0)


def free_directions(j: np.ndarray, p: np.ndarray, more: np.ndarray,
                    motions_of: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues (u,), over the largest, of the scaled normal matrix with the datum (7, u) held, and the directions (u, u) they
    belong to, smallest first: those near zero are what the observations leave free beyond the datum."""
    normal = Linear(np.zeros((len(j) + len(more), 2)), np.concatenate([j, more]),
                    np.concatenate([p, np.broadcast_to(np.eye(2), (len(more), 2, 2))])).normal()
    n = normal.scaled
    if motions_of is not None:
        q = np.linalg.qr((motions_of / normal.scale).T)[0]
        n = n + q @ q.T
    values, vectors = np.linalg.eigh(n)
    return values / values[-1], vectors / normal.scale[:, None]


def orthogonal(network: Network, inner_bundle: Bundle, x0: np.ndarray, frozen: bool,
               dense: bool | None = None) -> OrthogonalBundle:
    """The orthogonal twin of a bundle: its transformation kept at x0 or not, what it leaves free beyond the datum counted. Dense
    where the design matrix is small (or as told), sparse otherwise."""
    m, f, live = network.sizes
    small = 2 * len(network.image) * (6 * m + f + 3 * live) <= DENSE
    problem = OrthogonalBundle(network, inner_bundle.inner, None, sparse=None if (small if dense is None else dense)
                               else Sparse(network))
    if frozen:
        problem = replace(problem, frozen=problem.kept(x0))
    if not problem.inner:
        return problem
    if problem.sparse:
        with alone():
            return replace(problem, extra=left_free(Equations(problem, x0), NULL).shape[1])
    plain = replace(problem, extra=0)
    linear, n = plain.linear(x0), len(network.image)
    values, _ = free_directions(linear.j[:n], linear.p[:n], linear.j[n:], linear.h)
    return replace(problem, extra=int((values < NULL).sum()))


__all__ = ["Frozen", "OrthogonalBundle", "Parallel", "free_directions", "orthogonal"]
