"""How a photo was read and how fast the camera flew: XMP of Parrot, Pix4D and DJI."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .metadata import xmp_texts
from .photos import opened

LEAST, MOST = 1.0, 1000.0
"""Readout times [ms] that are believed."""


@dataclass(frozen=True)
class Motion:
    """readout_ms: from the first row to the last; velocity (3,): east, north, up [m/s]; None where the photo says nothing."""

    readout_ms: float | None = None
    velocity: np.ndarray | None = None


def read_motion(path: Path | str) -> Motion:
    """Readout time and velocity of a photo; absent or damaged entries are None. Raises Unsupported for what is no photo."""
    path = Path(path)
    texts = xmp_texts(path)
    return Motion(_readout(path, texts), _velocity(texts))


def _readout(path: Path, texts: dict[str, str]) -> float | None:
    """LineReadoutTime [ns] times the rows the photo was taken with."""
    line = _numbers(texts.get("LineReadoutTime", ""))
    if len(line) != 1:
        return None
    with opened(path) as photo:
        rows: Any = photo.getexif().get_ifd(0x8769).get(40963)
        rows = max(int(rows) if isinstance(rows, int) else 0, photo.size[1])
    value = float(line[0]) * 1e-6 * rows
    return round(value, 3) if LEAST < value < MOST else None


def _velocity(texts: dict[str, str]) -> np.ndarray | None:
    """IMULinearVelocity (east, north, up) or DJI's FlightXSpeed, FlightYSpeed, FlightZSpeed (north, east, down)."""
    values = _numbers(texts.get("IMULinearVelocity", ""))
    if len(values) == 3:
        return values
    values = np.concatenate([_numbers(texts.get(f"Flight{axis}Speed", "")) for axis in "XYZ"])
    return values[[1, 0, 2]] * [1, 1, -1] if len(values) == 3 else None


def _numbers(text: str) -> np.ndarray:
    try:
        values = np.array([float(part) for part in text.split(",")]) if text.strip() else np.zeros(0)
    except ValueError:
        return np.zeros(0)
    return values if np.isfinite(values).all() and (np.abs(values) < 1e9).all() else np.zeros(0)
