"""A cliff watched through a telephoto lens: epochs of one network, a few targets of which move by millimetres."""

from __future__ import annotations

import numpy as np

from ..block import Block, Image, Points
from ..cameras import Interior
from .scene import Simulated, look_at, observe, onboard

CAMERA = Interior(300.0, pixel_mm=0.006, width=6000, height=4000)
"""Full format behind 300 mm: 12 m by 8 m at 100 m."""
MOVED = {"7": (0.0, -1.0, 0.0), "18": (0.6, -0.8, 0.0), "26": (0.0, -0.6, 0.8), "33": (0.0, 0.0, 1.0)}
"""Targets that move, and whereto: unit vectors, Y up, Z towards the cameras."""


def cliff_epochs(seed: int = 0, *, epochs: int = 3, movement: float = 0.003, image_px: float = 0.1, noise: float = 1.0,
                 moved: dict[str, tuple[float, float, float]] | None = None) -> tuple[Simulated, ...]:
    """Epochs of 40 targets on a cliff, 10 m wide, 6 m high and 2 m deep, from seven stations 90 to 110 m away over 70 degrees.

    moved: targets and directions; each has moved by `movement` [m] in the second epoch, by twice as much in the third, and so on.
    The stations are set up anew to a metre, points are known to 5 cm to begin with. Points are tie points.
    """
    rng = np.random.default_rng([seed, 40])
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 8), np.linspace(-3.0, 3.0, 5))
    xyz = np.stack([x, y, 0.25 * y], -1).reshape(-1, 3) + rng.uniform(-1, 1, (40, 3)) * [0.4, 0.4, 0.7]
    xyz = xyz.round(4)
    names = tuple(str(i + 1) for i in range(40))
    step = np.zeros((40, 3))
    for name, direction in (MOVED if moved is None else moved).items():
        step[names.index(name)] = movement * np.asarray(direction)
    given = np.round(xyz + noise * rng.normal(0, 0.05, xyz.shape), 2)
    return tuple(_epoch(k, xyz + k * step, given, names, image_px, noise, np.random.default_rng([seed, 40, k]))
                 for k in range(epochs))


def _epoch(number: int, xyz: np.ndarray, given: np.ndarray, names: tuple[str, ...], image_px: float, noise: float,
           rng: np.random.Generator) -> Simulated:
    turn = np.radians(np.linspace(-35, 35, 7))
    distance = np.array([110, 100, 95, 90, 95, 100, 110.0])
    stations = np.stack([distance * np.sin(turn), -4 + 3 * np.cos(3 * turn), distance * np.cos(turn)], -1)
    stations += noise * rng.normal(0, 1.0, stations.shape)
    aim = noise * rng.normal(0, 0.15, stations.shape)
    truth = {f"{number + 1}{'ABCDEFG'[i]}": look_at(s, aim[i], 90.0 * (i % 2)) for i, s in enumerate(stations)}
    block = Block(
        name=f"Cliff, epoch {number + 1}", crs="local", cameras={"tele": CAMERA},
        images=tuple(Image(n, "tele", None, onboard(e, 1.0, 0.5, noise, rng)) for n, e in truth.items()),
        points=Points(names, given, np.full(xyz.shape, np.nan), ("tie",) * len(xyz)),
        observations=observe([CAMERA] * len(truth), list(truth.values()), xyz, image_px, noise, rng), image_px=image_px)
    return Simulated(block, truth, xyz, {"tele": CAMERA})
