"""Ways out of a project: an offline page that replays the adjustment, a recording, tables, and the whole project as one file."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

from solvers import BadProject, PhotogrammetryError
from solvers.io.files import write_atomic

from .actions import GoTo, update
from .bridge import open_server
from .home import home
from .lists import COLUMNS, as_csv, rows_of
from .paint_viser import Painter
from .state import MODELS, State
from .tabs import whole_scene

SECONDS = 0.5
"""How long the replay shows each row."""
MOST_ROWS = 200
LARGEST_ZIP = 2**32
SKIPPED = (".thumbnails", "__pycache__")


def replay_html(state: State) -> str:
    """One page, to be opened from disk, that plays every row of the chosen image's traces; nothing is fetched from anywhere."""
    server = open_server()
    try:
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        camera = server.initial_camera
        camera.position, camera.look_at, camera.far = home(state)
        painter = Painter(server)
        rows = range(min(state.last_row, MOST_ROWS - 1) + 1)
        painter.paint(whole_scene(update(state, GoTo(0))))
        recorder = server.get_scene_serializer()
        for row in rows:
            painter.paint(whole_scene(update(state, GoTo(row))))
            recorder.insert_sleep(SECONDS if row != rows[-1] else 3 * SECONDS)
        return recorder.as_html(dark_mode=state.view.dark)
    finally:
        server.stop()


def recording(state: State, path: Path) -> None:
    """The rerun recording of every solution. Raises BadProject where there is none."""
    from solvers.io import read_truth

    from .paint_rerun import record

    done = [s.orientation for i in state.block.images for m in MODELS if (s := state.solution(m, i.name)) and s.orientation]
    if not done:
        raise BadProject(f"{state.block.name}: there is no solution to record; measure points in an image first")
    folder = state.assets.folder
    photos = {name: photo.pane for name, photo in state.assets.photos.items()}
    record(path, state.block, done, photos, (read_truth(folder) if folder else None) or {})


def tables(state: State) -> dict[str, str]:
    """Points, images and orientations as CSV texts by file name."""
    return {f"{name}.csv": as_csv(COLUMNS[name], rows_of(state, name)[0]) for name in COLUMNS}


def tables_zip(state: State) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in tables(state).items():
            file.writestr(name, text)
    return out.getvalue()


def project_zip(folder: Path) -> bytes:
    """The project folder as one file, without what is derived and hidden. Links are left out: they may lead elsewhere.

    Raises BadProject where it is too large for one file in memory.
    """
    files = [p for p in sorted(folder.rglob("*")) if p.is_file() and not p.is_symlink() and _wanted(p.relative_to(folder))]
    if sum(p.stat().st_size for p in files) > LARGEST_ZIP:
        raise BadProject(f"{folder}: the project is larger than {LARGEST_ZIP / 2**30:.0f} GB; copy the folder itself")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for path in files:
            file.write(path, f"{folder.name}/{path.relative_to(folder).as_posix()}")
    return out.getvalue()


def _wanted(path: Path) -> bool:
    return path.parts[0] != "runs" and not any(part in SKIPPED or part.startswith(".") for part in path.parts)


def export(folder: Path, wishes: dict[str, Path]) -> list[Path]:
    """Solve a project and write what is wished for: html, rrd, png, csv (a folder), zip. Gives the files written.

    Raises PhotogrammetryError.
    """
    from .loading import bring, open_project
    from .tabs import wanted_tasks

    written: list[Path] = []
    if "zip" in wishes:
        data = project_zip(folder)
        write_atomic(wishes["zip"], lambda stream: stream.write(data))
        written.append(wishes["zip"])
    if not set(wishes) - {"zip"}:
        return written
    state = open_project(folder)
    for action in bring(state):
        state = update(state, action)
    while tasks := [task for task in wanted_tasks(state) if task.lane == "solve"]:
        for task in tasks:
            try:
                for value in task.call(*task.arguments):
                    state = update(state, task.arrive(value))
            except PhotogrammetryError as error:
                state = update(state, task.failed(str(error)))
    if "html" in wishes:
        text = replay_html(state)
        write_atomic(wishes["html"], lambda stream: stream.write(text.encode("utf-8")))
        written.append(wishes["html"])
    if "rrd" in wishes:
        recording(state, wishes["rrd"])
        written.append(wishes["rrd"])
    if "png" in wishes:
        from .pictures import scene_png

        picture = scene_png(state)
        write_atomic(wishes["png"], lambda stream: stream.write(picture))
        written.append(wishes["png"])
    if "csv" in wishes:
        wishes["csv"].mkdir(parents=True, exist_ok=True)
        for name, text in tables(state).items():
            write_atomic(wishes["csv"] / name, lambda stream, text=text: stream.write(text.encode("utf-8")))
            written.append(wishes["csv"] / name)
    return written
