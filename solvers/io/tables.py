"""Comma-separated tables of a project: header by name, every cell with its line number."""

from __future__ import annotations

import csv
import difflib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import BadTable
from .files import decode_utf8, read_bytes

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
SAVE = "save the table with commas between the columns and decimal points"


@dataclass(frozen=True)
class Row:
    """One line of a table: its cells by column name, with the file and line they came from."""

    path: Path
    line: int
    cells: dict[str, str]

    def text(self, column: str) -> str:
        """The cell, not empty. Raises BadTable."""
        value = self.cells.get(column, "")
        if not value:
            raise self.error(f"{column} is empty; fill it in")
        return value

    def number(self, column: str, expected: str, lowest: float | None = None, above: float | None = None) -> float:
        """The cell as a finite number, NaN when empty or absent. Raises BadTable for text, NaN, infinity and out of range."""
        value = self.cells.get(column, "")
        if not value:
            return float("nan")
        if not NUMBER.fullmatch(value):
            comma = NUMBER.fullmatch(value.replace(",", "."))
            cure = SAVE if comma else "correct the cell or leave it empty if it is unknown"
            raise self.error(f"{column} is '{value}', expected {expected}; {cure}")
        number = float(value)
        if number in (float("inf"), -float("inf")):
            raise self.error(f"{column} is {value}, expected {expected}; correct it")
        if (lowest is not None and number < lowest) or (above is not None and number <= above):
            bound = f"at least {lowest:g}" if lowest is not None else f"more than {above:g}"
            raise self.error(f"{column} is {value}, expected {expected}, {bound}; correct it")
        return number

    def required(self, column: str, expected: str) -> float:
        """The cell as a finite number that may not be empty. Raises BadTable."""
        self.text(column)
        return self.number(column, expected)

    def error(self, message: str) -> BadTable:
        """A BadTable that names this line."""
        return BadTable(f"{self.path} line {self.line}: {message}")


def read_table(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> list[Row]:
    """Rows of a UTF-8 comma-separated table with a header line; columns in any order, others are kept in `cells`.

    Raises BadTable naming the file, the line and the cure.
    """
    header_line = ",".join((*required, *optional))
    text = decode_utf8(path, read_bytes(path, f"it starts with the line {header_line}"))
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    header: list[str] | None = None
    rows: list[Row] = []
    try:
        for cells in reader:
            cells = [c.strip() for c in cells]
            if not any(cells):
                continue
            if header is None:
                header = _header(path, reader.line_num, cells, required, header_line)
                continue
            if len(cells) > len(header) and not any(cells[len(header):]):
                cells = cells[:len(header)]
            if len(cells) != len(header):
                raise BadTable(f"{path} line {reader.line_num}: {len(cells)} cells where the header has {len(header)} columns; "
                               f"{SAVE}, and put names that hold a comma in double quotes")
            rows.append(Row(path, reader.line_num, dict(zip(header, cells, strict=True))))
    except csv.Error as error:
        where = f"{path} line {reader.line_num}"
        raise BadTable(f"{where}: this is not a comma-separated line ({error}); correct its quotes") from None
    return rows


def read_columns(path: Path, required: Sequence[str], optional: Sequence[str] = ()) -> dict[str, list[str]] | None:
    """The cells of a plain table, column by column, optional columns that are absent empty: many times faster than rows.

    None where anything is out of the ordinary: `read_table` then says what, or reads it all the same.
    """
    try:
        text = read_bytes(path, "").decode("utf-8-sig").replace("\r\n", "\n")
    except (BadTable, UnicodeDecodeError):
        return None
    text = text if text.endswith("\n") else text + "\n"
    header = [c.strip() for c in text[:text.index("\n")].split(",")]
    if any(odd in text for odd in '"\0\r') or len(set(header)) != len(header) or not set(required) <= set(header):
        return None
    data = np.frombuffer(text.encode(), np.uint8)
    commas = np.diff(np.searchsorted(np.flatnonzero(data == ord(",")), np.flatnonzero(data == ord("\n"))), prepend=0)
    if len(header) < 2 or (commas != len(header) - 1).any():
        return None
    cells = text[:-1].replace("\n", ",").split(",")[len(header):]
    out = {name: list(map(str.strip, cells[k::len(header)])) for k, name in enumerate(header)}
    return {**{name: [""] * (len(commas) - 1) for name in optional}, **out}


def numbers(cells: Sequence[str]) -> np.ndarray | None:
    """Cells as finite numbers (n,), NaN where empty; None where one of them is none."""
    if not set("".join(cells)) <= set("0123456789+-.eE"):
        return None
    try:
        out = np.array([float(c) if c else np.nan for c in cells])
    except ValueError:
        return None
    return None if np.isinf(out).any() else out


def _header(path: Path, line: int, cells: list[str], required: Sequence[str], header_line: str) -> list[str]:
    where = f"{path} line {line}"
    missing = [c for c in required if c not in cells]
    if len(cells) == 1 and any(d in cells[0] for d in ";\t"):
        raise BadTable(f"{where}: the columns are separated by {'semicolons' if ';' in cells[0] else 'tabs'}; {SAVE}")
    if missing:
        near = difflib.get_close_matches(missing[0], [c for c in cells if c], 1, 0.4)
        near += [c for c in cells if c.lower() == missing[0].lower()]
        hint = f"rename column '{near[-1]}' if that is what it holds" if near else f"the header is {header_line}"
        raise BadTable(f"{where}: column '{missing[0]}' is missing; {hint}")
    twice = [c for c in cells if c and cells.count(c) > 1]
    if twice:
        raise BadTable(f"{where}: column '{twice[0]}' is there twice; remove one")
    return cells
