"""Files beside the photos: DJI's .MRK, tables of positions (CSV, geo.txt) and autopilot logs."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import BadTable
from ..geometry import FlightLog, Onboard
from .crs import is_geographic, transformed
from .files import decode_utf8, read_bytes
from .metadata import clock
from .sniff import Tell, mapping_shown

ALIASES = {
    "image": ("image", "imagename", "img", "photo", "photoname", "photoid", "file", "filename", "name", "label"),
    "time": ("time", "timestamp", "t", "datetime", "utc", "seconds", "gpstime", "timeus", "timems"),
    "lat": ("lat", "latitude", "gpslatitude", "latitudedeg", "y", "north", "northing", "ynorth", "ynorthing"),
    "lon": ("lon", "lng", "long", "longitude", "gpslongitude", "longitudedeg", "x", "east", "easting", "xeast", "xeasting"),
    "height": ("height", "alt", "altitude", "elevation", "h", "z", "heightm", "altm", "altitudem", "zaltitude"),
    "yaw": ("yaw", "heading", "yawdeg", "hdg"), "pitch": ("pitch", "pitchdeg"), "roll": ("roll", "rolldeg"),
    "trigger": ("trigger", "event", "cam", "camera", "shutter"),
    "hacc": ("hacc", "horizontalaccuracy", "accuracyhorizontalm", "accuracyhorizontal", "horizontalaccuracym", "sxy"),
    "vacc": ("vacc", "verticalaccuracy", "accuracyverticalm", "accuracyvertical", "verticalaccuracym", "sz"),
}
"""Column names that are understood, small letters and digits only."""
SCALE = {"timeus": 1e-6, "timems": 1e-3}
_N = r"(\d+(?:\.\d+)?)"
_DMS = re.compile(rf"""^([+-]?\d+(?:\.\d+)?)[°d\s:]+{_N}['m\s:]*(?:{_N}["s]?)?\s*([NSEW]?)$""", re.IGNORECASE)


def read_mrk(path: Path | str, images: Sequence[str], ppk: bool = False) -> list[Onboard]:
    """Positions of a DJI Timestamp.MRK, one line per photo, given to images in the order of their numbers.

    The coordinates are those of the camera already. ppk: they were replaced by post-processed ones of the antenna, and the
    offsets (north, east, down, mm) are added. Raises BadTable, also where there are not as many lines as images.
    """
    path, rows = Path(path), []
    for line, [text] in _lines(path):
        labels = {k.lower(): float(v) for v, k in re.findall(r"([+-]?\d+(?:\.\d+)?)\s*,\s*(N|E|V|Lat|Lon|Ellh)\b", text)}
        head = re.match(r"\s*\d+\s+(\d+(?:\.\d+)?)\s", text)
        after = re.search(r"Ellh\s+([\d.]+)\s*,\s*([\d.]+)\s*,\s*([\d.]+)", text)
        if head is None or len(labels) < 6:
            raise BadTable(f"{path} line {line}: expected number, time, [week], offsets N E V, Lat, Lon, Ellh, sigmas and Q as "
                           "in a "
                           "DJI .MRK; give the file as the aircraft wrote it")
        lat, lon, height = labels["lat"], labels["lon"], labels["ellh"]
        if ppk:
            lat += np.degrees(labels["n"] * 1e-3 / 6.371e6)
            lon += np.degrees(labels["e"] * 1e-3 / (6.371e6 * np.cos(np.radians(lat))))
            height -= labels["v"] * 1e-3
        north, east, up = (float(s) for s in after.groups()) if after else (0.0, 0.0, 0.0)
        sigma = (east, north, up) if min(north, east, up) > 0 else None
        rows.append((float(lat), float(lon), height, sigma, float(head[1])))
    if len(rows) != len(images):
        raise BadTable(f"{path}: {len(rows)} lines for {len(images)} photos; give exactly the photos of this flight")
    said = "position: .MRK, antenna offsets added" if ppk else "position: .MRK, at the camera"
    return [Onboard(name, lat, lon, h, "ellipsoidal", sigma_m=s, time=t, stated=(said, "height: ellipsoidal (.MRK)"))
            for name, (lat, lon, h, s, t) in zip(images, rows, strict=True)]


def read_positions(path: Path | str, tell: Tell | None = None, crs: str | None = None) -> list[Onboard]:
    """One line per photo: a table with named columns (image, lat, lon, height, yaw, pitch, roll ...), or OpenDroneMap's geo.txt.

    Latitudes and longitudes may be degrees or degrees, minutes, seconds. Yaw, pitch, roll are of a nadir mount. crs:
    of columns x and y that are map coordinates. tell: is shown the columns before they are used. Raises BadTable.
    """
    path = Path(path)
    lines = _lines(path, header=True)
    if not lines:
        raise BadTable(f"{path}: the table is empty; give a header and one line per photo")
    first = lines[0][1][0]
    if re.match(r"(?i)\s*(epsg:|\+proj|wgs84\s+utm)", first):
        return _geo_txt(path, first.strip(), lines[1:])
    header, rows = _named(path, lines, ("image", "lat", "lon"))
    if tell is not None and rows:
        tell(f"{path}: {mapping_shown(header, _cells(lines[0][1][0]), rows[0][1])}")
    return [_onboard(path, line, header, cells, crs) for line, cells in rows]


def read_flight_log(path: Path | str) -> FlightLog:
    """An autopilot's log with named columns: time, lat, lon and where it has them height, yaw, pitch, roll, trigger.

    Rows are put in the order of time; rows without time or position are left out. Raises BadTable.
    """
    path = Path(path)
    header, rows = _named(path, _lines(path), ("time", "lat", "lon"))
    table = []
    for line, cells in rows:
        time = clock(cells[header["time"]])
        value = [_angle(path, line, cells, header, k) for k in ("lon", "lat", "height", "yaw", "pitch", "roll")]
        event = cells[header["trigger"]].strip().lower() if "trigger" in header else ""
        if time is not None and np.isfinite(value[:2]).all():
            table.append([time, *value, event not in ("", "0", "0.0", "false", "no")])
    if len(table) < 2:
        raise BadTable(f"{path}: fewer than two lines have time, lat and lon; check the columns")
    a = np.array(table, float)
    _, once = np.unique(a[:, 0], return_index=True)
    a = a[once]
    name = next(c for c in _cells(_lines(path)[0][1][0]) if _key(c) in ALIASES["time"])
    return FlightLog(path.name, a[:, 0] * SCALE.get(_key(name), 1.0), a[:, 1:4], a[:, 4:7], a[:, 7] > 0)


def _onboard(path: Path, line: int, header: dict[str, int], cells: list[str], crs: str | None) -> Onboard:
    lon, lat, height, yaw, pitch, roll, hacc, vacc = (
        _angle(path, line, cells, header, k) for k in ("lon", "lat", "height", "yaw", "pitch", "roll", "hacc", "vacc"))
    if max(abs(lat), abs(lon)) > 360 and crs not in (None, "local") and not is_geographic(str(crs)):
        lon, lat = transformed(np.array([[lon, lat, 0.0]]), crs, "EPSG:4326")[0, :2]
    if not (abs(lat) <= 90 and abs(lon) <= 180):
        raise BadTable(f"{path} line {line}: lat {lat:g}, lon {lon:g} is no place on earth; check the order of the columns, or "
                       "give the crs of map coordinates with --crs EPSG:CODE")
    attitude = (yaw, pitch, roll) if np.isfinite([yaw, pitch, roll]).all() else None
    sigma = (hacc, hacc, vacc if np.isfinite(vacc) else 2 * hacc) if np.isfinite(hacc) and hacc > 0 else None
    time = clock(cells[header["time"]]) if "time" in header else None
    known = bool(np.isfinite(height))
    return Onboard(Path(cells[header["image"]]).stem, lat, lon, height if known else None, "unknown", attitude=attitude,
                   body=attitude,
                   sigma_m=sigma, time=time,
                   stated=(f"position: {path.name}", *(["height: datum not stated by the table"] if known else [])))


def _geo_txt(path: Path, crs: str, lines: list[tuple[int, list[str]]]) -> list[Onboard]:
    """OpenDroneMap's geo.txt: image x y [z] [yaw pitch roll] [hacc vacc] [extra]."""
    utm = re.fullmatch(r"(?i)wgs84\s+utm\s+(\d+)\s*([NS])", crs)
    code = f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}" if utm else crs
    out = []
    for line, [text] in lines:
        cells = text.split()
        values = np.array([_strict(path, line, c) for c in cells[1:9]], float)
        if len(values) < 2:
            raise BadTable(f"{path} line {line}: expected image x y [z] [yaw pitch roll] [hacc vacc]; correct the line")
        x, y, z = values[0], values[1], values[2] if len(values) > 2 else np.nan
        lon, lat = (x, y) if is_geographic(code) else transformed(np.array([[x, y, 0.0]]), code, "EPSG:4326")[0, :2]
        attitude = (values[3], values[4], values[5]) if len(values) >= 6 else None
        sigma = (values[6], values[6], values[7]) if len(values) >= 8 else None
        out.append(Onboard(Path(cells[0]).stem, float(lat), float(lon), float(z) if np.isfinite(z) else None, "unknown",
                           attitude=attitude,
                           body=attitude, sigma_m=sigma, stated=(f"position: {path.name}", "height: datum as geo.txt has it, "
                                                                                           "not stated")))
    return out


