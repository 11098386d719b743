"""What a simulation gives: a Block as a project would hold it, and the truth behind it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..block import Block, Observations, Points, Prior
from ..cameras import PARAMETERS, Interior, project
from ..geometry import Exterior, rotation
from .terrain import Terrain

Render = Callable[[str, int], np.ndarray]
"""render(image, reduction) -> (height // reduction, width // reduction, 3) uint8 RGB."""


@dataclass(frozen=True)
class Simulated:
    """A block and its truth, in the same coordinates: exteriors by image name, true points xyz (n, 3) m, true cameras."""

    block: Block
    exteriors: Mapping[str, Exterior]
    xyz: np.ndarray
    cameras: Mapping[str, Interior]
    terrain: Terrain | None = None
    render: Render | None = None

    @property
    def truth(self) -> dict[str, Any]:
        """The truth as truth.json holds it: images (m, degrees), cameras (mm), points (m)."""
        return {
            "images": {name: _pose(e) for name, e in self.exteriors.items()},
            "cameras": {name: _camera(c) for name, c in self.cameras.items()},
            "points": {name: p.tolist() for name, p in zip(self.block.points.names, self.xyz, strict=True)},
        }


def _pose(exterior: Exterior) -> dict[str, float]:
    degrees = np.degrees(exterior.angles).round(12)
    keys = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg")
    return dict(zip(keys, [*exterior.centre.tolist(), *degrees.tolist()], strict=True))


def _camera(interior: Interior) -> dict[str, Any]:
    parameters = {f"{p}_mm" if p in ("c", "xp", "yp") else p: float(getattr(interior, p)) for p in PARAMETERS}
    return {"width": interior.width, "height": interior.height, "pixel_mm": interior.pitch.tolist(), **parameters}


def pose(omega_deg: float, phi_deg: float, kappa_deg: float, centre: np.ndarray) -> Exterior:
    """Exterior orientation of angles in degrees and a perspective centre (3,) m."""
    return Exterior.from_angles(np.radians(omega_deg), np.radians(phi_deg), np.radians(kappa_deg), centre)


def look_at(centre: np.ndarray, target: np.ndarray, roll_deg: float = 0.0) -> Exterior:
    """Exterior orientation of a camera at `centre` (3,) m aiming at `target`, +Y up in the photo, then rolled about its axis."""
    back = (centre - target) / np.linalg.norm(centre - target)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    return Exterior(rotation(0.0, 0.0, np.radians(roll_deg)) @ np.stack([right, np.cross(back, right), back]), centre)


def observe(cameras: list[Interior], exteriors: list[Exterior], xyz: np.ndarray, sigma: float, noise: float,
            rng: np.random.Generator, margin: float = 0.0, least: int = 1) -> Observations:
    """Observations of points (n, 3) m in every image that sees them, Gaussian errors of `noise` * `sigma` px.

    Only points inside the format by `margin` px, in at least `least` images. With errors, pixels are rounded to 0.001.
    """
    pixels = np.stack([project(c, e, xyz) for c, e in zip(cameras, exteriors, strict=True)])
    seen = np.stack([c.inside(p, -margin) for c, p in zip(cameras, pixels, strict=True)])
    seen &= seen.sum(axis=0) >= least
    image, point = np.nonzero(seen)
    pixel = pixels[image, point]
    if noise:
        pixel = np.round(pixel + noise * sigma * rng.standard_normal(pixel.shape), 3)
    return Observations(image, point, pixel, np.full(len(image), float(sigma)))


def survey(names: tuple[str, ...], xyz: np.ndarray, role: tuple[str, ...], sigma: float, noise: float, rng: np.random.Generator,
           group: tuple[str, ...] = ()) -> Points:
    """Points as a surveyor would give them: truth (n, 3) m with errors of `noise` * `sigma` m, to 0.1 mm; tie points unknown."""
    errors = noise * sigma * rng.standard_normal(xyz.shape)
    given = np.round(xyz + errors, 4) if noise else np.array(xyz, float)
    given[np.array(role) == "tie"] = np.nan
    return Points(names, given, np.where(np.isnan(given), np.nan, sigma), role, group)


def onboard(exterior: Exterior, sigma_m: float, sigma_deg: float, noise: float, rng: np.random.Generator) -> Prior:
    """The prior of a simple GPS/IMU: the true orientation with errors as large as its sigmas say, to 1 cm and 0.01 degree."""
    centre = exterior.centre + noise * sigma_m * rng.standard_normal(3)
    degrees = np.degrees(exterior.angles) + noise * sigma_deg * rng.standard_normal(3)
    return Prior(centre.round(2), np.radians(degrees.round(2)), np.full(3, sigma_m), np.full(3, np.radians(sigma_deg)))
