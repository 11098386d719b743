"""Cameras that read a photo row by row and do not tell how fast: whether that matters in a flight."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from ..cameras import Interior
from ..geometry import Onboard

ROLLING = frozenset((
    "fc200", "fc300s", "fc300x", "fc300c", "fc330", "fc350", "fc220", "fc1102", "fc2103", "fc2204", "fc3170", "fc3411", "fc3582",
    "fc7203", "fc7303", "l1d20c", "anafi", "sequoia"))
"""Models as EXIF gives them (lower case, letters and digits only) that have an electronic shutter alone."""
ASSUMED_MS = 30.0
"""Readout time a judgement is made with: cameras of small aircraft take 20 to 80 ms.

Reference: Vautherin et al. 2016, "Photogrammetric accuracy and modeling of rolling shutter cameras".
"""
MATTERS = 0.5
"""Pixels of motion from which it is told."""
PAUSE = 60.0
"""Seconds between two photos of one flight line, at most."""
METRES = 111_200.0
"""Of a degree of latitude."""


def rolls(model: str) -> bool:
    """Whether a camera, its model as EXIF has it, is known to read a photo row by row."""
    return re.sub(r"[^a-z0-9]", "", model.lower()) in ROLLING


def unstated_shutters(cameras: Mapping[str, Interior], records: Mapping[str, Sequence[Onboard]]) -> list[str]:
    """A sentence for each camera of `records` that moves by more than half a pixel while it reads a photo, as far as GPS, clock
    and height above the take-off point of its photos tell."""
    said = []
    for name, photos in records.items():
        speed, height, camera = _speed(photos), _height(photos), cameras[name]
        if speed is None or height is None:
            continue
        moved = speed * ASSUMED_MS * 1e-3 * camera.c / height / float(np.mean(camera.pitch))
        if moved > MATTERS:
            said.append(f"rolling shutter: camera {name} reads a photo row by row, and its photos do not tell how fast; at "
                        f"{speed:.1f} m/s, {height:.0f} m above the take-off point, it moves by {moved:.1f} px on the ground if "
                        f"that takes {ASSUMED_MS:.0f} ms; write readout_ms, measured or from its maker, into [cameras.{name}] of "
                        "project.toml and adjust with --rolling-shutter")
    return said


def _speed(records: Sequence[Onboard]) -> float | None:
    """Median speed [m/s] from photo to photo, None where too little is known."""
    at = [(r.time, r.lat, r.lon) for r in records if r.time is not None and r.lat is not None and r.lon is not None]
    if len(at) < 2:
        return None
    t, lat, lon = np.array(sorted(at)).T
    north, east = np.diff(lat) * METRES, np.diff(lon) * METRES * np.cos(np.radians(lat[0]))
    took = np.diff(t)
    flown = (took > 0) & (took < PAUSE)
    return float(np.median(np.hypot(north, east)[flown] / took[flown])) if flown.any() else None


def _height(records: Sequence[Onboard]) -> float | None:
    """Median height [m] above the take-off point, None where no photo tells it or none is above it."""
    known = [r.relative for r in records if r.relative is not None and r.relative > 1]
    return float(np.median(known)) if known else None
