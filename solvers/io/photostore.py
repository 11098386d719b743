"""Photos decoded once into a scratch folder, from which any window is read at once: memory does not grow with their number."""

from __future__ import annotations

import contextlib
import hashlib
import json
import mmap
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import BadProject
from .photos import colours, opened, photo_rows

WHOLE = 40_000_000
"""px up to which a photo is decoded in one piece; larger ones come in strips."""
_LOCKS: dict[tuple[str, str], threading.Lock] = {}
_GUARD, _ONE = threading.Lock(), threading.Lock()


@dataclass(frozen=True)
class PhotoStore:
    """Windows of photos by name. folder: scratch, made when needed, safe to delete; limit: bytes that it may hold, the photos
    used longest ago leave first."""

    folder: Path
    files: Mapping[str, Path]
    limit: int = 8 * 2**30
    known: dict[str, tuple[Path, tuple[int, int, int]]] = field(default_factory=dict, compare=False, repr=False)
    """Scratch files that are there unless somebody made room."""

    def window(self, name: str, top: int, left: int, bottom: int, right: int) -> np.ndarray:
        """Pixels uint8 (bottom - top, right - left, 3) of a photo. Raises BadProject, Unsupported."""
        for _ in range(3):
            path, shape = self.known.get(name) or self._decoded(name)
            try:
                with open(path, "rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                    whole = np.frombuffer(data, np.uint8).reshape(shape)
                    part = whole[top:bottom, left:right].copy()
                    del whole  # before its memory goes
                    return part
            except (FileNotFoundError, ValueError):  # it has just made room for another
                self.known.pop(name, None)
        raise BadProject(f"{self.folder}: the scratch file of '{name}' disappears again and again; write to another folder")

    def _decoded(self, name: str) -> tuple[Path, tuple[int, int, int]]:
        if name not in self.files:
            raise BadProject(f"image '{name}' has no photo; add its file")
        folder = self._folder()
        raw, about = (folder / f"{_key(self.files[name])}{end}" for end in (".raw", ".json"))
        with _GUARD:
            lock = _LOCKS.setdefault((str(folder), name), threading.Lock())
        with lock:
            with contextlib.suppress(OSError, ValueError):
                shape = tuple(json.loads(about.read_text()))
                if raw.stat().st_size == int(np.prod(shape)):
                    self.known[name] = raw, (shape[0], shape[1], shape[2])
                    return self.known[name]
            self.known[name] = raw, self._decode(name, raw, about)
            return self.known[name]

    def _folder(self) -> Path:
        """The scratch folder; where it cannot be (another machine), one of this machine's own."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            return self.folder
        except OSError:
            key = hashlib.sha256(os.fsencode(str(self.folder))).hexdigest()[:16]
            own = Path(tempfile.gettempdir()) / f"collinea-{key}"
            own.mkdir(exist_ok=True)
            return own

    def _decode(self, name: str, raw: Path, about: Path) -> tuple[int, int, int]:
        with opened(self.files[name]) as photo:
            shape = photo.size[1], photo.size[0], 3
        self._make_room(raw.parent, int(np.prod(shape)))
        with _ONE:  # decoding takes the most memory: one photo at a time
            large = shape[0] * shape[1] > WHOLE
            _write(raw, photo_rows(self.files[name]) if large else iter([colours(self.files[name])]))
        _write(about, iter([np.frombuffer(json.dumps(shape).encode(), np.uint8)]))
        return shape

    def _make_room(self, folder: Path, size: int) -> None:
        there = []
        for path in folder.glob("*.raw"):
            with contextlib.suppress(OSError):
                state = path.stat()
                there.append((max(state.st_mtime_ns, state.st_atime_ns), state.st_size, path))
        held = sum(s for _, s, _ in there)
        for _, freed, path in sorted(there):
            if held + size <= self.limit:
                return
            with contextlib.suppress(OSError):  # another worker may be reading or have removed it
                path.unlink()
            held -= freed


def _write(path: Path, pieces: Iterator[np.ndarray]) -> None:
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            for piece in pieces:
                stream.write(np.ascontiguousarray(piece).data)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def _key(path: Path) -> str:
    state = path.stat()
    return hashlib.sha256(os.fsencode(f"{path.resolve()}|{state.st_size}|{state.st_mtime_ns}")).hexdigest()[:24]
