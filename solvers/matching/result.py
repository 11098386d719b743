"""What a match can come to: found, or the reason why not."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np


class Status(IntEnum):
    """Outcome of one match; the numbers are those of the compiled kernels."""

    OK = 0
    NO_TEXTURE = 1
    EDGE_ONLY = 2
    OUTSIDE = 3
    LEFT = 4
    DIVERGED = 5
    NOT_CONVERGED = 6
    LOW_SCORE = 7
    UNCERTAIN = 8
    NOT_UNIQUE = 9
    AT_BORDER = 10

    @property
    def reason(self) -> str:
        """In words, for a person."""
        return _REASONS[self]


_REASONS = {
    Status.OK: "found",
    Status.NO_TEXTURE: "the window has no texture that stands out of its noise",
    Status.EDGE_ONLY: "the window holds an edge only: its position along the edge is not determined",
    Status.OUTSIDE: "the template window leaves the image or its data",
    Status.LEFT: "the search left the other image or its data",
    Status.DIVERGED: "the window moved or changed its shape too far from the start",
    Status.NOT_CONVERGED: "the iterations ended before the position came to rest",
    Status.LOW_SCORE: "the correlation is below the threshold",
    Status.UNCERTAIN: "the standard deviation of the position is above the limit",
    Status.NOT_UNIQUE: "another place in the search window fits about as well",
    Status.AT_BORDER: "the best correlation lies at the border of the search window: enlarge it",
}


@dataclass(frozen=True)
class LsmResult:
    """Least squares matches of N points. pixel (N, 2) col, row in the target image, NaN where not found;
    sigma (N, 2) px and covariance (N, 2, 2) px^2, from the noise left in the residuals; score (N,) correlation after the
    adjustment; status (N,) `Status`; shape (N, 2, 2) template -> target offsets; radiometric (N, 2) r0, r1 of
    f = r0 + (1 + r1) g; noise (N,) grey values of the difference; iterations (N,); kept (N,) how many of the six geometric
    parameters were adjusted, free (N, 6) which: position and shaping by u, v of col, the same of row, in the template's axes."""

    pixel: np.ndarray
    sigma: np.ndarray
    covariance: np.ndarray
    score: np.ndarray
    status: np.ndarray
    shape: np.ndarray
    radiometric: np.ndarray
    noise: np.ndarray
    iterations: np.ndarray
    kept: np.ndarray
    free: np.ndarray

    @property
    def ok(self) -> np.ndarray:
        """(N,) found."""
        return self.status == Status.OK


@dataclass(frozen=True)
class NccResult:
    """Correlation matches of N points. pixel (N, 2) col, row of the highest peak (sub-pixel), NaN where not found;
    score (N,) its correlation; count (N,) of rivals, other peaks above three quarters of it in the search window; rival
    (N, 5, 2) and rival_score (N, 5) the best of them, NaN where there are fewer; status (N,) `Status`; peak (N, 2): as pixel, but
    also where it is refused."""

    pixel: np.ndarray
    score: np.ndarray
    count: np.ndarray
    rival: np.ndarray
    rival_score: np.ndarray
    status: np.ndarray
    peak: np.ndarray

    @property
    def uniqueness(self) -> np.ndarray:
        """(N,) second score over best where it is above three quarters, else 0: near 1 the place is not unique."""
        return np.nan_to_num(self.rival_score[:, 0]) / self.score

    @property
    def ok(self) -> np.ndarray:
        """(N,) found."""
        return self.status == Status.OK
