"""Lists of control points, with or without their image measurements: ODM gcp_list.txt and tables of any make."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import BadTable
from .crs import all_in_area
from .sniff import DELIMITERS, Sheet, Tell, column_index, mapped_columns, mapping_shown, read_sheet, read_text
from .tables import NUMBER, Row

FIELDS = ("name", "X", "Y", "Z", "sX", "sY", "sZ", "role", "image", "col", "row", "sigma")
ALIASES: dict[str, tuple[str, ...]] = {
    "name": ("name", "id", "label", "point", "pointname", "pointid", "gcp", "gcplabel", "gcpname", "gcpid", "nr", "no", "number",
             "punkt", "punktnr", "punktnummer", "punktname", "pt",
             "marker", "station", "target", "matricule", "nom", "nombre"),
    "X": ("x", "e", "east", "easting", "geox", "xmap", "mapx", "rechtswert", "rechts", "rw", "ost", "ostwert",
          "lon", "long", "longitude", "worldx",
          "xm", "xeast", "xeasting", "xlongitude", "este"),
    "Y": ("y", "n", "north", "northing", "geoy", "ymap", "mapy", "hochwert", "hoch", "hw", "nord", "nordwert",
          "lat", "latitude", "worldy", "ym",
          "ynorth", "ynorthing", "ylatitude", "norte"),
    "Z": ("z", "h", "height", "elev", "elevation", "geoz", "alt", "altitude", "hoehe", "höhe", "worldz", "zm", "hm", "zaltitude",
          "zheight", "höhenhn", "ellipsoidalheight",
          "ellipsoidheight", "orthometricheight", "cota", "altitud"),
    "sX": ("sx", "sigmax", "stdx", "xmapacc", "xacc", "accx", "xaccuracy", "accuracyx", "stde", "sigmae", "sh",
           "sxy", "accuracyxy", "accuracyhorizontal", "horizontalaccuracy", "hacc", "eastingrms"),
    "sY": ("sy", "sigmay", "stdy", "ymapacc", "yacc", "accy", "yaccuracy", "accuracyy", "stdn", "sigman", "northingrms"),
    "sZ": ("sz", "sigmaz", "stdz", "elevacc", "zacc", "accz", "zaccuracy", "accuracyz", "stdh", "sigmah", "sv",
           "accuracyvertical", "verticalaccuracy", "vacc", "elevationrms"),
    "role": ("role", "type", "use"),
    "image": ("image", "photo", "img", "imagename", "filename", "file", "foto", "bild", "picture", "camera", "photoname"),
    "col": ("col", "column", "px", "imx", "pixelx", "imagex", "imgx", "u", "xpx", "colpx", "xpixel", "spalte", "colonne"),
    "row": ("row", "line", "py", "imy", "pixely", "imagey", "imgy", "v", "ypx", "rowpx", "ypixel", "zeile", "ligne"),
    "sigma": ("sigma", "sigmapx", "pxsigma", "acc"),
}
BOTH = ("sh", "sxy", "accuracyxy", "accuracyhorizontal", "horizontalaccuracy", "hacc")
"""Headers of one standard error for x and y."""
DEGREES = ("lon", "long", "longitude", "lat", "latitude", "xlongitude", "ylatitude")

IMAGE = re.compile(r"\.(jpe?g|tiff?|png|dng|arw|cr2|nef)$", re.IGNORECASE)
"""The ending of a photo's name."""

Ask = Callable[[str], str]
"""Puts a question to a person at a terminal and returns the answer."""


@dataclass(frozen=True)
class Mark:
    """One measurement of a point in a photo, in the pixel origin of its file; line: where it was read."""

    point: str
    image: str
    col: float
    row: float
    sigma: float
    line: int


