"""A small, good project for tests: one photo from 300 m, seven control points with relief, honest noise."""

import numpy as np

from solvers import Block, Exterior, Image, Interior, Observations, Points, Prior
from solvers.cameras import project

CAMERA = Interior(35.0, pixel_mm=0.004, width=6000, height=4000)
GROUND = np.array([[-60.0, -30, 3], [70.0, -25, 12], [55, 38, 0], [-65, 22, 9], [5, -3, 15], [-20, 30, 5], [30, -30, 8]])
AT = Exterior.from_angles(0.03, -0.02, 0.4, np.array([4.0, -6.0, 300.0]))


def good_block(ground: np.ndarray = GROUND, at: Exterior = AT, prior: Prior | None = None) -> Block:
    n = len(ground)
    noise = 0.2 * np.random.default_rng(3).standard_normal((n, 2))
    return Block("site", "local", {"cam": CAMERA}, (Image("a", "cam", None, prior),),
                 Points(tuple(f"P{i + 1}" for i in range(n)), ground, np.full((n, 3), np.nan), ("control",) * n),
                 Observations(np.zeros(n, int), np.arange(n), project(CAMERA, at, ground) + noise, np.full(n, np.nan)))
