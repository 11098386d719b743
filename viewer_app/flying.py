"""Where a browser should look: at a point or an image. What is chosen changes for all, the view for who asked."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .acting import Action, handles, update
from .actions import ChooseImage, ChoosePoint
from .bars import rectangle
from .bundle_rows import place
from .ground import site
from .home import PANEL
from .looking import look_through, looked_through
from .mosaic_state import Mosaic
from .scene import any_exterior, frustum_depth
from .state import State

BESIDE = 60
"""How far from the panel over the scene the middle of what is flown to should be, pixels of the page."""


@dataclass(frozen=True)
class Fly(Action):
    """Choose a point or an image and let the browser that asked look at it, or "through" an image, or "back" from there, or at
    all "points" from where the images are, or at the "mosaic" that is shown, or at all there is, from "home".

    client: its number, None for all.
    """

    what: str
    name: str
    client: int | None = None


@handles(Fly)
def _fly(state: State, action: Fly) -> State:
    if action.what == "point":
        return update(state, ChoosePoint(action.name))
    if action.what == "back":
        return look_through(state, "")
    if action.what not in ("image", "through"):
        return state
    state = update(state, ChooseImage(action.name))
    there = action.what == "through" and state.image == action.name and any_exterior(state, action.name) is not None
    return look_through(state, action.name) if there else state


def flight(state: State, action: Fly, position: np.ndarray, look_at: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Position (3,) and point looked at (3,) [m, local] that show it from where one looks now; None where it has no place."""
    if action.what == "point" and action.name in state.block.points.names:
        at = state.assets.frame.to_local(state.block.points.xyz[[state.block.point_index(action.name)]])[0]
        placed = place(state, action.name)
        at = placed if placed is not None and not np.isfinite(at).all() else at
        low, high = site(state)
        far = 0.35 * float(np.linalg.norm(high - low))
    elif action.what == "image" and any(i.name == action.name for i in state.block.images):
        exterior, depth = any_exterior(state, action.name), frustum_depth(state)
        if exterior is None:
            return None
        at, far = exterior.centre - exterior.m[2] * depth, 6.0 * depth
    elif action.what == "points":
        return _before_points(state)
    elif action.what == "mosaic" and (made := state.room(Mosaic).current) is not None:
        ring = rectangle(state, made)
        at, far = ring.mean(axis=0), 1.4 * float(np.linalg.norm(np.ptp(ring, axis=0)))
    else:
        return None
    if not np.isfinite(at).all():
        return None
    way = np.asarray(position, float) - look_at
    length = float(np.linalg.norm(way))
    way = way / length if length > 1e-9 else np.array([0.4, -0.8, 0.45])
    return at + far * way, at


def beside_panel(
    position: np.ndarray, look_at: np.ndarray, width: float, height: float, fov: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and point looked at (3,) moved alike, so that what was looked at stands beside the panel over the scene where
    it would hide the middle of a canvas of width x height px; fov: vertical [rad]."""
    way = np.asarray(look_at, float) - position
    right = np.cross(way, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(right))
    if width / 2 > PANEL + BESIDE or width < PANEL + 4 * BESIDE or length < 1e-9:
        return position, look_at
    moved = -right / length * (PANEL / 2) * float(np.linalg.norm(way)) * np.tan(fov / 2) / (height / 2)
    return position + moved, look_at + moved


def sees_mosaic(state: State, position: np.ndarray, look_at: np.ndarray, fov: float, aspect: float) -> bool:
    """Whether who looks from a position has the middle of the mosaic in view, and large enough; True where there is none."""
    made = state.room(Mosaic).current
    if made is None:
        return True
    ring = rectangle(state, made)
    way = np.asarray(look_at, float) - position
    away = way / max(float(np.linalg.norm(way)), 1e-12)
    right = np.cross(away, [0.0, 0.0, 1.0])
    right /= max(float(np.linalg.norm(right)), 1e-12)
    seen = (np.vstack([ring.mean(axis=0), ring]) - position) @ np.column_stack([right, np.cross(right, away), away])
    high = np.tan(fov / 2)
    at = seen[:, :2] / np.maximum(seen[:, 2:], 1e-9) / [high * aspect, high]  # -1 to 1 over the canvas
    large = float(np.ptp(at[1:], axis=0).max()) > 0.2 or bool((seen[:, 2] <= 0).any())
    return bool(seen[0, 2] > 0 and (np.abs(at[0]) < 0.95).all() and large)


def _before_points(state: State) -> tuple[np.ndarray, np.ndarray] | None:
    """Position and point looked at that show all known points as the images see them; None where no point is known."""
    known = state.block.points.xyz[np.isfinite(state.block.points.xyz).all(axis=1)]
    if not len(known):
        return None
    xyz = state.assets.frame.to_local(known)
    at, far = xyz.mean(axis=0), 1.2 * max(float(np.linalg.norm(np.ptp(xyz, axis=0))), 0.1)
    seen = [e.centre for i in state.block.images if (e := any_exterior(state, i.name)) is not None]
    way = np.mean(seen, axis=0) - at if seen else np.array([0.4, -0.8, 0.45])
    way = way / max(float(np.linalg.norm(way)), 1e-9) + np.array([0.0, -0.15, 0.1])  # never along the vertical
    return at + far * way / np.linalg.norm(way), at


def through(state: State) -> Fly:
    """Through the chosen image, or back where one looks through it already."""
    return Fly("back", "") if looked_through(state) else Fly("through", state.image)


def asked_by(action: Action, client: int | None) -> Action:
    """The action with the number of the browser that asked, where that matters."""
    return replace(action, client=client) if isinstance(action, Fly) else action
