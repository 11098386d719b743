"""How far a registration can be trusted: covariances of photos, the drift they predict, and what systematic errors add.

Covariance is only the lower bound of drift: it knows the noise of the tie points and nothing of relief or of distortion that was
left in. Their share is the adjustment's own response to them. Reference: docs/formulas.md 6.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..adjustment.schur import Reduced
from ..cameras import Interior
from ..errors import DegenerateGeometry
from .bends import by_bend
from .models import Seen, through
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
    def _grid(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, Seen]:
        """Photos (25 m,), photo coordinates over c (25 m, 2) of the places, X, Y (25 m, 2) and how they are seen."""
        problem = self.problem
        photos = problem.split(self.x)[0]
        q = (GRID[None] * self.half[:, None]).reshape(-1, 2)
        image = np.repeat(np.arange(len(photos)), len(GRID))
        xy = through(np.linalg.inv(homographies(problem.model, photos))[image], q)[0]
        return image, q, xy, problem.model.see(photos, image, xy, np.zeros(len(q)))

    @cached_property
    def onto(self) -> np.ndarray:
        """(m, 25, 2, s) how places of a photo move on the mosaic with its tangent; NaN beyond the horizon."""
        return self.moving(self._grid[3].by_photo)

    def bending(self, interiors: Sequence[Interior]) -> np.ndarray:
        """(m, 25, 2, 6) how places of a photo move on the mosaic with its bend."""
        return self.moving(by_bend(interiors, *self._grid[:2]))

    def moving(self, by: np.ndarray) -> np.ndarray:
        """(m, 25, 2, k) on the mosaic from (25 m, 2, k) in the photos."""
        _, _, xy, seen = self._grid
        with np.errstate(invalid="ignore"):
            j = -np.linalg.solve(np.where(np.isfinite(seen.by_point), seen.by_point, np.eye(2)), by)
        j[~np.isfinite(xy).all(axis=1)] = np.nan
        return j.reshape(-1, len(GRID), 2, j.shape[2])

    def noise(self) -> np.ndarray:
        """(m,) standard error of a photo's places on the mosaic: rms over the photo of the length of the error, noise alone."""
        j = self.onto
        return np.sqrt(np.nanmean(np.einsum("mgea,mab,mgeb->mg", j, self.covariance, j), axis=1))

    def to(self, errors: np.ndarray) -> np.ndarray:
        """(m, s, k) the photos' tangent steps by k sets of errors (o, 2, k) of observations [their sigmas]."""
        net, (made, reduced) = self.problem.network, self._made
        s, k = self.problem.model.size, errors.shape[2]
        e = errors * self.robust
        e = e - made.b @ self._points(e)[net.point]
        rows = np.flatnonzero(made.node >= 0)
        g = _summed(np.einsum("oea,oek->oak", made.a[rows], e[rows]), made.node[rows], len(net.live))
        out = np.zeros((len(net.names), s, k))
        out[net.live] = reduced.factor.solve(g.reshape(-1, k)).reshape(-1, s, k)
        return out

    def by_right(self, right: np.ndarray) -> np.ndarray:
        """(m, s, k) the photos' tangent steps by right sides (m, s, k) of their own, of priors that err."""
        net, s = self.problem.network, self.problem.model.size
        out = np.zeros(right.shape)
        out[net.live] = self._made[1].factor.solve(right[net.live].reshape(-1, right.shape[2])).reshape(-1, s, right.shape[2])
        return out

    def left(self, errors: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """(o, 2, k) what is left of errors (o, 2, k) when the photos took their steps (m, s, k) and the points theirs."""
        made = self._made[0]
        e = errors * self.robust - made.a @ steps[self.problem.network.image]
        return (e - made.b @ self._points(e)[self.problem.network.point]) / self.robust

    def _points(self, e: np.ndarray) -> np.ndarray:
        """(n, 2, k) steps of the points alone by weighted errors (o, 2, k)."""
        made, net = self._made[0], self.problem.network
        return _inverse(made.v, 0.0) @ _summed(np.einsum("oea,oek->oak", made.b, e), net.point, len(net.known))

    @cached_property
    def robust(self) -> np.ndarray:
        """(o, 1, 1) square roots of the weights that the loss leaves."""
        net = self.problem.network
        if not net.loss:
            return np.ones((len(net.image), 1, 1))
        from ..adjustment.losses import LOSSES

        return np.sqrt(LOSSES[net.loss](np.linalg.norm(self.problem.residuals(self.x), axis=1)))[:, None, None]

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
