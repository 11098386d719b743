"""A project folder -> the viewer's first state, and what takes longer to read: terrain and photos."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from solvers import Exterior, PhotogrammetryError
from solvers.geometry import LocalFrame
from solvers.io import read_project, read_surface, read_truth

from .actions import Brought, Say
from .bundle_state import Bundle
from .ground import nice
from .state import Assets, Photo, State, Terrain, View, Work

PANE, THUMBNAIL = 1100, 480
"""Longer sides [px] of the pictures for the photo pane and the scene."""
TILE = 256
"""Side of the pieces [px of the file] in which a photo is reached into."""
TERRAIN_CELLS = 160
"""Longer side of the terrain mesh."""


def open_project(folder: Path | str) -> State:
    """The state a project opens with, read in a moment; what takes longer comes from `bring`. Raises BadProject, BadTable."""
    folder = Path(folder)
    block = read_project(folder)
    frame = LocalFrame.around(_somewhere(block), block.crs, block.frame)
    assets = Assets(folder, frame, level=_level(block.surface, frame), truth=_truth(read_truth(folder), frame))
    state = first_state(State(Work(block), assets, block.images[0].name if block.images else ""))
    return state.with_room(Bundle(datum=block.datum))


def _somewhere(block: Any) -> np.ndarray:
    """Known points (n, 3) m of a project; where there are none, the places its photos are said to be taken from."""
    if np.isfinite(block.points.xyz).all(axis=1).any():
        return block.points.xyz
    centres = [i.prior.centre for i in block.images if i.prior is not None and i.prior.centre is not None]
    return np.array(centres, float).reshape(-1, 3)


def first_state(state: State) -> State:
    """The state with exaggerations that make one pixel and a few centimetres visible at the size of this site."""
    block = state.block
    xyz = state.assets.frame.to_local(block.points.xyz)
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    seen = np.bincount(block.observations.image, minlength=len(block.images)) if len(block.images) else np.zeros(1)
    image = block.images[int(np.argmax(seen))].name if block.images else ""
    if not len(xyz) or not block.images:
        return State(state.work, state.assets, image)
    span = max(float(np.linalg.norm(np.ptp(xyz, axis=0)[:2])), 1e-3)
    camera = block.camera_of(image)
    ground_pixel = span / max(camera.width, camera.height)
    vectors = nice(max(0.04 * span / (block.image_px * ground_pixel), 1.0))
    photo = nice(max(0.02 * camera.width / block.image_px, 1.0))
    return State(state.work, state.assets, image, View(vectors=vectors, photo_vectors=photo))


def bring(state: State) -> Iterator[Brought | Say]:
    """Terrain and photos, one after the other; what cannot be read is said and left out."""
    folder = state.assets.folder
    if folder is None:
        return
    if state.block.surface.get("file"):
        from solvers.io.photos import surface_path

        try:
            file = surface_path(folder, state.block)
            assert file is not None
            yield Brought(terrain(file, state.assets.frame, state.block.points.xyz))
            yield Brought(read_surface(file, _bounds(state.block.points.xyz)))
        except PhotogrammetryError as error:
            yield Say(str(error))
    order = sorted(state.block.images, key=lambda image: image.name != state.image)
    for image in order:
        if image.file is not None:
            try:
                yield Brought(photo(folder, state.block, image.name), image.name)
            except PhotogrammetryError as error:
                yield Say(str(error))


def _bounds(xyz: np.ndarray) -> tuple[float, float, float, float] | None:
    """West, south, east, north of the known points with their own extent around."""
    known = xyz[np.isfinite(xyz).all(axis=1), :2]
    if len(known) < 2:
        return None
    low, high = known.min(axis=0), known.max(axis=0)
    (west, south), (east, north) = low - (high - low).max(), high + (high - low).max()
    return float(west), float(south), float(east), float(north)


def photo(folder: Path, block: Any, image: str) -> Photo:
    """The small pictures of a photo. Raises BadProject, Unsupported."""
    from solvers.io.photos import photo_path, photo_size, thumbnail

    path = photo_path(folder, block, image)
    pane = thumbnail(path, PANE, folder / "runs" / ".thumbnails").pixels
    step = -(-max(pane.shape[:2]) // THUMBNAIL)
    h, w = (n - n % step for n in pane.shape[:2])
    small = pane[:h, :w].reshape(h // step, step, w // step, step, 3).mean(axis=(1, 3)).astype(np.uint8)
    return Photo(path, small, pane, photo_size(path))


def crop(
    photo: Photo, format_size: tuple[int, int], col: float, row: float, half: int, pyramid: Path | None = None
) -> tuple[np.ndarray, float, float]:
    """File pixels (2 half + 1, 2 half + 1, 3) around a pixel of the full photo, and its place (x, y) in them, 0 = first centre.

    pyramid: read instead of the file where there is one, for reaching into a very large JPEG takes its time. The file may be
    the full photo reduced by a factor: full = (file + 0.5) * factor - 0.5.
    """
    x, y = ((v + 0.5) * n / full - 0.5 for v, n, full in zip((col, row), photo.size, format_size, strict=True))
    left, top, side = round(x) - half, round(y) - half, 2 * half + 1
    tile_x, tile_y = left // TILE, top // TILE
    tile = _tile(photo.path, tile_x * TILE, tile_y * TILE, TILE + side, pyramid)
    i, j = top - tile_y * TILE, left - tile_x * TILE
    return tile[i : i + side, j : j + side], x - left, y - top


@lru_cache(maxsize=16)
def _tile(path: Path, left: int, top: int, side: int, pyramid: Path | None) -> np.ndarray:
    """Pixels of a photo's file, black beyond it; kept."""
    from solvers.io.photos import photo_size, photo_window
    from solvers.io.pyramid import read_window

    if pyramid is not None:
        width, height = photo_size(path)
        x0, y0, x1, y1 = max(left, 0), max(top, 0), min(left + side, width), min(top + side, height)
        out = np.zeros((side, side, 3), np.uint8)
        if x1 > x0 and y1 > y0:
            out[y0 - top : y1 - top, x0 - left : x1 - left] = read_window(pyramid, x0, y0, x1 - x0, y1 - y0, side)
        return out
    return photo_window(path, left, top, side, side)


