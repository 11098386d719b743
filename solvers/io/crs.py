"""Coordinate reference systems of what people bring: which one it is, its units and heights, and the way into a metric one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import BadProject, BadTable

METRES = {"m": 1.0, "ft": 0.3048, "us-ft": 1200 / 3937}
"""Units of length a person may name: metres, international feet, US survey feet."""


@dataclass(frozen=True)
class Described:
    """A crs in words. unit: metres per unit of x and y (1 for degrees). vertical: the name of its vertical crs, None without
    one. heights: "levelled" with a vertical crs, "ellipsoidal" in three dimensions, else "unknown". height_unit: metres per unit
    of height, None where the crs does not say."""

    text: str
    name: str
    geographic: bool
    unit_name: str
    unit: float
    vertical: str | None
    heights: str
    height_unit: float | None

    @property
    def units(self) -> str:
        """Its unit of length in the plural, with its size."""
        return f"{self.unit_name.replace('foot', 'feet').replace('metre', 'metres')} ({self.unit:.10g} m)"

    @property
    def metric(self) -> bool:
        """Whether x and y are metres."""
        return not self.geographic and abs(self.unit - 1) < 1e-12


def utm_zone(lat: float, lon: float) -> str:
    """The WGS84 UTM zone of a position [degrees] as an EPSG code."""
    zone = int((lon + 180) // 6) % 60 + 1
    return f"EPSG:{(32600 if lat >= 0 else 32700) + zone}"


def short_crs(text: str, metric: bool = True) -> str:
    """A crs as an EPSG code where it has one ("local" stays): of an EPSG or compound code, WKT, PROJ or a .prj file.

    Raises BadProject when it is not known, or, where `metric`, has neither metres nor degrees.
    """
    if text == "local":
        return text
    told = described(text)
    if metric and not told.geographic and not told.metric:
        raise BadProject(f"crs '{_brief(text)}' is not in metres but in {told.units}; give a crs in metres")
    return told.text


@lru_cache(maxsize=64)
def described(text: str) -> Described:
    """What a crs is. Raises BadProject when it is not known, "local" included."""
    crs = _crs(text)
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    axis = flat.axis_info[0] if flat.axis_info else None
    upright = crs.sub_crs_list[1] if crs.is_compound else None
    third = (upright.axis_info[0] if upright is not None and upright.axis_info else
             flat.axis_info[2] if len(flat.axis_info) > 2 else None)
    geographic = bool(flat.is_geographic)
    return Described(_short(crs, text), crs.name, geographic, axis.unit_name if axis else "unknown unit",
                     1.0 if geographic or axis is None else float(axis.unit_conversion_factor), upright.name if upright else None,
                     "levelled" if upright is not None else "ellipsoidal" if third is not None else "unknown",
                     float(third.unit_conversion_factor) if third is not None else None)


def same_map(first: str, second: str) -> bool:
    """Whether two crs have the same map coordinates, whatever they say of heights; "local" agrees with everything."""
    if "local" in (first, second) or first == second:
        return True
    a, b = (_horizontal(_crs(text)) for text in (first, second))
    return a.equals(b, ignore_axis_order=True)


def _horizontal(crs: Any) -> Any:
    return (crs.sub_crs_list[0] if crs.is_compound else crs).to_2d()


def is_geographic(text: str) -> bool:
    """Whether coordinates in a crs are degrees."""
    return text != "local" and described(text).geographic


def north_first(text: str) -> bool:
    """Whether the crs's own definition puts northing or latitude before easting or longitude."""
    if text == "local":
        return False
    crs = _crs(text)
    flat = crs.sub_crs_list[0] if crs.is_compound else crs
    return bool(flat.axis_info) and flat.axis_info[0].direction.lower() in ("north", "south") and \
        flat.axis_info[1].direction.lower() in ("east", "west")


def all_in_area(xy: np.ndarray, text: str) -> bool:
    """Whether coordinates (n, 2), east before north, lie where the crs is made for, a tenth of its extent around it included."""
    crs = _flat(text)
    place = crs.area_of_use
    if place is None:
        return False
    box = np.array(_transformer("EPSG:4326", text).transform_bounds(*place.bounds)).reshape(2, 2)
    margin = 0.1 * (box[1] - box[0])
    return bool(np.isfinite(box).all() and (xy >= box[0] - margin).all() and (xy <= box[1] + margin).all())


