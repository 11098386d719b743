"""The bundle to be seen, in few nodes: images, object points by residual or rays, corrections and errors, ellipsoids; pure."""

from __future__ import annotations

import numpy as np

from solvers import Block, Exterior
from solvers.adjustment import Iteration

from . import theme
from .acting import Action
from .actions import ChooseImage, ChoosePoint
from .bars import bar, corner, fitting, said
from .bundle_rows import Misfit, given_places, image_number, misfit, point_rms, ray_counts
from .bundle_state import COLOURED, FACTORS, Bundle
from .bundle_values import Judged, Layout
from .ground import nice, site, symbol_size
from .kept import by_identity
from .matching_scene import RAYS, SCALE, UNKNOWN
from .mosaic_scene import bars_drawn
from .scene import CHI_95, MANY, image_name, pale
from .state import State
from .theme import Colour
from .values import Ellipsoids, Frusta, Frustum, PointCloud, Scene, Segments, frusta_corners

DRAWN = 200_000
"""Object points drawn at most, evenly chosen."""
MOST = 300
"""Ellipsoids of points of one kind drawn at most, the largest."""


def alone(state: State) -> bool:
    """Whether the bundle is drawn in place of the images oriented one by one."""
    return state.room(Bundle).leads


def ink(state: State) -> Colour:
    """The bundle's colour: its model's, beside the images oriented one by one that of the text."""
    return theme.MODELS[state.room(Bundle).asked[0]] if alone(state) else theme.foreground(state.view.dark)


def scene(state: State) -> Scene:
    """The bundle at the row shown."""
    room, found = state.room(Bundle), Scene()
    row = room.at(state.row)
    if row is None or room.layout is None or room.block is None:
        return found
    found |= _images(state, room, room.layout, row) | _held(state, room)
    if room.draw_points:
        found |= _points(state, room, room.layout, room.block, row)
    if room.draw_vectors and state.view.residuals:
        found |= _vectors(state, room.layout, room.block, row)
    if room.draw_ellipsoids and state.view.ellipsoids and judged(state) is not None:
        found |= _ellipsoids(state, room.layout, row)
    return found | bars(state)


def judged(state: State) -> Judged | None:
    """What the bundle is worth, at its last row; None at the others, where it does not hold."""
    room = state.room(Bundle)
    return room.result if state.row >= len(room.rows) - 1 else None


def click(state: State, origin: np.ndarray, direction: np.ndarray, tolerance: float) -> Action | None:
    """Choose the image whose picture plane a ray meets first, or the tie point nearest to it within an angle [rad]; control and
    check points are left to the core."""
    room = state.room(Bundle)
    row = room.at(state.row)
    if not alone(state) or row is None or room.layout is None or room.result is None:
        return None
    axis = np.asarray(direction, float) / np.linalg.norm(direction)
    image, near = _met(room.layout, row, _depth(room.layout, room.rows[0]), np.asarray(origin, float), axis)
    ties = np.flatnonzero(_roles(room.result) == "tie")
    if room.draw_points and len(ties):
        away = room.layout.places(row.x)[ties] - origin
        along = away @ axis
        across = np.linalg.norm(away - along[:, None] * axis, axis=1)
        angle = np.where(along > 0, np.arctan2(across, along), np.inf)
        best = int(np.argmin(angle))
        if angle[best] <= tolerance and along[best] < near:
            return ChoosePoint(room.layout.points[ties[best]])
    return None if image is None else ChooseImage(room.layout.images[image])


def _met(layout: Layout, row: Iteration, depth: float, origin: np.ndarray, axis: np.ndarray) -> tuple[int | None, float]:
    """The image whose picture plane a ray meets first, and how far along it."""
    centres, matrices = layout.poses(row.x)
    start, way = np.einsum("mij,mj->mi", matrices, origin - centres), matrices @ axis
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (-depth - start[:, 2]) / way[:, 2]
        hit = (start + t[:, None] * way)[:, :2] / depth
    t = np.where((t > 0) & (np.abs(hit) <= _half(layout)).all(axis=1), t, np.inf)
    best = int(np.argmin(t))
    return (best, float(t[best])) if np.isfinite(t[best]) else (None, np.inf)


