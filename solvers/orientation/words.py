"""Statistics said in words a surveyor can act on."""

from __future__ import annotations

import numpy as np

from .resection import Resection
from .steps import costs

ORDER = ("X", "Y", "Z", "omega", "phi", "kappa")
MEANING = {
    ("Y", "omega"): "a tilt across looks like a shift of the camera",
    ("X", "phi"): "a tilt along looks like a shift of the camera",
    ("X", "omega"): "a tilt looks like a shift of the camera",
    ("Y", "phi"): "a tilt looks like a shift of the camera",
}


def bad_fit(cost: float, dof: int) -> list[str]:
    """The chi-square test of sigma0 at 0.1 % (two-sided): residuals against the given sigmas."""
    if dof < 1:
        return []
    from scipy.special import gammainc, gammaincc

    upper, lower = float(gammaincc(dof / 2, cost)), float(gammainc(dof / 2, cost))
    sigma0 = np.sqrt(2 * cost / dof)
    if upper < 0.0005:
        return [f"bad fit: sigma0 = {sigma0:.2f}, residuals larger than the given sigmas allow (chi-square test, 0.1 %): "
                "look for blunders, uncorrected distortion or too small sigmas"]
    if lower < 0.0005:
        return [f"suspiciously good fit: sigma0 = {sigma0:.2f}, residuals much smaller than the given sigmas (chi-square test, "
                "0.1 %): the sigmas are probably too large"]
    return []


def correlations(covariance: np.ndarray, full: np.ndarray, problem: object) -> list[str]:
    """Pairs of orientation elements that this image cannot separate: |correlation| above 0.99."""
    sd = np.sqrt(np.diag(covariance))
    if not np.isfinite(sd).all() or (sd <= 0).any():
        return []
    r = covariance / np.outer(sd, sd)
    out = []
    for i in range(6):
        for j in range(i + 1, 6):
            if abs(r[i, j]) > 0.99:
                meaning = MEANING.get((ORDER[i], ORDER[j]), "the two are hardly separable")
                out.append(f"{ORDER[j]} and {ORDER[i]} are correlated by {_shown(r[i, j])}: {meaning}")
    free = getattr(problem, "free", ())
    if free:
        sd = np.sqrt(np.diag(full))
        r = full / np.outer(sd, sd)
        for k, name in enumerate(free):
            for i, other in enumerate((*ORDER, *free[:k])):
                if i < 6 + k and abs(r[6 + k, i]) > 0.99:
                    out.append(f"{name} and {other if i >= 6 else ('X', 'Y', 'Z', 'rotation 1', 'rotation 2', 'rotation 3')[i]} "
                               f"are correlated by {_shown(r[6 + k, i])}: the two are hardly separable")
    return out


def snooping(w: np.ndarray, names: tuple[str, ...]) -> list[str]:
    """Baarda's data snooping: the largest standardized residual, tested at 1 % over all observations together."""
    from scipy.special import ndtri

    if not len(w):
        return []
    size = np.abs(np.where(np.isfinite(w), w, 0.0))
    i, axis = np.unravel_index(int(size.argmax()), size.shape)
    limit = float(-ndtri(0.005 / max(int(np.isfinite(w).sum()), 1)))
    if size[i, axis] <= limit:
        return []
    return [f"data snooping: point {names[i]} has a standardized residual of {size[i, axis]:.1f} in {('col', 'row')[axis]} "
            f"(limit {limit:.1f}): check its measurement and coordinates, or use the robust start"]


def undetermined(covariance: np.ndarray) -> list[str]:
    """Whether this image determines its tilt at all (docs/formulas.md 5: 2 degrees)."""
    tilt = float(np.degrees(np.sqrt(covariance[3, 3] + covariance[4, 4])))
    if not np.isfinite(tilt) or tilt > 2:
        return [f"the tilt is not determined by this control (standard error {tilt:.1f} degrees): "
                "use the orientation only inside the control"]
    return []


def curved(problem: Resection, x: np.ndarray, covariance: np.ndarray) -> list[str]:
    """Whether the error region is far from an ellipsoid: on the 3-sigma points of the two longest rotations the sum of squares
    ought to rise by 9. covariance (6, 6): of the tangent (centre, left rotation vector)."""
    values, vectors = np.linalg.eigh(covariance[3:, 3:])
    if not values[2] > np.radians(0.2) ** 2:
        return []
    places = [x]
    for axis in (2, 1):
        for sign in (3.0, -3.0):
            step = np.zeros(len(x) - 6)
            step[:6] = sign * covariance[:, 3:] @ vectors[:, axis] / np.sqrt(values[axis])
            places.append(problem.retract(x, step))
    least, *around = costs(problem, places)
    if not all(0.4 < 2 * (cost - least) / 9 < 2.5 for cost in around):
        return ["the error region is not an ellipsoid (the geometry is too weak for linear error theory): the standard "
                "errors are a rough guide, the true orientation can lie several of them away"]
    return []


def _shown(r: float) -> str:
    """A correlation near 1 with digits that still tell something: -0.998, 0.99987."""
    digits = int(min(6, max(3, np.ceil(-np.log10(max(1 - abs(r), 1e-6))) + 1)))
    return f"{np.sign(r) * min(abs(r), 1 - 10.0**-digits):.{digits}f}"
