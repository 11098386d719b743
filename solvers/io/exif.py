"""What a photo says of itself: camera, focal length, pixel pitch, position."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import Unsupported
from .photos import opened
from .sensors import known_pitch

INCH = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}
"""Millimetres of the EXIF resolution units."""


@dataclass(frozen=True)
class Exif:
    """EXIF of one photo, None where it says nothing. focal_mm: focal length; focal_35mm: its 35-mm equivalent;
    pitch_mm: pixel pitch of this file and, in pitch_source, where it comes from; lat, lon: degrees WGS84; alt: metres, datum as
    the camera has it; orientation: EXIF code (1 = upright as stored)."""

    make: str
    model: str
    focal_mm: float | None
    focal_35mm: float | None
    pitch_mm: float | None
    pitch_source: str
    width: int
    height: int
    lat: float | None
    lon: float | None
    alt: float | None
    orientation: int


def read_exif(path: Path | str) -> Exif:
    """EXIF of a photo; damaged or absent entries are None. Raises Unsupported for a file that is no photo."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns of damaged EXIF, which here only means None
        with opened(Path(path)) as photo:
            (width, height), top = photo.size, photo.getexif()
            try:
                tags, gps = dict(top.get_ifd(0x8769)), dict(top.get_ifd(0x8825))
            except (ValueError, KeyError, TypeError, SyntaxError, OSError) as error:
                raise Unsupported(f"{path}: its EXIF is damaged ({error}); save the photo again or remove its EXIF") from None
            main = dict(top)
    make, model = _text(main.get(271)), _text(main.get(272))
    focal, focal35, full = _positive(tags.get(37386)), _positive(tags.get(41989)), _positive(tags.get(40962))
    taken = max(full or 0.0, width)  # a photo made smaller afterwards keeps the width it was taken with
    pitch, source = _pitch(tags, model, focal, focal35, width, height, taken)
    lat, lon = _degrees(gps.get(2), gps.get(1), "S", 90), _degrees(gps.get(4), gps.get(3), "W", 180)
    if lat is None or lon is None or (lat == 0 and lon == 0):
        lat = lon = None
    alt = _number(gps.get(6))
    if alt is not None and gps.get(5) in (1, b"\x01", b"1"):
        alt = -abs(alt)
    orientation = main.get(274)
    return Exif(make, model, focal, focal35, pitch, source, width, height, lat, lon, alt,
                orientation if isinstance(orientation, int) else 1)


def _pitch(tags: dict[int, Any], model: str, focal: float | None, focal35: float | None, width: int, height: int,
           taken: float) -> tuple[float | None, str]:
    """Pixel pitch [mm] of the file as it is, and its source: sensor table, focal plane resolution or 35-mm equivalent."""
    known = known_pitch(model, width, height)
    if known is not None:
        return known, "sensor table"
    resolution, unit = _positive(tags.get(41486)), INCH.get(tags.get(41488, 2), 25.4)
    if resolution is not None and 2e-4 < unit / resolution < 0.1:
        return unit / resolution * taken / width, "EXIF focal plane resolution"
    if focal is not None and focal35 is not None:
        diagonal = math.hypot(36, 24) * focal / focal35
        return diagonal / math.hypot(width, height), "EXIF 35-mm equivalent"
    return None, ""


def _text(value: Any) -> str:
    return value.replace("\0", " ").strip() if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _degrees(parts: Any, reference: Any, negative: str, limit: float) -> float | None:
    if not isinstance(parts, tuple | list) or not 1 <= len(parts) <= 3:
        return None
    numbers = [_number(p) for p in parts]
    if any(n is None for n in numbers):
        return None
    value = sum(n / 60**i for i, n in enumerate(numbers) if n is not None)
    value = -value if _text(reference).upper() == negative else value
    return value if abs(value) <= limit else None
