"""What calibrated parameters do together: distortion curves with their standard errors, and two calibrations compared.

K1, K2, K3 are correlated by -0.9 and more, so single coefficients say little; their curve says all (docs/formulas.md 9).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .interior import PARAMETERS, Interior


@dataclass(frozen=True)
class Calibrated:
    """An interior orientation with the covariance (10, 10) of `PARAMETERS`; zero rows for what was not adjusted."""

    interior: Interior
    covariance: np.ndarray

    @property
    def free(self) -> np.ndarray:
        """Positions among `PARAMETERS` of what was adjusted."""
        return np.flatnonzero(np.diag(self.covariance) > 0)


@dataclass(frozen=True)
class Curve:
    """radius (n,) mm, measured; radial, decentring (n,): corrections in micrometres, and their standard errors."""

    radius: np.ndarray
    radial: np.ndarray
    radial_sigma: np.ndarray
    decentring: np.ndarray
    decentring_sigma: np.ndarray


def curve(of: Calibrated, steps: int = 9) -> Curve:
    """The distortion curves of a camera out to the corner of its format."""
    i, c = of.interior, of.covariance
    reach = float(np.linalg.norm(np.array([i.width, i.height]) * i.pitch / 2))
    r = np.linspace(0, reach, steps)
    by_k = np.stack([r**3, r**5, r**7], axis=1)
    p = float(np.hypot(i.p1, i.p2))
    by_p = np.outer(r**2, np.array([i.p1, i.p2]) / p if p > 0 else np.array([1.0, 0.0]))
    sigma_k = np.sqrt(np.einsum("ni,ij,nj->n", by_k, c[3:6, 3:6], by_k))
    sigma_p = np.sqrt(np.einsum("ni,ij,nj->n", by_p, c[6:8, 6:8], by_p))
    return Curve(r, 1e3 * by_k @ i.parameters[3:6], 1e3 * sigma_k, 1e3 * p * r**2, 1e3 * sigma_p)


@dataclass(frozen=True)
class Difference:
    """Second calibration minus first. names, difference, sigma (k,): of the parameters both adjusted; chi_square over all of them
    with dof and probability (of a larger one, if nothing changed); radius (n,) mm, image_um (n,): how far apart the two cameras
    place the same ray along a radius, micrometres, principal distance included; image_sigma (n,)."""

    names: tuple[str, ...]
    difference: np.ndarray
    sigma: np.ndarray
    chi_square: float
    dof: int
    probability: float
    radius: np.ndarray
    image_um: np.ndarray
    image_sigma: np.ndarray

    @property
    def changed(self) -> bool:
        """Whether the two differ by more than their standard errors explain (1 %)."""
        return self.probability < 0.01


def difference(first: Calibrated, second: Calibrated, steps: int = 9) -> Difference:
    """Two independent calibrations of one camera, compared by parameters and by where they put rays.

    Raises ValueError where no parameter is adjusted in both.
    """
    from scipy.stats import chi2

    both = np.intersect1d(first.free, second.free)
    if not len(both):
        raise ValueError("the two calibrations adjust no parameter in common")
    d = (second.interior.parameters - first.interior.parameters)[both]
    q = (first.covariance + second.covariance)[np.ix_(both, both)]
    s = np.sqrt(np.diag(q))
    chi = float((d / s) @ np.linalg.solve(q / np.outer(s, s), d / s))
    half = np.array([first.interior.width, first.interior.height]) * first.interior.pitch / 2
    r = np.linspace(0, float(np.linalg.norm(half)), steps)
    one, two = (_outward(c.interior, r) for c in (first, second))
    by = _outward_derivatives(first.interior, r)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", by, (first.covariance + second.covariance)[np.ix_(RADIAL, RADIAL)], by))
    return Difference(tuple(PARAMETERS[k] for k in both), d, s, chi, len(both), float(chi2.sf(chi, len(both))), r,
                      1e3 * first.interior.c * (two - one), 1e3 * first.interior.c * sigma)


RADIAL = [0, 3, 4, 5]
"""Positions of c, k1, k2, k3."""


def _outward(interior: Interior, r: np.ndarray) -> np.ndarray:
    """Tangent of the angle to the axis of rays measured at radius r [mm]."""
    _, _, _, k1, k2, k3 = interior.parameters[:6]
    return (r + k1 * r**3 + k2 * r**5 + k3 * r**7) / interior.c


def _outward_derivatives(interior: Interior, r: np.ndarray) -> np.ndarray:
    """(n, 4) by c, k1, k2, k3."""
    return np.stack([-_outward(interior, r) / interior.c, r**3 / interior.c, r**5 / interior.c, r**7 / interior.c], axis=1)
