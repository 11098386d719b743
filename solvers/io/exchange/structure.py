"""JSON, XML and lines of text, bounded, with every complaint naming file, item and cure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadTable
from ..files import read_bytes
from ..sniff import read_text

AGAIN = "export it again, or name its format with --from"




@dataclass(frozen=True)
class Item:
    """A value inside a JSON file, with the way to it."""

    path: Path
    where: str
    value: Any

    def error(self, message: str) -> BadTable:
        """A BadTable that names this item."""
        return BadTable(f"{self.path}: {self.where or 'the file'} {message}; {AGAIN}")

    def get(self, key: str) -> Item:
        """A required member."""
        found = self.maybe(key)
        if found is None:
            raise self.error(f"has no '{key}'")
        return found

    def maybe(self, key: str) -> Item | None:
        """A member, None where it is absent or null."""
        if not isinstance(self.value, dict):
            raise self.error("is not an object")
        value = self.value.get(key)
        return None if value is None else Item(self.path, f"{self.where}.{key}" if self.where else key, value)

    def members(self) -> Iterator[tuple[str, Item]]:
        """All members of an object."""
        if not isinstance(self.value, dict):
            raise self.error("is not an object")
        for key, value in self.value.items():
            yield key, Item(self.path, f"{self.where}.{key}" if self.where else key, value)

    def entries(self) -> list[Item]:
        """The members of a list."""
        if not isinstance(self.value, list):
            raise self.error("is not a list")
        return [Item(self.path, f"{self.where}[{n}]", v) for n, v in enumerate(self.value)]

    def text(self) -> str:
        """A text or a whole number, as text."""
        if isinstance(self.value, str) or (isinstance(self.value, int) and not isinstance(self.value, bool)):
            return str(self.value)
        raise self.error(f"is {_short(self.value)}, expected a text")

    def number(self) -> float:
        """A finite number."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or abs(value) > 1e300:
            raise self.error(f"is {_short(value)}, expected a number")
        return float(value)

    def integer(self, most: int = 10_000_000) -> int:
        """A whole number from 1 to most."""
        value = self.number()
        if value != round(value) or not 1 <= value <= most:
            raise self.error(f"is {_short(value)}, expected a whole number of at least 1")
        return int(value)

    def numbers(self, count: int | Sequence[int]) -> np.ndarray:
        """(count,) finite numbers; nested lists are flattened."""
        flat: list[float] = []
        todo = [self]
        while todo:
            item = todo.pop(0)
            if isinstance(item.value, list):
                todo = [*item.entries(), *todo]
            else:
                flat.append(item.number())
        counts = (count,) if isinstance(count, int) else tuple(count)
        if len(flat) not in counts:
            raise self.error(f"has {len(flat)} numbers, expected {' or '.join(map(str, counts))}")
        return np.array(flat, float)

    def number_or(self, key: str, default: float) -> float:
        """A member as a number, a default where it is absent."""
        found = self.maybe(key)
        return default if found is None else found.number()


def read_json(path: Path) -> Item:
    """A JSON file. Raises BadTable when it is missing, too large, or no JSON."""
    text = read_text(path)
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        line = getattr(error, "lineno", None)
        raise BadTable(f"{path}{f' line {line}' if line else ''}: this is not whole JSON ({' '.join(str(error).split())}); "
                       f"{AGAIN}"
                       ) from None
    return Item(path, "", value)


