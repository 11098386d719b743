"""One photo orthorectified: onto a plane or over a height grid, with what the ground hides left out."""

from __future__ import annotations

import numpy as np

from ..cameras import Interior
from ..geometry import Exterior, Grid, LocalFrame, Surface
from .canvas import canvas_of
from .lattice import Nets, Tile
from .placed import Placed
from .resample import Resample, warp_onto
from .surface import Ground, MosaicPlane

_SIDE = 1024


def orthorectify(image: np.ndarray, interior: Interior, exterior: Exterior, surface: Surface | MosaicPlane | float,
                 grid: Grid | None = None, *, gsd: float | None = None, frame: LocalFrame | None = None,
                 method: Resample = "bilinear") -> tuple[np.ndarray, np.ndarray, Grid]:
    """The orthophoto of an image (h, w) or (h, w, bands): values float32 (rows, columns, bands), where it is seen, and its grid.

    exterior: in the frame (None: map coordinates are taken as Cartesian); surface: a height grid, a plane, or the height of a
    level one [m, in the map]; grid None: the photo's own extent at `gsd` (None: as the photo resolves). What the height grid
    hides from the camera is not seen. Raises DegenerateGeometry, Unsupported, BadProject.
    """
    frame = frame or LocalFrame(np.zeros(3))
    plane = MosaicPlane(float(surface) - float(frame.origin[2])) if isinstance(surface, int | float) else surface
    ground, photo = Ground(frame, plane), Placed("photo", interior, exterior)
    grid = grid or canvas_of([photo], ground, gsd).grid
    bands = 1 if image.ndim == 2 else image.shape[2]
    layers = np.pad(np.atleast_3d(image), ((0, 0), (0, 0), (0, -bands % 3)))
    threes = [np.ascontiguousarray(layers[..., k:k + 3]) for k in range(0, bands, 3)]
    rows, columns = grid.shape
    out, seen = np.full((rows, columns, bands), np.nan, np.float32), np.zeros((rows, columns), bool)
    for top in range(0, rows, _SIDE):
        for left in range(0, columns, _SIDE):
            tile = Tile(top, left, min(_SIDE, rows - top), min(_SIDE, columns - left))
            lattice = Nets(grid, tile, ground).lattice(photo)
            if lattice is None:
                continue
            acc = np.zeros((tile.height, tile.width, 4), np.float32)
            part = slice(top, top + tile.height), slice(left, left + tile.width)
            for k, three in enumerate(threes):
                acc.fill(0)
                warp_onto(acc, photo, lattice, lambda _, t, le, b, r, three=three: three[t:b, le:r], method)
                seen[part] = acc[..., 3] > 0
                out[part][..., 3 * k:3 * k + 3] = np.where(seen[part][..., None], acc[..., :min(3, bands - 3 * k)], np.nan)
    return out, seen, grid
