"""The ground of the scene, pure: terrain or plane, grid, north arrow, scale bar, and the ground control points."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from solvers.block import Points

from . import theme
from .bundle_rows import inner_extent, inner_places
from .bundle_state import Bundle
from .kept import by_identity
from .matching_state import Matching
from .mosaic_state import Mosaic, in_frame
from .state import MODELS, Assets, State, Terrain
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


def ground(state: State, vectors: float | None) -> Scene:
    """Terrain or a plane at the mean height of the points, a grid in metres, north and a scale bar. vectors: exaggeration of
    the residuals drawn, None where only the ground is."""
    low, high, span = _drawn(state)
    cell = nice(span / 8)
    found: Scene = {}
    terrain = state.assets.terrain
    if terrain is not None:
        level = float(terrain.vertices[:, 2].min()) - 0.02 * span
    else:
        heights = known_points(state.assets, state.block.points)[:, 2]
        heights = heights if len(heights) else _instead(state)[:, 2]
        given = state.assets.level
        level = given if given is not None else float(heights.mean()) if len(heights) else 0.0
        level -= lowered(state)
    x0, x1, y0, y1 = _lines(low, high, cell)
    if state.view.terrain:
        if terrain is not None:
            found["/ground/terrain"] = Mesh(terrain.vertices, terrain.faces, terrain.colours, lowered(state))
        else:
            corners = np.array([[x0, y0, level], [x1, y0, level], [x1, y1, level], [x0, y1, level]])
            found["/ground/plane"] = Plane(corners, theme.INITIAL, 0.12)
    fine = (70, 74, 80) if state.view.dark else (208, 212, 216)
    found["/ground/grid"] = Segments(_grid(x0, x1, y0, y1, cell, level), fine, 1.0)
    return found | _north(state, x0, x1, y0, y1, level, cell, vectors)


def drawn_ground(state: State) -> np.ndarray:
    """Corners (4, 3) m of what is drawn of the ground, north arrow and scale bar included."""
    low, high, span = _drawn(state)
    cell = nice(span / 8)
    x0, x1, y0, y1 = _lines(low, high, cell)
    return np.array([[x, y, low[2]] for x in (x0, x1 + cell) for y in (y0 - 0.7 * cell, y1)])


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


def _north(state: State, x0: float, x1: float, y0: float, y1: float, z: float, cell: float, vectors: float | None) -> Scene:
    ink = theme.foreground(state.view.dark)
    x, tip, head = x1 + 0.6 * cell, y1, 0.25 * cell
    foot = tip - 1.6 * cell
    arrow = np.array(
        [
            [(x, foot, z), (x, tip, z)],
            [(x, tip, z), (x - head, tip - 1.6 * head, z)],
            [(x, tip, z), (x + head, tip - 1.6 * head, z)],
            [(x - head, foot, z), (x + head, foot, z)],
        ]
    )
    y, tick = y0 - 0.5 * cell, 0.15 * cell
    bar = np.array([[(x0, y, z), (x0 + cell, y, z)], *([[(x0 + d, y - tick, z), (x0 + d, y + tick, z)] for d in (0, cell)])])
    found: Scene = {"/ground/north": Segments(arrow, ink, 2.5), "/ground/scale": Segments(bar, ink, 2.5)}
    if state.view.labels:
        found["/ground/north_label"] = Label("N", np.array([x, tip + 0.35 * cell, z]), 1.3)
        found["/ground/scale_label"] = Label(scales(state, cell, vectors), np.array([x0 + 1.15 * cell, y, z]))
    return found


def scales(state: State, cell: float, vectors: float | None) -> str:
    """The scale bar in words, with every exaggeration that is drawn."""
    view = state.view
    words = [f"{cell:g} m"]
    if vectors is None:
        return words[0]
    if view.residuals and any((s := state.solution(m)) and s.rows for m in MODELS):
        words.append(f"residuals × {vectors:g}")
    if view.ellipsoids and view.ellipsoid > 0:
        words.append(f"95 % ellipsoids × {view.ellipsoid:g}")
    return ", ".join(words)


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


NAMES, APART = 300, 0.1
"""Names of points drawn at most; of the site's width: how far apart those of many points are."""
CROWD = 24
"""Points up to which every one is named, however close together."""


@by_identity(4)
def _by_role(points: Points) -> dict[str, np.ndarray]:
    role = np.array(points.role)
    return {kind: np.flatnonzero(role == kind) for kind in ("control", "check", "tie")}


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
    xyz = _local(assets, points)[_by_role(points)["tie"]]
    xyz = xyz[np.isfinite(xyz).all(axis=1)]
    return PointCloud(xyz, np.broadcast_to(np.array(theme.INITIAL, np.uint8), (len(xyz), 3)), 0.25 * size)


def points(state: State) -> Scene:
    """Ground control: a cross in a circle (control) or a triangle (check); grey when off; the chosen one ringed."""
    block, found = state.block, Scene()
    xyz = _local(state.assets, block.points)
    known: np.ndarray = np.asarray(np.isfinite(xyz).all(axis=1))
    kinds = _by_role(block.points)
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
        for j in _named(state.assets, block.points, state.point):
            name = block.points.names[j]
            found[f"/points/names/{name.replace('/', '_')}"] = Label(name, xyz[j] + [size, size, 0], 0.7)
    return found


@by_identity(4)
def _named(assets: Assets, points: Points, chosen: str | None) -> list[int]:
    """The control and check points whose names are drawn: the chosen one, and of many only such as leave each other room."""
    xyz, kinds = _local(assets, points), _by_role(points)
    rows = [int(j) for j in (*kinds["control"], *kinds["check"]) if np.isfinite(xyz[j]).all()]
    if len(rows) <= CROWD:
        return rows
    low, high = _extent(assets, points) or (np.zeros(3), np.ones(3))
    room = APART * float((high - low)[:2].max())
    found: list[int] = []
    for j in sorted(rows, key=lambda j: points.names[j] != chosen):
        if len(found) < NAMES and (not found or np.linalg.norm(xyz[found, :2] - xyz[j, :2], axis=1).min() > room):
            found.append(j)
    return found


def _symbols(at: np.ndarray, size: float, corners: int) -> np.ndarray:
    """Segments of horizontal outlines of so many corners, and of crosses with a stem, around points (n, 3)."""
    turn = np.pi / 2 + 2 * np.pi * np.arange(corners) / corners
    ring = size * np.stack([np.cos(turn), np.sin(turn), np.zeros(corners)], axis=1)
    outline = np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
    cross = np.array([np.outer((-0.7, 0.7), axis) for axis in np.eye(3)]) * size
    shape = np.concatenate([cross, outline])
    return (at[:, None, None, :] + shape[None]).reshape(-1, 2, 3)
