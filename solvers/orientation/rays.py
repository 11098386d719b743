"""The problem of intersection: points that share no unknown, all of them stepped at once by the engine."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..adjustment import Linear
from ..cameras import Interior, project_derivatives
from ..geometry import Exterior


@dataclass(frozen=True)
class Blocks:
    """Normal equations of many points that share no unknown: n (m, 3, 3), g (m, 3)."""

    n: np.ndarray
    g: np.ndarray
    scale: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        diagonal = np.einsum("mii->mi", self.n).ravel()
        object.__setattr__(self, "scale", np.sqrt(np.maximum(diagonal, np.finfo(float).tiny)))

    @property
    def gradient(self) -> np.ndarray:
        return self.g.ravel()

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        s = self.scale.reshape(-1, 3)
        scaled = self.n / (s[:, :, None] * s[:, None, :]) + damping * np.eye(3)
        try:
            dx = np.linalg.solve(scaled, (self.g / s)[..., None])[..., 0] / s
        except np.linalg.LinAlgError:
            dx = np.full_like(self.g, np.nan)
        return dx.ravel(), np.zeros(0)

    def covariance(self) -> np.ndarray:
        """(m, 3, 3) covariance of each point."""
        s = self.scale.reshape(-1, 3)
        q = np.linalg.inv(self.n / (s[:, :, None] * s[:, None, :])) / (s[:, :, None] * s[:, None, :])
        return (q + np.swapaxes(q, 1, 2)) / 2


class Seen(NamedTuple):
    """Pixels (o, 2) and their derivatives by centre, left rotation vector and object point, (o, 2, 3) each."""

    pixels: np.ndarray
    centre: np.ndarray
    rotation: np.ndarray
    point: np.ndarray


@dataclass(frozen=True)
class Intersection:
    """Intersection of m points: x (3 m,) local coordinates [m], the tangent is their change.

    cameras: interior and exterior (local) of each image. image, point (o,): which image and which point an observation is of;
    pixels (o, 2); sigma (o,) px of the image measurement alone; weights (o, 2, 2) px^-2, orientation errors included.
    """

    cameras: tuple[tuple[Interior, Exterior], ...]
    image: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    sigma: np.ndarray
    weights: np.ndarray
    count: int

    @property
    def dof(self) -> int:
        return 2 * len(self.point) - 3 * self.count

    def derivatives(self, x: np.ndarray) -> Seen:
        """Pixels of every observation with their derivatives, (o, ...); NaN behind a camera."""
        xyz = x.reshape(-1, 3)[self.point]
        out = Seen(*(np.full((len(xyz), 2, *k), np.nan) for k in ((), (3,), (3,), (3,))))
        for i in np.unique(self.image):
            interior, exterior = self.cameras[i]
            rows = np.flatnonzero(self.image == i)
            rows = rows[exterior.camera(xyz[rows])[:, 2] < 0]
            at = project_derivatives(interior, exterior, xyz[rows])
            for name, whole in out._asdict().items():
                whole[rows] = getattr(at, name)
        return out

    def cost(self, x: np.ndarray) -> float:
        v = self.pixels - self.derivatives(x).pixels
        return 0.5 * float(np.einsum("oa,oab,ob->", v, self.weights, v))

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def linear(self, x: np.ndarray) -> Linear:
        """The same as one dense linear problem, (o, 2, 3 m): for checks, not for many points."""
        at = self.derivatives(x)
        j = np.zeros((len(self.point), 2, 3 * self.count))
        for k, p in enumerate(self.point):
            j[k, :, 3 * p:3 * p + 3] = at.point[k]
        return Linear(self.pixels - at.pixels, j, self.weights)

    def normal(self, x: np.ndarray) -> Blocks:
        at = self.derivatives(x)
        jp = np.swapaxes(at.point, 1, 2) @ self.weights
        n, g = np.zeros((self.count, 3, 3)), np.zeros((self.count, 3))
        np.add.at(n, self.point, jp @ at.point)
        np.add.at(g, self.point, (jp @ (self.pixels - at.pixels)[..., None])[..., 0])
        return Blocks(n, g)

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        return x + dx

    def take(self, rows: np.ndarray) -> Intersection:
        """Only some of the observations; every point stays."""
        return replace(self, image=self.image[rows], point=self.point[rows], pixels=self.pixels[rows],
                       sigma=self.sigma[rows], weights=self.weights[rows])

    def only(self, points: np.ndarray) -> Intersection:
        """Only some of the points (count,) bool, renumbered."""
        some = self.take(points[self.point])
        return replace(some, point=(np.cumsum(points) - 1)[some.point], count=int(points.sum()))

    def weighted(self, x: np.ndarray, covariances: tuple[np.ndarray | None, ...]) -> Intersection:
        """The same with weights that have the orientations' covariances (6, 6) in them, at the points x."""
        cov = self.sigma[:, None, None]**2 * np.eye(2)
        j = self.by_orientation(x)
        for k, c in enumerate(covariances):
            rows = self.image == k
            if c is not None and rows.any():
                extra = j[rows] @ c @ np.swapaxes(j[rows], 1, 2)
                cov[rows] += np.where(np.isfinite(extra), extra, 0.0)
        return replace(self, weights=np.linalg.inv(cov))

    def by_orientation(self, x: np.ndarray) -> np.ndarray:
        """(o, 2, 6) derivatives of the pixels by (centre, left rotation vector) of their image."""
        at = self.derivatives(x)
        return np.concatenate([at.centre, at.rotation], axis=2)

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """(o, 3) perspective centres and (o, 3) unit directions of all rays, local."""
        centre, unit = np.empty((len(self.point), 3)), np.empty((len(self.point), 3))
        for i in np.unique(self.image):
            rows, (interior, exterior) = self.image == i, self.cameras[i]
            xy = interior.ideal(self.pixels[rows])
            ray = np.column_stack([xy, np.full(len(xy), -interior.c)]) @ exterior.m
            centre[rows], unit[rows] = exterior.centre, ray / np.linalg.norm(ray, axis=1)[:, None]
        return centre, unit

    def start(self) -> np.ndarray:
        """(3 m,) points nearest to their rays, all at once, linear; NaN where the rays are parallel or fewer than two."""
        centre, unit = self.rays()
        across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
        n, g = np.zeros((self.count, 3, 3)), np.zeros((self.count, 3))
        np.add.at(n, self.point, across)
        np.add.at(g, self.point, (across @ centre[..., None])[..., 0])
        n = n / np.maximum(np.bincount(self.point, minlength=self.count), 1)[:, None, None]
        g = g / np.maximum(np.bincount(self.point, minlength=self.count), 1)[:, None]
        ok = np.linalg.eigvalsh(n)[:, 0] > 1e-14
        x = np.full((self.count, 3), np.nan)
        x[ok] = np.linalg.solve(n[ok], g[ok][..., None])[..., 0]
        return x.ravel()
