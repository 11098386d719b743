"""Photos by pieces: what a pane shows of a photo, as fine as it can show it; read in the background, only what is looked at."""

from __future__ import annotations

import logging
import queue
import threading
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from solvers import PhotogrammetryError

from .state import Photo

TILE = 1024
"""Side [px of the file] of the pieces of a photo that is too large to be kept whole."""
WHOLE = 30_000_000
"""px of the largest picture that is kept in one piece."""
KEPT = 400_000_000
"""Bytes of pictures kept."""

Key = tuple[Path, int, int, int]
"""A piece: file, reduction, and the tile's column and row (-1: the whole picture)."""


class Piece(NamedTuple):
    """Pixels (h, w, 3) uint8 and where they lie: left, top, right, bottom in 0..1 of the photo."""

    pixels: np.ndarray
    box: tuple[float, float, float, float]


class Pyramid:
    """Pictures of photos at full size and reduced 2, 4, 8 times. came(): called from another thread when a finer one was read."""

    def __init__(self, came: Callable[[], None]) -> None:
        self._came = came
        self._kept: OrderedDict[Key, np.ndarray] = OrderedDict()
        self._asked: set[Key] = set()
        self._todo: queue.Queue[Key | None] = queue.Queue()
        self._change = threading.Lock()
        self._thread: threading.Thread | None = None

    def look(self, photo: Photo, box: tuple[float, float, float, float], across: int) -> Piece:
        """The part of a photo that holds `box` (left, top, right, bottom, 0..1), for a pane that shows its width in `across`
        pixels: at once as fine as there is, finer ones are read meanwhile."""
        left, top, right, bottom = (float(np.clip(v, 0, 1)) for v in box)
        if right - left < 1e-9 or bottom - top < 1e-9:
            return Piece(np.zeros((1, 1, 3), np.uint8), (0, 0, 1, 1))
        wanted = (box[2] - box[0]) * photo.size[0] / max(across, 1)  # file pixels in a pixel of the pane
        if wanted * 1.3 >= photo.size[0] / photo.pane.shape[1]:
            return _cut(photo.pane, (0, 0, 1, 1), (left, top, right, bottom))
        level = max(1, 2 ** int(np.floor(np.log2(max(wanted * 1.3, 1.0)))))
        for n in (level, 2 * level, 4 * level, 8 * level):
            if photo.size[0] / n <= photo.pane.shape[1]:
                break
            piece = self._piece(photo, n, (left, top, right, bottom), ask=n == level)
            if piece is not None:
                return piece
        return _cut(photo.pane, (0, 0, 1, 1), (left, top, right, bottom))

    def close(self) -> None:
        self._todo.put(None)

    def _piece(self, photo: Photo, level: int, box: tuple[float, float, float, float], ask: bool) -> Piece | None:
        width, height = photo.size
        if width * height <= WHOLE * level * level:
            pixels = self._get((photo.path, level, -1, -1), ask)
            return None if pixels is None else _cut(pixels, (0, 0, 1, 1), box)
        side = TILE * level
        cols = range(int(box[0] * width) // side, -(-int(np.ceil(box[2] * width)) // side))
        rows = range(int(box[1] * height) // side, -(-int(np.ceil(box[3] * height)) // side))
        tiles = [[self._get((photo.path, level, c, r), ask) for c in cols] for r in rows]
        if any(t is None for line in tiles for t in line):
            return None
        pixels = np.vstack([np.hstack([t for t in line if t is not None]) for line in tiles])
        x, y = cols[0] * side, rows[0] * side
        place = (x / width, y / height, (x + pixels.shape[1] * level) / width, (y + pixels.shape[0] * level) / height)
        return _cut(pixels, place, box)

    def _get(self, key: Key, ask: bool) -> np.ndarray | None:
        with self._change:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            if not ask or key in self._asked:
                return None
            self._asked.add(key)
            if self._thread is None:
                self._thread = threading.Thread(target=self._read, name="collinea-pyramid", daemon=True)
                self._thread.start()
        self._todo.put(key)
        return None

    def _read(self) -> None:
        while (key := self._todo.get()) is not None:
            try:
                pixels = read_piece(*key)
            except (PhotogrammetryError, OSError):
                logging.getLogger("collinea").exception("%s", key[0])
                continue  # stays asked: what cannot be read is not tried again
            with self._change:
                self._kept[key] = pixels
                self._asked.discard(key)
                while len(self._kept) > 1 and sum(p.nbytes for p in self._kept.values()) > KEPT:
                    self._kept.popitem(last=False)
            if self._todo.empty():
                self._came()


def read_piece(path: Path, level: int, col: int, row: int) -> np.ndarray:
    """Pixels (h, w, 3) uint8 of a photo reduced `level` times, whole or one tile. Raises Unsupported."""
    from solvers.io.photos import photo_size, photo_window, read_photo, thumbnail

    width, height = photo_size(path)
    if col < 0:
        return read_photo(path, grey=False) if level == 1 else thumbnail(path, -(-max(width, height) // level)).pixels
    side = TILE * level
    w, h = (min(side, n - at * side) // level * level or level for n, at in ((width, col), (height, row)))
    pixels = photo_window(path, col * side, row * side, w, h)
    return pixels.reshape(h // level, level, w // level, level, 3).mean(axis=(1, 3)).astype(np.uint8) if level > 1 else pixels


def _cut(pixels: np.ndarray, place: tuple[float, ...], box: tuple[float, ...]) -> Piece:
    """The pixels of a picture lying at `place` that cover `box`, whole pixels."""
    h, w = pixels.shape[:2]
    sx, sy = (place[2] - place[0]) / w, (place[3] - place[1]) / h
    left, right = (int(np.clip(f((v - place[0]) / sx), 0, w)) for f, v in ((np.floor, box[0]), (np.ceil, box[2])))
    top, bottom = (int(np.clip(f((v - place[1]) / sy), 0, h)) for f, v in ((np.floor, box[1]), (np.ceil, box[3])))
    right, bottom = max(right, left + 1), max(bottom, top + 1)
    return Piece(
        pixels[top:bottom, left:right], (place[0] + left * sx, place[1] + top * sy, place[0] + right * sx, place[1] + bottom * sy)
    )
