"""The walks around an oriented image: georeference, intersect, monoplot."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .block import Block
from .errors import BadProject, PhotogrammetryError
from .geometry import Exterior, rotation
from .io import (
    latest_run,
    new_run,
    read_project,
    read_surface,
    save_trace,
    surface_path,
    write_json,
)
from .orientation import Intersected, Known, Monoplotted, Plane, Request, intersect, monoplot, orient
from .orientation.monoplot import Ground

SOURCES = ("auto", "resect", "georeference", "adjust", "prior")
"""Where orientations come from: auto is the latest resect run, and images it lacks are resected; prior takes the priors of
project.toml as they are (an orientation imported from another tool)."""
INPUTS = ("project.toml", "points.csv", "observations.csv")


class Found(NamedTuple):
    """Orientations of a project: its block (with the interior orientations they were computed with), and how they came."""

    block: Block
    known: tuple[Known, ...]
    notes: tuple[str, ...]


# -- intersect and monoplot -----------------------------------------------------------------------------------------------


class IntersectedProject(NamedTuple):
    """Object points, the orientations they rest on, and the run."""

    result: Intersected
    images: tuple[str, ...]
    notes: tuple[str, ...]
    run: Path

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command intersect."""
        return {**self.result.to_json(), "images": list(self.images), "notes": list(self.notes), "run": str(self.run)}


def intersect_project(folder: Path | str, points: Sequence[str] = (), *, robust: bool = False,
                      source: str = "auto") -> IntersectedProject:
    """Object points of a project from its oriented images; leaves a run with the trace and result.json.

    points: names, empty for all that two or more oriented images see. source: as in `SOURCES`.
    """
    folder = Path(folder)
    found = orientations_of(folder, source=source)
    result = intersect(found.block, found.known, points, robust=robust)
    run = new_run(folder, "intersect")
    try:
        save_trace(result.trace, run)
        done = IntersectedProject(result, tuple(k.image for k in found.known), found.notes, run)
        write_json(run / "result.json", done.to_json())
    except BaseException:
        shutil.rmtree(run, ignore_errors=True)
        raise
    return done


class MonoplottedProject(NamedTuple):
    """A ground point, and where the orientation and the ground come from."""

    result: Monoplotted
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command monoplot."""
        return {**self.result.to_json(), "notes": list(self.notes)}


def monoplot_project(folder: Path | str, image: str, pixel: tuple[float, float], *, dem: Path | str | None = None,
                     z: float | None = None, sigma_z: float | None = None, source: str = "auto") -> MonoplottedProject:
    """Ground coordinates of a pixel (col, row) of one image on a DEM, a level plane z, or the project's [surface].

    sigma_z: standard error of the ground's height [m], None: taken as free of error, and said so.
    """
    folder = Path(folder)
    found = orientations_of(folder, (image,), source)
    ground = ground_of(folder, found.block, dem, z, sigma_z or 0.0)
    if ground is None:
        raise BadProject(f"{folder}: the height of the ground is not known; give --dem DEM.tif or --z H, or add [surface] to "
                         "project.toml")
    free = () if sigma_z is not None else ("ground: its height is taken as free of error; give --sigma-z to have that in the "
                                           "ellipse",)
    return MonoplottedProject(monoplot(found.block, found.known[0], pixel, ground), (*found.notes, *free))


def ground_of(folder: Path, block: Block, dem: Path | str | None, z: float | None, sigma: float = 0.0) -> Ground | None:
    """The ground as given (a DEM file or a height), else the project's [surface]; None without any. Raises BadProject."""
    if dem is None and z is None:
        dem, z = surface_path(folder, block), block.surface.get("z")
    if dem is None:
        return None if z is None else Plane(float(z), sigma)
    surface = read_surface(dem, sigma=sigma)
    if surface.grid.crs != block.crs:
        raise BadProject(f"{dem}: its crs is '{surface.grid.crs}' and the project's is '{block.crs}'; warp the DEM to the "
                         "project's crs, or give a height instead of it")
    return surface


# -- orientations of a project ----------------------------------------------------------------------------------------------


