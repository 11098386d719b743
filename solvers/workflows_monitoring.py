"""The walk from epochs of one network to displacements: adjust each as a free network, compare, leave a run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .adjustment import Trace
from .errors import BadProject, DegenerateGeometry
from .geometry import LocalFrame
from .io import latest_run, load_trace, new_run, read_project, write_json
from .orientation import BundleRequest
from .orientation.bundle.joint import free_epoch
from .orientation.deformation import Comparison, Displacement, Epoch, Pair, compare_epochs
from .workflows_orientation import INPUTS

KEPT = ("free", "loss", "start", "images", "model", "transform")
"""Options of an adjust run that its epoch takes over."""


class ComparedEpochs(NamedTuple):
    """Epochs compared: points of each in the first one's frame [m], what to know of them, and the run that was left."""

    comparison: Comparison
    epochs: tuple[Epoch, ...]
    frame: LocalFrame
    notes: tuple[str, ...]
    run: Path | None

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command compare."""
        c = self.comparison
        return {
            "epochs": [{"name": e.name, "sigma0": e.sigma0, "dof": e.dof, "points": len(e.points)} for e in self.epochs],
            "level": c.level, "level_pair": c.level_pair, "level_single": c.level_single, "datum": list(c.datum),
            "moved": list(c.moved), "pairs": [_pair_json(p) for p in c.pairs],
            "coordinates": {e.name: {n: self.frame.to_map(x).tolist() for n, x in zip(e.points, e.xyz, strict=True)}
                            for e in self.epochs},
            "notes": list(self.notes), "warnings": list(c.warnings), "run": None if self.run is None else str(self.run)}


def compare_projects(folders: Sequence[Path | str], stable: Sequence[str] | None = None, level: float = 0.05,
                     source: str = "auto", **options: Any) -> ComparedEpochs:
    """Compare projects that are epochs of one network with the first of them, and leave a run in the last one.

    source: "auto" adjusts each as its latest adjust run did, beginning at its end, where there is one that is newer than the
    project's files; "now" adjusts all anew. options: of `BundleRequest`, where no run says otherwise. The adjustment is that of a
    free network in any case. Raises PhotogrammetryError; then no run is left.
    """
    epochs, notes, warnings, frame = [], [], [], None
    for folder, name in zip(map(Path, folders), _names(folders), strict=True):
        epoch, frame, said, warned = _epoch(folder, name, frame, source, options)
        epochs.append(epoch)
        notes += [f"{name}: {w}" for w in said]
        warnings += [f"{name}: {w}" for w in warned]
    comparison = compare_epochs(epochs, stable, level)
    comparison = replace(comparison, warnings=(*warnings, *comparison.warnings))
    assert frame is not None
    run = new_run(folders[-1], "compare")
    try:
        done = ComparedEpochs(comparison, tuple(epochs), frame, tuple(notes), run)
        write_json(run / "result.json", done.to_json())
    except BaseException:
        shutil.rmtree(run, ignore_errors=True)
        raise
    return done


def _names(folders: Sequence[Path | str]) -> list[str]:
    """Names of epochs: of their folders, with as much of the path as tells them apart."""
    paths = [Path(f).resolve() for f in folders]
    if len(set(paths)) < len(paths):
        raise BadProject("an epoch is given twice; give each project once")
    for depth in range(1, max((len(p.parts) for p in paths), default=1) + 1):
        names = ["/".join(p.parts[-depth:]) for p in paths]
        if len(set(names)) == len(names):
            return names
    return [str(p) for p in paths]


def _epoch(folder: Path, name: str, frame: LocalFrame | None, source: str,
           options: dict[str, Any]) -> tuple[Epoch, LocalFrame, list[str], tuple[str, ...]]:
    block = read_project(folder)
    if frame is not None and block.crs != frame.crs and not (frame.cartesian and block.frame == "grid"):
        raise BadProject(f"{folder}: its crs is '{block.crs}', that of the first epoch '{frame.crs}'; epochs need one crs")
    trace, said = _run_of(folder) if source == "auto" else (None, [])
    request = BundleRequest(**options) if trace is None else _request(trace, options)
    try:
        epoch, frame, warned = free_epoch(block, request, name, trace, frame)
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometry(f"{folder}: the numbers do not fit together ({error}); look at it with collinea adjust "
                                 "first") from None
    return epoch, frame, said, warned


def _run_of(folder: Path) -> tuple[Trace | None, list[str]]:
    """The trace of the latest adjust (or calibrate) run that is newer than the project's files, and what to say."""
    runs = [r for r in (latest_run(folder, "trace.npz", c) for c in ("adjust", "calibrate")) if r is not None]
    run = max(runs, key=lambda r: r.name, default=None)
    if run is None:
        return None, ["adjusted now"]
    written = (run / "trace.npz").stat().st_mtime
    if any((folder / f).stat().st_mtime > written for f in INPUTS if (folder / f).exists()):
        return None, [f"adjusted now, the run {run.name} is older than the project's files"]
    return load_trace(run), [f"as the run {run.name} adjusted it"]


