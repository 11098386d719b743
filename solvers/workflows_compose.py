"""The composing half of a mosaic: registered photos -> surface -> tiles -> GeoTIFF."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .errors import BadProject, Unsupported
from .execution import Progress, each, timed
from .geometry import Grid, Surface
from .io import (
    Coding,
    Part,
    PhotoStore,
    TileFolder,
    areas_of,
    crs,
    encode_tile,
    full_disk,
    no_space,
    photo_size,
    photo_state,
    read_surface,
    thumbnail,
    to_picture,
    write_areas,
    write_cog,
    write_world_file,
)
from .mosaic import (
    ComposeOptions,
    Composition,
    Job,
    MosaicPlane,
    Placed,
    Registration,
    SeamCheck,
    check_seams,
    coarse,
    composition,
    half,
    render,
)
from .mosaic.surface import Ground

PICTURES = (".png", ".jpg", ".jpeg")
RASTERS = (".tif", ".tiff")
PER_TILE, PER_BANDED = 0.08, 0.22
"""GB that a tile in work takes, blended at once or in bands, ..."""
AT_LEAST, ROOM = 0.235, 0.66
"""... GB that the programme takes without any, and GB to stay within unless told otherwise."""


@dataclass(frozen=True)
class ComposeRequest:
    """How a mosaic is composed. surface: "plane" or a DEM's file; gsd [m], None: of the photos; memory [GB] to stay within;
    crs: of the map, None: the registration's (a block in frame "grid" is local, its map is not). compression and nodata: see
    `Coding`."""

    surface: str = "plane"
    gsd: float | None = None
    resample: Literal["nearest", "bilinear", "bicubic"] = "bilinear"
    blend: Literal["none", "average", "feather", "multiband"] = "feather"
    seams: bool = False
    gain: bool = False
    memory: float | None = None
    workers: int = 1
    scheduler: str | None = None
    compression: Literal["deflate", "zstd", "jpeg", "none"] = "deflate"
    crs: str | None = None
    nodata: int | None = None

    @property
    def coding(self) -> Coding:
        """How the file holds pixels."""
        return Coding(self.compression, self.nodata)


def compose_photos(registration: Registration, photos: Mapping[str, Path], out: Path, request: ComposeRequest,
                   report: Callable[[Progress], object] | None = None) -> dict[str, Any]:
    """Compose registered photos (files by image name) into one raster file; gives width, height, bounds, seam_rms, seconds and
    what else the JSON of the command mosaic says of it.

    Beside it: a world file, OUT.footprints.geojson and with seams OUT.seams.geojson. Raises PhotogrammetryError.
    """
    out, request = _must_be_writable(Path(out), request)
    _must_be_no_source(out, [*photos.values(), *([Path(request.surface)] if request.surface != "plane" else [])])
    start, spent, files = time.perf_counter(), time.process_time(), {n: Path(photos[n]) for n in registration.names}
    placed = [_placed(registration, k, files[n]) for k, n in enumerate(registration.names)]
    ground, surface = ground_of(registration, placed, request)
    folder = TileFolder(out, _plan(registration, placed, files, request))
    store = PhotoStore(folder.folder / "photos", files)
    options = ComposeOptions(request.gsd, request.resample, request.blend, request.seams, request.gain)
    made = composition(placed, ground, options, partial(_small, files=files) if len(placed) > 1 else None, surface)
    planned = time.perf_counter()
    try:
        notes = _tiles(made, folder, store, request, report)
        tiled = time.perf_counter()
        seams = check_seams(made, store.window) if len(placed) > 1 else SeamCheck(None, None, 0)
        _finish(made, folder, request, registration.unit, _crs(registration, request))
        _beside(made, out, _crs(registration, request))
        folder.remove()
    finally:
        folder.release()
    seconds = {"plan": planned - start, "tiles": tiled - planned, "write": time.perf_counter() - tiled}
    return {**_said(made, registration), "crs": _crs(registration, request), **notes, "seam_rms": seams.rms,
            "seams": seams._asdict(), "seconds": seconds, "cpu_seconds": time.process_time() - spent,
            "peak_memory_mb": peak_memory_mb()}


def make_tile(job: Job, store: PhotoStore, coding: Coding) -> Part:
    """One tile, encoded; at the top of a module, so that workers anywhere find it."""
    return encode_tile(job.index, render(job, store.window), half, coding)


def peak_memory_mb() -> float | None:
    """The most memory [MB] that this process has had, None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)


# -- what it is made of -----------------------------------------------------------------------------------------------------


