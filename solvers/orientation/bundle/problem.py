"""The bundle as a problem of the engine: poses, interior orientations and object points together.

x holds 12 numbers of every image, the ten parameters of every camera and three of every point; the tangent is (centre, left
rotation vector) of every image, the freed interior parameters and the changes of the points that are not fixed.
Reference: Brown 1958; docs/formulas.md 2, 3.7 and 9.
"""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...adjustment import Dense, Linear, Normal
from ...adjustment.fronts import alone
from ...adjustment.losses import COSTS, LOSSES
from ...cameras import project, project_derivatives
from ...geometry import Exterior, skew
from ...geometry.rotation import exp_many, log_many
from .compiled import Compiled
from .datum import Inner, motions
from .lagged import Lagged, lagged_derivatives, virtual
from .network import Network

DENSE = 2_000_000
"""Elements of a dense design matrix up to which no compiled kernel is needed."""

SLIGHT = 1e-10
"""Share by which the diagonal of a free network's normal matrix is raised."""


@dataclass(frozen=True)
class Bundle:
    """A bundle. inner: inner constraints of a free network, None where control or priors give the datum. compiled: the
    kernels that eliminate the points, None for the plain dense path, which gives the same."""

    network: Network
    inner: Inner | None = None
    compiled: Compiled | Lagged | None = None

    @classmethod
    def of(cls, network: Network, inner: Inner | None = None, dense: bool | None = None) -> Bundle:
        """Dense where the design matrix is small (or as told), compiled otherwise; sparse where images move as they are read."""
        m, f, live = network.sizes
        if network.extras.moving:
            return cls(network, inner, Lagged(network))
        small = 2 * len(network.image) * (6 * m + f + 3 * live) <= DENSE
        return cls(network, inner, None if (small if dense is None else dense) else Compiled(network))

    @property
    def model(self) -> Literal["perspective", "orthogonal"]:
        """The projection that is adjusted."""
        return "perspective"

    @property
    def dof(self) -> int:
        m, f, live = self.network.sizes
        return self.network.observed - (6 * m + f + 3 * live) + (self.inner.count if self.inner else 0)

    def cost(self, x: np.ndarray) -> float:
        net, interiors = self.network, self.network.split(x)[1]
        if (interiors[:, 0] <= 0).any() or not np.isfinite(x).all():
            return float("inf")
        total = self.given_cost(x)
        if self.compiled:
            return total + self.compiled.cost(x)
        t = np.linalg.norm(self.residuals(x), axis=1) / net.sigma
        seen = COSTS[net.loss](t) if net.loss else t**2 / 2
        return total + float(seen.sum()) if np.isfinite(t).all() else float("inf")

    def given_cost(self, x: np.ndarray) -> float:
        """Cost of weighted coordinates, priors and all that touches the border only: all but the images'."""
        net = self.network
        given = net.weight[:net.live] > 0
        total = 0.5 * float((net.weight[:net.live][given] * (net.known - net.split(x)[2])[:net.live][given] ** 2).sum())
        if net.extras.count:
            total += 0.5 * float((net.border_rows(x)[0] ** 2).sum())
        if len(net.prior_arrays[0]):
            total += 0.5 * float((self.prior_rows(x)[0] ** 2).sum())
        return total

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)  # `retract` keeps the inner constraints exactly

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        with alone() if self.compiled else nullcontext():
            return self._retracted(x, dx)

    def _retracted(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        net = self.network
        m, f, _ = net.sizes
        poses, interiors, points = (part.copy() for part in net.split(x))
        step = dx[:6 * m].reshape(m, 6)
        poses[:, :3] += step[:, :3]
        poses[:, 3:] = (exp_many(step[:, 3:]) @ poses[:, 3:].reshape(m, 3, 3)).reshape(m, 9)
        interiors[np.repeat(np.arange(len(net.cameras)), net.count), net.which] += dx[6 * m + net.tie]
        points[:net.unknown] += dx[net.point_columns[:net.unknown]]
        last = 6 * m + f - net.extras.motions
        shifts = net.shifts_at(x) + dx[last - 3 * len(net.extras.shifts):last].reshape(-1, 3)
        motion = net.motion_at(x) + dx[last:6 * m + f].reshape(len(net.extras.motion), net.extras.moving)
        x = net.pack(poses, interiors, points, shifts, motion)
        return self.inner.restored(net, x) if self.inner else x

    def normal(self, x: np.ndarray) -> Normal:
        if self.compiled:
            with alone():
                return self.compiled.normal(x, self.prior_rows(x), self.inner)
        normal = self.linear(x).normal()
        if self.inner is None:
            return normal
        # The datum is left to the damping, of which nothing is left once `retract` restores the inner one: steps held by a few
        # datum points would be long, and poorly predicted.
        n = normal.n.copy()
        n.flat[::len(n) + 1] *= 1 + SLIGHT
        return Dense(n, normal.gradient)

    # -- the plain path -------------------------------------------------------------------------------------------------

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """(o, 2) px, observed minus projected; NaN where a point cannot be seen."""
        net = self.network
        poses, _, points = net.split(x)
        v = np.empty_like(net.pixels)
        interiors = net.interiors_at(x)
        for i in range(len(net.images)):
            rows = net.seen_in(i)
            at = Exterior.from_vector(poses[i])
            at_point = virtual(net, x, i, rows) if net.extras.moving else points[net.point[rows]]
            v[rows] = net.pixels[rows] - project(interiors[net.camera[i]], at, at_point)
        return v

    def linear(self, x: np.ndarray) -> Linear:
        """One dense linear problem: image observations, then weighted coordinates and priors, whitened, in pairs."""
        net = self.network
        m, f, live = net.sizes
        poses, _, points = net.split(x)
        u, interiors = 6 * m + f + 3 * live, net.interiors_at(x)
        v, j = np.empty_like(net.pixels), np.zeros((len(net.image), 2, u))
        for i in range(m):
            rows = net.seen_in(i)
            camera, of = net.camera[i], net.point[rows]
            exterior = Exterior.from_vector(poses[i])
            if net.extras.moving:
                at, moved = lagged_derivatives(net, x, i, rows, interiors[camera])
                first = 6 * m + f - net.extras.motions + net.extras.moving * i
                j[rows, :, first:first + net.extras.moving] = moved
            else:
                at = project_derivatives(interiors[camera], exterior, points[of])
            v[rows] = net.pixels[rows] - at.pixels
            j[rows, :, 6 * i:6 * i + 3], j[rows, :, 6 * i + 3:6 * i + 6] = at.centre, at.rotation
            k = slice(net.first[camera], net.first[camera] + net.count[camera])
            j[rows[:, None, None], np.arange(2)[:, None], 6 * m + net.tie[k]] = at.interior[:, :, net.which[k]]
            unknown = of < net.unknown
            for c in range(3):
                j[rows[unknown], :, net.point_columns[of[unknown], c]] = at.point[unknown, :, c]
        factor = LOSSES[net.loss](np.linalg.norm(v, axis=1) / net.sigma) if net.loss else np.ones(len(v))
        p = (factor / net.sigma**2)[:, None, None] * np.eye(2)
        more_v, more_j = self._whitened(x, u)
        n = len(more_v)
        v = np.concatenate([v, more_v])
        h = w = None
        if self.inner:
            h = self.inner.rows_of(net, motions(net, x))
            w = np.zeros(len(h))
        return Linear(v, np.concatenate([j, more_j]), np.concatenate([p, np.broadcast_to(np.eye(2), (n, 2, 2))]), h, w)

    def _whitened(self, x: np.ndarray, u: int) -> tuple[np.ndarray, np.ndarray]:
        """(r, 2) misclosures and (r, 2, u) derivatives of weighted coordinates and priors, in standard deviations."""
        net = self.network
        m, f, live = net.sizes
        n, c = np.nonzero(net.weight[:live] > 0)
        root = np.sqrt(net.weight[n, c])
        v1, j1 = root * (net.known - net.split(x)[2])[n, c], np.zeros((len(n), u))
        j1[np.arange(len(n)), 6 * m + f + 3 * n + c] = root
        images, (v2, d) = net.prior_arrays[0], self.prior_rows(x)
        j2 = np.zeros((len(images), 6, u))
        for row, i in enumerate(images):
            j2[row, :, 6 * i:6 * i + 6] = d[row]
            if (at := net.shift_columns[i]) is not None:
                j2[row, :, 6 * m + at] = d[row, :, :3].T
        v, j = np.concatenate([v1, v2.ravel()]), np.concatenate([j1, j2.reshape(-1, u)])
        if net.extras.count:
            v3, border = net.border_rows(x)
            j3 = np.zeros((len(v3), u))
            j3[:, 6 * m:6 * m + f] = border
            v, j = np.concatenate([v, v3]), np.concatenate([j, j3])
        if len(v) % 2:
            v, j = np.append(v, 0.0), np.concatenate([j, np.zeros((1, u))])
        return v.reshape(-1, 2), j.reshape(-1, 2, u)

    def prior_rows(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(a, 6) misclosures of the images' priors in standard deviations, and (a, 6, 6) their derivatives, sign turned."""
        net, levers = self.network, self.network.extras.levers
        images, given, roots = net.prior_arrays
        if not len(images):
            return np.zeros((0, 6)), np.zeros((0, 6, 6))
        poses = net.split(x)[0][images]
        turned = np.swapaxes(poses[:, 3:].reshape(-1, 3, 3), 1, 2)
        r = log_many(given[:, 3:].reshape(-1, 3, 3) @ turned)
        k, theta = skew(r), np.linalg.norm(r, axis=1)
        safe = np.where(theta < 1e-3, 1.0, theta)
        curve = np.where(theta < 1e-3, 1 / 12, (1 - safe / 2 / np.tan(safe / 2)) / safe**2)
        d = np.tile(np.eye(6), (len(images), 1, 1))
        d[:, 3:, 3:] += k / 2 + curve[:, None, None] * (k @ k)
        if levers is not None:  # turning the image moves its antenna
            d[:, :3, 3:] += turned @ skew(levers[images])
        v = np.concatenate([given[:, :3] - self.antennas(x), r], axis=1)
        return (roots @ v[..., None])[..., 0], roots @ d

    def antennas(self, x: np.ndarray) -> np.ndarray:
        """(a, 3) where GPS puts the images with priors: at the antenna, shifted with their strip [m]."""
        net, extras = self.network, self.network.extras
        images = net.prior_arrays[0]
        poses = net.split(x)[0][images]
        centre = poses[:, :3].copy()
        if extras.levers is not None:
            centre += (np.swapaxes(poses[:, 3:].reshape(-1, 3, 3), 1, 2) @ extras.levers[images, :, None])[..., 0]
        if extras.shift_of is not None:
            of = extras.shift_of[images]
            centre[of >= 0] += net.shifts_at(x)[of[of >= 0]]
        return centre


__all__ = ["DENSE", "Bundle", "exp_many"]