def transformed(xyz: np.ndarray, source: str, target: str) -> np.ndarray:
    """Coordinates (n, 3) (longitude before latitude, east before north) in another crs; heights stay as they are."""
    if source == target:
        return xyz
    if "local" in (source, target):
        raise BadProject(f"coordinates in '{source}' cannot be converted to '{target}'; give the crs of the control points with "
                         "--crs")
    x, y = _transformer(source, target).transform(xyz[:, 0], xyz[:, 1])
    out = np.column_stack([x, y, xyz[:, 2]])
    if not np.isfinite(out[np.isfinite(xyz).all(axis=1)]).all():
        raise BadProject(f"some coordinates do not lie in the area of '{target}'; check the order of the columns and the crs")
    return out


@lru_cache(maxsize=256)
def _transformer(source: str, target: str) -> Any:
    from pyproj import Transformer

    return Transformer.from_crs(_flat(source), _flat(target), always_xy=True)


def _flat(text: str) -> Any:
    crs = _crs(text)
    return crs.sub_crs_list[0] if crs.is_compound else crs


def _short(crs: Any, text: str) -> str:
    """EPSG:n or EPSG:n+m where that is the same crs, else one line of WKT or what was given."""
    code = _code(crs)
    if code:
        return f"EPSG:{code}"
    if crs.is_compound:
        codes = [_code(c) for c in crs.sub_crs_list]
        if all(codes):
            return f"EPSG:{codes[0]}+{codes[1]}"
    given = text.strip()
    return given if len(given) < 40 and not given.lower().endswith(".prj") else crs.to_wkt()


def _code(crs: Any) -> int | None:
    """The EPSG code; also of a WKT that only calls itself differently (.prj files of GIS programs)."""
    from pyproj import CRS

    code = crs.to_epsg()
    if code or crs.is_compound:
        return code
    code = crs.to_epsg(min_confidence=20)
    if not code:
        return None
    other = CRS.from_epsg(code)
    place = other.area_of_use
    if place is None or other.is_geographic != crs.is_geographic or other.is_vertical or crs.is_vertical:
        return code if crs.is_vertical and other.name == crs.name else None
    try:
        from pyproj import Transformer

        lon, lat = (place.west + place.east) / 2, (place.south + place.north) / 2
        base = "EPSG:4326"
        a, b = (Transformer.from_crs(base, c, always_xy=True).transform(lon, lat) for c in (crs, other))
    except Exception:
        return None
    return code if np.allclose(a, b, rtol=0, atol=1e-3 if not crs.is_geographic else 1e-8) else None


def _crs(text: str) -> Any:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        crs = CRS.from_user_input(_content(text))
        shift = crs.coordinate_operation.towgs84 if crs.is_bound and crs.coordinate_operation else None
        return crs.source_crs if shift is not None and not any(shift) else crs  # TOWGS84[0,0,..] says nothing
    except (CRSError, ValueError):
        raise BadProject(f"crs '{_brief(text)}' is not known; write \"local\", an EPSG code such as \"EPSG:32632\" or "
                         "\"EPSG:25832+7837\", WKT, or the path of a .prj file") from None


def _content(text: str) -> str:
    """The text itself, a UTM zone in words as its EPSG code (WGS84 UTM 32N, UTM 32S), or that of the .prj file it names."""
    utm = re.fullmatch(r"\s*(?:WGS\s*84)?[\s/]*UTM\s*(?:zone)?\s*(\d{1,2})\s*([NS])\s*", text, re.IGNORECASE)
    if utm and 1 <= int(utm[1]) <= 60:
        return f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    if not text.strip().lower().endswith(".prj"):
        return text
    from .files import read_bytes

    try:
        return read_bytes(Path(text.strip()), "give the .prj of the coordinates").decode("utf-8-sig", "replace").strip()
    except BadTable as error:
        raise BadProject(str(error)) from None


def _brief(text: str) -> str:
    one = " ".join(text.split())
    return one if len(one) <= 60 or one.lower().endswith(".prj") else f"{one[:57]}..."
