"""Plane coefficients held by onboard positions: photos are taken to be nearly vertical above where they were.

A position places the ground under a photo no better than its tilt is known, and holds nothing else; that photos look down,
within some degrees, does. Both are weighted observations of every photo, so that the covariance knows the levers: heading,
scale, the tilt of the plane, the bend of a strip. How far photos tilt is estimated with them. Relief and distortion left in are
not noise: each is told by what it leaves in the residuals, and what it does to the mosaic is the adjustment's own response.
Reference: docs/formulas.md 6.4; Foerstner & Wrobel 2016, 4.2.4 (variance components).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..geometry import Exterior
from .data import Data
from .models import Coefficients, Exteriors
from .network import Network
from .precision import Response
from .problem import Registering, ShapePriors
from .simultaneous import Found, homographies, run, spread, upright

TILT = np.radians(3.0)
"""Standard deviation beforehand of the tilt, each way, of a photo that is meant to be vertical."""
SURE_OF = 3
"""Tilts that this is worth."""
SQUEEZE = 0.002
"""Standard deviation of what a vertical photo's affinity differs by from a similarity: sloping ground; and tilt squared."""
OBLIQUE = np.radians(15.0)
"""Recorded tilt from which a photo is not taken to be vertical."""
TURNS, DRAWS = 4, 128

BASIS = np.array([  # D = (d11 d12 d13 d21 d22 d23 d31 d32) by shift x, y; scale; turn; two squeezes; tilt x, y
    [0, 0, 1, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 1, 0, 0], [1, 0, 0, 0, 0, 0, 1, 0], [0, 0, 0, -1, 0, 1, 0, 0],
    [0, 0, 1, 0, -1, 0, 0, 0], [0, 1, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, -1, 0], [0, 0, 0, 0, 0, 0, 0, -1]], float)
BACK = np.linalg.inv(BASIS)
SHIFT, SQUEEZED, TILTED = slice(0, 2), slice(4, 6), slice(6, 8)


class Precision(NamedTuple):
    """covariance (m, 8, 8) of D, noise (m,) standard error of places, with relief of standard deviation `height` [unit] off the
    plane and radial distortion of `corner` [px] at the photos' corners in it; tilt: standard deviation found [rad]."""

    covariance: np.ndarray
    noise: np.ndarray
    height: float
    corner: float
    tilt: float

    def said(self, unit: str) -> str:
        """A sentence on what the standard errors hold."""
        return (f"photos are taken to be nearly vertical (tilts of {np.degrees(self.tilt):.1f} degrees were found) where onboard "
                f"positions say; what tie points leave stands for {self.height:.2g} {unit} of relief off the plane and "
                f"{self.corner:.1f} px of distortion at the corners, whose drift is in the standard errors")


def held_by_positions(data: Data, net: Network, found: Found) -> Found:
    """Coefficients (plane in map units) adjusted once more with onboard positions and upright photos as weighted observations.

    net: of that plane, nothing held. The tie points weigh as much as they fit.
    """
    net = replace(net, weight=net.weight / max(1.0, spread(found.problem, found.x)))
    vertical, sigma = _recorded_tilt(data) < OBLIQUE, TILT
    for _ in range(TURNS):
        problem = Registering(net, Coefficients(), _priors(data, found.warps, vertical, sigma))
        found = run(problem, problem.pack(found.warps.reshape(-1, 9), found.xy), "positions", found)
        sigma = _tilt_of(Response(problem, found.x, data.half), vertical, sigma)
    return found


def _priors(data: Data, h: np.ndarray, vertical: np.ndarray, tilt: float) -> ShapePriors:
    """h (m, 3, 3): where the photos are now, which gives their scale and azimuth; vertical (m,): which ones look down."""
    photos = upright(h)
    height = photos[:, 2]
    known = np.isfinite(data.gps[:, :2]).all(axis=1) & vertical
    photos[known, :2] = data.gps[known, :2]
    sigma = np.full((len(h), 8), np.inf)
    sigma[known, SHIFT] = data.gps_sigma[known, :2] / height[known, None]
    sigma[vertical, SQUEEZED], sigma[vertical, TILTED] = np.hypot(SQUEEZE, tilt**2), tilt
    return ShapePriors(np.arange(len(h)), homographies(Exteriors(), photos), np.einsum("pa,kp,pb->kab", BACK, 1 / sigma**2, BACK))


