"""What a blunder could do unseen: external reliability and the chi-square test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .precision import BAARDA_DELTA0, Linear, Precision


@dataclass(frozen=True)
class ChiSquare:
    """Test of sigma0: statistic, degrees of freedom and the probability of a larger statistic when the sigmas are right."""

    statistic: float
    dof: int
    probability: float


def chi_square(cost: float, dof: int) -> ChiSquare | None:
    """Global test of an adjustment with given sigmas; None without redundancy."""
    if dof < 1:
        return None
    from scipy.special import gammaincc

    return ChiSquare(2 * cost, dof, float(gammaincc(dof / 2, cost)))


def external(linear: Linear, stats: Precision) -> np.ndarray:
    """(n, b, u) change of every parameter that a just undetectable blunder in each observation would cause.

    The blunder is `stats.detectable` (Baarda, 0.1 %, power 80 %); inf where an observation is not checked.
    Reference: Baarda 1968; Förstner 1987.
    """
    gain = stats.covariance @ np.swapaxes(linear.j, 1, 2) @ linear.p  # (n, u, b): d parameters / d observations
    with np.errstate(invalid="ignore"):
        effect = np.swapaxes(gain, 1, 2) * stats.detectable[:, :, None]
    return np.where(np.isfinite(stats.detectable)[:, :, None], effect, np.inf)


def correlation(covariance: np.ndarray) -> np.ndarray:
    """(u, u) correlation matrix of a covariance matrix."""
    sd = np.sqrt(np.diag(covariance))
    return covariance / np.outer(sd, sd)


__all__ = ["BAARDA_DELTA0", "ChiSquare", "chi_square", "correlation", "external"]
