"""Close-range networks with convergent images: Ono & Hattori's simulations, a long-range field test, a calibration plate."""

from __future__ import annotations

import numpy as np

from ..block import Block, Image, Points
from ..cameras import Interior
from ..geometry import Exterior
from .scene import Simulated, look_at, observe, onboard

# Ono & Hattori 2002, "Fundamental principles of image orientation using orthogonal projection model", Table 1 (here in m)
_OBJECT = np.array([(-200, 800, 0), (-200, 500, 0), (-300, 100, 0), (-100, 700, 200), (-150, 350, 300), (100, 700, 0),
                    (50, 450, 0), (250, 800, 350), (300, 550, 0), (250, 250, 250), (400, 800, 0), (400, 150, 0)]) / 1000.0
_STATIONS = {"A": (-3.0, 0.5, 10.0), "B": (3.0, 0.4, 10.0), "C": (0.0, 0.4, 11.0)}
_ONO = Interior(300.0, pixel_mm=0.005, width=6000, height=6000)  # the paper gives c only; pixels and format are ours
_FIELD = Interior(400.0, pixel_mm=0.0105, width=2160, height=1440)  # their section 5: Canon D30, 400 mm
_APSC = Interior(35.0, 0.12, -0.08, -3.0e-5, 4.0e-8, 0.0, 8.0e-6, -5.0e-6, 6.0e-5, -4.0e-5,
                 pixel_mm=23.5 / 6000, width=6000, height=4000)
_PLATE = 0.27  # m, half the side of the square of targets


def ono_stereo(seed: int = 0, *, image_mm: float = 0.001, noise: float = 1.0) -> Simulated:
    """Twelve points from the stations A and B of Ono & Hattori's Table 1, c = 300 mm; approximate values off by 10 mm, 2 degrees.

    The paper does not print the attitudes: the axes aim at the middle of the points. Points are tie points.
    """
    return _ono(seed, "AB", image_mm, noise)


def ono_triplet(seed: int = 0, *, image_mm: float = 0.001, noise: float = 1.0) -> Simulated:
    """As `ono_stereo`, with the third station C."""
    return _ono(seed, "ABC", image_mm, noise)


def _ono(seed: int, stations: str, image_mm: float, noise: float) -> Simulated:
    rng = np.random.default_rng([seed, len(stations)])
    truth = {s: look_at(np.array(_STATIONS[s]), _OBJECT.mean(axis=0)) for s in stations}
    given = np.round(_OBJECT + noise * rng.normal(0, 0.010, _OBJECT.shape), 4)
    name = "Ono stereo" if len(stations) == 2 else "Ono triplet"
    return _network(name, _ONO, _ONO, truth, _OBJECT, given, "tie", image_mm / 0.005, noise, (0.010, 2.0), rng)


def field_long_range(seed: int = 0, *, relief: float = 1.5, span: float = 60.0, images: int = 5, image_mm: float = 0.0026,
                     noise: float = 1.0) -> Simulated:
    """Twenty-eight targets of a bank, 4.8 m wide, from 105 m with c = 400 mm; metres, Z towards the cameras.

    relief: depth of the object [m]; span: angle between the outer ones of five stations [degrees]; images: 5, or 3 for the middle
    ones. Approximate values: object points to 0.5 m, centres 1 m, angles 0.01 rad (half a degree). Points are tie points.
    """
    rng = np.random.default_rng([seed, 5])
    x, y = np.meshgrid(np.linspace(-2.4, 2.4, 7), np.linspace(-1.4, 1.4, 4))
    z = 0.35 * y * relief + relief * (rng.uniform(size=x.shape) - 0.5)
    xyz = np.stack([x, y, z], -1).reshape(-1, 3).round(6)
    turn = np.radians(np.linspace(-span / 2, span / 2, 5))
    stations = np.stack([105 * np.sin(turn), 2 + 1.5 * np.cos(3 * turn), 105 * np.cos(turn)], -1)
    truth = {"ABCDE"[i]: look_at(stations[i], xyz.mean(axis=0)) for i in (range(5) if images == 5 else range(1, 4))}
    given = np.round(xyz * 2) / 2 if noise else xyz
    approximate = (1.0, float(np.degrees(0.01)))
    return _network("Long-range field", _FIELD, _FIELD, truth, xyz, given, "tie", image_mm / 0.0105, noise, approximate, rng)


def calibration_plate(seed: int = 0, *, camera: Interior = _APSC, image_px: float = 0.1, noise: float = 1.0,
                      distance: float | None = None, tilts: tuple[float, float] = (32.0, 22.0)) -> Simulated:
    """A plate of 36 targets, some on posts, in eight convergent images rolled by quarter turns, for self-calibration.

    camera: the true one, all ten parameters; the block only knows its nominal c and format. Targets are control to 0.1 mm.
    distance [m] to the cameras: None for as near as shows all; tilts [degrees]: of every other camera.
    """
    rng = np.random.default_rng([seed, 36])
    x, y = np.meshgrid(np.linspace(-_PLATE, _PLATE, 6), np.linspace(-_PLATE, _PLATE, 6))
    z = 0.10 * ((np.arange(36).reshape(6, 6) + np.arange(6)[:, None]) % 3 == 0)
    xyz = np.stack([x, y, z], -1).reshape(-1, 3)
    azimuth = np.radians(np.arange(8) * 45.0)
    distance = 1.1 * 2 * _PLATE * camera.c / (camera.height * camera.pitch[1]) if distance is None else distance
    tilt = np.radians(np.where(np.arange(8) % 2, tilts[1], tilts[0]))
    stations = distance * np.stack([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), np.cos(tilt)], -1)
    truth = {f"plate{i + 1}": look_at(stations[i], np.array([0, 0, 0.05]), 90.0 * (i % 4)) for i in range(8)}
    given = np.round(xyz + noise * rng.normal(0, 1e-4, xyz.shape), 6)
    nominal = Interior(camera.c, pixel_mm=camera.pixel_mm, width=camera.width, height=camera.height)
    return _network("Calibration plate", nominal, camera, truth, xyz, given, "control", image_px, noise, (0.02, 1.0), rng)


def _network(name: str, known: Interior, camera: Interior, truth: dict[str, Exterior], xyz: np.ndarray, given: np.ndarray,
             role: str, image_px: float, noise: float, prior: tuple[float, float], rng: np.random.Generator) -> Simulated:
    """A block without photo files: the `known` camera in the block, `camera` behind the pixels, priors good to (m, degrees)."""
    labels = tuple(str(i + 1) for i in range(len(xyz)))
    sigma = 1e-4 if role == "control" else np.nan
    block = Block(
        name=name, crs="local", cameras={"camera": known},
        images=tuple(Image(n, "camera", None, onboard(e, *prior, noise, rng)) for n, e in truth.items()),
        points=Points(labels, given, np.full(xyz.shape, sigma), (role,) * len(xyz)),
        observations=observe([camera] * len(truth), list(truth.values()), xyz, image_px, noise, rng),
        image_px=image_px, control_m=(1e-4, 1e-4, 1e-4),
    )
    return Simulated(block, truth, xyz, {"camera": camera})
