"""Exterior orientations as text: Metashape's and Pix4D's OPK files, PATB, and tables of any make with named columns.

Angles are omega, phi, kappa or phi, omega, kappa, in degrees, gon or radians; which, the header says, or the rotation matrix
beside the angles, or the person (--angles, --angle-unit). References: Metashape "Export cameras, omega phi kappa"; Pix4D article
202558969; PATB records by PCI Geomatics article 204186705 (I16,16x,3F16.5 / 5F16.12 / 4F16.12).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...errors import BadTable
from ...geometry import Exterior
from ..files import write_text
from ..gcp import ALIASES, DEGREES
from ..sniff import Sheet, mapped_columns, mapping_shown, read_sheet, read_text
from ..tables import NUMBER
from .conventions import (
    AngleOrder,
    AngleUnit,
    CameraAxes,
    Position,
    RotationDirection,
    angles_as,
    exterior_as,
    exterior_from,
    rotation_from,
)
from .options import NOTHING, ORDERS, UNITS, Reading
from .scene import Exchange, Shot, labels_of, named
from .structure import Line, lines_of

NAMES = ("photoid", "label", "imagename", "image", "photo", "filename", "file", "name", "id", "camera", "img", "bild",
         "photoname", "imageid")
ANGLES = {"omega": ("omega", "om", "w", "omegadeg", "omegagon"), "phi": ("phi", "ph", "p", "phideg", "phigon"),
          "kappa": ("kappa", "ka", "k", "kap", "kappadeg", "kappagon")}
SIGMAS = {"sX": (*ALIASES["sX"], "xacc", "accuracyx", "xaccuracy"), "sY": (*ALIASES["sY"], "accuracyy", "yaccuracy"),
          "sZ": (*ALIASES["sZ"], "accuracyz", "zaccuracy"), "so": ("so", "somega", "sigmaomega", "omegaacc"),
          "sp": ("sp", "sphi", "sigmaphi", "phiacc"), "sk": ("sk", "skappa", "sigmakappa", "kappaacc")}
MATRIX = tuple(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3))
PATB_CONVENTION = (CameraAxes.PHOTO, RotationDirection.CAMERA_TO_OBJECT, Position.CENTRE)


def looks_like(path: Path, head: str) -> bool:
    """Whether a text's beginning is a header with omega, phi and kappa."""
    words = [_key(c) for line in head.splitlines()[:30] for c in re.split(r"[,;\t ]+", line)]
    return all(any(w in ANGLES[a][:1] or w in ANGLES[a][3:] for w in words) for a in ANGLES)


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """A table of positions and angles. Raises BadTable, also where unit or order of the angles contradict the file."""
    sheet = read_sheet(path)
    header, unit_said = _header(path, sheet)
    columns, order_said = _chosen(sheet, options.mapping) if options.mapping else _columns(sheet, header)
    if options.tell is not None:
        options.tell(f"{path}: {_said(sheet, header, columns)}")
    order = ORDERS[options.angles] if options.angles else order_said
    unit = UNITS[options.unit] if options.unit else unit_said
    rows = sheet.rows(columns)
    at = np.array([[r.required(k, "a coordinate in metres") for k in "XYZ"] for r in rows])
    keys = ("omega", "phi", "kappa") if order is AngleOrder.OPK else ("phi", "omega", "kappa")
    angles = np.array([[r.required(k, "an angle") for k in keys] for r in rows])
    matrices = np.array([[r.required(k, "a number") for k in MATRIX] for r in rows]) if MATRIX[0] in columns else None
    order, unit, notes = _settled(path, angles, order, unit, matrices, options)
    sigma = np.array([[r.number(k, "a standard error", lowest=0) if k in columns else np.nan for k in SIGMAS] for r in rows])
    shots = []
    for k, (name, file) in enumerate(named([r.text("image") for r in rows])):
        m = rotation_from(angles[k], order, unit)
        sd = sigma[k, 3:] * unit.value
        shots.append(Shot(name, None, Exterior(m, at[k]), file, sigma[k, :3] if np.isfinite(sigma[k, :3]).all() else None,
                          sd if np.isfinite(sd).all() else None))
    return Exchange("OPK text", path, None, {}, _unique(path, shots, rows), notes=(_said(sheet, header, columns), *notes))


def _unique(path: Path, shots: list[Shot], rows: Sequence) -> tuple[Shot, ...]:
    seen: dict[str, int] = {}
    for row in rows:
        label = row.text("image")
        if label in seen:
            raise row.error(f"image '{label}' is already in line {seen[label]}; remove one of them")
        seen[label] = row.line
    return tuple(shots)


