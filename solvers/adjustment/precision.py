"""Covariance, sigma0 and reliability of an adjusted problem whose observations come in small correlated blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import DegenerateGeometry
from .normal import Dense

BAARDA_DELTA0 = 4.13
"""Non-centrality for a two-sided test at 0.1 % with a power of 80 % (Baarda 1968)."""


@dataclass(frozen=True)
class Linear:
    """A linearised problem. v (n, b) residuals observed minus computed; j (n, b, u) derivatives of the computed values;
    p (n, b, b) weights, the inverse a-priori covariance of each block; h (k, u) constraints."""

    v: np.ndarray
    j: np.ndarray
    p: np.ndarray
    h: np.ndarray | None = None
    w: np.ndarray | None = None

    @property
    def cost(self) -> float:
        return 0.5 * float(np.einsum("na,nab,nb->", self.v, self.p, self.v))

    def normal(self) -> Dense:
        """Normal equations N = J^T P J, g = J^T P v, bordered where there are constraints."""
        pj = self.p @ self.j
        u = self.j.shape[2]
        flat = self.j.reshape(-1, u)
        n = flat.T @ pj.reshape(-1, u)
        g = pj.reshape(-1, u).T @ self.v.ravel()
        return Dense((n + n.T) / 2, g, self.h, self.w)


@dataclass(frozen=True)
class Precision:
    """How sure an adjustment is, a priori: with the given weights. Multiply sigmas by sigma0 to scale by the fit.

    sigma0: a posteriori, relative to the given sigmas; None without redundancy. dof: redundancy.
    covariance (u, u). redundancy (n, b): redundancy number of each observation, 0..1 for uncorrelated blocks; they sum
    to dof. w (n, b): standardized residuals (Baarda), NaN where an observation is not checked by any other.
    detectable (n, b): minimal detectable blunder, in the observation's unit, inf where unchecked.
    condition: of the scaled normal matrix.
    """

    sigma0: float | None
    dof: int
    covariance: np.ndarray
    redundancy: np.ndarray
    w: np.ndarray
    detectable: np.ndarray
    condition: float


def precision(linear: Linear, what: str = "the adjustment") -> Precision:
    """Precision of a linearised problem at its solution.

    Raises DegenerateGeometry when the normal matrix (with its constraints) is singular.
    Reference: Förstner 1987, "Reliability analysis of parameter estimation in linear models".
    """
    normal = linear.normal()
    try:
        q = normal.covariance()
    except np.linalg.LinAlgError:
        raise DegenerateGeometry(f"{what} is singular: the observations do not determine every unknown; "
                                 "add or spread control") from None
    n, b, u = linear.j.shape
    dof = n * b - u + (0 if linear.h is None else len(linear.h))
    eye = np.eye(b)
    computed = linear.j @ q @ np.swapaxes(linear.j, 1, 2)  # covariance of the computed values, block by block
    r = eye - computed @ linear.p
    redundancy = np.einsum("naa->na", r)
    pqp = np.einsum("naa->na", linear.p @ r)  # diagonal of P Qv P
    pv = (linear.p @ linear.v[..., None])[..., 0]
    checked = pqp > 1e-9 * np.einsum("naa->na", linear.p)
    root = np.sqrt(np.where(checked, pqp, 1.0))
    return Precision(
        sigma0=float(np.sqrt(2 * linear.cost / dof)) if dof > 0 else None,
        dof=dof,
        covariance=q,
        redundancy=redundancy,
        w=np.where(checked, pv / root, np.nan),
        detectable=np.where(checked, BAARDA_DELTA0 / root, np.inf),
        condition=normal.condition,
    )
