"""Numbers behind the bundle's residual plots, pure: vectors of an image, radial profile and mean field of a camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solvers import Interior

from .bundle_rows import Misfit, image_number, misfit
from .bundle_state import Bundle
from .bundle_values import Layout
from .kept import by_identity
from .state import State

BINS = 10
CELLS = (8, 6)
"""Cells of the mean residual field along the longer and the shorter side."""


@dataclass(frozen=True, eq=False)
class Vectors:
    """Residuals of one image: pixel (n, 2), v (n, 2) px, names (n,)."""

    interior: Interior
    pixel: np.ndarray
    v: np.ndarray
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Profile:
    """Radial part of a camera's residuals, positive outwards: radius (b,) mm, mean, its standard error and spread (b,) px,
    count (b,)."""

    radius: np.ndarray
    mean: np.ndarray
    error: np.ndarray
    spread: np.ndarray
    count: np.ndarray


@dataclass(frozen=True, eq=False)
class Field:
    """Mean residuals of a camera in cells of its format: middle (c, 2) px, mean (c, 2) px, count (c,)."""

    interior: Interior
    middle: np.ndarray
    mean: np.ndarray
    count: np.ndarray


def image_vectors(state: State, name: str) -> Vectors | None:
    """The residuals of an image at the row shown; None where it is not in the bundle."""
    room = state.room(Bundle)
    k, of, row = image_number(room, name), misfit(state), room.at(state.row)
    if k is None or of is None or room.layout is None or row is None:
        return None
    rows = np.flatnonzero((of.image == k) & np.isfinite(of.v).all(axis=1))
    interior = room.layout.interiors_at(row.x)[room.layout.camera_of[k]]
    return Vectors(interior, of.pixel[rows], of.v[rows], tuple(room.layout.points[j] for j in of.point[rows]))


def camera_of(state: State, name: str) -> int | None:
    """The camera's number of an image of the bundle."""
    room = state.room(Bundle)
    k = image_number(room, name)
    return None if k is None or room.layout is None else int(room.layout.camera_of[k])


def camera_figures(state: State, camera: int) -> tuple[Profile, Field] | None:
    """Radial profile and mean field of a camera over all its images at the row shown."""
    room = state.room(Bundle)
    of, row = misfit(state), room.at(state.row)
    if of is None or room.layout is None or row is None:
        return None
    given = room.result.interiors if room.result is not None and not of.live else _interiors(room.layout, row)
    interior = given[camera]
    return _figures(room.layout, of, interior, camera)


@by_identity(32)
def _interiors(layout: Layout, row: object) -> tuple[Interior, ...]:
    return layout.interiors_at(row.x)  # type: ignore[attr-defined]


@by_identity(4)
def _figures(layout: Layout, of: Misfit, interior: Interior, camera: int) -> tuple[Profile, Field]:
    rows = np.flatnonzero((layout.camera_of[of.image] == camera) & np.isfinite(of.v).all(axis=1))
    return profile(interior, of.pixel[rows], of.v[rows]), field(interior, of.pixel[rows], of.v[rows])


def profile(interior: Interior, pixel: np.ndarray, v: np.ndarray, bins: int = BINS) -> Profile:
    """Radial profile of residuals v (n, 2) px at pixel (n, 2), in rings of equal width around the principal point."""
    away = (pixel - interior.pixels(interior.principal_point)) * interior.pitch  # mm
    radius = np.linalg.norm(away, axis=1)
    radial = (v * away).sum(axis=1) / np.maximum(radius, 1e-12)
    edges = np.linspace(0, float(radius.max(initial=1e-9)) * (1 + 1e-9), bins + 1)
    ring = np.clip(np.searchsorted(edges, radius, side="right") - 1, 0, bins - 1)
    count = np.bincount(ring, minlength=bins)
    n = np.maximum(count, 1)
    mean = np.bincount(ring, radial, bins) / n
    square = np.bincount(ring, (radial - mean[ring]) ** 2, bins)
    spread = np.sqrt(square / np.maximum(count - 1, 1))
    known = count > 1
    return Profile(((edges[1:] + edges[:-1]) / 2)[known], mean[known], (spread / np.sqrt(n))[known], spread[known], count[known])


def field(interior: Interior, pixel: np.ndarray, v: np.ndarray, cells: tuple[int, int] = CELLS) -> Field:
    """Mean residual of every cell of the format that holds a measurement."""
    across, down = cells if interior.width >= interior.height else cells[::-1]
    size = np.array([interior.width / across, interior.height / down])
    at = np.clip(((pixel + 0.5) / size).astype(int), 0, [across - 1, down - 1])
    cell = at[:, 1] * across + at[:, 0]
    count = np.bincount(cell, minlength=across * down)
    n = np.maximum(count, 1)
    mean = np.stack([np.bincount(cell, v[:, c], across * down) / n for c in (0, 1)], axis=1)
    index = np.flatnonzero(count)
    middle = (np.stack([index % across, index // across], axis=1) + 0.5) * size - 0.5
    return Field(interior, middle, mean[index], count[index])


def inside(start: np.ndarray, way: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Which share (n,) of arrows from start (n, 2) along way (n, 2) lies in a frame from 0, 0 to its size; 1: all of it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        room = np.where(way > 0, (np.asarray(size) - start) / way, np.where(way < 0, -start / way, np.inf))
    return np.clip(np.nan_to_num(room, nan=1.0).min(axis=1, initial=1.0), 0.0, 1.0)


def cut_words(share: np.ndarray) -> str:
    """What is to be said of arrows of which only a share (n,) is drawn, "" where none is cut."""
    count = int((share < 1).sum())
    return f", {count} end{'s' if count == 1 else ''} at the frame" if count else ""
