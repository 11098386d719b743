"""Problems of bundle adjustment in the large: cameras with approximate orientations, points and observations in one text file.

Agarwal, Snavely, Seitz & Szeliski 2010: P = R X + t (camera looks along -z, y up), p = -P / P.z, p' = f (1 + k1 p^2 + k2 p^4) p,
pixels from the middle of the photo, y up. https://grail.cs.washington.edu/projects/bal
"""

from __future__ import annotations

import bz2
from decimal import Decimal
from pathlib import Path

import numpy as np

from ..block import Block, Image, Observations, Points, Prior
from ..cameras import Unsided
from ..errors import BadTable
from ..geometry import Exterior
from .exchange import exact
from .files import MAX_BYTES

PER_CAMERA = 9  # angle-axis, t, f, k1, k2


def read_bal(path: Path | str) -> Block:
    """The problem as a block: a forward camera for each image, approximate orientations as priors without sigma, and points.

    Pixels get the origin of the project, sigma 1 px. Files may be packed (.bz2). Raises BadTable.
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


def _words(path: Path) -> list[bytes]:
    try:
        if path.stat().st_size > 8 * MAX_BYTES:
            raise BadTable(f"{path}: the file is larger than {8 * MAX_BYTES // 2**30} GB; take a smaller problem")
        data = path.read_bytes()
        return (bz2.decompress(data) if path.suffix == ".bz2" else data).split()
    except (FileNotFoundError, IsADirectoryError, PermissionError):
        raise BadTable(f"{path}: there is no such file that may be read; give one such as problem-49-7776-pre.txt") from None
    except (OSError, EOFError):
        raise BadTable(f"{path}: it cannot be unpacked; load the file again") from None


def _numbers(path: Path, words: list[bytes]) -> np.ndarray:
    try:
        return np.array(words, float)
    except ValueError:
        raise BadTable(f"{path}: it holds something that is not a number; load the file again") from None
