"""The lens as a photo states it: principal point, principal distance and distortion of Pix4D's XMP."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..cameras import Interior
from ..cameras.foreign import Fit, from_pix4d, to_interior
from ..errors import PhotogrammetryError
from .exif import Exif
from .metadata import xmp_texts
from .motion import numbers


def read_lens(path: Path | str, exif: Exif) -> tuple[Interior, Fit] | None:
    """The interior orientation in a photo's XMP, and what refitting its distortion costs; None where it is absent or not to be
    believed. PerspectiveFocalLength and PrincipalPoint are mm, PerspectiveDistortion is R1, R2, R3, T1, T2 (Parrot, MicaSense).

    Reference: Pix4D, "Specifications of XMP tags".
    """
    pitch = exif.pitch_mm
    texts = xmp_texts(path)
    focal, point = numbers(texts.get("PerspectiveFocalLength", "")), numbers(texts.get("PrincipalPoint", ""))
    bent = numbers(texts.get("PerspectiveDistortion", ""))
    if pitch is None or len(focal) != 1 or texts.get("ModelType", "perspective").strip().lower() != "perspective":
        return None
    size = pitch * np.array([exif.width, exif.height])
    point = point if len(point) == 2 else size / 2
    bent = bent if len(bent) == 5 else np.zeros(5)
    whole = 0.3 * size[0] < focal[0] < 10 * size[0] and (np.abs(point / size - 0.5) < 0.1).all() and (np.abs(bent) < 5).all()
    if not whole or (exif.focal_mm is not None and not 0.7 < focal[0] / exif.focal_mm < 1.4):
        return None
    try:
        return to_interior(from_pix4d(float(focal[0]) / pitch, tuple(point / pitch), tuple(bent[:3]), tuple(bent[3:]), exif.width,
                                      exif.height, (pitch, pitch)))
    except PhotogrammetryError:
        return None