def _must_be_writable(out: Path, request: ComposeRequest) -> tuple[Path, ComposeRequest]:
    if out.suffix.lower() not in RASTERS + PICTURES:
        raise Unsupported(f"{out}: a mosaic is written as .tif, .png or .jpg; choose one of these endings")
    if not out.resolve().parent.is_dir():
        raise BadProject(f"{out}: there is no such folder; make it first or correct the path")
    if out.is_dir():
        raise BadProject(f"{out}: this is a folder; give the name of a file")
    picture = out.suffix.lower() in PICTURES
    if picture and request.nodata is not None:
        raise Unsupported(f"{out}: a nodata value is for .tif; a .png has alpha, a .jpg is white where nothing is seen")
    if request.nodata is not None and not 0 <= request.nodata <= 255:
        raise BadProject(f"nodata {request.nodata}: pixels are bytes; give a value from 0 to 255")
    if request.compression == "jpeg" and request.nodata is not None:
        raise BadProject("JPEG does not keep a nodata value as it is; leave --nodata out (the file gets a mask), or take "
                         "--compression deflate")
    return out.resolve(), replace(request, compression="deflate") if picture else request


def _must_be_no_source(out: Path, sources: Iterable[Path]) -> None:
    if out in {file.resolve() for file in map(Path, sources)}:
        raise BadProject(f"{out}: the mosaic is made from this file; give another name")


def _placed(registration: Registration, k: int, file: Path) -> Placed:
    """A photo with its place, in the pixels of its file, which may be smaller than the camera's format."""
    interior, (width, height) = registration.interiors[k], photo_size(file)
    if abs(width * interior.height - height * interior.width) > 0.01 * width * interior.height:
        raise BadProject(f"{file}: {width} x {height} pixels do not have the shape of its camera's {interior.width} x "
                         f"{interior.height}; correct the camera or name the right photo")
    return placed_at(registration, k, (width, height))


def placed_at(registration: Registration, k: int, size: tuple[int, int]) -> Placed:
    """A photo with its place, in the pixels of a picture of this size (width, height) that shows all of it."""
    interior, (width, height) = registration.interiors[k], size
    s = np.array([width / interior.width, height / interior.height])
    if (s != 1).any():
        pitch = interior.pitch / s
        interior = replace(interior, pixel_mm=(float(pitch[0]), float(pitch[1])), width=width, height=height)
    if registration.kind == "exterior":
        return Placed(registration.names[k], interior, registration.exteriors[k])
    zoom = np.array([[s[0], 0, (s[0] - 1) / 2], [0, s[1], (s[1] - 1) / 2], [0, 0, 1]])
    bend = None if registration.bends is None else registration.bends[k] * np.repeat(s, 3)
    return Placed(registration.names[k], interior, warp=zoom @ registration.warps[k], bend=bend)


def ground_of(registration: Registration, placed: list[Placed], request: ComposeRequest,
              ) -> tuple[Ground, Callable[[tuple[float, float, float, float]], Surface] | None]:
    """The surface, whole but coarse where it is a height grid, and how its parts are read."""
    plane = Ground(registration.frame, MosaicPlane(*map(float, registration.plane)))
    if request.surface == "plane":
        return plane, None
    if registration.kind == "plane":
        raise Unsupported(f"--surface {request.surface}: over a height grid every photo needs its exterior orientation, and "
                          "these have plane coefficients only; leave --surface out, or give flight data or control points")
    outlines = np.vstack([p.outline(plane)[0] for p in placed])
    cameras = np.array([plane.frame.to_map(p.exterior.centre)[:2] for p in placed if p.exterior is not None])
    low, high = np.min([outlines.min(0), cameras.min(0)], axis=0), np.max([outlines.max(0), cameras.max(0)], axis=0)
    reach = 0.25 * (high - low)
    west, south, east, north = (float(v) for v in (*(low - reach), *(high + reach)))
    whole = read_surface(request.surface, (west, south, east, north))
    if not crs.same_map(whole.grid.crs, _crs(registration, request)):
        raise BadProject(f"{request.surface}: its crs is not the mosaic's, '{_crs(registration, request)}'; warp the DEM to it")
    whole = _on_map(whole, registration)
    if not np.isfinite(whole.z).any():
        raise BadProject(f"{request.surface}: the height grid has no heights at this place; take one of the site, in the "
                         "same crs")
    return Ground(registration.frame, coarse(whole)), partial(_heights, Path(request.surface), registration)


def _crs(registration: Registration, request: ComposeRequest) -> str:
    return request.crs or registration.crs


def _on_map(surface: Surface, registration: Registration) -> Surface:
    return replace(surface, grid=replace(surface.grid, crs=registration.crs))


