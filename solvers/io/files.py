"""Text in and out of files: bounded reading, atomic writing."""

from __future__ import annotations

import json
import os
import re
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..errors import BadTable

MAX_BYTES = 256 * 2**20
"""Tables and descriptions larger than this are refused before they are read."""


def read_bytes(path: Path, cure: str) -> bytes:
    """The content of a file. Raises BadTable when it is missing, a folder, empty or larger than `MAX_BYTES`."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise BadTable(f"{path}: the file has {size / 2**20:.0f} MB and at most {MAX_BYTES // 2**20} MB are read; {cure}")
        data = path.read_bytes()
    except FileNotFoundError:
        raise BadTable(f"{path}: there is no such file; {cure}") from None
    except IsADirectoryError:
        raise BadTable(f"{path}: this is a folder, not a file; {cure}") from None
    except PermissionError:
        raise BadTable(f"{path}: the file may not be read; change its permissions") from None
    if not data.strip():
        raise BadTable(f"{path}: the file is empty; {cure}")
    return data


def decode_utf8(path: Path, data: bytes) -> str:
    """Text of UTF-8 bytes, byte order mark removed. Raises BadTable naming the line that is not UTF-8."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        byte = f"0x{data[error.start]:02x}"
        raise BadTable(f"{path} line {line}: the byte {byte} is not UTF-8 text; save the file as UTF-8") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise BadTable(f"{path} line {line}: the file holds zero bytes and is not UTF-8 text; save the file as UTF-8")
    return text


def write_atomic(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Let `write` fill a temporary file in the same folder, then put it at `path` in one step; on failure nothing is left."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            write(stream)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text atomically."""
    write_atomic(path, lambda stream: stream.write(text.encode("utf-8")))


def write_json(path: Path, value: Any, indent: int | None = 1) -> None:
    """Write a value as readable JSON, atomically; numbers that are not finite become null. indent: None for one line."""
    write_text(path, json.dumps(jsonable(value), indent=indent, allow_nan=False, ensure_ascii=False) + "\n")


def jsonable(value: Any) -> Any:
    """A value made of what JSON knows: arrays become lists, numbers that are not finite become None."""
    if isinstance(value, np.ndarray):
        return jsonable(value.tolist())
    if isinstance(value, np.generic):
        return jsonable(value.item())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): jsonable(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [jsonable(v) for v in value]
    if value is None or isinstance(value, str | int | bool):
        return value
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} is not JSON")


def safe_name(name: str) -> str:
    """A file name part made of letters, digits, '.', '-' and '_' only, never starting with a dot."""
    return re.sub(r"[^\w.-]+", "_", name).lstrip(".") or "_"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
