"""The walks: each reads like a table of contents, introducing the rooms to each other."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .block import Block, Image, Observations
from .errors import BadProject, DegenerateGeometry, PhotogrammetryError
from .io import (
    Ask,
    ControlList,
    Exif,
    assemble,
    check_photos,
    crs,
    latest_run,
    new_run,
    photo_path,
    read_control,
    read_exif,
    read_project,
    read_truth,
    save_trace,
    thumbnail,
    trace_name,
    write_heights,
    write_image,
    write_json,
    write_project,
)
from .orientation import Advice, Orientation, Request, advise, orient

MODELS = ("perspective", "orthogonal")
Recorder = Callable[[Path, Block, Sequence[Orientation], Mapping[str, np.ndarray], Mapping[str, Any] | None], object]
"""record(path, block, orientations, small photos by image name, truth): writes recording.rrd."""
PHOTO_SIDE = 1280
"""Longer side of the photos in a recording [px]."""


class Failure(NamedTuple):
    """An orientation that could not be computed, and the sentence that says why."""

    image: str
    model: str
    why: str


class Resected(NamedTuple):
    """What a resection run gave: orientations, its folder, and what could not be computed."""

    orientations: list[Orientation]
    run: Path
    failed: list[Failure]
    advice: dict[str, Advice]

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command resect."""
        failed = {"failed": [f._asdict() for f in self.failed]} if self.failed else {}
        return {"orientations": [o.to_json() for o in self.orientations],
                "advice": {i: a.to_json() for i, a in self.advice.items()},
                "run": str(self.run), **failed}


class Initialised(NamedTuple):
    """A new project, and what a person should know of how its numbers were found."""

    block: Block
    folder: Path
    notes: list[str]

    def to_json(self) -> dict[str, Any]:
        block = self.block
        return {"project": str(self.folder), "crs": block.crs, "cameras": list(block.cameras),
                "images": [i.name for i in block.images],
                "points": len(block.points), "observations": len(block.observations), "notes": self.notes}


# -- resect ---------------------------------------------------------------------------------------------------------------


def resect_project(folder: Path | str, images: Sequence[str] = (), models: Sequence[str] = MODELS,
                   recorder: Recorder | None = None,
                   **options: Any) -> Resected:
    """Orient images of a project one by one and leave a run: traces, result.json, recording.rrd.

    images: names, empty for all that have observations. options: as in `Request`. Raises PhotogrammetryError when nothing could
    be oriented; then no run is left.
    """
    folder = Path(folder)
    block = read_project(folder)
    requests = requests_of(block, images, models, **options)
    check_photos(folder, block, tuple(r.image for r in requests))
    orientations, failed = _orient_all(block, requests)
    advice = _advise_all(block, orientations, options.get("points"))
    run = new_run(folder, "resect")
    try:
        _write_run(run, folder, block, orientations, recorder)
        result = Resected(orientations, run, failed, advice)
        write_json(run / "result.json", result.to_json())
    except BaseException:
        shutil.rmtree(run, ignore_errors=True)
        raise
    return result


def requests_of(block: Block, images: Sequence[str] = (), models: Sequence[str] = MODELS, **options: Any) -> list[Request]:
    """One request per image and model; beside the perspective model, the orthogonal one leaves the interior orientation fixed."""
    seen = [i.name for n, i in enumerate(block.images) if (block.observations.image == n).any()]
    if not images and not seen:
        raise BadProject(f"{block.name}: no point is observed in any image; add lines to observations.csv, or mark points in the "
                         "viewer")
    names = [block.images[block.image_index(name)].name for name in images] or seen
    fixed = {**options, "free": ()} if len(models) > 1 else options
    return [Request(name, model, **(fixed if model == "orthogonal" else options))  # type: ignore[arg-type]
            for name in dict.fromkeys(names) for model in models]


def _orient_all(block: Block, requests: Sequence[Request]) -> tuple[list[Orientation], list[Failure]]:
    orientations: list[Orientation] = []
    failed: list[Failure] = []
    errors: list[PhotogrammetryError] = []
    for request in requests:
        try:
            orientations.append(_oriented(block, request))
        except PhotogrammetryError as error:
            errors.append(error)
            failed.append(Failure(request.image, request.model, str(error)))
    if not orientations:
        raise errors[0]
    return orientations, failed


def _oriented(block: Block, request: Request) -> Orientation:
    try:
        return orient(block, request)
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometry(
            f"image '{request.image}': the numbers do not fit together ({error}); look for a control point, a pixel or a camera "
            "value that is wrong by far, or try --robust") from None


