"""Where a point of one photo should be in another, before it is matched: by orientation, by earlier ties, by features."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .block import Block
from .cameras import Interior, project
from .errors import DegenerateGeometry
from .geometry import Exterior, LocalFrame, Surface
from .orientation import Plane
from .orientation.monoplot import trace_ray

STEP = 8.0
"""px between the points whose places tell how the surroundings of a point map."""
NEAREST = 8
"""Earlier ties that are used, the nearest."""


class Guess(NamedTuple):
    """A predicted place (2,) px, how offsets around it map there (2, 2), how far to search around it [px], and what told."""

    place: np.ndarray
    shape: np.ndarray
    reach: float
    how: str


class View(NamedTuple):
    """An oriented photo: its exterior orientation in the local frame, and the standard errors of a place [m] and of an angle
    [rad] of it, where it is as given and not adjusted."""

    name: str
    interior: Interior
    exterior: Exterior
    sigma_m: float = 0.0
    sigma_rad: float = 0.0


def by_orientation(first: View, second: View, at: np.ndarray, ground: Plane | Surface, frame: LocalFrame) -> Guess | None:
    """The place of a pixel (2,) seen on the ground by one photo in another; None where the other does not see it.

    The reach is what the standard errors of the ground and of the orientations as given move the place by, twice, and a few
    pixels.
    """
    corners = at + STEP * np.array([[0, 0], [1, 0], [0, 1]])
    try:
        hits = [trace_ray(first.name, first.interior, first.exterior, frame, (float(c), float(r)), ground) for c, r in corners]
    except DegenerateGeometry:
        return None
    local = frame.to_local(np.array([h.ground for h in hits]))
    toward = (local[0] - first.exterior.centre) / np.linalg.norm(local[0] - first.exterior.centre)
    slant = ground.sigma / max(abs(float(toward[2])), 0.05)
    return _seen(first, second, at, local, slant * toward, "orientation")


def by_point(first: View, second: View, xyz: np.ndarray, at: np.ndarray, sigma: float = 0.0) -> Guess | None:
    """The place of an object point xyz (3,) m of the local frame, known to sigma [m], measured at (2,) px in the first photo."""
    normal = np.array([0.0, 0.0, 1.0])
    corners = at + STEP * np.array([[1, 0], [0, 1]])
    rays = np.column_stack([first.interior.ideal(corners), np.full(2, -first.interior.c)]) @ first.exterior.m
    steep = rays @ normal
    if np.abs(steep).min() < 1e-3 * np.linalg.norm(rays, axis=1).max():
        normal = (first.exterior.centre - xyz) / np.linalg.norm(first.exterior.centre - xyz)
        steep = rays @ normal
    reach = (xyz - first.exterior.centre) @ normal / steep
    local = np.vstack([xyz, first.exterior.centre + reach[:, None] * rays])
    own = project(first.interior, first.exterior, local[:1])[0]
    if not np.isfinite(own).all():
        return None
    guess = _seen(first, second, own, local, sigma * np.array([0.0, 0.0, 1.0]), "orientation and coordinates")
    return guess if guess is None else guess._replace(reach=guess.reach + float(np.linalg.norm(own - at)))


def _seen(first: View, second: View, at: np.ndarray, local: np.ndarray, doubt: np.ndarray, how: str) -> Guess | None:
    """local (3, 3): the point and its neighbours to the right and below; doubt (3,) m: one standard error of the point."""
    own = project(first.interior, first.exterior, local)
    there = project(second.interior, second.exterior, np.vstack([local, local[0] + doubt]))
    if not np.isfinite(there).all() or not second.interior.inside(there[0]):
        return None
    shape = (there[1:3] - there[0]).T @ np.linalg.inv((own[1:] - at).T)
    if not 0.04 < abs(np.linalg.det(shape)) < 25:
        return None
    # A standard error of the first photo shows as it would in the second, near enough.
    off = [view.interior.c / view.interior.pitch.mean() * np.hypot(
        view.sigma_rad, view.sigma_m / np.linalg.norm(local[0] - view.exterior.centre)) for view in (first, second)]
    return Guess(there[0], shape, 4.0 + 2.0 * float(np.linalg.norm([*(there[3] - there[0]), *off])), how)


def by_ties(first: np.ndarray, second: np.ndarray, at: np.ndarray) -> Guess | None:
    """From points (n, 2) px seen in both photos, the nearest of them; None without any or where they contradict each other."""
    if len(first) == 0:
        return None
    distance = np.linalg.norm(first - at, axis=1)
    near = np.argsort(distance)[:NEAREST]
    a, b, far = first[near], second[near], float(distance[near].max())
    words = f"{len(first)} earlier tie{'s' if len(first) > 1 else ''}"
    if len(near) < 3:
        shape = np.eye(2) if len(near) == 1 else _similarity(a, b)
        place = b[0] + shape @ (at - a[0])
        return Guess(place, shape, min(12.0 + 0.1 * float(distance.min()), 60.0), words)
    design = np.column_stack([np.ones(len(a)), a - at])
    if np.linalg.svd(design / [1, max(far, 1.0), max(far, 1.0)], compute_uv=False)[-1] < 0.05:
        return by_ties(a[:2], b[:2], at)._replace(how=words)  # type: ignore[union-attr]
    weight = 1 / (1 + distance[near] / max(float(np.median(distance[near])), 1.0))
    solved = np.linalg.lstsq(design * weight[:, None], b * weight[:, None], rcond=None)[0]
    off = float(np.sqrt(((b - design @ solved) ** 2).sum(axis=1).mean()))
    return Guess(solved[0], solved[1:].T, min(max(6.0, 3.0 * off + 0.02 * float(distance.min())), 60.0), words)


def _similarity(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(2, 2) turn and scale that carries the way between two points (2, 2) into that between two others."""
    p, q = complex(*(a[1] - a[0])), complex(*(b[1] - b[0]))
    z = q / p if abs(p) > 1e-6 else 1 + 0j
    return np.array([[z.real, -z.imag], [z.imag, z.real]])


def common_points(block: Block, first: str, second: str) -> tuple[np.ndarray, np.ndarray, Sequence[str]]:
    """Pixels (n, 2) in two images of the points measured in both, and their names."""
    of = block.observations
    rows = [{int(of.point[r]): r for r in np.flatnonzero(of.image == block.image_index(name))} for name in (first, second)]
    both = sorted(rows[0].keys() & rows[1].keys())
    a, b = (of.pixel[[row[j] for j in both]].reshape(-1, 2) for row in rows)
    return a, b, [block.points.names[j] for j in both]