# -- images -------------------------------------------------------------------------------------------------------------------


def _held(state: State, room: Bundle) -> Scene:
    """The images of the bundle set aside, pale."""
    held = room.held
    if held is None:
        return Scene()
    centres, matrices = held.layout.poses(held.row.x)
    colour = pale(theme.RESIDUAL, state.view.dark)
    value = Frusta(centres, matrices, _half(held.layout), _depth(held.layout, held.row), colour)
    return Scene({"/bundle/held": value if len(centres) > MANY else Segments(_edges(value), colour, 1.0)})


def _images(state: State, room: Bundle, layout: Layout, row: Iteration) -> Scene:
    """All but the chosen one in one node, solid where they are many; the chosen one with its photo and its rays."""
    centres, matrices = layout.poses(row.x)
    half, depth, found = _half(layout), _depth(layout, room.rows[0]), Scene()
    chosen = image_number(room, state.image)
    others = np.array([k for k in range(len(centres)) if k != chosen], int)
    colour = ink(state)
    if len(others):
        value = Frusta(centres[others], matrices[others], half[others], depth, colour)
        many = len(centres) > MANY
        found["/bundle/images"] = value if many else Segments(_edges(value), colour, 1.5)
    if chosen is not None:
        exterior = Exterior(matrices[chosen], centres[chosen])
        photo = state.assets.photos.get(state.image) if state.view.photos else None
        fov, aspect = 2 * float(np.arctan(half[chosen, 1])), float(half[chosen, 0] / half[chosen, 1])
        image = photo.thumbnail if photo else None
        found["/bundle/chosen/camera"] = Frustum(exterior, fov, aspect, depth, colour, 3.0, image)
        if room.draw_rays and state.view.rays:
            of = misfit(state)
            seen = np.zeros(0, int) if of is None else of.point[of.image == chosen][:2000]
            if len(seen):
                ends = layout.places(row.x)[seen]
                lines = np.stack([np.broadcast_to(exterior.centre, ends.shape), ends], axis=1)
                found["/bundle/chosen/rays"] = Segments(lines, pale(colour, state.view.dark), 1.0)
    if state.view.labels:
        for k, name in enumerate(layout.images):
            if k == chosen or len(layout.images) <= MANY:
                at = centres[k] + np.array([0, 0, 0.35 * depth])
                found[f"/bundle/names/{name.replace('/', '_')}"] = image_name(name, at, k == chosen)
    return found


@by_identity(4)
def _half(layout: Layout) -> np.ndarray:
    """Tangents (m, 2) of half the angles of view."""
    half = np.array([np.array([i.width, i.height]) * i.pitch / 2 / i.c for i in layout.interiors])
    return half[layout.camera_of]


@by_identity(4)
def _depth(layout: Layout, row: Iteration) -> float:
    """Depth (m) at which image planes are drawn: a twelfth of the way to the points, less where images stand close together."""
    from scipy.spatial import KDTree

    centres, places = layout.poses(row.x)[0], layout.places(row.x)
    middle = np.median(places, axis=0) if len(places) else centres.mean(axis=0)
    depth = 0.08 * float(np.median(np.linalg.norm(centres - middle, axis=1)))
    if len(centres) > 1:
        apart = float(np.median(KDTree(centres).query(centres, k=2)[0][:, 1]))
        depth = min(depth, 0.6 * apart) if apart > 0.05 * depth else depth
    return nice(max(depth, 1e-4))


def _edges(value: Frusta) -> np.ndarray:
    """Segments (8 n, 2, 3) of the outlines, with the four edges from the centre."""
    corners = frusta_corners(value)
    rays = np.stack([np.broadcast_to(value.centres[:, None], corners.shape), corners], axis=2)
    frame = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    return np.concatenate([rays, frame], axis=1).reshape(-1, 2, 3)


# -- object points ------------------------------------------------------------------------------------------------------------


def _points(state: State, room: Bundle, layout: Layout, block: Block, row: Iteration) -> Scene:
    places = layout.places(row.x)
    if not len(places):
        return {}
    rows = np.linspace(0, len(places) - 1, min(len(places), DRAWN)).astype(int)
    colours = point_colours(layout, block, misfit(state), room.colour, scale_end(state))
    return {"/bundle/points": PointCloud(places[rows], colours[rows], _dot(state, len(places)))}


