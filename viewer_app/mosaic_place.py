"""Where in the scene a mosaic lies: its own frame against the project's, and without a scale as large as the site."""

from __future__ import annotations

import numpy as np

from .ground import site
from .mosaic_state import Made, in_frame
from .state import State


def to_scene(state: State, made: Made, xyz: np.ndarray) -> np.ndarray:
    """(..., 3) scene coordinates of places (..., 3) of a mosaic, in the local frame of its registration."""
    if made.registration.unit == "px":
        return _plain(state, made, np.asarray(xyz, float))
    return in_frame(state.assets.frame, made.registration, xyz)


def scale_of(state: State, made: Made) -> float:
    """Scene metres per unit of the mosaic: 1, or for a mosaic without scale what makes it as large as the site."""
    return 1.0 if made.registration.unit == "m" else _fit(state, made)[0]


def _fit(state: State, made: Made) -> tuple[float, np.ndarray, np.ndarray]:
    corners = np.concatenate([made.registration.footprint(k) for k in range(len(made.registration.names))])
    corners = corners[np.isfinite(corners).all(axis=1)]
    low, high = corners.min(axis=0), corners.max(axis=0)
    begin, end = site(state)
    scale = float((end - begin)[:2].max() / max((high - low).max(), 1e-9))
    return scale, (low + high) / 2, np.append((begin + end)[:2] / 2, begin[2])


def _plain(state: State, made: Made, xyz: np.ndarray) -> np.ndarray:
    scale, middle, at = _fit(state, made)
    out = np.empty(xyz.shape)
    out[..., :2] = scale * (xyz[..., :2] - middle) + at[:2]
    out[..., 2] = at[2]
    return out