def _advise_all(block: Block, orientations: Sequence[Orientation], points: tuple[str, ...] | None) -> dict[str, Advice]:
    advice: dict[str, Advice] = {}
    for image in dict.fromkeys(o.image for o in orientations):
        try:
            advice[image] = advise(block, image, points)
        except (DegenerateGeometry, np.linalg.LinAlgError):  # only its prior orients this image: there is nothing to choose from
            continue
    return advice


def _write_run(run: Path, folder: Path, block: Block, orientations: Sequence[Orientation], recorder: Recorder | None) -> None:
    save_trace(orientations[0].trace, run)
    for orientation in orientations:
        save_trace(orientation.trace, run, trace_name(orientation.image, orientation.model))
    if recorder is not None:
        names = dict.fromkeys(o.image for o in orientations)
        paths = {n: photo_path(folder, block, n) for n in names if block.images[block.image_index(n)].file is not None}
        photos = {n: thumbnail(path, PHOTO_SIDE).pixels for n, path in paths.items()}
        recorder(run / "recording.rrd", block, orientations, photos, read_truth(folder))


# -- init -----------------------------------------------------------------------------------------------------------------


def init_project(files: Sequence[Path | str], folder: Path | str, *, mapping: str | None = None, project_crs: str | None = None,
                 pixel_origin: str | None = None, pixel_um: float | None = None, c_mm: float | None = None,
                 ask: Ask | None = None) -> Initialised:
    """Make a project folder from photos and, if there is one, a list of control points.

    ask: puts a question to a person when something is unclear; without it unclear input is refused with the cure.
    """
    folder = Path(folder)
    _must_be_free(folder)
    photos, table = assemble.sort_files([Path(f) for f in files])
    exifs = [read_exif(photo) for photo in photos]
    cameras, camera_of, notes = assemble.cameras_of(photos, exifs, pixel_um, c_mm)
    control = read_control(table, mapping, ask) if table else None
    chosen, xyz, said = _choose_crs(control, exifs, project_crs, ask)
    origin, assumed = _choose_origin(control, pixel_origin, ask)
    names, priors = assemble.image_names(photos), assemble.priors_of(exifs, chosen)
    paths = [_written_path(photo, folder) for photo in photos]
    images = tuple(Image(*values) for values in zip(names, camera_of, paths, priors, strict=True))
    observations, left = assemble.measurements(control, images, photos, cameras, origin) if control else (_none(), ())
    all_notes = [*notes, *(control.notes if control else ()), *said, *assumed, *left, *_photo_notes(exifs, priors)]
    if ask is not None and control is not None:
        _confirm(all_notes, ask)
    block = Block(folder.resolve().name or "project", chosen, cameras, images, assemble.points_of(control, xyz), observations)
    _write_new(block, folder, origin)
    return Initialised(read_project(folder), folder, all_notes)


def _choose_crs(control: ControlList | None, exifs: Sequence[Exif], given: str | None, ask: Ask | None,
                ) -> tuple[str, np.ndarray, list[str]]:
    """The crs of the project, the control in it, and what to say about it."""
    zone = assemble.home_zone(exifs)
    given = crs.short_crs(given) if given else None
    if given and crs.is_geographic(given):
        raise BadProject(f"--crs {given}: a project needs coordinates in metres; give the UTM zone or the national grid")
    if control is None:
        source = "given" if given else "from the photos' GPS" if zone else "neither given nor in the photos"
        chosen = given or zone or "local"
        return chosen, np.empty((0, 3)), [f"crs: {chosen} ({source})"]
    source = control.crs and crs.short_crs(control.crs)
    if source and crs.is_geographic(source):
        known = control.xyz[np.isfinite(control.xyz).all(axis=1)]
        target = given or crs.utm_zone(float(np.median(known[:, 1])), float(np.median(known[:, 0])))
        xyz = crs.transformed(control.xyz, source, target)
        return target, xyz, [f"crs: {target}, converted from degrees; heights are kept as they are"]
    if source:
        target = given or source
        return target, crs.transformed(control.xyz, source, target), [f"crs: {target}"]
    if given:
        return given, control.xyz, [f"crs: {given}"]
    near = zone is not None and assemble.plausible(control.xyz, zone, exifs)
    if ask is not None:
        proposed = zone if near and zone else "local"
        answer = ask(f"Coordinate system of the control points, such as EPSG:32632, or local [{proposed}]: ").strip()
        chosen = crs.short_crs(answer or proposed)
        return chosen, control.xyz, [f"crs: {chosen}"]
    if near and zone:
        return zone, control.xyz, [f"crs: {zone} (assumed: the control lies near the photos' GPS in it; give --crs if it is "
                                   "another)"]
    raise BadProject(f"{control.path}: it does not say its coordinate system; give it with --crs EPSG:CODE, or --crs local")