def _key(header: str) -> str:
    return re.sub(r"[^a-z0-9äöüß]", "", re.sub(r"[\[(].*?[\])]", "", header.lower()))


def _header(path: Path, sheet: Sheet) -> tuple[tuple[str, ...] | None, AngleUnit | None]:
    """The header, also where it stands in a comment with other separators, and the unit it names."""
    header = sheet.header
    comments = [line.lstrip("#% ").strip() for line in read_text(path).splitlines() if line.lstrip().startswith(("#", "%"))]
    if header is None or not any(_key(h) in ANGLES["kappa"] for h in header):
        for text in comments:
            for separator in (r"[,;\t]", r"[,;\t]|\s+"):
                cells = tuple(c.strip() for c in re.split(separator, text) if c.strip())
                if len(cells) == sheet.width and any(_key(c) in ANGLES["kappa"] for c in cells):
                    header = cells
                    break
    words = " ".join([*(header or ()), *comments]).lower()
    unit = (AngleUnit.GON if re.search(r"\bgon\b|\bgrads?\b|gon\b", words) else
            AngleUnit.RADIANS if re.search(r"\[rad\]|\(rad\)|radian", words) else
            AngleUnit.DEGREES if re.search(r"deg|°", words) else None)
    return header, unit


def _columns(sheet: Sheet, header: tuple[str, ...] | None) -> tuple[dict[str, int], AngleOrder]:
    if header is None:
        if sheet.width < 7:
            raise BadTable(f"{sheet.path} line {sheet.lines[0][0]}: {sheet.width} items, expected image, X, Y, Z and three "
                           f"angles; "
                           "give a table with these columns")
        if sheet.width not in (7, 10, 13, 16):  # with standard errors, with a matrix, with both
            raise BadTable(f"{sheet.path} line {sheet.lines[0][0]}: {sheet.width} items and no header that says what they are; "
                           "say it with --map image=..,X=..,Y=..,Z=..,omega=..,phi=..,kappa=.. by column number")
        numeric = [all(NUMBER.fullmatch(c[i].replace(",", ".")) for _, c in sheet.lines) for i in range(7)]
        if not all(numeric[1:]):
            raise BadTable(f"{sheet.path} line {sheet.lines[0][0]}: there is no header and not every item after the image is a "
                           "number; write a header such as image,X,Y,Z,omega,phi,kappa")
        return dict(zip(("image", "X", "Y", "Z", "omega", "phi", "kappa"), range(7), strict=True)), AngleOrder.OPK
    keys = [_key(h) for h in header]
    wanted = {"image": NAMES, **{k: ALIASES[k] for k in "XYZ"}, **ANGLES, **SIGMAS, **{m: (m,) for m in MATRIX}}
    columns = {}
    for what, known in wanted.items():
        found = [i for name in known for i, k in enumerate(keys) if k == name]
        if what in ("X", "Y") and len(found) > 1:  # the same place on the map and in degrees: the map
            found = [i for i in found if keys[i] not in DEGREES] or found
        if len(found) > 1 and what in ("X", "Y", "Z", *ANGLES):
            both = " and ".join(f"'{header[i]}'" for i in found[:3])
            raise BadTable(f"{sheet.path}: the columns are unclear (for {what} there is {both}); say which they are with --map "
                           f"image=..,X=..,Y=..,Z=..,omega=..,phi=..,kappa=.. by header name or column number")
        if found:
            columns[what] = found[0]
    missing = [w for w in ("image", "X", "Y", "Z", *ANGLES) if w not in columns]
    if missing:
        raise BadTable(f"{sheet.path}: the header has no column {missing[0]}, it is {', '.join(header[:12])}; name the columns "
                       "image, X, Y, Z, omega, phi, kappa")
    if not all(m in columns for m in MATRIX):
        columns = {k: v for k, v in columns.items() if k not in MATRIX}
    return columns, AngleOrder.OPK if columns["omega"] < columns["phi"] else AngleOrder.POK


