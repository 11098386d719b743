"""The Mosaic tab's long work, done in another process: registering, showing, writing."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from solvers import BadProject, Block
from solvers.geometry import Grid
from solvers.mosaic import Registration
from solvers.workflows_compose import ComposeRequest, compose_photos, ground_of, placed_at
from solvers.workflows_mosaic import MosaicRequest, Offsets, point_offsets, registered_block, registered_json

from .following import followed
from .mosaic_state import BLENDS, KINDS, PLANES, Ask, Tile
from .uploads import in_the_way

SIDE = 256
"""px of a tile's side as shown."""
MOST = 2.6e6
"""px of a mosaic as shown, at most: what a browser takes at once."""
MEMORY = 160e6
"""Bytes of all photos' small pictures together."""
SAME = 0.3
"""px of the small pictures by which photos may move under a tile that is not made anew."""
AT_ONCE = 4
"""Tiles sent in one message."""


@dataclass(frozen=True, eq=False)
class Begun:
    """A registration, before any tile."""

    registration: Registration
    said: Mapping[str, Any]
    points: Offsets
    total: int
    grid: Grid


@dataclass(frozen=True, eq=False)
class Batch:
    """Tiles; last: there are no more."""

    tiles: tuple[Tile, ...]
    last: bool


def request_of(ask: Ask, dem: str) -> MosaicRequest:
    """The command's request for what the panel asks. Raises BadProject."""
    if ask.plane == PLANES[2] and not dem:
        raise BadProject(
            "the project has no height grid; choose the mean height as surface, or name a DEM in project.toml (surface)"
        )
    compose = ComposeRequest(
        surface=dem if ask.plane == PLANES[2] else "plane", gsd=ask.gsd or None, blend=_blend(ask), seams=ask.seams, gain=ask.gain
    )
    kind: Any = None if ask.kind == KINDS[0] else ask.kind
    plane: Any = "fitted" if ask.plane == PLANES[1] else None
    model: Any = ask.model
    method: Any = ask.method
    return MosaicRequest(kind, method, model, plane, compose=compose)


def _blend(ask: Ask) -> Literal["none", "average", "feather", "multiband"]:
    blend: Any = ask.blend if ask.blend in BLENDS else BLENDS[0]
    return blend


def mosaic_work(
    block: Block, folder: Path, ask: Ask, dem: str, files: Mapping[str, Path], grid: Grid | None, old: Mapping[int, Tile]
) -> Iterator[str | Begun | Batch]:
    """Words on how it goes; the registration; then tiles as they are finished. grid, old: of the mosaic before, whose tiles stay
    where no photo under them has moved."""
    from solvers.mosaic import ComposeOptions, composition, render

    yield f"Registering {len(files)} photos, {ask.method}: tie points, start, adjustment"
    request = request_of(ask, dem)
    done = registered_block(block, folder, request)
    r = done.registration
    r = replace(r, frame=replace(r.frame))  # without what it has computed, which need not travel
    side = int(np.clip(np.sqrt(MEMORY / 3 / len(r.names)), 200, 1600))
    placed = [placed_at(r, k, _small(files[n], side)[1]) for k, n in enumerate(r.names)]
    yield "Preparing the picture"
    ground, surface = ground_of(r, placed, request.compose)
    options = ComposeOptions(None, "bilinear", request.compose.blend, ask.seams, ask.gain, SIDE)
    rough = composition(placed, ground, replace(options, seams=False, gain=False, blend="average"), None, surface)
    rows, columns = rough.canvas.grid.shape
    gsd = max(rough.canvas.gsd * max(1.0, float(np.sqrt(rows * columns / MOST))), ask.gsd)
    before = None if grid is None else grid.affine[0]
    gsd = before if before is not None and abs(gsd / before - 1) < 0.03 else float(f"{gsd:.3g}")
    made = composition(placed, ground, replace(options, gsd=gsd), lambda name, most: _fit(files[name], side, most), surface)
    if grid is not None and before == gsd and _holds(grid, made.canvas.outlines):
        made = replace(made, canvas=replace(made.canvas, grid=replace(grid, crs=made.canvas.grid.crs)))
    else:
        old = {}
    if ask.seams or ask.gain or ask.blend == "multiband":
        old = {}  # what one photo changes there reaches all others
    order = made.order()
    yield Begun(r, registered_json(done), point_offsets(r, block), len(order), made.canvas.grid)

    def window(name: str, top: int, left: int, bottom: int, right: int) -> np.ndarray:
        return _small(files[name], side)[0][top:bottom, left:right]

    kept, batch, began = 0, [], time.monotonic()
    for n, index in enumerate(order):
        tile = made.tile(index)
        corners = _corners(r, made.canvas.grid, tile)
        job = made.job(index)
        names = tuple(p.name for p in job.layers.photos)
        lay = np.array([p.pixels(_five(corners)) for p in job.layers.photos]).reshape(-1, 5, 2)
        was = old.get(index)
        if was is not None and was.photos == names and _still(was.lay, lay):
            kept += 1
            continue
        batch.append(Tile(index, render(job, window), corners, names, lay))
        if len(batch) >= AT_ONCE:
            yield Batch(tuple(batch), False)
            batch = []
            left = (time.monotonic() - began) / (n + 1) * (len(order) - n - 1)
            yield f"Tiles: {n + 1} of {len(order)}, about {left:.0f} s left"
    yield Batch(tuple(batch), True)


