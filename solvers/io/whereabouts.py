"""Coordinates that lie far from where the photos were taken: which common mistake explains it, and the option that mends it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..errors import BadProject
from .crs import METRES, described, is_geographic, transformed, utm_zone

FAR = 20e3
"""Metres between coordinates and photos beyond which something is wrong: an aerial photo may lie a few kilometres off."""
NEAR = 5e3
"""Metres within which a mistake explains it."""
PREFIXED = {31: "EPSG:5649", 32: "EPSG:4647", 33: "EPSG:5650"}
"""UTM with the zone number before the easting."""


@dataclass(frozen=True)
class Reading:
    """How coordinates are read: their crs, x and y swapped, metres per unit (None: as the crs says)."""

    crs: str
    swap: bool = False
    unit: str | None = None

    def metric(self, xyz: np.ndarray, height_unit: str | None = None) -> np.ndarray:
        """Coordinates (n, 3) with x and y in the unit of the crs and heights in metres."""
        out = np.array(xyz[:, [1, 0, 2]] if self.swap else xyz, float)
        if self.crs == "local":
            scale = METRES[self.unit] if self.unit else 1.0
            out[:, :2] *= scale
            out[:, 2] *= METRES[height_unit] if height_unit else scale
            return out
        told = described(self.crs)
        if self.unit and not told.geographic:
            out[:, :2] *= METRES[self.unit] / told.unit
        if height_unit:
            out[:, 2] *= METRES[height_unit]
        elif told.height_unit is not None:
            out[:, 2] *= told.height_unit
        return out


@dataclass(frozen=True)
class Mistake:
    """distance: from the photos as read [m]; what was likely meant, in words, the reading that mends it, and its options."""

    distance: float
    words: str
    mended: Reading | None
    options: str


def distance(xyz: np.ndarray, crs: str, degrees: np.ndarray) -> float:
    """Metres between the middles of coordinates (n, 3) and photos (m, 2) longitude, latitude; inf where the crs has no such
    place."""
    known = xyz[np.isfinite(xyz[:, :2]).all(axis=1)]
    try:
        at = known[:, :2] if is_geographic(crs) else transformed(np.column_stack([known[:, :2], np.zeros(len(known))]), crs,
                                                                 "EPSG:4326")
    except BadProject:
        return np.inf
    at = at[np.isfinite(at[:, :2]).all(axis=1)]
    if not len(at):
        return np.inf
    lon, lat = np.median(at[:, :2], axis=0)
    lon0, lat0 = np.median(degrees, axis=0)
    if not (abs(lat) <= 90 and abs(lon) <= 360):
        return np.inf
    return _great_circle(lon, lat, lon0, lat0)


def mistaken(xyz: np.ndarray, reading: Reading, degrees: np.ndarray) -> Mistake | None:
    """What is wrong with coordinates (n, 3) far from photos at degrees (m, 2); None where they are near, or none is known."""
    if reading.crs == "local" or not len(degrees) or not np.isfinite(xyz[:, :2]).all(axis=1).any():
        return None
    as_read = distance(reading.metric(xyz), reading.crs, degrees)
    if as_read < FAR:
        return None
    found = []
    for words, other, options in _hypotheses(xyz, reading, degrees):
        d = distance(other.metric(xyz), other.crs, degrees)
        if d < NEAR:
            found.append((words, other, options))
    if not found:
        return Mistake(as_read, "and neither another zone, swapped axes, degrees nor feet explain it", None, "")
    words, other, options = found[0]
    return Mistake(as_read, words, other, options)


def _hypotheses(xyz: np.ndarray, reading: Reading, degrees: np.ndarray) -> Iterator[tuple[str, Reading, str]]:
    """The simplest mistakes first."""
    lon, lat = np.median(degrees, axis=0)
    home, other = utm_zone(lat, lon), utm_zone(-lat if lat else -1.0, lon)
    crs = reading.crs
    size = np.nanmax(np.abs(xyz[:, :2]))
    if size <= 360 and not is_geographic(crs):
        yield "they are degrees, longitude before latitude", Reading("EPSG:4326"), "--crs EPSG:4326"
        yield "they are degrees, latitude before longitude", Reading("EPSG:4326", True), "--crs EPSG:4326 --swap-xy"
    yield "x and y are swapped", Reading(crs, not reading.swap, reading.unit), "--swap-xy" if not reading.swap else "no --swap-xy"
    if not is_geographic(crs):
        if (reading.unit != "m" and reading.unit is not None) or abs(described(crs).unit - 1) > 1e-9:
            yield "they are in metres", Reading(crs, reading.swap, "m"), "--unit m"
        if reading.unit not in ("ft", "us-ft"):
            apart = float(np.nanmax(np.abs(xyz[:, :2]))) * (METRES["us-ft"] - METRES["ft"])
            yield (f"they are in feet (international: --unit ft, US survey: --unit us-ft; {apart:.1f} m apart here)",
                   Reading(crs, reading.swap, "ft"), "--unit ft or --unit us-ft")
    if crs != home:
        halves = {_code(crs) // 100, _code(home) // 100}
        what = "they are of the other hemisphere" if halves == {326, 327} and _code(crs) % 100 == _code(home) % 100 else \
            "they are of another zone or system"
        yield f"{what} ({home})", Reading(home, reading.swap, reading.unit), f"--crs {home}"
        zone = _code(home) % 100
        for near in (zone - 1, zone + 1):
            if 1 <= near <= 60:
                code = f"EPSG:{_code(home) // 100 * 100 + near}"
                yield f"they are of the neighbouring zone ({code})", Reading(code, reading.swap, reading.unit), f"--crs {code}"
        yield f"they are of {home} with x and y swapped", Reading(home, True), f"--crs {home} --swap-xy"
    for zone, code in PREFIXED.items():
        if zone * 1e6 < np.nanmedian(np.abs(xyz[:, 0])) < (zone + 1) * 1e6:
            yield f"their easting begins with the zone number ({code})", Reading(code), f"--crs {code}"
    yield "they are of the other hemisphere's count of northing", Reading(other), f"--crs {other}"


def _code(crs: str) -> int:
    return int(crs[5:]) if crs.startswith("EPSG:") and crs[5:].isdigit() else 0


def _great_circle(lon: float, lat: float, lon0: float, lat0: float) -> float:
    a, b, c, d = np.radians([lon, lat, lon0, lat0])
    h = np.sin((b - d) / 2) ** 2 + np.cos(b) * np.cos(d) * np.sin((a - c) / 2) ** 2
    return float(2 * 6.371e6 * np.arcsin(min(1.0, np.sqrt(h))))
