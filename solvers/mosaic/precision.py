"""How far a registration can be trusted: covariances of photos, the drift they predict, and what systematic errors add.

Covariance is only the lower bound of drift: it knows the noise of the tie points and nothing of relief or of distortion that was
left in. Their share is the adjustment's own response to them. Reference: FORMULAS section 6.4.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..adjustment.schur import Reduced
from ..errors import DegenerateGeometry
from .models import through
from .problem import Gathered, Registering, _inverse, _summed
from .simultaneous import homographies

GRID = np.stack(np.meshgrid(np.linspace(-0.9, 0.9, 5), np.linspace(-0.9, 0.9, 5)), -1).reshape(-1, 2)
"""(25, 2) places in a photo at which its error on the mosaic is judged, in half formats."""


@dataclass(frozen=True)
class Response:
    """A registration at its solution x; half (m, 2): half formats of the photos over c."""

    problem: Registering
    x: np.ndarray
    half: np.ndarray

    @cached_property
    def _made(self) -> tuple[Gathered, Reduced]:
        made = self.problem.gather(self.x)
        return made, self.problem.reduce(made, 0.0)

    @cached_property
    def covariance(self) -> np.ndarray:
        """(m, s, s) of every photo's tangent, a priori; zero for held photos. Raises DegenerateGeometry where singular."""
        problem, size = self.problem, self.problem.model.size
        out = np.zeros((len(problem.network.names), size, size))
        try:
            blocks = self._made[1].inverse()[0]
        except np.linalg.LinAlgError:
            raise DegenerateGeometry("the registration is singular: its tie points leave a photo free; add tie points spread "
                                     "over the overlaps, or control points") from None
        m = len(problem.network.live)
        out[problem.network.live] = blocks[problem.lut[np.arange(m), np.arange(m)]]
        return out

    @cached_property
    def onto(self) -> np.ndarray:
        """(m, 25, 2, s) how places of a photo move on the mosaic with its tangent; NaN beyond the horizon."""
        problem = self.problem
        photos = problem.split(self.x)[0]
        m = len(photos)
        q = (GRID[None] * self.half[:, None]).reshape(-1, 2)
        image = np.repeat(np.arange(m), len(GRID))
        xy = through(np.linalg.inv(homographies(problem.model, photos))[image], q)[0]
        seen = problem.model.see(photos, image, xy, np.zeros(len(q)))
        with np.errstate(invalid="ignore"):
            j = -np.linalg.solve(np.where(np.isfinite(seen.by_point), seen.by_point, np.eye(2)), seen.by_photo)
        j[~np.isfinite(xy).all(axis=1)] = np.nan
        return j.reshape(m, len(GRID), 2, -1)

    def noise(self) -> np.ndarray:
        """(m,) standard error of a photo's places on the mosaic: rms over the photo of the length of the error, noise alone."""
        j = self.onto
        return np.sqrt(np.nanmean(np.einsum("mgea,mab,mgeb->mg", j, self.covariance, j), axis=1))

    def to(self, errors: np.ndarray) -> np.ndarray:
        """(m, s, k) the photos' tangent steps by k sets of errors (o, 2, k) of observations [their sigmas]."""
        problem, net = self.problem, self.problem.network
        made, reduced = self._made
        s, k = problem.model.size, errors.shape[2]
        factor = np.ones(len(net.image))
        if net.loss:
            from ..adjustment.losses import LOSSES

            factor = np.sqrt(LOSSES[net.loss](np.linalg.norm(problem.residuals(self.x), axis=1)))
        e = errors * factor[:, None, None]
        q = _summed(np.einsum("oea,oek->oak", made.b, e), net.point, len(net.known))
        t = _inverse(made.v, 0.0) @ q
        e = e - made.b @ t[net.point]
        rows = np.flatnonzero(made.node >= 0)
        g = _summed(np.einsum("oea,oek->oak", made.a[rows], e[rows]), made.node[rows], len(net.live))
        out = np.zeros((len(net.names), s, k))
        out[net.live] = reduced.factor.solve(g.reshape(-1, k)).reshape(-1, s, k)
        return out

    def moved(self, steps: np.ndarray) -> np.ndarray:
        """(m, k) rms over the photo of the displacement on the mosaic by tangent steps (m, s, k)."""
        return np.sqrt(np.nanmean((self.onto @ steps[:, None]) ** 2, axis=1).sum(axis=1))

    def relief(self, sigma: float, draws: int = 24, seed: int = 2) -> np.ndarray:
        """(m,) rms displacement where points lie off the plane by independent heights of standard deviation sigma [mosaic unit],
        by `draws` draws of linear theory."""
        net, heights = self.problem.network, np.random.default_rng(seed).standard_normal((len(self.problem.network.known), draws))
        errors = self.by_height()[:, :, None] * sigma * heights[net.point][:, None, :]
        return np.sqrt((self.moved(self.to(errors)) ** 2).mean(axis=1))

    def by_height(self) -> np.ndarray:
        """(o, 2) shift of each observation, in standard deviations, per unit of height of its point: away from the nadir, for
        photos that look down (exact for vertical ones)."""
        net, h = self.problem.network, homographies(self.problem.model, self.problem.split(self.x)[0])
        at = through(np.linalg.inv(h), np.zeros((len(h), 2)))[0]
        p = np.einsum("mij,mj->mi", h[:, :, :2], at) + h[:, :, 2]
        j = h[:, :2, :2] / p[:, 2, None, None]
        scale = np.sqrt(np.abs(np.linalg.det(j)))  # c over the height, per unit
        return net.q * scale[net.image][:, None] * net.weight

    def distortion(self, corner: float) -> np.ndarray:
        """(m,) rms displacement by a radial distortion left in that shifts the photo's corners by `corner` (over c), cubic."""
        net = self.problem.network
        reach = np.linalg.norm(self.half, axis=1)[net.image]
        radius = np.linalg.norm(net.q, axis=1)
        shift = net.q / reach[:, None] * (radius**2 / reach**2)[:, None] * corner
        return self.moved(self.to((shift * net.weight)[:, :, None]))[:, 0]


__all__ = ["GRID", "Response"]
