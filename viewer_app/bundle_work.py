"""The Bundle tab's long work, done in another process: the adjustment row by row, what its end is worth, a run of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from solvers import Block, DegenerateGeometry
from solvers.adjustment import Iteration, Trace, iterate
from solvers.geometry import LocalFrame

from .bundle_state import Judged, Kept, Layout, layout_of

SILENT = "stopped"
"""The stop reason of a trace that a person ended."""


@dataclass
class _Last:
    """What the process did last, so that to keep it nothing is adjusted again."""

    rows: tuple[Iteration, ...] = ()
    block: Block | None = None
    adjusted: Any = None


LAST = _Last()


def bundle_work(block: Block, options: dict[str, Any], frame: LocalFrame, x0: np.ndarray | None = None
                ) -> Iterator[str | Layout | Iteration | Judged]:
    """Words, how rows are read, every row, and what the last one is worth. options: of a `BundleRequest`; x0: begin there.

    Raises PhotogrammetryError.
    """
    from solvers.orientation.bundle import BundleRequest, prepare_bundle

    try:
        start = prepare_bundle(block, BundleRequest(**options))
        yield layout_of(start.manifest, start.problem.network.interiors, frame)
        rows: list[Iteration] = []
        for row in iterate(start.problem, start.x0 if x0 is None else x0, start.options):
            rows.append(row)
            yield row
        yield f"{len(rows) - 1} iterations; standard errors …"
        yield _judged(start, tuple(rows), block, frame)
    except np.linalg.LinAlgError as error:
        raise _misfit(block, error) from None


def _misfit(block: Block, error: Exception) -> DegenerateGeometry:
    return DegenerateGeometry(f"{block.name}: the numbers do not fit together ({error}); look for a point, a pixel or a camera "
                              "value that is wrong by far, or take a robust loss")


def keep_work(block: Block, options: dict[str, Any], rows: tuple[Iteration, ...], folder: Path) -> Iterator[Kept]:
    """The bundle of these rows as a run of the project. Raises PhotogrammetryError, also where the folder takes no file."""
    from solvers import BadProject
    from solvers.orientation.bundle import BundleRequest, conclude_bundle, prepare_bundle
    from solvers.workflows_bundle import leave_run

    from .rerun_bundle import record_bundle

    adjusted = LAST.adjusted if LAST.block is block and _same(LAST.rows, rows) else None
    if adjusted is None:
        start = prepare_bundle(block, BundleRequest(**options))
        ended = rows if rows[-1].stop else (*rows[:-1], replace(rows[-1], stop=SILENT))
        try:
            adjusted = conclude_bundle(start, Trace(ended, start.manifest))
        except np.linalg.LinAlgError as error:
            raise _misfit(block, error) from None
    try:
        run = leave_run(folder, "adjust", block, adjusted, record_bundle)
    except OSError as error:
        raise BadProject(f"the run could not be written ({error}); make room in {folder / 'runs'} or its rights") from None
    yield Kept(str(run.run))


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
        suspects=done.suspects, warnings=done.warnings)
