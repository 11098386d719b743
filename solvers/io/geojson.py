"""Outlines and areas on the map written as GeoJSON, and world files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry import Grid, LocalFrame
from .files import write_json, write_text


def write_areas(path: Path, areas: Sequence[tuple[Sequence[np.ndarray], dict[str, Any]]], crs: str) -> None:
    """Polygons, each of rings (k, 2) on the map (the outer one first, not closed) with its properties, as a FeatureCollection.

    By RFC 7946 in longitude and latitude (WGS84), outer rings counterclockwise; with crs "local", which no map knows, in the
    local coordinates as they are, which the file says. Atomic.
    """
    frame = None if crs == "local" else LocalFrame(np.zeros(3), crs)
    features = []
    for rings, properties in areas:
        turned = [_degrees(_turned(np.asarray(r, float), outer=k == 0), frame) for k, r in enumerate(rings)]
        features.append({"type": "Feature", "geometry": {"type": "Polygon", "coordinates": turned}, "properties": properties})
    value: dict[str, Any] = {"type": "FeatureCollection", "features": features}
    if frame is None:
        value["coordinates"] = "local, metres"
    write_json(path, value)


def _turned(ring: np.ndarray, outer: bool) -> np.ndarray:
    x, y = (ring - ring[0]).T
    left = x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0
    return ring if left == outer else ring[::-1]


def _degrees(ring: np.ndarray, frame: LocalFrame | None) -> list[list[float]]:
    at = ring if frame is None else frame.map_to_degrees(np.column_stack([ring, np.zeros(len(ring))]))[:, :2]
    closed = np.vstack([at, at[:1]])
    return [[round(float(a), 9 if frame else 4), round(float(b), 9 if frame else 4)] for a, b in closed]


def areas_of(number: np.ndarray, grid: Grid) -> list[tuple[int, list[np.ndarray]]]:
    """Areas of equal number in a grid of int16 (rows, columns): the number and the rings (k, 2) on the map, not closed;
    negative numbers are left out."""
    from rasterio.features import shapes
    from rasterio.transform import Affine

    found = shapes(np.ascontiguousarray(number, np.int16), mask=number >= 0, transform=Affine(*grid.affine))
    return [(int(value), [np.array(r[:-1]) for r in shape["coordinates"]]) for shape, value in found]


def write_world_file(out: Path, grid: Grid) -> Path:
    """The world file of a raster (.tfw, .pgw, .jgw): six lines, the last two the CENTRE of the top-left pixel. Atomic."""
    a, b, c, d, e, f = grid.affine
    lines = (a, d, b, e, c + (a + b) / 2, f + (d + e) / 2)
    end = {".png": ".pgw", ".jpg": ".jgw", ".jpeg": ".jgw"}.get(out.suffix.lower(), ".tfw")
    path = out.with_suffix(end)
    write_text(path, "".join(f"{v:.15g}\n" for v in lines))
    return path
