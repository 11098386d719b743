"""The ground of the scene, pure: terrain or plane, grid, and the ground control points."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solvers import Block
from solvers.block import Points

from . import theme
from .bundle_rows import inner_extent, inner_places
from .bundle_state import Bundle
from .kept import by_identity
from .matching_state import Matching
from .mosaic_state import Mosaic, in_frame
from .state import Assets, State, Terrain, by_role
from .values import Label, Mesh, Plane, PointCloud, Scene, Segments


def nice(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above value (> 0)."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(f * power for f in (1, 2, 5) if f * power <= value * (1 + 1e-9)))


def site(state: State) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) low and high of the known points, with a little room around, in the local frame."""
    extent = _extent(state.assets, state.block.points)
    room = state.room(Bundle)
    if extent is None and room.rows and room.layout is not None:
        extent = inner_extent(room.layout, room.rows[-1 if room.result else 0])
    if extent is None:
        xyz = _instead(state)
        extent = (xyz.min(axis=0), xyz.max(axis=0)) if len(xyz) else (np.full(3, -10.0), np.full(3, 10.0))
        if not len(xyz):
            return extent
    low, high = extent
    room = np.array([1.0, 1.0, 0.0]) * max(float((high - low)[:2].max()) * 0.06, 1e-3)
    return low - room, high + room


def _instead(state: State) -> np.ndarray:
    """Places (n, 3) m where no point is known: tie points as a bundle placed them, else the photos' outlines on a mosaic, else
    where the photos were taken from."""
    room = state.room(Bundle)
    if room.rows and room.layout is not None:
        return inner_places(room.layout, room.rows[-1 if room.result else 0])
    mosaics = state.room(Mosaic).made
    if made := mosaics.get("simultaneous") or mosaics.get("sequential"):
        if made.registration.unit == "m":
            ring = np.concatenate([made.registration.footprint(k) for k in range(len(made.registration.names))])
            ring = ring[np.isfinite(ring).all(axis=1)]
            xyz = np.column_stack([ring, made.registration.heights(ring)])
            return in_frame(state.assets.frame, made.registration, xyz)
    network = state.room(Matching).network
    if network is not None and len(network.xyz):
        low, high = np.percentile(network.xyz, [1, 99], axis=0)
        return network.xyz[((network.xyz >= low) & (network.xyz <= high)).all(axis=1)]
    priors = [i.prior.centre for i in state.block.images if i.prior is not None and i.prior.centre is not None]
    return state.assets.frame.to_local(np.array(priors, float).reshape(-1, 3)) if priors else np.empty((0, 3))


def ground(state: State) -> Scene:
    """Terrain or a plane at the mean height of the points, and a grid in metres."""
    low, high, span = _drawn(state)
    cell, level = nice(span / 8), ground_level(state)
    found: Scene = {}
    terrain = state.assets.terrain
    x0, x1, y0, y1 = _lines(low, high, cell)
    if state.view.terrain:
        if terrain is not None:
            found["/ground/terrain"] = Mesh(terrain.vertices, terrain.faces, terrain.colours, lowered(state))
        else:
            corners = np.array([[x0, y0, level], [x1, y0, level], [x1, y1, level], [x0, y1, level]])
            found["/ground/plane"] = Plane(corners, theme.INITIAL, 0.12)
    fine = (70, 74, 80) if state.view.dark else (208, 212, 216)
    return found | {"/ground/grid": Segments(_grid(x0, x1, y0, y1, cell, level), fine, 1.0)}


def ground_level(state: State) -> float:
    """Height (m) of the grid."""
    terrain = state.assets.terrain
    if terrain is not None:
        return float(_box(terrain)[0][2]) - 0.02 * _drawn(state)[2]
    heights = known_points(state.assets, state.block.points)[:, 2]
    heights = heights if len(heights) else _instead(state)[:, 2]
    given = state.assets.level
    level = given if given is not None else float(heights.mean()) if len(heights) else 0.0
    return level - lowered(state)


