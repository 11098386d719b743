"""Problems of bundle adjustment in the large: cameras with approximate orientations, points and observations in one text file.

Agarwal, Snavely, Seitz & Szeliski 2010: P = R X + t (camera looks along -z, y up), p = -P / P.z, p' = f (1 + k1 p^2 + k2 p^4) p,
pixels from the middle of the photo, y up. https://grail.cs.washington.edu/projects/bal
"""

from __future__ import annotations

import bz2
import gzip
import zlib
from decimal import Decimal
from pathlib import Path

import numpy as np

from ..block import Block, Image, Observations, Points, Prior
from ..cameras import Unsided
from ..errors import BadTable
from ..geometry import Exterior
from .exchange import exact
from .files import MAX_BYTES

LARGEST = 8 * MAX_BYTES
"""Bytes of the largest problem that is read, unpacked."""
PER_CAMERA = 9  # angle-axis, t, f, k1, k2


def read_bal(path: Path | str) -> Block:
    """The problem as a block: a forward camera for each image, approximate orientations as priors without sigma, and points.

    Pixels get the origin of the project, sigma 1 px. Files may be packed (bzip2, gzip). Raises BadTable.
    """
    path = Path(path)
    words = _words(path)
    numbers = _numbers(path, words)
    if len(numbers) < 3 or not np.all(numbers[:3] == np.round(numbers[:3])) or numbers[:3].min() < 1:
        raise BadTable(f"{path}: it does not begin with the numbers of cameras, points and observations; this is no problem of "
                       "bundle adjustment in the large")
    m, n, o = (int(v) for v in numbers[:3])
    expected = 3 + 4 * o + PER_CAMERA * m + 3 * n
    if len(numbers) != expected:
        raise BadTable(f"{path}: {m} cameras, {n} points and {o} observations take {expected} numbers, there are {len(numbers)}; "
                       "load the file again")
    rows = numbers[3:3 + 4 * o].reshape(o, 4)
    cameras = numbers[3 + 4 * o:3 + 4 * o + PER_CAMERA * m].reshape(m, PER_CAMERA)
    xyz = numbers[3 + 4 * o + PER_CAMERA * m:].reshape(n, 3)
    image, point = rows[:, 0].astype(int), rows[:, 1].astype(int)
    if rows[:, :2].min(initial=0) < 0 or image.max() >= m or point.max() >= n:
        raise BadTable(f"{path}: an observation names a camera or a point that there is not; load the file again")
    if not (np.isfinite(numbers).all() and (cameras[:, 6] > 0).all()):
        raise BadTable(f"{path}: a number is not finite or a focal length not positive; load the file again")
    half = np.ceil(np.abs(rows[:, 2:]).max(axis=0)) + 1
    width, height = (int(2 * h) for h in half)
    names = [f"{i:04d}" for i in range(m)]
    lenses = {name: Unsided(f, k1=k1, k2=k2, pixel_mm=1.0, width=width, height=height)
              for name, (f, k1, k2) in zip(names, cameras[:, 6:].tolist(), strict=True)}
    at = 3 + 4 * o + PER_CAMERA * np.arange(m)
    images = tuple(Image(name, name, None, _prior(row, words[k + 3:k + 6]))
                   for name, row, k in zip(names, cameras, at, strict=True))
    points = Points(tuple(f"{j:06d}" for j in range(n)), xyz, np.full((n, 3), np.nan), ("tie",) * n)
    pixel = rows[:, 2:] * [1, -1] + [(width - 1) / 2, (height - 1) / 2]
    return Block(path.stem, "local", lenses, images, points, Observations(image, point, pixel, np.ones(o)), image_px=1.0)


def _prior(row: np.ndarray, t: list[bytes]) -> Prior:
    r = exact.of_vector(row[:3])
    at = Exterior(exact.floats(r), exact.centre(r, [Decimal(w.decode()) for w in t]))
    return Prior(at.centre, np.array(at.angles))


def packed(head: bytes) -> bool:
    """Whether a file's beginning is that of bzip2 or gzip."""
    return head.startswith((b"BZh", b"\x1f\x8b"))


def unpacked_head(path: Path, size: int = 4096) -> str:
    """The beginning of a packed file as text. Raises BadTable when it cannot be unpacked."""
    return _unpacked(path, size).decode("utf-8", "replace")


def _unpacked(path: Path, most: int) -> bytes:
    """The first `most` bytes of a file, unpacked where it is packed: never more, however much it holds."""
    try:
        with open(path, "rb") as stream:
            head = stream.read(3)
        with (bz2.open(path) if head == b"BZh" else gzip.open(path) if packed(head) else open(path, "rb")) as stream:
            return stream.read(most)
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise BadTable(f"{path}: there is no such file that may be read; give one such as problem-49-7776-pre.txt") from None
    except (OSError, EOFError, zlib.error):
        raise BadTable(f"{path}: it cannot be unpacked; load the file again") from None


def _words(path: Path) -> list[bytes]:
    most = LARGEST
    try:
        most = min(LARGEST, max(2**26, 40 * path.stat().st_size))  # numbers pack to a quarter
    except OSError:
        pass
    data = _unpacked(path, most + 1)
    if len(data) > most:
        raise BadTable(f"{path}: it holds more than {most / 2**20:.0f} MB; take a smaller problem")
    return data.split()


def _numbers(path: Path, words: list[bytes]) -> np.ndarray:
    try:
        return np.array(words, float)
    except ValueError:
        raise BadTable(f"{path}: it holds something that is not a number; load the file again") from None
