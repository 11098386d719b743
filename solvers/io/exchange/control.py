"""Lists of control points: OpenDroneMap gcp_list.txt, plain tables, PIX4Dmatic, QGIS .points, OpenSfM and GeoJSON control.

Tables and gcp_list.txt are read by `solvers.io.gcp`; this module brings every list into one `Exchange` and writes lists.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadTable
from ..crs import described, is_geographic, north_first, short_crs, transformed
from ..files import write_json, write_text
from ..gcp import ControlList, read_control
from ..sniff import mapping_shown, read_sheet, read_text
from ..tables import Row
from .conventions import PixelOrigin
from .options import NOTHING, Reading
from .scene import Exchange, Shot, labels_of, named, no_observations, observations_from, points_from
from .structure import read_json


def read_list(path: Path, options: Reading = NOTHING) -> Exchange:
    """A gcp_list.txt or a table with any delimiter, decimal sign and order of columns; how it was read is in the notes."""
    return of_control(read_control(path, options.mapping, options.ask, options.tell, options.crs), options)


def of_control(control: ControlList, options: Reading = NOTHING) -> Exchange:
    """A control list as an exchange; images are those it names."""
    labels = list(dict.fromkeys(m.image for m in control.marks))
    index, points = {label: n for n, label in enumerate(labels)}, {name: j for j, name in enumerate(control.names)}
    origin = _origin(options)
    rows = [(index[m.image], points[m.point], m.col - origin, m.row - origin, m.sigma) for m in control.marks]
    said = options.pixel_origin or not rows
    notes = control.notes if said else (*control.notes, "pixel origin: center of the top-left pixel (assumed; give "
                                                        "--pixel-origin "
                                        "corner if (0, 0) is its corner)")
    shots = tuple(Shot(name, None, None, file) for name, file in named(labels))
    crs = short_crs(control.crs, metric=False) if control.crs else options.crs
    return Exchange("control points", control.path, crs, {}, shots,
                    points_from(control.path, control.names, control.xyz, control.sigma, control.role), observations_from(rows),
                    notes)


def _origin(options: Reading) -> float:
    return PixelOrigin.CORNER.value if options.pixel_origin == "corner" else PixelOrigin.CENTER.value


# -- PIX4Dmatic -----------------------------------------------------------------------------------------------------------


def read_pix4dmatic(path: Path, options: Reading = NOTHING) -> Exchange:
    """label,c1,c2,z[,sigma horizontal,sigma vertical]: c1 and c2 in the axis order of the crs's own definition.

    Reference: Pix4D article 360038397752. Raises BadTable, also without a crs, which decides the order.
    """
    sheet = read_sheet(path)
    if options.crs is None:
        raise BadTable(f"{path}: a PIX4Dmatic list has its coordinates in the axis order of its crs, and does not name it; give "
                       f"--crs "
                       "EPSG:CODE")
    if sheet.width not in (4, 5, 6):
        raise BadTable(f"{path} line {sheet.lines[0][0]}: {sheet.width} columns, expected label, two coordinates, height and "
                       f"perhaps two "
                       "accuracies")
    crs = short_crs(options.crs, metric=False)
    swap = north_first(crs)
    keys: dict[str, int] = dict(zip(("name", "Y" if swap else "X", "X" if swap else "Y", "Z", "sH", "sV"), range(sheet.width),
                                    strict=False))
    if options.tell is not None:
        options.tell(f"{path}: {mapping_shown(keys, sheet.header, sheet.lines[0][1], f'the axis order of {crs}')}")
    rows = sheet.rows(keys)
    xyz = [[r.required(k, "a coordinate") for k in "XYZ"] for r in rows]
    sigma = [[r.number(k, "an accuracy in metres", lowest=0) for k in ("sH", "sH", "sV")] for r in rows]
    order = "north before east" if swap else "east before north"
    return Exchange("PIX4Dmatic GCPs", path, crs, {}, (), points_from(path, [r.text("name") for r in rows], xyz, sigma),
                    no_observations(), (f"axis order: {order}, as {crs} defines it",))


# -- QGIS -----------------------------------------------------------------------------------------------------------------


def looks_like_qgis(head: str) -> bool:
    """Whether a text's beginning is a .points file of the QGIS georeferencer."""
    return "mapX" in head and ("pixelX" in head or "sourceX" in head)