def terrain(path: Path, frame: LocalFrame, site: np.ndarray) -> Terrain:
    """The DEM around the points `site` (n, 3) of the map as a mesh in calm colours. Raises Unsupported, BadProject."""
    from solvers.io.heights import read_heights

    x, y, z = _around(*read_heights(path, 4 * TERRAIN_CELLS), site)
    gx, gy = np.meshgrid(x, y)
    known = np.isfinite(z)
    flat = np.stack([gx, gy, np.where(known, z, 0.0)], axis=-1)
    vertices = frame.to_local(flat.reshape(-1, 3))
    index = np.arange(z.size).reshape(z.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    quads = np.stack([a, d, c, b], axis=-1)[known[:-1, :-1] & known[:-1, 1:] & known[1:, 1:] & known[1:, :-1]]
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    if (x[-1] > x[0]) != (y[-1] < y[0]):  # a grid that runs the other way would be seen from below
        faces = faces[:, ::-1]
    used = np.unique(faces)
    place = np.full(len(vertices), -1)
    place[used] = np.arange(len(used))
    return Terrain(vertices[used], place[faces], _tint(x, y, z).reshape(-1, 3)[used])


def _around(x: np.ndarray, y: np.ndarray, z: np.ndarray, site: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of a grid around the known points, with half their spread of room, at most TERRAIN_CELLS to a side."""
    known = site[np.isfinite(site).all(axis=1), :2]
    if len(known) >= 2:
        low, high = known.min(axis=0), known.max(axis=0)
        room = 0.5 * float((high - low).max())
        cols, rows = ((v >= a - room) & (v <= b + room) for v, a, b in zip((x, y), low, high, strict=True))
        if cols.sum() >= 2 and rows.sum() >= 2:
            x, y, z = x[cols], y[rows], z[np.ix_(rows, cols)]
    step = -(-max(z.shape) // TERRAIN_CELLS)
    return x[::step], y[::step], z[::step, ::step]


def _tint(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    z = np.where(np.isfinite(z), z, np.nanmean(z))
    dy, dx = np.gradient(z, y, x)
    light = np.array([-0.45, 0.45, 0.77])
    normal = np.stack([-dx, -dy, np.ones_like(z)], axis=-1)
    shade = np.clip((normal @ light) / np.linalg.norm(normal, axis=-1), 0.0, 1.0)[..., None]
    t = ((z - z.min()) / max(float(np.ptp(z)), 1e-9))[..., None]
    low, high = np.array([150.0, 170.0, 140.0]), np.array([206.0, 194.0, 164.0])
    return np.clip((low + t * (high - low)) * (0.45 + 0.6 * shade), 0, 255).astype(np.uint8)


def _level(surface: Any, frame: LocalFrame) -> float | None:
    z = surface.get("z")
    return None if z is None else float(frame.to_local(np.array([*frame.origin[:2], float(z)]))[2])


def _truth(truth: dict[str, Any] | None, frame: LocalFrame) -> dict[str, Exterior]:
    images = (truth or {}).get("images", {})
    return {
        name: Exterior.from_angles(
            *np.radians([v["omega_deg"], v["phi_deg"], v["kappa_deg"]]),
            centre=frame.to_local(np.array([v["X"], v["Y"], v["Z"]], float)),
        )
        for name, v in images.items()
    }
