"""Tables from anywhere: encoding, delimiter, decimal sign and header are found out, or refused with the cure."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import BadTable
from .files import read_bytes
from .tables import NUMBER, Row

DELIMITERS = {";": "semicolons", "\t": "tabs", ",": "commas", " ": "blanks"}
EXPECTED = "give a table with one control point per line: name, X, Y, Z"


@dataclass(frozen=True)
class Sheet:
    """A table as found: cells by line, header (None when there is none), and how it is written."""

    path: Path
    header: tuple[str, ...] | None
    lines: tuple[tuple[int, tuple[str, ...]], ...]
    delimiter: str
    decimal_comma: bool

    @property
    def width(self) -> int:
        return len(self.lines[0][1])

    def column(self, i: int) -> list[str]:
        return [cells[i] for _, cells in self.lines]

    def rows(self, columns: dict[str, int]) -> list[Row]:
        """Rows with the mapped columns under their own names, decimal points in numbers."""
        out = []
        for line, cells in self.lines:
            out.append(Row(self.path, line, {k: self.plain(cells[i]) for k, i in columns.items()}))
        return out

    def plain(self, cell: str) -> str:
        """A cell with a decimal point, where it is a number."""
        plain = _ungrouped(cell)
        if plain != cell:
            return plain
        changed = cell.replace(",", ".")
        return changed if self.decimal_comma and NUMBER.fullmatch(changed) else cell


Tell = Callable[[str], None]
"""Shows a person how a table is read, before it is."""


def mapping_shown(columns: Mapping[str, int], header: Sequence[str] | None, first: Sequence[str], how: str = "",
                  also: Sequence[int] = ()) -> str:
    """Which column is read as what, with the first line's value, and which are not read. also: columns read without a word."""
    named = ", ".join(f"{k} = {header[i] if header else f'column {i + 1}'} ({first[i][:24]})" for k, i in columns.items()
                      if i < len(first))
    left = [header[i] if header else str(i + 1) for i in range(len(first)) 
            if i not in columns.values() and i not in also and (not header or header[i])]
    unused = f"; not read: {', '.join(left[:12])}{' ...' if len(left) > 12 else ''}" if left else ""
    return f"columns: {named}{unused}{f' ({how})' if how else ''}"


def mapped_columns(sheet: Sheet, mapping: str, fields: Sequence[str], needed: Sequence[str]) -> dict[str, int]:
    """Columns of "name=ID,X=East,...", by header or number from 1. Raises BadTable naming what is wrong and what there is."""
    columns: dict[str, int] = {}
    for part in mapping.split(","):
        field, _, name = (p.strip() for p in part.partition("="))
        if field not in fields:
            raise BadTable(f"--map {mapping}: '{field}' is not a column of a project; choose from {', '.join(fields)}")
        try:
            columns[field] = column_index(sheet, name)
        except KeyError:
            there = ", ".join(sheet.header) if sheet.header else f"the numbers 1 to {sheet.width}"
            raise BadTable(f"--map {mapping}: {sheet.path} has no column '{name}'; choose from {there}") from None
    missing = [f for f in needed if f not in columns]
    if missing:
        raise BadTable(f"--map {mapping}: {missing[0]} is missing; add {missing[0]}=COLUMN")
    return columns


def column_index(sheet: Sheet, text: str) -> int:
    """The column of a header or of a number from 1. Raises KeyError."""
    if sheet.header and text in sheet.header:
        return sheet.header.index(text)
    if text.isascii() and text.isdigit() and 1 <= int(text) <= sheet.width:
        return int(text) - 1
    raise KeyError(text)


def read_text(path: Path) -> str:
    """Text of a file in UTF-8, UTF-16 (with byte order mark) or Windows-1252. Raises BadTable when it is no text."""
    data = read_bytes(path, EXPECTED)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings: tuple[str, ...] = ("utf-16",)
    else:
        encodings = ("utf-8-sig", "cp1252")
    for encoding in encodings:
        try:
            text = data.decode(encoding)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise BadTable(f"{path}: this is not a text file in UTF-8, UTF-16 or Windows-1252; {EXPECTED}, saved as UTF-8 text")


