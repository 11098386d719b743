"""Height grids written as GeoTIFF, and where a raster lies."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import Unsupported
from .files import write_atomic


def write_heights(path: Path, heights: np.ndarray, west: float, north: float, cell: float, crs: str) -> None:
    """Write heights (rows, columns) m of nodes, rows from north to south, as a GeoTIFF whose pixel centres are the nodes.

    west, north: map coordinates of the first node; cell: spacing [m]; a crs "local" is left unsaid. Atomic.
    """
    from rasterio.io import MemoryFile
    from rasterio.transform import from_origin

    rows, columns = heights.shape
    with MemoryFile() as memory:
        with memory.open(driver="GTiff", width=columns, height=rows, count=1, dtype="float32",
                         crs=None if crs == "local" else crs,
                         transform=from_origin(west - cell / 2, north + cell / 2, cell, cell), compress="deflate", predictor=3,
                         nodata=float("nan")) as data:
            data.write(np.asarray(heights, np.float32), 1)
        write_atomic(path, lambda stream: stream.write(memory.read()))


def raster_affine(path: Path) -> tuple[tuple[float, ...], str]:
    """The affine a .. f of pixel edges of a georeferenced raster and its crs as text. Raises Unsupported without one."""
    import warnings

    import rasterio
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as data:
                transform, crs = data.transform, data.crs
    except RasterioIOError as error:
        raise Unsupported(f"{path}: it cannot be read as a raster ({' '.join(str(error).split())}); give a GeoTIFF") from None
    if transform.is_identity:
        raise Unsupported(f"{path}: it is not georeferenced; give a mosaic or an orthophoto, or a project and --image")
    code = crs.to_epsg() if crs else None
    return tuple(transform)[:6], f"EPSG:{code}" if code else "a crs without EPSG code" if crs else "an unknown crs"