def _tilt_of(response: Response, vertical: np.ndarray, sigma: float) -> float:
    """Standard deviation [rad] of the photos' tilt by what the adjustment left of it, with its redundancy."""
    priors = response.problem.priors
    assert isinstance(priors, ShapePriors)
    t = (priors.misclosure(response.problem.split(response.x)[0]) @ BACK.T)[vertical, TILTED]
    cofactor = BACK[TILTED] @ response.covariance[vertical] @ BACK[TILTED].T / sigma**2
    redundancy = max(t.size - float(np.einsum("kaa->", cofactor)), 0.0)
    return float(np.clip(np.sqrt(((t**2).sum() + SURE_OF * TILT**2) / (redundancy + SURE_OF)), TILT / 6, 3 * TILT))


def _recorded_tilt(data: Data) -> np.ndarray:
    """(m,) tilt that onboard angles say [rad]; 0 where they are not known."""
    priors = [data.block.images[data.block.image_index(n)].prior for n in data.names]
    return np.array([0.0 if p is None or p.angles is None else
                     np.arccos(np.clip(Exterior.from_angles(*p.angles, centre=np.zeros(3)).m[2, 2], -1, 1)) for p in priors])


def held_precision(response: Response, factor: float, scale: np.ndarray, seed: int = 3) -> Precision:
    """response: at the solution of `held_by_positions`, whose weights are those of the marks over `factor`; scale (m,): principal
    distances [px]. Raises DegenerateGeometry where singular."""
    problem, net = response.problem, response.problem.network
    m, rng = len(net.names), np.random.default_rng(seed)
    priors = problem.priors
    assert isinstance(priors, ShapePriors)
    values, vectors = np.linalg.eigh(priors.information)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    by_priors = response.by_right(np.einsum("kab,kbd->kad", root, rng.standard_normal((m, 8, DRAWS))))
    covariance = response.covariance / factor**2 + (1 - 1 / factor**2) * _squared(by_priors)
    reach = np.linalg.norm(response.half, axis=1)[net.image]
    cubic = net.q / reach[:, None] * ((net.q**2).sum(axis=1) / reach**2)[:, None]  # 1 at a corner
    shift = (cubic * net.weight / scale[net.image, None])[:, :, None]
    bent = response.to(shift)
    mark = response.left(shift, bent)[:, :, 0] * response.robust[:, :, 0]
    v = problem.residuals(response.x) * response.robust[:, :, 0]
    weight = float((mark**2).sum())
    corner = float((v * mark).sum() / weight)
    lens = np.hypot(corner, 1 / np.sqrt(weight))
    heights = rng.standard_normal((len(net.known), DRAWS // 4))
    raised = response.by_height()[:, :, None] * heights[net.point][:, None, :]
    lifted = response.to(raised)
    sound = response.robust[:, 0, 0] > 0.1  # not marks that are wrong by far
    remains = float((response.left(raised, lifted)[sound] ** 2).sum(axis=1).mean())
    whole = (v - corner * mark) / response.robust[:, :, 0]  # the loss trims where it is high: all of it counts here
    more = max(float((whole[sound] ** 2).sum(axis=1).mean()) - 2 * _share(problem) / factor**2, 0.0)
    height = np.sqrt(more / max(remains, 1e-300))
    covariance = covariance + height**2 * _squared(lifted) + lens**2 * _squared(bent)
    j = response.onto
    noise = np.sqrt(np.nanmean(np.einsum("mgea,mab,mgeb->mg", j, covariance, j), axis=1))
    tilt = float(np.sqrt(1 / np.median(np.einsum("ap,kab,bp->kp", BASIS, priors.information, BASIS)[:, 7])))
    return Precision(covariance, noise, float(height), float(lens), tilt)


def _share(problem: Registering) -> float:
    """What part of the observations' noise is seen in their residuals."""
    return min(max(problem.dof / (2 * len(problem.network.image)), 0.1), 1.0)


def _squared(steps: np.ndarray) -> np.ndarray:
    """(m, s, s) mean of the products of steps (m, s, k)."""
    return steps @ np.swapaxes(steps, 1, 2) / steps.shape[2]


__all__ = ["Precision", "held_by_positions", "held_precision"]