@dataclass(frozen=True)
class ControlList:
    """Control as read: names, xyz (n, 3) in `crs` (None when the file does not say), sigma (n, 3) m, roles, marks and notes."""

    path: Path
    names: tuple[str, ...]
    xyz: np.ndarray
    sigma: np.ndarray
    role: tuple[str, ...]
    marks: tuple[Mark, ...]
    crs: str | None
    notes: tuple[str, ...] = ()


def read_control(path: Path | str, mapping: str | None = None, ask: Ask | None = None, tell: Tell | None = None,
                 crs: str | None = None) -> ControlList:
    """Control points of an ODM gcp_list.txt or of a table with any delimiter, decimal sign, encoding and order of columns.

    mapping: "name=ID,X=East,..." by header names or column numbers from 1. ask: how to put a question when the columns are
    unclear; without it an unclear table is refused. tell: is shown the columns before they are used. crs: where it is said, a
    table name, x, y, z without a header is read in the one order of x and y that lies in its area. Raises BadTable with the
    cure.
    """
    path = Path(path)
    lines = (line.strip() for line in read_text(path).splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    if mapping is None and is_crs(first):
        return _read_odm(path, first)
    sheet = read_sheet(path)
    columns = _mapped(sheet, mapping) if mapping else _by_place(sheet, crs) or _columns(sheet, ask)
    if tell is not None:
        tell(f"{path}: {_shown(sheet, columns)}")
    return _from_sheet(sheet, columns)


def is_crs(line: str) -> bool:
    """Whether a line is the first line of an ODM gcp_list.txt: proj4, EPSG:n, or WGS84 UTM 32N."""
    return bool(re.match(r"\s*(\+proj=|EPSG:\s*\d+\s*$|WGS84\s+UTM\s+\d{1,2}\s*[NS]\s*$)", line, re.IGNORECASE))


def _read_odm(path: Path, crs: str) -> ControlList:
    """One line per measurement: geo_x geo_y geo_z im_x im_y image [name]; without a name a point is its coordinate text."""
    points: dict[str, tuple[tuple[str, ...], int]] = {}
    marks: list[Mark] = []
    unknown: list[str] = []
    seen: dict[tuple[str, str], int] = {}
    numbers: dict[tuple[str, ...], str] = {}
    header_seen = False
    for n, line in enumerate(read_text(path).splitlines(), 1):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        if not header_seen:
            header_seen = True
            continue
        if len(cells) < 6:
            raise BadTable(f"{path} line {n}: {len(cells)} items, expected geo_x geo_y geo_z im_x im_y image and perhaps a name; "
                           "correct the line")
        where, key = Row(path, n, dict(zip(("X", "Y", "Z", "col", "row"), cells, strict=False))), tuple(cells[:3])
        name = cells[6] if len(cells) > 6 else numbers.setdefault(key, f"gcp{len(numbers) + 1}")
        if name in points and points[name][0] != key:
            raise where.error(f"point '{name}' has other coordinates than in line {points[name][1]}; correct one of them or "
                              "rename the point")
        if cells[2].lower() == "nan":
            unknown.append(name)
        else:
            where.required("Z", "metres")
        where.required("X", "metres")
        where.required("Y", "metres")
        points.setdefault(name, (key, n))
        if (name, cells[5]) in seen:
            raise where.error(f"point '{name}' in image '{cells[5]}' is already in line {seen[name, cells[5]]}; remove one of "
                              "them")
        seen[name, cells[5]] = n
        marks.append(Mark(name, cells[5], where.required("col", "pixels"), where.required("row", "pixels"), np.nan, n))
    if not points:
        raise BadTable(f"{path}: there is no control point below the first line; write geo_x geo_y geo_z im_x im_y image on each "
                       "line")
    xyz = np.array([[np.nan] * 3 if name in unknown else [float(v) for v in key] for name, (key, _) in points.items()])
    role = tuple("tie" if name in unknown else "control" for name in points)
    notes = [f"{', '.join(dict.fromkeys(unknown))}: no height is given, taken as tie"] if unknown else []
    return ControlList(path, tuple(points), xyz, np.full(xyz.shape, np.nan), role, tuple(marks), _odm_crs(crs), tuple(notes))


def _odm_crs(line: str) -> str:
    utm = re.match(r"\s*WGS84\s+UTM\s+(\d{1,2})\s*([NS])", line, re.IGNORECASE)
    if utm:
        return f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    return re.sub(r"EPSG:\s*", "EPSG:", line.strip(), flags=re.IGNORECASE)


def _key(header: str) -> str:
    """A header without units and signs: 'X [m]' -> x, 'Höhe' -> höhe."""
    return re.sub(r"[^a-z0-9äöüß]", "", re.sub(r"[\[(].*?[\])]", "", header.lower()))


def _by_place(sheet: Sheet, crs: str | None) -> dict[str, int] | None:
    """Columns of a table name, x, y, z without a header, where x and y lie in the area of the crs in one order only."""
    if sheet.header is not None or crs in (None, "local") or not 4 <= sheet.width <= 6:
        return None
    cells = [[sheet.plain(c) for c in sheet.column(i)] for i in range(sheet.width)]
    if not all(NUMBER.fullmatch(c) for i in (1, 2, 3) for c in cells[i]) or any(IMAGE.search(c) for row in cells for c in row):
        return None
    xy = np.array([cells[1], cells[2]], float).T
    fits = [all_in_area(xy, crs), all_in_area(xy[:, ::-1], crs)]
    if fits == [False, False] or fits == [True, True]:
        return None
    return dict(zip(("name", "X", "Y", "Z") if fits[0] else ("name", "Y", "X", "Z"), range(4), strict=True))


def _columns(sheet: Sheet, ask: Ask | None) -> dict[str, int]:
    """Columns found by the header; unclear ones are asked for, or refused when nobody can be asked."""
    found: dict[str, list[int]] = {f: [] for f in FIELDS}
    keys = [_key(h) for h in sheet.header or ()]
    for field in FIELDS:
        found[field] = [i for i, k in enumerate(keys) if k in ALIASES[field]]
    _plain_xy_are_pixels(found, keys)
    _map_before_degrees(found, keys)
    if len(found["sX"]) == 1 and not found["sY"] and keys[found["sX"][0]] in BOTH:
        found["sY"] = found["sX"]  # one standard error for both
    needed = ["name", "X", "Y", "Z"] + (["image", "col", "row"] if any(found[f] for f in ("image", "col", "row")) else [])
    unclear = [f for f in needed if len(found[f]) != 1]
    if unclear and ask is None:
        field = unclear[0]
        why = "none" if not found[field] else " and ".join(f"'{(sheet.header or ())[i]}'" for i in found[field])
        why = f"for {field} there is {why}" if sheet.header else \
            "there is no header line, nor a --crs in whose area x and y lie in one order only"
        raise BadTable(f"{sheet.path} line {sheet.lines[0][0]}: the columns are unclear ({why}); say which they are with "
                       f"--map \"{_example(sheet, found)}\" by header name or column number"
                       f"{'' if sheet.header else ' (a PIX4Dmatic list has a format of its own, gcp-pix4dmatic)'}")
    for field in unclear if ask is not None else []:
        assert ask is not None
        found[field] = [_asked(sheet, field, ask)]
    return {f: c[0] for f, c in found.items() if len(c) == 1}


def _plain_xy_are_pixels(found: dict[str, list[int]], keys: Sequence[str]) -> None:
    """Beside x_map and y_map, the columns x and y are pixels."""
    for field, pixel, plain in (("X", "col", "x"), ("Y", "row", "y")):
        if len(found[field]) > 1 and not found[pixel] and found["image"] and plain in keys:
            found[pixel] = [keys.index(plain)]
            found[field].remove(keys.index(plain))


def _map_before_degrees(found: dict[str, list[int]], keys: Sequence[str]) -> None:
    """A receiver's table has the same place on the map and in degrees: the map is read, with the height that goes with it."""
    for field in ("X", "Y"):
        plain = [i for i in found[field] if keys[i] not in DEGREES]
        if len(plain) == 1 and len(found[field]) == 2:
            found[field] = plain
    if len(found["Z"]) == 2:
        above = [i for i in found["Z"] if not keys[i].startswith("ellipsoid")]
        degrees = all(len(found[k]) == 1 and keys[found[k][0]] in DEGREES for k in "XY")
        found["Z"] = [i for i in found["Z"] if i not in above] if degrees else above if len(above) == 1 else found["Z"]


def _asked(sheet: Sheet, field: str, ask: Ask) -> int:
    shown = "  ".join(f"{i + 1}: {sheet.header[i] if sheet.header else sheet.lines[0][1][i]}" for i in range(sheet.width))
    for _ in range(3):
        answer = ask(f"{shown}\nWhich column is {field}? ").strip()
        try:
            return column_index(sheet, answer)
        except KeyError:
            continue
    raise BadTable(f"{sheet.path}: no column was chosen for {field}; give --map \"{field}=COLUMN,...\"")


def _example(sheet: Sheet, found: Mapping[str, Sequence[int]]) -> str:
    def shown(i: int) -> str:
        return sheet.header[i] if sheet.header else str(i + 1)

    free = iter(i for i in range(sheet.width) if not any(i in c for c in found.values()))
    return ",".join(f"{f}={shown(found[f][0] if found[f] else next(free, 0))}" for f in ("name", "X", "Y", "Z"))


def _mapped(sheet: Sheet, mapping: str) -> dict[str, int]:
    measured = {p.partition("=")[0].strip() for p in mapping.split(",")} & {"image", "col", "row"}
    return mapped_columns(sheet, mapping, FIELDS, ("name", "X", "Y", "Z", *(("image", "col", "row") if measured else ())))


def _from_sheet(sheet: Sheet, columns: Mapping[str, int]) -> ControlList:
    points: dict[str, tuple[tuple[float, ...], tuple[float, ...], str, int]] = {}
    marks: dict[tuple[str, str], Mark] = {}
    measured = "image" in columns
    for row in sheet.rows(dict(columns)):
        name = row.text("name")
        xyz = tuple(row.required(k, "a coordinate in metres") for k in "XYZ")
        sigma = tuple(row.number(k, "a standard error in metres", lowest=0) for k in ("sX", "sY", "sZ"))
        role = {"check": "check", "tie": "tie"}.get(row.cells.get("role", "").lower(), "control")
        if name in points and (not measured or points[name][0] != xyz):
            raise row.error(f"point '{name}' is already in line {points[name][3]}; remove or rename one of them")
        points.setdefault(name, (xyz, sigma, role, row.line))
        if measured and row.cells.get("image"):
            image = row.cells["image"]
            if (name, image) in marks:
                raise row.error(f"point '{name}' in image '{image}' is already in line {marks[name, image].line}; remove one of "
                                "them")
            marks[name, image] = Mark(name, image, row.required("col", "pixels"), row.required("row", "pixels"),
                                      row.number("sigma", "a standard error in pixels", above=0), row.line)
    values = list(points.values())
    return ControlList(sheet.path, tuple(points), np.array([v[0] for v in values]), np.array([v[1] for v in values]),
                       tuple(v[2] for v in values), tuple(marks.values()), _sheet_crs(sheet, columns), (_shown(sheet, columns),))


def _sheet_crs(sheet: Sheet, columns: Mapping[str, int]) -> str | None:
    degrees = sheet.header is not None and all(_key(sheet.header[columns[k]]) in DEGREES for k in "XY")
    return "EPSG:4326" if degrees else None


def _shown(sheet: Sheet, columns: Mapping[str, int]) -> str:
    how = f"separated by {DELIMITERS[sheet.delimiter]}{', decimal commas' if sheet.decimal_comma else ''}"
    return mapping_shown(columns, sheet.header, sheet.lines[0][1], how)
