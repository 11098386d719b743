"""The walks around a block: adjust it, calibrate its cameras; every row is in the run while it is made."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from .adjustment import LARGE, Iteration, Options, Trace
from .block import Block
from .cameras import PARAMETERS
from .errors import BadProject, DegenerateGeometry
from .io import (
    OBSERVATIONS,
    RowReader,
    RowWriter,
    latest_run,
    load_trace,
    new_run,
    read_bal,
    read_corners,
    read_project,
    save_arrays,
    save_trace,
    write_json,
)
from .orientation import Adjusted, BundleRequest, CornerControl, adjust, with_corners
from .orientation.bundle import MANY, MOST, Begun, Stopped, Watch

BundleRecorder = Callable[[Path, Block, Adjusted], object]
"""record(path, block, adjusted): writes recording.rrd."""
RUNNING = "running"
"""File of a run while rows are still to come: the number of the process that makes them."""


class LiveRecording(Protocol):
    """A recording that grows row by row."""

    def row(self, row: Iteration) -> None:
        """One more."""
        ...

    def close(self) -> None:
        """No more."""
        ...


LiveRecorder = Callable[[Path, Block, Mapping[str, Any], np.ndarray], LiveRecording]
"""live(path, block, manifest, x0): begins recording.rrd."""

BAL: dict[str, Any] = {"datum": "free", "free": ("c", "k1", "k2"), "start": "given"}
IN_THE_LARGE = Options(max_iterations=100, max_trials=20, step_tolerance=1e-6, cost_tolerance=1e-9)
"""Points near infinity make such problems end slowly, at a cost that no longer falls."""


class AdjustedProject(NamedTuple):
    """An adjusted block and the run it left."""

    block: Block
    result: Adjusted
    run: Path | None

    def to_json(self) -> dict[str, Any]:
        """The JSON of the commands adjust and calibrate; of large blocks the residuals stay beside it in the run."""
        beside = self.run is not None and (self.run / OBSERVATIONS).exists()
        return {**self.result.to_json(residuals=not beside), **({"observations_file": OBSERVATIONS} if beside else {}),
                "run": None if self.run is None else str(self.run)}


class StoppedRun(NamedTuple):
    """An adjustment that a person stopped: the run with the rows so far, and the last of them."""

    run: Path
    last: Iteration


def adjust_project(folder: Path | str, command: str = "adjust", recorder: BundleRecorder | None = None,
                   corners: str | None = None, live: LiveRecorder | None = None, further: str | None = None,
                   **options: Any) -> AdjustedProject | StoppedRun:
    """Adjust all images of a project together and leave a run: rows and recording.rrd as they are made, trace, result.json.

    corners: a file of image corners as control. further: RUN or RUN:ROW to continue, with the options of that run. options: as in
    `BundleRequest`. Raises PhotogrammetryError; then no run is left.
    """
    folder = Path(folder)
    block, begun = read_project(folder), None
    if further is not None:
        begun, options = begun_of(folder, further)
    elif corners is not None:
        block, options = _by_corners(block, corners, options)
    options, said = _with_datum(block, options)
    run = new_run(folder, command)
    rows = Rows(run, block, live)
    try:
        result = adjust_block(block, watch=rows, begun=begun, **options)
        done = leave_run(folder, command, block, replace(result, warnings=(*said, *result.warnings)), recorder, run)
    except KeyboardInterrupt as stopped:
        if rows.last is None:
            _dropped(run)
            raise
        if isinstance(stopped, Stopped):
            save_trace(stopped.trace, run)
        return StoppedRun(run, rows.last)
    except BaseException:
        _dropped(run)
        raise
    finally:
        rows.close()
    return done


def _with_datum(block: Block, options: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The options with a datum where they leave it to the project, and what to say of it."""
    if options.get("datum") is not None:
        return options, []
    if block.datum != "prior":
        return {**options, "datum": "control"}, []
    return {**options, "datum": "prior"}, [f"there is no control: the positions (GPS) of {block.placed} images hold the block "
                                           "(datum prior)"]


def _dropped(run: Path) -> None:
    """Leave nothing of a run, nor a folder of runs that it would have been the first in."""
    shutil.rmtree(run, ignore_errors=True)
    with suppress(OSError):
        run.parent.rmdir()


class Rows(Watch):
    """Rows of an adjustment, written to its run and its recording as they come."""

    def __init__(self, run: Path, block: Block, live: LiveRecorder | None) -> None:
        self._run, self._block, self._live = run, block, live
        self._writer: RowWriter | None = None
        self._recording: LiveRecording | None = None
        self.last: Iteration | None = None
        (run / RUNNING).write_text(f"{os.getpid()}\n", encoding="ascii")

    def begin(self, manifest: Mapping[str, Any], x0: np.ndarray) -> None:
        self._end()
        head = 12 * len(manifest["images"]) + len(PARAMETERS) * len(manifest["cameras"])
        self._writer = RowWriter(self._run, manifest, head, len(x0))
        if self._live is not None:
            self._recording = self._live(self._run / "recording.rrd", self._block, manifest, x0)

    def row(self, row: Iteration) -> None:
        if self._writer is not None:
            self._writer.add(row)
            self.last = row
        if self._recording is not None:
            self._recording.row(row)

    def _end(self) -> None:
        for part in (self._writer, self._recording):
            if part is not None:
                part.close()
        self._writer = self._recording = None

    def close(self) -> None:
        """The run is told to be at its end."""
        self._end()
        (self._run / RUNNING).unlink(missing_ok=True)


