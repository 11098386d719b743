"""nerfstudio's transforms.json (and instant-ngp's): camera-to-object matrices, x right, y up, z back, OpenCV distortion.

applied_transform (3 x 4) and after it applied_scale, where present, were applied to the object frame once the poses were
computed, and are undone.
Principal points count from the corner. References: docs.nerf.studio, "Data conventions"; instant-ngp, "NeRF dataset tips".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...cameras.brown import Brown
from ...cameras.foreign import to_brown
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ...geometry import Exterior
from ..files import write_json
from .conventions import CameraAxes, PixelOrigin, Position, RotationDirection, exterior_as, exterior_from
from .options import NOTHING, Reading
from .scene import Camera, Exchange, Shot, labels_of, named
from .structure import Item, read_json

CONVENTION = (CameraAxes.PHOTO, RotationDirection.CAMERA_TO_OBJECT, Position.CENTRE)
CORNER = PixelOrigin.CORNER.value
KEYS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2")


def looks_like(head: str) -> bool:
    """Whether a JSON's beginning is a transforms.json."""
    return '"transform_matrix"' in head or ('"frames"' in head and ('"camera_angle_x"' in head or '"fl_x"' in head))


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """Cameras and orientations. Raises BadTable and Unsupported."""
    root = read_json(path)
    if root.maybe("camera_model") and root.get("camera_model").text() not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE"):
        raise Unsupported(f"{path}: its camera model is {root.get('camera_model').text()}; only OPENCV and PINHOLE are read")
    undo, scale = _undo(root), root.number_or("applied_scale", 1.0)
    if scale <= 0:
        raise root.get("applied_scale").error("is not positive")
    frames = root.get("frames").entries()
    cameras: dict[Camera, str] = {}
    labels, found = [], []
    for frame in frames:
        m = frame.get("transform_matrix").numbers((12, 16))[:12].reshape(3, 4)
        try:
            at = exterior_from(m[:, :3], m[:, 3], *CONVENTION)
        except BadTable as error:
            raise frame.error(f"{error}") from None
        at = Exterior(at.m @ undo[0], undo[0].T @ (at.centre / scale - undo[1]))
        camera = _camera(root, frame, options)
        labels.append(frame.get("file_path").text())
        found.append((cameras.setdefault(camera, f"camera-{len(cameras) + 1}"), at))
    if not frames:
        raise root.error("has no frames")
    shots = tuple(Shot(name, of, at, file) for (name, file), (of, at) in zip(named(labels), found, strict=True))
    return Exchange("nerfstudio transforms", path, options.crs or "local", {v: k for k, v in cameras.items()}, shots)


def _undo(root: Item) -> tuple[np.ndarray, np.ndarray]:
    said = root.maybe("applied_transform")
    if said is None:
        return np.eye(3), np.zeros(3)
    a = said.numbers((12, 16))[:12].reshape(3, 4)
    if np.abs(a[:, :3] @ a[:, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(a[:, :3]) < 0:
        raise said.error("is no rotation with a shift")
    return a[:, :3], a[:, 3]


def _camera(root: Item, frame: Item, options: Reading) -> Camera:
    def value(key: str) -> float | None:
        for place in (frame, root):
            if place.maybe(key) is not None:
                return place.get(key).number()
        return None

    v = {k: value(k) for k in KEYS}
    if v["w"] is None or v["h"] is None:
        if options.size is None:
            raise root.error("does not say the size of the photos (w, h); give --size WIDTH,HEIGHT")
        v["w"], v["h"] = options.size
    width, height = round(v["w"]), round(v["h"])
    fx, angle = v["fl_x"], value("camera_angle_x")
    if fx is None and angle is not None and 0 < angle < np.pi:
        fx = width / 2 / float(np.tan(angle / 2))
    if fx is None:
        raise root.error("has neither fl_x nor camera_angle_x")
    fy = v["fl_y"] if v["fl_y"] is not None else fx
    cx, cy = v["cx"] if v["cx"] is not None else width / 2, v["cy"] if v["cy"] is not None else height / 2
    d = {k: v[k] or 0.0 for k in ("k1", "k2", "k3", "k4", "p1", "p2")}
    try:
        return Brown(fx, fy, cx - CORNER, cy - CORNER, width=width, height=height, **d)  # type: ignore[arg-type]
    except PhotogrammetryError as error:
        raise frame.error(str(error)) from None


def write(scene: Exchange, path: Path) -> tuple[str, ...]:
    """transforms.json; several cameras are written image by image. Returns notes."""
    notes: list[str] = []
    values: dict[str, dict[str, Any]] = {}
    for name, camera in scene.cameras.items():
        b, fit = to_brown(camera, ("k1", "k2", "k3", "k4", "p1", "p2", "aspect"))
        notes += fit.told(name)
        values[name] = dict(zip(KEYS, (b.fx, b.fy, b.cx + CORNER, b.cy + CORNER, b.width, b.height, b.k1, b.k2, b.k3, b.k4, b.p1,
                                       b.p2),
                                strict=True))
    frames = []
    for shot, label in zip(scene.shots, labels_of(scene.shots), strict=True):
        if not shot.oriented or shot.exterior is None or shot.camera is None:
            continue
        r, c = exterior_as(shot.exterior, *CONVENTION)
        matrix = np.vstack([np.column_stack([r, c]), [0, 0, 0, 1]])
        frames.append({"file_path": shot.file or label, "transform_matrix": matrix,
                       **(values[shot.camera] if len(values) > 1 else {})})
    common = next(iter(values.values())) if len(values) == 1 else {}
    write_json(path, {"camera_model": "OPENCV", **common, "frames": frames})
    left = len(scene.shots) - len(frames)
    return (*notes, *((f"{left} images without an orientation are left out",) if left else ()))
