"""Registration as a problem of the engine: photos and the points they share on the mosaic plane, all at once.

x holds `model.width` numbers of every photo and X, Y of every point; the tangent is that of the moving photos and of all points,
which are eliminated in 2 by 2 blocks. One photo onto known points is the same problem with everything else held.

Reference: docs/formulas.md 6.3; Brown 1958 (elimination).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..adjustment import Dense
from ..adjustment.losses import COSTS, LOSSES
from ..adjustment.schur import Reduced, Schur
from ..compiled import kernels
from .models import Model
from .network import Network


@dataclass(frozen=True)
class PhotoPriors:
    """Weighted observations of photos' exterior orientations. photo (a,): which; centre (a, 3) [local]; m (a, 3, 3);
    information (a, 6, 6) of (centre, left rotation vector), zero where nothing is known."""

    photo: np.ndarray
    centre: np.ndarray
    m: np.ndarray
    information: np.ndarray

    @classmethod
    def none(cls) -> PhotoPriors:
        """No photo has one."""
        return cls(np.zeros(0, int), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 6, 6)))

    @property
    def count(self) -> int:
        """Scalar observations."""
        return int((np.einsum("aii->ai", self.information) > 0).sum())

    def misclosure(self, photos: np.ndarray) -> np.ndarray:
        """(a, 6) what is missing from photos (m, 12) to the priors, as tangent steps."""
        at = photos[self.photo]
        turn = self.m @ np.swapaxes(at[:, 3:].reshape(-1, 3, 3), 1, 2)
        axis = np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]], axis=1) / 2
        sine, cosine = np.linalg.norm(axis, axis=1), (np.trace(turn, axis1=1, axis2=2) - 1) / 2
        angle = np.arctan2(sine, cosine)
        return np.hstack([self.centre - at[:, :3], axis * (angle / np.where(sine > 1e-12, sine, 1))[:, None]])


@dataclass(frozen=True)
class ShapePriors:
    """Weighted observations of plane coefficients: photos lie where h (a, 3, 3) says, as sure as information (a, 8, 8) of D."""

    photo: np.ndarray
    h: np.ndarray
    information: np.ndarray

    @property
    def count(self) -> int:
        """Scalar observations."""
        return 8 * len(self.photo)

    def misclosure(self, photos: np.ndarray) -> np.ndarray:
        """(a, 8) D that takes photos (m, 9) to the priors."""
        d = self.h @ np.linalg.inv(photos[self.photo].reshape(-1, 3, 3))
        return (d / d[:, 2:, 2:] - np.eye(3)).reshape(-1, 9)[:, :8]


@dataclass(frozen=True)
class Registering:
    """A registration. fixed_points: the points are where they are (a photo onto the mosaic)."""

    network: Network
    model: Model
    priors: PhotoPriors | ShapePriors = field(default_factory=PhotoPriors.none)
    fixed_points: bool = False

    @property
    def dof(self) -> int:
        net = self.network
        points = 0 if self.fixed_points else 2 * int((net.rays > 0).sum())
        return net.observed + self.priors.count - len(net.live) * self.model.size - points

    @cached_property
    def pattern(self) -> Any:
        return self.network.patterns(self.model.size)

    @cached_property
    def lut(self) -> np.ndarray:
        """(m, m) block of each pair of moving photos, -1 for none."""
        p = self.pattern
        out = np.full((p.count, p.count), -1, np.int32)
        out[p.row, p.column] = np.arange(len(p.row), dtype=np.int32)
        return out

    # -- x ----------------------------------------------------------------------------------------------------------------

    def pack(self, photos: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """x of photos (m, width) and points (n, 2)."""
        return np.concatenate([photos.ravel(), xy.ravel()])

    def split(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Photos (m, width) and points (n, 2) of x."""
        k = len(self.network.names) * self.model.width
        return x[:k].reshape(-1, self.model.width), x[k:].reshape(-1, 2)

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """(o, 2) observed minus computed, in standard deviations; NaN where a point lies behind a photo."""
        net = self.network
        photos, xy = self.split(x)
        return (net.q - self.model.see(photos, net.image, xy[net.point], net.lift[net.point]).q) * net.weight

    # -- the engine's questions ---------------------------------------------------------------------------------------------

    def cost(self, x: np.ndarray) -> float:
        net = self.network
        with np.errstate(invalid="ignore", over="ignore"):
            t2 = (self.residuals(x) ** 2).sum(axis=1)
        if not np.isfinite(t2).all():
            return float("inf")
        photos, xy = self.split(x)
        total = float((COSTS[net.loss](np.sqrt(t2)) if net.loss else t2 / 2).sum())
        if not self.fixed_points:
            given = net.weight_xy > 0
            total += 0.5 * float((net.weight_xy[given] * (net.known - xy)[given] ** 2).sum())
        if len(self.priors.photo):
            d = self.priors.misclosure(photos)
            total += 0.5 * float(np.einsum("ai,aij,aj->", d, self.priors.information, d))
        return total

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        net = self.network
        photos, xy = (part.copy() for part in self.split(x))
        k = len(net.live) * self.model.size
        photos[net.live] = self.model.moved(photos[net.live], dx[:k].reshape(len(net.live), -1))
        if not self.fixed_points:
            xy += dx[k:].reshape(-1, 2)
        return self.pack(photos, xy)

    def normal(self, x: np.ndarray) -> Dense | Schur:
        made = self.gather(x)
        diagonal = [np.einsum("kaa->ka", made.u).ravel()]
        if not self.fixed_points:
            diagonal.append(np.einsum("paa->pa", made.v).ravel())
        root = np.concatenate(diagonal)
        scale = np.sqrt(np.maximum(root, max(float(root.max(initial=0.0)) * 1e-24, np.finfo(float).tiny)))
        if self.fixed_points:
            return Dense(_block_diagonal(made.u), made.g.ravel())
        return Schur(np.concatenate([made.g.ravel(), made.q.ravel()]), scale, lambda damping: self.reduce(made, damping),
                     lambda images, _, damping: self.expand(made, images, damping))

    # -- normal equations -----------------------------------------------------------------------------------------------------

    def gather(self, x: np.ndarray) -> Gathered:
        """Weighted derivatives and the blocks on the diagonal at x."""
        net = self.network
        photos, xy = self.split(x)
        seen = self.model.see(photos, net.image, xy[net.point], net.lift[net.point])
        weight = net.weight
        residual = (net.q - seen.q) * weight
        if net.loss:
            factor = np.sqrt(LOSSES[net.loss](np.sqrt((residual**2).sum(axis=1))))[:, None]
            weight, residual = weight * factor, residual * factor
        a, b = seen.by_photo * weight[:, :, None], seen.by_point * weight[:, :, None]
        m = len(net.live)
        node = net.node[net.image]
        rows = np.flatnonzero(node >= 0)
        u = _summed(np.swapaxes(a[rows], 1, 2) @ a[rows], node[rows], m)
        g = _summed(np.einsum("oea,oe->oa", a[rows], residual[rows]), node[rows], m)
        v = _summed(np.swapaxes(b, 1, 2) @ b, net.point, len(xy))
        q = _summed(np.einsum("oea,oe->oa", b, residual), net.point, len(xy))
        v[:, [0, 1], [0, 1]] += net.weight_xy
        q += np.where(net.weight_xy > 0, net.weight_xy * (net.known - xy), 0.0)
        v[net.rays == 0] = np.eye(2)  # points that no photo sees stay
        if len(self.priors.photo):
            at = net.node[self.priors.photo]
            moving, info = at >= 0, self.priors.information
            np.add.at(u, at[moving], info[moving])
            np.add.at(g, at[moving], np.einsum("aij,aj->ai", info, self.priors.misclosure(photos))[moving])
        return Gathered(node, a, b, u, g, v, q)

    def reduce(self, made: Gathered, damping: float) -> Reduced:
        """The points eliminated, all diagonals raised by the damping."""
        net, p, s = self.network, self.pattern, self.model.size
        m = len(net.live)
        blocks, right = np.zeros((len(p.row), s, s)), made.g.copy()
        diagonal = self.lut[np.arange(m), np.arange(m)]
        blocks[diagonal] = made.u
        blocks[diagonal[:, None], np.arange(s), np.arange(s)] += damping * np.einsum("kaa->ka", made.u)
        eliminate = kernels("solvers.mosaic.elimination._kernels", "the registration").eliminate
        eliminate(net.start, made.node, np.ascontiguousarray(made.a), np.ascontiguousarray(made.b), _inverse(made.v, damping),
                  made.q, self.lut, blocks, right)
        return Reduced(p, blocks, np.zeros((m * s, 0)), np.zeros((0, 0)), right.ravel(), np.zeros(0))

    def expand(self, made: Gathered, images: np.ndarray, damping: float) -> np.ndarray:
        """(2 n,) the points' step that belongs to the photos' step (m s,)."""
        net = self.network
        rows = made.node >= 0
        moved = np.einsum("oea,oa->oe", made.a[rows], images.reshape(-1, self.model.size)[made.node[rows]])
        took = _summed(np.einsum("oeb,oe->ob", made.b[rows], moved), net.point[rows], len(made.q))
        return np.einsum("pab,pb->pa", _inverse(made.v, damping), made.q - took).ravel()


