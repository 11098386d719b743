"""What stands on the painted ground: trees and houses, each with its light side and its shadow, painted in place."""

from __future__ import annotations

import numpy as np

from .relief import HALF, river, road, track

_ROOFS = np.array([(168, 92, 70), (150, 80, 62), (184, 108, 82), (136, 128, 122), (160, 100, 84)], np.float32)
_HOUSES, _WOOD, _LONELY, _RIVERSIDE, _ROADSIDE = 30, 460, 220, 300, 90


def paint_houses(picture: np.ndarray, cell: float, clear: np.ndarray, sun: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Paints a hamlet along the road; returns the houses' positions (k, 2) m."""
    placed: list[np.ndarray] = []
    for _ in range(600):
        if len(placed) == _HOUSES:
            break
        north = rng.uniform(-HALF + 30, HALF - 30) if rng.uniform() < 0.3 else rng.normal(-30, 42)
        at = np.array([road(np.array(north)) + rng.choice([-1, 1]) * rng.uniform(13, 30), north])
        heading = np.arctan(0.2) * rng.normal(1, 0.5) + rng.choice([0, np.pi / 2])
        free = [np.linalg.norm(p - at) > 19 for p in placed]
        if (np.linalg.norm(clear - at, axis=1).min() > 14 and all(free) and abs(at[1] - river(at[0])) > 20
                and abs(at[1] - track(at[0])) > 10):
            _house(picture, cell, at, heading, sun, rng)
            placed.append(at)
    return np.array(placed).reshape(-1, 2)


def _window(picture: np.ndarray, cell: float, at: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part (h, w, 3) of the picture within `reach` [m] of a place, as a view, and its east and north offsets [m]."""
    n = len(picture)
    col, row, half = (at[0] + HALF) / cell, (HALF - at[1]) / cell, reach / cell
    left, right, top, bottom = (int(np.clip(v, 0, n)) for v in (col - half, col + half, row - half, row + half))
    east = (np.arange(left, right) + 0.5 - col) * cell
    north = (row - np.arange(top, bottom) - 0.5) * cell
    return (picture[top:bottom, left:right], *np.meshgrid(east, north))


def _house(picture: np.ndarray, cell: float, at: np.ndarray, heading: float, sun: np.ndarray, rng: np.random.Generator) -> None:
    wide, long, high = rng.uniform(3.4, 4.6), rng.uniform(4.6, 7.5), rng.uniform(2.6, 3.8)
    view, east, north = _window(picture, cell, at, 22.0)
    u, v = east * np.cos(heading) + north * np.sin(heading), -east * np.sin(heading) + north * np.cos(heading)
    yard = np.clip((3.0 + wide - np.abs(u)) / 1.5, 0, 1) * np.clip((4.0 + long - np.abs(v)) / 1.5, 0, 1)
    view += (0.75 * yard)[..., None] * (np.array([150, 142, 116], np.float32) - view)
    throw = -sun[:2] / sun[2] * high
    shade = np.zeros(u.shape)
    for part in np.linspace(0, 1, 12):
        e, n = east - throw[0] * part, north - throw[1] * part
        a, b = e * np.cos(heading) + n * np.sin(heading), -e * np.sin(heading) + n * np.cos(heading)
        shade = np.maximum(shade, np.clip((wide - np.abs(a)) / cell, 0, 1) * np.clip((long - np.abs(b)) / cell, 0, 1))
    view *= (1 - 0.5 * shade)[..., None]
    roof = np.clip((wide - np.abs(u)) / cell, 0, 1) * np.clip((long - np.abs(v)) / cell, 0, 1)
    across = np.array([np.cos(heading), np.sin(heading)]) @ sun[:2]
    light = 0.93 + 0.42 * np.sign(u) * across + 0.05 * np.sin(2 * np.pi * v / 1.1)
    light += 0.25 * np.clip(1 - np.abs(u) / 0.25, 0, 1)
    colour = _ROOFS[rng.integers(len(_ROOFS))] * light[..., None]
    view += roof[..., None].astype(np.float32) * (colour.astype(np.float32) - view)


def paint_trees(picture: np.ndarray, cell: float, clear: np.ndarray, sun: np.ndarray, rng: np.random.Generator) -> None:
    """Paints a wood, riverside and roadside trees and single ones, none near the positions `clear` (n, 2) m."""
    spots = _spots(rng)
    radii = np.clip(rng.lognormal(np.log(2.3), 0.35, len(spots)), 1.0, 4.2)
    for at, radius in zip(spots, radii, strict=True):
        on_way = abs(at[0] - road(at[1])) < radius + 4.2 or abs(at[1] - track(at[0])) < radius + 1.5
        wet = abs(at[1] - river(at[0])) < 6.0
        if np.all(np.linalg.norm(clear - at, axis=1) > 8.5) and not on_way and not wet:
            _tree(picture, cell, at, radius, sun, rng)


def _spots(rng: np.random.Generator) -> np.ndarray:
    """Places (n, 2) m for trees."""
    wood = np.concatenate([rng.normal((-150, 110), (38, 30), (_WOOD // 2, 2)), rng.normal((120, -60), (30, 40), (_WOOD // 2, 2))])
    along = rng.uniform(-HALF, HALF, _RIVERSIDE)
    bank = np.column_stack([along, river(along) + rng.choice([-1, 1], _RIVERSIDE) * rng.uniform(7, 14, _RIVERSIDE)])
    way = rng.uniform(-HALF, HALF, _ROADSIDE)
    side = np.column_stack([road(way) + rng.choice([-1, 1], _ROADSIDE) * rng.uniform(7, 9, _ROADSIDE), way])
    return np.concatenate([wood, bank, side, rng.uniform(-HALF, HALF, (_LONELY, 2))])


def _tree(picture: np.ndarray, cell: float, at: np.ndarray, radius: float, sun: np.ndarray, rng: np.random.Generator) -> None:
    view, east, north = _window(picture, cell, at, 3.2 * radius)
    throw = -sun[:2] / sun[2] * radius * 1.1
    far = np.hypot(east - throw[0], north - throw[1]) / (0.95 * radius)
    view *= (1 - 0.5 * np.clip((1.1 - far) / 0.3, 0, 1))[..., None]
    angle = np.arctan2(north, east)
    lobes = sum(rng.uniform(0.03, 0.09) * np.sin(k * angle + rng.uniform(0, 6.3)) for k in (3, 5, 8))
    r = np.hypot(east, north) / (radius * (1 + lobes))
    up = np.sqrt(np.clip(1 - r**2, 0, 1))
    light = (east * sun[0] + north * sun[1]) / radius + up * sun[2]
    leaves = rng.uniform(-0.16, 0.16, r.shape)
    colour = np.array([70, 92, 48]) * rng.uniform(0.8, 1.2) * np.array([rng.uniform(0.85, 1.2), 1, rng.uniform(0.85, 1.1)])
    crown = np.clip((1 - r) / 0.15, 0, 1)[..., None].astype(np.float32)
    shaded = colour * (0.52 + 0.72 * np.clip(light, -0.3, 1) + leaves)[..., None]
    view += crown * (shaded.astype(np.float32) - view)
