"""How well neighbouring photos fit along their seams: the shift between them, measured on the mosaic itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .compose import Composition
from .lattice import Nets, Tile
from .resample import Window, warp_onto
from .surface import Ground
from .survey import bounds_of

SIDE = 96
"""px of the patches that are compared."""
MOST = 120
"""Patches at most, spread over the neighbouring pairs."""
SURE = 0.2
"""Least response of the phase correlation (1: the same picture)."""


class SeamCheck(NamedTuple):
    """rms and median length [px of the mosaic] of the shifts between neighbours at `places` on their seams; None without any.

    Seams say how neighbours fit each other, not where the mosaic lies: drift does not show in them."""

    rms: float | None
    median: float | None
    places: int


def check_seams(made: Composition, window: Window) -> SeamCheck:
    """Shifts at places midway between neighbouring photos, by phase correlation; the worst tenth is taken as parallax."""
    import cv2

    pairs = _pairs(made)
    each = max(MOST // max(len(pairs), 1), 1)
    hann, found = cv2.createHanningWindow((SIDE, SIDE), cv2.CV_32F), []
    for a, b in pairs[:MOST]:
        for tile in _places(made, a, b, each):
            nets = _nets(made, (a, b), tile)
            first = _patch(made, a, nets, window)
            second = None if first is None else _patch(made, b, nets, window)
            if first is None or second is None or min(first.std(), second.std()) < 3:
                continue
            (dx, dy), response = cv2.phaseCorrelate(first, second, hann)
            if response > SURE and max(abs(dx), abs(dy)) < SIDE / 4:
                found.append(np.hypot(dx, dy))
    if not found:
        return SeamCheck(None, None, 0)
    shifts = np.sort(found)
    kept = shifts[:max(int(np.ceil(0.9 * len(shifts))), 1)]
    return SeamCheck(float(np.sqrt(np.mean(kept**2))), float(np.median(shifts)), len(shifts))


def _pairs(made: Composition) -> list[tuple[int, int]]:
    """Photos and their three nearest neighbours, the nearest pairs first."""
    feet = made.canvas.feet
    away = np.linalg.norm(feet[:, None] - feet[None], axis=2)
    np.fill_diagonal(away, np.inf)
    near = {tuple(sorted((k, int(j)))) for k in range(len(feet)) for j in np.argsort(away[k])[:3] if np.isfinite(away[k, j])}
    order = sorted(near, key=lambda p: float(away[p]))
    step = max(len(order) // MOST, 1)
    return [(int(p[0]), int(p[1])) for p in order[::step]]


def _places(made: Composition, a: int, b: int, count: int) -> list[Tile]:
    """Patches across the line midway between the feet of two photos."""
    feet = made.canvas.feet
    middle, along = (feet[a] + feet[b]) / 2, feet[b] - feet[a]
    across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9)
    reach = 0.3 * min(float(np.ptp(made.canvas.outlines[k], axis=0).min()) for k in (a, b))
    at = middle + np.linspace(-reach, reach, max(count, 3))[:, None] * across
    pixels = np.round(made.canvas.grid.to_pixels(at)).astype(int) - SIDE // 2
    rows, columns = made.canvas.grid.shape
    return [Tile(int(r), int(c), SIDE, SIDE) for c, r in pixels if 0 <= r <= rows - SIDE and 0 <= c <= columns - SIDE]


def _nets(made: Composition, pair: tuple[int, int], tile: Tile) -> Nets:
    """The surface under a patch."""
    ground, grid = made.ground, made.canvas.grid
    if made.surface is not None:
        ground = Ground(ground.frame, made.surface(bounds_of(grid, tile, ground, [made.photos[k] for k in pair])))
    return Nets(grid, tile, ground)


def _patch(made: Composition, k: int, nets: Nets, window: Window) -> np.ndarray | None:
    """Grey values (SIDE, SIDE) float32 of one photo alone; None where it does not show all of it."""
    photo = made.photos[k]
    lattice = nets.lattice(photo)
    if lattice is None:
        return None
    acc = np.zeros((SIDE, SIDE, 4), np.float32)
    warp_onto(acc, photo, lattice, window, made.options.resample)
    return acc[..., :3].mean(-1) if (acc[..., 3] > 0).all() else None
