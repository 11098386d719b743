"""Drawings and pictures' places for other programs: DXF of lines and points, world files, GeoJSON of lines.

DXF is the ASCII form of AutoCAD R12 (AC1009), which every CAD program reads. A world file maps pixel centres: A, D, B, E, then
the map coordinates of the centre of the top-left pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...errors import BadTable
from ..files import safe_name, write_text
from ..sniff import read_text
from ..tables import read_table

LINE_COLUMNS = ("line", "image", "col", "row")


def read_lines(path: Path) -> dict[str, tuple[str, np.ndarray]]:
    """Lines drawn in photos, a table line,image,col,row of vertices: image and pixels (k, 2) by name. Raises BadTable."""
    out: dict[str, tuple[str, list[list[float]]]] = {}
    for row in read_table(path, LINE_COLUMNS):
        name, image = row.text("line"), row.text("image")
        if name in out and out[name][0] != image:
            raise row.error(f"line '{name}' is in image '{out[name][0]}' above and in '{image}' here; give each image its own "
                            f"lines")
        out.setdefault(name, (image, []))[1].append([row.required("col", "pixels"), row.required("row", "pixels")])
    if not out:
        raise BadTable(f"{path}: there is no line in it; write one vertex a line under the header {','.join(LINE_COLUMNS)}")
    return {name: (image, np.array(xy)) for name, (image, xy) in out.items()}


def write_dxf(path: Path, lines: Mapping[str, Sequence[tuple[str, np.ndarray, bool]]],
              points: Mapping[str, Sequence[tuple[str, np.ndarray]]],
              text_height: float = 1.0) -> None:
    """A drawing. lines: by layer, name, vertices (k, 3) [m] and whether closed; points: by layer, name and place (3,) [m]."""
    every = [xyz for rows in lines.values() for _, xyz, _ in rows] + [at[None] for rows in points.values() for _, at in rows]
    if not every:
        raise BadTable(f"{path}: there is nothing to draw; give lines with --lines, or a project with points")
    both = np.vstack(every)
    out = ["0", "SECTION", "2", "HEADER", "9", "$ACADVER", "1", "AC1009", *_corner("$EXTMIN", both.min(axis=0)),
           *_corner("$EXTMAX", both.max(axis=0)), "0", "ENDSEC", "0", "SECTION", "2", "TABLES"]
    layers = [*lines, *(p for p in points if p not in lines)]
    out += ["0", "TABLE", "2", "LAYER", "70", str(len(layers))]
    for n, layer in enumerate(layers):
        out += ["0", "LAYER", "2", _layer(layer), "70", "0", "62", str(n % 6 + 1), "6", "CONTINUOUS"]
    out += ["0", "ENDTAB", "0", "ENDSEC", "0", "SECTION", "2", "ENTITIES"]
    for layer, rows in lines.items():
        for _, xyz, closed in rows:
            out += ["0", "POLYLINE", "8", _layer(layer), "66", "1", "70", str(8 + closed), "10", "0.0", "20", "0.0", "30", "0.0"]
            for p in xyz:
                out += ["0", "VERTEX", "8", _layer(layer), *_xyz(p), "70", "32"]
            out += ["0", "SEQEND", "8", _layer(layer)]
    for layer, marks in points.items():
        for name, at in marks:
            out += ["0", "POINT", "8", _layer(layer), *_xyz(at), "0", "TEXT", "8", _layer(layer), *_xyz(at), "40",
                    repr(text_height), "1",
                    name.replace("\n", " ")]
    write_text(path, "\n".join([*out, "0", "ENDSEC", "0", "EOF"]) + "\n")


def read_dxf_lines(path: Path) -> dict[str, list[np.ndarray]]:
    """Vertices (k, 3) of the polylines of a drawing by layer. Raises BadTable for what is no DXF in text."""
    words = [w.strip() for w in read_text(path).splitlines()]
    if len(words) % 2 or words[:2] != ["0", "SECTION"] or words[-2:] != ["0", "EOF"]:
        raise BadTable(f"{path}: this is not a whole DXF file in text form; save it as DXF R12 ASCII")
    out: dict[str, list[np.ndarray]] = {}
    line: list[list[float]] | None = None
    kind, at, layer = "", [0.0] * 3, ""
    for code, value in [*zip(words[::2], words[1::2], strict=True), ("0", "")]:
        if code == "0":
            if kind == "VERTEX" and line is not None:
                line.append(list(at))
            if value == "POLYLINE":
                line = []
            elif value == "SEQEND" and line is not None:
                out.setdefault(layer, []).append(np.array(line))
                line = None
            kind = value
        elif code == "8":
            layer = value
        elif code in ("10", "20", "30"):
            try:
                at["123".index(code[0])] = float(value)
            except ValueError:
                raise BadTable(f"{path}: '{value}' is no coordinate; save it as DXF R12 ASCII") from None
    return out


def _layer(name: str) -> str:
    return safe_name(name).upper()[:31]


def _xyz(p: np.ndarray) -> list[str]:
    return ["10", repr(float(p[0])), "20", repr(float(p[1])), "30", repr(float(p[2]))]


def _corner(name: str, p: np.ndarray) -> list[str]:
    return ["9", name, *_xyz(p)]


# -- world files ----------------------------------------------------------------------------------------------------------


def write_world(path: Path, affine: Sequence[float]) -> None:
    """A world file of an affine a, b, c, d, e, f of pixel edges (GDAL's: x = a col + b row + c with 0, 0 the outer corner)."""
    a, b, c, d, e, f = map(float, affine)
    write_text(path, "".join(f"{v!r}\n" for v in (a, d, b, e, c + (a + b) / 2, f + (d + e) / 2)))


def read_world(path: Path) -> tuple[float, float, float, float, float, float]:
    """The affine of pixel edges of a world file: the inverse of `write_world`. Raises BadTable."""
    cells = read_text(path).split()
    try:
        a, d, b, e, x, y = (float(c.replace(",", ".")) for c in cells)
    except ValueError:
        raise BadTable(f"{path}: a world file is six numbers, one a line, and this is not; write it again") from None
    if not np.isfinite([a, b, d, e, x, y]).all() or a * e - b * d == 0:
        raise BadTable(f"{path}: its six numbers make no pixels; write it again")
    return a, b, x - (a + b) / 2, d, e, y - (d + e) / 2


def fitted_affine(pixels: np.ndarray, ground: np.ndarray) -> tuple[tuple[float, ...], float]:
    """The affine (of pixel edges) that fits ground (n, 2) of pixels (n, 2) best, and the largest misfit [m]."""
    middle = ground.mean(axis=0)
    design = np.column_stack([pixels + 0.5, np.ones(len(pixels))])
    x, *_ = np.linalg.lstsq(design, ground - middle, rcond=None)
    off = np.linalg.norm(design @ x - (ground - middle), axis=1).max()
    (a, d), (b, e), (c, f) = x
    return (a, b, c + middle[0], d, e, f + middle[1]), float(off)
