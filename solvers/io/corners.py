"""Image corners as control, with the whole covariance of each image's four: corners.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import BadProject
from .files import decode_utf8, read_bytes, write_json

KEYS = ("image", "names", "pixels", "xyz_m", "covariance_m2")


class WrittenCorners(NamedTuple):
    """One image's corners: names (4), xyz (4, 3) m, covariance (12, 12) m^2, pixels (4, 2)."""

    image: str
    names: tuple[str, ...]
    xyz: np.ndarray
    covariance: np.ndarray
    pixels: np.ndarray


def write_corners(path: Path, crs: str, corners: Sequence[WrittenCorners]) -> None:
    """Write corners of images, with the sigmas of single coordinates for the reader's eye."""
    write_json(path, {
        "what": "image corners as weighted control; the covariance is of X, Y, Z of the four corners in their order (12 x 12): "
                "they move together with their image's orientation",
        "crs": crs,
        "images": [{"image": c.image, "names": list(c.names), "pixels": c.pixels.tolist(), "xyz_m": c.xyz.tolist(),
                    "sigma_m": np.sqrt(np.diag(c.covariance)).reshape(4, 3).tolist(),
                    "covariance_m2": c.covariance.tolist()} for c in corners]})


def read_corners(path: Path | str, crs: str) -> list[WrittenCorners]:
    """Corners as `write_corners` left them. Raises BadProject naming the file, the image and the cure."""
    path = Path(path)
    again = "write the file anew with collinea georeference PROJECT --corners FILE.json"
    try:
        said = json.loads(decode_utf8(path, read_bytes(path, again)))
    except ValueError as error:
        raise BadProject(f"{path}: this is not JSON ({error}); {again}") from None
    if not (isinstance(said, dict) and isinstance(said.get("images"), list) and said["images"]):
        raise BadProject(f"{path}: there are no images with corners in it; {again}")
    if said.get("crs") != crs:
        raise BadProject(f"{path}: its crs is '{said.get('crs')}' and the project's is '{crs}'; {again}")
    return [_image(path, k, row, again) for k, row in enumerate(said["images"])]


def _image(path: Path, k: int, row: Any, again: str) -> WrittenCorners:
    name = row.get("image") if isinstance(row, dict) else None
    where = f"{path} image '{name}'" if isinstance(name, str) else f"{path} entry {k + 1} of images"
    missing = [key for key in KEYS if not isinstance(row, dict) or key not in row]
    if missing:
        raise BadProject(f"{where}: {', '.join(missing)} missing; {again}")
    shapes = {"pixels": (4, 2), "xyz_m": (4, 3), "covariance_m2": (12, 12)}
    values = {}
    for key, shape in shapes.items():
        try:
            values[key] = np.array(row[key], float)
        except (TypeError, ValueError):
            values[key] = np.zeros(0)
        if values[key].shape != shape or not np.isfinite(values[key]).all():
            raise BadProject(f"{where}: {key} is not {shape[0]} x {shape[1]} numbers; {again}")
    cov = (values["covariance_m2"] + values["covariance_m2"].T) / 2
    if not np.linalg.eigvalsh(cov).min() > 0:
        raise BadProject(f"{where}: covariance_m2 is not positive definite; {again}")
    return WrittenCorners(str(name), tuple(map(str, row["names"])), values["xyz_m"], cov, values["pixels"])
