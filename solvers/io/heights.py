"""Heights of the ground on a grid (DEM), read no finer than asked for."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ..errors import BadProject, Unsupported


def read_heights(path: Path | str, max_side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Map coordinates x (w,), y (h,) of the cell centres and heights z (h, w) [m], NaN where there are none.

    The longer side has at most `max_side` cells. Raises BadProject when there is no such file, Unsupported when it is no
    north-up grid.
    """
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.errors import NotGeoreferencedWarning, RasterioIOError

    if not Path(path).is_file():
        raise BadProject(f"{path}: there is no such surface; correct [surface] file in project.toml or remove it")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            with rasterio.open(path) as data:
                a = data.transform
                if a.b or a.d:
                    raise Unsupported(f"{path}: the surface's grid is turned; resample it to north up")
                factor = min(1.0, max_side / max(data.width, data.height))
                w, h = max(2, round(data.width * factor)), max(2, round(data.height * factor))
                band = data.read(1, out_shape=(h, w), masked=True, resampling=Resampling.average)
                x = a.c + a.a * (np.arange(w) + 0.5) * data.width / w
                y = a.f + a.e * (np.arange(h) + 0.5) * data.height / h
    except RasterioIOError as error:
        raise Unsupported(f"{path}: the surface cannot be read ({' '.join(str(error).split())}); write it as a GeoTIFF") from None
    return x, y, np.ma.filled(band.astype(float), np.nan)
