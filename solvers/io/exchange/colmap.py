"""COLMAP's sparse model, text and binary, with the rigs and frames that newer versions write.

cameras, images, points3D (and rigs, frames) .txt or .bin in one folder. Quaternions and translations turn object axes into
camera axes (x right, y down, z forward); pixels count from the corner. Reference: colmap.github.io/format.html
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...cameras.foreign import COLMAP_MODELS, COLMAP_OTHERS, as_colmap, from_colmap
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ..files import read_bytes, write_atomic, write_text
from . import exact
from .conventions import (
    CameraAxes,
    PixelOrigin,
    Position,
    RotationDirection,
    exterior_as,
    exterior_of,
    quaternion_as,
)
from .scene import MANY, Camera, Exchange, Shot, labels_of, named, observations_from, points_from
from .structure import AGAIN, Line, lines_of

CONVENTION = (CameraAxes.VISION, RotationDirection.OBJECT_TO_CAMERA, Position.TRANSLATION)
CORNER = PixelOrigin.CORNER.value
NONE = 2**64 - 1
"""The point number of a feature that belongs to no point."""
BY_NUMBER = {number: name for name, (number, _) in COLMAP_MODELS.items()}


@dataclass(frozen=True)
class _Image:
    number: int
    q: np.ndarray
    t: exact.Numbers
    camera: int
    name: str
    xy: np.ndarray  # (n, 2) px from the corner
    points: np.ndarray  # (n,) point numbers, -1 for none


def read(path: Path) -> Exchange:
    """A model folder (or one of its files). Raises BadTable and Unsupported."""
    folder = path if path.is_dir() else path.parent
    binary = (folder / "cameras.bin").exists() and path.suffix != ".txt"
    ending = ".bin" if binary else ".txt"
    for part in ("cameras", "images"):
        if not (folder / (part + ending)).exists():
            raise BadTable(f"{folder / (part + ending)}: there is no such file; give the folder of the whole model")
    reads: tuple[Callable[[Path], Any], ...] = (_cameras_bin, _images_bin,
                                                _points_bin) if binary else (_cameras, _images, _points)
    cameras = reads[0](folder / f"cameras{ending}")
    images = reads[1](folder / f"images{ending}")
    there = (folder / f"points3D{ending}").exists()
    points: dict[int, np.ndarray] = reads[2](folder / f"points3D{ending}") if there else {}
    return _exchange(folder, folder / f"images{ending}", cameras, images, points, _rigs_said(folder, ending))


def _exchange(folder: Path, source: Path, cameras: Mapping[int, Camera], images: list[_Image], points: Mapping[int, np.ndarray],
              notes: tuple[str, ...]) -> Exchange:
    names = named([i.name for i in images])
    index = {number: j for j, number in enumerate(points)}
    shots, rows = [], []
    for i, (image, (name, file)) in enumerate(zip(images, names, strict=True)):
        if image.camera not in cameras:
            raise BadTable(f"{source}: image '{image.name}' has camera {image.camera}, which cameras{source.suffix} lacks; "
                           f"{AGAIN}")
        try:
            exterior = exterior_of(exact.of_quaternion(image.q), image.t, CONVENTION[0])
        except BadTable as error:
            raise BadTable(f"{source}: image '{image.name}': {error}") from None
        shots.append(Shot(name, str(image.camera), exterior, file))
        for (x, y), number in zip(image.xy, image.points, strict=True):
            if int(number) in index:
                rows.append((i, index[int(number)], x - CORNER, y - CORNER, np.nan))
    return Exchange("COLMAP", folder, None, {str(k): v for k, v in cameras.items()}, tuple(shots),
                    points_from(source, [str(k) for k in points], points.values(), role="tie"), observations_from(rows), notes)


def _rigs_said(folder: Path, ending: str) -> tuple[str, ...]:
    """images.* holds every image's own pose also in models with rigs; a person is told that the rig is not kept."""
    rigs = folder / f"rigs{ending}"
    if not rigs.exists():
        return ()
    if ending == ".txt":
        shared = sum(len(line.cells) > 4 for line in lines_of(rigs))
    else:
        shared = sum(n > 1 for n in _rig_sizes(_Bytes(rigs)))
    return (f"{shared} rigs of several cameras: each image keeps its own pose, that the rig is rigid is not kept",
            ) if shared else ()


# -- text -----------------------------------------------------------------------------------------------------------------


