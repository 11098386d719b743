"""Files that a browser hands over: a plain name inside the project's folder, and content that is what the name says."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path, PurePosixPath, PureWindowsPath

from solvers import BadProject
from solvers.io.files import write_atomic

FOLDER = "maps"
"""Where maps that were handed over lie in the project's folder."""
TIFF = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
LONGEST = 80


def base_name(name: str) -> str:
    """The last part of whatever path a browser names, letters, digits, and - _ . alone; "" where nothing is left of it."""
    last = PurePosixPath(PureWindowsPath(str(name)).name).name
    return re.sub(r"[^\w.-]+", "_", last, flags=re.ASCII).lstrip(".")[-LONGEST:].lstrip(".")


def inside(folder: Path, said: str) -> Path | None:
    """The file of a project's folder that a person means; None where it leads out of it, or is no name of a file at all."""
    try:
        file, root = (folder / said).resolve(), folder.resolve()
        named = all(len(os.fsencode(part)) <= 255 for part in file.parts)
    except (ValueError, OSError):  # a character that no file's name has
        return None
    return file if named and file.is_relative_to(root) else None


def is_tiff(head: bytes) -> bool:
    """Whether a file that begins so is a TIFF, of either byte order or size."""
    return head[:4] in TIFF


def keep_map(folder: Path, name: str, content: bytes) -> str:
    """Keeps a GeoTIFF in the project; gives its path from the project's folder. One of the same name and other content stays.

    Raises BadProject for anything but a TIFF, OSError where the folder cannot be written.
    """
    base = base_name(name)
    if not base.lower().endswith((".tif", ".tiff")) or not is_tiff(content):
        raise BadProject(f"{base or 'this file'} is no TIFF; hand over a map or orthophoto as GeoTIFF (gdal_translate makes one)")
    stem, dot, end = base.rpartition(".")
    for number in range(1, 1000):
        path = folder / FOLDER / (base if number == 1 else f"{stem}-{number}{dot}{end}")
        if path.is_file() and path.read_bytes() == content:
            break
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            write_atomic(path, lambda stream: stream.write(content))
            break
    else:
        raise BadProject(f"{folder / FOLDER} holds a thousand files named {stem}; remove some")
    return f"{FOLDER}/{path.name}"


BESIDE = (".tfw", ".pgw", ".jgw", ".footprints.geojson", ".seams.geojson")
"""What is written beside a mosaic."""
OURS = b"Collinea"
HEAD = 2**20
"""Bytes of a file that are looked at."""


def in_the_way(out: Path) -> Path | None:
    """A file that a mosaic of this name would replace and that is not of an earlier mosaic; None where there is none.

    A mosaic has its footprints beside it, a GeoTIFF among them also the name of this program in it.
    """
    there = [file for file in (out, *(out.with_suffix(end) for end in BESIDE)) if os.path.lexists(file)]
    if not there:
        return None
    areas = [file for file in there if file.suffix == ".geojson"]
    foreign = next((file for file in areas if not _is_areas(file)), None)
    if foreign is not None:
        return foreign
    if not areas:
        return there[0]
    tiff = out.suffix.lower() in (".tif", ".tiff") and out in there
    return out if tiff and not _is_ours(out) else None


def _is_areas(file: Path) -> bool:
    """Whether a file holds areas of images, as they are written beside a mosaic."""
    try:
        if file.is_symlink():
            return False
        said = json.loads(file.read_bytes())
        return bool(said["features"]) and all("image" in f["properties"] for f in said["features"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return False


def _is_ours(file: Path) -> bool:
    """Whether a GeoTIFF was written by this program: its header comes first and names it."""
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError:
        return False
    return is_tiff(head) and OURS in head
