"""Resampling: values between the pixels of a photo, exact for a ramp; nearest, bilinear, bicubic (Keys 1981, a = -1/2)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from ..compiled import kernels
from .lattice import Lattice
from .placed import Placed

Resample = Literal["nearest", "bilinear", "bicubic"]
KINDS: tuple[Resample, ...] = ("nearest", "bilinear", "bicubic")
Window = Callable[[str, int, int, int, int], np.ndarray]
"""(name, top, left, bottom, right) -> pixels (h, w, 3) of a photo."""


def compiled() -> Any:
    """The kernels, compiled at first use."""
    return kernels("solvers.mosaic._kernels", "the resampling")


def sample(image: np.ndarray, pixels: np.ndarray, method: Resample = "bilinear") -> np.ndarray:
    """Values (n, bands) float32 of an image (h, w[, bands]) at pixels (n, 2) (col, row); NaN beyond its pixel edges."""
    p = np.asarray(pixels, float).reshape(-1, 2)
    bands = np.ascontiguousarray(image if image.ndim == 3 else image[..., None])
    out = np.full((len(p), bands.shape[2]), np.nan, np.float32)
    compiled().values(bands, bands.shape[:2], np.ascontiguousarray(p[:, 0]), np.ascontiguousarray(p[:, 1]), KINDS.index(method),
                      out)
    return out


def warp_onto(photo: Placed, lattice: Lattice, weight: np.ndarray, bright: np.ndarray, good: np.ndarray, window: Window,
              method: Resample, best: bool, acc: np.ndarray, total: np.ndarray) -> None:
    """Joins a photo to a tile: acc (h, w, 3) and total (h, w), float32; see the kernel `warp`."""
    box = _window(photo, lattice, good)
    if box is None:
        return
    top, left, bottom, right = box
    pixels = window(photo.name, top, left, bottom, right)
    compiled().warp(pixels, top, left, (photo.interior.height, photo.interior.width), lattice.u, lattice.v,
                    np.ascontiguousarray(weight, float), np.ascontiguousarray(bright, float), good, lattice.step,
                    KINDS.index(method), int(best), acc, total)


def _window(photo: Placed, lattice: Lattice, good: np.ndarray) -> tuple[int, int, int, int] | None:
    """The part of a photo that good cells need: top, left, bottom, right."""
    node = np.zeros(lattice.u.shape, bool)
    node[:-1, :-1] |= good
    node[1:, :-1] |= good
    node[:-1, 1:] |= good
    node[1:, 1:] |= good
    if not node.any():
        return None
    u, v, wide, high = lattice.u[node], lattice.v[node], photo.interior.width, photo.interior.height
    left, right = max(int(np.floor(u.min())) - 2, 0), min(int(np.ceil(u.max())) + 4, wide)
    top, bottom = max(int(np.floor(v.min())) - 2, 0), min(int(np.ceil(v.max())) + 4, high)
    return (top, left, bottom, right) if right > left and bottom > top else None