def _cameras(path: Path) -> dict[int, Camera]:
    out: dict[int, Camera] = {}
    for line in lines_of(path):
        line.need(5, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS")
        params = line.floats(4, len(line.cells) - 4)
        out[line.int(0)] = _made(path, f"line {line.number}", line.cells[1], params, line.int(2, 1), line.int(3, 1))
    return out


def _made(path: Path, where: str, model: str, params: np.ndarray, width: int, height: int) -> Camera:
    try:
        return from_colmap(model, list(params), width, height)
    except PhotogrammetryError as error:
        raise type(error)(f"{path} {where}: {error}") from None


def _images(path: Path) -> list[_Image]:
    """Two lines an image; the second may be empty, so empty lines count."""
    from ..sniff import read_text

    lines = [Line(path, n, tuple(t.split())) for n, t in enumerate(read_text(path).splitlines(), 1)
             if not t.lstrip().startswith("#")]
    while lines and not lines[0].cells:
        lines.pop(0)
    out = []
    for k in range(0, len(lines), 2):
        line = lines[k]
        if not line.cells:
            continue
        line.need(10, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        cells = lines[k + 1] if k + 1 < len(lines) else Line(path, line.number + 1, ())
        if len(cells.cells) % 3:
            raise cells.error(f"{len(cells.cells)} items, expected X Y POINT3D_ID repeated")
        table = cells.floats(0, len(cells.cells)).reshape(-1, 3)
        out.append(_Image(line.int(0), line.floats(1, 4), line.decimals(5, 3), line.int(8), " ".join(line.cells[9:]),
                          table[:, :2], table[:, 2].astype(np.int64)))
    return out


def _points(path: Path) -> dict[int, np.ndarray]:
    out = {}
    for line in lines_of(path):
        line.need(8, "POINT3D_ID X Y Z R G B ERROR TRACK")
        out[line.int(0)] = line.floats(1, 3)
    return out


# -- binary ---------------------------------------------------------------------------------------------------------------


class _Bytes:
    """Little-endian values one after the other; running out of bytes is an error that names the file and the place."""

    def __init__(self, path: Path) -> None:
        self.path, self.data, self.at = path, read_bytes(path, AGAIN), 0

    def error(self, message: str) -> BadTable:
        return BadTable(f"{self.path} byte {self.at}: {message}; {AGAIN}")

    def take(self, form: str) -> tuple[Any, ...]:
        size = struct.calcsize("<" + form)
        if self.at + size > len(self.data):
            raise self.error("the file ends here, in the middle of an entry")
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += size
        return values

    def count(self, each: int) -> int:
        """A number of entries of at least `each` bytes, refused when the file cannot hold them."""
        [n] = self.take("Q")
        if n > MANY or n * each > len(self.data) - self.at:
            raise self.error(f"{n} entries are announced and only {len(self.data) - self.at} bytes follow")
        return int(n)

    def array(self, dtype: Any, n: int) -> np.ndarray:
        size = np.dtype(dtype).itemsize * n
        if self.at + size > len(self.data):
            raise self.error("the file ends here, in the middle of an entry")
        out = np.frombuffer(self.data, dtype, n, self.at)
        self.at += size
        return out

    def text(self) -> str:
        end = self.data.find(b"\0", self.at)
        if not 0 <= end - self.at <= 4096:
            raise self.error("no image name of at most 4096 bytes ends here")
        try:
            out = self.data[self.at:end].decode("utf-8")
        except UnicodeDecodeError:
            raise self.error("an image name is not UTF-8") from None
        self.at = end + 1
        return out

    def finite(self, values: np.ndarray) -> np.ndarray:
        if not np.isfinite(values).all() or np.abs(values).max(initial=0.0) > 1e300:
            raise self.error("a number is not finite")
        return values


def _cameras_bin(path: Path) -> dict[int, Camera]:
    data, out = _Bytes(path), {}
    for _ in range(data.count(24)):
        number, model, width, height = data.take("iiQQ")
        if model not in BY_NUMBER:
            name, _ = COLMAP_OTHERS.get(model, (f"number {model}", 0))
            raise Unsupported(f"{path}: camera {number}: the camera model {name} is not one of {', '.join(COLMAP_MODELS)}; "
                              f"undistort "
                              "the photos in COLMAP (image_undistorter) and take the model it writes")
        params = data.finite(data.array("<f8", len(COLMAP_MODELS[BY_NUMBER[model]][1])))
        out[number] = _made(path, f"camera {number}", BY_NUMBER[model], params, int(width), int(height))
    return out


def _images_bin(path: Path) -> list[_Image]:
    data, out = _Bytes(path), []
    for _ in range(data.count(73)):
        [number] = data.take("i")
        pose = data.finite(np.array(data.take("7d")))
        [camera] = data.take("i")
        name = data.text()
        table = data.array([("xy", "<f8", 2), ("point", "<i8")], data.count(24))
        out.append(_Image(number, pose[:4], pose[4:], camera, name, data.finite(table["xy"]), table["point"]))
    return out


def _points_bin(path: Path) -> dict[int, np.ndarray]:
    data, out = _Bytes(path), {}
    for _ in range(data.count(51)):
        number, x, y, z = data.take("Qddd")
        data.take("BBBd")
        data.array("<i4", 2 * data.count(8))
        out[int(number)] = data.finite(np.array([x, y, z]))
    return out


def _rig_sizes(data: _Bytes) -> list[int]:
    """How many sensors each rig of rigs.bin has: id, number, reference (type, id), others (type, id, has pose, q t)."""
    out = []
    for _ in range(data.count(8)):
        _, sensors = data.take("II")
        out.append(sensors)
        if sensors:
            data.take("ii")
        for _ in range(max(0, sensors - 1)):
            *_, pose = data.take("iib")
            if pose:
                data.take("7d")
    return out


# -- writing --------------------------------------------------------------------------------------------------------------


def write_txt(scene: Exchange, folder: Path) -> tuple[str, ...]:
    """cameras.txt, images.txt, points3D.txt in a folder; returns notes."""
    (cameras, images, points), notes = _parts(scene)
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "cameras.txt", "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n" + "".join(
        f"{n} {model} {w} {h} {' '.join(map(repr, params))}\n" for n, (model, w, h, params) in cameras.items()))
    text = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME, then POINTS2D[] as (X, Y, POINT3D_ID)"]
    for i in images:
        pose = " ".join([*(repr(float(v)) for v in i.q), *map(exact.text, exact.decimals(i.t))])
        text += [f"{i.number} {pose} {i.camera} {i.name}",
                 " ".join(f"{float(x)!r} {float(y)!r} {p}" for (x, y), p in zip(i.xy, i.points, strict=True))]
    write_text(folder / "images.txt", "\n".join(text) + "\n")
    write_text(folder / "points3D.txt", "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n" + "".join(
        f"{n} {' '.join(repr(float(v)) for v in xyz)} 128 128 128 0.0{''.join(f' {a} {b}' for a, b in track)}\n"
        for n, (xyz, track) in points.items()))
    return notes


def write_bin(scene: Exchange, folder: Path) -> tuple[str, ...]:
    """cameras.bin, images.bin, points3D.bin in a folder; returns notes."""
    (cameras, images, points), notes = _parts(scene, binary=True)
    folder.mkdir(parents=True, exist_ok=True)
    out = [struct.pack("<Q", len(cameras))]
    for n, (model, w, h, params) in cameras.items():
        out.append(struct.pack(f"<iiQQ{len(params)}d", n, COLMAP_MODELS[model][0], w, h, *params))
    _dump(folder / "cameras.bin", out)
    out = [struct.pack("<Q", len(images))]
    for i in images:
        out.append(struct.pack("<i7di", i.number, *i.q, *i.t, i.camera) + i.name.encode() + b"\0" + struct.pack("<Q", len(i.xy)))
        out += [struct.pack("<ddq", x, y, p) for (x, y), p in zip(i.xy, i.points, strict=True)]
    _dump(folder / "images.bin", out)
    out = [struct.pack("<Q", len(points))]
    for n, (xyz, track) in points.items():
        out.append(struct.pack("<QdddBBBdQ", n, *xyz, 128, 128, 128, 0.0, len(track)))
        out += [struct.pack("<ii", *t) for t in track]
    _dump(folder / "points3D.bin", out)
    return notes


def _dump(path: Path, parts: list[bytes]) -> None:
    write_atomic(path, lambda stream: stream.write(b"".join(parts)))


def _parts(scene: Exchange, binary: bool = False) -> tuple[tuple[dict[int, tuple[str, int, int, list[float]]], list[_Image],
                                           dict[int, tuple[np.ndarray, list[tuple[int, int]]]]], tuple[str, ...]]:
    """Cameras, images and points with their numbers. Image names with blanks are refused, COLMAP cannot read them back."""
    notes: list[str] = []
    numbers, cameras = {}, {}
    for n, (name, camera) in enumerate(scene.cameras.items(), 1):
        model, params, fit = as_colmap(camera)
        notes += fit.told(name)
        numbers[name], cameras[n] = n, (model, camera.width, camera.height, params)
    known = np.flatnonzero(np.isfinite(scene.points.xyz).all(axis=1))
    number = {int(j): k + 1 for k, j in enumerate(known)}
    points: dict[int, tuple[np.ndarray, list[tuple[int, int]]]] = {k: (scene.points.xyz[j], []) for j, k in number.items()}
    images, of = [], scene.observations
    for i, (shot, label) in enumerate(zip(scene.shots, labels_of(scene.shots), strict=True)):
        if not shot.oriented or shot.exterior is None or shot.camera is None:
            continue
        if not binary and any(c.isspace() for c in label):
            raise BadTable(f"image '{label}': COLMAP's text files take no blanks in names; write --to colmap-bin, or rename the "
                           "photo")
        rows = [r for r in np.flatnonzero(of.image == i) if int(of.point[r]) in number]
        ids = np.array([number[int(of.point[r])] for r in rows], np.int64)
        for k, p in enumerate(ids):
            points[int(p)][1].append((i + 1, k))
        q = quaternion_as(exterior_as(shot.exterior, CONVENTION[0], CONVENTION[1], Position.CENTRE)[0])
        q = exact.kept_quaternion(q, shot.exterior.centre) if binary else q
        t = exact.translation(exact.of_quaternion(q), shot.exterior.centre)
        images.append(_Image(i + 1, q, t, numbers[shot.camera], label, of.pixel[rows] + CORNER, ids))
    if len(images) < len(scene.shots):
        notes.append(f"{len(scene.shots) - len(images)} images without an orientation are left out")
    return (cameras, images, points), tuple(notes)
