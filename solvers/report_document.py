"""A report as a value: sections of words, tables and figures. HTML and PDF are two drawings of the same value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Number:
    """A number of a result, shown with so many decimals.

    key: its place in result.json as a JSON pointer ("/orientations/0/sigma/X"), None where it was computed for the report;
    value: None where there is none.
    """

    value: float | None
    decimals: int
    key: str | None = None

    def __str__(self) -> str:
        if self.value is None or self.value != self.value:
            return "–"
        text = f"{self.value:.{self.decimals}f}"
        return text[1:] if text.startswith("-") and not float(text) else text.replace("-", "−")


@dataclass(frozen=True)
class Table:
    """Rows under a header. how: one sentence on how the numbers were got. marked: rows that deserve a look."""

    header: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    how: str = ""
    marked: frozenset[int] = frozenset()

    @property
    def right(self) -> tuple[bool, ...]:
        """Columns of numbers only, which are set to the right."""
        columns = [[row[c] for row in self.rows] for c in range(len(self.header))]
        return tuple(any(isinstance(v, Number | int) for v in cells)
                     and all(isinstance(v, Number | int) or v in ("", "–") for v in cells) for cells in columns)


@dataclass(frozen=True)
class Figure:
    """A drawing as SVG, with a caption that says units and enlargements."""

    svg: str
    caption: str
    wide: bool = True


@dataclass(frozen=True)
class Words:
    """A paragraph; kind: text, warning, statement (a quoted form), or note (how something was got)."""

    text: str
    kind: str = "text"


Part = Words | Table | Figure


@dataclass(frozen=True)
class Section:
    """A heading and what stands below it."""

    title: str
    parts: Sequence[Part]


@dataclass(frozen=True)
class Document:
    """The whole report. facts: what is said on its first lines."""

    title: str
    facts: Mapping[str, str]
    sections: Sequence[Section]


@dataclass(frozen=True)
class Source:
    """The JSON of a run, read by path, so that every number in a report says where it stands."""

    result: Mapping[str, Any]

    def get(self, path: str | tuple[str, ...], default: Any = None) -> Any:
        """The value at a path ("a.b.0", or a tuple where names may hold dots); the default where it is missing."""
        at: Any = self.result
        for word in _words(path):
            if isinstance(at, Mapping) and word in at:
                at = at[word]
            elif isinstance(at, Sequence) and not isinstance(at, str) and word.isdecimal() and int(word) < len(at):
                at = at[int(word)]
            else:
                return default
        return default if at is None else at

    def number(self, path: str | tuple[str, ...], decimals: int = 3) -> Number:
        """The number at a path."""
        value = self.get(path)
        return Number(float(value) if isinstance(value, int | float) else None, decimals, pointer(path))


def pointer(path: str | tuple[str, ...]) -> str:
    """A path as JSON pointer (RFC 6901)."""
    return "".join("/" + word.replace("~", "~0").replace("/", "~1") for word in _words(path))


def _words(path: str | tuple[str, ...]) -> Sequence[str]:
    return path.split(".") if isinstance(path, str) else path