def _dot(state: State, count: int) -> float:
    """Diameter (m) of a point: a part of a control point's symbol, less where they are many."""
    return symbol_size(state) * (0.7 if count <= 500 else 0.4 if count <= 20_000 else 0.2)


@by_identity(4)
def point_colours(layout: Layout, block: Block, of: Misfit | None, by: str, end: float) -> np.ndarray:
    """Colours (n, 3) uint8 of the points."""
    unknown = np.tile(np.array(UNKNOWN, np.uint8), (len(layout.points), 1))
    if by == COLOURED[1]:
        table = np.array([RAYS.get(min(max(k, 2), 5), UNKNOWN) for k in range(6)], np.uint8)
        return table[np.clip(ray_counts(layout, block), 0, 5)]
    if by != COLOURED[0] or of is None:
        return unknown
    rms = point_rms(layout, of)
    at = np.clip(np.nan_to_num(rms) / end, 0, 1) * (len(SCALE) - 1)
    found = np.stack([np.interp(at, np.arange(len(SCALE)), SCALE[:, c]) for c in range(3)], axis=1)
    return np.where(np.isfinite(rms)[:, None], np.round(found), unknown).astype(np.uint8)


def scale_end(state: State) -> float:
    """Residual [px] at the bright end of the scale: of the last row, all but the worst twentieth of the points lie below it."""
    room = state.room(Bundle)
    of = misfit(state if not room.rows else _at_last(state))
    return 1.0 if of is None or room.layout is None else _end(room.layout, of)


def _at_last(state: State) -> State:
    from dataclasses import replace

    return replace(state, row=len(state.room(Bundle).rows) - 1)


@by_identity(8)
def _end(layout: Layout, of: Misfit) -> float:
    rms = point_rms(layout, of)
    rms = rms[np.isfinite(rms)]
    return max(float(np.percentile(rms, 95)) if len(rms) else 1.0, 0.01)


# -- corrections, errors, ellipsoids ------------------------------------------------------------------------------------------


