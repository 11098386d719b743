"""Composition: the mosaic tile after tile, never as a whole.

A Composition is made once (canvas, seams, tones); its jobs are small values, each of which holds all that one tile needs, so
that tiles can be made here, in threads, or on other machines, in any order, with the same result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import DegenerateGeometry
from ..geometry import Grid, Surface
from .blend import MARGIN, Blend, Layers, blended, finish, multiband, shots_of, widened
from .canvas import Canvas, canvas_of
from .gain import Tones, solve_tones
from .labels import Labels
from .lattice import COARSEST, Nets, Tile
from .placed import Placed
from .resample import Resample, Window
from .seams import graph_cut, voronoi
from .surface import Ground
from .survey import Small, bounds_of, survey_of
from .tones import PLAIN, Tone

SIDE = 1024
"""px of a tile's side."""
STRIP = 128
"""px of a tile's rows that are blended at a time: sums that a processor's cache holds."""
ReadSurface = Callable[[tuple[float, float, float, float]], Surface]
"""(west, south, east, north) -> the height grid there."""


@dataclass(frozen=True)
class ComposeOptions:
    """How photos become a mosaic. gsd [m], None: of the photos. blend: one photo a place (the nearest), mean, feathered by the
    distance from a photo's edge, or in bands. seams: places of one photo only, seams by graph cut. gain: even out exposure and
    vignetting. side: of a tile [px], a multiple of 32."""

    gsd: float | None = None
    resample: Resample = "bilinear"
    blend: Blend = "feather"
    seams: bool = False
    gain: bool = False
    side: int = SIDE


@dataclass(frozen=True)
class Job:
    """One tile and all it needs. tile: on `grid`, within it; ground: with the part of the height grid that matters."""

    index: int
    tile: Tile
    grid: Grid
    ground: Ground
    layers: Layers
    options: ComposeOptions


