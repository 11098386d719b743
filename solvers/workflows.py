"""The walks: each reads like a table of contents, introducing the rooms to each other."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .block import Block
from .errors import BadProject, DegenerateGeometry, PhotogrammetryError
from .io import (
    check_photos,
    latest_run,
    new_run,
    photo_path,
    read_project,
    read_truth,
    save_trace,
    thumbnail,
    trace_name,
    write_heights,
    write_image,
    write_json,
)
from .orientation import Advice, Orientation, Request, advise, orient
from .workflows_init import Initialised, init_project
from .workflows_new import must_be_free, write_new

__all__ = ["Initialised", "Resected", "init_project", "recording_of", "requests_of", "resect_project", "simulate_project"]
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


# -- simulate -------------------------------------------------------------------------------------------------------------


def simulate_project(kind: str, folder: Path | str, *, seed: int = 0, reduction: int = 4, quality: int = 88,
                     photos: bool = True, **options: Any) -> Block:
    """A project with known truth: project folder, truth.json, dem.tif and photos made smaller by `reduction`; options: of the
    kind."""
    from . import simulation

    folder = Path(folder)
    must_be_free(folder)
    simulated = simulation.simulate(kind, seed, **options)
    block, terrain, render = simulated.block, simulated.terrain, simulated.render
    if not photos:
        block = replace(block, images=tuple(replace(i, file=None) for i in block.images))
    pictures = {i.file: render(i.name, reduction) for i in block.images if i.file and render}
    write_new(block, folder, "center", simulated.truth)
    for file, picture in pictures.items():
        write_image(folder / file, picture, quality)
    if terrain is not None and "file" in block.surface:
        write_heights(folder / block.surface["file"], terrain.heights, terrain.west, terrain.north, terrain.cell, block.crs)
    return block


def simulate_epochs(kind: str, folder: Path | str, *, seed: int = 0) -> list[Path]:
    """Projects with known truth that are epochs of one network: folder/epoch1, folder/epoch2 ..; all or none are written."""
    from .simulation import SERIES

    folder = Path(folder)
    made = SERIES[kind](seed)
    folders = [folder / f"epoch{k + 1}" for k in range(len(made))]
    must_be_free(folder)
    for at in folders:
        must_be_free(at)
    done: list[Path] = []
    try:
        for at, simulated in zip(folders, made, strict=True):
            done.append(at)
            write_new(simulated.block, at, "center", simulated.truth)
    except BaseException:
        for at in done:
            shutil.rmtree(at, ignore_errors=True)
        raise
    return folders


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
