"""Pyramids of very large photos for the screen: tiles of every level in one file, from which any window is read in a moment.

The tiles are JPEG of high quality: good to look at and to point in; least squares matching reads the photo itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import zipfile
from collections.abc import Generator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import Unsupported
from .photos import opened

TILE = 512
QUALITY = 93
SMALLEST = 1024
"""The coarsest level's longer side is at most this, pixels."""


def pyramid_path(photo: Path, cache: Path) -> Path:
    """Where the pyramid of a photo is kept; another name once the photo changes."""
    state = photo.stat()
    text = f"{photo.resolve()}|{state.st_size}|{state.st_mtime_ns}|{TILE}|{QUALITY}"
    return cache / f"{hashlib.sha256(os.fsencode(text)).hexdigest()[:24]}.pyramid"


def build_pyramid(photo: Path, path: Path) -> Generator[float, None, None]:
    """Write the pyramid; yields the share done. It appears under its name when it is complete. Raises Unsupported, BadProject."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with opened(photo) as source:
            try:
                source.load()
            except OSError as error:
                raise Unsupported(f"{photo}: the photo is damaged ({error}); copy it again") from None
            level: Any = source.copy() if source.mode == "RGB" else source.convert("RGB")
        total, done, sizes = 1.34 * level.width * level.height, 0.0, []
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_STORED) as out:
            while True:
                number = len(sizes)
                sizes.append(level.size)
                for top in range(0, level.height, TILE):
                    for left in range(0, level.width, TILE):
                        box = left, top, min(left + TILE, level.width), min(top + TILE, level.height)
                        data = io.BytesIO()
                        level.crop(box).save(data, "JPEG", quality=QUALITY, subsampling=0)
                        out.writestr(f"{number}/{top // TILE}/{left // TILE}", data.getvalue())
                    done += level.width * min(TILE, level.height - top)
                    yield min(done / total, 0.99)
                if max(level.size) <= SMALLEST:
                    break
                level = level.reduce(2)
            out.writestr("levels.json", json.dumps(sizes))
        os.replace(unfinished, path)
        yield 1.0
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)


def read_window(path: Path, left: float, top: float, width: float, height: float, max_side: int) -> np.ndarray:
    """A window of the photo, resampled so that its longer side has at most `max_side` pixels and none finer than the photo's own.

    left, top, width, height: in pixels of the photo from its outer corner, within it. Gives uint8 (h, w, 3).
    Raises Unsupported where the pyramid is damaged.
    """
    try:
        pyramid = _opened(path)
        scale = min(1.0, max_side / max(width, height))
        number = min(max(int(np.floor(-np.log2(scale) + 1e-9)), 0), len(pyramid.sizes) - 1)
        full, size = pyramid.sizes[0], pyramid.sizes[number]
        fx, fy = size[0] / full[0], size[1] / full[1]
        box = left * fx, top * fy, (left + width) * fx, (top + height) * fy
        x0, y0 = int(np.floor(box[0])), int(np.floor(box[1]))
        x1, y1 = min(int(np.ceil(box[2])), size[0]), min(int(np.ceil(box[3])), size[1])
        area = pyramid.area(number, x0, y0, x1, y1)
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise Unsupported(f"{path}: the pyramid is damaged ({error}); remove it, it is made anew") from None
    return resampled(area, (box[0] - x0, box[1] - y0, box[2] - x0, box[3] - y0), (width * scale, height * scale))


def resampled(area: np.ndarray, box: tuple[float, float, float, float], size: tuple[float, float]) -> np.ndarray:
    """A box (left, top, right, bottom from the outer corner, px) of a picture at another size, uint8 (h, w, 3)."""
    from PIL import Image

    limits = min(box[2], area.shape[1]), min(box[3], area.shape[0])
    target = max(round(size[0]), 1), max(round(size[1]), 1)
    picture = Image.fromarray(np.ascontiguousarray(area))
    inside = max(box[0], 0.0), max(box[1], 0.0), *limits
    magnified = target[0] > inside[2] - inside[0] or target[1] > inside[3] - inside[1]
    return np.asarray(picture.resize(target, Image.Resampling.NEAREST if magnified else Image.Resampling.BOX, box=inside))


class _Pyramid:
    def __init__(self, path: Path) -> None:
        self._file = zipfile.ZipFile(path)
        self.sizes: list[tuple[int, int]] = [tuple(s) for s in json.loads(self._file.read("levels.json"))]
        self.tile = lru_cache(maxsize=96)(self._tile)

    def _tile(self, number: int, row: int, col: int) -> np.ndarray:
        from PIL import Image

        with Image.open(io.BytesIO(self._file.read(f"{number}/{row}/{col}"))) as picture:
            return np.asarray(picture.convert("RGB"))

    def area(self, number: int, x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
        out = np.zeros((y1 - y0, x1 - x0, 3), np.uint8)
        for row in range(y0 // TILE, (y1 - 1) // TILE + 1):
            for col in range(x0 // TILE, (x1 - 1) // TILE + 1):
                tile = self.tile(number, row, col)
                a, b = max(y0, row * TILE), max(x0, col * TILE)
                c, d = min(y1, row * TILE + tile.shape[0]), min(x1, col * TILE + tile.shape[1])
                out[a - y0 : c - y0, b - x0 : d - x0] = tile[a - row * TILE : c - row * TILE, b - col * TILE : d - col * TILE]
        return out


@lru_cache(maxsize=4)
def _opened(path: Path) -> _Pyramid:
    return _Pyramid(path)
