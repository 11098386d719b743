"""The composing half of a mosaic: registered photos -> surface -> tiles -> GeoTIFF."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from .errors import Unsupported
from .execution import Progress
from .mosaic import Registration


@dataclass(frozen=True)
class ComposeRequest:
    """How a mosaic is composed. surface: "plane" or a DEM's file; gsd [m], None: of the photos; memory [GB], None: as needed."""

    surface: str = "plane"
    gsd: float | None = None
    resample: Literal["nearest", "bilinear", "bicubic"] = "bilinear"
    blend: Literal["none", "average", "feather", "multiband"] = "feather"
    seams: bool = False
    gain: bool = False
    memory: float | None = None
    workers: int = 1
    scheduler: str | None = None


def compose_photos(registration: Registration, photos: Mapping[str, Path], out: Path, request: ComposeRequest,
                   report: Callable[[Progress], object] | None = None) -> dict[str, Any]:
    """Compose registered photos (files by image name) into one raster file; gives width, height, bounds, seam_rms, seconds and
    what else the JSON of the command mosaic says of it."""
    raise Unsupported(f"{out}: composing {len(registration.names)} photos is not available yet")