@dataclass(frozen=True)
class Xml:
    """An element of an XML file, with the way to it."""

    path: Path
    where: str
    element: Any

    @property
    def tag(self) -> str:
        return _local(self.element.tag)

    def error(self, message: str) -> BadTable:
        """A BadTable that names this element."""
        return BadTable(f"{self.path}: <{self.where}> {message}; {AGAIN}")

    def all(self, *tags: str) -> list[Xml]:
        """The children that a way of tags leads to, numbered where there are several."""
        level: list[Xml] = [self]
        for tag in tags:
            level = [Xml(e.path, f"{e.where}/{tag}{f'[{n + 1}]' if n else ''}", c)
                     for e in level for n, c in enumerate(c for c in e.element if _local(c.tag) == tag)]
        return level

    def maybe(self, *tags: str) -> Xml | None:
        """The first such child, or None."""
        found = self.all(*tags)
        return found[0] if found else None

    def get(self, *tags: str) -> Xml:
        """The first such child. Raises BadTable without one."""
        found = self.maybe(*tags)
        if found is None:
            raise self.error(f"has no <{'/'.join(tags)}>")
        return found

    def children(self) -> list[Xml]:
        """All children."""
        return [Xml(self.path, f"{self.where}/{_local(c.tag)}", c) for c in self.element if isinstance(c.tag, str)]

    def text(self) -> str:
        """Its text without blanks around."""
        return (self.element.text or "").strip()

    def attribute(self, name: str) -> str:
        """A required attribute."""
        value = self.element.attrib.get(name)
        if value is None or not value.strip():
            raise self.error(f"has no attribute {name}")
        return value.strip()

    def number(self, *tags: str, default: float | None = None) -> float:
        """The number in a child (or in itself without tags); a default where the child is absent."""
        at = self if not tags else self.maybe(*tags)
        if at is None:
            if default is None:
                raise self.error(f"has no <{'/'.join(tags)}>")
            return default
        return _float(at.text(), at.error)

    def attribute_number(self, name: str, default: float | None = None) -> float:
        """The number in an attribute."""
        value = self.element.attrib.get(name)
        if value is None and default is not None:
            return default
        return _float(self.attribute(name), self.error)

    def integer(self, *tags: str) -> int:
        """A whole number of at least 1 in a child."""
        value = self.number(*tags)
        if value != round(value) or not 1 <= value <= 10_000_000:
            raise self.error(f"has {'/'.join(tags)} = {value:g}, expected a whole number of at least 1")
        return int(value)

    def numbers(self, count: int | Sequence[int]) -> np.ndarray:
        """(count,) numbers of its text, separated by blanks or commas."""
        cells = self.text().replace(",", " ").split()
        counts = (count,) if isinstance(count, int) else tuple(count)
        if len(cells) not in counts:
            raise self.error(f"has {len(cells)} numbers, expected {' or '.join(map(str, counts))}")
        return np.array([_float(c, self.error) for c in cells])


def read_xml(path: Path) -> Xml:
    """The root of an XML file; entities and external references are refused. Raises BadTable."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, fromstring

    data = read_bytes(path, AGAIN)
    try:
        root = fromstring(data)
    except DefusedXmlException:
        raise BadTable(f"{path}: its XML defines entities or refers to other files, which is not read; {AGAIN}") from None
    except (ParseError, ValueError, LookupError, RecursionError) as error:
        raise BadTable(f"{path}: this is not whole XML ({' '.join(str(error).split())}); {AGAIN}") from None
    return Xml(path, _local(root.tag), root)


@dataclass(frozen=True)
class Line:
    """A line of a text file."""

    path: Path
    number: int
    cells: tuple[str, ...]

    def error(self, message: str) -> BadTable:
        """A BadTable that names this line."""
        return BadTable(f"{self.path} line {self.number}: {message}; {AGAIN}")

    def need(self, count: int, what: str) -> None:
        """Raises BadTable unless there are that many cells at least."""
        if len(self.cells) < count:
            raise self.error(f"{len(self.cells)} items, expected {what}")

    def float(self, i: int) -> float:
        """A finite number."""
        if i >= len(self.cells):
            raise self.error(f"item {i + 1} is missing")
        return _float(self.cells[i], self.error)

    def floats(self, start: int, count: int) -> np.ndarray:
        """(count,) numbers from a cell on."""
        return np.array([self.float(i) for i in range(start, start + count)])

    def decimals(self, start: int, count: int) -> list[Decimal]:
        """(count,) numbers from a cell on, with all their digits."""
        self.floats(start, count)  # says what is wrong with them
        return [Decimal(self.cells[i]) for i in range(start, start + count)]

    def int(self, i: int, lowest: int = 0) -> int:
        """A whole number."""
        value = self.float(i)
        if value != round(value) or value < lowest or abs(value) > 2**62:
            raise self.error(f"'{self.cells[i]}' is no whole number of at least {lowest}")
        return int(value)


def lines_of(path: Path, comment: str = "#") -> list[Line]:
    """Lines of blanks- or tab-separated text, without empty ones and comments."""
    return [Line(path, n, tuple(t.split())) for n, t in enumerate(read_text(path).splitlines(), 1)
            if t.strip() and not (comment and t.lstrip().startswith(comment))]


def _float(text: str, error: Any) -> float:
    try:
        value = float(text)
    except ValueError:
        raise error(f"has '{text[:40]}' where a number is expected") from None
    if not math.isfinite(value) or abs(value) > 1e300:
        raise error(f"has '{text[:40]}' where a finite number is expected")
    return value


def _local(tag: Any) -> str:
    return tag.rpartition("}")[2] if isinstance(tag, str) else ""


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