def orientations_of(folder: Path, images: Sequence[str] = (), source: str = "auto") -> Found:
    """Perspective orientations of a project's images; images: names that must be there, empty for all that can be had.

    auto: of the latest resect run while the project is not newer than it, the missing ones computed now. resect: all computed
    now. georeference, adjust: of the latest such run. prior: the priors of project.toml as they are. Raises BadProject, and what
    the resection of a wanted image raises.
    """
    block = read_project(folder)
    wanted = tuple(block.images[block.image_index(n)].name for n in images)
    if source == "georeference":
        return _georeferenced(folder, block, wanted)
    if source == "adjust":
        return _adjusted(folder, block, wanted)
    if source == "prior":
        return _priors(folder, block, wanted)
    found = _of_run(folder, block, wanted) if source == "auto" else Found(block, (), ())
    missing = [n for n in wanted or _observed(block) if n not in {k.image for k in found.known}]
    fresh, failed, warned = [], [], []
    for name in missing:
        try:
            o = orient(block, Request(name))
        except PhotogrammetryError as error:
            if wanted:
                raise
            failed.append(f"not oriented: {error}")
            continue
        fresh.append(Known(name, o.exterior, o.covariance))
        warned += [name] * bool(o.warnings)
    if not fresh and not found.known:
        why = f" ({failed[0].removeprefix('not oriented: ')})" if failed else ""
        raise BadProject(f"{folder}: no image can be oriented{why}; measure control points, or run collinea georeference and add "
                         "--from georeference")
    return Found(found.block, (*found.known, *fresh),
                 (*found.notes, *_said(fresh, "resected now", warned), *failed))


def _of_run(folder: Path, block: Block, wanted: tuple[str, ...]) -> Found:
    """What the latest resect run holds of the perspective model, unless the project was changed since."""
    run = latest_run(folder, "result.json", "resect")
    if run is None:
        return Found(block, (), ())
    if _outdated(folder, run):
        return Found(block, (), (f"the run {run.name} is older than the project's files and was not used",))
    known: list[Known] = []
    warned: list[str] = []
    for o in _orientations(run / "result.json"):
        use = o["model"] == "perspective" and o["converged"] and o["image"] in {i.name for i in block.images}
        if use and (not wanted or o["image"] in wanted):
            known.append(_known(o))
            warned += [o["image"]] * bool(o["warnings"])
            block = _with_interior(block, o)
    return Found(block, tuple(known), tuple(_said(known, f"of the run {run.name}", warned)))


def _georeferenced(folder: Path, block: Block, wanted: tuple[str, ...]) -> Found:
    run = latest_run(folder, "result.json", "georeference")
    if run is None:
        raise BadProject(f"{folder}: there is no georeference run; make one with: collinea georeference {folder}")
    known = {o["image"]: _known(o) for o in _orientations(run / "result.json")}
    for name in wanted:
        if name not in known:
            raise BadProject(f"{run}: it does not hold image '{name}'; run collinea georeference again")
    chosen = tuple(known[n] for n in wanted or known)
    return Found(block, chosen, (f"orientations: {_listed([k.image for k in chosen])} of the run {run.name}",))


def known_orientations(folder: Path, source: str = "auto") -> Found:
    """What a project knows of its orientations without computing any; auto: of the latest adjust, calibrate or resect run that
    is not older than the project's files, else the priors that have angles, else none. Raises BadProject."""
    if source != "auto":
        return orientations_of(folder, (), source)
    block = read_project(folder)
    runs = {c: latest_run(folder, "result.json", c) for c in ("adjust", "calibrate", "resect")}
    there = {c: r for c, r in runs.items() if r is not None and not _outdated(folder, r)}
    last = max(there, key=lambda c: there[c].name, default=None)  # names begin with the time
    if last == "resect":
        return _of_run(folder, block, ())
    if last is not None:
        return _adjusted(folder, block, ())
    whole = any(i.prior is not None and i.prior.angles is not None for i in block.images)
    return _priors(folder, block, ()) if whole else Found(block, (), ())


def adjusted_points(folder: Path) -> dict[str, np.ndarray]:
    """Coordinates of the tie points of the latest adjust or calibrate run, by name; none without such a run."""
    run = _latest_adjust(folder)
    if run is None or _outdated(folder, run):
        return {}
    points = _result(run / "result.json").get("points") or []
    return {p["name"]: np.array([p["X"], p["Y"], p["Z"]], float) for p in points if p["role"] == "tie"}


def _outdated(folder: Path, run: Path) -> bool:
    """Whether the project's files are newer than a run."""
    done = (run / "result.json").stat().st_mtime
    return any((folder / f).stat().st_mtime > done for f in INPUTS if (folder / f).exists())


def _latest_adjust(folder: Path) -> Path | None:
    runs = [r for c in ("adjust", "calibrate") if (r := latest_run(folder, "result.json", c)) is not None]
    return max(runs, key=lambda r: r.name, default=None)


