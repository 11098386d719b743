"""The canvas of a mosaic: ground size of a pixel, bounds, and the refusal of those beyond all sense."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import DegenerateGeometry, Unsupported
from ..geometry import Grid
from .placed import Placed
from .surface import Ground

ROOM = 40.0
"""A canvas may have this many times the pixels of all photos together ..."""
SMALL = 4e8
"""... or this many pixels, whichever is more."""


@dataclass(frozen=True)
class Canvas:
    """Grid of the mosaic, and by photo its outline on the map (k, 2), the place (2,) it shows best and whether it is whole."""

    grid: Grid
    gsd: float
    outlines: tuple[np.ndarray, ...]
    feet: np.ndarray
    whole: tuple[bool, ...]

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north."""
        c = self.grid.corners
        return float(c[0, 0]), float(c[2, 1]), float(c[2, 0]), float(c[0, 1])


def canvas_of(photos: Sequence[Placed], ground: Ground, gsd: float | None = None) -> Canvas:
    """The canvas that holds all photos; gsd [m], None: the median of what the photos resolve, to three digits.

    Its edges lie on multiples of the pixel size, so that mosaics of one pixel size fit each other. Raises DegenerateGeometry
    for photos that show no ground and Unsupported for a canvas beyond sane bounds, naming the photo that makes it so.
    """
    seen = [p.outline(ground) for p in photos]
    outlines = tuple(o for o, _ in seen)
    if gsd is None:
        gsd = natural(photos, ground, outlines)
    low, high = np.min([o.min(0) for o in outlines], axis=0), np.max([o.max(0) for o in outlines], axis=0)
    slack = 1e-6  # px: an outline on a pixel's edge does not open another pixel
    west, south = np.floor(low / gsd + slack) * gsd
    east, north = np.ceil(high / gsd - slack) * gsd
    columns, rows = (max(round(d / gsd), 1) for d in (east - west, north - south))
    _must_be_sane(photos, outlines, columns, rows, gsd)
    grid = Grid((rows, columns), (gsd, 0.0, float(west), 0.0, -gsd, float(north)), ground.frame.crs)
    feet = np.array([p.foot(ground, o) for p, o in zip(photos, outlines, strict=True)])
    return Canvas(grid, gsd, outlines, feet, tuple(w for _, w in seen))


def natural(photos: Sequence[Placed], ground: Ground, outlines: Sequence[np.ndarray]) -> float:
    """Ground size of a pixel that keeps what the photos resolve: their median at their centres, to three digits."""
    sizes = np.array([p.resolution(ground) for p in photos])
    for k in np.flatnonzero(~np.isfinite(sizes)).tolist():  # a centre at the horizon or beyond the DEM: by the area
        x, y = (outlines[k] - outlines[k][0]).T
        area = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
        sizes[k] = np.sqrt(area / (photos[k].interior.width * photos[k].interior.height))
    size = float(np.median(sizes))
    if not (np.isfinite(size) and size > 0):
        raise DegenerateGeometry("the photos do not tell how large a pixel is on the ground; give --gsd")
    digits = 2 - int(np.floor(np.log10(size)))
    return round(size, digits)


def _must_be_sane(photos: Sequence[Placed], outlines: Sequence[np.ndarray], columns: int, rows: int, gsd: float) -> None:
    pixels = sum(p.interior.width * p.interior.height for p in photos)
    if columns * rows <= max(ROOM * pixels, SMALL) and max(columns, rows) < 2**31:
        return
    middles = np.array([o.mean(0) for o in outlines])
    away = np.linalg.norm(middles - np.median(middles, axis=0), axis=1)
    size = np.array([np.ptp(o, axis=0).max() for o in outlines])
    reach = away + size / 2
    worst = int(np.argmax(reach))
    least = gsd * np.sqrt(columns * rows / max(ROOM * pixels, SMALL))
    far = reach[worst] > 10 * np.median(reach) and len(photos) > 2
    cure = (f"image '{photos[worst].name}' reaches {reach[worst]:.4g} from the middle of the others, leave it out or correct its "
            "orientation") if far else f"give --gsd of at least {least:.3g}"
    raise Unsupported(f"the mosaic would have {columns} x {rows} pixels, {columns * rows / pixels:.0f} times those of its "
                      f"photos; {cure}")
