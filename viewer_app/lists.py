"""Tables of points, images and orientations as values, pure: what is in each cell, how it sorts, what it says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from solvers.block import Image

from .acting import Action, handles
from .actions_points import FIELDS
from .scene import sight
from .state import MODELS, State, by_role, fresh, hopeful, measured

MOST = 400
"""Rows shown at once; the filter finds the others."""


@dataclass(frozen=True)
class Tables:
    """How the tables are looked at. sorting: table -> (column, descending); shown: pattern of names."""

    sorting: Mapping[str, tuple[str, bool]] = field(default_factory=dict)
    shown: str = ""


@dataclass(frozen=True)
class SortBy(Action):
    """By this column; the same again turns the order, a third time takes it away."""

    table: str
    column: str


@dataclass(frozen=True)
class ShowRows(Action):
    """Only rows whose name matches; * and ? stand for any letters, any letter; a part of a name will do."""

    pattern: str


@handles(SortBy)
def _sort(state: State, action: SortBy) -> State:
    known = COLUMNS.get(action.table, ())
    if action.column not in [c.key for c in known]:
        return state
    tables = state.room(Tables)
    before = tables.sorting.get(action.table)
    sorting = dict(tables.sorting)
    if before == (action.column, False):
        sorting[action.table] = (action.column, True)
    elif before == (action.column, True):
        del sorting[action.table]
    else:
        sorting[action.table] = (action.column, False)
    return state.with_room(replace(tables, sorting=sorting))


@handles(ShowRows)
def _shown(state: State, action: ShowRows) -> State:
    return state.with_room(replace(state.room(Tables), shown=action.pattern.strip()[:80]))


@dataclass(frozen=True)
class Column:
    """title and unit as written; hint: what it is; editable: a number that can be typed."""

    key: str
    title: str
    unit: str = ""
    hint: str = ""
    editable: bool = False


POINT_COLUMNS = (
    Column("on", "on", "", "Takes part in the solutions; a click switches it."),
    Column("name", "point", "", "A click chooses the point and flies there."),
    Column("role", "role", "", "Control points orient the images, check points judge them; a click changes it."),
    Column("v", "v", "px", "Length of the residual in the chosen image by the perspective solution, observed − projected."),
    Column("w", "w", "", "Largest standardized residual in the chosen image, at the last row; above 3 a blunder is likely."),
    *(
        Column(
            k,
            k,
            "m",
            f"Map coordinate {k}; type another and press Enter."
            if len(k) == 1
            else f"Standard error of {k[1:]}; empty means the project's default.",
            True,
        )
        for k in FIELDS
    ),
    Column("group", "group", "", "Cluster, column group of points.csv."),
)
IMAGE_COLUMNS = (
    Column("name", "image", "", "A click chooses the image and flies there."),
    Column("status", "status", "", "What has been found for the image."),
    Column("n", "points", "", "Points measured in the image."),
    Column("rms_p", "rms p", "px", "Root mean square residual of the perspective solution."),
    Column("rms_o", "rms o", "px", "Root mean square residual of the orthogonal solution."),
)
ORIENTATION_COLUMNS = (
    Column("name", "image", "", "A click chooses the image and flies there."),
    *(
        Column(k, k, u, f"{k} of the perspective solution, with its standard error.")
        for k, u in (("X", "m"), ("Y", "m"), ("Z", "m"), ("ω", "°"), ("φ", "°"), ("κ", "°"))
    ),
    Column("sigma0", "σ0", "", "Standard error of unit weight, a posteriori; 1 is as expected."),
)
COLUMNS: dict[str, tuple[Column, ...]] = {"points": POINT_COLUMNS, "images": IMAGE_COLUMNS, "orientations": ORIENTATION_COLUMNS}


@dataclass(frozen=True, eq=False)
class Row:
    """name: of the point or image; values: by column, as they sort; numbers or text, NaN or "" where there is none."""

    name: str
    values: Mapping[str, Any]
    chosen: bool = False


def rows_of(state: State, table: str) -> tuple[tuple[Row, ...], int]:
    """The rows shown, sorted, and how many there are that match."""
    rows = {"points": _point_rows, "images": _image_rows, "orientations": _orientation_rows}[table](state)
    tables = state.room(Tables)
    if tables.shown:
        pattern = tables.shown if any(c in tables.shown for c in "*?[") else f"*{tables.shown}*"
        rows = [r for r in rows if fnmatchcase(r.name.lower(), pattern.lower())]
    order = tables.sorting.get(table)
    if order is not None:
        rows = sorted(rows, key=lambda r: sort_key(r.values.get(order[0], "")), reverse=order[1])
        rows = [r for r in rows if not _empty(r, order[0])] + [r for r in rows if _empty(r, order[0])]
    count = len(state.block.images) if table != "points" and not tables.shown else len(rows)
    return tuple(rows[:MOST]), count


def _empty(row: Row, column: str) -> bool:
    value = row.values.get(column, "")
    return value == "" or (isinstance(value, float) and math.isnan(value))


def sort_key(value: Any) -> tuple[Any, ...]:
    """Numbers by size before words; words as people count: G2 before G10."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (0, float(value)) if not math.isnan(value) else (2,)
    if isinstance(value, bool):
        return (0, float(not value))
    parts: list[tuple[int, Any]] = []
    digits = ""
    for letter in str(value).lower() + "\0":
        if letter.isdecimal():
            digits += letter
            continue
        if digits:
            parts.append((0, int(digits)))
            digits = ""
        parts.append((1, letter))
    return 1, tuple(parts)


