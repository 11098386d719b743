"""What an adjustment leaves behind: one row per iteration, read by viewer, rerun, report and plots alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

CONVERGED = ("step", "gradient", "cost")
"""Stop reasons that mean success; the others are "max_iterations", "diverged" and "stopped" (by a person)."""

LARGE = 300_000
"""Numbers of an x from which the rows between the first and the last are kept thin."""

SCALARS = ("cost", "sigma0", "step", "gradient", "damping", "trials")


@dataclass(frozen=True)
class Iteration:
    """One row. Row 0 is the start; only the last row has a stop reason.

    x: parameters as the problem stores them. cost: half the weighted sum of squares. sigma0: a posteriori, relative to
    the given sigmas, NaN without redundancy. step: length of the step that led here, in standard deviations (NaN in row
    0). gradient: largest element of the scaled gradient. damping: Levenberg-Marquardt lambda of the accepted step.
    trials: proposals it took.
    """

    index: int
    x: np.ndarray
    cost: float
    sigma0: float
    step: float
    gradient: float
    damping: float
    trials: int
    stop: str | None = None


def thin(row: Iteration) -> Iteration:
    """The row as it is kept while others follow it: a large x in single precision (0.1 mm in a kilometre), but that of row 0."""
    return row if row.index == 0 or len(row.x) < LARGE else replace(row, x=row.x.astype(np.float32))


@dataclass(frozen=True)
class Trace:
    """All rows of one adjustment and, in `manifest`, what it was: problem, names, units, options (JSON-able values)."""

    rows: tuple[Iteration, ...]
    manifest: Mapping[str, Any] = field(default_factory=dict)

    @property
    def last(self) -> Iteration:
        return self.rows[-1]

    @property
    def converged(self) -> bool:
        return self.last.stop in CONVERGED

    @property
    def iterations(self) -> int:
        return self.last.index

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> np.ndarray:
        """(rows,) one of `SCALARS`, or (rows, u) for "x"."""
        return np.array([getattr(row, name) for row in self.rows])
