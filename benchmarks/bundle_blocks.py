"""Blocks of the bundle benchmark: double grids of near-vertical photos with start values off the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solvers import Interior
from solvers.geometry import exp, rotation
from solvers.geometry.pose import Exterior

UTM = np.array([679_421.0, 9_123_785.0, 100.0])
PIXEL, WIDTH, HEIGHT, NOISE = 0.00392, 6000, 4000, 0.3
TRUE = Interior(35.0, 0.02, -0.015, pixel_mm=PIXEL, width=WIDTH, height=HEIGHT)
START = Interior(35.14, pixel_mm=PIXEL, width=WIDTH, height=HEIGHT)


def block(m: int, points_per_image: int = 200) -> dict[str, Any]:
    """Start values and observations (sorted by point) of a block of m images, every point in three to twelve of them."""
    rng = np.random.default_rng(m)
    wide, high = np.array([WIDTH, HEIGHT]) * PIXEL / TRUE.c * 120.0
    rows = max(2, int(np.sqrt(m / 2)))
    columns = -(-(m // 2) // rows)
    step = np.array([0.4 * wide, 0.2 * high])
    size = step * [rows - 1, columns - 1]
    grid = [(i * step[0], j * step[1], 120.0, np.pi * (i % 2)) for i in range(rows) for j in range(columns)][:m // 2]
    across = m - len(grid)
    lines = max(2, int(np.sqrt(across * size[1] / max(size[0], 1) / 2)))
    each = -(-across // lines)
    grid += [(u * size[0] / max(each - 1, 1), v * size[1] / (lines - 1), 150.0, np.pi / 2 * (-1) ** v)
             for v in range(lines) for u in range(each)][:across]
    plan = np.array(grid)
    centres = plan[:, :3] + rng.normal(0, [1.5, 1.5, 1.0], (m, 3))
    tilts = np.radians(rng.normal(0, 2.5, (m, 2)))
    ms = [rotation(o, p, k + np.radians(rng.normal(0, 4))) for (o, p), k in zip(tilts, plan[:, 3], strict=True)]
    n = m * points_per_image
    xyz = np.column_stack([rng.uniform(-0.3 * wide, size[0] + 0.3 * wide, n), rng.uniform(-0.3 * high, size[1] + 0.3 * high, n),
                           np.zeros(n)])
    xyz[:, 2] = 6 * (np.sin(xyz[:, 0] / 40) * np.cos(xyz[:, 1] / 55) + 1)
    image, point, pixel = _seen(centres, ms, xyz, rng)
    return {
        "poses": np.array([Exterior(exp(np.radians(rng.normal(0, 0.5, 3))) @ r, c + rng.normal(0, 0.5, 3)).vector
                           for r, c in zip(ms, centres, strict=True)]),
        "xyz": xyz[np.unique(point)] + rng.normal(0, 0.5, (len(np.unique(point)), 3)),
        "image": image, "point": np.unique(point, return_inverse=True)[1], "pixel": pixel,
    }


LONG = Interior(300.0, pixel_mm=PIXEL, width=WIDTH, height=HEIGHT)


def long_range(m: int, points_per_image: int = 60) -> dict[str, Any]:
    """The same of m photos of 300 mm along a cliff 100 m away, two metres deep, each third turned 25 degrees to the left, none
    and to the right: narrow fields, for the orthogonal model."""
    rng = np.random.default_rng(m)
    step, n = 2.0, m * points_per_image // 3
    target = step * (np.arange(m) // 3)
    turn = np.radians(25.0) * (np.arange(m) % 3 - 1)
    xyz = np.column_stack([rng.uniform(-3, target[-1] + 3, n), rng.uniform(-2.4, 2.4, n), rng.uniform(-1, 1, n)])
    centres = np.column_stack([target + 100 * np.sin(turn), np.zeros(m), 100 * np.cos(turn)]) + rng.normal(0, 0.3, (m, 3))
    tilts = np.radians(rng.normal(0, [0.05, 0.05, 3.0], (m, 3)))
    ms = [rotation(o, p, k) @ exp(np.array([0.0, -t, 0.0])) for (o, p, k), t in zip(tilts, turn, strict=True)]
    image, point, pixel = [], [], []
    for i, (r, c) in enumerate(zip(ms, centres, strict=True)):
        uvw = (xyz - c) @ r.T
        at = LONG.pixels(-LONG.c * uvw[:, :2] / uvw[:, 2:])
        ok = np.flatnonzero(LONG.inside(at, -20))
        image.append(np.full(len(ok), i))
        point.append(ok)
        pixel.append(at[ok])
    image, point, pixel = (np.concatenate(parts) for parts in (image, point, pixel))
    keep = np.bincount(point, minlength=n)[point] >= 3
    image, point, pixel = image[keep], point[keep], pixel[keep]
    order = np.lexsort((image, point))
    kept = np.unique(point)
    return {
        "poses": np.array([Exterior(exp(np.radians(rng.normal(0, 0.02, 3))) @ r, c + rng.normal(0, 0.02, 3)).vector
                           for r, c in zip(ms, centres, strict=True)]),
        "xyz": xyz[kept] + rng.normal(0, 0.02, (len(kept), 3)), "image": image[order],
        "point": np.searchsorted(kept, point[order]), "pixel": (pixel + rng.normal(0, NOISE, pixel.shape))[order],
    }


def _seen(centres: np.ndarray, ms: list[np.ndarray], xyz: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Image, point and pixel of the observations, sorted by point and image."""
    from scipy.spatial import KDTree

    tree, found = KDTree(xyz[:, :2]), []
    for i, (r, c) in enumerate(zip(ms, centres, strict=True)):
        near = np.array(tree.query_ball_point(c[:2], c[2] * 0.45))
        uvw = (xyz[near] - c) @ r.T
        pixel = TRUE.pixels(-TRUE.c * uvw[:, :2] / uvw[:, 2:] + TRUE.principal_point)
        ok = TRUE.inside(pixel, -20) & (rng.random(len(near)) < 0.6)
        found.append((np.full(int(ok.sum()), i), near[ok], pixel[ok]))
    image, point, pixel = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((rng.random(len(point)), point))
    image, point, pixel = image[order], point[order], pixel[order]
    first = np.searchsorted(point, point)
    keep = np.arange(len(point)) - first < rng.integers(3, 13, len(xyz))[point]
    keep &= np.bincount(point[keep], minlength=len(xyz))[point] >= 3
    image, point, pixel = image[keep], point[keep], pixel[keep]
    order = np.lexsort((image, point))
    return image[order], point[order], (pixel + rng.normal(0, NOISE, pixel.shape))[order]


def kept(path: Path) -> dict[str, Any]:
    """A block that `np.savez` wrote."""
    with np.load(path) as file:
        return dict(file)
