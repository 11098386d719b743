"""New project folders: never over an old one, whole or not at all."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .block import Block
from .errors import BadProject
from .io import write_project


def must_be_free(folder: Path) -> None:
    """Raises BadProject rather than overwrite a project."""
    if folder.exists() and not folder.is_dir():
        raise BadProject(f"{folder}: this is a file; choose another folder")
    for name in ("project.toml", "points.csv", "observations.csv"):
        if (folder / name).exists():
            raise BadProject(f"{folder / name}: it is already there; choose another folder or remove it")


def write_new(block: Block, folder: Path, origin: str, truth: Mapping[str, Any] | None = None) -> None:
    """Write a new project whole or not at all."""
    was_there = folder.exists()
    try:
        write_project(block, folder, truth=truth, pixel_origin=origin)
    except BaseException:
        if was_there:
            for name in ("project.toml", "points.csv", "observations.csv", "truth.json"):
                (folder / name).unlink(missing_ok=True)
        else:
            shutil.rmtree(folder, ignore_errors=True)
        raise