def is_running(run: Path) -> bool:
    """Whether the adjustment of a run is still going on."""
    try:
        process = int((run / RUNNING).read_text(encoding="ascii"))
        if os.name == "posix":
            os.kill(process, 0)  # raises where there is no such process
    except (OSError, ValueError):
        return False
    return True


def leave_run(folder: Path, command: str, block: Block, result: Adjusted, recorder: BundleRecorder | None = None,
              run: Path | None = None) -> AdjustedProject:
    """Keep an adjusted block as a run of a project (a new one, or the one given): trace, covariances, result.json,
    recording.rrd; all of it or nothing."""
    fresh, run = run is None, new_run(folder, command) if run is None else run
    try:
        if len(result.trace.last.x) >= LARGE and not (run / "rows.bin").exists():
            rows = Rows(run, block, None)
            rows.begin(result.trace.manifest, result.trace.rows[0].x)
            for row in result.trace.rows:
                rows.row(row)
            rows.close()
        save_trace(result.trace, run)
        if (run / "trace.npz").exists():
            for name in ("rows.bin", "rows.json"):
                (run / name).unlink(missing_ok=True)
        if len(result.points) > MOST:  # too many for the JSON
            save_arrays(result.covariances(), run / "covariance.npz")
        if sum(len(o.points) for o in result.orientations) > MANY:
            save_arrays(result.observations(), run / OBSERVATIONS)
        if recorder is not None:
            recorder(run / "recording.rrd", block, result)
        done = AdjustedProject(block, result, run)
        write_json(run / "result.json", done.to_json(), None if (run / OBSERVATIONS).exists() else 1)
    except BaseException:
        if fresh:
            shutil.rmtree(run, ignore_errors=True)
        raise
    return done


def begun_of(folder: Path, further: str) -> tuple[Begun, dict[str, Any]]:
    """Where RUN or RUN:ROW of a project is continued, and the options it was adjusted with. RUN: a name or a path, nothing for
    the latest run with rows. Raises BadProject."""
    name, _, row = further.rpartition(":") if further.rpartition(":")[2].isdecimal() else (further, "", "")
    run = latest_with_rows(folder) if not name else next((p for p in (folder / "runs" / name, Path(name)) if p.is_dir()), None)
    if run is None:
        raise BadProject(f"{folder / 'runs'}: there is no run {name or 'with rows of an adjustment'} to continue; adjust the "
                         "project first")
    if (run / "rows.json").exists():
        reader = RowReader(run)
        manifest, last = reader.manifest, len(reader) - 1
        first, x = reader.first(), reader.row(int(row) if row else last).x
    else:
        trace = load_trace(run)
        if row and int(row) >= len(trace):
            raise BadProject(f"{run}: there is no row {row}; rows 0 to {len(trace) - 1} are there")
        manifest, first, x = trace.manifest, trace.rows[0].x, trace.rows[int(row) if row else -1].x
    if manifest.get("problem") != "bundle" or "request" not in manifest:
        raise BadProject(f"{run}: this is no run of an adjustment that can be continued; adjust the project anew")
    return Begun(manifest, first, x), options_of(manifest)


def latest_with_rows(folder: Path) -> Path | None:
    """The newest run of an adjustment that holds rows, at work or done."""
    runs = [r for c in ("adjust", "calibrate") for h in ("rows.json", "trace.npz") if (r := latest_run(folder, h, c)) is not None]
    return max(runs, key=lambda r: r.name, default=None)


def options_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The options, as in `BundleRequest`, behind a manifest."""
    said = dict(manifest["request"])
    free = said["free"]
    said["free"] = {c: tuple(f) for c, f in free.items()} if isinstance(free, dict) else tuple(free)
    said["images"] = None if said["images"] is None else tuple(said["images"])
    said["per_image"] = tuple(said["per_image"]) if isinstance(said["per_image"], list) else said["per_image"]
    return said


def _by_corners(block: Block, path: str, options: dict[str, Any]) -> tuple[Block, dict[str, Any]]:
    """The block with its image corners as weighted control, and the datum they belong to. Raises BadProject."""
    block = with_corners(block, [CornerControl(*c) for c in read_corners(path, block.crs)])
    if options.get("datum") == "free":
        raise BadProject("--datum free takes no control; leave it out, or leave out --corners")
    has_control = bool(len(block.observations)) and "control" in {block.points.role[j] for j in block.observations.point.tolist()}
    if options.get("datum") in (None, "control"):
        options = {**options, "datum": "both" if has_control else "prior"}
    return block, options


def adjust_bal(path: Path | str, **options: Any) -> AdjustedProject:
    """Adjust a problem in the large from its own start, free network, f, k1, k2 of every image; leaves no run.

    options: as in `BundleRequest`, in place of these. Raises PhotogrammetryError.
    """
    block = read_bal(path)
    return AdjustedProject(block, adjust_block(block, IN_THE_LARGE, **{**BAL, **options}), None)


def adjust_block(block: Block, engine: Options | None = None, watch: Watch | None = None, begun: Begun | None = None,
                 **options: Any) -> Adjusted:
    """Prepare, iterate, conclude. Raises PhotogrammetryError, also where numbers run out of range."""
    try:
        return adjust(block, BundleRequest(**options), engine, watch, begun)
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometry(f"{block.name}: the numbers do not fit together ({error}); look for a point, a pixel or a "
                                 "camera value that is wrong by far, or try --robust") from None


__all__ = ["AdjustedProject", "StoppedRun", "Trace", "adjust_bal", "adjust_block", "adjust_project", "begun_of", "leave_run"]
