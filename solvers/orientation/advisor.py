"""Which model? The error of every candidate, predicted for the given control before any solution is believed.

Reference: docs/formulas.md 3.6 and 5; Gauss-Markov: with the same information the perspective adjustment is never worse.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..adjustment import precision
from ..block import Block
from ..errors import BadProject
from ..geometry import Exterior
from .one_pass import one_pass_covariance
from .orthogonal import Orthogonal
from .resection import PriorOrientation, Resection
from .single import AMBIGUOUS, Request, discrimination, given_prior, prepare

UNDETERMINED_DEG = 2.0
"""Tilt standard error beyond which an image does not determine its exterior orientation."""
FACTORS = np.array([1.0, 2.0, 3.0, 5.0])
"""By how much a prior's sigmas may be too small ..."""
BELIEF = np.array([0.5, 0.05, 0.4, 0.05])
"""... and how probable each of these is held to be before the image is asked: honest, or about three times too small."""
NEARLY_BEST = 1.1
"""Tilt error over the least possible one within which a choice is as good as the best."""
MARGIN = 0.1
"""How much likelier leaving a prior out must be to be (nearly) best before it is left out."""


@dataclass(frozen=True)
class Prediction:
    """Covariance (6, 6) of X, Y, Z [m], omega, phi, kappa [rad] that a candidate will have, and what bounds it."""

    covariance: np.ndarray
    remarks: dict[str, float] = field(default_factory=dict)

    @property
    def tilt(self) -> float:
        """Standard error of the tilt, sqrt(omega^2 + phi^2) [rad]."""
        return float(np.sqrt(self.covariance[3, 3] + self.covariance[4, 4]))

    def to_json(self) -> dict[str, float]:
        sd = np.sqrt(np.diag(self.covariance))
        keys = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg")
        values = dict(zip(keys, map(float, [*sd[:3], *np.degrees(sd[3:])]), strict=True))
        return {**values, "tilt_deg": float(np.degrees(self.tilt)), **self.remarks}


@dataclass(frozen=True)
class Advice:
    """The recommended model, the reasons in words, and the predicted errors of every candidate.

    model: "perspective", "perspective with prior", "orthogonal one pass", or "local registration" where the control
    determines no exterior orientation. discrimination: D of the second solution, None where there is none.
    """

    model: str
    reasons: tuple[str, ...]
    predicted: dict[str, Prediction]
    discrimination: float | None = None

    def to_json(self) -> dict[str, Any]:
        return {"model": self.model, "reasons": list(self.reasons), "discrimination": self.discrimination,
                "predicted": {name: p.to_json() for name, p in self.predicted.items()}}


def advise(block: Block, image: str, points: tuple[str, ...] | None = None) -> Advice:
    """Advice for an image and its control; a complete prior with sigmas in the project joins as a candidate.

    Raises what `prepare` raises when no orientation can be found at all.
    """
    start = prepare(block, Request(image, points=points))
    problem = start.problem
    assert isinstance(problem, Resection)
    trace = start.trace
    at = Exterior.from_vector(trace.last.x)
    cp = precision(problem.linear(trace.last.x), f"image '{image}'").covariance
    try:
        prior = given_prior(block, image, start.frame)
    except BadProject:
        prior = None
    if prior is not None and prior.count < 6:
        prior = None
    found = _predict(start.control.take(start.used), at, cp, prior)
    d = discrimination(start, at, start.control.take(start.used))
    trust = None if prior is None else _trust(prior, at, cp)
    model, reasons = _choose(found, d, trust)
    return Advice(model, tuple(reasons), found, d)


def _predict(control: Any, at: Exterior, cp: np.ndarray, prior: PriorOrientation | None) -> dict[str, Prediction]:
    sigma = np.linalg.inv(control.weights(at))
    orthogonal = Orthogonal(control.interior, control.points, control.pixels, sigma)
    leak = orthogonal.statistics(at)
    out = {"perspective": Prediction(at.angle_covariance(cp))}
    iterated = at.angle_covariance(leak.iterated) if leak.radius < 1 else np.full((6, 6), np.inf)
    out["orthogonal iterated"] = Prediction(iterated, {"spectral_radius": leak.radius})
    if prior is not None:
        inverse = np.linalg.inv(prior.root)
        c0 = inverse @ inverse.T
        cb = np.linalg.inv(np.linalg.inv(cp) + prior.root.T @ prior.root)
        share = float(np.trace((cb @ np.linalg.inv(c0))[3:5, 3:5]) / 2)
        out["orthogonal one pass"] = Prediction(at.angle_covariance(one_pass_covariance(orthogonal, at, prior)[0]))
        out["perspective with prior"] = Prediction(at.angle_covariance(cb), {"prior_share": share})
    return out


