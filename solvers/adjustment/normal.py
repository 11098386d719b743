"""Normal equations: dense ones here; a Schur complement is another class with the same three members."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np


class Normal(Protocol):
    """What the engine asks of normal equations N dx = g, whoever stores them."""

    @property
    def gradient(self) -> np.ndarray:
        """(u,) g = J^T P v."""
        ...

    @property
    def scale(self) -> np.ndarray:
        """(u,) square roots of N's diagonal: one standard deviation of each parameter, all others fixed, is 1 / scale."""
        ...

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """(u,) dx and (k,) Lagrange multipliers; NaN where the equations are singular."""
        ...


@dataclass(frozen=True)
class Dense:
    """N (u, u), g (u,) with, if there are constraints H dx = w, H (k, u) and w (k,): Helmert's bordered system

        | N  H^T | | dx |   | g |
        | H   0  | |  k | = | w |

    Reference: Mikhail 1970, "Parameters constraints in least squares"; docs/formulas.md 3.3.
    """

    n: np.ndarray
    gradient: np.ndarray
    h: np.ndarray | None = None
    w: np.ndarray | None = None

    scale: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        diagonal = np.diag(self.n)
        floor = max(float(diagonal.max(initial=0.0)) * 1e-24, np.finfo(float).tiny)
        object.__setattr__(self, "scale", np.sqrt(np.maximum(diagonal, floor)))

    @cached_property
    def scaled(self) -> np.ndarray:
        """N with a unit diagonal: parameters of any unit weigh alike."""
        return self.n / self.scale / self.scale[:, None]

    @cached_property
    def condition(self) -> float:
        """Condition number of `scaled`."""
        return float(np.linalg.cond(self.scaled))

    @cached_property
    def _border(self) -> tuple[np.ndarray, np.ndarray]:
        """H and w in scaled parameters, rows of unit length."""
        u = len(self.gradient)
        if self.h is None or self.w is None:
            return np.zeros((0, u)), np.zeros(0)
        h = self.h / self.scale
        length = np.linalg.norm(h, axis=1)
        return h / length[:, None], self.w / length

    def _bordered(self, damping: float) -> np.ndarray:
        h, _ = self._border
        k, u = h.shape
        b = np.zeros((u + k, u + k))
        b[:u, :u] = self.scaled
        b[:u, :u].flat[:: u + 1] += damping
        b[u:, :u] = h
        b[:u, u:] = h.T
        return b

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        _, w = self._border
        u = len(self.gradient)
        try:
            solution = np.linalg.solve(self._bordered(damping), np.concatenate([self.gradient / self.scale, w]))
        except np.linalg.LinAlgError:
            return np.full(u, np.nan), np.full(len(w), np.nan)
        return solution[:u] / self.scale, solution[u:]

    def covariance(self) -> np.ndarray:
        """(u, u) cofactor matrix: the upper left block of the inverse bordered matrix (of N where nothing constrains).

        Raises numpy.linalg.LinAlgError where the matrix is singular to working precision.
        """
        u = len(self.gradient)
        bordered = self._bordered(0.0)
        if (self.condition if self.h is None else np.linalg.cond(bordered)) > 1e15:
            raise np.linalg.LinAlgError("singular normal matrix")
        q = np.linalg.inv(bordered)[:u, :u]
        q = q / self.scale / self.scale[:, None]
        return (q + q.T) / 2
