"""Normal equations of a block with its object points eliminated: the Schur complement as one more kind of `Normal`.

    | U  B  W |   images (m nodes of 6), a few shared unknowns (the border, interior orientations), points (3 by 3 blocks)
    | .  C  D |
    | .  .  V |   ->   S = U - W V^-1 W^T ... , block-sparse where images share points, with a dense border

Who owns the points says how to eliminate them and how to find them again; this module knows no camera.

Reference: Brown 1958; Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .fronts import Factor, Indefinite, Pattern, alone


@dataclass(frozen=True)
class Reduced:
    """The reduced system. blocks (b, s, s) of `pattern`, border (n, k), corner (k, k), right side of images g (n,) and of the
    border h (k,), where n = nodes times s. definite: whether it should be positive definite."""

    pattern: Pattern
    blocks: np.ndarray
    border: np.ndarray
    corner: np.ndarray
    g: np.ndarray
    h: np.ndarray
    definite: bool = True

    @cached_property
    def factor(self) -> Factor:
        """Raises numpy.linalg.LinAlgError where S is not positive definite, or singular."""
        return (Factor if self.definite else Indefinite)(self.pattern, self.blocks)

    @cached_property
    def _both(self) -> np.ndarray:
        """(n, k + 1) S^-1 of the border and of the right side, in one pass."""
        return self.factor.solve(np.column_stack([self.border, self.g]))

    @cached_property
    def _border(self) -> tuple[np.ndarray, np.ndarray]:
        """S^-1 border, and the inverse of corner - border^T S^-1 border."""
        y = self._both[:, :self.border.shape[1]]
        with alone():
            k = self.corner - self.border.T @ y
            k = (k + k.T) / 2
            if self.definite:
                np.linalg.cholesky(k)  # refuses what is not positive definite
            return y, np.linalg.inv(k)

    def solve(self, g: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns of the images (n, r) and of the border (k, r) for right sides of the same shapes (g itself: its one column).

        Raises numpy.linalg.LinAlgError where the system is singular.
        """
        y, inverse = self._border
        x = self._both[:, -1:] if g is self.g else self.factor.solve(g)
        with alone():
            shared = inverse @ (h - self.border.T @ x)
            return x - y @ shared, shared

    def inverse(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The inverse where S is stored: blocks (b, s, s), image-border (n, k) and border (k, k)."""
        y, inverse = self._border
        blocks = self.factor.selected_inverse()
        if y.shape[1]:
            s = self.pattern.size
            rows = y.reshape(-1, s, y.shape[1])
            blocks += (rows @ inverse)[self.pattern.row] @ np.swapaxes(rows[self.pattern.column], 1, 2)
        return blocks, -y @ inverse, inverse


@dataclass(frozen=True)
class Schur:
    """Normal equations whose points are eliminated anew for every damping.

    reduce(damping) gives the reduced system; expand(dx_images (n,), dx_border (k,), damping) the points' step.
    """

    gradient: np.ndarray
    scale: np.ndarray
    reduce: Callable[[float], Reduced]
    expand: Callable[[np.ndarray, np.ndarray, float], np.ndarray]

    def step(self, damping: float) -> tuple[np.ndarray, np.ndarray]:
        reduced = self.reduce(damping)
        try:
            images, shared = reduced.solve(reduced.g, reduced.h[:, None])
        except np.linalg.LinAlgError:
            return np.full(len(self.gradient), np.nan), np.zeros(0)
        dx = np.concatenate([images[:, 0], shared[:, 0], self.expand(images[:, 0], shared[:, 0], damping)])
        return dx, np.zeros(0)


__all__ = ["Factor", "Indefinite", "Pattern", "Reduced", "Schur"]
