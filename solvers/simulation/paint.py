"""The picture painted on the ground: fields, river, road, track, wood, hamlet, trees, and the light of a morning sun.

Pure decoration, but seen from the air it should read as land: every later photo of the block is made from it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .objects import paint_houses, paint_trees
from .relief import HALF, RIVER_HALF_WIDTH, river, road, track
from .terrain import Terrain

SUN = np.array([-0.56, 0.50, 0.66])  # towards the sun: north-west, 41 degrees high
_CROPS = np.array([(110, 126, 76), (94, 114, 68), (80, 101, 62), (136, 140, 90), (170, 158, 116), (142, 120, 94), (118, 98, 80),
                   (122, 132, 92), (152, 142, 106), (100, 112, 74), (126, 124, 84)], np.float32)
_ROAD_HALF, _TRACK_HALF = 3.2, 1.5  # m


def paint_ground(terrain: Terrain, middle: np.ndarray, clear: np.ndarray, seed: np.random.SeedSequence,
                 cell: float) -> np.ndarray:
    """The picture (n, n, 3) uint8 RGB on the scene's square, first row north, pixels of `cell` [m].

    clear: (m, 2) local positions [m] that trees, houses and their shadows leave free.
    """
    rng = np.random.default_rng(seed)
    axis = (np.arange(round(2 * HALF / cell), dtype=np.float32) + 0.5) * np.float32(cell) - np.float32(HALF)
    x, y = np.meshgrid(axis, axis[::-1])
    picture = _fields(x, y, rng)
    _track(picture, x, y, axis, rng)
    _river(picture, x, y, axis, rng)
    _road(picture, x, y, axis[::-1])
    picture *= _light(terrain, middle, x, y)[..., None]
    houses = paint_houses(picture, cell, clear, SUN, rng)
    paint_trees(picture, cell, np.concatenate([clear, houses]), SUN, rng)
    picture *= (1 + 0.05 * _clouds(len(axis), 0.9, 0.2, rng))[..., None]
    picture += 0.07 * (np.array([150, 158, 168], np.float32) - picture)  # haze
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)


def _noise(n: int, wavelength: float, rng: np.random.Generator) -> np.ndarray:
    """Smooth random picture (n, n) in about -1..1 over the scene, its grains `wavelength` [m] wide."""
    import cv2

    k = min(n, round(2 * HALF / wavelength))
    return cv2.resize(rng.uniform(-1, 1, (k, k)).astype(np.float32), (n, n), interpolation=cv2.INTER_CUBIC)


def _clouds(n: int, longest: float, shortest: float, rng: np.random.Generator, fade: float = 0.7) -> np.ndarray:
    """Sum of noise pictures, each half as coarse and `fade` as strong as the one before."""
    total, strength = np.zeros((n, n), np.float32), np.float32(0.7)
    while longest >= shortest:
        total += strength * _noise(n, longest, rng)
        longest, strength = longest / 2, strength * np.float32(fade)
    return total


def _fields(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Parcels, each with its crop, its rows, its mottling and its hedge."""
    n = len(x)
    parcel, edge, u, v = _parcels(x, y, rng)
    crop = _CROPS[rng.integers(0, len(_CROPS), 997)] * rng.uniform(0.92, 1.06, (997, 1))
    period = rng.uniform(1.2, 2.6, 997).astype(np.float32)[parcel]
    depth = rng.choice([0.0, 0.02, 0.05, 0.08], 997).astype(np.float32)[parcel]
    along = np.where((rng.uniform(size=997) < 0.5)[parcel], v, u)
    del u, v
    along += 0.3 * _noise(n, 3.0, rng)
    shade = 1 + depth * np.sin(np.float32(2 * np.pi) * along / period) * (1 + 0.6 * _noise(n, 5.0, rng))
    del along, period, depth
    rough = rng.uniform(0.06, 0.17, 997).astype(np.float32)[parcel]
    shade += rough * _clouds(n, 2.4, 0.3, rng, 0.85) + 0.11 * _clouds(n, 40.0, 4.0, rng)
    edge += 0.5 * _noise(n, 2.5, rng) + 0.3 * _noise(n, 0.8, rng)
    picture = crop.astype(np.float32)[parcel]
    picture *= shade[..., None]
    return _over(picture, np.clip(1.2 - edge, 0, 1) * 0.75, (88, 100, 58))


