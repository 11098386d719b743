"""Runs of a project: runs/<yyyymmdd-hhmmss>-<command>/ with traces as npz arrays and a JSON manifest (never pickle)."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from ..adjustment import LARGE, SCALARS, Iteration, Trace
from ..errors import BadProject, BadTable
from .files import decode_utf8, read_bytes, safe_name, write_atomic, write_json
from .rows import RowReader

RUN = re.compile(r"\d{8}-\d{6}-\w+(-\d+)?")
REDO = "delete this run and compute it again"
FORMAT = "collinea trace 1"
PREVIEW = "mosaic.png"
"""The small picture of its mosaic in a run."""


def new_run(project_folder: Path | str, command: str) -> Path:
    """Make runs/<yyyymmdd-hhmmss>-<command>/ in a project; a number is added when two start in one second."""
    runs = Path(project_folder) / "runs"
    runs.mkdir(exist_ok=True)
    stamp = f"{datetime.now():%Y%m%d-%H%M%S}-{safe_name(command)}"
    for number in range(1, 1000):
        run = runs / (stamp if number == 1 else f"{stamp}-{number}")
        try:
            run.mkdir()
            return run
        except FileExistsError:
            continue
    raise BadProject(f"{runs}: there are too many runs of this second; delete old runs")


def latest_run(project_folder: Path | str, holding: str = "", command: str = "") -> Path | None:
    """The newest run of a project (that holds a file of the given name, of one command), None when there is none."""
    runs = Path(project_folder) / "runs"
    there = [r for r in runs.iterdir() if r.is_dir() and RUN.fullmatch(r.name) and command in ("", r.name.split("-")[2])] \
        if runs.is_dir() else []
    return max((r for r in there if (r / holding).exists()), key=lambda r: _order(r.name), default=None)


def trace_name(image: str, model: str) -> str:
    """Name of the trace of one image and model inside a run."""
    return f"trace-{safe_name(image)}-{model}"


def save_trace(trace: Trace, run_folder: Path | str, name: str = "trace") -> Path:
    """Write a trace as name.npz (x and scalars per row) and name.json (manifest and stop reason); returns the npz path.

    A large one whose rows are there already (rows.bin, written while they were made) gets its name.json alone.
    """
    folder = Path(run_folder)
    if len(trace.last.x) >= LARGE and name == "trace" and (folder / "rows.bin").exists():
        manifest = {**trace.manifest, "stop": trace.last.stop, "rows": len(trace), "format": FORMAT, "thin": True}
        write_json(folder / f"{name}.json", manifest)
        return folder / "rows.bin"
    arrays: dict[str, Any] = {"x": trace.column("x"), "index": trace.column("index"), **{k: trace.column(k) for k in SCALARS}}
    path = folder / f"{name}.npz"
    write_atomic(path, lambda stream: np.savez(stream, **arrays))
    manifest = {**trace.manifest, "stop": trace.last.stop, "rows": len(trace), "format": FORMAT}
    write_json(folder / f"{name}.json", manifest)
    return path


OBSERVATIONS = "observations.npz"
"""File of a run that holds the residuals of a large block."""


def save_arrays(arrays: Mapping[str, np.ndarray], path: Path) -> None:
    """Write named arrays as one npz file, atomically."""
    write_atomic(path, lambda stream: np.savez(stream, **arrays))  # type: ignore[arg-type]


def load_residuals(run_folder: Path | str) -> dict[str, list[dict[str, Any]]]:
    """The residuals of every image as result.json has them, from observations.npz of a large block. Raises BadProject."""
    path, out = Path(run_folder) / OBSERVATIONS, {}
    try:
        with np.load(path, allow_pickle=False) as file:
            a = dict(file)
        images, points = a["images"].tolist(), a["points"].tolist()
        out = {name: [] for name in images}
        names = ("residuals", "redundancy", "w", "detectable", "effect")
        rows = zip(a["image"].tolist(), a["point"].tolist(), a["used"].tolist(), *(_finite(a[n]) for n in names), strict=True)
        for image, point, used, (col, row), redundancy, w, detectable, effect in rows:
            out[images[image]].append({"point": points[point], "col": col, "row": row, "redundancy": redundancy, "w": w,
                                       "used": used, "detectable_px": detectable, "effect_sigma": effect})
    except (OSError, ValueError, KeyError, IndexError, EOFError, BadZipFile) as error:
        raise BadProject(f"{path}: it cannot be read ({type(error).__name__}: {error}); {REDO}") from None
    return out


def _finite(values: np.ndarray) -> list[list[float | None]]:
    """Rows of numbers, None where they are not finite."""
    return [[v if np.isfinite(v) else None for v in row] for row in values.tolist()]


def load_trace(run_folder: Path | str, name: str = "trace") -> Trace:
    """The trace that `save_trace` wrote. Raises BadProject when it is missing or damaged."""
    folder = Path(run_folder)
    manifest = dict(_manifest(folder / f"{name}.json"))
    stop, rows = manifest.pop("stop", None), manifest.pop("rows", None)
    if manifest.pop("format", None) != FORMAT:
        raise BadProject(f"{folder / name}.json: this is not a trace of this version of Collinea; {REDO}")
    if manifest.pop("thin", False):
        kept = list(RowReader(folder).rows())
        if len(kept) != rows or not kept:
            raise BadProject(f"{folder / 'rows.bin'}: its rows do not agree with {name}.json; {REDO}")
        return Trace((*kept[:-1], replace(kept[-1], stop=stop)), manifest)
    path = folder / f"{name}.npz"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            columns = {k: arrays[k] for k in ("x", "index", *SCALARS)}
    except FileNotFoundError:
        raise BadProject(f"{path}: there is no such file; {REDO}") from None
    except (KeyError, ValueError, EOFError, BadZipFile) as error:
        raise BadProject(f"{path}: the file is damaged ({error}); {REDO}") from None
    if any(len(c) != rows for c in columns.values()) or not rows:
        raise BadProject(f"{path}: its rows do not agree with {name}.json; {REDO}")
    return Trace(tuple(_row(columns, i, stop if i == rows - 1 else None) for i in range(rows)), manifest)


def _row(columns: Mapping[str, np.ndarray], i: int, stop: str | None) -> Iteration:
    scalars: dict[str, Any] = {k: float(columns[k][i]) for k in SCALARS if k != "trials"}
    return Iteration(index=int(columns["index"][i]), x=columns["x"][i], trials=int(columns["trials"][i]), stop=stop, **scalars)


def _manifest(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(decode_utf8(path, read_bytes(path, REDO)))
    except ValueError as error:
        raise BadProject(f"{path}: this is not JSON ({error}); {REDO}") from None
    except BadTable as error:
        raise BadProject(str(error)) from None
    if not isinstance(value, dict):
        raise BadProject(f"{path}: expected an object; {REDO}")
    return value


def _order(name: str) -> tuple[str, int]:
    """Runs by time, then by the number added within one second."""
    number = re.fullmatch(r"(\d{8}-\d{6})-\w+?(?:-(\d+))?", name)
    return (number[1], int(number[2] or 1)) if number else (name, 0)