@dataclass(frozen=True)
class Composition:
    """What is to be composed. ground: with a plane, or (surface given) with a height grid that is read part by part."""

    photos: tuple[Placed, ...]
    ground: Ground
    canvas: Canvas
    options: ComposeOptions
    tones: tuple[Tone, ...]
    labels: Labels | None = None
    evened: Tones | None = None
    surface: ReadSurface | None = field(default=None, compare=False)

    @property
    def tiles(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        rows, columns = self.canvas.grid.shape
        return -(-rows // self.options.side), -(-columns // self.options.side)

    def tile(self, index: int) -> Tile:
        """A tile by its number, row after row from the north-west, cut at the canvas' edges."""
        i, j = divmod(index, self.tiles[1])
        (rows, columns), side = self.canvas.grid.shape, self.options.side
        return Tile(i * side, j * side, min(side, rows - i * side), min(side, columns - j * side))

    def jobs(self, done: frozenset[int] = frozenset()) -> Iterator[Job]:
        """The jobs of all tiles that photos may touch and that are not done, swept along the longer side of the canvas, so that
        a photo's tiles follow each other."""
        for index in self.order():
            if index not in done:
                yield self.job(index)

    def order(self) -> list[int]:
        """Numbers of the tiles that photos may touch, swept along the longer side of the canvas."""
        rows, columns = self.tiles
        indices = np.arange(rows * columns).reshape(rows, columns)
        swept = indices.T.ravel() if columns > rows else indices.ravel()
        return [int(k) for k in swept if self._over(self.tile(int(k))).any()]

    def job(self, index: int) -> Job:
        """The job of one tile."""
        tile = self.tile(index)
        wide = widened(tile) if self.options.blend == "multiband" else tile
        over = np.flatnonzero(self._over(wide))
        photos = tuple(self.photos[k] for k in over)
        labels = None if self.labels is None else self.labels.around(self.canvas.grid, wide)
        ground = self.ground
        if self.surface is not None:
            ground = Ground(ground.frame, self.surface(bounds_of(self.canvas.grid, wide, ground, photos)))
        layers = Layers(photos, tuple(self.tones[k] for k in over), self.canvas.feet[over], tuple(int(k) for k in over), labels)
        return Job(index, tile, self.canvas.grid, ground, layers, self.options)

    def _over(self, tile: Tile) -> np.ndarray:
        """(n,) photos whose outline's box meets a tile's."""
        a, _, west, _, e, north = self.canvas.grid.affine
        x0, x1 = west + a * (tile.left - 2), west + a * (tile.left + tile.width + 2)
        y0, y1 = north + e * (tile.top + tile.height + 2), north + e * (tile.top - 2)
        low, high = self._boxes
        return (low[:, 0] <= x1) & (high[:, 0] >= x0) & (low[:, 1] <= y1) & (high[:, 1] >= y0)

    @property
    def _boxes(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([o.min(0) for o in self.canvas.outlines]), np.array([o.max(0) for o in self.canvas.outlines])


def composition(photos: Sequence[Placed], ground: Ground, options: ComposeOptions | None = None, small: Small | None = None,
                surface: ReadSurface | None = None) -> Composition:
    """Prepare a mosaic: canvas, and where they are wanted seams and tones, from small pictures read with `small`.

    ground: a plane, or a height grid that covers the site (coarse is enough when `surface` reads it part by part).
    Raises DegenerateGeometry and Unsupported, see `canvas_of`.
    """
    options = options or ComposeOptions()
    photos = tuple(photos)
    canvas = canvas_of(photos, ground, options.gsd)
    tones, labels, evened = (PLAIN,) * len(photos), None, None
    lines = options.seams or options.blend == "multiband" or (options.blend == "none" and small is not None)
    if len(photos) > 1 and (options.gain or lines):
        if small is None:
            raise DegenerateGeometry("seams and gain need the photos themselves; give a way to read them small")
        survey = survey_of(photos, ground, canvas, small, surface)
        if options.gain:
            kinds = list(dict.fromkeys(p.interior for p in photos))
            evened = solve_tones(survey, len(photos), tuple(kinds.index(p.interior) for p in photos))
            tones = evened.tones
        if lines:
            labels = voronoi(survey)
            labels = graph_cut(survey, labels) if options.seams else labels
    return Composition(photos, ground, canvas, options, tones, labels, evened, surface)


def render(job: Job, window: Window) -> np.ndarray:
    """RGBA uint8 (h, w, 4) of a tile; alpha 0 where no photo shows anything."""
    labels, options = job.layers.labels, job.options
    step = COARSEST if labels is None else min(COARSEST, labels.factor)
    out = np.empty((job.tile.height, job.tile.width, 4), np.uint8)
    if options.blend != "multiband":
        shots = shots_of(Nets(job.grid, job.tile, job.ground, step), job.layers)
        acc = np.empty((min(STRIP, job.tile.height), job.tile.width, 4), np.float32)
        for first in range(0, job.tile.height, STRIP):
            rows = acc[:job.tile.height - first]
            blended(rows, first, shots, options.blend, window, options.resample)
            finish(rows, out[first:first + STRIP])
        return out
    wide = widened(job.tile)
    shots = shots_of(Nets(job.grid, wide, job.ground, step), job.layers)
    acc = multiband(shots, (wide.height, wide.width), window, options.resample)
    finish(np.ascontiguousarray(acc[MARGIN:MARGIN + job.tile.height, MARGIN:MARGIN + job.tile.width]), out)
    return out


def compose(photos: Sequence[Placed], ground: Ground, window: Window, options: ComposeOptions | None = None,
            small: Small | None = None) -> Iterator[tuple[Tile, np.ndarray]]:
    """The mosaic's tiles, one after the other: (tile, RGBA (h, w, 4)); see `composition` for the canvas they lie on."""
    made = composition(photos, ground, options, small)
    for job in made.jobs():
        yield job.tile, render(job, window)


def coarse(surface: Surface, most: int = 1_000_000) -> Surface:
    """A height grid thinned to at most `most` nodes: enough for outlines."""
    factor = int(np.ceil(np.sqrt(surface.z.size / most)))
    if factor <= 1:
        return surface
    a, b, c, d, e, f = surface.grid.affine
    z = surface.z[::factor, ::factor]
    shift = (1 - factor) / 2  # the nodes that stay keep their places
    affine = (a * factor, b * factor, c + (a + b) * shift, d * factor, e * factor, f + (d + e) * shift)
    return replace(surface, grid=Grid(z.shape, affine, surface.grid.crs), z=z)