@dataclass(frozen=True)
class Gathered:
    """node (o,), weighted derivatives a (o, 2, s) by photos and b (o, 2, 2) by points, photos' blocks u (m, s, s) and right side
    g (m, s), points' blocks v (n, 2, 2) and right side q (n, 2)."""

    node: np.ndarray
    a: np.ndarray
    b: np.ndarray
    u: np.ndarray
    g: np.ndarray
    v: np.ndarray
    q: np.ndarray


def _summed(values: np.ndarray, index: np.ndarray, count: int) -> np.ndarray:
    """Sums (count, ...) of values (k, ...) by index."""
    flat = values.reshape(len(values), -1)
    out = np.stack([np.bincount(index, flat[:, k], count) for k in range(flat.shape[1])], axis=1)
    return out.reshape(count, *values.shape[1:])


def _inverse(v: np.ndarray, damping: float) -> np.ndarray:
    """(n, 2, 2) inverses of symmetric 2 by 2 blocks, diagonals raised by the damping."""
    a, b, c = v[:, 0, 0] * (1 + damping), v[:, 0, 1], v[:, 1, 1] * (1 + damping)
    out = np.empty_like(v)
    out[:, 0, 0], out[:, 1, 1], out[:, 0, 1] = c, a, -b
    out[:, 1, 0] = -b
    with np.errstate(divide="ignore", invalid="ignore"):
        return out / (a * c - b * b)[:, None, None]


def _block_diagonal(u: np.ndarray) -> np.ndarray:
    m, s, _ = u.shape
    out = np.zeros((m, s, m, s))
    out[np.arange(m), :, np.arange(m), :] = u
    return out.reshape(m * s, m * s)
