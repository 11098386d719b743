"""A folder of named arrays: what a long work has done so far, to go on after an interruption."""

from __future__ import annotations

import zipfile
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
