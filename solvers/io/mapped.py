"""Maps and orthophotos: any georeferenced raster, read onto the pixels of another one."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import BadProject, Unsupported
from ..geometry import Grid
from . import crs


def read_mapped(path: Path, grid: Grid) -> np.ndarray:
    """(rows, columns, 4) uint8: a georeferenced raster of any pixel size on the pixels of `grid`, alpha 0 where it has none.

    Only the part that is needed is read, averaged where its pixels are smaller. Raises BadProject (no such file, another crs, no
    common area) and Unsupported (no raster, not georeferenced).
    """
    import cv2
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError
    from rasterio.windows import Window

    if not path.is_file():
        raise BadProject(f"{path}: there is no such file; give a GeoTIFF, its path from the project's folder")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as data:
                if data.transform.is_identity:
                    raise Unsupported(f"{path.name}: it is not georeferenced; give a GeoTIFF that is")
                code = data.crs.to_epsg() if data.crs else None
                if code and grid.crs != "local" and not crs.same_map(f"EPSG:{code}", grid.crs):
                    raise BadProject(
                        f"{path.name}: its crs is EPSG:{code} and the mosaic's is {grid.crs}; warp it first "
                        f"(gdalwarp -t_srs {grid.crs})"
                    )
                whole = Grid((data.height, data.width), tuple(data.transform)[:6])
                corners = whole.to_pixels(grid.corners)
                low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - 2, 0)
                high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + 3, [data.width, data.height])
                if (high - low < 2).any():
                    raise BadProject(f"{path.name}: it does not cover the mosaic; give a map of this place")
                step = max(grid.affine[0] / float(np.hypot(whole.affine[0], whole.affine[3])), 1.0)
                size = np.maximum(((high - low) / step).astype(int), 2)
                window = Window.from_slices((low[1], high[1]), (low[0], high[0]))
                count = 3 if data.count >= 3 else 1
                bands = data.read(
                    list(range(1, count + 1)),
                    window=window,
                    out_shape=(count, int(size[1]), int(size[0])),
                    resampling=Resampling.average,
                )
                mask = data.dataset_mask(window=window, out_shape=(int(size[1]), int(size[0])))
    except RasterioIOError as error:
        raise Unsupported(f"{path.name}: it cannot be read ({' '.join(str(error).split())}); give a GeoTIFF") from None
    values = bands.astype(np.float32)
    if bands.dtype != np.uint8:
        known = values[:, mask > 0]
        a, b = np.percentile(known, [1, 99]) if known.size else (0, 1)
        values = np.clip(255 * (values - a) / max(b - a, 1e-9), 0, 255)
    rgb = np.repeat(values, 3, axis=0) if count == 1 else values
    picture = np.dstack([*rgb, mask.astype(np.float32)])
    rows, columns = grid.shape
    col, row = np.meshgrid(np.arange(columns), np.arange(rows))
    at = whole.to_pixels(grid.to_map(np.stack([col, row], axis=-1)))
    scale = (high - low) / size
    at = ((at + 0.5 - low) / scale - 0.5).astype(np.float32)
    return np.clip(
        np.round(cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=(0, 0, 0, 0))), 0, 255
    ).astype(np.uint8)
