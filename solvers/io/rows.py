"""The rows of an adjustment written while it runs, thin, so that it can be watched, stopped, lost and continued from any row.

rows.json says what they are; rows.bin holds the first row in full, then records of one length: the scalars, the head of x (images
and cameras) in full, and how far every point has come since the first row in single precision (a ten-millionth of its
way). A record that was cut off is not there; whoever reads may do so while another writes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..adjustment import SCALARS, Iteration
from ..errors import BadProject, BadTable
from .files import decode_utf8, read_bytes, write_text

FORMAT = "collinea rows 1"
STOPS = ("", "step", "gradient", "cost", "max_iterations", "diverged", "stopped")
NUMBERS = len(SCALARS) + 2
"""Of a record before x: index, the scalars, the stop reason."""


class RowWriter:
    """Rows of one adjustment, appended to a folder. head: numbers at the front of x that are kept in full."""

    def __init__(self, folder: Path, manifest: Mapping[str, Any], head: int, size: int) -> None:
        self._head = head
        self._first: np.ndarray | None = None
        self._stream: BinaryIO = (folder / "rows.bin").open("wb", buffering=0)
        write_text(folder / "rows.json", json.dumps({"format": FORMAT, "head": head, "size": size, "manifest": manifest}))

    def add(self, row: Iteration) -> None:
        """Append a row; it can be read at once."""
        if self._first is None:
            self._first = np.array(row.x, float)
            self._stream.write(self._first.tobytes())
        numbers = [row.index, *(getattr(row, name) for name in SCALARS), STOPS.index(row.stop or "")]
        head = np.concatenate([np.array(numbers, float), row.x[:self._head]])
        self._stream.write(head.tobytes() + (row.x[self._head:] - self._first[self._head:]).astype(np.float32).tobytes())

    def close(self) -> None:
        self._stream.close()


class RowReader:
    """Rows that are there so far. Raises BadProject where there are none, or they are damaged."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "rows.bin"
        cure = "adjust the project again"
        try:
            said = json.loads(decode_utf8(folder / "rows.json", read_bytes(folder / "rows.json", cure)))
            self.manifest: dict[str, Any] = said["manifest"]
            self._head, self.size = int(said["head"]), int(said["size"])
            if said["format"] != FORMAT or not 0 <= self._head <= self.size:
                raise ValueError("of another version")
        except BadTable as error:
            raise BadProject(str(error)) from None
        except (ValueError, KeyError, TypeError) as error:
            raise BadProject(f"{folder / 'rows.json'}: these are no rows of an adjustment ({error}); {cure}") from None
        self._record = 8 * (NUMBERS + self._head) + 4 * (self.size - self._head)

    def __len__(self) -> int:
        try:
            return max(self._path.stat().st_size - 8 * self.size, 0) // self._record
        except FileNotFoundError:
            return 0

    def first(self) -> np.ndarray:
        """(size,) x of the first row."""
        return np.fromfile(self._path, float, self.size)

    def row(self, k: int, first: np.ndarray | None = None) -> Iteration:
        """Row k; first: x of the first row, where it is known already. Raises BadProject where there is no such row."""
        if not 0 <= k < len(self):
            raise BadProject(f"{self._path}: there is no row {k}; rows 0 to {len(self) - 1} are there")
        first = self.first() if first is None else first
        with self._path.open("rb") as stream:
            stream.seek(8 * self.size + k * self._record)
            data = stream.read(self._record)
        head = np.frombuffer(data, float, NUMBERS + self._head)
        x = first.copy()
        x[:self._head] = head[NUMBERS:]
        x[self._head:] += np.frombuffer(data, np.float32, offset=head.nbytes)
        scalars: dict[str, Any] = dict(zip(SCALARS, map(float, head[1:NUMBERS - 1]), strict=True))
        scalars["trials"] = int(scalars["trials"])
        return Iteration(index=int(head[0]), x=x, stop=STOPS[int(head[NUMBERS - 1])] or None, **scalars)

    def rows(self) -> Iterator[Iteration]:
        """All rows that are there."""
        first = self.first() if len(self) else np.zeros(0)
        for k in range(len(self)):
            yield self.row(k, first)


__all__ = ["RowReader", "RowWriter"]
