"""Pixel pitch of common cameras: EXIF seldom says it, and often wrongly."""

from __future__ import annotations

import re

# model as EXIF gives it (lower case, letters and digits only) -> (pixel pitch in micrometres, width in pixels of its full photos)
# From the makers' data sheets: sensor width / photo width.
SENSORS: dict[str, tuple[float, int]] = {
    "fc300s": (1.56, 4000), "fc300x": (1.56, 4000), "fc300c": (1.56, 4000), "fc330": (1.56, 4000),
    "fc350": (1.56, 4000), "fc220": (1.57, 4000), "fc2103": (1.52, 4056), "fc7203": (1.57, 4000), "fc2204": (1.57, 4000),
    "fc6310": (2.41, 5472), "fc6310r": (2.41, 5472), "fc6310s": (2.41, 5472), "fc6360": (3.00, 1600), "fc3170": (1.60, 4000),
    "fc3411": (2.41, 5472), "fc3582": (2.40, 4032), "fc550": (3.76, 4608), "fc6510": (2.41, 5472), "fc6520": (3.28, 5280),
    "fc6540": (3.76, 6016), "l1d20c": (2.41, 5472), "l2d20c": (3.30, 5280), "m3e": (3.30, 5280), "zenmusep1": (4.40, 8192),
    "ilce5100": (3.92, 6000), "ilce6000": (3.92, 6000), "ilce6300": (3.92, 6000), "ilce6500": (3.92, 6000),
    "ilce7": (5.97, 6000), "ilce7m3": (5.93, 6000), "ilce7r": (4.90, 7360), "ilce7rm2": (4.51, 7952), "ilce7rm4": (3.76, 9504),
    "dscrx1rm2": (4.51, 7952), "dscrx1r": (5.97, 6000), "dscwx220": (1.26, 4896), "nex5": (5.10, 4592), "nex7": (3.92, 6000),
    "nikond3x": (5.95, 6048), "nikond90": (5.50, 4288), "nikond200": (6.09, 3872), "nikond300": (5.50, 4288),
    "nikond700": (8.45, 4256),
    "nikond750": (5.97, 6016), "nikond800": (4.88, 7360), "nikond800e": (4.88, 7360), "nikond810": (4.88, 7360),
    "nikond850": (4.35, 8256), "nikond3200": (3.85, 6016), "nikond5300": (3.92, 6000), "nikond7100": (3.92, 6000),
    "canoneos5d": (8.20, 4368), "canoneos5dmarkii": (6.41, 5616), "canoneos5dmarkiii": (6.25, 5760),
    "canoneos5dmarkiv": (5.36, 6720),
    "canoneos5dsr": (4.14, 8688), "canoneos6d": (6.54, 5472), "canoneos450d": (5.20, 4272), "canoneos550d": (4.30, 5184),
    "canoneos600d": (4.30, 5184), "canoneos7d": (4.30, 5184), "canonpowershotsx260hs": (1.54, 4000),
    "canonpowershots110": (1.86, 4000), "canonixus127hs": (1.34, 4608), "canonpowershotelph110hs": (1.34, 4608),
    "sequoia": (1.34, 4608), "anafi": (1.12, 5344), "rededgem": (3.75, 1280), "c4040z": (3.19, 2272),
    "dmciii": (3.90, 25728), "ixmrs150f": (3.76, 14204), "ixmrs100f": (4.60, 11608), "iphone6": (1.50, 3264),
    "iphone7": (1.22, 4032),
    "gr": (4.81, 4928), "grii": (4.81, 4928), "griii": (3.92, 6000), "dmcgh4": (3.75, 4608), "ep3": (4.29, 4032),
    "ep5": (3.75, 4608),
}


def known_pitch(model: str, width: int, height: int) -> float | None:
    """Pixel pitch in mm of a photo of a camera model, None when the model is not in the table.

    A photo with fewer pixels than the camera's full ones is taken to show the whole sensor at a lower resolution.
    """
    found = SENSORS.get(re.sub(r"[^a-z0-9]", "", model.lower()))
    return None if found is None else round(found[0] * 1e-3 * found[1] / max(width, height), 9)
