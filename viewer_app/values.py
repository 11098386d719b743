"""Scene values: what there is to see, without saying how it is painted. Lengths in metres of the local frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solvers import Exterior

from .theme import Colour


@dataclass(frozen=True, eq=False)
class Frustum:
    """A camera: fov (vertical, rad), aspect (width / height), depth (m) at which its image plane is drawn."""

    exterior: Exterior
    fov: float
    aspect: float
    depth: float
    colour: Colour
    thickness: float = 2.0  # px
    image: np.ndarray | None = None  # (h, w, 3) uint8


@dataclass(frozen=True, eq=False)
class Frusta:
    """Many cameras as one: centres (n, 3) m, matrices (n, 3, 3) object to photo axes, half (n, 2) tangents of half the angles of
    view across and down, depth (m)."""

    centres: np.ndarray
    matrices: np.ndarray
    half: np.ndarray
    depth: float
    colour: Colour


@dataclass(frozen=True, eq=False)
class Segments:
    """Line segments (n, 2, 3), thickness in pixels of the screen."""

    points: np.ndarray
    colour: Colour
    thickness: float = 1.0


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points (n, 3) with one colour or (n, 3) uint8 colours, size in metres."""

    points: np.ndarray
    colours: np.ndarray
    size: float


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """Semi-axes (3,) m along the columns of axes (3, 3), a rotation."""

    centre: np.ndarray
    axes: np.ndarray
    radii: np.ndarray
    colour: Colour
    opacity: float = 0.35


@dataclass(frozen=True, eq=False)
class Ellipsoids:
    """Many of one colour as one: centres (n, 3) m, axes (n, 3, 3) with the semi-axes' directions as columns, radii (n, 3) m."""

    centres: np.ndarray
    axes: np.ndarray
    radii: np.ndarray
    colour: Colour
    opacity: float = 0.35


@dataclass(frozen=True, eq=False)
class Plane:
    """A filled quadrilateral, corners (4, 3) in order."""

    corners: np.ndarray
    colour: Colour
    opacity: float


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a colour (uint8, 3) per vertex, drawn lower by so many metres."""

    vertices: np.ndarray
    faces: np.ndarray
    colours: np.ndarray
    lower: float = 0.0


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture (h, w, 4) uint8 spread over a rectangle: corners (4, 3) of its outer edges, top left, top right, bottom right,
    bottom left."""

    corners: np.ndarray
    rgba: np.ndarray
    opacity: float = 1.0


@dataclass(frozen=True, eq=False)
class Overlay:
    """A picture (h, w, 3) uint8 on a mesh: vertices (n, 3), faces (k, 3), places (n, 2) in the picture, 0..1 from its corner."""

    vertices: np.ndarray
    faces: np.ndarray
    places: np.ndarray
    pixels: np.ndarray
    opacity: float


@dataclass(frozen=True, eq=False)
class Label:
    """Text at a position, of constant size on the screen. One that stands on its place is a name, which may have to make room for
    a larger one; any other is said in words that are never hidden (scale, exaggeration, north)."""

    text: str
    position: np.ndarray
    size: float = 1.0
    anchor: Literal["bottom-left", "bottom-center", "center-left", "center-center", "top-left"] = "bottom-left"

    @property
    def words(self) -> bool:
        return not self.anchor.startswith("bottom")


def frustum_corners(value: Frustum) -> np.ndarray:
    """The four corners (4, 3) of a frustum's image plane: top left, top right, bottom right, bottom left of the photo."""
    y = value.depth * np.tan(value.fov / 2)
    x = y * value.aspect
    camera = np.array([[-x, y, -value.depth], [x, y, -value.depth], [x, -y, -value.depth], [-x, -y, -value.depth]])
    return camera @ value.exterior.m + value.exterior.centre


def frusta_corners(value: Frusta) -> np.ndarray:
    """Corners (n, 4, 3) of the image planes of many cameras."""
    signs = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]], float)
    across = signs[None] * value.half[:, None] * value.depth
    camera = np.concatenate([across, np.full((*across.shape[:2], 1), -value.depth)], axis=2)
    return camera @ value.matrices + value.centres[:, None]


def dashed(lines: np.ndarray, length: float) -> np.ndarray:
    """Segments (k, 2, 3) that draw lines (n, 2, 3) as dashes, dash and gap each about `length` m."""
    pieces = []
    for start, end in lines:
        n = 2 * max(round(float(np.linalg.norm(end - start)) / length / 2), 1) + 1
        at = start + np.arange(n + 1)[:, None] / n * (end - start)
        pieces.append(np.stack([at[:-1:2], at[1::2]], axis=1))
    return np.concatenate(pieces)


def linear(colours: np.ndarray) -> np.ndarray:
    """uint8 linear light of sRGB colours: glTF and three.js take colours of vertices as linear."""
    c = np.asarray(colours, float) / 255
    return np.round(255 * np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)).astype(np.uint8)


Value = Frustum | Frusta | Segments | PointCloud | Ellipsoid | Ellipsoids | Plane | Mesh | Picture | Overlay | Label
Scene = dict[str, Value]
"""Entity path -> value; the same paths in viser and rerun."""