def drawn_ground(state: State) -> tuple[np.ndarray, np.ndarray, float]:
    """Corners (2,) low and high of the grid and its cell, m."""
    low, high, span = _drawn(state)
    cell = nice(span / 8)
    x0, x1, y0, y1 = _lines(low, high, cell)
    return np.array([x0, y0]), np.array([x1, y1]), cell


def _drawn(state: State) -> tuple[np.ndarray, np.ndarray, float]:
    """Corners (3,) low and high of the site and its terrain, and the site's greater extent [m]."""
    low, high = site(state)
    span = float((high - low)[:2].max())
    if state.assets.terrain is not None:
        bottom, top = _box(state.assets.terrain)
        low, high = np.minimum(low, bottom), np.maximum(high, top)
    return low, high, span


@by_identity(2)
def _box(terrain: Terrain) -> tuple[np.ndarray, np.ndarray]:
    return terrain.vertices.min(axis=0), terrain.vertices.max(axis=0)


def _lines(low: np.ndarray, high: np.ndarray, cell: float) -> tuple[float, float, float, float]:
    """First and last line of the grid in x and in y."""
    (x0, y0), (x1, y1) = np.floor(low[:2] / cell) * cell, np.ceil(high[:2] / cell) * cell
    return float(x0), float(x1), float(y0), float(y1)


def _grid(x0: float, x1: float, y0: float, y1: float, cell: float, z: float) -> np.ndarray:
    along_y = [[(x, y0, z), (x, y1, z)] for x in np.arange(x0, x1 + cell / 2, cell)]
    along_x = [[(x0, y, z), (x1, y, z)] for y in np.arange(y0, y1 + cell / 2, cell)]
    return np.array(along_y + along_x)


def lowered(state: State) -> float:
    """How much lower (m) the ground is drawn, so that symbols and residuals on its slopes stay visible."""
    return 0.5 * symbol_size(state)


def symbol_size(state: State) -> float:
    """Radius (m) of a point's symbol: a little of the site, less where points stand close together."""
    xyz = known_points(state.assets, state.block.points)
    low, high = site(state)
    size = 0.016 * float((high - low)[:2].max())
    if 2 <= len(xyz) <= 400:
        size = min(size, max(0.35 * _spacing(xyz.tobytes()), 0.2 * size))
    return size


@lru_cache(maxsize=8)
def _spacing(xyz: bytes) -> float:
    """Median distance (m) to the nearest neighbour of points (n, 3), given as bytes so that they are kept."""
    p = np.frombuffer(xyz).reshape(-1, 3)
    apart = np.linalg.norm(p[:, None] - p[None], axis=-1) + np.diag(np.full(len(p), np.inf))
    return float(np.median(apart.min(axis=1)))


NAMES = 400
"""Names of points that a scene has at most; the page draws those of them that leave each other room."""
SMALL, SEEN, CHOSEN = 0.8, 0.88, 1.0
"""Sizes of names: of any point, of one that the chosen image has measured, of the chosen one. The larger keeps its place."""


@by_identity(2)
def _local(assets: Assets, points: Points) -> np.ndarray:
    """Every point in the local frame (n, 3)."""
    return assets.frame.to_local(points.xyz)


@by_identity(2)
def known_points(assets: Assets, points: Points) -> np.ndarray:
    """Those that have coordinates, in the local frame (n, 3)."""
    xyz = _local(assets, points)
    return xyz[np.isfinite(xyz).all(axis=1)]


@by_identity(2)
def _extent(assets: Assets, points: Points) -> tuple[np.ndarray, np.ndarray] | None:
    xyz = known_points(assets, points)
    return (xyz.min(axis=0), xyz.max(axis=0)) if len(xyz) else None


@by_identity(2)
def _tie_points(assets: Assets, points: Points) -> PointCloud:
    low, high = _extent(assets, points) or (np.zeros(3), np.ones(3))
    size = 0.016 * float((high - low)[:2].max())
    xyz = _local(assets, points)[by_role(points)["tie"]]
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    return PointCloud(xyz, np.broadcast_to(np.array(theme.INITIAL, np.uint8), (len(xyz), 3)), 0.25 * size)


