"""The shape of the simulated country: a hill, a river valley, gentle ups and downs, and the courses of river, road and track.

Positions here are local: metres east and north of the middle of the scene.
"""

from __future__ import annotations

import numpy as np

from .terrain import Terrain

LEVEL = 495.0  # m, mean height of the ground under the seed's image
HALF = 240.0  # m, half the side of the square scene
RIVER_HALF_WIDTH = 5.0  # m


def value_noise(x: np.ndarray, y: np.ndarray, wavelength: float, rng: np.random.Generator) -> np.ndarray:
    """Smooth random values in about -1..1 at x, y [m]: random nodes every `wavelength` [m], joined by smoothstep."""
    u, v = (x + 2 * HALF) / wavelength, (y + 2 * HALF) / wavelength
    n = int(np.ceil(4 * HALF / wavelength)) + 2
    nodes = rng.uniform(-1, 1, (n, n)).astype(np.float32)
    i, j = np.clip(v.astype(np.int32), 0, n - 2), np.clip(u.astype(np.int32), 0, n - 2)
    a, b = v - i, u - j
    a, b = a * a * (3 - 2 * a), b * b * (3 - 2 * b)
    south = nodes[i, j] * (1 - b) + nodes[i, j + 1] * b
    return south * (1 - a) + (nodes[i + 1, j] * (1 - b) + nodes[i + 1, j + 1] * b) * a


def river(x: np.ndarray) -> np.ndarray:
    """Northing [m] of the river's middle at easting x [m]."""
    return 31.0 + 7.0 * np.sin(x / 37.0) + 0.04 * x


def road(y: np.ndarray) -> np.ndarray:
    """Easting [m] of the road's middle at northing y [m]."""
    return -12.0 + 0.16 * y + 12.0 * np.sin(y / 75.0)


def track(x: np.ndarray) -> np.ndarray:
    """Northing [m] of the farm track's middle at easting x [m]."""
    return -44.0 - 0.12 * x + 6.0 * np.sin(x / 45.0)


def hills(seed: np.random.SeedSequence, origin: np.ndarray, cell: float = 4.0) -> Terrain:
    """The terrain of the scene around map position `origin` (2,) m: about 40 m between river and hilltop."""
    rng = np.random.default_rng(seed)
    nodes = np.arange(-HALF, HALF + cell / 2, cell)
    x, y = np.meshgrid(nodes, nodes[::-1])
    to_river = np.abs(y - river(x))
    heights = LEVEL + 26 * np.exp(-((x + 85) ** 2 + (y + 75) ** 2) / 75**2)
    heights += 17 * np.exp(-((x - 80) ** 2 + (y - 105) ** 2) / 65**2)
    heights += 5.5 * value_noise(x, y, 70.0, rng) + 2.6 * value_noise(x, y, 32.0, rng) + 1.3 * value_noise(x, y, 17.0, rng)
    valley = np.exp(-((to_river / 30.0) ** 2))
    bed = LEVEL - 8.0 + 0.004 * x  # the water falls gently to the west
    heights = heights * (1 - valley) + bed * valley
    return Terrain(heights.round(3).astype(np.float32).astype(float), float(origin[0] - HALF), float(origin[1] + HALF), cell)
