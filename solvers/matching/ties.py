"""Tie points as values: how they are asked for, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ..block import Observations, Points
from ..cameras import Interior

SIGMA_PX = 0.2
"""A-priori standard error of a tie point, px: real changes of viewpoint give 0.1 to 0.3, whatever the matching itself says."""


@dataclass(frozen=True)
class TieOptions:
    """How tie points are found."""

    feature: str = "sift"  # or orb, akaze, brisk
    count: int = 4000  # features a photo
    side: int = 2400  # px, longer side of the picture in which features are found; the refinement sees the whole photo
    equalise: bool | None = None  # contrast equalisation; None: where the texture is low
    root: bool = True  # RootSIFT
    ratio: float = 0.8  # nearest over second nearest descriptor
    neighbours: int = 12  # photos that each one is compared with
    threshold: float = 3.0  # px of that picture, off the common geometry
    least: int = 16  # matches of a pair
    window: int = 21  # px of the least squares matching, 0 leaves the features as they are
    per_photo: int = 1000  # points wanted in each photo


class TiePhoto(NamedTuple):
    """One photo: the name that the reader knows, its interior orientation and position (m, at least X, Y) where known, and a
    word that changes when the photo does (for resuming)."""

    name: str
    interior: Interior | None = None
    position: np.ndarray | None = None
    version: str = ""


class TiePair(NamedTuple):
    """Two photos that share points: their names, matches before and after the geometric verification, and its kind."""

    first: str
    second: str
    matches: int
    verified: int
    kind: str


@dataclass(frozen=True)
class Ties:
    """Tie points. observations and points as in a Block (image: index into `photos`; coordinates unknown); sizes: cols, rows
    of the photos as they were read, (0, 0) for those that failed; failed: why, by photo; groups: names of the photos that
    hang together by points, largest group first, photos without points alone."""

    photos: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    observations: Observations
    points: Points
    pairs: tuple[TiePair, ...]
    failed: dict[str, str]
    groups: tuple[tuple[str, ...], ...]

    @property
    def rays(self) -> np.ndarray:
        """(points,) photos that see each point."""
        return np.bincount(self.observations.point, minlength=len(self.points))

    @property
    def per_photo(self) -> np.ndarray:
        """(photos,) points in each photo."""
        return np.bincount(self.observations.image, minlength=len(self.photos))


class Store(Protocol):
    """Where intermediate results are kept, so that an interrupted search goes on where it was."""

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """The arrays saved under a key, None without any."""
        ...

    def save(self, key: str, arrays: dict[str, np.ndarray]) -> None:
        """Keep arrays under a key."""
        ...
