"""The project folder: project.toml, points.csv, observations.csv, truth.json <-> Block."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..block import ROLES, Block, Observations, Points
from ..errors import BadProject, BadTable
from .description import ORIGINS, describe, read_description, to_toml
from .files import decode_utf8, read_bytes, write_json, write_text
from .tables import Row, numbers, read_columns, read_table

POINT_COLUMNS = ("name", "X", "Y", "Z", "sX", "sY", "sZ", "role")
OBSERVATION_COLUMNS = ("image", "point", "col", "row", "sigma")


def read_project(folder: Path | str) -> Block:
    """The block of a project folder; pixels refer to the centre of the top-left pixel, empty cells are NaN.

    Raises BadProject or BadTable with one sentence naming the file, the line or table, the item and the cure.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "this is a file, not a project folder" if folder.exists() else "there is no such folder"
        raise BadProject(f"{folder}: {what}; give the folder that holds project.toml")
    block, origin = read_description(folder / "project.toml")
    block = replace(block, points=_read_points(folder / "points.csv"))
    if not (folder / "observations.csv").exists() and not block.images:
        return block
    return replace(block, observations=_read_observations(folder / "observations.csv", block, origin))


def write_project(block: Block, folder: Path | str, *, truth: Mapping[str, Any] | None = None,
                  pixel_origin: str = "center") -> None:
    """Write a block as a project folder that `read_project` reads back unchanged; each file appears whole or not at all.

    truth: what truth.json says ({"images": .., "cameras": .., "points": ..}), only for simulated projects.
    """
    if pixel_origin not in ORIGINS:
        raise BadProject(f"pixel origin '{pixel_origin}' is not known; choose center or corner")
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "points.csv", _points_table(block.points))
    write_text(folder / "observations.csv", _observations_table(block, pixel_origin))
    if truth is not None:
        write_json(folder / "truth.json", truth)
    write_text(folder / "project.toml", to_toml(describe(block, pixel_origin)))


def write_observations(block: Block, folder: Path | str) -> None:
    """Replace observations.csv of a project by the observations of a block, in the pixel origin the project states."""
    folder = Path(folder)
    _, origin = read_description(folder / "project.toml")
    write_text(folder / "observations.csv", _observations_table(block, origin))


def write_tables(block: Block, folder: Path | str) -> None:
    """Replace points.csv and observations.csv of a project by those of a block; project.toml stays as it is."""
    write_text(Path(folder) / "points.csv", _points_table(block.points))
    write_observations(block, folder)


def write_observation_table(path: Path, images: Sequence[str], points: Sequence[str], pixel: np.ndarray,
                            sigma: np.ndarray) -> None:
    """Write observations as a table of their own: names, pixel (n, 2) from the centre of the top-left pixel, sigma (n,) px."""
    rows = [[i, p, *map(_cell, at), _cell(s)] for i, p, at, s in zip(images, points, pixel, sigma, strict=True)]
    write_text(path, _table(OBSERVATION_COLUMNS, rows))


def read_truth(folder: Path | str) -> dict[str, Any] | None:
    """What truth.json of a simulated project says, None where there is none. Raises BadProject."""
    path = Path(folder) / "truth.json"
    if not path.exists():
        return None
    try:
        truth = json.loads(decode_utf8(path, read_bytes(path, "delete it or simulate the project again")))
    except ValueError as error:
        raise BadProject(f"{path}: this is not JSON ({error}); delete it or simulate the project again") from None
    if not isinstance(truth, dict):
        raise BadProject(f"{path}: expected an object with images, cameras and points; delete it or simulate the project again")
    return truth


def _read_points(path: Path) -> Points:
    """Points in file order."""
    if (plain := _plain_points(path)) is not None:
        return plain
    rows = read_table(path, (*POINT_COLUMNS[:4], "role"), POINT_COLUMNS[4:7])
    lines: dict[str, int] = {}
    for row in rows:
        name = row.text("name")
        if name in lines:
            raise row.error(f"point '{name}' is already in line {lines[name]}; remove or rename one of them")
        lines[name] = row.line
    roles = tuple(_role(row) for row in rows)
    xyz = np.array([[row.number(k, "metres") for k in "XYZ"] for row in rows]).reshape(-1, 3)
    for row, role, values in zip(rows, roles, xyz, strict=True):
        if role != "tie" and not np.isfinite(values).all():
            axis = "XYZ"[int(np.argmin(np.isfinite(values)))]
            raise row.error(f"{role} point '{row.text('name')}' has no {axis}; fill it in, or give the point the role tie")
    sigma = np.array([[row.number(k, "a standard error in metres", lowest=0) for k in ("sX", "sY", "sZ")] for row in rows])
    group = tuple(row.cells.get("group", "") for row in rows)
    return Points(tuple(lines), xyz, sigma.reshape(-1, 3), roles, group if any(group) else ())


