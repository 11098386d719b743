"""Bends: what a photo differs by, smoothly, from a central projection of the plane: a shutter that rolls, ground that rises.

A bend is a polynomial of the second degree over the photo: its six coefficients are pixels that the undistorted column (first
three, of x^2, x y, y^2) and row (last three) are shifted by where x or y, from the format's centre in half widths, is one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..cameras import Interior

REACH = 1.25
"""Half widths beyond which a bend grows no further."""


def bent(bend: np.ndarray, interior: Interior, pixels: np.ndarray) -> np.ndarray:
    """(..., 2) undistorted pixels of the photo for those (..., 2) of the plane's central projection; bend (6,) or (..., 6)."""
    f = terms(interior.width, interior.height, pixels)
    return pixels + np.stack([(f * bend[..., :3]).sum(-1), (f * bend[..., 3:]).sum(-1)], -1)


def straightened(bend: np.ndarray, interior: Interior, pixels: np.ndarray) -> np.ndarray:
    """The inverse of `bent`, to 1e-6 px."""
    out = np.array(pixels, float)
    for _ in range(30):
        step = pixels - bent(bend, interior, out)
        out += step
        if not np.nanmax(np.abs(step), initial=0.0) > 1e-7:
            break
    return out


def terms(width: int, height: int, pixels: np.ndarray) -> np.ndarray:
    """(..., 3) x^2, x y, y^2 of pixels (..., 2)."""
    x = np.clip((pixels[..., 0] - (width - 1) / 2) / (width / 2), -REACH, REACH)
    y = np.clip((pixels[..., 1] - (height - 1) / 2) / (width / 2), -REACH, REACH)
    return np.stack([x * x, x * y, y * y], -1)


def by_bend(interiors: Sequence[Interior], photo: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(k, 2, 6) how ideal photo coordinates over c (k, 2), x right and y up, of photos (k,) move with their bends."""
    size = np.array([[i.width, i.height] for i in interiors], float)[photo]
    scale = np.array([i.c / i.pitch for i in interiors]).reshape(-1, 2)[photo] * [1, -1]
    offset = np.array([i.principal_point / i.pitch for i in interiors]).reshape(-1, 2)[photo] * [1, -1]
    off = (q * scale + offset) / (size[:, :1] / 2)
    x, y = np.clip(off, -REACH, REACH).T
    f = np.stack([x * x, x * y, y * y], -1)
    out = np.zeros((len(q), 2, 6))
    out[:, 0, :3], out[:, 1, 3:] = f / scale[:, :1], f / scale[:, 1:]
    return out