def _request(trace: Trace, options: dict[str, Any]) -> BundleRequest:
    """The request of a run; options that a person gave win."""
    given = trace.manifest.get("options", {})
    taken = {k: given[k] for k in KEPT if k in given}
    if isinstance(taken.get("free"), dict):
        taken["free"] = {camera: tuple(names) for camera, names in taken["free"].items()}
    taken["images"] = tuple(taken["images"]) if taken.get("images") else None
    return BundleRequest(**{**taken, **options})


# -- JSON ---------------------------------------------------------------------------------------------------------------------


def _pair_json(pair: Pair) -> dict[str, Any]:
    tests = [{"statistic": t.statistic, "critical": t.critical, "dof": [t.h, t.f], "p": t.p, "largest": t.largest,
              "worst": t.worst, "congruent": t.congruent} for t in pair.tests]
    return {"first": pair.first, "second": pair.second, "sigma0": pair.s0, "dof": pair.f, "global_test": tests[0],
            "datum_test": tests[-1], "steps": tests, "removed": list(pair.removed), "stable": list(pair.stable),
            "moved": list(pair.moved), "scale": pair.scale, "points": [_point_json(d) for d in pair.displacements]}


def _point_json(d: Displacement) -> dict[str, Any]:
    sigma = np.sqrt(np.diag(d.covariance))
    return {"name": d.point, **dict(zip(("dX", "dY", "dZ"), map(float, d.d), strict=True)), "length": d.length,
            **dict(zip(("sX", "sY", "sZ"), map(float, sigma), strict=True)), "covariance": d.covariance.tolist(),
            "statistic_over_critical": d.statistic, "p": d.p, "significant": d.moved, "datum": d.datum,
            "ellipsoid_95": {"axes_m": d.axes.tolist(), "directions": d.directions.tolist()}, "detectable_m": d.detectable}


# -- a comparison again -------------------------------------------------------------------------------------------------------


class Movements(NamedTuple):
    """A later epoch against the first, as a run holds it: names; d (n, 3) m; axes (n, 3) m and directions (n, 3, 3) (rows) of
    the 95 % ellipsoids; moved, datum (n,)."""

    epoch: str
    names: tuple[str, ...]
    d: np.ndarray
    axes: np.ndarray
    directions: np.ndarray
    moved: np.ndarray
    datum: np.ndarray


class Monitored(NamedTuple):
    """A comparison as a run holds it: its run, the first epoch's name and points xyz (n, 3) m in the map's coordinates, the later
    epochs, the level of the whole."""

    run: Path
    first: str
    places: dict[str, np.ndarray]
    later: tuple[Movements, ...]
    level: float


def read_comparison(folder: Path | str) -> Monitored | None:
    """The latest comparison that a project holds, None where there is none. Raises BadProject where it is damaged."""
    run = latest_run(folder, "result.json", "compare")
    if run is None:
        return None
    try:
        said = json.loads((run / "result.json").read_text(encoding="utf-8"))
        first = said["epochs"][0]["name"]
        places = {str(n): np.array(x, float).reshape(3) for n, x in said["coordinates"][first].items()}
        later = tuple(_movements(pair, places) for pair in said["pairs"])
        return Monitored(run, str(first), places, later, float(said["level"]))
    except (OSError, ValueError, KeyError, TypeError, IndexError) as error:
        raise BadProject(f"{run / 'result.json'}: it is damaged ({type(error).__name__}: {error}); delete this run and compare "
                         "again") from None


def _movements(pair: dict[str, Any], places: dict[str, np.ndarray]) -> Movements:
    points = [p for p in pair["points"] if p["name"] in places]
    return Movements(
        str(pair["second"]), tuple(str(p["name"]) for p in points),
        np.array([[p["dX"], p["dY"], p["dZ"]] for p in points], float).reshape(-1, 3),
        np.array([p["ellipsoid_95"]["axes_m"] for p in points], float).reshape(-1, 3),
        np.array([p["ellipsoid_95"]["directions"] for p in points], float).reshape(-1, 3, 3),
        np.array([p["significant"] for p in points], bool), np.array([p["datum"] for p in points], bool))