def write_work(registration: Registration, files: Mapping[str, Path], out: Path, ask: Ask, dem: str, crs: str,
               careful: bool = True) -> Iterator[str]:
    """Words on how far the writing at full resolution is; last what was written. careful: no file is replaced but those of an
    earlier mosaic. Raises BadProject."""
    if careful and (file := in_the_way(out)) is not None:
        raise BadProject(f"{file.name}: a file of this name is there that is no mosaic of this program's; give another name")
    if not out.parent.is_dir():
        raise BadProject(f"{out.parent}: there is no such folder; make it first or correct the path")
    request = replace(request_of(ask, dem).compose, crs=crs)
    for value in followed(lambda report: compose_photos(registration, files, out, request, report), f"Writing {out.name}"):
        if isinstance(value, str):
            yield value
        else:
            beside = "its world file and footprints beside it"
            yield f"={out}: {value['width']} x {value['height']} px of {value['gsd']:g} {value['unit']}, {beside}."


# -- small pictures ---------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=4096)
def _small(file: Path, side: int) -> tuple[np.ndarray, tuple[int, int]]:
    """A photo with its longer side at most so many pixels, and its size; kept, all together within MEMORY."""
    from solvers.io.photos import thumbnail

    pixels = thumbnail(file, side).pixels
    return pixels, (pixels.shape[1], pixels.shape[0])


def _fit(file: Path, side: int, most: int) -> np.ndarray:
    import cv2

    pixels = _small(file, side)[0]
    f = most / max(pixels.shape[:2])
    return pixels if f >= 1 else cv2.resize(pixels, None, fx=f, fy=f, interpolation=cv2.INTER_AREA)


def _corners(r: Registration, grid: Grid, tile: Any) -> np.ndarray:
    """(4, 3) local corners of a tile on the mosaic plane, its outer edges."""
    from solvers.mosaic import Ground, MosaicPlane

    left, top = tile.left - 0.5, tile.top - 0.5
    right, bottom = left + tile.width, top + tile.height
    at = grid.to_map(np.array([[left, top], [right, top], [right, bottom], [left, bottom]]))
    return Ground(r.frame, MosaicPlane(*map(float, r.plane))).local(at)


def _five(corners: np.ndarray) -> np.ndarray:
    return np.vstack([corners, corners.mean(axis=0)])


def _still(a: np.ndarray, b: np.ndarray) -> bool:
    known = np.isfinite(a) & np.isfinite(b)
    return a.shape == b.shape and bool(
        (np.abs(np.where(known, a - b, 0.0)) < SAME).all() and (np.isfinite(a) == np.isfinite(b)).all()
    )


def _holds(grid: Grid, outlines: tuple[np.ndarray, ...]) -> bool:
    """Whether a raster still holds the photos, within a pixel or two, and is not much larger than they are."""
    pixels = grid.to_pixels(np.concatenate(outlines))
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    edge = np.array([grid.shape[1], grid.shape[0]]) - 0.5
    return bool((np.abs(low + 0.5) < 3).all() and (np.abs(high - edge) < 3).all())
