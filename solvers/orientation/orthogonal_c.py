"""The orthogonal model with unknown principal distance: equations (15) and (16) of Ono & Hattori 2002, corrected.

The printed column is the partial derivative with the camera's height held; the iteration needs the total one, through
Z_C = Zmean + m33 c / s (docs/formulas.md 3.8): with the partial alone it takes tens of iterations or runs away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..adjustment import Dense, Linear
from ..cameras import Interior, project_derivatives
from ..geometry import Exterior
from .orthogonal import Orthogonal


def by_principal_distance(model: Orthogonal, exterior: Exterior, total: bool = True) -> np.ndarray:
    """(n, 2) d x_a / d c, no unit, of the transformation at an orientation; `total` lets the camera's distance follow c.

    For a bundle that is not re-centred, whose photo coordinates do not depend on c.
    """
    c, m, x, s = model.interior.c, exterior.m, model.virtual, model.scale_of(exterior)
    if model.form == "depth":
        ahead = (model.mean - model.points) @ m[2]  # depth beyond the centroid, m
        return x * (-s * ahead / c**2 if total else np.zeros(len(x)))[:, None]
    q, h = x @ m[:2, 2], model.mean[2] - exterior.centre[2]
    partial = (model.points[:, 2] - exterior.centre[2]) / h * -m[2, 2] * q / (q - m[2, 2] * c) ** 2
    through_height = (model.points[:, 2] - model.mean[2]) * s / (m[2, 2] * c**2) * m[2, 2] * c / (m[2, 2] * c - q)
    return x * (partial + through_height if total else partial)[:, None]


@dataclass(frozen=True)
class OrthogonalFreeC:
    """Orthogonal resection with the principal distance unknown: x = X, Y, Z, m11 .. m33, A1 .. A8, c.

    model: the adjustment with a first value of c, its bundle not re-centred, iterated. total: use the total derivative.
    """

    model: Orthogonal
    total: bool = True

    @property
    def dof(self) -> int:
        return self.model.dof - 1

    def at(self, x: np.ndarray) -> Orthogonal:
        """The adjustment at the principal distance of x."""
        return replace(self.model, interior=replace(self.model.interior, c=float(x[20])))

    def interior_at(self, x: np.ndarray) -> Interior:
        return self.at(x).interior

    def linear(self, x: np.ndarray) -> Linear:
        model, exterior = self.at(x), Exterior.from_vector(x)
        fixed = model.linear(x[:20])
        _, t = model.transform(exterior)
        column = -np.linalg.inv(t) @ by_principal_distance(model, exterior, self.total)[:, :, None]
        h = None if fixed.h is None else np.hstack([fixed.h, np.zeros((2, 1))])
        return Linear(fixed.v, np.concatenate([fixed.j, column], axis=2), fixed.p, h, fixed.w)

    def cost(self, x: np.ndarray) -> float:
        return self.at(x).cost(x[:20]) if np.isfinite(x).all() and x[20] > 0 else float("inf")

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return self.model.constraints(x)

    def normal(self, x: np.ndarray) -> Dense:
        return self.linear(x).normal()

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        c = max(float(x[20] + dx[8]), 1e-3 * float(x[20]))  # a principal distance stays positive
        return np.append(self.at(np.append(x[:20], c)).start(x[12:20] + dx[:8]), c)

    def covariance(self, x: np.ndarray) -> np.ndarray:
        """(7, 7) covariance of (centre [m], left rotation vector [rad], c [mm]) at the fixed point x.

        The fixed point makes G^T P v = 0, with G the derivatives of the orthogonal and v the residuals of the perspective
        model: a sandwich, not the inverse of a normal matrix.
        """
        model, exterior = self.at(x), Exterior.from_vector(x)
        jg, _, p = model.models(exterior)
        g = np.concatenate([jg, self.linear(x).j[:, :, 8:]], axis=2)
        at = project_derivatives(model.interior, exterior, model.points)
        jp = np.concatenate([at.centre, at.rotation, at.interior[:, :, :1]], axis=2)
        pg = p @ g
        meat = np.einsum("nai,nab,nbj->ij", pg, model.sigma, pg)
        bread = np.linalg.inv(np.einsum("nai,naj->ij", pg, jp))
        return bread @ meat @ bread.T
