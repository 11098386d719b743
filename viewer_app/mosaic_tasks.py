"""What the Mosaic tab wants done now, pure: mosaics asked for, tie points where there are none, the layer, the writing."""

from __future__ import annotations

from pathlib import Path

from solvers import Block, PhotogrammetryError
from solvers.execution import cores
from solvers.io import photo_path
from solvers.io.photos import surface_path
from solvers.workflows_mosaic import has_ties

from .acting import Action
from .kept import by_identity
from .matching_work import ties_work
from .mosaic_actions import Ended, LayerCame, Progressing, Registered, TiesFound, TilesCame
from .mosaic_layer import layer_work
from .mosaic_state import METHODS, Ask, Layer, Made, Mosaic, block_of
from .mosaic_work import Batch, Begun, mosaic_work, write_work
from .state import State
from .tasks import Task
from .uploads import inside

LANE = "mosaic"


def tasks(state: State) -> tuple[Task, ...]:
    """Mosaics first, in the order of the methods."""
    room, folder = state.room(Mosaic), state.assets.folder
    if folder is None or not (room.wanted or room.busy):
        return ()
    block = block_of(state)
    found = [
        _make(room, folder, block, room.wanted[m]) for m in METHODS if m in room.wanted and not _fresh(room, m, block)
    ]
    if found and not _tied(block):
        before = state.block
        return (
            Task(
                ("mosaic-ties", id(before)),
                ties_work,
                (before, folder, cores()),
                lambda value: Progressing(value) if isinstance(value, str) else TiesFound(before, *value),
                lambda why: Ended(next(iter(room.wanted)), why),
                "the search for tie points",
                LANE,
            ),
        )
    made = room.current
    if made is not None and made.done:
        for busy in room.busy:
            what, _, path = busy.partition("|")
            found.append(_layer(made, folder, path) if what == "layer" else _write(made, folder, path))
    return tuple(found)


def _fresh(room: Mosaic, method: str, block: Block) -> bool:
    made = room.made.get(method)
    return made is not None and made.done and made.block is block and made.ask == room.wanted[method]


@by_identity(8)
def _tied(block: Block) -> bool:
    return has_ties(block)


@by_identity(8)
def files_of(folder: Path, block: Block) -> dict[str, Path]:
    """The photo of every image that has one."""
    found = {}
    for image in block.images:
        try:
            found[image.name] = photo_path(folder, block, image.name)
        except PhotogrammetryError:
            continue  # the work itself says which photo is missing
    return found


def dem_of(folder: Path, block: Block) -> str:
    """The project's height grid, "" where there is none."""
    try:
        found = surface_path(folder, block)
    except PhotogrammetryError:
        return ""
    return "" if found is None else str(found)


def _make(room: Mosaic, folder: Path, block: Block, ask: Ask) -> Task:
    old = room.made.get(ask.method)
    grid, tiles = (old.grid, old.tiles) if old is not None and old.done and _alike(old.ask, ask) else (None, {})

    def arrive(value: str | Begun | Batch) -> Action:
        if isinstance(value, str):
            return Progressing(value)
        if isinstance(value, Batch):
            return TilesCame(ask.method, value.tiles, value.last)
        return Registered(Made(ask, block, value.registration, value.said, value.points, {}, value.total, value.grid))

    return Task(
        ("mosaic", ask, id(block)),
        mosaic_work,
        (block, folder, ask, dem_of(folder, block), files_of(folder, block), grid, tiles),
        arrive,
        lambda why: Ended(ask.method, why),
        f"the {ask.method} mosaic",
        LANE,
    )


def _alike(a: Ask, b: Ask) -> bool:
    """Whether tiles made for one look like those for the other where the photos lie alike."""
    return (a.blend, a.seams, a.gain, a.plane, a.gsd) == (b.blend, b.seams, b.gain, b.plane, b.gsd)


def _layer(made: Made, folder: Path, path: str) -> Task:
    def arrive(value: str | Layer) -> Action:
        return Progressing(value) if isinstance(value, str) else _layered(value)

    file = inside(folder, path)
    if file is not None:
        call, arguments = layer_work, (file, made.tiles, made.grid, made.registration)
    else:
        why = f"{path}: the viewer reads maps within the project's folder only; hand the map over or copy it there"
        call, arguments = _refuse, (why,)
    return Task(
        ("layer", path),
        call,
        arguments,
        arrive,
        lambda why: Ended("layer", why),
        "the comparison with the layer",
        LANE,
    )


def _layered(layer: Layer) -> Action:
    return Ended("layer", layer.words) if layer.tile is None else LayerCame(layer)


def _write(made: Made, folder: Path, path: str) -> Task:
    out = inside(folder, path)
    if out is not None:
        call = write_work
        arguments = (made.registration, files_of(folder, made.block), out, made.ask, dem_of(folder, made.block), made.block.crs)
    else:
        why = f"{path}: the viewer writes within the project's folder only; give a name such as mosaic.tif"
        call, arguments = _refuse, (why,)

    def arrive(value: str) -> Action:
        return Ended("write", value[1:], file=True) if value.startswith("=") else Progressing(value)

    return Task(("write", path), call, arguments, arrive, lambda why: Ended("write", why), "the writing", LANE)


def _refuse(why: str):
    from solvers import BadProject

    raise BadProject(why)
    yield ""  # a generator, as all work is
