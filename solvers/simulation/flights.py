"""A regular block of UAV photos: strips flown to and fro over the simulated country, with tie points, control and priors."""

from __future__ import annotations

import numpy as np

from ..block import Block, Image
from ..cameras import Interior
from ..errors import BadProject
from ..geometry import Exterior
from .country import Country
from .relief import HALF, LEVEL
from .scene import Simulated, observe, onboard, pose, survey

_CAMERA = Interior(35.0, pixel_mm=23.5 / 6000, width=6000, height=4000)
_MARGIN = 60.0  # px, so that a whole target is in the photo
_MIDDLE = np.array([679400.0, 9123770.0])


def uav_block(seed: int = 0, *, strips: int = 3, images: int = 6, forward: float = 0.7, side: float = 0.5, height: float = 200.0,
              ties: int = 600, control: int = 8, checks: int = 8, image_px: float = 0.3, control_m: float = 0.02,
              gps_m: float = 2.0, tilt_deg: float = 3.0, noise: float = 1.0, fine: bool = True) -> Simulated:
    """Strips of near-vertical photos, flown alternately north and south, with the wind's tilt.

    forward, side: overlaps; height: above mean ground [m]; ties: tie points tried, kept where two images or more see them;
    control, checks: points with targets, round the border and half-way to it; gps_m: sigma of the priors [m], angles 2 degrees.
    Raises BadProject when the block is larger than the simulated country.
    """
    relief, paint, flight, places, errors, priors = np.random.SeedSequence(seed).spawn(6)
    country = Country.around(_MIDDLE, relief, paint, 0.125 if fine else 0.5)
    truth, area = _fly(strips, images, forward, side, height, tilt_deg, np.random.default_rng(flight))
    rng, gps, scatter = (np.random.default_rng(s) for s in (errors, priors, places))
    around = np.concatenate([_round(control, 0.92, scatter), _round(checks, 0.5, scatter)])
    marked = country.terrain.on_ground(_MIDDLE + area * around)
    tried = country.terrain.on_ground(_MIDDLE + area * scatter.uniform(-1.2, 1.2, (ties, 2)))
    cameras, exteriors = [_CAMERA] * len(truth), list(truth.values())
    tied = tried[np.unique(observe(cameras, exteriors, tried, image_px, 0.0, rng, _MARGIN, least=2).point)]
    xyz = np.concatenate([marked, tied]).round(6)
    roles = ("control",) * control + ("check",) * checks + ("tie",) * len(tied)
    prefixes = {"control": "G", "check": "C", "tie": "T"}
    labels = tuple(f"{prefixes[role]}{i + 1:04d}" for i, role in enumerate(roles))
    block = Block(
        name="UAV block", crs="local", cameras={"nex": _CAMERA},
        images=tuple(Image(n, "nex", f"images/{n}.jpg", onboard(e, gps_m, 2.0, noise, gps)) for n, e in truth.items()),
        points=survey(labels, xyz, roles, control_m, noise, rng),
        observations=observe(cameras, exteriors, xyz, image_px, noise, rng, _MARGIN, least=2),
        image_px=image_px, control_m=(control_m, control_m, control_m), surface={"file": "dem.tif"},
    )
    return Simulated(block, truth, xyz, {"nex": _CAMERA}, country.terrain, country.renderer(block, truth, xyz[:len(marked)]))


def _fly(strips: int, images: int, forward: float, side: float, height: float, tilt: float,
         rng: np.random.Generator) -> tuple[dict[str, Exterior], np.ndarray]:
    """True orientations by name, and half the size (2,) m of the rectangle of centres widened by a third of a photo."""
    photo = np.array([_CAMERA.width, _CAMERA.height]) * _CAMERA.pitch / _CAMERA.c * height
    step = photo * [1 - side, 1 - forward]
    half = step * [(strips - 1) / 2, (images - 1) / 2]
    reach = float((half + photo / 2 + height * np.tan(np.radians(2 * tilt))).max())
    if reach > HALF:
        raise BadProject(f"{strips} strips of {images} images from {height:g} m reach {reach:.0f} m from their middle and the "
                         f"simulated country ends at {HALF:g} m; fly lower, overlap more, or take fewer images")
    truth: dict[str, Exterior] = {}
    for s in range(strips):
        for i in range(images):
            east, north = step * [s, i if s % 2 == 0 else images - 1 - i] - half
            centre = np.array([_MIDDLE[0] + east, _MIDDLE[1] + north, LEVEL + height]) + rng.normal(0, [1.5, 1.5, 1.0])
            omega, phi, kappa = rng.normal(0, tilt / 2, 3).clip(-tilt, tilt).round(4)
            truth[f"S{s + 1}_{i + 1:02d}"] = pose(omega, phi, kappa + 180.0 * (s % 2), centre.round(4))
    return truth, half + photo / 3


def _round(n: int, reach: float, rng: np.random.Generator) -> np.ndarray:
    """Places (n, 2) on the border of a square of half side `reach`, evenly spread by direction, a little shaken."""
    turn = 2 * np.pi * (np.arange(n) + rng.uniform(-0.2, 0.2, n) + 0.5) / max(n, 1)
    around = np.column_stack([np.cos(turn), np.sin(turn)])
    return reach * around / np.abs(around).max(axis=1, keepdims=True)
