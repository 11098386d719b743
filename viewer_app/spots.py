"""Monoplotting by click, pure: places on a photo become ground coordinates with their error ellipse."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from solvers import PhotogrammetryError
from solvers.geometry import Surface
from solvers.orientation import Monoplotted, Plane, monoplot
from solvers.orientation.oriented import ELLIPSE95

from . import theme
from .ground import nice, site, symbol_size
from .state import MODELS, Assets, Spot, State, Work
from .values import Label, Scene, Segments

CORNERS = 48
"""Of a drawn ellipse."""


def plotted(state: State) -> tuple[tuple[Spot, Monoplotted | str], ...]:
    """Every place with its ground coordinates by the finished solution of its image, or why there are none."""
    return tuple((spot, _plot(state.work, state.assets, spot)) for spot in state.spots)


@lru_cache(maxsize=128)
def _plot(work: Work, assets: Assets, spot: Spot) -> Monoplotted | str:
    found = (work.solutions.get((spot.image, model)) for model in MODELS)
    orientation = next((s.orientation for s in found if s and s.orientation), None)
    if orientation is None:
        return f"{spot.image} has no solution"
    try:
        return monoplot(work.block, orientation, (spot.col, spot.row), ground_of(work, assets))
    except PhotogrammetryError as error:
        return str(error)


def ground_of(work: Work, assets: Assets) -> Surface | Plane:
    """The project's heights; without them a level plane at the mean height of the points, as uncertain as they differ."""
    if assets.surface is not None:
        grid = assets.surface.grid  # a GeoTIFF that states no crs is taken to be in the project's
        return replace(assets.surface, grid=replace(grid, crs=work.block.crs)) if grid.crs == "local" else assets.surface
    heights = work.block.points.xyz[np.isfinite(work.block.points.xyz).all(axis=1), 2]
    given = work.block.surface.get("z")
    if given is not None:
        return Plane(float(given))
    return Plane(float(heights.mean()), float(heights.std())) if len(heights) else Plane(0.0)


def spots(state: State) -> Scene:
    """A cross, the 95 % ellipse and the number of every place that has ground coordinates."""
    found = Scene()
    ink, size = theme.foreground(state.view.dark), 0.7 * symbol_size(state)
    for number, (_, place) in enumerate(plotted(state), 1):
        if isinstance(place, str):
            continue
        at = state.assets.frame.to_local(place.ground)
        factor = ellipse_factor(state, place)
        cross = at + size * np.array([[(-1, 0, 0), (1, 0, 0)], [(0, -1, 0), (0, 1, 0)], [(0, 0, 0), (0, 0, 2)]], float)
        ring = at + factor * ellipse(place.covariance)
        found[f"/spots/{number}/cross"] = Segments(cross, ink, 2.5)
        found[f"/spots/{number}/ellipse"] = Segments(np.stack([ring, np.roll(ring, -1, axis=0)], axis=1), ink, 2.0)
        if state.view.labels:
            a, b = place.ellipse.semi_major_m, place.ellipse.semi_minor_m
            found[f"/spots/{number}/label"] = Label(
                f"{number}: 95 % {a:.2g} × {b:.2g} m, × {factor:g}", at + size * np.array([1.0, 1.0, 2.0]), 0.9, "center-left"
            )
    return found


def ellipse(covariance: np.ndarray) -> np.ndarray:
    """Points (CORNERS, 3) m of the 95 % ellipse of X, Y about its middle, lifted along the ground by what Z goes with them."""
    values, axes = np.linalg.eigh(covariance[:2, :2])
    turn = 2 * np.pi * np.arange(CORNERS) / CORNERS
    level = ELLIPSE95 * np.stack([np.cos(turn), np.sin(turn)], axis=1) * np.sqrt(np.maximum(values, 0)) @ axes.T
    slope = np.linalg.pinv(covariance[:2, :2]) @ covariance[:2, 2]
    return np.column_stack([level, level @ slope])


def ellipse_factor(state: State, place: Monoplotted) -> float:
    """The exaggeration drawn: that of the ground vectors, less while the ellipse would cover a tenth of the site."""
    low, high = site(state)
    room = 0.1 * float((high - low)[:2].max())
    longest = max(place.ellipse.semi_major_m, 1e-9)
    return state.view.vectors if longest * state.view.vectors <= room else max(nice(room / longest), 1.0)
