"""A first look at the mosaic: every photo small, on a grid coarser by a factor, to place seams and to compare brightness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..cameras import Interior
from ..geometry import Grid, Surface
from .blend import feather, interpolated
from .canvas import Canvas
from .lattice import Lattice, Nets, Tile
from .placed import Placed
from .resample import warp_onto
from .surface import Ground

SIDE = 320
"""px that a photo's longer side has at least in the survey, before rounding the factor to a power of two."""
LARGEST = 3_000_000
"""px of the whole survey."""

Small = Callable[[str, int], np.ndarray]
"""(name, longer side) -> a small picture (h, w, 3) uint8 of a photo, the whole of it."""


@dataclass(frozen=True)
class Look:
    """A photo on the coarse grid: window `tile`, colours (h, w, 3) uint8, `seen` (h, w), feather weight (h, w), and
    the way to its full-resolution pixels: u, v (m, n) float32 at every step-th cell."""

    number: int
    photo: Placed
    tile: Tile
    colours: np.ndarray
    seen: np.ndarray
    edge: np.ndarray
    step: int
    u: np.ndarray
    v: np.ndarray

    def pixels(self) -> np.ndarray:
        """(h, w, 2) full-resolution photo pixels of the window's cells."""
        return np.stack([interpolated(np.nan_to_num(x), self.step, self.seen.shape) for x in (self.u, self.v)], -1)

    def pixels_of(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """(k, 2) of them: those of cells (k,) of the window."""
        step, out = self.step, []
        for x in (np.nan_to_num(self.u), np.nan_to_num(self.v)):
            i, j = np.minimum(rows // step, x.shape[0] - 2), np.minimum(columns // step, x.shape[1] - 2)
            a, b = rows / step - i, columns / step - j
            out.append((1 - a) * ((1 - b) * x[i, j] + b * x[i, j + 1]) + a * ((1 - b) * x[i + 1, j] + b * x[i + 1, j + 1]))
        return np.stack(out, -1)


@dataclass(frozen=True)
class Survey:
    """All photos on one coarse grid; factor: its cell in px of the mosaic; feet (n, 2): map positions each shows best."""

    grid: Grid
    factor: int
    looks: tuple[Look, ...]
    feet: np.ndarray


def factor_for(canvas: Canvas, photos: Sequence[Placed]) -> int:
    """How many px of the mosaic a cell of the survey has, a power of two."""
    rows, columns = canvas.grid.shape
    sides = [max(np.ptp(o, axis=0)) / canvas.gsd for o in canvas.outlines]
    least = max(float(np.median(sides)) / (2 * SIDE), np.sqrt(rows * columns / LARGEST), 2.0)
    return 2 ** int(np.ceil(np.log2(least)))


def survey_of(photos: Sequence[Placed], ground: Ground, canvas: Canvas, small: Small,
              surface: Callable[[tuple[float, float, float, float]], Surface] | None = None) -> Survey:
    """The survey of placed photos. small: how small pictures are read; surface: reads the height grid within bounds."""
    factor = factor_for(canvas, photos)
    rows, columns = (-(-n // factor) for n in canvas.grid.shape)
    gsd, (_, _, west, _, _, north) = canvas.gsd * factor, canvas.grid.affine
    grid = Grid((rows, columns), (gsd, 0.0, west, 0.0, -gsd, north), canvas.grid.crs)
    looks = []
    for k, photo in enumerate(photos):
        look = _look(k, photo, grid, ground, canvas.outlines[k], small, surface)
        if look is not None:
            looks.append(look)
    return Survey(grid, factor, tuple(looks), canvas.feet)


def _look(number: int, photo: Placed, grid: Grid, ground: Ground, outline: np.ndarray, small: Small,
          surface: Callable[[tuple[float, float, float, float]], Surface] | None) -> Look | None:
    corner = grid.to_pixels(outline)
    left, top = np.maximum(np.floor(corner.min(0)).astype(int), 0)
    right, bottom = np.minimum(np.ceil(corner.max(0)).astype(int) + 1, np.array(grid.shape)[::-1])
    if right - left < 2 or bottom - top < 2:
        return None
    tile = Tile(int(top), int(left), int(bottom - top), int(right - left))
    if surface is not None:
        ground = Ground(ground.frame, surface(bounds_of(grid, tile, ground, (photo,))))
    lattice = Nets(grid, tile, ground).lattice(photo)
    if lattice is None:
        return None
    i = photo.interior
    cells = np.hypot(*np.ptp(outline, axis=0)) / grid.affine[0]  # over the photo's diagonal
    longer = max(i.width, i.height)
    side = int(np.clip(np.ceil(cells * longer / np.hypot(i.width, i.height)), 64, longer))
    picture = small(photo.name, side)
    zoom = picture.shape[1] / i.width, picture.shape[0] / i.height
    u, v = (lattice.u + 0.5) * zoom[0] - 0.5, (lattice.v + 0.5) * zoom[1] - 0.5
    reduced = Lattice(lattice.step, u, v, lattice.good, lattice.net)
    acc = np.zeros((tile.height, tile.width, 4), np.float32)
    thumb = Placed(photo.name, Interior(1.0, pixel_mm=1.0, width=picture.shape[1], height=picture.shape[0]))
    warp_onto(acc, thumb, reduced, lambda _, t, le, b, r: picture[t:b, le:r])
    seen = acc[..., 3] > 0
    if not seen.any():
        return None
    edge = interpolated(feather(photo, lattice.u, lattice.v), lattice.step, seen.shape)
    return Look(number, photo, tile, np.rint(acc[..., :3]).astype(np.uint8), seen, edge, lattice.step,
                lattice.u.astype(np.float32), lattice.v.astype(np.float32))


def bounds_of(grid: Grid, tile: Tile, ground: Ground, photos: Sequence[Placed]) -> tuple[float, float, float, float]:
    """West, south, east, north of the heights that a tile needs: its own and those between it and the cameras."""
    corners = grid.to_map(np.array([[tile.left - 1, tile.top - 1], [tile.left + tile.width, tile.top + tile.height]]))
    feet = [ground.frame.to_map(p.exterior.centre)[:2] for p in photos if p.exterior is not None]
    at = np.vstack([corners, *feet]) if feet else corners
    (west, south), (east, north) = at.min(0), at.max(0)
    return float(west), float(south), float(east), float(north)
