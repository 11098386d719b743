"""The Mosaic tab's part of the state: what is asked, the mosaics that came of it, what is shown of them; frozen values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solvers import Block
from solvers.geometry import Grid, LocalFrame
from solvers.mosaic import Registration
from solvers.workflows_mosaic import Offsets

from .kept import by_identity
from .state import State

METHODS = ("simultaneous", "sequential")
KINDS = ("best possible", "uncontrolled", "semicontrolled", "controlled")
MODELS = ("auto", "exterior", "adapted", "plane", "bundle")
PLANES = ("mean height", "fitted plane", "height grid")
BLENDS = ("feather", "average", "none", "multiband")
SHOWN = ("simultaneous", "sequential", "swipe", "fade")
CLICKS = ("look", "measure", "conjugate point")
EXAGGERATIONS = tuple(float(f * 10**k) for k in range(5) for f in (1, 2, 5))
NO_GRID = Grid((1, 1), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0))
PLACES = 60
"""Places measured at most."""


@dataclass(frozen=True)
class Ask:
    """How a mosaic is wanted; the words of the panel. gsd [m], 0: of the photos; dem: the height grid's file, "" for a plane."""

    method: str = METHODS[0]
    kind: str = KINDS[0]
    model: str = MODELS[0]
    plane: str = PLANES[0]
    gsd: float = 0.0
    blend: str = BLENDS[0]
    seams: bool = False
    gain: bool = False


@dataclass(frozen=True, eq=False)
class Tile:
    """A piece of a mosaic as it is shown: rgba (h, w, 4) uint8; corners (4, 3) m, local frame of its registration: top left, top
    right, bottom right, bottom left. photos, lay (k, 5, 2): those over it, and where its corners and middle lay in them [px of
    the small pictures]."""

    number: int
    rgba: np.ndarray
    corners: np.ndarray
    photos: tuple[str, ...] = ()
    lay: np.ndarray = field(default_factory=lambda: np.empty((0, 5, 2)))


@dataclass(frozen=True, eq=False)
class Made:
    """A mosaic: of which block and how asked, its registration and what judges it (`said`, the JSON of the command), points of
    known coordinates on it, the tiles so far, of how many, and the raster they are parts of (map coordinates)."""

    ask: Ask
    block: Block
    registration: Registration
    said: Mapping[str, Any]
    points: Offsets
    tiles: Mapping[int, Tile] = field(default_factory=dict)
    total: int = 0
    grid: Grid = NO_GRID
    done: bool = False
    renewed: int = 0  # tiles made by the last run

    @property
    def gsd(self) -> float:
        """Ground size of a pixel as shown [unit of the registration]."""
        return self.grid.affine[0]


@dataclass(frozen=True, eq=False)
class Layer:
    """A map or orthophoto under the mosaic: its file, its picture on the mosaic's map, and how it differs (None before that is
    known). at (k, 2), off (k, 2) m: places, and layer minus mosaic there; score (k,); words: on what came of it."""

    name: str
    tile: Tile | None = None
    at: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    off: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    score: np.ndarray = field(default_factory=lambda: np.empty(0))
    words: str = ""

    @property
    def mean(self) -> np.ndarray:
        """(2,) mean offset [m]."""
        return self.off.mean(axis=0) if len(self.off) else np.full(2, np.nan)

    @property
    def rms(self) -> float:
        """Root of the mean squared length of the offsets [m]."""
        return float(np.sqrt(np.mean((self.off**2).sum(axis=1)))) if len(self.off) else float("nan")


@dataclass(frozen=True, eq=False)
class Mosaic:
    """ask: what the controls say. wanted: the mosaics to be made, by method; made: those that are there. shown: which of them,
    how (swipe: 0..1 from the west, or how far the fade is); row: of the trace (None: the end). click: what a click on the mosaic
    means. places: measured ones (x, y), mosaic plane. under: file of the layer asked for. exaggeration 0: made to fit. busy: what
    is being written or compared. written: how many files were; wrote: what came of the last."""

    ask: Ask = Ask()
    wanted: Mapping[str, Ask] = field(default_factory=dict)
    made: Mapping[str, Made] = field(default_factory=dict)
    shown: str = METHODS[0]
    swipe: float = 0.5
    opacity: float = 1.0
    row: int | None = None
    outlines: bool = True
    thumbnails: bool = True
    drift: bool = True
    residuals: bool = True
    exaggeration: float = 0.0
    click: str = CLICKS[0]
    places: tuple[tuple[float, float], ...] = ()
    layer: Layer | None = None
    under: str = ""
    layer_shown: bool = True
    busy: tuple[str, ...] = ()
    progress: str = ""
    message: str = ""
    wrote: str = ""
    conjugate: tuple[str, float, float] | None = None
    written: int = 0

    @property
    def method(self) -> str:
        """The registration that clicks, rows and numbers are about."""
        return self.shown if self.shown in METHODS else METHODS[0] if METHODS[0] in self.made else METHODS[1]

    @property
    def current(self) -> Made | None:
        return self.made.get(self.method)

    @property
    def last_row(self) -> int:
        return 0 if self.current is None else len(self.current.registration.trace.rows) - 1

    @property
    def shown_row(self) -> int:
        return self.last_row if self.row is None else min(max(self.row, 0), self.last_row)


def block_of(state: State) -> Block:
    """The block as it is to be used: points switched off are check points, so that they judge and do not hold."""
    return _without(state.block, state.work.off) if state.work.off else state.block


@by_identity(8)
def _without(block: Block, off: frozenset[str]) -> Block:
    roles = tuple(
        "check" if n in off and r == "control" else r for n, r in zip(block.points.names, block.points.role, strict=True)
    )
    return replace(block, points=replace(block.points, role=roles))


def in_frame(frame: LocalFrame, registration: Registration, xyz: np.ndarray) -> np.ndarray:
    """(..., 3) places of a registration in metres as places of another local frame."""
    theirs = registration.frame
    if theirs.crs == frame.crs and np.array_equal(theirs.origin, frame.origin):
        return np.asarray(xyz, float)
    return frame.to_local(theirs.to_map(xyz))