def _adjusted(folder: Path, block: Block, wanted: tuple[str, ...]) -> Found:
    """Orientations and interior orientations of the latest adjust or calibrate run."""
    run = _latest_adjust(folder)
    if run is None:
        raise BadProject(f"{folder}: there is no adjust run; make one with: collinea adjust {folder}")
    result = _result(run / "result.json")
    known = {o["image"]: _known(o) for o in result["orientations"]}
    for name in wanted:
        if name not in known:
            raise BadProject(f"{run}: it does not hold image '{name}'; run collinea adjust again")
    cameras = dict(block.cameras)
    for name, values in result.get("interior", {}).items():
        if name in cameras:
            cameras[name] = replace(cameras[name], **{k.removesuffix("_mm"): float(v) for k, v in values.items() if k != "sigma"})
    chosen = tuple(known[n] for n in wanted or known if n in {i.name for i in block.images})
    said = f"orientations: {_listed([k.image for k in chosen])} of the run {run.name}"
    old = ("the run is older than the project's files",) if _outdated(folder, run) else ()
    return Found(replace(block, cameras=cameras), chosen, (said, *old))


def _priors(folder: Path, block: Block, wanted: tuple[str, ...]) -> Found:
    """The priors that have position and angles, taken as they are; with their sigmas as covariance where they state all six."""
    known: list[Known] = []
    for image in block.images:
        p = image.prior
        if p is None or p.centre is None or p.angles is None:
            if image.name in wanted:
                raise BadProject(f"{folder}: image '{image.name}' has no prior with position and angles; run collinea "
                                 f"georeference "
                                 "--write-priors, or convert orientations of another tool")
            continue
        sigma = None if p.sigma_m is None or p.sigma_rad is None else np.diag(np.concatenate([p.sigma_m, p.sigma_rad]) ** 2)
        if not wanted or image.name in wanted:
            known.append(Known(image.name, Exterior(rotation(*p.angles), p.centre), sigma))
    if not known:
        raise BadProject(f"{folder}: no image has a prior with position and angles; convert orientations of another tool, or run "
                         f"collinea "
                         "georeference --write-priors")
    free = sum(k.covariance is None for k in known)
    doubt = f" ({free} without sigmas are taken as free of error)" if free else ""
    return Found(block, tuple(known), (f"orientations: {_listed([k.image for k in known])}, the priors of project.toml{doubt}",))


def _result(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
        return value if isinstance(value["orientations"], list) else {}["orientations"]
    except (ValueError, KeyError, TypeError) as error:
        raise BadProject(f"{path}: it is damaged ({type(error).__name__}: {error}); delete this run and compute it "
                         "again") from None


def _orientations(path: Path) -> list[dict[str, Any]]:
    return list(_result(path)["orientations"])


def _known(o: dict[str, Any]) -> Known:
    """An orientation of the JSON contract."""
    omega, phi, kappa = np.radians([o["omega_deg"], o["phi_deg"], o["kappa_deg"]])
    exterior = Exterior.from_angles(omega, phi, kappa, np.array([o["X"], o["Y"], o["Z"]], float))
    return Known(o["image"], exterior, np.array(o["covariance"], float))


def _with_interior(block: Block, o: dict[str, Any]) -> Block:
    """The block whose image has the interior orientation that was adjusted with it."""
    freed = o.get("interior")
    if not freed:
        return block
    own = {k.removesuffix("_mm"): v for k, v in freed.items() if k != "sigma"}
    name = f"{block.images[block.image_index(o['image'])].camera} of {o['image']}"
    images = tuple(replace(i, camera=name) if i.name == o["image"] else i for i in block.images)
    return replace(block, cameras={**block.cameras, name: replace(block.camera_of(o["image"]), **own)}, images=images)


def _observed(block: Block) -> list[str]:
    return [i.name for n, i in enumerate(block.images) if (block.observations.image == n).any()]


def _said(known: Sequence[Known], where: str, warned: Sequence[str]) -> list[str]:
    """Where orientations come from, and how many of them came with warnings."""
    if not known:
        return []
    doubt = f" ({len(warned)} with warnings: collinea resect shows them)" if warned else ""
    return [f"orientations: {_listed([k.image for k in known])} {where}{doubt}"]


def _listed(names: Sequence[str]) -> str:
    return f"{len(names)} images" if len(names) > 3 else ", ".join(names)
