"""Coordinate reference systems of what people bring: which one it is, and the way into a metric one."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import BadProject


def utm_zone(lat: float, lon: float) -> str:
    """The WGS84 UTM zone of a position [degrees] as an EPSG code."""
    zone = int((lon + 180) // 6) % 60 + 1
    return f"EPSG:{(32600 if lat >= 0 else 32700) + zone}"


def short_crs(text: str) -> str:
    """A crs as an EPSG code where it has one ("local" stays). Raises BadProject when it is not known or has no metres."""
    if text == "local":
        return text
    crs = _crs(text)
    if not crs.is_geographic and any(abs(axis.unit_conversion_factor - 1) > 1e-12 for axis in crs.axis_info[:2]):
        raise BadProject(f"crs '{text}' is not in metres, and it is not known in what its heights are; "
                         "convert the control to a crs in metres first")
    code = crs.to_epsg()
    return f"EPSG:{code}" if code else text


def is_geographic(text: str) -> bool:
    """Whether coordinates in a crs are degrees."""
    return text != "local" and bool(_crs(text).is_geographic)


def transformed(xyz: np.ndarray, source: str, target: str) -> np.ndarray:
    """Coordinates (n, 3) (longitude before latitude, east before north) in another crs; heights stay as they are."""
    from pyproj import Transformer

    if source == target:
        return xyz
    if "local" in (source, target):
        raise BadProject(f"coordinates in '{source}' cannot be converted to '{target}'; give the crs of the control points with "
                         "--crs")
    x, y = Transformer.from_crs(_crs(source), _crs(target), always_xy=True).transform(xyz[:, 0], xyz[:, 1])
    out = np.column_stack([x, y, xyz[:, 2]])
    if not np.isfinite(out[np.isfinite(xyz).all(axis=1)]).all():
        raise BadProject(f"some coordinates do not lie in the area of '{target}'; check the order of the columns and the crs")
    return out


def _crs(text: str) -> Any:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        return CRS.from_user_input(text)
    except CRSError:
        raise BadProject(f"crs '{text}' is not known; write \"local\" or an EPSG code such as \"EPSG:32632\"") from None
