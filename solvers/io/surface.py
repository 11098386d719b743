"""Height grids as values: a DEM at its full resolution around a place, and the geoid grids that a machine may have."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np

from ..errors import BadProject, Unsupported
from ..geometry import Grid, Surface

GEOIDS = ("us_nga_egm08_25.tif", "us_nga_egm96_15.tif", "egm08_25.gtx", "egm96_15.gtx")
"""Names of global geoid grids in PROJ's data folders, the better first."""
LARGEST = 100_000_000
"""Most cells that are read at once; larger grids are read around the place asked for."""


def read_surface(path: Path | str, bounds: tuple[float, float, float, float] | None = None, sigma: float = 0.0,
                 sigma_xy: float = 0.0) -> Surface:
    """Heights of a GeoTIFF with their geometry. bounds: west, south, east, north of the part that is needed.

    sigma, sigma_xy: standard errors of its heights and of its position [m]. Raises BadProject (no such file, nothing within the
    bounds) and Unsupported (no grid, too large without bounds).
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError
    from rasterio.windows import Window

    path = Path(path)
    if not path.is_file():
        raise BadProject(f"{path}: there is no such height grid; correct the path")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as data:
                code = data.crs.to_epsg() if data.crs else None
                crs = f"EPSG:{code}" if code else data.crs.to_wkt() if data.crs else "local"
                whole = Grid((data.height, data.width), tuple(data.transform)[:6], crs)
                left, top, right, bottom = 0, 0, data.width, data.height
                if bounds is not None:
                    corners = whole.to_pixels(np.array([[bounds[i], bounds[j]] for i in (0, 2) for j in (1, 3)]))
                    left, top = np.floor(corners.min(axis=0)).astype(int) - 1
                    right, bottom = np.ceil(corners.max(axis=0)).astype(int) + 3
                    left, top, right, bottom = max(left, 0), max(top, 0), min(right, data.width), min(bottom, data.height)
                if right - left < 2 or bottom - top < 2:
                    raise BadProject(f"{path}: the height grid has no cells at this place; take one of the site, in the same crs")
                if (right - left) * (bottom - top) > LARGEST:
                    raise Unsupported(f"{path}: {(right - left) * (bottom - top) / 1e6:.0f} million cells; cut out the site")
                band = data.read(1, window=Window.from_slices((top, bottom), (left, right)), masked=True)
                a, b, c, d, e, f = whole.affine
    except RasterioIOError as error:
        raise Unsupported(f"{path}: it cannot be read ({' '.join(str(error).split())}); write it as a GeoTIFF") from None
    moved = (a, b, c + a * left + b * top, d, e, f + d * left + e * top)
    return Surface(Grid(band.shape, moved, crs), np.ma.filled(band.astype(float), np.nan), sigma, sigma_xy, path.name)


def find_geoid() -> Path | None:
    """A global geoid grid on this machine (in PROJ's data folders), None where there is none; nothing is downloaded."""
    from pyproj.datadir import get_data_dir, get_user_data_dir  # pyright: ignore[reportPrivateImportUsage]

    said = [os.environ.get(k, "") for k in ("PROJ_DATA", "PROJ_LIB")]
    folders = [Path(p) for text in (*said, get_data_dir(), get_user_data_dir(), "/usr/share/proj") for p in text.split(os.pathsep)
               if p]
    return next((f / name for name in GEOIDS for f in folders if (f / name).is_file()), None)