def _parcels(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Number (0..996) and distance from the edge [m] of the parcel at each place, and coordinates [m] along its two sides.

    The parcels are cut from columns of a warped, turned grid.
    """
    n, turn = len(x), np.radians(17.0)
    u = x * np.float32(np.cos(turn)) + y * np.float32(np.sin(turn)) + 6 * _noise(n, 90.0, rng) + 400
    v = -x * np.float32(np.sin(turn)) + y * np.float32(np.cos(turn)) + 6 * _noise(n, 80.0, rng) + 400
    width = np.float32(58.0)
    column = (u / width).astype(np.int32)
    w = v + rng.uniform(0, 40, 32).astype(np.float32)[column]
    step = rng.uniform(24, 52, 32).astype(np.float32)[column]
    row = (w / step).astype(np.int32)
    inside, along = u - column * width, w - row * step
    edge = np.minimum(np.minimum(inside, width - inside), np.minimum(along, step - along))
    return ((column * 37 + row * 101) % 997).astype(np.int16), edge, u, v


def _over(picture: np.ndarray, cover: np.ndarray, colour: tuple[float, float, float]) -> np.ndarray:
    """Lays a colour over the picture, in place, where `cover` (h, w) is 1; returns it."""
    where = cover > 0
    under = picture[where]
    picture[where] = under + cover[where].astype(np.float32)[:, None] * (np.array(colour, np.float32) - under)
    return picture


def _river(picture: np.ndarray, x: np.ndarray, y: np.ndarray, axis: np.ndarray, rng: np.random.Generator) -> None:
    off = np.abs(y - river(x)) / _stretch(river, axis)[None, :]
    off = off + 0.9 * _noise(len(x), 9.0, rng) + 0.3 * _noise(len(x), 2.0, rng)
    _over(picture, 0.75 * np.clip((RIVER_HALF_WIDTH + 5.0 - off) / 4.0, 0, 1), (104, 118, 70))
    _over(picture, np.clip((RIVER_HALF_WIDTH + 1.0 - off) / 0.5, 0, 1), (158, 146, 116))
    _over(picture, np.clip((RIVER_HALF_WIDTH - off) / 0.6, 0, 1), (92, 112, 104))
    _over(picture, 0.8 * np.clip((RIVER_HALF_WIDTH - 1.0 - off) / 3.0, 0, 1), (52, 80, 86))


def _road(picture: np.ndarray, x: np.ndarray, y: np.ndarray, axis: np.ndarray) -> None:
    off = (x - road(y)) / _stretch(road, axis)[:, None]
    side = np.abs(off)
    _over(picture, 0.7 * np.clip((_ROAD_HALF + 1.4 - side) / 0.6, 0, 1), (150, 142, 118))
    _over(picture, np.clip((_ROAD_HALF - side) / 0.2, 0, 1), (128, 128, 130))
    line = np.clip(1.5 - np.abs(side - (_ROAD_HALF - 0.35)) / 0.1, 0, 1)
    _over(picture, 0.8 * line, (222, 222, 216))
    dashes = np.clip(1.5 - side / 0.1, 0, 1) * (np.mod(y, 9.0) < 4.0)
    _over(picture, 0.8 * dashes, (226, 226, 220))


def _track(picture: np.ndarray, x: np.ndarray, y: np.ndarray, axis: np.ndarray, rng: np.random.Generator) -> None:
    side = np.abs(y - track(x)) / _stretch(track, axis)[None, :] + 0.25 * _noise(len(x), 4.0, rng)
    _over(picture, 0.9 * np.clip((_TRACK_HALF - side) / 0.4, 0, 1), (176, 156, 122))
    _over(picture, 0.6 * np.clip((0.45 - side) / 0.3, 0, 1), (120, 128, 78))


def _stretch(course: Callable[[np.ndarray], np.ndarray], axis: np.ndarray) -> np.ndarray:
    """sqrt(1 + slope^2) of a course along its axis: turns a distance across the axis into one across the course."""
    return np.sqrt(1 + np.gradient(course(axis), axis) ** 2).astype(np.float32)


def _light(terrain: Terrain, middle: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Brightness of the ground by its slope to the sun, 1 on level ground, from heights smoothed by one cell."""
    import cv2

    heights = cv2.GaussianBlur(terrain.heights, (0, 0), 0.9)
    by_row, by_column = np.gradient(heights, terrain.cell)
    cosine = (-by_column * SUN[0] + by_row * SUN[1] + SUN[2]) / np.sqrt(1 + by_row**2 + by_column**2)
    shade = np.clip(cosine / SUN[2], 0.25, 1.5) ** 0.9
    u = ((x + middle[0] - terrain.west) / terrain.cell).astype(np.float32)
    v = ((terrain.north - y - middle[1]) / terrain.cell).astype(np.float32)
    return cv2.remap(shade.astype(np.float32), u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
