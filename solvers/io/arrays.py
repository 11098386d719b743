"""A folder of named arrays: what a long work has done so far, to go on after an interruption."""

from __future__ import annotations

import re
import zipfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .files import write_atomic


@dataclass(frozen=True)
class ArrayFolder:
    """Arrays by key, one .npz file a key; made when it is first needed, safe to delete."""

    folder: Path

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        """The arrays saved under a key; None without any, or where the file is damaged."""
        try:
            with np.load(self.folder / f"{key}.npz", allow_pickle=False) as kept:
                return {name: kept[name] for name in kept.files}
        except (FileNotFoundError, ValueError, EOFError, zipfile.BadZipFile, KeyError):
            return None

    def save(self, key: str, arrays: dict[str, np.ndarray]) -> None:
        """Keep arrays under a key; they appear whole or not at all."""
        self.folder.mkdir(parents=True, exist_ok=True)
        write_atomic(self.folder / f"{key}.npz", lambda stream: np.savez(stream, **arrays))  # type: ignore[arg-type]

    def clear(self) -> None:
        """Remove what is kept under keys of a word, a dash and 24 hexadecimal digits; the folder too when it is empty then."""
        for file in self.folder.glob("*.npz"):
            if re.fullmatch(r"[a-z]+-[0-9a-f]{24}", file.stem):
                file.unlink(missing_ok=True)
        with suppress(OSError):
            self.folder.rmdir()
