"""Where the scene is first looked at from, pure."""

from __future__ import annotations

import numpy as np

from .ground import site
from .scene import prior
from .state import MODELS, State


def home(state: State) -> tuple[np.ndarray, np.ndarray, float]:
    """Position (3,), point looked at (3,) and far plane [m]: from the south, high enough to see ground and cameras."""
    low, high = site(state)
    centres = [e.centre for i in state.block.images
               if (e := state.exterior(MODELS[0], i.name) or state.assets.truth.get(i.name) or prior(state, i.name)) is not None]
    corners = np.vstack([low, high, *centres])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    way = np.array([0.5, -1.0, 0.5])
    # the panels cover the left lower corner: look a little below and left of the middle
    return middle + 2.8 * radius * way / np.linalg.norm(way), middle + radius * np.array([-0.08, 0.0, -0.12]), 40 * radius