def read_qgis(path: Path, options: Reading = NOTHING) -> Exchange:
    """mapX,mapY,pixelX,pixelY,enable..: pixels from the outer corner, y up (negative); disabled points are left out.

    The photo is the file's name without .points. Heights are unknown: the points are ties unless given heights.
    """
    lines = read_text(path).splitlines()
    crs = next((line.split(":", 1)[1].strip() for line in lines if line.lstrip().upper().startswith("#CRS:")), "") or options.crs
    start = next((n for n, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    header = [c.strip() for c in lines[start].split(",")] if start < len(lines) else []
    names = {"X": ("mapX",), "Y": ("mapY",), "col": ("pixelX", "sourceX"), "row": ("pixelY", "sourceY"), "enable": ("enable",)}
    at = {k: next((header.index(n) for n in known if n in header), -1) for k, known in names.items()}
    if min(at[k] for k in ("X", "Y", "col", "row")) < 0:
        raise BadTable(f"{path} line {start + 1}: the header is not mapX,mapY,pixelX,pixelY; save the points again in QGIS")
    xyz, rows = [], []
    for n, line in enumerate(lines[start + 1:], start + 2):
        if not line.strip():
            continue
        cells = [c.strip() for c in line.split(",")]
        if len(cells) < len(header) - 1 or len(cells) <= max(at.values()):
            raise BadTable(f"{path} line {n}: {len(cells)} cells where the header has {len(header)}; save the points again in "
                           f"QGIS")
        row = Row(path, n, {k: cells[i] for k, i in at.items() if i >= 0})
        if row.cells.get("enable", "1") in ("0", "false"):
            continue
        xyz.append([row.required("X", "a coordinate"), row.required("Y", "a coordinate"), np.nan])
        col, down = row.required("col", "pixels"), -row.required("row", "pixels")
        rows.append((0, len(xyz) - 1, col - PixelOrigin.CORNER.value, down - PixelOrigin.CORNER.value, np.nan))
    [(name, file)] = named([path.name.removesuffix(".points")])
    points = points_from(path, [f"qgis{n + 1}" for n in range(len(xyz))], np.array(xyz).reshape(-1, 3), role="tie")
    return Exchange("QGIS points", path, short_crs(crs, metric=False) if crs else None, {}, (Shot(name, None, None, file),),
                    points,
                    observations_from(rows), ("heights are unknown in QGIS: the points are ties until they have heights",))


def write_qgis(scene: Exchange, path: Path) -> tuple[str, ...]:
    """A .points file of the image that the file's name says, or of the only one."""
    names = {s.name: n for n, s in enumerate(scene.shots)} | {label: n for n, label in enumerate(labels_of(scene.shots))}
    wanted = path.name.removesuffix(".points")
    if wanted not in names and len(scene.shots) != 1:
        raise BadTable(f"{path}: a .points file is of one image; name it IMAGE.points, after one of "
                       f"{', '.join(s.name for s in scene.shots[:6])}")
    image = names.get(wanted, 0)
    of = scene.observations
    out = [f"#CRS: {scene.crs}"] if scene.crs not in (None, "local") else []
    out.append("mapX,mapY,pixelX,pixelY,enable,dX,dY,residual")
    for r in np.flatnonzero(of.image == image):
        x, y, _ = scene.points.xyz[of.point[r]]
        if np.isfinite([x, y]).all():
            col, row = of.pixel[r] + PixelOrigin.CORNER.value
            out.append(f"{float(x)!r},{float(y)!r},{float(col)!r},{float(-row)!r},1,0,0,0")
    write_text(path, "\n".join(out) + "\n")
    return ()


# -- OpenSfM --------------------------------------------------------------------------------------------------------------


def looks_like_opensfm(head: str) -> bool:
    """Whether a JSON's beginning is a ground_control_points.json of OpenSfM."""
    return '"observations"' in head and '"projection"' in head and '"shot_id"' in head


def read_opensfm(path: Path, options: Reading = NOTHING) -> Exchange:
    """Positions in latitude, longitude, altitude; projections divided by the longer side, from the middle (--size)."""
    root = read_json(path)
    if options.size is None:
        raise BadTable(f"{path}: its measurements are divided by the longer side of the photos; give their size with --size "
                       f"WIDTH,HEIGHT")
    width, height = options.size
    names, xyz, labels, marks = [], [], [], []
    for n, point in enumerate(root.get("points").entries()):
        names.append(point.get("id").text())
        at = point.maybe("position")
        xyz.append([np.nan] * 3 if at is None else
                   [at.get("longitude").number(), at.get("latitude").number(), at.number_or("altitude", np.nan)])
        for o in point.get("observations").entries():
            labels.append(o.get("shot_id").text())
            marks.append((n, o.get("projection").numbers(2)))
    index = {label: n for n, label in enumerate(dict.fromkeys(labels))}
    side = max(width, height)
    rows = [(index[label], n, p[0] * side + (width - 1) / 2, p[1] * side + (height - 1) / 2, np.nan)
            for label, (n, p) in zip(labels, marks, strict=True)]
    shots = tuple(Shot(name, None, None, file) for name, file in named(list(index)))
    role = ["control" if np.isfinite(x).all() else "tie" for x in xyz]
    return Exchange("OpenSfM control points", path, "EPSG:4326", {}, shots, points_from(path, names, xyz, None, role),
                    observations_from(rows))


# -- writing --------------------------------------------------------------------------------------------------------------


def write_odm(scene: Exchange, path: Path) -> tuple[str, ...]:
    """OpenDroneMap's gcp_list.txt: one line a measurement, pixels from the centre of the top-left pixel. Raises BadTable."""
    if scene.crs in (None, "local"):
        raise BadTable(f"{path}: a gcp_list.txt begins with its crs, and '{scene.crs}' is on no map; give --crs")
    labels, of, out, left = labels_of(scene.shots), scene.observations, [str(scene.crs)], 0
    for i, j, (col, row) in zip(of.image, of.point, of.pixel, strict=True):
        name = scene.points.names[j]
        if any(c.isspace() for c in name + labels[i]):
            raise BadTable(f"point '{name}' or image '{labels[i]}' has blanks, which a gcp_list.txt cannot hold; rename it")
        xyz = scene.points.xyz[j]
        if scene.points.role[j] == "tie" or not np.isfinite(xyz).all():
            left += 1
            continue
        out.append(" ".join([*(repr(float(v)) for v in xyz), repr(float(col)), repr(float(row)), labels[i], name]))
    write_text(path, "\n".join(out) + "\n")
    return (f"{left} measurements of tie points are left out",) if left else ()


def write_table(scene: Exchange, path: Path) -> tuple[str, ...]:
    """Points as a table, one line a point, and its measurements where there are any (one line a measurement)."""
    p, of = scene.points, scene.observations
    labels = labels_of(scene.shots)
    known = [j for j in range(len(p)) if np.isfinite(p.xyz[j]).all()]
    rows: list[Sequence[Any]] = [["name", "X", "Y", "Z", "sX", "sY", "sZ", "role", *(("image", "col", "row") if len(of) else ())]]
    marks: dict[int, list[int]] = {}
    for r, j in enumerate(of.point):
        marks.setdefault(int(j), []).append(r)
    for j in known:
        line = [p.names[j], *map(_cell, p.xyz[j]), *map(_cell, p.sigma[j]), p.role[j]]
        if len(of):
            rows += [[*line, labels[of.image[r]], *map(_cell, of.pixel[r])] for r in marks.get(j, ())]
        else:
            rows.append(line)
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    write_text(path, out.getvalue())
    left = len(p) - len(known)
    return (f"{left} points without coordinates are left out",) if left else ()


def write_metashape_csv(scene: Exchange, path: Path) -> tuple[str, ...]:
    """Markers for Metashape's "Import Reference" (label, X, Y, Z, accuracies), comma-separated with a header line."""
    p = scene.points
    rows: list[Sequence[Any]] = [["#Label", "X/East", "Y/North", "Z/Altitude", "X_Accuracy", "Y_Accuracy", "Z_Accuracy"]]
    for name, xyz, sigma, role in zip(p.names, p.xyz, p.sigma, p.role, strict=True):
        if role != "tie" and np.isfinite(xyz).all():
            rows.append([name, *map(_cell, xyz), *map(_cell, sigma)])
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    write_text(path, out.getvalue())
    return ()


def write_pix4dmatic(scene: Exchange, path: Path) -> tuple[str, ...]:
    """label,c1,c2,z,sigma horizontal,sigma vertical in the axis order of the crs; returns which that is."""
    crs = scene.crs or "local"
    order = [1, 0, 2] if north_first(crs) else [0, 1, 2]
    out = []
    for name, xyz, sigma, role in zip(scene.points.names, scene.points.xyz, scene.points.sigma, scene.points.role, strict=True):
        if role != "tie" and np.isfinite(xyz).all():
            if "," in name:
                raise BadTable(f"point '{name}': a PIX4Dmatic list takes no commas in names; rename it")
            sd = [max(sigma[:2]), sigma[2]] if np.isfinite(sigma).all() else []
            out.append(",".join([name, *(repr(float(v)) for v in (*xyz[order], *sd))]))
    write_text(path, "\n".join(out) + "\n")
    return (f"axis order: {'north before east' if order[0] else 'east before north'}, as {crs} defines it",)


def write_geojson(scene: Exchange, path: Path) -> tuple[str, ...]:
    """Control and check points with their measurements as GeoJSON (RFC 7946: longitude, latitude, height as it is)."""
    crs = scene.crs or "local"
    if crs == "local":
        raise BadTable(f"{path}: GeoJSON needs longitude and latitude, and the coordinates are on no map; give --crs")
    degrees = scene.points.xyz if is_geographic(crs) else transformed(scene.points.xyz, crs, "EPSG:4326")
    labels, of = labels_of(scene.shots), scene.observations
    features = []
    for j, (name, role) in enumerate(zip(scene.points.names, scene.points.role, strict=True)):
        if role == "tie" or not np.isfinite(scene.points.xyz[j]).all():
            continue
        marks = [{"filename": labels[of.image[r]], "ji": of.pixel[r]} for r in np.flatnonzero(of.point == j)]
        features.append({"type": "Feature", "geometry": {"type": "Point", "coordinates": [round(float(v), 11)
                                                                                          for v in degrees[j, :2]]
                                                          + [float(degrees[j, 2])]},
                         "properties": {"id": name, "role": role, "X": scene.points.xyz[j, 0], "Y": scene.points.xyz[j, 1],
                                        "Z": scene.points.xyz[j, 2], "sigma_m": scene.points.sigma[j], "marks": marks,
                                        "crs": crs}})
    write_json(path, {"type": "FeatureCollection", "features": features})
    heights = described(crs).heights
    return (f"heights: {heights}, as they are in the project",)


def looks_like_geojson(head: str) -> bool:
    """Whether a JSON's beginning is a point collection of control points (ours or Orthority's)."""
    return '"FeatureCollection"' in head and '"Point"' in head and '"translation"' not in head


def read_geojson(path: Path, options: Reading = NOTHING) -> Exchange:
    """Control points as GeoJSON: ours (X, Y, Z and crs in the properties), or Orthority's (filename, ji, id)."""
    names, xyz, sigma, role, marks = [], [], [], [], []
    index: dict[str, int] = {}
    crs = None
    for n, f in enumerate(read_json(path).get("features").entries(), 1):
        p = f.get("properties")
        name = p.get("id").text() if p.maybe("id") else f"gcp{n}"
        if p.maybe("crs") and p.maybe("X"):
            crs, at = short_crs(p.get("crs").text(), metric=False), [p.get(k).number() for k in "XYZ"]
        else:
            at = list(f.get("geometry").get("coordinates").numbers((2, 3)))
            at = at if len(at) == 3 else [*at, np.nan]
        if name not in index:
            index[name] = len(names)
            names.append(name)
            xyz.append(at)
            sd = p.maybe("sigma_m")
            sigma.append([np.nan] * 3 if sd is None or None in sd.value else sd.numbers(3))
            role.append(p.get("role").text() if p.maybe("role") else "control")
        places = p.get("marks").entries() if p.maybe("marks") else [p] if p.maybe("ji") else []
        marks += [(index[name], m.get("filename").text(), m.get("ji").numbers(2)) for m in places]
    bad = [r for r in role if r not in ("control", "check", "tie")]
    if bad:
        raise BadTable(f"{path}: the role '{bad[0]}' is not known; write control or check")
    labels = list(dict.fromkeys(m[1] for m in marks))
    shots = tuple(Shot(name, None, None, file) for name, file in named(labels))
    rows = [(labels.index(label), j, ji[0], ji[1], np.nan) for j, label, ji in marks]
    return Exchange("GeoJSON control points", path, crs or "EPSG:4326", {}, shots, points_from(path, names, xyz, sigma, role),
                    observations_from(rows))


def _cell(value: float) -> str:
    return "" if np.isnan(value) else repr(float(value))

