"""The demo's flight: tilted UAV photos over 33 control points, twenty-five of them in five clusters of about 6 degrees.

Camera, flying height and the first image's orientation are those of Tjahjadi & Agustina 2019, "Single image orientation of UAV's
imagery using orthogonal projection model", section I and Table I; the paper does not print its points, so these are our own.
"""

from __future__ import annotations

import numpy as np

from ..block import Block, Image
from ..cameras import Interior
from ..geometry import Exterior
from .country import Country
from .relief import LEVEL, river
from .scene import Simulated, observe, onboard, pose, survey
from .terrain import Terrain

CAMERA = Interior(35.0, pixel_mm=23.5 / 6000, width=6000, height=4000)
TABLE_I = pose(-2.6368, 3.9069, 88.933, np.array([679421.0695, 9123785.2218, 794.8981]))
MIDDLE = np.array([679400.0, 9123770.0])  # m, where the optical axis of the first image meets the ground, roughly
FIELD = np.radians(6.0)  # full angle of a cluster
TARGET_MARGIN = 40.0  # px, so that a whole target is in the photo

# east, north of MIDDLE [m], height [m], omega, phi, kappa [degrees]; the last one is an oblique
_FLIGHT = ((-38, 12, 305, -2.3, -6.3, 90.2), (48, -22, 296, 3.5, 6.8, -91.4), (-8, 62, 302, -9.0, -1.2, 87.6),
           (5, -118, 280, 22.0, 1.0, 1.5))
_CLUSTERS_MM = ((-7.6, 4.6), (7.6, 4.7), (7.5, -4.6), (-7.4, -4.7), (0.2, -0.3))
_OTHERS_MM = ((-10.6, 0.4), (10.5, -0.6), (0.4, 6.5), (-0.6, -6.4), (-4.3, 0.8), (4.9, 1.2), (10.4, 7.0), (-10.5, -6.9))
_CHECKS_MM = ((-6.4, -0.9), (6.2, -2.2), (1.8, 3.7), (-2.2, -3.8), (9.6, 2.1), (-9.3, 2.4))


def uav_cluster(seed: int | np.random.SeedSequence = 0, *, image_px: float = 0.3, control_m: float = 0.002, noise: float = 1.0,
                fine: bool = True) -> Simulated:
    """Five tilted photos from 300 m, 33 GCPs (groups cluster1 .. cluster5), six check points, terrain and photos to render.

    image_px, control_m: stated sigmas of image and control coordinates; noise: actual errors in units of them (0: none).
    fine: False paints the ground coarsely, for quick tests.
    """
    streams = np.random.SeedSequence(seed).spawn(6) if isinstance(seed, int) else seed.spawn(6)
    relief, flight, places, errors, priors, paint = streams
    country = Country.around(MIDDLE, relief, paint, 0.125 if fine else 0.5)
    truth = _fly(np.random.default_rng(flight))
    control, group = _control(country.terrain, np.random.default_rng(places))
    checks = country.terrain.on_ground(_dry(_ground(country.terrain, _CHECKS_MM)[:, :2]))
    xyz = np.round(np.concatenate([control, checks]), 6)
    roles = ("control",) * len(control) + ("check",) * len(checks)
    labels = tuple(f"G{i + 1:02d}" for i in range(len(control))) + tuple(f"C{i + 1:02d}" for i in range(len(checks)))
    rng, gps = np.random.default_rng(errors), np.random.default_rng(priors)
    block = Block(
        name="Five clusters", crs="local", cameras={"nex": CAMERA},
        images=tuple(Image(n, "nex", f"images/{n}.jpg", onboard(e, 2.0, 1.5, noise, gps)) for n, e in truth.items()),
        points=survey(labels, xyz, roles, control_m, noise, rng, group + ("",) * len(checks)),
        observations=observe([CAMERA] * len(truth), list(truth.values()), xyz, image_px, noise, rng, TARGET_MARGIN),
        image_px=image_px, control_m=(control_m, control_m, control_m), surface={"file": "dem.tif"},
    )
    return Simulated(block, truth, xyz, {"nex": CAMERA}, country.terrain, country.renderer(block, truth, xyz))


def _fly(rng: np.random.Generator) -> dict[str, Exterior]:
    """True orientations by image name: Table I first, then the flight with a little wind."""
    exteriors = [TABLE_I]
    for east, north, up, omega, phi, kappa in _FLIGHT:
        centre = np.array([MIDDLE[0] + east, MIDDLE[1] + north, LEVEL + up]) + rng.uniform(-4, 4, 3)
        wind = rng.uniform(-1, 1, 3)
        exteriors.append(pose(round(omega + wind[0], 4), round(phi + wind[1], 4), round(kappa + wind[2], 4), centre.round(4)))
    return {f"DSC{229 + i:05d}": e for i, e in enumerate(exteriors)}


def _ground(terrain: Terrain, photo_mm: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Ground points (n, 3) m under photo positions (n, 2) mm of the first image."""
    rays = np.column_stack([np.array(photo_mm), np.full(len(photo_mm), -CAMERA.c)]) @ TABLE_I.m
    return terrain.meet(TABLE_I.centre, rays)


def _dry(xy: np.ndarray, clear: float = 9.0) -> np.ndarray:
    """Positions (n, 2) m moved north or south until they are `clear` [m] from the middle of the river."""
    bank = MIDDLE[1] + river(xy[:, 0] - MIDDLE[0])
    off = xy[:, 1] - bank
    return np.column_stack([xy[:, 0], np.where(np.abs(off) < clear, bank + np.copysign(clear, off), xy[:, 1])])


def _control(terrain: Terrain, rng: np.random.Generator) -> tuple[np.ndarray, tuple[str, ...]]:
    """The 33 control points (33, 3) m and their groups: each cluster four points on a circle of 6 degrees and one inside."""
    xy, group = [], []
    for k, centre in enumerate(_ground(terrain, _CLUSTERS_MM)):
        radius = np.linalg.norm(centre - TABLE_I.centre) * np.tan(FIELD / 2)
        azimuth = 0.3 + np.pi / 2 * np.arange(5) + rng.uniform(-0.25, 0.25, 5)
        reach = radius * np.array([*rng.uniform(0.94, 1.0, 4), rng.uniform(0.1, 0.4)])
        xy.append(centre[:2] + reach[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)]))
        group += [f"cluster{k + 1}"] * 5
    xy.append(_ground(terrain, _OTHERS_MM)[:, :2])
    return terrain.on_ground(_dry(np.concatenate(xy))), (*group, *[""] * len(_OTHERS_MM))