def _heights(path: Path, registration: Registration, bounds: tuple[float, float, float, float]) -> Surface:
    """Heights within bounds; none of a place beyond the grid."""
    try:
        return _on_map(read_surface(path, bounds), registration)
    except BadProject:
        west, _, _, north = bounds
        return Surface(Grid((2, 2), (1.0, 0.0, west, 0.0, -1.0, north)), np.full((2, 2), np.nan), name=path.name)


def _small(name: str, side: int, files: Mapping[str, Path]) -> np.ndarray:
    return thumbnail(files[name], side).pixels


def _plan(registration: Registration, placed: list[Placed], files: Mapping[str, Path], request: ComposeRequest) -> str:
    """A word that changes when the mosaic would."""
    dem = None if request.surface == "plane" else photo_state(Path(request.surface)) if Path(request.surface).is_file() else ""
    each_photo = [(p.name, photo_state(files[p.name]), p.interior.parameters.tolist(), p.interior.pitch.tolist(),
                   None if p.exterior is None else p.exterior.vector.tolist(), None if p.warp is None else p.warp.tolist(),
                   None if p.bend is None else p.bend.tolist())
                  for p in placed]
    text = json.dumps([each_photo, registration.crs, registration.frame.origin.tolist(), registration.plane.tolist(), dem,
                       request.surface, request.gsd, request.resample, request.blend, request.seams, request.gain,
                       request.compression, request.nodata])
    return hashlib.sha256(text.encode()).hexdigest()


# -- the work ---------------------------------------------------------------------------------------------------------------


def _tiles(made: Composition, folder: TileFolder, store: PhotoStore, request: ComposeRequest,
           report: Callable[[Progress], object] | None) -> dict[str, Any]:
    """All tiles that are not there yet."""
    tile = PER_BANDED if request.blend == "multiband" else PER_TILE
    workers = int(np.clip(((request.memory or ROOM) - AT_LEAST) // tile, 1, max(request.workers, 1)))
    finished = frozenset[int]()
    order: list[int] = []
    try:
        finished, order = folder.open(), made.order()
        work = partial(make_tile, store=store, coding=request.coding)
        left = sum(k not in finished for k in order)
        results = each(work, made.jobs(finished), workers, request.scheduler, threads=True)
        for _, part in timed("tiles", results, left, report):
            folder.keep(part)
    except OSError as error:
        if no_space(error):
            raise full_disk(folder.out, error, sum(1 for _ in folder.folder.glob("*.tile")), len(order)) from None
        raise
    return {"tiles": len(order), "tiles_kept": len(finished & set(order))}


def _finish(made: Composition, folder: TileFolder, request: ComposeRequest, unit: str, map_crs: str) -> None:
    grid = replace(made.canvas.grid, crs=map_crs)
    try:
        if folder.out.suffix.lower() in RASTERS:
            write_cog(folder, grid, made.tiles, half, request.coding)
            return
        whole = folder.folder / "whole.tif"
        write_cog(folder, grid, made.tiles, half, request.coding, whole)
        to_picture(whole, folder.out, f"1 px = {made.canvas.gsd:g} {unit}")
    except OSError as error:
        if no_space(error):
            raise full_disk(folder.out, error, len(made.order()), len(made.order())) from None
        raise


def _beside(made: Composition, out: Path, map_crs: str) -> None:
    """World file, footprints, seams."""
    write_world_file(out, made.canvas.grid)
    rings = [([o], {"image": p.name, "whole": w}) for p, o, w in zip(made.photos, made.canvas.outlines, made.canvas.whole,
                                                                   strict=True)]
    write_areas(out.with_suffix(".footprints.geojson"), rings, map_crs)
    if made.labels is not None:
        areas = [(r, {"image": made.photos[k].name}) for k, r in areas_of(made.labels.number, made.labels.grid)]
        write_areas(out.with_suffix(".seams.geojson"), areas, map_crs)


def _said(made: Composition, registration: Registration) -> dict[str, Any]:
    rows, columns = made.canvas.grid.shape
    cut = [p.name for p, w in zip(made.photos, made.canvas.whole, strict=True) if not w]
    horizon = [f"image '{n}' shows the horizon: only its ground up to 75 degrees from the vertical is used" for n in cut]
    evened = made.evened
    return {"width": columns, "height": rows, "bounds": made.canvas.bounds, "gsd": made.canvas.gsd,
            "unit": registration.unit, "horizon": cut, "notes": horizon,
            "gain": None if evened is None else {"rms_before": evened.before, "rms_after": evened.after, "places": evened.places}}
