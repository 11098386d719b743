"""The Bundle tab's long work, done in another process: the adjustment row by row, what its end is worth, a run of it."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from solvers import Block, DegenerateGeometry
from solvers.adjustment import Iteration, Trace, iterate, thin
from solvers.geometry import LocalFrame

from .bundle_values import Ended, Judged, Kept, Layout, layout_of, stopped_at
from .rerun_shown import EVERYTHING, Shown

SILENT = "stopped"
"""The stop reason of a trace that a person ended."""


@dataclass
class _Last:
    """What the process did last, so that to keep it nothing is adjusted again."""

    rows: tuple[Iteration, ...] = ()
    block: Block | None = None
    adjusted: Any = None


LAST = _Last()


def bundle_work(block: Block, options: dict[str, Any], frame: LocalFrame,
                begun: tuple[Mapping[str, Any], np.ndarray, np.ndarray] | None = None, upto: int | None = None
                ) -> Iterator[str | Layout | Iteration | Judged | Ended]:
    """Words, how rows are read, every row (thin while others follow), and what the last one is worth. options: of a
    `BundleRequest`; begun: manifest, x of the first row and of that to go on from; upto: row to stop at, of which nothing is
    worked out.

    Raises PhotogrammetryError.
    """
    from solvers.orientation.bundle import Begun, BundleRequest, prepare_bundle

    try:
        start = prepare_bundle(block, BundleRequest(**options), begun and Begun(*begun))
        yield layout_of(start.manifest, start.problem.network.interiors, frame)
        rows: list[Iteration] = []
        began = time.monotonic()
        for row in iterate(start.problem, start.x0, start.options):
            if rows:
                rows[-1] = thin(rows[-1])
            rows.append(row)
            yield row if row.stop else thin(row)
            if row.index == upto and not row.stop:
                yield Ended(stopped_at(row.index))
                return
            if row.index and not row.stop:
                each = (time.monotonic() - began) / row.index
                left = each * (start.options.max_iterations - row.index)
                yield f"Iteration {row.index}, σ0 {row.sigma0:.4g}; {each:.2g} s each, at most {left:.0f} s left"
        yield f"{len(rows) - 1} iterations; standard errors …"
        yield _judged(start, tuple(rows), block, frame)
    except np.linalg.LinAlgError as error:
        raise _misfit(block, error) from None


def _misfit(block: Block, error: Exception) -> DegenerateGeometry:
    return DegenerateGeometry(f"{block.name}: the numbers do not fit together ({error}); look for a point, a pixel or a camera "
                              "value that is wrong by far, or take a robust loss")


POLL = 0.2
"""Seconds between two looks at a run that is being made."""


def follow_work(block: Block, folder: Path, frame: LocalFrame) -> Iterator[Layout | Iteration | str | Judged | Ended]:
    """The rows of the project's latest run, those that are there and those that come, and what its end is worth.

    Raises PhotogrammetryError.
    """
    from solvers import BadProject
    from solvers.io import RowReader, load_trace
    from solvers.orientation.bundle import Begun, BundleRequest, prepare_bundle
    from solvers.workflows_bundle import is_running, latest_with_rows, options_of

    run = latest_with_rows(folder)
    if run is None:
        raise BadProject(f"{folder / 'runs'}: there is no run of an adjustment to follow; start collinea adjust, or Run bundle")
    rows: list[Iteration] = []
    first: np.ndarray | None = None
    reader: RowReader | None = None
    manifest: Mapping[str, Any] = {}
    seen, more = -1, True
    while more:
        more = is_running(run)
        try:
            if (now := (run / "rows.json").stat().st_mtime_ns) != seen or reader is None:  # it has begun, perhaps anew
                reader = RowReader(run)
                seen, rows, first, manifest = now, [], None, reader.manifest
                yield _layout(block, manifest, frame)
            for k in range(len(rows), len(reader)):
                row = reader.row(k, first)
                first = row.x if first is None else first
                rows.append(row if row.stop else thin(row))
                yield rows[-1]
        except FileNotFoundError:  # a small one that is done has its rows in its trace
            break
        if more:
            yield f"Row {len(rows) - 1} of {run.name}; waiting for the next …"
            time.sleep(POLL)
    if (run / "trace.npz").exists():
        trace = load_trace(run)
        if not rows:
            manifest = trace.manifest
            yield _layout(block, manifest, frame)
        yield from trace.rows[len(rows):]
        rows = list(trace.rows)
    if not rows or rows[-1].stop in (None, SILENT):
        yield Ended(f"{run.name} was stopped at row {len(rows) - 1}; go on from any row.")
        return
    yield f"{len(rows) - 1} iterations of {run.name}; standard errors …"
    try:
        start = prepare_bundle(block, BundleRequest(**options_of(manifest)), Begun(manifest, rows[0].x, rows[-1].x))
        yield _judged(start, tuple(rows), block, frame)
    except np.linalg.LinAlgError as error:
        raise _misfit(block, error) from None


def _layout(block: Block, manifest: Mapping[str, Any], frame: LocalFrame) -> Layout:
    """How the rows of a run of this block are read. Raises BadProject where they are of another."""
    from solvers import BadProject

    cameras = [name if name in block.cameras else name.split("@")[0] for name in manifest.get("cameras", ())]
    if manifest.get("problem") != "bundle" or not cameras or any(c not in block.cameras for c in cameras):
        raise BadProject("the latest run is of other cameras than the project has now; adjust it anew")
    return layout_of(manifest, tuple(block.cameras[c] for c in cameras), frame)


def keep_work(block: Block, options: dict[str, Any], rows: tuple[Iteration, ...], folder: Path,
              manifest: Mapping[str, Any], shown: Shown = EVERYTHING) -> Iterator[Kept]:
    """The bundle of these rows as a run of the project. shown: with what its recording opens.

    Raises PhotogrammetryError, also where the folder takes no file.
    """
    from solvers import BadProject
    from solvers.workflows_bundle import leave_run

    from .rerun_bundle import record_bundle, worst_image

    adjusted = adjusted_of(block, options, rows, manifest)
    try:
        run = leave_run(folder, "adjust", block, adjusted, partial(record_bundle, shown=shown))
    except OSError as error:
        raise BadProject(f"the run could not be written ({error}); make room in {folder / 'runs'} or its rights") from None
    yield Kept(str(run.run), worst_image(adjusted))


def adjusted_of(block: Block, options: dict[str, Any], rows: tuple[Iteration, ...], manifest: Mapping[str, Any]) -> Any:
    """The bundle that ended with these rows, as this process did it last or worked out again. Raises PhotogrammetryError."""
    from solvers.orientation.bundle import Begun, BundleRequest, conclude_bundle, prepare_bundle

    if LAST.block is block and _same(LAST.rows, rows):
        return LAST.adjusted
    start = prepare_bundle(block, BundleRequest(**options), Begun(manifest, rows[0].x, rows[-1].x))
    ended = rows if rows[-1].stop else (*rows[:-1], replace(rows[-1], stop=SILENT))
    try:
        return conclude_bundle(start, Trace(ended, start.manifest))
    except np.linalg.LinAlgError as error:
        raise _misfit(block, error) from None


def _same(a: tuple[Iteration, ...], b: tuple[Iteration, ...]) -> bool:
    return len(a) == len(b) and np.array_equal(a[-1].x, b[-1].x)


def _judged(start: Any, rows: tuple[Iteration, ...], block: Block, frame: LocalFrame) -> Judged:
    """Arrays in place of thousands of values, so that they cross to the viewer quickly."""
    from solvers.orientation.bundle import conclude_bundle

    done = conclude_bundle(start, Trace(rows, start.manifest))
    LAST.rows, LAST.block, LAST.adjusted = rows, block, done
    net, turn = start.problem.network, layout_of(start.manifest, start.problem.network.interiors, frame).turn
    order = np.argsort(net.image, kind="stable")
    of = done.orientations
    joined = {name: np.concatenate([getattr(o, name) for o in of]) for name in ("residuals", "w", "redundancy", "used")}
    image, weight = net.image[order], joined["used"][:, None] / net.sigma[order, None] ** 2
    spent = np.bincount(image, joined["redundancy"].sum(axis=1), len(of))
    square = np.bincount(image, (weight * joined["residuals"] ** 2).sum(axis=1), len(of))
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma0 = np.sqrt(square / np.where(spent > 0.5, spent, np.nan))
    exterior = np.array([o.covariance for o in of]).reshape(-1, 6, 6)
    points = done.points
    return Judged(
        values=np.array([[*o.exterior.centre, *np.degrees(o.exterior.angles)] for o in of]).reshape(-1, 6),
        exterior=exterior, image_covariance=turn @ exterior[:, :3, :3] @ turn.T,
        seen=np.bincount(image, minlength=len(of)), rms=np.array([o.rms_px for o in of]), image_sigma0=sigma0,
        image=image, point=net.point[order], pixel=net.pixels[order], v=joined["residuals"], w=joined["w"],
        redundancy=joined["redundancy"], used=joined["used"], roles=tuple(p.role for p in points),
        xyz=np.array([p.xyz for p in points]).reshape(-1, 3),
        covariance=turn @ np.array([p.covariance for p in points]).reshape(-1, 3, 3) @ turn.T,
        off=np.array([p.off for p in points]).reshape(-1, 3) @ turn.T, point_w=np.array([p.w for p in points]).reshape(-1, 3),
        rays=np.array([p.rays for p in points], int), interiors=tuple(done.interiors.values()), freed=done.interior_names,
        interior_covariance=done.interior_covariance, sigma0=done.sigma0, dof=done.dof, rms_px=done.rms_px,
        converged=done.trace.converged, groups=done.groups, control_rms=done.control_rms, check_rms=done.check_rms,
        suspects=done.suspects, warnings=done.warnings, joint=done.joint)
