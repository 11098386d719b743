"""Resection: exterior orientation of one image by the perspective (collinearity) model, as a problem of the engine."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..adjustment import Dense, Linear
from ..cameras import PARAMETERS, Interior, project, project_derivatives
from ..errors import BadProject
from ..geometry import Exterior, exp, log, skew

COLUMNS = ("X", "Y", "Z", *(f"m{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)))
UNITS = ("m", "m", "m", *(9 * ("1",)))


@dataclass(frozen=True)
class PriorOrientation:
    """A weighted approximate orientation: exterior, and root (6, 6), a square root of its inverse covariance."""

    exterior: Exterior
    root: np.ndarray

    @classmethod
    def of(cls, exterior: Exterior, covariance: np.ndarray) -> PriorOrientation:
        """covariance (6, 6) of (centre [m], left rotation vector [rad]); infinite variances mean unknown."""
        known = np.isfinite(np.diag(covariance))
        root = np.zeros((6, 6))
        root[np.ix_(known, known)] = np.linalg.cholesky(np.linalg.inv(covariance[np.ix_(known, known)])).T
        return cls(exterior, root)

    def misclosure(self, exterior: Exterior) -> np.ndarray:
        """(6,) prior minus current: centre [m] and rotation vector [rad]."""
        return np.concatenate([self.exterior.centre - exterior.centre, log(self.exterior.m @ exterior.m.T)])

    def derivatives(self, exterior: Exterior) -> np.ndarray:
        """(6, 6) minus d misclosure / d (centre, left rotation vector): log(exp(r) exp(-d)) = r - J d, J the inverse of
        the right Jacobian of the rotations at r."""
        out = np.eye(6)
        r = self.misclosure(exterior)[3:]
        k, theta = skew(r), float(np.linalg.norm(r))
        curve = 1 / 12 if theta < 1e-3 else (1 - theta / 2 / np.tan(theta / 2)) / theta**2
        out[3:, 3:] += k / 2 + curve * (k @ k)
        return out

    @property
    def count(self) -> int:
        """How many of the six elements are observed."""
        return int((np.abs(self.root).sum(axis=1) > 0).sum())


@dataclass(frozen=True)
class Resection:
    """Perspective resection: x = X, Y, Z, m11 .. m33 and the freed interior parameters; the tangent is the change of the
    centre [m], the left rotation vector [rad] and the changes of the freed parameters.

    points (n, 3) m, pixels (n, 2), weights (n, 2, 2) px^-2. Reference: docs/formulas.md 2.
    """

    interior: Interior
    points: np.ndarray
    pixels: np.ndarray
    weights: np.ndarray
    free: tuple[str, ...] = ()
    prior: PriorOrientation | None = None
    _free_index: tuple[int, ...] = field(init=False, repr=False, default=())

    def __post_init__(self) -> None:
        for name in self.free:
            if name not in PARAMETERS:
                raise BadProject(f"'{name}' is not an interior orientation parameter; choose from {', '.join(PARAMETERS)}")
        object.__setattr__(self, "_free_index", tuple(PARAMETERS.index(n) for n in self.free))

    @property
    def dof(self) -> int:
        return 2 * len(self.points) + (self.prior.count if self.prior else 0) - 6 - len(self.free)

    def start(self, exterior: Exterior) -> np.ndarray:
        """x at an exterior orientation and the given interior orientation."""
        return np.concatenate([exterior.vector, [getattr(self.interior, n) for n in self.free]])

    def interior_at(self, x: np.ndarray) -> Interior:
        if not self.free:
            return self.interior
        return replace(self.interior, **dict(zip(self.free, map(float, x[12:]), strict=True)))

    def cost(self, x: np.ndarray) -> float:
        if self.free and "c" in self.free and x[12 + self.free.index("c")] <= 0:
            return float("inf")
        exterior = Exterior.from_vector(x)
        v = self.pixels - project(self.interior_at(x), exterior, self.points)
        cost = 0.5 * float(np.einsum("na,nab,nb->", v, self.weights, v))
        if self.prior is not None:
            cost += 0.5 * float(((self.prior.root @ self.prior.misclosure(exterior)) ** 2).sum())
        return cost

    def constraints(self, x: np.ndarray) -> np.ndarray:
        return np.zeros(0)

    def linear(self, x: np.ndarray) -> Linear:
        """Residuals, derivatives and weights at x; a prior joins as three whitened pairs behind the points."""
        exterior = Exterior.from_vector(x)
        at = project_derivatives(self.interior_at(x), exterior, self.points)
        j = np.concatenate([at.centre, at.rotation, *([at.interior[:, :, self._free_index]] if self.free else [])], axis=2)
        v, p = self.pixels - at.pixels, self.weights
        if self.prior is not None:
            rows = np.zeros((3, 2, j.shape[2]))
            rows[:, :, :6] = (self.prior.root @ self.prior.derivatives(exterior)).reshape(3, 2, 6)
            j = np.concatenate([j, rows])
            v = np.concatenate([v, (self.prior.root @ self.prior.misclosure(exterior)).reshape(3, 2)])
            p = np.concatenate([p, np.broadcast_to(np.eye(2), (3, 2, 2))])
        return Linear(v, j, p)

    def normal(self, x: np.ndarray) -> Dense:
        return self.linear(x).normal()

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        m = exp(dx[3:6]) @ x[3:12].reshape(3, 3)
        return np.concatenate([x[:3] + dx[:3], m.ravel(), x[12:] + dx[6:]])
