"""A map or orthophoto compared with a mosaic: windows of the mosaic are looked for in it by correlation and least squares."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from solvers import BadProject
from solvers.geometry import Grid
from solvers.io.mapped import read_mapped
from solvers.mosaic import Ground, MosaicPlane, Registration

from .mosaic_state import Layer, Tile
from .uploads import is_tiff

EVERY, WINDOW, SEARCH = 48, 31, 24
"""px of the mosaic as shown: distance of the windows, their side, how far each is looked for."""
LEAST = 0.6
"""Correlation below which no match is believed."""


def assembled(tiles: Mapping[int, Tile], grid: Grid, side: int = 256) -> np.ndarray:
    """The mosaic as shown, (rows, columns, 4) uint8."""
    rows, columns = grid.shape
    out, across = np.zeros((rows, columns, 4), np.uint8), -(-columns // side)
    for number, tile in tiles.items():
        i, j = divmod(number, across)
        h, w = tile.rgba.shape[:2]
        out[i * side : i * side + h, j * side : j * side + w] = tile.rgba[: rows - i * side, : columns - j * side]
    return out


def layer_work(path: Path, tiles: Mapping[int, Tile], grid: Grid, r: Registration) -> Iterator[str | Layer]:
    """Words, the layer as a picture, the same with its offsets, then words alone on what came of it (a Layer without picture)."""
    if r.unit != "m":
        raise BadProject(
            "an uncontrolled mosaic has no map coordinates; make a semicontrolled or controlled one to compare it with "
            f"{path.name}"
        )
    if path.is_file():
        with open(path, "rb") as stream:
            if not is_tiff(stream.read(4)):
                raise BadProject(f"{path.name} is no TIFF; give a map or orthophoto as GeoTIFF")
    yield f"Reading {path.name}"
    rgba = read_mapped(path, grid)
    corners = Ground(r.frame, MosaicPlane(*map(float, r.plane))).local(grid.corners)
    layer = Layer(path.name, Tile(0, rgba, corners))
    yield layer
    yield f"Looking for the mosaic in {path.name}"
    found = offsets(layer, assembled(tiles, grid), rgba, grid)
    yield found
    yield replace(found, tile=None)


def offsets(layer: Layer, mosaic: np.ndarray, other: np.ndarray, grid: Grid) -> Layer:
    """The layer with the offsets (layer minus mosaic) of a net of windows; mosaic, other (rows, columns, 4) uint8, one raster."""
    import cv2

    from solvers.matching import match_lsm

    rows, columns = grid.shape
    reach = WINDOW // 2 + 3
    inside = [
        cv2.erode((p[..., 3] > 250).astype(np.uint8), np.ones((2 * reach + 1,) * 2, np.uint8), borderValue=0)
        for p in (mosaic, other)
    ]
    col, row = np.meshgrid(np.arange(reach, columns - reach, EVERY), np.arange(reach, rows - reach, EVERY))
    at = np.stack([col.ravel(), row.ravel()], axis=1)
    at = at[(inside[0][at[:, 1], at[:, 0]] > 0) & (inside[1][at[:, 1], at[:, 0]] > 0)].astype(float)
    if not len(at):
        return replace(layer, words=f"{layer.name} and the mosaic share no area of {2 * reach} px; nothing to compare.")
    grey = [cv2.cvtColor(np.ascontiguousarray(p[..., :3]), cv2.COLOR_RGB2GRAY).astype(np.float32) for p in (mosaic, other)]
    matched = match_lsm(grey[0], grey[1], at, at, WINDOW, search=SEARCH, threshold=LEAST)
    ok = matched.ok & (
        inside[1][tuple(np.clip(np.nan_to_num(np.round(matched.pixel)).astype(int)[:, ::-1].T, 0, [[rows - 1], [columns - 1]]))]
        > 0
    )
    place, off = grid.to_map(at[ok]), grid.to_map(matched.pixel[ok]) - grid.to_map(at[ok])
    score = matched.score[ok]
    if not len(off):
        return replace(
            layer,
            words=f"None of {len(at)} windows was found in {layer.name}: it looks too different, or lies more than "
            f"{SEARCH * grid.affine[0]:.3g} m away.",
        )
    away = np.linalg.norm(off - np.median(off, axis=0), axis=1)
    good = away <= max(5 * float(np.median(away)), 0.5 * grid.affine[0])
    layer = replace(layer, at=place[good], off=off[good], score=score[good])
    mean = layer.mean
    words = (
        f"{layer.name}: {good.sum()} of {len(at)} windows found ({(~good).sum()} left out as wrong); layer minus mosaic, mean "
        f"{mean[0]:+.3f} m east, {mean[1]:+.3f} m north, rms {layer.rms:.3f} m."
    )
    return replace(layer, words=words)


def csv_of(layer: Layer) -> str:
    """The offsets as a table: map places of the mosaic, layer minus mosaic [m], correlation."""
    lines = ["x_m,y_m,dx_m,dy_m,score"]
    lines += [
        f"{x:.3f},{y:.3f},{dx:.4f},{dy:.4f},{s:.3f}" for (x, y), (dx, dy), s in zip(layer.at, layer.off, layer.score, strict=True)
    ]
    return "\n".join(lines) + "\n"
