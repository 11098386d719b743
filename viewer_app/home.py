"""Where the scene is first looked at from, pure."""

from __future__ import annotations

import numpy as np

from solvers import Exterior

from .ground import site
from .matching_state import Matching
from .scene import MANY, centres
from .sighting import position, prior
from .state import MODELS, State


def home(state: State) -> tuple[np.ndarray, np.ndarray, float]:
    """Position (3,), point looked at (3,) and far plane [m]: from the south, high enough to see ground and cameras."""
    low, high = site(state)
    at = [*centres(state)] if len(state.block.images) > MANY else [e.centre for e in _known(state)]
    at += [p for i in state.block.images[:MANY] if i.prior is not None and (p := position(state, i.name)) is not None]
    network = state.room(Matching).network
    at += [] if network is None else [e.centre for e in network.exteriors.values()]
    corners = np.vstack([low, high, *at])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    way = np.array([0.5, -1.0, 0.5])
    # the panels cover the lower left corner: what is seen moves up and right where one looks at a place left below the middle
    aim = middle + radius * np.array([-0.24, -0.1, -0.1])
    return aim + 2.95 * radius * way / np.linalg.norm(way), aim, 40 * radius


def _known(state: State) -> list[Exterior]:
    names = [i.name for i in state.block.images]
    known = (state.exterior(MODELS[0], name) or state.assets.truth.get(name) or prior(state, name) for name in names)
    return [e for e in known if e is not None]