def _point_rows(state: State) -> list[Row]:
    points, work = state.block.points, state.work
    residuals = {}
    seen = sight(state, MODELS[0])
    if seen is not None:
        residuals = dict(zip(seen.names, np.linalg.norm(seen.residuals, axis=1).tolist(), strict=True))
    solution = state.solution(MODELS[0])
    w: dict[str, float] = {}
    if solution and solution.orientation and state.row_of(solution) == len(solution.rows) - 1:
        found = solution.orientation
        w = dict(zip(found.points, np.abs(np.nan_to_num(found.w)).max(axis=1).tolist(), strict=True))
    rows = []
    for j in by_role(points)["named"].tolist():
        name = points.names[j]
        values = {
            "on": name not in work.off,
            "name": name,
            "role": points.role[j],
            "group": points.group[j] if points.group else "",
            "v": residuals.get(name, math.nan),
            "w": w.get(name, math.nan),
            **dict(zip(FIELDS, (*points.xyz[j].tolist(), *points.sigma[j].tolist()), strict=True)),
        }
        rows.append(Row(name, values, name == state.point))
    return rows


def _image_rows(state: State) -> list[Row]:
    waits = state.held != state.work.revision
    rows = []
    for image, n in _shown_images(state, "images"):
        rms = [s.orientation.rms_px if (s := state.solution(m, image.name)) and s.orientation else math.nan for m in MODELS]
        values = {
            "name": image.name,
            "status": status(state, image.name, n, waits),
            "n": n,
            "rms_p": rms[0],
            "rms_o": rms[1],
        }
        rows.append(Row(image.name, values, image.name == state.image))
    return rows


def _shown_images(state: State, table: str) -> list[tuple[Image, int]]:
    """The images and how many points are measured in each; no more than are shown where no order or pattern asks for all."""
    tables, counts = state.room(Tables), measured(state.block)
    every = tables.shown or table in tables.sorting
    return [(image, counts[image.name]) for image in state.block.images[: None if every else MOST]]


def status(state: State, image: str, measured: int, waits: bool) -> str:
    """What has been found for an image, in a word or two."""
    if not measured:
        return "not measured"
    solutions = [s for m in MODELS if (s := state.solution(m, image))]
    if not solutions and not hopeful(state.work, image):
        return "no solution"
    if waits and not all(fresh(state.work, image, m) for m in MODELS):
        return "waits"
    solved = [s for s in solutions if s.orientation]
    if not solved:
        return "no solution" if solutions else "waits"
    if len(solved) < len(MODELS):
        return "one model"
    return "solved" if all(s.orientation and s.orientation.trace.converged for s in solved) else "not converged"


def _orientation_rows(state: State) -> list[Row]:
    rows = []
    for image, _ in _shown_images(state, "orientations"):
        solution = state.solution(MODELS[0], image.name)
        found = solution.orientation if solution else None
        values: dict[str, Any] = {"name": image.name}
        if found is not None:
            numbers = [*found.exterior.centre.tolist(), *np.degrees(found.exterior.angles).tolist()]
            sigma = [*found.sigma[:3].tolist(), *np.degrees(found.sigma[3:]).tolist()]
            keys = [c.key for c in ORIENTATION_COLUMNS[1:7]]
            values |= dict(zip(keys, numbers, strict=True)) | {f"s{k}": s for k, s in zip(keys, sigma, strict=True)}
            values["sigma0"] = math.nan if found.sigma0 is None else float(found.sigma0)
        rows.append(Row(image.name, values, image.name == state.image))
    return rows


def as_csv(columns: Sequence[Column], rows: Sequence[Row]) -> str:
    """A table as CSV text, units in the heading."""
    import csv
    import io

    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([f"{c.title} [{c.unit}]" if c.unit else c.title for c in columns])
    for row in rows:
        cells = [row.values.get(c.key, "") for c in columns]
        writer.writerow(["" if isinstance(v, float) and math.isnan(v) else repr(v) if isinstance(v, float) else v for v in cells])
    return out.getvalue()
