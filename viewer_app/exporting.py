"""The command export: what the viewer's Export tab hands over, for a project as it was left in the viewer, written to files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import BinaryIO

from solvers import BadProject, PhotogrammetryError
from solvers.io import photo_path
from solvers.io.files import write_atomic
from solvers.io.photos import surface_path

from .acting import update
from .archive import write_project_zip
from .keeping import NAME, resume
from .loading import bring, open_project
from .state import State
from .tabs import wanted_tasks, whole_scene
from .tasks import Task

KINDS = ("html", "rrd", "png", "csv", "glb", "ply", "tif", "zip")
"""The ways out, in the order in which they are written; `solvers.cli_project.EXPORTS` offers them."""
SOURCES = ("project.toml", "points.csv", "observations.csv", "truth.json", NAME)


def export(folder: Path, wishes: Mapping[str, Path]) -> tuple[list[Path], list[str]]:
    """Solve a project and write what is wished for, by kind (csv: a folder); gives the files written, and a sentence for each
    kind that could not be.

    Raises PhotogrammetryError where nothing can be done, and before anything is written where a target is part of the project.
    """
    opened = open_project(folder)
    check_targets(folder, opened, wishes)
    written: list[Path] = []
    failed: list[str] = []
    state = opened if set(wishes) == {"zip"} else settled(resume(opened))
    for kind in KINDS:
        if kind in wishes:
            try:
                written += WAYS[kind](state, folder, wishes[kind])
            except PhotogrammetryError as error:
                failed.append(str(error))
            except OSError as error:
                failed.append(f"{wishes[kind]} could not be written ({error.strerror or error}); check the folder, its "
                              "permissions and the space left")  # fmt: skip
    return written, failed


def settled(state: State) -> State:
    """The state with everything read and solved that it asks for: orientations, and where it was there before, the bundle and
    the mosaics."""
    for action in bring(state):
        state = update(state, action)
    return _solved(state)


def _solved(state: State) -> State:
    tried: set[object] = set()
    while tasks := [t for t in wanted_tasks(state) if t.key not in tried]:
        tried.add(tasks[0].key)
        state = _done(state, tasks[0])
    return state


def _done(state: State, task: Task) -> State:
    try:
        for value in task.call(*task.arguments):
            state = update(state, task.arrive(value))
    except PhotogrammetryError as error:
        state = update(state, task.failed(str(error)))
    return state


def check_targets(folder: Path, state: State, wishes: Mapping[str, Path]) -> None:
    """Raises BadProject where a target is a file of the project itself, two are one, or one cannot be a file at all."""
    from .export_tables import NAMES

    sources = {(folder / name).resolve() for name in SOURCES}
    for image in state.block.images:
        if image.file is not None:
            sources |= _path(lambda name=image.name: photo_path(folder, state.block, name))
    sources |= _path(lambda: surface_path(folder, state.block))
    taken: dict[Path, str] = {}
    for kind, said in wishes.items():
        if kind == "csv" and said.exists() and not said.is_dir():
            raise BadProject(f"{said}: this is a file; name a folder for the tables")
        if kind != "csv" and said.is_dir():
            raise BadProject(f"{said}: this is a folder; give the name of a file")
        if not said.resolve().parent.is_dir() and kind != "csv":
            raise BadProject(f"{said}: there is no such folder; make it first or correct the path")
        for file in [said / f"{n}.csv" for n in NAMES] if kind == "csv" else [said]:
            if file.resolve() in sources:
                raise BadProject(f"{file}: this file is part of the project; give another name")
            if file.resolve() in taken:
                raise BadProject(f"{said}: two exports have the same name; give another")
            taken[file.resolve()] = kind


def _path(find: Callable[[], Path | None]) -> set[Path]:
    try:
        found = find()
    except PhotogrammetryError:
        return set()
    return set() if found is None else {found.resolve()}


def _file(make: Callable[[State], bytes]) -> Callable[[State, Path, Path], list[Path]]:
    def write(state: State, folder: Path, out: Path) -> list[Path]:
        data = make(state)
        write_atomic(out, lambda stream: stream.write(data))
        return [out]

    return write


def _html(state: State) -> bytes:
    from .share import replay_html

    return replay_html(state).encode("utf-8")


def _png(state: State) -> bytes:
    from .pictures import scene_png

    return scene_png(state)


def _glb(state: State) -> bytes:
    from .export import glb, where

    return glb(whole_scene(state), where(state))


def _ply(state: State) -> bytes:
    from .export import ply, where

    return ply(whole_scene(state), where(state))


def _rrd(state: State, folder: Path, out: Path) -> list[Path]:
    from .share import recording

    recording(state, out)
    return [out]


def _csv(state: State, folder: Path, out: Path) -> list[Path]:
    from .export_tables import tables

    out.mkdir(parents=True, exist_ok=True)
    written = []
    for name, text in tables(state).items():
        write_atomic(out / name, lambda stream, text=text: stream.write(text.encode("utf-8")))
        written.append(out / name)
    return written


def _tif(state: State, folder: Path, out: Path) -> list[Path]:
    """The mosaic shown, at full resolution."""
    from .mosaic_actions import MakeMosaic
    from .mosaic_state import METHODS, Mosaic
    from .mosaic_tasks import dem_of, files_of
    from .mosaic_work import write_work

    if state.room(Mosaic).current is None:  # for this file alone: the scene of the others stays as it was left
        state = _solved(update(state, MakeMosaic(METHODS[0])))
    room = state.room(Mosaic)
    made = room.current
    if made is None or not made.done:
        raise BadProject(f"{out}: there is no mosaic to write; {room.message or 'the project has no photos that overlap'}")
    files, dem = files_of(folder, made.block), dem_of(folder, made.block)
    for _ in write_work(made.registration, files, out, made.ask, dem, made.block.crs, careful=False):
        pass
    return [out]


def _zip(state: State, folder: Path, out: Path) -> list[Path]:
    def write(stream: BinaryIO) -> None:
        write_project_zip(folder, stream)

    write_atomic(out, write)
    return [out]


WAYS: Mapping[str, Callable[[State, Path, Path], list[Path]]] = {
    "html": _file(_html), "rrd": _rrd, "png": _file(_png), "csv": _csv, "glb": _file(_glb), "ply": _file(_ply), "tif": _tif,
    "zip": _zip,
}  # fmt: skip
