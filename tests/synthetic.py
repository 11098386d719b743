"""Geometry with a known truth for tests: cameras, attitudes, clusters of control, and the Block that observes them."""

from __future__ import annotations

import numpy as np

from solvers import Block, Exterior, Image, Interior, Observations, Points, Prior
from solvers.cameras import project
from solvers.geometry import exp

SEED_CAMERA = Interior(35.0, pixel_mm=23.5 / 6000, width=6000, height=4000)
"""35 mm, 23.5 mm wide, square pixels: the camera of the published clusters."""

SEED_EXTERIOR = Exterior.from_angles(*np.radians([-2.6368, 3.9069, 88.933]), centre=np.array([0.0, 0.0, 300.0]))
"""The published attitude (kappa near 90 degrees), 300 m above the local origin."""

REAL_CAMERA = Interior(35.0, 0.12, -0.08, 6e-5, -4e-8, 1e-11, 5e-6, -3e-6, 1e-4, -5e-5, pixel_mm=(0.004, 0.0041), width=6000,
                       height=4000)
"""All ten parameters at work, and pixels that are not square."""


def cluster(centre_mm: tuple[float, float] = (0.0, 0.0), n: int = 4, fov_deg: float = 6.0, relief: float = 5.0) -> np.ndarray:
    """(n, 3) m: control within a cone of `fov_deg` about the ground point seen at `centre_mm` by SEED_EXTERIOR."""
    ray = SEED_EXTERIOR.m.T @ np.array([*centre_mm, -SEED_CAMERA.c])
    middle = SEED_EXTERIOR.centre - ray * SEED_EXTERIOR.centre[2] / ray[2]
    radius = np.linalg.norm(middle - SEED_EXTERIOR.centre) * np.tan(np.radians(fov_deg) / 2)
    k = np.arange(n)
    if n == 4:
        azimuth, r, z = 0.3 + k * np.pi / 2, np.full(4, radius), relief / 2 * np.array([1.0, -1, 1, -1])
    else:
        azimuth = k * np.pi * (3 - np.sqrt(5)) + 0.3
        r = radius * np.sqrt((k + 0.5) / (n - 0.5))
        z = relief * (np.mod(k * 0.6180339887498949, 1) - 0.5)
    return middle + np.column_stack([r * np.cos(azimuth), r * np.sin(azimuth), z])


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A rotation (3, 3), uniform over all attitudes."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def scene(rng: np.random.Generator, n: int = 12, fov_deg: float = 40.0, distance: float = 300.0, depth: float = 0.3,
          m: np.ndarray | None = None, interior: Interior = SEED_CAMERA) -> tuple[np.ndarray, Exterior]:
    """Control (n, 3) m near the origin, spread over a field of view and `depth` times the distance, and a camera that sees
    all of it under any attitude."""
    m = random_rotation(rng) if m is None else m
    reach = np.tan(np.radians(fov_deg) / 2)
    d = distance * (1 + depth * rng.uniform(-0.5, 0.5, n))
    half = reach * min(interior.width, interior.height) / interior.width
    camera = np.column_stack([d * rng.uniform(-reach, reach, n), d * rng.uniform(-half, half, n), -d])
    centre = -camera.mean(axis=0) @ m
    return camera @ m + centre, Exterior(m, centre)


def block_of(points: np.ndarray, exterior: Exterior, interior: Interior = SEED_CAMERA, *, noise_px: float = 0.0,
             noise_m: float = 0.0, sigma_px: float = 0.3, sigma_m: float = 0.002, seed: int = 0, prior: Prior | None = None,
             crs: str = "local", frame: str = "tangent", map_points: np.ndarray | None = None) -> Block:
    """One image "a" that observes control P1, P2 ... (n, 3) m. Stated sigmas are sigma_px and sigma_m; noise is drawn with
    noise_px and noise_m. map_points: the coordinates the project states, where they are not `points`."""
    rng = np.random.default_rng(seed)
    n = len(points)
    pixels = project(interior, exterior, points) + noise_px * rng.standard_normal((n, 2))
    stated = (points if map_points is None else map_points) + noise_m * rng.standard_normal((n, 3))
    return Block(
        "site", crs, {"cam": interior}, (Image("a", "cam", None, prior),),
        Points(tuple(f"P{i + 1}" for i in range(n)), stated, np.full((n, 3), sigma_m), ("control",) * n),
        Observations(np.zeros(n, int), np.arange(n), pixels, np.full(n, sigma_px)), frame=frame)


def prior_of(exterior: Exterior, sigma_deg: float, sigma_m: float, rng: np.random.Generator | None = None,
             stated: float = 1.0) -> Prior:
    """A prior off the truth by a draw of its sigmas (exact without rng); the sigmas it states are `stated` times the true."""
    draw = np.zeros(6) if rng is None else rng.standard_normal(6)
    return Prior(exterior.centre + sigma_m * draw[:3], exterior.angles + np.radians(sigma_deg) * draw[3:],
                 np.full(3, sigma_m * stated), np.full(3, np.radians(sigma_deg) * stated))


def moved(exterior: Exterior, d: np.ndarray, shift: np.ndarray) -> Exterior:
    """An exterior orientation moved by a left rotation vector d [rad] and a shift [m]."""
    return Exterior(exp(d) @ exterior.m, exterior.centre + shift)
