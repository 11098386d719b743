"""A small project for the Matching tab: three photos of one painted wall, shifted, turned and scaled by known affinities."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solvers import Block, Image, Interior, Observations, Points
from solvers.io import write_project

SIZE = (640, 480)
AFFINITIES = {
    "one": np.array([[1.0, 0, 0], [0, 1, 0]]),
    "two": np.array([[0.995, -0.0872, 60.3], [0.0872, 0.995, -20.6]]),
    "three": np.array([[1.1, 0.05, -40.2], [-0.04, 1.08, 15.4]]),
}
"""Pixel of photo one -> pixel of the photo."""


def conjugate(image: str, pixel: np.ndarray) -> np.ndarray:
    """(2,) where a photo shows what photo one shows at a pixel (2,)."""
    return AFFINITIES[image] @ np.append(pixel, 1.0)


def make_project(folder: Path, seed: int = 4) -> Path:
    """Writes it; returns the folder."""
    import cv2
    from PIL import Image as Picture

    rng = np.random.default_rng(seed)
    wall = np.full((960, 1280), 120.0)
    for s in (1.6, 4.0, 12.0):
        wall += 30 * s * cv2.GaussianBlur(rng.normal(size=wall.shape), (0, 0), s)
    (folder / "images").mkdir(parents=True)
    to_wall = np.array([[1.0, 0, 300], [0, 1, 220], [0, 0, 1]])
    for name, a in AFFINITIES.items():
        back = to_wall @ np.linalg.inv(np.vstack([a, [0, 0, 1]]))
        grey = cv2.warpAffine(wall, back[:2], SIZE, flags=cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP)
        pixels = np.clip(grey + rng.normal(0, 1.0, grey.shape), 0, 255).astype(np.uint8)
        Picture.fromarray(pixels).convert("RGB").save(folder / "images" / f"{name}.png")
    nothing = np.empty((0, 3))
    empty = Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))
    camera = Interior(20.0, pixel_mm=0.02, width=SIZE[0], height=SIZE[1])
    images = tuple(Image(name, "cam", f"images/{name}.png") for name in AFFINITIES)
    write_project(Block("Wall", "local", {"cam": camera}, images, Points((), nothing, nothing, ()), empty), folder)
    return folder
