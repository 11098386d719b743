"""Priors put into project.toml, everything else in it left as a person wrote it."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..block import Prior
from .description import describe, read_description, to_toml
from .files import decode_utf8, read_bytes, write_text

HEADER = re.compile(r"^[ \t]*\[.*\][ \t]*(?:#.*)?$")


def write_priors(folder: Path | str, priors: Mapping[str, Prior]) -> int:
    """Put priors of images, by name, into project.toml in place of those it has; returns how many were replaced.

    Comments and order stay; a file written in another way than tables with headers is written anew. Raises BadProject.
    """
    path = Path(folder) / "project.toml"
    block, origin = read_description(path)
    replaced = sum(block.images[block.image_index(name)].prior is not None for name in priors)
    wanted = describe(replace(block, images=tuple(replace(i, prior=priors.get(i.name, i.prior)) for i in block.images)), origin)
    for name in priors:
        wanted["images"][name]["prior"] = {k: _rounded(k, v) for k, v in wanted["images"][name]["prior"].items()}
    before = decode_utf8(path, read_bytes(path, "give a project folder"))
    text = _spliced(before, {n: to_toml({"images": {n: {"prior": wanted["images"][n]["prior"]}}}) for n in priors})
    write_text(path, text if _says(text, before, priors, wanted["images"]) else to_toml(wanted))
    return replaced


def _rounded(key: str, value: Any) -> Any:
    """A number as a person would write it: 0.1 mm, 1e-7 degrees, standard errors to four digits."""
    if isinstance(value, list):
        return [float(f"{v:.4g}") for v in value]
    return round(value, 7 if key.endswith("_deg") else 4)


def _spliced(text: str, tables: Mapping[str, str]) -> str:
    """The text with the table [images.NAME.prior] of each image after its [images.NAME]."""
    out: list[str] = []
    after: str | None = None
    skip = False

    def close() -> None:
        nonlocal after
        if after is not None:
            while out and not out[-1].strip():
                out.pop()
            out.extend(["", *tables[after].strip().splitlines(), ""])
        after = None

    for line in text.splitlines():
        if HEADER.match(line):
            at = _header(line)
            skip = len(at) == 3 and at[0] == "images" and at[2] == "prior" and at[1] in tables
            if not skip:
                close()
            if len(at) == 2 and at[0] == "images" and at[1] in tables:
                after = at[1]
        if not skip:
            out.append(line)
    close()
    return "\n".join(out).rstrip() + "\n"


def _header(line: str) -> list[str]:
    """The keys of a table header, [] where it is none."""
    try:
        value = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return []
    keys: list[str] = []
    while isinstance(value, dict) and len(value) == 1:
        [(key, value)] = value.items()
        keys.append(key)
    return keys


def _says(text: str, before: str, priors: Mapping[str, Prior], images: Mapping[str, Any]) -> bool:
    """Whether a text says the new priors, and else what was said before."""
    try:
        new, old = tomllib.loads(text), tomllib.loads(before)
    except tomllib.TOMLDecodeError:
        return False
    for name in priors:
        old["images"][name]["prior"] = images[name]["prior"]
    return new == old
