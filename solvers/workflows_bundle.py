"""The walks around a block: adjust it, calibrate its cameras."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .adjustment import Options
from .block import Block
from .errors import BadProject, DegenerateGeometry
from .io import new_run, read_bal, read_corners, read_project, save_trace, write_json
from .orientation import Adjusted, BundleRequest, CornerControl, adjust, with_corners

BundleRecorder = Callable[[Path, Block, Adjusted], object]
"""record(path, block, adjusted): writes recording.rrd."""


BAL: dict[str, Any] = {"datum": "free", "free": ("c", "k1", "k2"), "start": "given"}
IN_THE_LARGE = Options(max_iterations=100, max_trials=20, step_tolerance=1e-6, cost_tolerance=1e-9)
"""Points near infinity make such problems end slowly, at a cost that no longer falls."""


class AdjustedProject(NamedTuple):
    """An adjusted block and the run it left."""

    block: Block
    result: Adjusted
    run: Path | None

    def to_json(self) -> dict[str, Any]:
        """The JSON of the commands adjust and calibrate."""
        return {**self.result.to_json(), "run": None if self.run is None else str(self.run)}


def adjust_project(folder: Path | str, command: str = "adjust", recorder: BundleRecorder | None = None,
                   corners: str | None = None, **options: Any) -> AdjustedProject:
    """Adjust all images of a project together and leave a run: trace, result.json, recording.rrd.

    corners: a file of image corners as control. options: as in `BundleRequest`. Raises PhotogrammetryError; then no run is left.
    """
    folder = Path(folder)
    block = read_project(folder)
    if corners is not None:
        block, options = _by_corners(block, corners, options)
    return leave_run(folder, command, block, adjust_block(block, **options), recorder)


def leave_run(folder: Path, command: str, block: Block, result: Adjusted,
              recorder: BundleRecorder | None = None) -> AdjustedProject:
    """Keep an adjusted block as a run of a project: trace, result.json, recording.rrd; all of it or nothing."""
    run = new_run(folder, command)
    try:
        save_trace(result.trace, run)
        if recorder is not None:
            recorder(run / "recording.rrd", block, result)
        done = AdjustedProject(block, result, run)
        write_json(run / "result.json", done.to_json())
    except BaseException:
        shutil.rmtree(run, ignore_errors=True)
        raise
    return done


def _by_corners(block: Block, path: str, options: dict[str, Any]) -> tuple[Block, dict[str, Any]]:
    """The block with its image corners as weighted control, and the datum they belong to. Raises BadProject."""
    block = with_corners(block, [CornerControl(*c) for c in read_corners(path, block.crs)])
    if options.get("datum") == "free":
        raise BadProject("--datum free takes no control; leave it out, or leave out --corners")
    has_control = bool(len(block.observations)) and "control" in {block.points.role[j] for j in block.observations.point.tolist()}
    if options.get("datum", "control") == "control":
        options = {**options, "datum": "both" if has_control else "prior"}
    return block, options


def adjust_bal(path: Path | str, **options: Any) -> AdjustedProject:
    """Adjust a problem in the large from its own start, free network, f, k1, k2 of every image; leaves no run.

    options: as in `BundleRequest`, in place of these. Raises PhotogrammetryError.
    """
    block = read_bal(path)
    return AdjustedProject(block, adjust_block(block, IN_THE_LARGE, **{**BAL, **options}), None)


def adjust_block(block: Block, engine: Options | None = None, **options: Any) -> Adjusted:
    """Prepare, iterate, conclude. Raises PhotogrammetryError, also where numbers run out of range."""
    try:
        return adjust(block, BundleRequest(**options), engine)
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometry(f"{block.name}: the numbers do not fit together ({error}); look for a point, a pixel or a "
                                 "camera value that is wrong by far, or try --robust") from None