def points(state: State) -> Scene:
    """Ground control: a cross in a circle (control) or a triangle (check); grey when off; the chosen one ringed."""
    block, found = state.block, Scene()
    xyz = _local(state.assets, block.points)
    known: np.ndarray = np.asarray(np.isfinite(xyz).all(axis=1))
    kinds = by_role(block.points)
    off = [j for j in (*kinds["control"], *kinds["check"]) if block.points.names[j] in state.work.off]
    size = symbol_size(state)
    for name, rows, colour, corners in (
        ("control", np.setdiff1d(kinds["control"], off), theme.CONTROL, 24),
        ("check", np.setdiff1d(kinds["check"], off), theme.CHECK, 3),
        ("off", np.array(off, int), theme.INITIAL, 24),
    ):
        at = xyz[rows[known[rows]]]
        if len(at):
            found[f"/points/{name}"] = Segments(_symbols(at, size, corners), colour, 3.0)
    ties = kinds["tie"]
    if len(ties) and known[ties].any():
        found["/points/tie"] = _tie_points(state.assets, block.points)
    if state.point in block.points.names:
        at = xyz[[block.point_index(state.point or "")]]
        if np.isfinite(at).all():
            found["/points/chosen"] = Segments(_symbols(at, 1.7 * size, 32)[3:], theme.foreground(state.view.dark), 3.0)
    if state.view.labels:
        found |= _names(state.assets, block, state.image, state.point, size)
    return found


@by_identity(4)
def _names(assets: Assets, block: Block, image: str, chosen: str | None, size: float) -> Scene:
    """The names, beside symbols of a radius [m]."""
    xyz, names = _local(assets, block.points), block.points.names
    drawn = _named(assets, block, image, chosen)
    return {f"/points/names/{names[j].replace('/', '_')}": Label(names[j], xyz[j] + [size, size, 0], k) for j, k in drawn.items()}


def _named(assets: Assets, block: Block, image: str, chosen: str | None) -> dict[int, float]:
    """The control and check points that have their names drawn, and how large: of many the chosen one, those that the chosen
    image has measured, and others, the farthest apart first."""
    ranked = _spread(assets, block.points)
    known = any(i.name == image for i in block.images)
    rows = block.seen_in(image, ("control", "check")) if known else np.zeros(0, int)
    seen = np.isin(ranked, block.observations.point[rows])
    first = [j for j in ranked if block.points.names[j] == chosen]
    order = [*first, *ranked[seen], *ranked[~seen]]
    size = dict.fromkeys(map(int, ranked[seen]), SEEN) | dict.fromkeys(map(int, first), CHOSEN)
    return {j: size.get(j, SMALL) for j in list(dict.fromkeys(map(int, order)))[:NAMES]}


@by_identity(2)
def _spread(assets: Assets, points: Points) -> np.ndarray:
    """Control and check points (n,) by number such that the first of them always lie far apart: those that are the first in a
    square of a coarse net, then of nets ever finer."""
    xyz, kinds = _local(assets, points), by_role(points)
    rows = np.concatenate([kinds["control"], kinds["check"]])
    rows = rows[np.isfinite(xyz[rows]).all(axis=1)]
    low, high = _extent(assets, points) or (np.zeros(3), np.ones(3))
    at = (xyz[rows, :2] - low[:2]) / max(float((high - low)[:2].max()), 1e-9)
    rank = np.full(len(rows), 99)
    for level in range(1, 10):
        square = np.floor(at * 2**level).astype(int)
        first = np.unique(square[:, 0] * 1025 + square[:, 1], return_index=True)[1]
        rank[first] = np.minimum(rank[first], level)
    return rows[np.argsort(rank, kind="stable")]


def _symbols(at: np.ndarray, size: float, corners: int) -> np.ndarray:
    """Segments of horizontal outlines of so many corners, and of crosses with a stem, around points (n, 3)."""
    turn = np.pi / 2 + 2 * np.pi * np.arange(corners) / corners
    ring = size * np.stack([np.cos(turn), np.sin(turn), np.zeros(corners)], axis=1)
    outline = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    cross = np.array([np.outer((-0.7, 0.7), axis) for axis in np.eye(3)]) * size
    shape = np.concatenate([cross, outline])
    return (at[:, None, None, :] + shape[None]).reshape(-1, 2, 3)
