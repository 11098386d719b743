"""Pix4D's calibrated_camera_parameters.txt: camera, distortion and pose of every image, relative to an offset file.

Nine records an image after an eight-line header: name width height, K (3 lines), radial (3), tangential (2), t (3), R (3 lines);
m = K [R | -R t] X, so t is the perspective centre, R turns object axes into x right, y down, z forward. The principal point
counts from the corner. Reference: Pix4D article 202558969, nFrames "Pix4D" orientation format.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...cameras.foreign import as_pix4d, from_pix4d
from ...errors import BadTable, PhotogrammetryError
from ..files import write_text
from .conventions import CameraAxes, Position, RotationDirection, exterior_as, exterior_from
from .options import NOTHING, Reading
from .scene import Camera, Exchange, Shot, labels_of, named
from .structure import AGAIN, lines_of

CONVENTION = (CameraAxes.VISION, RotationDirection.OBJECT_TO_CAMERA, Position.CENTRE)
RECORD = (3, 3, 3, 3, 3, 2, 3, 3, 3, 3)


def looks_like(head: str) -> bool:
    """Whether a text begins as this file does."""
    return "camera matrix K" in head and "camera rotation R" in head


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """Cameras and orientations; the offset is added from NAME_offset.xyz. Raises BadTable."""
    lines = [line for line in lines_of(path) if len(line.cells) > 1]
    start = next((n for n, line in enumerate(lines) if line.cells[0] == "camera" and "m" in line.cells[2:4]), -1) + 1
    lines = lines[start:]
    offset, notes = _offset(path)
    cameras: dict[Camera, str] = {}
    labels, places = [], []
    for k in range(0, len(lines), len(RECORD)):
        record = lines[k:k + len(RECORD)]
        if len(record) < len(RECORD):
            raise record[-1].error("the file ends in the middle of an image")
        for line, count in zip(record[1:], RECORD[1:], strict=True):
            if len(line.cells) != count:
                raise line.error(f"{len(line.cells)} numbers, expected {count}")
        record[0].need(3, "image name, width, height")
        matrix = np.array([line.floats(0, 3) for line in record[1:4]])
        width, height = record[0].int(-2 % len(record[0].cells), 1), record[0].int(len(record[0].cells) - 1, 1)
        name = " ".join(record[0].cells[:-2])
        try:
            camera = from_pix4d(matrix[0, 0], (matrix[0, 2], matrix[1, 2]), list(record[4].floats(0, 3)),
                                list(record[5].floats(0, 2)), width, height)
            exterior = exterior_from(np.array([line.floats(0, 3) for line in record[7:]]), record[6].floats(0, 3) + offset,
                                     *CONVENTION)
        except PhotogrammetryError as error:
            raise type(error)(f"{path} line {record[0].number}: image '{name}': {error}") from None
        labels.append(name)
        places.append((cameras.setdefault(camera, f"camera-{len(cameras) + 1}"), exterior))
    if not labels:
        raise BadTable(f"{path}: there is no image below the header; {AGAIN}")
    shots = tuple(Shot(name, of, at, file) for (name, file), (of, at) in zip(named(labels), places, strict=True))
    return Exchange("Pix4D calibrated camera parameters", path, options.crs, {v: k for k, v in cameras.items()}, shots,
                    notes=notes)


def _offset(path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    found = sorted(path.parent.glob("*offset.xyz"))
    own = [f for f in found if path.name.startswith(f.name.removesuffix("offset.xyz").rstrip("_"))]
    if not (own or len(found) == 1):
        return np.zeros(3), ("offset: there is no *_offset.xyz beside the file, the coordinates are taken as they are",)
    lines = lines_of(own[0] if own else found[0])
    return lines[0].floats(0, 3), (f"offset: {' '.join(lines[0].cells[:3])}, of {(own or found)[0].name}",)


def write(scene: Exchange, path: Path) -> tuple[str, ...]:
    """The file with one record an image, and NAME_offset.xyz beside it; returns notes."""
    notes: list[str] = []
    values: dict[str, dict[str, Any]] = {}
    for name, camera in scene.cameras.items():
        values[name], fit = as_pix4d(camera)
        notes += fit.told(name)
    shots = [s for s in scene.shots if s.oriented and s.camera in values]
    at = np.array([s.exterior.centre for s in shots if s.exterior is not None]).reshape(-1, 3)
    offset = np.round(at.mean(axis=0)) if len(at) else np.zeros(3)
    out = ["fileName imageWidth imageHeight", "camera matrix K [3x3]", "radial distortion [3x1]", "tangential distortion [2x1]",
           "camera position t [3x1]", "camera rotation R [3x3]", "camera model m = K [R|-Rt] X", ""]
    for shot, label in zip(shots, labels_of(shots), strict=True):
        assert shot.exterior is not None and shot.camera is not None
        p, camera = values[shot.camera], scene.cameras[shot.camera]
        f, (cx, cy) = p["focal_length_px"], p["principal_point_px"]
        r, centre = exterior_as(shot.exterior, *CONVENTION)
        rows = [[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0], p["radial_distortion"], p["tangential_distortion"], centre - offset,
                *r]
        out += [f"{label} {camera.width} {camera.height}", *(" ".join(repr(float(v)) for v in row) for row in rows)]
    write_text(path, "\n".join(out) + "\n")
    stem = path.stem.removesuffix("_calibrated_camera_parameters").removesuffix("calibrated_camera_parameters")
    write_text(path.parent / (f"{stem}_offset.xyz" if stem else "offset.xyz"), " ".join(repr(float(v)) for v in offset) + "\n")
    left = len(scene.shots) - len(shots)
    return (*notes, *((f"{left} images without an orientation are left out",) if left else ()))
