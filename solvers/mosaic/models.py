"""How a photo sees the plane: by eight plane coefficients (or fewer, for a gentle start) or by its exterior orientation.

Each model says where points are seen and how that changes with its own tangent. H (3, 3) maps the mosaic plane X, Y, 1 to ideal
photo coordinates over c; its tangent D acts on the photo's side, H <- (I + D) H with D33 = 0, so that it is as well
conditioned at the far end of a long strip as at its beginning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from ..geometry import Exterior
from ..geometry.rotation import exp_many


class Seen(NamedTuple):
    """Predicted q (o, 2), NaN where a point lies behind the photo; derivatives by photo (o, 2, s) and by point (o, 2, 2)."""

    q: np.ndarray
    by_photo: np.ndarray
    by_point: np.ndarray


class Model(Protocol):
    """size s: tangent of one photo; width: numbers that x stores of it."""

    @property
    def size(self) -> int: ...

    @property
    def width(self) -> int: ...

    def see(self, photos: np.ndarray, image: np.ndarray, xy: np.ndarray, lift: np.ndarray) -> Seen:
        """photos (m, width); observation o sees in photo image[o] the point xy[o] that lies lift[o] above the plane."""
        ...

    def moved(self, photos: np.ndarray, step: np.ndarray) -> np.ndarray:
        """photos (k, width) after tangent steps (k, s)."""
        ...


SIMILARITY = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1], [0] * 4, [0] * 4],
                      float)
AFFINE = np.eye(8)[:, :6]
BASES = {"similarity": SIMILARITY, "affine": AFFINE, "projective": np.eye(8)}
"""(8, s) directions of D = (d11 d12 d13 d21 d22 d23 d31 d32) that a stage may use."""


@dataclass(frozen=True)
class Coefficients:
    """Plane coefficients. stage: "similarity" (4), "affine" (6) or "projective" (8 unknowns of each photo)."""

    stage: str = "projective"

    @property
    def size(self) -> int:
        return BASES[self.stage].shape[1]

    @property
    def width(self) -> int:
        return 9

    def see(self, photos: np.ndarray, image: np.ndarray, xy: np.ndarray, lift: np.ndarray) -> Seen:
        h = photos.reshape(-1, 3, 3)[image]
        q, w = through(h, xy)
        by_point = (h[:, :2, :2] - q[:, :, None] * h[:, 2:, :2]) / w[:, None, None]
        return Seen(q, tangent(q) @ BASES[self.stage], by_point)

    def moved(self, photos: np.ndarray, step: np.ndarray) -> np.ndarray:
        d = np.zeros((len(photos), 9))
        d[:, :8] = step @ BASES[self.stage].T
        h = (np.eye(3) + d.reshape(-1, 3, 3)) @ photos.reshape(-1, 3, 3)
        return (h / np.linalg.norm(h, axis=(1, 2))[:, None, None]).reshape(-1, 9)


def tangent(q: np.ndarray) -> np.ndarray:
    """(o, 2, 8) change of photo coordinates q (o, 2) by D."""
    j = np.zeros((len(q), 2, 8))
    j[:, 0, 0:2], j[:, 0, 2], j[:, 1, 3:5], j[:, 1, 5] = q, 1.0, q, 1.0
    j[:, :, 6:] = -q[:, :, None] * q[:, None, :]
    return j


def through(h: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """q (o, 2) and w (o,) of points xy (o, 2) through H (o, 3, 3); NaN where w is not positive."""
    p = (h[:, :, :2] @ xy[:, :, None])[:, :, 0] + h[:, :, 2]
    w = np.where(p[:, 2] > 0, p[:, 2], np.nan)
    return p[:, :2] / w[:, None], w


@dataclass(frozen=True)
class Exteriors:
    """Exterior orientations over the plane Z = z0 + zx X + zy Y; x stores the 12 numbers of each, the tangent is centre and left
    rotation vector."""

    plane: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def size(self) -> int:
        return 6

    @property
    def width(self) -> int:
        return 12

    def points(self, xy: np.ndarray, lift: np.ndarray) -> np.ndarray:
        """(n, 3) local coordinates of points on and above the plane."""
        z0, zx, zy = self.plane
        return np.column_stack([xy, z0 + xy @ np.array([zx, zy]) + lift])

    def see(self, photos: np.ndarray, image: np.ndarray, xy: np.ndarray, lift: np.ndarray) -> Seen:
        m = photos[:, 3:].reshape(-1, 3, 3)[image]
        d = self.points(xy, lift) - photos[image, :3]
        uvw = np.einsum("oij,oj->oi", m, d)
        w = np.where(uvw[:, 2] < 0, uvw[:, 2], np.nan)
        q = -uvw[:, :2] / w[:, None]
        a = np.zeros((len(q), 2, 3))  # dq = a d(uvw)
        a[:, 0, 0] = a[:, 1, 1] = -1 / w
        a[:, :, 2] = -q / w[:, None]
        by_point = a @ m
        by_photo = np.concatenate([-by_point, np.cross(uvw[:, None, :], a)], axis=2)  # -a [uvw]x
        return Seen(q, by_photo, by_point[:, :, :2] + by_point[:, :, 2:] * np.array(self.plane[1:]))

    def moved(self, photos: np.ndarray, step: np.ndarray) -> np.ndarray:
        m = exp_many(step[:, 3:]) @ photos[:, 3:].reshape(-1, 3, 3)
        return np.hstack([photos[:, :3] + step[:, :3], m.reshape(-1, 9)])


def exterior_rows(exteriors: list[Exterior]) -> np.ndarray:
    """(m, 12) as `Exteriors` stores them."""
    return np.array([e.vector for e in exteriors])
