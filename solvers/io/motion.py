"""How a photo was read, how fast the camera flew and how it turned meanwhile: XMP of Parrot, Pix4D and DJI."""

from __future__ import annotations

import base64
import binascii
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.rotation import exp_many, log
from .metadata import xmp_texts
from .photos import opened

LEAST, MOST = 1.0, 1000.0
"""Readout times [ms] that are believed."""
INSTANTS = 33
"""At which the turning of a photo is kept, from its first row to its last."""
AXES = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
"""Photo axes (right, up, back) of body axes (forward, right, down), the photo's top forward."""
LAG = 0.030
"""Seconds by which the last row is later than the record's end, on the record's clock. No specification states it: found from
five photos of a Parrot Sequoia (firmware 1.1.0), whose misfit it halves and whose velocities and rates it makes plausible."""


@dataclass(frozen=True)
class Motion:
    """readout_ms: from the first row to the last; velocity (3,): east, north, up [m/s]; turning (INSTANTS, 3) rad, as a `Prior`
    has it; None where the photo says nothing."""

    readout_ms: float | None = None
    velocity: np.ndarray | None = None
    turning: np.ndarray | None = None


def read_motion(path: Path | str) -> Motion:
    """Readout time and velocity of a photo; absent or damaged entries are None. Raises Unsupported for what is no photo."""
    path = Path(path)
    texts = xmp_texts(path)
    readout = _readout(path, texts)
    return Motion(readout, _velocity(texts), None if readout is None else _turning(texts, readout * 1e-3))


def _readout(path: Path, texts: dict[str, str]) -> float | None:
    """LineReadoutTime [ns] times the rows the photo was taken with."""
    line = numbers(texts.get("LineReadoutTime", ""))
    if len(line) != 1:
        return None
    with opened(path) as photo:
        rows: Any = photo.getexif().get_ifd(0x8769).get(40963)
        rows = max(int(rows) if isinstance(rows, int) else 0, photo.size[1])
    value = float(line[0]) * 1e-6 * rows
    return round(value, 3) if LEAST < value < MOST else None


def _velocity(texts: dict[str, str]) -> np.ndarray | None:
    """IMULinearVelocity (east, north, up) or DJI's FlightXSpeed, FlightYSpeed, FlightZSpeed (north, east, down)."""
    values = numbers(texts.get("IMULinearVelocity", ""))
    if len(values) == 3:
        return values
    values = np.concatenate([numbers(texts.get(f"Flight{axis}Speed", "")) for axis in "XYZ"])
    return values[[1, 0, 2]] * [1, 1, -1] if len(values) == 3 else None


def _turning(texts: dict[str, str], readout: float) -> np.ndarray | None:
    """How the camera turned while the photo was read: IMUAngularVelocity (Parrot, Pix4D) summed up.

    base64 of records of 24 bytes: microseconds (8, unsigned), rates about body axes (3 x 4, floating, rad/s), a flag (4).
    """
    try:
        raw = base64.b64decode(texts.get("IMUAngularVelocity", ""), validate=False)
    except binascii.Error:
        return None
    if len(raw) < 3 * 24 or len(raw) % 24:
        return None
    record = np.frombuffer(raw, [("t", "<u8"), ("rate", "<f4", 3), ("flag", "<u4")])
    t, rate = (record["t"] - record["t"][-1].astype(float)) * 1e-6, record["rate"].astype(float) @ AXES.T
    if not np.isfinite(rate).all() or np.abs(rate).max() > 35 or (np.diff(t) <= 0).any() or t[0] > LAG - 0.9 * readout:
        return None
    wanted = LAG - readout * np.linspace(1, 0, 8 * (INSTANTS - 1) + 1)  # the record's clock, its end is 0
    rates = np.stack([np.interp(wanted, t, rate[:, k]) for k in range(3)], 1)  # the first and last rate last beyond it
    steps = -0.5 * (rates[1:] + rates[:-1]) * np.diff(wanted)[:, None]  # a camera that turns by v sees exp(-v) M
    attitude = np.empty((len(wanted), 3, 3))
    attitude[0] = np.eye(3)
    for k, step in enumerate(exp_many(steps)):
        attitude[k + 1] = step @ attitude[k]
    kept = attitude[::8]
    return np.round(np.array([log(a @ kept[INSTANTS // 2].T) for a in kept]), 8)


def numbers(text: str) -> np.ndarray:
    """(n,) numbers between commas, none where one of them is none."""
    try:
        values = np.array([float(part) for part in text.split(",")]) if text.strip() else np.zeros(0)
    except ValueError:
        return np.zeros(0)
    return values if np.isfinite(values).all() and (np.abs(values) < 1e9).all() else np.zeros(0)