def _choose_origin(control: ControlList | None, given: str | None, ask: Ask | None) -> tuple[str, list[str]]:
    if given or control is None or not control.marks:
        return given or "center", []
    if ask is not None:
        answer = ask("Pixel (0, 0) of the measurements is the center of the top-left pixel, or its corner [center]: ")
        answer = answer.strip().lower()
        if answer in ("", "center", "centre", "corner"):
            return "corner" if answer == "corner" else "center", []
        raise BadProject(f"pixel origin '{answer}' is not known; answer center or corner")
    return "center", ["pixel origin: center of the top-left pixel (assumed; give --pixel-origin corner if (0, 0) is its corner)"]


def _confirm(notes: Sequence[str], ask: Ask) -> None:
    if ask("\n".join(notes) + "\nIs this right? [yes] ").strip().lower() not in ("", "y", "yes"):
        raise BadProject("nothing was written; say it with --map, --crs, --pixel-origin, --pixel-um and --c-mm")


def _photo_notes(exifs: Sequence[Exif], priors: Sequence[object]) -> list[str]:
    count = sum(p is not None for p in priors)
    notes = [f"priors: GPS positions of {count} photos, their heights of unknown datum, sigma 5, 5, 10 m"] if count else []
    turned = sum(e.orientation != 1 for e in exifs)
    if turned:
        notes.append(f"{turned} photos ask to be shown turned (EXIF orientation); pixels refer to the photo as it is stored")
    return notes


def _written_path(photo: Path, folder: Path) -> str:
    """Relative inside the project folder, absolute elsewhere."""
    at, home = photo.resolve(), folder.resolve()
    return at.relative_to(home).as_posix() if at.is_relative_to(home) else str(at)


def _none() -> Observations:
    return Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))


# -- simulate -------------------------------------------------------------------------------------------------------------


def simulate_project(kind: str, folder: Path | str, *, seed: int = 0, reduction: int = 4, quality: int = 88,
                     photos: bool = True) -> Block:
    """A project with known truth: project folder, truth.json, dem.tif and photos made smaller by `reduction`."""
    from . import simulation

    folder = Path(folder)
    _must_be_free(folder)
    simulated = simulation.simulate(kind, seed)
    block, terrain, render = simulated.block, simulated.terrain, simulated.render
    if not photos:
        block = replace(block, images=tuple(replace(i, file=None) for i in block.images))
    pictures = {i.file: render(i.name, reduction) for i in block.images if i.file and render}
    _write_new(block, folder, "center", simulated.truth)
    for file, picture in pictures.items():
        write_image(folder / file, picture, quality)
    if terrain is not None and "file" in block.surface:
        write_heights(folder / block.surface["file"], terrain.heights, terrain.west, terrain.north, terrain.cell, block.crs)
    return block


# -- new folders ----------------------------------------------------------------------------------------------------------


def _must_be_free(folder: Path) -> None:
    """Raises BadProject rather than overwrite a project."""
    if folder.exists() and not folder.is_dir():
        raise BadProject(f"{folder}: this is a file; choose another folder")
    for name in ("project.toml", "points.csv", "observations.csv"):
        if (folder / name).exists():
            raise BadProject(f"{folder / name}: it is already there; choose another folder or remove it")


def _write_new(block: Block, folder: Path, origin: str, truth: Mapping[str, Any] | None = None) -> None:
    """Write a new project whole or not at all."""
    was_there = folder.exists()
    try:
        write_project(block, folder, truth=truth, pixel_origin=origin)
    except BaseException:
        if was_there:
            for name in ("project.toml", "points.csv", "observations.csv", "truth.json"):
                (folder / name).unlink(missing_ok=True)
        else:
            shutil.rmtree(folder, ignore_errors=True)
        raise


# -- log ------------------------------------------------------------------------------------------------------------------


def recording_of(project_or_run: Path | str) -> Path:
    """The recording of a run, or of the latest run of a project that has one. Raises BadProject."""
    at = Path(project_or_run)
    if at.suffix == ".rrd" and at.is_file():
        return at
    if (at / "recording.rrd").is_file():
        return at / "recording.rrd"
    run = latest_run(at, "recording.rrd")
    if run is None:
        raise BadProject(f"{at}: there is no run with a recording; make one with: collinea resect PROJECT")
    return run / "recording.rrd"
