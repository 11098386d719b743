"""A photo of the terrain: every pixel's ray meets the ground, and the colour there is what it sees."""

from __future__ import annotations

import numpy as np

from ..cameras import Interior, project
from ..errors import BadProject
from ..geometry import Exterior
from .terrain import Terrain

RING = (0.22, 0.50, 0.85, 1.15)  # m, radii: white dot, inner and outer edge of the white ring, edge of the dark board
_WHITE, _DARK = np.array([250.0, 250.0, 246.0], np.float32), np.array([26.0, 27.0, 30.0], np.float32)
_STRIP = 64  # rows of the photo at a time: memory stays small


def photograph(camera: Interior, exterior: Exterior, terrain: Terrain, ground: np.ndarray, cell: float, targets: np.ndarray,
               reduction: int = 4, samples: int = 2) -> np.ndarray:
    """The photo (height / reduction, width / reduction, 3) uint8 RGB of a painted terrain with ring `targets` (n, 3) m.

    ground: the picture painted on the terrain, (rows, columns, 3), first row north, pixels of `cell` [m] tiling its bounds.
    A pixel (col, row) of the photo covers reduction x reduction pixels of the camera: camera col = (col + 0.5) * reduction - 0.5.
    samples: rays per pixel and direction. Targets are level boards, white dot and ring on a dark disc, centred on their points.
    Raises BadProject when the reduction does not divide the format.
    """
    if reduction < 1 or camera.width % reduction or camera.height % reduction:
        raise BadProject(f"reduction {reduction} does not divide the format {camera.width} x {camera.height} px; "
                         "choose a common divisor of both")
    width, height = camera.width // reduction, camera.height // reduction
    photo = np.empty((height, width, 3), np.uint8)
    inside = (np.arange(samples) + 0.5) / samples
    cols = ((np.arange(width)[:, None] + inside).ravel()) * reduction - 0.5
    for top in range(0, height, _STRIP):
        rows = ((np.arange(top, min(top + _STRIP, height))[:, None] + inside).ravel()) * reduction - 0.5
        pixels = np.stack(np.meshgrid(cols, rows), -1)
        colour = _colours(camera, exterior, terrain, ground, cell, targets, pixels)
        n = len(rows) // samples
        mean = colour.reshape(n, samples, width, samples, 3).mean(axis=(1, 3))
        photo[top:top + n] = np.clip(mean + 0.5, 0, 255).astype(np.uint8)
    return photo


def _colours(camera: Interior, exterior: Exterior, terrain: Terrain, ground: np.ndarray, cell: float, targets: np.ndarray,
             pixels: np.ndarray) -> np.ndarray:
    """Colours (h, w, 3) that the rays of pixels (h, w, 2) see."""
    import cv2

    ideal = camera.ideal(pixels)
    rays = np.concatenate([ideal, np.full((*ideal.shape[:2], 1), -camera.c)], -1) @ exterior.m
    at = terrain.meet(exterior.centre, rays)
    west, _, _, north = terrain.bounds
    u, v = (at[..., 0] - west) / cell - 0.5, (north - at[..., 1]) / cell - 0.5
    seen = cv2.remap(ground, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    colour = seen.astype(np.float32)
    for target, pixel in zip(targets, project(camera, exterior, targets), strict=True):
        metres = float(np.linalg.norm(target - exterior.centre)) * camera.pitch.min() / camera.c  # of one camera pixel
        reach = 2 * RING[3] / metres
        rows, cols = (_between(pixels[:, 0, 1], pixel[1], reach), _between(pixels[0, :, 0], pixel[0], reach))
        ray = rays[rows, cols]
        board = exterior.centre[:2] + ray[..., :2] * ((target[2] - exterior.centre[2]) / ray[..., 2])[..., None]
        step = metres * (pixels[0, 1, 0] - pixels[0, 0, 0])
        colour[rows, cols] = _ring(np.linalg.norm(board - target[:2], axis=-1), step, colour[rows, cols])
    return colour


def _between(values: np.ndarray, middle: float, reach: float) -> slice:
    return slice(*np.searchsorted(values, [middle - reach, middle + reach]))


def _ring(radius: np.ndarray, step: float, ground: np.ndarray) -> np.ndarray:
    """Colours (..., 3) at distances (...,) m from a target's middle on `ground` (..., 3), edges softened over `step` m."""
    dot, inner, outer, board = (np.clip((edge - radius) / step + 0.5, 0, 1)[..., None] for edge in RING)
    return ground + board * (_DARK - ground) + (dot + outer - inner) * (_WHITE - _DARK)
