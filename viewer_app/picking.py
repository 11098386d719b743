"""What a click in the scene means: the point or the image nearest to the ray, pure."""

from __future__ import annotations

import numpy as np

from .actions import Action, SwitchPoint
from .flying import Fly
from .looking import looked_through
from .scene import frustum_depth
from .state import MODELS, State


def pick(state: State, origin: np.ndarray, direction: np.ndarray, tolerance: float) -> Action | None:
    """Switch the point, or look through the image, within an angle (rad) of the ray from `origin` (3,) along `direction` (3,)."""
    axis = np.asarray(direction, float) / np.linalg.norm(direction)
    names = state.block.points.names
    xyz = state.assets.frame.to_local(state.block.points.xyz)
    image, near = (None, np.inf) if looked_through(state) else _image(state, np.asarray(origin, float), axis)
    if len(names):
        off, distance = _off_ray(xyz, np.asarray(origin, float), axis)
        off[~np.isfinite(off)] = np.inf
        best = int(np.argmin(off))
        if off[best] <= tolerance and distance[best] < near:
            return SwitchPoint(names[best])
    return Fly("through", image) if image else None


def _off_ray(xyz: np.ndarray, origin: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (n,) from a ray and distances (n,) along it; behind it the angle is infinite."""
    along = (xyz - origin) @ axis
    across = np.linalg.norm(xyz - origin - along[:, None] * axis, axis=1)
    return np.where(along > 0, np.arctan2(across, along), np.inf), along


def _image(state: State, origin: np.ndarray, axis: np.ndarray) -> tuple[str | None, float]:
    """The image whose picture plane the ray meets first, and how far along it."""
    best, near, depth = None, np.inf, frustum_depth(state)
    for image in state.block.images:
        interior = state.block.camera_of(image.name)
        half = np.array([interior.width, interior.height]) * interior.pitch / 2 / interior.c
        for model in MODELS:
            exterior = state.exterior(model, image.name) if getattr(state.view, model) else None
            if exterior is None:
                continue
            start, way = exterior.camera(origin), exterior.m @ axis
            if abs(way[2]) < 1e-12:
                continue
            t = (-depth - start[2]) / way[2]
            hit = (start + t * way)[:2] / depth
            if 0 < t < near and np.all(np.abs(hit) <= half):
                best, near = image.name, t
    return best, near
