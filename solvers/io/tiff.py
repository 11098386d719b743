"""The few parts of TIFF that a mosaic needs: tags read from and written to a file, classic or BigTIFF, little-endian."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

ASCII, SHORT, LONG, DOUBLE, LONG8 = 2, 3, 4, 12, 16
_FORMAT = {1: "B", ASCII: "s", SHORT: "H", LONG: "I", DOUBLE: "d", LONG8: "Q", 7: "s"}
SUBFILE, WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC, SAMPLES, PLANAR, SOFTWARE, PREDICTOR, TILE_WIDTH, TILE_HEIGHT, OFFSETS, \
    COUNTS, EXTRA, SAMPLE_FORMAT = 254, 256, 257, 258, 259, 262, 277, 284, 305, 317, 322, 323, 324, 325, 338, 339
GEO = (33550, 33922, 34264, 34735, 34736, 34737)
"""Pixel scale, tie point, transformation, and the three tags of GeoKeys."""
NODATA, JPEG_TABLES, SUBSAMPLING = 42113, 347, 530


class Tag(NamedTuple):
    """Type and values of a tag: numbers, or bytes (ASCII)."""

    kind: int
    values: tuple[float, ...] | bytes


def read_tags(data: memoryview | bytes) -> dict[int, Tag]:
    """Tags of the first directory of a classic little-endian TIFF in memory."""
    assert bytes(data[:4]) == b"II*\0"
    at = struct.unpack_from("<I", data, 4)[0]
    tags = {}
    for k in range(struct.unpack_from("<H", data, at)[0]):
        number, kind, count = struct.unpack_from("<HHI", data, at + 2 + 12 * k)
        letter = _FORMAT.get(kind)
        if letter is None:
            continue
        size = struct.calcsize(letter) * count
        place = at + 2 + 12 * k + 8
        where = place if size <= 4 else struct.unpack_from("<I", data, place)[0]
        raw = bytes(data[where:where + size])
        tags[number] = Tag(kind, raw if letter == "s" else struct.unpack(f"<{count}{letter}", raw))
    return tags


def directories(all_tags: Sequence[Mapping[int, Tag]], big: bool) -> tuple[bytes, list[dict[int, int]]]:
    """Header and directories of a TIFF, and for each directory where in them the values of each tag lie, to be filled in later.

    All tags with more than one value lie apart from the entries, in the order of the directories.
    """
    head = struct.pack("<2sHHHQ", b"II", 43, 8, 0, 16) if big else struct.pack("<2sHI", b"II", 42, 8)
    entry, room = (20, 8) if big else (12, 4)
    out, places = bytearray(head), []
    for k, tags in enumerate(all_tags):
        numbers = sorted(tags)
        start = len(out)
        after = start + (8 if big else 2) + entry * len(numbers) + (8 if big else 4)
        block, extra, place = bytearray(struct.pack("<Q" if big else "<H", len(numbers))), bytearray(), {}
        for number in numbers:
            kind, values = tags[number]
            raw = values if isinstance(values, bytes) else struct.pack(f"<{len(values)}{_FORMAT[kind]}", *values)
            count = len(values)
            here = start + len(block) + (12 if big else 8)
            if len(raw) <= room:
                value, place[number] = raw.ljust(room, b"\0"), here
            else:
                place[number] = after + len(extra)
                value = struct.pack("<Q" if big else "<I", place[number])
                extra += raw + b"\0" * (len(raw) % 2)
            block += struct.pack("<HHQ" if big else "<HHI", number, kind, count) + value
        last = k == len(all_tags) - 1
        block += struct.pack("<Q" if big else "<I", 0 if last else after + len(extra))
        out += block + extra
        places.append(place)
    return bytes(out), places


def packed(kind: int, values: Sequence[int]) -> bytes:
    """Values as they stand in a file."""
    return struct.pack(f"<{len(values)}{_FORMAT[kind]}", *values)