def _lines(path: Path, header: bool = False) -> list[tuple[int, list[str]]]:
    """Number and text of every line that is neither empty nor a comment; header: a comment may be the header of what follows."""
    data = read_bytes(path, "correct the path")
    try:
        text = decode_utf8(path, data)
    except BadTable:
        if b"\0" in data:
            raise
        text = data.decode("cp1252", "replace")
    lines = [(n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    content = [(n, [line]) for n, line in lines if not line.lstrip().startswith("#")]
    said = [(n, line.lstrip("# \t")) for n, line in lines if line.lstrip().startswith("#")]
    if header and content:
        width = len(_cells(content[0][1][0]))
        content[:0] = [(n, [line]) for n, line in said if n < content[0][0] and len(_cells(line)) == width
                       and {_key(c) for c in _cells(line)} & set(ALIASES["lat"])][-1:]
    return content


def _cells(text: str) -> list[str]:
    """Cells of a line: by tab, semicolon or comma, whichever it has, else by blanks."""
    for mark in ("\t", ";", ","):
        if mark in text:
            return [c.strip().strip('"') for c in text.split(mark)]
    return text.split()


def _named(path: Path, lines: list[tuple[int, list[str]]], required: Sequence[str]) -> tuple[dict[str, int],
                                                                                             list[tuple[int, list[str]]]]:
    """Which column holds what, and the rows. Raises BadTable."""
    if not lines:
        raise BadTable(f"{path}: the table is empty; give a header line")
    names = [_key(c) for c in _cells(lines[0][1][0])]
    header = {what: names.index(n) for what, known in ALIASES.items() for n in reversed(known) if n in names}
    for what in required:
        if what not in header:
            raise BadTable(f"{path} line {lines[0][0]}: there is no column for {what} (one of {', '.join(ALIASES[what][:5])}); "
                           "name it in the header")
    rows = []
    for line, [text] in lines[1:]:
        cells = _cells(text)
        if len(cells) < len(names):
            raise BadTable(f"{path} line {line}: {len(cells)} cells where the header has {len(names)}; fill in the missing ones")
        rows.append((line, cells))
    return header, rows


def _key(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _strict(path: Path, line: int, cell: str) -> float:
    try:
        return float(cell.replace(",", "."))  # a comma is a decimal sign here: it separates no cells of this table
    except ValueError:
        raise BadTable(f"{path} line {line}: '{cell}' is no number; correct it") from None


def _angle(path: Path, line: int, cells: list[str], header: dict[str, int], what: str) -> float:
    """A number, or degrees minutes seconds as one; NaN where the column or the cell is empty."""
    text = cells[header[what]] if what in header else ""
    if not text:
        return float("nan")
    found = _DMS.match(text)
    if found and what in ("lat", "lon"):
        size = abs(float(found[1])) + float(found[2]) / 60 + float(found[3] or 0) / 3600
        return -size if found[1].startswith("-") or found[4].upper() in ("S", "W") else size
    return _strict(path, line, text)
