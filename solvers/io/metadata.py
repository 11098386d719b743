"""What a photo says of its flight: EXIF GPS and the XMP of DJI, Parrot, senseFly and Pix4D, as one value."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ..geometry import Onboard
from .exif import read_exif
from .photos import opened

RTK = {50: (0.02, 0.02, 0.03), 34: (0.5, 0.5, 1.0), 16: (3.0, 3.0, 5.0)}
"""Standard errors (east, north, up) [m] of DJI's RtkFlag fixed, float, single, where the photo states none itself."""
VENDORS = {"dji": "drone-dji", "parrot": "drone-parrot", "pix4d": "camera", "sensefly": "camera"}
"""Part of an XMP namespace that makes its tags ours, and the prefix they get here."""


def read_onboard(path: Path | str, image: str | None = None) -> Onboard:
    """Position, attitude and their stated standard errors of a photo; absent or damaged entries are None.

    image: its name, None for the file's name without ending. Raises Unsupported for a file that is no photo.
    """
    path = Path(path)
    exif, stated = read_exif(path), []
    tags, problem = _xmp(path)
    if problem:
        stated.append(problem)
    lat, lon, height = exif.lat, exif.lon, exif.alt
    datum, words = _height_datum(tags, exif.make)
    absolute = tags.get("drone-dji:AbsoluteAltitude")
    if absolute is not None and (height is None or datum == "ellipsoidal"):
        height = absolute
    if height is not None:
        stated.append(words)
    rtk_lat, rtk_lon = tags.get("drone-dji:GpsLatitude"), tags.get("drone-dji:GpsLongitude", tags.get("drone-dji:GpsLongtitude"))
    if rtk_lat and rtk_lon and abs(rtk_lat) <= 90 and abs(rtk_lon) <= 180:
        lat, lon = rtk_lat, rtk_lon  # more digits than EXIF holds
    attitude, body, mount, said = _attitude(tags, exif.make)
    sigma_m, from_m = _position_sigma(tags)
    sigma_deg, from_deg = _attitude_sigma(tags)
    stated += [s for s in (said, from_m, from_deg) if s]
    return Onboard(image or path.stem, lat, lon, height, datum, tags.get("drone-dji:RelativeAltitude"), attitude, mount, body,
                   sigma_m,
                   sigma_deg, photo_time(path), tuple(stated))


def photo_time(path: Path | str) -> float | None:
    """When a photo was taken by the camera's clock: seconds since 1970 as if it showed UTC; None where absent."""
    with opened(Path(path)) as photo:
        top = photo.getexif()
        tags = top.get_ifd(0x8769)
        text, part = tags.get(36867) or top.get(306), tags.get(37521) or tags.get(37520)
    if not isinstance(text, str):
        return None
    seconds = clock(text)
    digits = part.strip("\0 ") if isinstance(part, str) else ""
    return None if seconds is None else seconds + (float(f"0.{digits}") if digits.isdigit() else 0.0)