@dataclass(frozen=True)
class Trust:
    """What the image says of its prior. factor: most probable factor of its sigmas; rarity: chance that an honest prior
    disagrees as much (chi-square, 6); tilt: expected error [rad] of the perspective adjustment weighted with it; use: whether
    weighting it is about as likely to be (nearly) the best choice as leaving it out, or likelier."""

    factor: float
    rarity: float
    tilt: float
    use: bool


def _trust(prior: PriorOrientation, at: Exterior, cp: np.ndarray) -> Trust:
    """The gap between prior and image is normal with C_P + k^2 Sigma_0: how probable is each factor k, and what would the
    weighted adjustment, which believes k = 1, then be worth beside the one without the prior?"""
    from scipy.special import gammaincc

    inverse = np.linalg.inv(prior.root)
    c0, gap = inverse @ inverse.T, prior.misclosure(at)
    spread = [cp + k**2 * c0 for k in FACTORS]
    chi2 = np.array([gap @ np.linalg.solve(c, gap) for c in spread])
    log_likelihood = -(chi2 + [np.linalg.slogdet(c)[1] for c in spread]) / 2
    weight = BELIEF * np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    np_, n0 = np.linalg.inv(cp), prior.root.T @ prior.root
    cb = np.linalg.inv(np_ + n0)
    tilts = np.array([Prediction(at.angle_covariance(cb @ (np_ + k**2 * n0) @ cb)).tilt for k in FACTORS])
    free = Prediction(at.angle_covariance(cp)).tilt
    enough = NEARLY_BEST * np.minimum(tilts, free)
    return Trust(float(FACTORS[np.argmax(weight)]), float(gammaincc(3.0, chi2[0] / 2)), float(np.sqrt(weight @ tilts**2)),
                 bool(weight @ (tilts <= enough) > weight @ (free <= enough) - MARGIN))


def _choose(found: dict[str, Prediction], d: float | None, trust: Trust | None) -> tuple[str, list[str]]:
    def deg(name: str) -> float:
        return float(np.degrees(found[name].tilt))

    reasons = []
    free = deg("perspective")
    if trust is not None and trust.use:
        share = found["perspective with prior"].remarks["prior_share"]
        reasons.append("the prior joins as a weighted observation: predicted tilt error "
                       f"{deg('perspective with prior'):.3f} degrees, {free:.3f} without it, "
                       f"{deg('orthogonal one pass'):.3f} for one orthogonal pass through the prior")
        if trust.factor > 1:
            helps = "helps" if trust.tilt <= found["perspective"].tilt else "is the likelier choice"
            reasons.append(f"the prior seems {trust.factor:.0f} times less accurate than it says; it still {helps}, "
                           f"with an expected tilt error of {np.degrees(trust.tilt):.3f} degrees")
        if share > 0.5:
            reasons.append(f"the tilt comes from the prior, not from this image ({share:.0%} of it)")
        if deg("orthogonal one pass") < free:
            reasons.append("one orthogonal pass would beat the perspective model without the prior, "
                           "but not the perspective model with it")
        return "perspective with prior", reasons
    if trust is not None:
        rarity = f"once in {1 / trust.rarity:.0f} times" if trust.rarity > 1e-9 else "less than once in a billion times"
        if trust.rarity < 0.05:
            reasons.append(f"the prior contradicts the image (an honest one would do so {rarity}): "
                           "its sigmas are too small or it belongs to another image; it is not used")
        else:
            reasons.append(f"the prior is not used: it would gain little ({deg('perspective with prior'):.3f} degrees instead of "
                           f"{free:.3f}) and cost more if its sigmas are too small, which the image cannot rule out")
    if not free <= UNDETERMINED_DEG:
        reasons.append(f"this control does not determine the tilt ({free:.1f} degrees): register locally (similarity, affine, "
                       "homography) and claim no exterior orientation")
        return "local registration", reasons
    if d is not None and d < AMBIGUOUS:
        reasons.append(f"two solutions cannot be told apart (D = {d:.1f} below {AMBIGUOUS:.0f}): compare both, "
                       "or add control out of the plane")
    radius, iterated = found["orthogonal iterated"].remarks["spectral_radius"], deg("orthogonal iterated")
    reasons.append(f"predicted tilt error {free:.3f} degrees; the perspective adjustment uses the same control best "
                   "(Gauss-Markov)")
    if radius < 0.3 and iterated <= 1.05 * free:
        reasons.append(f"the iterated orthogonal model is an equivalent fast choice here ({iterated:.3f} degrees, "
                       f"spectral radius {radius:.2f})")
    elif radius >= 1:
        reasons.append(f"the orthogonal iteration would run away (spectral radius {radius:.2f})")
    else:
        reasons.append(f"the iterated orthogonal model would lose precision ({iterated:.3f} degrees, "
                       f"spectral radius {radius:.2f})")
    return "perspective", reasons
