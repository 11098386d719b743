"""What the bundle's row shown says: where its images and points are, its residuals."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from solvers import Block, Exterior
from solvers.adjustment import Iteration
from solvers.cameras import project

from .bundle_state import Bundle
from .bundle_values import Judged, Layout
from .kept import by_identity
from .state import Assets, State

LIVE = 30_000
"""Observations up to which residuals are those of the row shown; beyond, those of the last row."""


@by_identity(4)
def _images(layout: Layout) -> Mapping[str, int]:
    return {name: k for k, name in enumerate(layout.images)}


@by_identity(4)
def _points(layout: Layout) -> Mapping[str, int]:
    return {name: k for k, name in enumerate(layout.points)}


def image_number(room: Bundle, name: str) -> int | None:
    """Position of an image in the bundle, None where it is not in it."""
    return None if room.layout is None else _images(room.layout).get(name)


def point_number(room: Bundle, name: str) -> int | None:
    return None if room.layout is None else _points(room.layout).get(name)


def exterior(state: State, name: str) -> Exterior | None:
    """Where the bundle has an image at the row shown, in the scene's frame."""
    room = state.room(Bundle)
    k, row = image_number(room, name), room.at(state.row)
    if room.layout is None or k is None or row is None:
        return None
    centres, matrices = room.layout.poses(row.x)
    return Exterior(matrices[k], centres[k])


def place(state: State, name: str) -> np.ndarray | None:
    """Where the bundle has a point (3,) at the row shown, in the scene's frame."""
    room = state.room(Bundle)
    k, row = point_number(room, name), room.at(state.row)
    return None if room.layout is None or k is None or row is None else room.layout.places(row.x)[k]


@by_identity(2)
def inner_places(layout: Layout, row: Iteration) -> np.ndarray:
    """Where the points (k, 3) are, without the outermost."""
    xyz = layout.places(row.x)
    low, high = np.percentile(xyz, [1, 99], axis=0) if len(xyz) else (0, 0)
    return xyz[((xyz >= low) & (xyz <= high)).all(axis=1)]


@by_identity(2)
def inner_extent(layout: Layout, row: Iteration) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) of those."""
    xyz = inner_places(layout, row)
    return (xyz.min(axis=0), xyz.max(axis=0)) if len(xyz) else (np.full(3, -10.0), np.full(3, 10.0))


@dataclass(frozen=True, eq=False)
class Misfit:
    """Residuals (o, 2) px, observed minus projected, of observations by image and point of the layout, at pixel (o, 2).

    live: they are those of the row shown.
    """

    image: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    v: np.ndarray
    live: bool = True


def misfit(state: State) -> Misfit | None:
    """The residuals at the row shown, of large blocks and of photos that move while they are read those of the last row; None
    before there is anything."""
    room = state.room(Bundle)
    row = room.at(state.row)
    if row is None or room.layout is None or room.block is None:
        return None
    if len(room.block.observations) <= LIVE and not moving(room.layout, row):
        return _misfit(room.layout, room.block, row)
    if room.result is None:
        return None
    return last_misfit(room.result)


def moving(layout: Layout, row: Iteration) -> bool:
    """Whether the images of a row have motions, by which points are seen from where each line was read."""
    asked = layout.manifest["request"].get("rolling_shutter", "none")
    images = len(layout.images)
    beside = len(row.x) - 12 * images - 10 * len(layout.cameras) - 3 * len(layout.points)
    return asked in ("translation", "rotation") or (asked == "auto" and beside >= 6 * images)  # shifts are 3 of a strip, at most


@by_identity(2)
def last_misfit(result: Judged) -> Misfit:
    """The residuals of the last row."""
    return Misfit(result.image, result.point, result.pixel, result.v, False)


@by_identity(2)
def _observed(layout: Layout, block: Block) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observations that take part, by the numbers of the layout and sorted by image: image, point (o,), pixel (o, 2)."""
    images, points, of = _images(layout), _points(layout), block.observations
    image = np.array([images.get(i.name, -1) for i in block.images], int)[of.image]
    point = np.array([points.get(n, -1) for n in block.points.names], int)[of.point]
    rows = np.flatnonzero((image >= 0) & (point >= 0) & np.isfinite(of.pixel).all(axis=1))
    rows = rows[np.argsort(image[rows], kind="stable")]
    return image[rows], point[rows], of.pixel[rows]


@by_identity(8)
def _misfit(layout: Layout, block: Block, row: Iteration) -> Misfit:
    image, point, pixel = _observed(layout, block)
    centres, matrices = layout.poses(row.x)
    places, interiors = layout.places(row.x), layout.interiors_at(row.x)
    ends, v = np.searchsorted(image, np.arange(len(layout.images) + 1)), np.full_like(pixel, np.nan)
    for i in range(len(layout.images)):
        rows = slice(ends[i], ends[i + 1])
        v[rows] = pixel[rows] - project(interiors[layout.camera_of[i]], Exterior(matrices[i], centres[i]), places[point[rows]])
    return Misfit(image, point, pixel, v)


@by_identity(8)
def point_rms(layout: Layout, of: Misfit) -> np.ndarray:
    """Root mean square residual (n,) px of every point, NaN where none is known."""
    square = (of.v**2).sum(axis=1)
    good = np.isfinite(square)
    n = len(layout.points)
    count = np.bincount(of.point[good], minlength=n)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.bincount(of.point[good], square[good], n) / np.where(count > 0, count, np.nan))


@by_identity(4)
def ray_counts(layout: Layout, block: Block) -> np.ndarray:
    """Images (n,) that see every point."""
    return np.bincount(_observed(layout, block)[1], minlength=len(layout.points))


@by_identity(4)
def given_places(layout: Layout, block: Block, assets: Assets) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Control points (a,) and check points (b,) by the numbers of the layout, and given coordinates (n, 3) m, NaN elsewhere."""
    index = _points(layout)
    xyz = np.full((len(layout.points), 3), np.nan)
    rows = np.array([index.get(n, -1) for n in block.points.names], int)
    here = np.flatnonzero(rows >= 0)
    xyz[rows[here]] = assets.frame.to_local(block.points.xyz[here])
    roles = np.array(block.points.role)
    known = np.isfinite(block.points.xyz).all(axis=1) & (rows >= 0)
    return rows[known & (roles == "control")], rows[known & (roles == "check")], xyz