def _settled(path: Path, angles: np.ndarray, order: AngleOrder, unit: AngleUnit | None, matrices: np.ndarray | None,
             options: Reading) -> tuple[AngleOrder, AngleUnit, tuple[str, ...]]:
    """Order and unit that agree with the matrices where there are any; else as said, degrees when nothing is."""
    if matrices is not None:
        tried = [(o, u) for o in dict.fromkeys((order, *AngleOrder))
                 for u in dict.fromkeys((unit or AngleUnit.DEGREES, *AngleUnit))]
        swap = {AngleOrder.OPK: order is not AngleOrder.OPK}
        for o, u in tried:
            a = angles[:, [1, 0, 2]] if swap.get(o, order is AngleOrder.OPK) else angles
            made = np.array([rotation_from(row, o, u) for row in a]).reshape(-1, 9)
            if np.abs(made - matrices).max() < 1e-4:
                if (o, u) == (order, unit or AngleUnit.DEGREES):
                    return o, u, ()
                if options.angles or options.unit:
                    raise BadTable(f"{path}: its rotation matrices say {o.name} in {u.name.lower()}; leave out --angles and "
                                   "--angle-unit")
                if o is not order:
                    angles[:] = a
                return o, u, (f"angles: {o.name} in {u.name.lower()}, as its rotation matrices say",)
        raise BadTable(f"{path}: angles and rotation matrix of image 1 contradict each other in every order and unit; correct "
                       f"the "
                       "file")
    largest = float(np.abs(angles).max(initial=0.0))
    if unit is not None:
        limit = {AngleUnit.DEGREES: 360.0, AngleUnit.GON: 400.0, AngleUnit.RADIANS: 2 * np.pi}[unit]
        if largest > limit * 1.0001:
            raise BadTable(f"{path}: an angle is {largest:g}, more than a full turn in {unit.name.lower()}; give the right "
                           "--angle-unit: deg, gon or rad")
        return order, unit, ()
    if largest > 360.0001:
        if largest > 400.0001:
            raise BadTable(f"{path}: an angle is {largest:g}, more than a full turn in degrees or gon; correct it")
        return order, AngleUnit.GON, ("angles: in gon, one is above 360",)
    return order, AngleUnit.DEGREES, (f"angles: {order.name} in degrees (assumed, else give --angles and --angle-unit)",)


def _chosen(sheet: Sheet, mapping: str) -> tuple[dict[str, int], AngleOrder]:
    needed = ("image", "X", "Y", "Z", *ANGLES)
    columns = mapped_columns(sheet, mapping, (*needed, *SIGMAS), needed)
    return columns, AngleOrder.OPK if columns["omega"] < columns["phi"] else AngleOrder.POK


def _said(sheet: Sheet, header: tuple[str, ...] | None, columns: dict[str, int]) -> str:
    named = header if header is not None and len(header) == sheet.width else None
    parts = {k: v for k, v in columns.items() if k not in MATRIX}
    return mapping_shown(parts, named, sheet.lines[0][1], "and the rotation matrix" if MATRIX[0] in columns else "",
                         [columns[m] for m in MATRIX if m in columns])


# -- PATB -----------------------------------------------------------------------------------------------------------------


def looks_like_patb(head: str) -> bool:
    """Whether the first three lines are a PATB record: 4 or 5, 5 and 4 numbers."""
    lines = [line.split() for line in head.splitlines() if line.strip() and not line.lstrip().startswith("#")][:3]
    if [len(c) for c in lines] not in ([4, 5, 4], [5, 5, 4]):
        return False
    return all(NUMBER.fullmatch(c) for cells in (lines[0][1:], *lines[1:]) for c in cells)


def read_patb(path: Path, options: Reading = NOTHING) -> Exchange:
    """PATB exterior orientations with rotation matrices, which turn photo axes into object axes unless said otherwise."""
    lines = lines_of(path)
    if lines and lines[-1].cells == ("-99",):  # how PATB ends a list
        lines = lines[:-1]
    direction = RotationDirection.OBJECT_TO_CAMERA if options.matrix == "object-to-photo" else RotationDirection.CAMERA_TO_OBJECT
    if not lines or len(lines) % 3:
        where = lines[-1] if lines else Line(path, 1, ())
        raise where.error(f"{len(lines)} lines, expected three for every photo")
    found: list[tuple[str, Exterior]] = []
    for k in range(0, len(lines), 3):
        first, second, third = lines[k:k + 3]
        first.need(4, "photo number X Y Z")
        second.need(5, "a11 a12 a13 a21 a22")
        third.need(4, "a23 a31 a32 a33")
        r = np.concatenate([second.floats(0, 5), third.floats(0, 4)])
        try:
            exterior = exterior_from(r, first.floats(len(first.cells) - 3, 3), CameraAxes.PHOTO, direction, Position.CENTRE)
        except BadTable as error:
            raise second.error(f"photo {first.cells[0]}: {error}") from None
        found.append((first.cells[0], exterior))
    if len({label for label, _ in found}) < len(found):
        raise BadTable(f"{path}: a photo number is there twice; remove one of them")
    names = named([label for label, _ in found])
    shots = [Shot(name, None, at, file) for (name, file), (_, at) in zip(names, found, strict=True)]
    said = "object axes into photo axes" if options.matrix == "object-to-photo" else \
        "photo axes into object axes (assumed; give --matrix object-to-photo if it is the other way)"
    return Exchange("PATB", path, None, {}, tuple(shots), notes=(f"rotation matrices: {said}",))


