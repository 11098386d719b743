"""The Matching tab's part of the state: two photos, what is asked, what was found; frozen values, no truth elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from solvers import Block, Exterior
from solvers.matching import Stepped
from solvers.workflows_conjugate import Guess

SIDES = ("left", "right")
COLOURS = ("number of rays", "residual", "none")
ASPECT = 0.8
"""Height over width of a photo pane."""


@dataclass(frozen=True)
class Look:
    """What a pane shows of its photo: its middle, pixels of the full photo, and how many of them it is wide."""

    col: float
    row: float
    across: float


@dataclass(frozen=True)
class Ask:
    """One match that is wanted. at, start: col, row, pixels of the full photos; start None: predicted; point None: a new tie
    point; search 0: as far as the prediction is uncertain."""

    serial: int
    first: str
    second: str
    at: tuple[float, float]
    start: tuple[float, float] | None
    point: str | None
    window: int
    search: int
    threshold: float


@dataclass(frozen=True, eq=False)
class Found:
    """What came of it. guess, pixel, sigma (2,) are in pixels of the full photo, stepped in those of the windows read from the
    files, whose first pixel is `corner` (2,) of the second file; factor (2,): full pixels per file pixel. error: why nothing was
    done, else ""."""

    ask: Ask
    guess: Guess | None = None
    stepped: Stepped | None = None
    corner: np.ndarray = field(default_factory=lambda: np.zeros(2))
    factor: np.ndarray = field(default_factory=lambda: np.ones(2))
    error: str = ""

    @property
    def ok(self) -> bool:
        return self.stepped is not None and bool(self.stepped.lsm.ok[0])

    @property
    def pixel(self) -> np.ndarray | None:
        """Where the point is in the second photo; None where it was refused."""
        return self.full(self.stepped.lsm.pixel[0]) if self.stepped is not None and self.ok else None

    @property
    def sigma(self) -> np.ndarray | None:
        return self.stepped.lsm.sigma[0] * self.factor if self.stepped is not None and self.ok else None

    @property
    def why(self) -> str:
        """Why it was refused, in words; "" when it was found."""
        return self.error or ("" if self.stepped is None or self.ok else self.stepped.status.reason)

    def full(self, window_pixel: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of the full second photo from those of the window read."""
        return (window_pixel + self.corner + 0.5) * self.factor - 0.5


@dataclass(frozen=True, eq=False)
class Network:
    """Tie points as a bundle places them: names, xyz (n, 3) m local, rms (n,) px of each point's residuals; exteriors: local, by
    image. words: what to know; block: of which it was adjusted."""

    names: tuple[str, ...]
    xyz: np.ndarray
    rms: np.ndarray
    exteriors: Mapping[str, Exterior]
    words: str
    block: Block


@dataclass(frozen=True, eq=False)
class Matching:
    """Images left and right ("" until chosen), what is matched and how. at: the template's place; asked: what is still to be
    done, found: what was, `shown` the one in view; row: of its iterations. task: long work that is wanted ("ties", "adjust")."""

    first: str = ""
    second: str = ""
    looks: Mapping[str, Look] = field(default_factory=dict)
    point: str | None = None
    at: tuple[float, float] | None = None
    start: tuple[float, float] | None = None
    window: int = 21
    search: int = 0
    threshold: float = 0.6
    serial: int = 0
    asked: tuple[Ask, ...] = ()
    found: tuple[Found, ...] = ()
    shown: int = 0
    row: int = 0
    colour: str = COLOURS[0]
    task: str = ""
    progress: str = ""
    network: Network | None = None
    read: int = 0  # sharper pictures that have come
    message: str = ""

    @property
    def current(self) -> Found | None:
        """The match in view."""
        return self.found[self.shown] if self.shown < len(self.found) else None

    @property
    def last_row(self) -> int:
        now = self.current
        return 0 if now is None or now.stepped is None else max(len(now.stepped.rows) - 1, 0)

    def image(self, side: str) -> str:
        return self.first if side == "left" else self.second
