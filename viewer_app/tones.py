"""What a colour must be sent as to be seen as it is: viser draws lines through a film curve (ACES), which shifts every colour.

Reference: three.js r17x, tonemapping_pars_fragment.glsl.js, ACESFilmicToneMapping; S. Hill 2015.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .theme import Colour

INTO = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
OUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
EXPOSURE = 1 / 0.6


def seen(colour: np.ndarray) -> np.ndarray:
    """sRGB (..., 3), 0..255, of colours (..., 3) after the film curve."""
    v = _linear(colour) * EXPOSURE @ INTO.T
    v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.4329510) + 0.238081)
    return _srgb(np.clip(v @ OUT.T, 0.0, 1.0))


@lru_cache(maxsize=256)
def sent(colour: Colour) -> Colour:
    """The colour whose picture comes closest to `colour`; the curve has no pure white: the brightest come out darker."""
    best = np.array(colour)
    for step in (32, 16, 8, 4, 2, 1, 1):
        axis = np.arange(-2, 3) * step
        grid = np.clip(best + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3), 0, 255)
        best = grid[np.argmin(((seen(grid) - colour) ** 2).sum(axis=-1))]
    r, g, b = (int(c) for c in best)
    return r, g, b


def _linear(colour: np.ndarray) -> np.ndarray:
    c = np.asarray(colour, float) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _srgb(linear: np.ndarray) -> np.ndarray:
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-12) ** (1 / 2.4) - 0.055)