# -- writing --------------------------------------------------------------------------------------------------------------


def write(scene: Exchange, path: Path, style: str = "metashape", order: AngleOrder = AngleOrder.OPK,
          unit: AngleUnit = AngleUnit.DEGREES) -> tuple[str, ...]:
    """Orientations as text; style: metashape (tabs, with matrix), pix4d (blanks), patb, table (commas, with sigmas)."""
    shots = [s for s in scene.shots if s.oriented and s.exterior is not None]
    labels = labels_of(shots)
    text = {"metashape": _metashape, "pix4d": _pix4d, "patb": _patb, "table": _csv}[style](shots, labels, order, unit)
    write_text(path, text)
    left = len(scene.shots) - len(shots)
    return (f"{left} images without an orientation are left out",) if left else ()


def _numbers(values: np.ndarray) -> list[str]:
    return [repr(float(v)) for v in values]


def _values(shot: Shot, order: AngleOrder, unit: AngleUnit) -> tuple[list[str], list[str]]:
    assert shot.exterior is not None
    return _numbers(shot.exterior.centre), _numbers(angles_as(shot.exterior.m, order, unit))


def _title(order: AngleOrder) -> list[str]:
    return ["Omega", "Phi", "Kappa"] if order is AngleOrder.OPK else ["Phi", "Omega", "Kappa"]


def _unit_suffix(unit: AngleUnit) -> str:
    return {AngleUnit.DEGREES: "", AngleUnit.GON: " [gon]", AngleUnit.RADIANS: " [rad]"}[unit]


def _metashape(shots: list[Shot], labels: list[str], order: AngleOrder, unit: AngleUnit) -> str:
    out = [f"# Cameras ({len(shots)})", "# PhotoID, X, Y, Z, " + ", ".join(t + _unit_suffix(unit) for t in _title(order)) + ", "
           + ", ".join(MATRIX)]
    for shot, label in zip(shots, labels, strict=True):
        assert shot.exterior is not None
        at, angles = _values(shot, order, unit)
        out.append("\t".join([label, *at, *angles, *_numbers(shot.exterior.m.ravel())]))
    return "\n".join(out) + "\n"


def _pix4d(shots: list[Shot], labels: list[str], order: AngleOrder, unit: AngleUnit) -> str:
    for label in labels:
        if any(c.isspace() for c in label):
            raise BadTable(f"image '{label}': this format takes no blanks in names; rename the photo")
    rows = [" ".join([label, *(v for part in _values(s, order, unit) for v in part)]) for s,
            label in zip(shots, labels, strict=True)]
    return "\n".join(["imageName X Y Z " + " ".join(_title(order)), *rows]) + "\n"


def _patb(shots: list[Shot], labels: list[str], order: AngleOrder, unit: AngleUnit) -> str:
    out = []
    for shot, label in zip(shots, labels, strict=True):
        if any(c.isspace() for c in label):
            raise BadTable(f"image '{label}': this format takes no blanks in names; rename the photo")
        assert shot.exterior is not None
        r, at = exterior_as(shot.exterior, *PATB_CONVENTION)
        cells = [f" {float(v)!r:>23}" for v in r.ravel()]
        out += [f"{label:>16}{'':16}" + "".join(f" {float(v)!r:>20}" for v in at), "".join(cells[:5]), "".join(cells[5:])]
    return "\n".join(out) + "\n"


def _csv(shots: list[Shot], labels: list[str], order: AngleOrder, unit: AngleUnit) -> str:
    import csv
    import io

    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["Label", "X", "Y", "Z", *(t + _unit_suffix(unit) for t in _title(order)), "sX", "sY", "sZ",
                     "sOmega", "sPhi", "sKappa"])
    for shot, label in zip(shots, labels, strict=True):
        at, angles = _values(shot, order, unit)
        sm = _numbers(shot.sigma_m) if shot.sigma_m is not None else [""] * 3
        sr = _numbers(shot.sigma_rad / unit.value) if shot.sigma_rad is not None else [""] * 3
        writer.writerow([label, *at, *angles, *sm, *sr])
    return out.getvalue()
