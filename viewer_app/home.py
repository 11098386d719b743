"""Where the scene is first looked at from, pure."""

from __future__ import annotations

import numpy as np

from solvers import Exterior

from .bars import furniture, rectangle
from .bundle_scene import bars as bundle_bars
from .bundle_state import Bundle
from .ground import drawn_ground, site
from .matching_state import Matching
from .mosaic_scene import bars as mosaic_bars
from .mosaic_state import Mosaic
from .scene import MANY, centres, vector_scale
from .sighting import position, prior
from .state import MODELS, State
from .values import Label, Segments

WAY = np.array([0.5, -1.0, 0.5]) / np.sqrt(1.5)
"""From what is looked at to the eye (3,): from the south, high enough to see ground and cameras."""
PANEL, LOW = 442, 384
"""Width and height of the canvas's lower left corner that the panel over the scene covers, pixels of the page."""
RIM, SKY, WORDS = 24, 64, 70
"""Pixels kept free around what is seen, above it for names and right of it for words."""
WIDE = 700
"""Pixels beside the panel from which on the whole terrain is shown at first, not the site alone."""


LETTER, ROW = 6.5, 15.0
"""Width of a letter and height of a row of words of size 1, pixels."""


def home(state: State) -> tuple[np.ndarray, np.ndarray, float]:
    """Position (3,), point looked at (3,) and far plane [m], where nothing lies over the scene and its shape is not known."""
    corners = np.vstack([_seen(state), _measures(state)[0]])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    return middle + 2.95 * radius * WAY, middle, 40 * radius


def home_beside(state: State, width: float, height: float, fov: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and point looked at (3,) from which all there is stands beside the panel, or above it, whichever shows it
    larger. width, height: of the canvas, pixels of the page; fov: vertical [rad]."""
    half = np.array([width, height]) / 2
    places = [(np.array([left, low]) + RIM - half, half - [WORDS, SKY]) for left, low in ((PANEL, 0), (0, LOW))]
    return _placed(state, width > PANEL + WIDE, (width, height), fov, places)


def home_alone(state: State, width: float, height: float, fov: float, left: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The same in a picture of its own; left: pixels kept free there, for a legend."""
    half = np.array([width, height]) / 2
    return _placed(state, True, (width, height), fov, [(np.array([left, 0.0]) + RIM - half, half - [WORDS, SKY])])


def _placed(state: State, whole: bool, size: tuple[float, float], fov: float, places: list[tuple[np.ndarray, np.ndarray]]
            ) -> tuple[np.ndarray, np.ndarray]:
    """Position and point looked at from which all there is fits into one of the rectangles, that which shows it larger, or onto
    the whole canvas where none of them has room for its words."""
    corners, (bars, beside) = _seen(state, whole), _measures(state)
    corners, beside = np.vstack([corners, bars]), np.concatenate([np.zeros((len(corners), 2)), beside])
    half = np.array(size) / 2
    free = [(a, b) for a, b in places if (b - a > np.maximum(120, 40 + beside.max(axis=0))).all()] or [(0.1 - half, half - 0.1)]
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    right = np.cross(-WAY, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    seen = (corners - middle) @ np.column_stack([right, np.cross(right, -WAY), -WAY])  # right, up, away
    focal = size[1] / 2 / np.tan(fov / 2)
    distance, moved = min((_fitted(seen, focal, a + [0, 1] * beside, b - [1, 0] * beside) for a, b in free), key=lambda f: f[0])
    at = middle + moved[0] * right + moved[1] * np.cross(right, -WAY)
    return at + distance * WAY, at


def _measures(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Ends (n, 3) m of the bars and of the arrow north, and how much (n, 2) px their words need to the right and below."""
    found = {**furniture(state, vector_scale(state)), **bundle_bars(state), **mosaic_bars(state)}
    ends = np.concatenate([v.points.reshape(-1, 3) for v in found.values() if isinstance(v, Segments)])
    words = [v for v in found.values() if isinstance(v, Label)]
    sizes = [(LETTER * v.size * max(map(len, v.text.split("\n"))), 0.5 * ROW * v.size * len(v.text.split("\n"))) for v in words]
    places = np.array([v.position for v in words]).reshape(-1, 3)
    return np.vstack([ends, places]), np.concatenate([np.zeros((len(ends), 2)), np.array(sizes).reshape(-1, 2)])


def _fitted(seen: np.ndarray, focal: float, low: np.ndarray, high: np.ndarray) -> tuple[float, np.ndarray]:
    """Least distance at which places (n, 3) m, as right, up, away, fit between low and high (n, 2) px from the canvas's middle, y
    up; and how far (2,) m right and up the eye is moved for it: one is drawn at focal * (place - moved) / (distance + away)."""
    size = max(float(np.ptp(seen, axis=0).max()), 1e-3)

    def limits(distance: float) -> tuple[np.ndarray, np.ndarray]:
        depth = (distance + seen[:, 2:]) / focal
        return (seen[:, :2] - high * depth).max(axis=0), (seen[:, :2] - low * depth).min(axis=0)

    near, far = size - float(seen[:, 2].min()), 1e4 * size
    for _ in range(60):
        distance = float(np.sqrt(near * far))
        least, most = limits(distance)
        near, far = (near, distance) if (least <= most).all() else (distance, far)
    least, most = limits(far)
    return far, (least + most) / 2


def _seen(state: State, whole: bool = True) -> np.ndarray:
    """Corners and centres (n, 3) m of what the first view shows, local frame; whole: to the edge of the ground that is drawn."""
    low, high = site(state)
    at = [*centres(state)] if len(state.block.images) > MANY else [e.centre for e in _known(state)]
    at += [p for i in state.block.images[:MANY] if i.prior is not None and (p := position(state, i.name)) is not None]
    network = state.room(Matching).network
    at += [] if network is None else [e.centre for e in network.exteriors.values()]
    bundle = state.room(Bundle)
    if bundle.result is not None and bundle.layout is not None:
        at += [*bundle.layout.poses(bundle.rows[-1].x)[0]]
    at += [corner for made in state.room(Mosaic).made.values() for corner in rectangle(state, made)]
    ground = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    if not whole:
        return np.vstack([ground, *at])
    (x0, y0), (x1, y1), _ = drawn_ground(state)
    return np.vstack([ground, *at, [[x, y, low[2]] for x in (x0, x1) for y in (y0, y1)]])


def _known(state: State) -> list[Exterior]:
    names = [i.name for i in state.block.images]
    known = (state.exterior(MODELS[0], name) or state.assets.truth.get(name) or prior(state, name) for name in names)
    return [e for e in known if e is not None]
