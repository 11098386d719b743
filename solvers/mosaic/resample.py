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


def warp_onto(acc: np.ndarray, photo: Placed, lattice: Lattice, window: Window, method: Resample = "bilinear",
              weight: np.ndarray | None = None, bright: np.ndarray | None = None, good: np.ndarray | None = None,
              best: bool = False, first: int = 0) -> None:
    """Joins a photo to rows of a tile from `first` on: acc (rows, w, 4) float32 gains (weight * bright * value, weight), or
    with `best` becomes it where the weight is more. weight, bright: at the lattice nodes (None: 1); good: cells (None: all)."""
    ones = np.ones_like(lattice.u)
    good = lattice.good if good is None else good
    here = np.zeros_like(good)
    rows = slice(first // lattice.step, (first + len(acc) - 1) // lattice.step + 1)
    here[rows] = good[rows]
    box = _window(photo, lattice, here)
    if box is None:
        return
    top, left, bottom, right = box
    pixels = window(photo.name, top, left, bottom, right)
    pixels = np.ascontiguousarray(pixels, None if pixels.dtype == np.uint8 else np.float32)
    w, b = (ones if x is None else np.ascontiguousarray(x, float) for x in (weight, bright))
    compiled().warp(pixels, top, left, (photo.interior.height, photo.interior.width), lattice.u, lattice.v, w, b, here,
                    lattice.step, KINDS.index(method), best, first, acc)


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