def clock(text: str) -> float | None:
    """Seconds of a time in words: a number as it is, else date and time (2016:07:29 07:13:49.2, ISO 8601) as such since 1970."""
    text = text.strip("\0 ")
    try:
        number = float(text)
        return number if math.isfinite(number) else None
    except ValueError:
        pass
    try:
        when = datetime.fromisoformat(re.sub(r"^(\d{4})[:/](\d\d)[:/](\d\d)", r"\1-\2-\3", text))
    except ValueError:
        return None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def _xmp(path: Path) -> tuple[dict[str, float], str]:
    """Numbers of the vendors' tags by "prefix:Name", and what is wrong with the XMP, in words."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    packet = _packet(path)
    if packet is None:
        return {}, ""
    try:
        root = fromstring(packet)
    except (ParseError, DefusedXmlException, ValueError):
        return {}, "its XMP is damaged and was not used"
    found: dict[str, float] = {}
    for name, text in _entries(root):
        space, _, tag = name[1:].partition("}")
        prefix = next((p for part, p in VENDORS.items() if part in space.lower()), None)
        number = _number(text)
        if prefix and number is not None:
            found[f"{prefix}:{tag}"] = number
    return found, ""


def _packet(path: Path) -> bytes | None:
    """The XMP of a photo."""
    with opened(path) as photo:
        packet = photo.info.get("xmp") or photo.info.get("XML:com.adobe.xmp") or dict(photo.getexif()).get(700)
    if not packet:
        return None
    data = packet if isinstance(packet, bytes) else str(packet).encode()
    return data[data.find(b"<"):].strip(b"\0 \r\n\t")


def _entries(root: Any) -> Iterable[tuple[str, str]]:
    """All attributes and all leaf elements of an XML tree with their text."""
    for element in root.iter():
        yield from ((k, v) for k, v in element.attrib.items() if k.startswith("{"))
        if isinstance(element.tag, str) and element.tag.startswith("{") and not len(element) and element.text:
            yield element.tag, element.text


def _number(text: str) -> float | None:
    """A number, also as a fraction (329087/100000)."""
    top, _, bottom = text.strip().partition("/")
    try:
        value = float(top) / (float(bottom) if bottom else 1.0)
    except (ValueError, ZeroDivisionError):
        return None
    return value if math.isfinite(value) else None


def _attitude(tags: Mapping[str, float], make: str,
              ) -> tuple[tuple[float, float, float] | None, tuple[float, float, float] | None, Any, str]:
    """Camera attitude, aircraft attitude (yaw, pitch, roll, degrees), mount, and what was done, in words."""
    def three(prefix: str, suffix: str = "Degree") -> tuple[float, float, float] | None:
        values = [tags.get(f"{prefix}{axis}{suffix}") for axis in ("Yaw", "Pitch", "Roll")]
        return None if None in values else tuple(values)  # type: ignore[return-value]

    for vendor, camera, aircraft in (("drone-dji", "Gimbal", "Flight"), ("drone-parrot", "Camera", "Drone")):
        attitude = three(f"{vendor}:{camera}")
        if attitude is not None:
            return attitude, three(f"{vendor}:{aircraft}"), "gimbal", ""
    attitude = three("camera:", "")
    if attitude is not None and "sensefly" in make.lower():
        return (attitude[0], attitude[1], -attitude[2]), None, "nadir", "senseFly: roll is positive to the left and was turned"
    return attitude, attitude, "nadir", ""


def _height_datum(tags: Mapping[str, float], make: str) -> tuple[Any, str]:
    """What the photo's height refers to, as far as vendors agree, and the same in words."""
    flag = tags.get("drone-dji:RtkFlag")
    if flag is not None and flag >= 16:
        return "ellipsoidal", "height: ellipsoidal (RTK)"
    if any(k.startswith("drone-dji:") for k in tags) or "dji" in make.lower():
        return "barometric", "height: barometric, on the standard atmosphere and uncertain by up to 100 m (no RTK)"
    return "unknown", "height: datum not stated by the photo"


def _position_sigma(tags: Mapping[str, float]) -> tuple[tuple[float, float, float] | None, str]:
    std = [tags.get(f"drone-dji:RtkStd{k}") for k in ("Lon", "Lat", "Hgt")]
    if None not in std and min(std) > 0:  # type: ignore[type-var]
        return tuple(std), "position sigma: RtkStdLon, RtkStdLat, RtkStdHgt"  # type: ignore[return-value]
    flag = tags.get("drone-dji:RtkFlag")
    if flag is not None and flag >= 16:
        state = 50 if flag == 50 else 34 if flag >= 32 else 16
        return RTK[state], f"position sigma: assumed for RtkFlag {flag:.0f}"
    across, up = tags.get("camera:GPSXYAccuracy"), tags.get("camera:GPSZAccuracy")
    if across and across > 0:
        return (across, across, up or 2 * across), "position sigma: GPSXYAccuracy, GPSZAccuracy"
    return None, ""


def _attitude_sigma(tags: Mapping[str, float]) -> tuple[tuple[float, float, float] | None, str]:
    values = [tags.get(f"camera:IMU{k}Accuracy") for k in ("Roll", "Pitch", "Yaw")]
    if None in values or min(values) <= 0:  # type: ignore[type-var]
        return None, ""
    tilt = max(values[0], values[1])  # type: ignore[type-var]
    return (tilt, tilt, values[2]), "attitude sigma: IMU...Accuracy"  # type: ignore[return-value]


def xmp_texts(path: Path | str) -> dict[str, str]:
    """All entries of a photo's XMP by their names without namespace; empty where it has none or it is damaged."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    packet = _packet(Path(path))
    if packet is None:
        return {}
    try:
        return {name.partition("}")[2]: text for name, text in _entries(fromstring(packet))}
    except (ParseError, DefusedXmlException, ValueError):
        return {}


def dewarp_data(path: Path | str) -> tuple[str | None, int | None]:
    """DJI's DewarpData and DewarpFlag of a photo as they stand in its XMP, None each where absent."""
    entries = xmp_texts(path)
    flag = entries.get("DewarpFlag", "").strip()
    return entries.get("DewarpData"), int(flag) if flag.isdigit() else None
