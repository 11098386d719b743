"""The walk of a mosaic: photos -> tie points -> registration -> composition."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

from .errors import Unsupported
from .execution import Progress
from .mosaic import Registration
from .mosaic.registration import Level, Method
from .workflows_compose import ComposeRequest, compose_photos


@dataclass(frozen=True)
class MosaicRequest:
    """How a mosaic is made. kind None: the best that the data allow; crs: of a folder of photos, None: their UTM zone."""

    kind: Level | None = None
    register: Method = "simultaneous"
    allow_partial: bool = False
    crs: str | None = None
    compose: ComposeRequest = field(default_factory=ComposeRequest)


class Mosaicked(NamedTuple):
    """A mosaic on disk: its registration and what composing said."""

    registration: Registration
    composed: dict[str, Any]
    complete: bool

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command mosaic."""
        r = self.registration
        images = [{"name": n, "used": True, "why": ""} for n in r.names]
        images += [{"name": n, "used": False, "why": w} for n, w in r.unused.items()]
        return {**self.composed, "images": images, "rms_px": r.rms_px, "kind": r.level, "register": r.method,
                "warnings": list(r.warnings)}


def mosaic_of(source: Path | str, out: Path | str, request: MosaicRequest | None = None,
              report: Callable[[Progress], object] | None = None) -> Mosaicked:
    """Register the photos of a project or folder and compose them into one raster. Raises PhotogrammetryError."""
    request = request or MosaicRequest()
    registration, photos = registered(Path(source), request, report)
    composed = compose_photos(registration, photos, Path(out), request.compose, report)
    return Mosaicked(registration, composed, not registration.unused)


def registered(source: Path, request: MosaicRequest, report: Callable[[Progress], object] | None = None,
               ) -> tuple[Registration, dict[str, Path]]:
    """The registration of the photos of a project or folder, and their files by image name."""
    raise Unsupported(f"{source}: registration is not available yet")


def rectify_photo(project: Path | str, image: str, out: Path | str, plane: float | Literal["fitted"] | None = None,
                  compose: ComposeRequest | None = None) -> dict[str, Any]:
    """One photo on a plane, in true scale: the rectified and ratioed photo. Raises PhotogrammetryError."""
    raise Unsupported(f"{project}: rectification of image '{image}' is not available yet")