def read_sheet(path: Path) -> Sheet:
    """A table of unknown make. Raises BadTable naming file, line and cure when its shape is unclear."""
    numbered = [(n, line) for n, line in enumerate(read_text(path).splitlines(), 1) if line.strip()]
    comments = [line.lstrip("#% ").strip() for _, line in numbered if line.lstrip().startswith(("#", "%"))]
    content = [(n, line.strip("\r")) for n, line in numbered if not line.lstrip().startswith(("#", "%"))]
    if not content:
        raise BadTable(f"{path}: there are only comments; {EXPECTED}")
    delimiter = _delimiter(path, content)
    lines = tuple((n, tuple(_split(path, n, line, delimiter))) for n, line in content)
    width = len(lines[0][1])
    for n, cells in lines:
        if len(cells) != width:
            raise BadTable(f"{path} line {n}: {len(cells)} cells where line {lines[0][0]} has {width}, separated by "
                           f"{DELIMITERS[delimiter]}; give every line the same cells")
    comma = delimiter != "," and any("," in c and NUMBER.fullmatch(c.replace(",", ".")) for _, cells in lines for c in cells)
    header = None
    if sum(_numeric(c) for c in lines[0][1]) < 2:
        header, lines = lines[0][1], lines[1:]
    elif comments:  # a header may stand in a comment
        cells = _split(path, 0, comments[-1], delimiter)
        header = tuple(cells) if len(cells) == width and not any(_numeric(c) for c in cells) else None
    if not lines:
        raise BadTable(f"{path}: there is a header and no line below it; {EXPECTED}")
    return Sheet(path, header, lines, delimiter, comma)


def _delimiter(path: Path, content: Sequence[tuple[int, str]]) -> str:
    """The sign that cuts most lines into the same number (at least 3) of cells; blanks only when no other does."""
    sample = content[:200]
    best, score = "", 0.0
    for delimiter in DELIMITERS:
        counts = [len(_split(path, n, line, delimiter)) for n, line in sample]
        common = max(set(counts), key=counts.count)
        share = counts.count(common) / len(counts)
        if common >= 3 and share > score + 1e-9:
            best, score = delimiter, share
    if not best:
        n, line = content[-1]
        raise BadTable(f"{path} line {n}: '{line.strip()[:60]}' is not cut into columns by commas, semicolons, tabs or blanks; "
                       f"{EXPECTED}")
    if best == "," and _comma_both(content):
        raise BadTable(f"{path} line {content[-1][0]}: commas are both decimal signs and column separators; save the table with "
                       "semicolons "
                       "between the columns or with decimal points")
    return best


def _comma_both(content: Sequence[tuple[int, str]]) -> bool:
    """Commas cut the header into fewer cells than the lines, and every cell of the lines is a whole number or a name."""
    counts = [line.count(",") for _, line in content]
    return len(counts) > 1 and counts[0] < min(counts[1:]) and not any("." in line for _, line in content[1:])


def _split(path: Path, line: int, text: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return text.split()
    try:
        return [c.strip() for c in next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))]
    except csv.Error as error:
        raise BadTable(f"{path} line {line}: this line cannot be cut into cells ({error}); correct it") from None


def _numeric(cell: str) -> bool:
    return NUMBER.fullmatch(_ungrouped(cell).replace(",", ".")) is not None


def _ungrouped(cell: str) -> str:
    """A number without the signs between its thousands, where these are unmistakable: 4.468.210,50 and 4,468,210.50."""
    for sign, point in ((".", ","), (",", ".")):
        if re.fullmatch(rf"[+-]?\d{{1,3}}(\{sign}\d{{3}})+\{point}\d+", cell):
            return cell.replace(sign, "").replace(point, ".")
    return cell