def _plain_points(path: Path) -> Points | None:
    """The points of a table in which nothing is wrong or unusual, all at once; None of any other."""
    cells = read_columns(path, (*POINT_COLUMNS[:4], "role"), (*POINT_COLUMNS[4:7], "group"))
    if cells is None or not all(cells["name"]) or not set(cells["role"]) <= set(ROLES):
        return None
    columns = [numbers(cells[k]) for k in POINT_COLUMNS[1:7]]
    if any(c is None for c in columns):
        return None
    values, roles, group = np.stack(columns, axis=1), tuple(cells["role"]), tuple(cells["group"])  # type: ignore[arg-type]
    bare = ~np.isfinite(values[:, :3]).all(axis=1) & (np.array(roles, str) != "tie")
    if bare.any() or (values[:, 3:] < 0).any() or len(set(cells["name"])) < len(roles):
        return None
    return Points(tuple(cells["name"]), values[:, :3].copy(), values[:, 3:].copy(), roles, group if any(group) else ())


def _role(row: Row) -> str:
    role = row.cells["role"]
    if role not in ROLES:
        raise row.error(f"role of point '{row.text('name')}' is '{role}'; write control, check or tie")
    return role


def _read_observations(path: Path, block: Block, origin: str) -> Observations:
    if (plain := _plain_observations(path, block, origin)) is not None:
        return plain
    rows = read_table(path, OBSERVATION_COLUMNS[:4], OBSERVATION_COLUMNS[4:])
    images = {image.name: i for i, image in enumerate(block.images)}
    points = {name: i for i, name in enumerate(block.points.names)}
    shift = 0.5 if origin == "corner" else 0.0
    seen: dict[tuple[int, int], int] = {}
    pixel, sigma = np.empty((len(rows), 2)), np.empty(len(rows))
    for n, row in enumerate(rows):
        i = _known(row, "image", images, "add [images.NAME] to project.toml")
        j = _known(row, "point", points, "add it to points.csv, with role tie and empty X, Y, Z if its position is not known")
        if (i, j) in seen:
            raise row.error(f"point '{row.text('point')}' in image '{row.text('image')}' is already in line {seen[i, j]}; remove "
                            "one of them")
        seen[i, j] = row.line
        pixel[n] = row.required("col", "pixels") - shift, row.required("row", "pixels") - shift
        sigma[n] = row.number("sigma", "a standard error in pixels", above=0)
        camera = block.cameras[block.images[i].camera]
        if not camera.inside(pixel[n]):
            raise row.error(f"point '{row.text('point')}' at col {row.cells['col']}, row {row.cells['row']} lies outside image "
                            f"'{row.text('image')}' of {camera.width} x {camera.height} pixels; correct the pixel, or width and "
                            "height of "
                            f"[cameras.{block.images[i].camera}] in project.toml")
    index = np.array(list(seen), int).reshape(-1, 2)
    return Observations(index[:, 0].copy(), index[:, 1].copy(), pixel, sigma)


def _plain_observations(path: Path, block: Block, origin: str) -> Observations | None:
    """The observations of a table in which nothing is wrong or unusual, all at once; None of any other."""
    cells = read_columns(path, OBSERVATION_COLUMNS[:4], OBSERVATION_COLUMNS[4:])
    if cells is None:
        return None
    col, row, sigma = (numbers(cells[k]) for k in OBSERVATION_COLUMNS[2:])
    if col is None or row is None or sigma is None:
        return None
    images, points = ({name: k for k, name in enumerate(names)} for names in ((i.name for i in block.images), block.points.names))
    image = np.array([images.get(name, -1) for name in cells["image"]], int)
    point = np.array([points.get(name, -1) for name in cells["point"]], int)
    pixel = np.column_stack([col, row]) - (0.5 if origin == "corner" else 0.0)
    if (image < 0).any() or (point < 0).any() or not np.isfinite(pixel).all() or (sigma <= 0).any():
        return None
    key = np.sort(image * len(block.points) + point)
    of = np.array([i.camera for i in block.images], str)[image]
    inside = all(camera.inside(pixel[of == name]).all() for name, camera in block.cameras.items())
    return Observations(image, point, pixel, sigma) if inside and (np.diff(key) > 0).all() else None


def _known(row: Row, column: str, index: Mapping[str, int], cure: str) -> int:
    name = row.text(column)
    if name not in index:
        raise row.error(f"there is no {column} '{name}' in the project; correct the name or {cure}")
    return index[name]


def _points_table(points: Points) -> str:
    rows: list[Sequence[str]] = []
    for j, name in enumerate(points.names):
        group = [points.group[j]] if points.group else []
        rows.append([name, *map(_cell, points.xyz[j]), *map(_cell, points.sigma[j]), points.role[j], *group])
    return _table((*POINT_COLUMNS, "group") if points.group else POINT_COLUMNS, rows)


def _observations_table(block: Block, origin: str) -> str:
    of, shift = block.observations, 0.5 if origin == "corner" else 0.0
    return _table(OBSERVATION_COLUMNS, [
        [block.images[of.image[n]].name, block.points.names[of.point[n]], *map(_cell, of.pixel[n] + shift), _cell(of.sigma[n])]
        for n in range(len(of))])


def _cell(value: float) -> str:
    """Shortest text that reads back as the same number; empty for NaN."""
    return "" if np.isnan(value) else repr(float(value))


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    for n, row in enumerate(rows):
        broken = [c for c in row if c != c.strip() or "\n" in c or "\r" in c]
        if broken:
            raise BadTable(f"row {n + 1} of the table to write: {broken[0]!r} has blanks around it or line breaks; rename it")
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([header, *rows])
    return out.getvalue()