def offsets(state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """Control (a,) and check points (b,) by number, where they were given (n, 3) and how far off the row has them (n, 3)."""
    room = state.room(Bundle)
    row = room.at(state.row)
    if row is None or room.layout is None or room.block is None:
        return None
    return _offsets(room.layout, room.block, state.assets, row)


@by_identity(8)
def _offsets(layout: Layout, block: Block, assets: object, row: Iteration
             ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    control, check, given = given_places(layout, block, assets)  # type: ignore[arg-type]
    return control, check, given, layout.places(row.x) - given


def vector_factor(state: State) -> float:
    """Exaggeration of the vectors: the one chosen, or one that draws the longest of the last row as a sixth of the site."""
    room = state.room(Bundle)
    if room.vectors > 0:
        return room.vectors
    found = offsets(_at_last(state)) if room.rows else None
    if found is None:
        return 1.0
    rows = np.concatenate(found[:2])
    longest = float(np.linalg.norm(found[3][rows], axis=1).max(initial=0.0)) if len(rows) else 0.0
    return _fitted(state, longest, 6)


def ellipsoid_factor(state: State) -> float:
    """Exaggeration of the 95 % ellipsoids: the one chosen, or one that draws nine tenths of them below a tenth of the
    site, of many images below their distance."""
    room = state.room(Bundle)
    if room.ellipsoid > 0 or room.result is None:
        return room.ellipsoid or 1.0
    return _fitted(state, CHI_95 * _usual(room.result), max(10, 3 * len(room.result.values) ** 0.5))


@by_identity(2)
def _usual(result: Judged) -> float:
    """Largest standard error (m) that nine tenths of images and points stay below."""
    some = np.linspace(0, len(result.covariance) - 1, min(len(result.covariance), 2000)).astype(int)
    every = np.concatenate([result.image_covariance, result.covariance[some]])
    largest = np.sqrt(np.clip(np.linalg.eigvalsh(every)[:, -1], 0, None))
    largest = largest[np.isfinite(largest) & (largest > 0)]
    return float(np.percentile(largest, 90)) if len(largest) else 0.0


def _fitted(state: State, length: float, part: float) -> float:
    low, high = site(state)
    room = float((high - low).max()) / part
    return float(np.clip(nice(room / length), FACTORS[0], FACTORS[-1])) if length > 1e-12 and room > 0 else 1.0


def _vectors(state: State, layout: Layout, block: Block, row: Iteration) -> Scene:
    found, of, factor = Scene(), offsets(state), vector_factor(state)
    for name, rows, colour in (() if of is None else (("control", of[0], theme.CONTROL), ("check", of[1], theme.RESIDUAL))):
        if len(rows):
            start = of[2][rows]  # type: ignore[index]
            found[f"/bundle/vectors/{name}"] = Segments(
                np.stack([start, start + factor * of[3][rows]], axis=1), colour, 3.0)  # type: ignore[index]
    return found


def _ellipsoids(state: State, layout: Layout, row: Iteration) -> Scene:
    """95 %, a priori, of the centres and of the points (of many the largest); a node for each kind."""
    result, factor, found = judged(state), CHI_95 * ellipsoid_factor(state), Scene()
    if result is None:
        return found
    roles, places = _roles(result), layout.places(row.x)
    for kind, colour in (("control", theme.CONTROL), ("check", theme.CHECK), ("tie", theme.INITIAL)):
        rows = np.flatnonzero(roles == kind)
        rows = _largest(result, kind) if len(rows) > MOST else rows
        value = _ellipsoid_batch(places[rows], result.covariance[rows], factor, colour)
        if value is not None:
            found[f"/bundle/ellipsoids/{kind}"] = value
    value = _ellipsoid_batch(layout.poses(row.x)[0], result.image_covariance, factor, ink(state))
    return found if value is None else found | {"/bundle/ellipsoids/images": value}


def left_out(result: Judged) -> dict[str, int]:
    """How many points there are of each kind of which only the largest ellipsoids are drawn."""
    return {kind: n for kind in ("control", "check", "tie") if (n := result.roles.count(kind)) > MOST}


@by_identity(2)
def _roles(result: Judged) -> np.ndarray:
    return np.array(result.roles)


@by_identity(4)
def _largest(result: Judged, kind: str) -> np.ndarray:
    """The points (k,) of a kind with the largest ellipsoids."""
    rows = np.flatnonzero(_roles(result) == kind)
    return rows[np.argsort(-np.einsum("nii->n", result.covariance[rows]), kind="stable")[:MOST]]


def _ellipsoid_batch(centres: np.ndarray, covariance: np.ndarray, factor: float, colour: Colour) -> Ellipsoids | None:
    good = np.isfinite(covariance).all(axis=(1, 2)) & (np.einsum("nii->n", covariance) > 0)
    if not good.any():
        return None
    values, axes = np.linalg.eigh(covariance[good])
    axes = axes * np.sign(np.linalg.det(axes))[:, None, None]
    return Ellipsoids(centres[good], axes, factor * np.sqrt(np.clip(values, 1e-18, None)), colour, 0.3)


def bars(state: State) -> Scene:
    """What the exaggerated lengths are worth: a bar for the vectors, one for the ellipsoids, with words."""
    room, found = state.room(Bundle), Scene()
    lines = []
    if room.at(state.row) is None or room.layout is None or room.block is None:
        return found
    of = offsets(_at_last(state))
    moved = 0.0 if of is None else np.abs(of[3][np.concatenate(of[:2])]).max(initial=0.0)
    if room.draw_vectors and state.view.residuals and moved > 1e-9:
        lines.append(("vectors", vector_factor(state), "corrections and errors"))
    if room.draw_ellipsoids and state.view.ellipsoids and judged(state) is not None:
        lines.append(("ellipsoids", ellipsoid_factor(state), "95 % ellipsoids"))
    for k, (name, factor, words) in enumerate(lines, 1 + bars_drawn(state)):
        length = fitting(corner(state)[1], factor)
        found |= bar(state, f"/bundle/scale/{name}", k, factor * length, f"{said(length)}: {words} × {factor:g}")
    return found
