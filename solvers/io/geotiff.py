"""Height grids written as GeoTIFF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

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
