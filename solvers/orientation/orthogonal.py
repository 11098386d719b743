"""The orthogonal projection model: rays made parallel, an affine adjustment under two constraints, and the way back.

Reference: Ono & Hattori 2002; Ono, Akamatsu & Hattori 2004; with the errata of docs/formulas.md 1 and 3.
A = (A1 .. A8): x_a = A1 X + A2 Y + A3 Z + A4, y_a = A5 X + A6 Y + A7 Z + A8, X reduced to the centroid of the control.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ..adjustment import Dense, Linear, Normal
from ..cameras import Interior, correct_jacobian, project, project_derivatives
from ..errors import DegenerateGeometry
from ..geometry import Exterior, exp, skew
from .initial import planar_block, pose_of_block, recentring, turned

Form = Literal["depth", "printed"]


@dataclass(frozen=True)
class Orthogonal:
    """Orthogonal resection: x = X, Y, Z, m11 .. m33 of the camera that the affine parameters imply, then A1 .. A8.

    points (n, 3) m; pixels (n, 2); sigma (n, 2, 2) px^2, covariance of each measurement, control included. The
    adjustment weighs orthogonal coordinates alike but for each point's mean variance, as the papers do.
    form: "depth" holds for every attitude, "printed" is the papers' own (12) and (19) with the mean height.
    recentre: turn the bundle to its mean ray first. frozen: the approximate orientation whose transformation is kept
    (one pass); None transforms again at every iteration, from parallel rays in the first (row 0), until nothing
    changes. accelerated: aim each step at the fixed point with the known contraction (Newton), for geometries in which
    plain repetition runs away from it; the fixed point is the same.
    """

    interior: Interior
    points: np.ndarray
    pixels: np.ndarray
    sigma: np.ndarray
    form: Form = "depth"
    recentre: bool = True
    frozen: Exterior | None = None
    accelerated: bool = False
    _latest: tuple[np.ndarray, Linear] | None = field(init=False, repr=False, compare=False, default=None)

    @cached_property
    def mean(self) -> np.ndarray:
        """(3,) centroid of the control, m; its height is the reference level of both the transformation and (19)."""
        return self.points.mean(axis=0)

    @cached_property
    def reduced(self) -> np.ndarray:
        return self.points - self.mean

    @cached_property
    def _design(self) -> np.ndarray:
        """(n, 2, 8) derivatives of the orthogonal coordinates by A."""
        out = np.zeros((len(self.points), 2, 8))
        out[:, 0, :3] = out[:, 1, 4:7] = self.reduced
        out[:, 0, 3] = out[:, 1, 7] = 1.0
        return out

    @cached_property
    def _precision(self) -> np.ndarray:
        """(n,) weight of each point's orthogonal coordinates: one over its mean variance and the area of a pixel."""
        return 2 / np.einsum("naa->n", self.sigma) / np.prod(self.interior.pitch)

    @cached_property
    def r_v(self) -> np.ndarray:
        """(3, 3) photo -> virtual camera."""
        return recentring(self._ideal, self.interior.c) if self.recentre else np.eye(3)

    @cached_property
    def _ideal(self) -> np.ndarray:
        return self.interior.ideal(self.pixels)

    @cached_property
    def virtual(self) -> np.ndarray:
        """(n, 2) mm, photo coordinates in the virtual camera."""
        return turned(self._ideal, self.interior.c, self.r_v)

    @cached_property
    def by_pixel(self) -> np.ndarray:
        """(n, 2, 2) mm/px, derivatives of `virtual` by the pixels."""
        i, c = self.interior, self.interior.c
        lens = correct_jacobian(i.coefficients, i.photo(self.pixels) - i.principal_point) * (i.pitch * [1, -1])
        v = np.concatenate([self._ideal, np.full((len(self.pixels), 1), -c)], axis=1) @ self.r_v.T
        turn = -c * (self.r_v[:2, :2] / v[:, 2, None, None] - v[:, :2, None] * self.r_v[2, :2] / v[:, 2, None, None] ** 2)
        return turn @ lens

    @property
    def dof(self) -> int:
        return 2 * len(self.points) - 6

    # -- the transformation and the way back ---------------------------------------------------------------------

    def transform(self, exterior: Exterior | None) -> tuple[np.ndarray, np.ndarray]:
        """Orthogonal image coordinates (n, 2) mm and their derivatives by the pixels (n, 2, 2) mm/px, with the depths of
        an orientation; of parallel rays (x_a = x) without one. docs/formulas.md 3.1, (D) and (E)."""
        if exterior is None:
            return self.virtual, self.by_pixel
        m, x = self.r_v @ exterior.m, self.virtual
        if self.form == "depth":
            depth = -(self.points - exterior.centre) @ m[2]
            k = depth / -((self.mean - exterior.centre) @ m[2])
            return k[:, None] * x, k[:, None, None] * self.by_pixel
        c, q = self.interior.c, x @ m[:2, 2]
        k = (self.points[:, 2] - exterior.centre[2]) / (self.mean[2] - exterior.centre[2]) * m[2, 2] * c / (m[2, 2] * c - q)
        lean = np.eye(2) + x[:, :, None] * m[:2, 2] / (m[2, 2] * c - q)[:, None, None]
        return k[:, None] * x, k[:, None, None] * lean @ self.by_pixel

    def scale_of(self, exterior: Exterior) -> float:
        """s [mm/m]: the principal distance over the reference distance, (D) or the papers' (10)."""
        m = self.r_v @ exterior.m
        if self.form == "depth":
            return float(self.interior.c / -((self.mean - exterior.centre) @ m[2]))
        return float(-m[2, 2] * self.interior.c / (self.mean[2] - exterior.centre[2]))

    def affine_of(self, exterior: Exterior) -> np.ndarray:
        """A (8,) of an orientation."""
        m, s = self.r_v @ exterior.m, self.scale_of(exterior)
        t = s * m[:2] @ (self.mean - exterior.centre)
        return np.column_stack([s * m[:2], t]).ravel()

    def exterior_of(self, a: np.ndarray) -> Exterior:
        """Exterior orientation of A (8,): m3 = m1 x m2, then the centre by the depth form or by (19) rearranged."""
        rows = a.reshape(2, 4)
        m, s = pose_of_block(rows[:, :3])
        t, c = rows[:, 3], self.interior.c
        if self.form == "depth":
            centre = self.mean - m.T @ np.array([t[0] / s, t[1] / s, -c / s])
        else:
            z = self.mean[2] + m[2, 2] * c / s
            right = m[:2] @ self.mean - t / s - m[:2, 2] * z
            centre = np.append(np.linalg.solve(m[:2, :2], right), z)
        return Exterior(self.r_v.T @ m, centre)

    # -- starts ----------------------------------------------------------------------------------------------------

    def starts(self) -> list[np.ndarray]:
        """Linear starts: the affine adjustment where the control is not in one plane, and both reversal solutions of
        its plane. Each is an x with the orthogonal coordinates of `frozen` (of parallel rays when iterating)."""
        xa, _ = self.transform(self.frozen)
        u, s, vt = np.linalg.svd(self.reduced, full_matrices=False)
        centred, t = xa - xa.mean(axis=0), xa.mean(axis=0)
        blocks = [planar_block(centred, u, s, vt, sign) for sign in (1.0, -1.0)]
        if s[2] > 1e-4 * s[0]:
            blocks.insert(0, (vt.T @ ((u.T @ centred) / s[:, None])).T)
        return [self.start(np.column_stack([b, t]).ravel()) for b in blocks if np.isfinite(b).all()]

    def start(self, a: np.ndarray) -> np.ndarray:
        """x (20,) of A (8,)."""
        return np.concatenate([self.exterior_of(a).vector, a])

    def refrozen(self, exterior: Exterior) -> Orthogonal:
        """The same adjustment with the transformation kept at an orientation."""
        return replace(self, frozen=exterior)

    # -- the problem -------------------------------------------------------------------------------------------------

    def _transform_at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.transform(self.frozen if self.frozen is not None else Exterior.from_vector(x))

    def linear(self, x: np.ndarray) -> Linear:
        """The adjustment (13) to (16) at x in pixels: residuals and derivatives are carried back through the
        transformation. The last one is remembered: the engine asks for the cost first, then for the equations there."""
        if self._latest and self._latest[0] is x:
            return self._latest[1]
        xa, t = self._transform_at(x)
        a = x[12:]
        back = _inverse(t)
        design = self._design
        v = xa - (design @ a)
        r1, r2, zero = a[:3], a[4:7], np.zeros(1)
        h = np.stack([np.concatenate([r2, zero, r1, zero]), np.concatenate([2 * r1, zero, -2 * r2, zero])])
        out = Linear((back @ v[..., None])[..., 0], back @ design, self._weights(t), h, -np.array([r1 @ r2, r1 @ r1 - r2 @ r2]))
        object.__setattr__(self, "_latest", (x, out))
        return out

    def cost(self, x: np.ndarray) -> float:
        if not np.isfinite(x).all():
            return float("inf")
        return self.linear(x).cost

    def constraints(self, x: np.ndarray) -> np.ndarray:
        """(2,) (9): the rows are orthogonal and equally long, relative to their length."""
        r1, r2 = x[12:15], x[16:19]
        size = max(float(r1 @ r1 + r2 @ r2) / 2, 1e-300)
        return np.array([r1 @ r2, r1 @ r1 - r2 @ r2]) / size

    def normal(self, x: np.ndarray) -> Normal:
        plain = self.linear(x).normal()
        if not self.accelerated:
            return plain
        exterior = Exterior.from_vector(x)
        jg, jp, p = self.models(exterior)
        v = self.pixels - project(self.interior, exterior, self.points)
        pull = np.einsum("nai,nab,nb->i", jg, p, v)  # zero at the fixed point
        try:
            step = np.linalg.solve(np.einsum("nai,nab,nbj->ij", jg, p, jp), pull)
        except np.linalg.LinAlgError:
            return Aimed(plain, np.full(8, np.nan))
        moved = Exterior(exp(step[3:]) @ exterior.m, exterior.centre + step[:3])
        return Aimed(plain, self.affine_of(moved) - x[12:])

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        return self.start(x[12:] + dx)

    def _weights(self, transform: np.ndarray) -> np.ndarray:
        """(n, 2, 2) px^-2: equal weights of the orthogonal coordinates, seen through the transformation."""
        return np.swapaxes(transform, 1, 2) @ transform * self._precision[:, None, None]

    # -- statistics of the model (docs/formulas.md 3.6) ---------------------------------------------------------------

    def statistics(self, exterior: Exterior) -> Leak:
        """Noise, prior leak and fixed-point covariance of the model at an orientation, all in (centre, rotation)."""
        jg, jp, p = self.models(exterior)
        jp, pj = jp.reshape(-1, 6), p @ jg
        scale = np.sqrt(np.einsum("nai,nai->i", jg, pj))
        flat, weighted = (jg / scale).reshape(-1, 6), (pj / scale).reshape(-1, 6)
        left = np.linalg.pinv(flat.T @ weighted, rcond=1e-15) @ weighted.T / scale[:, None]
        noise = np.einsum("una,nab,wnb->uw", left.reshape(6, -1, 2), self.sigma, left.reshape(6, -1, 2))
        gain = left @ jp
        if not np.isfinite(gain).all():
            raise DegenerateGeometry("the orthogonal model runs away with this control and has no solution; measure more control "
                                     "points in the image, or take the perspective model")
        leak = np.eye(6) - gain
        back = np.linalg.pinv(gain)
        return Leak(noise, leak, float(np.abs(np.linalg.eigvals(leak)).max()), back @ noise @ back.T)

    def models(self, exterior: Exterior) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives (n, 2, 6) px of the orthogonal and of the perspective model by (centre, left rotation vector), and
        the weights (n, 2, 2)."""
        m, s = self.r_v @ exterior.m, self.scale_of(exterior)
        xc = self.points - exterior.centre
        reach = self.mean - exterior.centre
        cam = xc @ m.T
        c = self.interior.c
        # derivatives of s by (centre, left rotation vector of the virtual camera)
        if self.form == "depth":
            depth = -(reach @ m[2])
            ds = -s / depth * np.concatenate([m[2], -(-skew(m @ reach))[2]])
        else:
            h = reach[2]
            dm33 = np.array([m[1, 2], -m[0, 2], 0.0])  # d m33 = (d x m_.3)_3
            ds = np.concatenate([[0, 0, -m[2, 2] * c / h**2], -c / h * dm33])
        g = s * np.concatenate([np.broadcast_to(-m[:2], (len(xc), 2, 3)), -skew(cam)[:, :2]], axis=2)
        g = g + cam[:, :2, None] * ds
        g[:, :, 3:] = g[:, :, 3:] @ self.r_v  # rotation vector of the photo -> of the virtual camera
        _, t = self.transform(exterior)
        jg = _inverse(t) @ g
        at = project_derivatives(self.interior, exterior, self.points)
        return jg, np.concatenate([at.centre, at.rotation], axis=2), self._weights(t)


def _inverse(a: np.ndarray) -> np.ndarray:
    """Inverses (n, 2, 2)."""
    out = np.empty_like(a)
    out[:, 0, 0], out[:, 1, 1], out[:, 0, 1], out[:, 1, 0] = a[:, 1, 1], a[:, 0, 0], -a[:, 0, 1], -a[:, 1, 0]
    with np.errstate(all="ignore"):
        return out / (a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0])[:, None, None]


@dataclass(frozen=True)
class Aimed:
    """Normal equations whose step is known beforehand."""

    plain: Dense
    dx: np.ndarray

    @property
    def gradient(self) -> np.ndarray:
        return self.plain.gradient

    @property
    def scale(self) -> np.ndarray:
        return self.plain.scale

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        return self.dx, np.zeros(2)


@dataclass(frozen=True)
class Leak:
    """What the orthogonal model does to errors. noise (6, 6): covariance C_n of one pass with a perfect approximation.
    leak (6, 6): K, how errors of the approximation come through; one pass has C_n + K Sigma_0 K^T. radius: spectral
    radius of K; iterating converges when below 1. iterated (6, 6): covariance at the fixed point. Order: centre [m],
    left rotation vector [rad]."""

    noise: np.ndarray
    leak: np.ndarray
    radius: float
    iterated: np.ndarray
