"""The project as one file: everything it needs, also photos that lie elsewhere, nothing that is derived or was not asked for."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from solvers import BadProject, Block, PhotogrammetryError
from solvers.io.description import describe, read_description, to_toml
from solvers.io.files import safe_name
from solvers.io.heights import read_heights
from solvers.io.photos import photo_path, photo_size, surface_path

LARGEST = 2**31
"""Bytes handed to a browser at most."""
SKIPPED = (".thumbnails", "__pycache__")
PACKED = frozenset({".jpg", ".jpeg", ".png", ".webp", ".zip"})
"""Endings of files that do not become smaller."""
DESCRIPTION = "project.toml"


def project_zip(folder: Path, largest: int = LARGEST) -> bytes:
    """The project as one file in memory. Raises BadProject where it is too large for that, Unsupported as `write_project_zip`."""
    if size_of(folder) > largest:
        raise BadProject(f"{folder}: the project is larger than {largest / 2**30:.0f} GB, too large for a browser; use "
                         "collinea export PROJECT --zip FILE, or copy the folder itself")  # fmt: skip
    out = io.BytesIO()
    write_project_zip(folder, out)
    return out.getvalue()


def write_project_zip(folder: Path, out: BinaryIO) -> None:
    """The project folder without what is derived (runs) and hidden. Photos and a height grid that project.toml names elsewhere,
    or through a link, come along: they are put into the folder and named so there. Other links are left out.

    Raises Unsupported where such a file is no picture.
    """
    root = folder.resolve()
    inside, described = list(_inside(root)), _described(root)
    names = {path.relative_to(root).as_posix() for path in inside}
    text, brought = (None, {}) if described is None else _gathered(root, *described, names)
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for path in inside:
            name = path.relative_to(root).as_posix()
            if text is not None and name == DESCRIPTION:
                file.writestr(f"{root.name}/{name}", text)
            else:
                _put(file, path, f"{root.name}/{name}")
        for name, path in brought.items():
            _put(file, path, f"{root.name}/{name}")


def size_of(folder: Path) -> int:
    """Bytes of all that goes into the archive, before packing."""
    root = folder.resolve()
    inside, described = list(_inside(root)), _described(root)
    brought = {} if described is None else _gathered(root, *described, {p.relative_to(root).as_posix() for p in inside})[1]
    return sum(p.stat().st_size for p in (*inside, *brought.values()))


def _put(file: zipfile.ZipFile, path: Path, name: str) -> None:
    file.write(path, name, zipfile.ZIP_STORED if path.suffix.lower() in PACKED else zipfile.ZIP_DEFLATED)


def _inside(root: Path) -> Iterator[Path]:
    for path in sorted(root.rglob("*")):
        parts = path.relative_to(root).parts
        derived = parts[0] == "runs" or any(part in SKIPPED or part.startswith(".") for part in parts)
        if not derived and path.is_file() and not path.is_symlink() and path.resolve().is_relative_to(root):
            yield path


def _described(root: Path) -> tuple[Block, str] | None:
    """What project.toml says, None where it cannot be read: then the folder goes as it is."""
    try:
        return read_description(root / DESCRIPTION)
    except PhotogrammetryError:
        return None


def _gathered(root: Path, block: Block, origin: str, names: set[str]) -> tuple[str | None, dict[str, Path]]:
    """project.toml with every file inside, None where it is so already; and what has to be brought, by its name inside."""
    brought: dict[str, Path] = {}
    images = []
    for image in block.images:
        if image.file is not None and _elsewhere(image.file, names):
            with suppress(BadProject):  # missing here too: it stays as it is named
                path = photo_path(root, block, image.name)
                photo_size(path)  # a picture, not just any file of this machine
                image = replace(image, file=_bring(path, "images", names, brought))
        images.append(image)
    surface = dict(block.surface)
    if "file" in surface and _elsewhere(str(surface["file"]), names):
        with suppress(BadProject):
            heights = surface_path(root, block)
            if heights is not None:
                read_heights(heights, 2)
                surface["file"] = _bring(heights, "", names, brought)
    if not brought:
        return None, {}
    return to_toml(describe(replace(block, images=tuple(images), surface=surface), origin)), brought


def _elsewhere(said: str, names: set[str]) -> bool:
    return PurePosixPath(said).as_posix() not in names


def _bring(path: Path, folder: str, names: set[str], brought: dict[str, Path]) -> str:
    """The name inside for a file from elsewhere, one that nothing else has."""
    for known, other in brought.items():
        if other == path:
            return known
    stem, end = safe_name(path.stem), safe_name(path.suffix.lstrip(".")).lower()
    number = 1
    while (name := f"{folder}/{stem}{'' if number == 1 else f'-{number}'}.{end}".lstrip("/")) in names | set(brought):
        number += 1
    brought[name] = path
    return name
