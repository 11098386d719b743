"""What an oriented image covers on the ground: corners, outline, GeoJSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..block import Block
from ..cameras import Interior
from ..errors import BadProject
from ..geometry import LocalFrame
from .monoplot import Ground, trace_ray
from .oriented import Oriented, frame_of, local, vector_covariance

CORNERS = ("upper right", "upper left", "lower left", "lower right")
"""Order of the corners F1 to F4 everywhere, in the photo frame (x right, y up): counterclockwise in the photo."""


def corner_pixels(interior: Interior) -> np.ndarray:
    """(4, 2) pixels of the centres of the corner pixels, in the order of `CORNERS`."""
    right, low = interior.width - 1.0, interior.height - 1.0
    return np.array([[right, 0], [0, 0], [0, low], [right, low]])


@dataclass(frozen=True)
class Footprint:
    """Outline (k, 3) of an image on the ground, project coordinates [m], not closed, and its corners (4, 3), `CORNERS`."""

    image: str
    outline: np.ndarray
    corners: np.ndarray
    surface: str

    @property
    def area(self) -> float:
        """Area on the map [m^2]."""
        x, y = (self.outline[:, :2] - self.outline[0, :2]).T
        return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)


def footprint(block: Block, oriented: Oriented, ground: Ground, frame: LocalFrame | None = None, per_edge: int = 8) -> Footprint:
    """Outline of an image by the edges of its corner pixels' centres, `per_edge` points on each edge.

    Raises DegenerateGeometry where a part of the image shows no ground (the horizon, beyond the DEM).
    """
    interior, frame = block.camera_of(oriented.image), frame or frame_of(block, {oriented.image: oriented})
    corners = corner_pixels(interior)
    t = np.arange(per_edge)[:, None] / per_edge
    edge = np.vstack([a + t * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    at, covariance = local(oriented, frame), vector_covariance(oriented)
    xyz = np.array([trace_ray(oriented.image, interior, at, frame, (p[0], p[1]), ground, 0.0, covariance).ground for p in edge])
    return Footprint(oriented.image, xyz, xyz[::per_edge], ground.name)


def footprints_geojson(footprints: Sequence[Footprint], crs: str, properties: Sequence[dict[str, Any]] = ()) -> dict[str, Any]:
    """A FeatureCollection by RFC 7946: longitude, latitude (WGS84), outer rings counterclockwise, cut at the antimeridian.

    Raises BadProject for a crs that is on no map.
    """
    if crs == "local":
        raise BadProject("GeoJSON needs longitude and latitude, and crs \"local\" is on no map; give the project the crs of its "
                         "map")
    frame, features = LocalFrame(np.zeros(3), crs), []
    for k, f in enumerate(footprints):
        ring = frame.map_to_degrees(f.outline)[:, :2]
        ring[:, 0] = ring[0, 0] + (ring[:, 0] - ring[0, 0] + 180) % 360 - 180  # one piece, across 180 degrees if need be
        parts = [_closed(part - [360 * turn, 0]) for turn in (-1, 0, 1)
                 if len(part := _between(ring, 360 * turn - 180.0, 360 * turn + 180.0)) >= 3]
        geometry = {"type": "Polygon", "coordinates": parts[0]} if len(parts) == 1 else {"type": "MultiPolygon",
                                                                                         "coordinates": parts}
        features.append({"type": "Feature", "geometry": geometry,
                         "properties": {"image": f.image, "surface": f.surface, "area_m2": round(f.area, 2),
                                        **(properties[k] if properties else {})}})
    return {"type": "FeatureCollection", "features": features}


def _closed(ring: np.ndarray) -> list[list[list[float]]]:
    x, y = (ring - ring[0]).T
    ring = ring if x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0 else ring[::-1]
    return [[[round(float(a), 9), round(float(b), 9)] for a, b in np.vstack([ring, ring[:1]])]]


def _between(ring: np.ndarray, west: float, east: float) -> np.ndarray:
    """The part of a ring between two meridians (Sutherland & Hodgman 1974)."""
    for limit, side in ((west, 1.0), (east, -1.0)):
        out = []
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
            da, db = side * (a[0] - limit), side * (b[0] - limit)
            if da >= 0:
                out.append(a)
            if (da > 0) != (db > 0) and da != db and da * db < 0:
                out.append(a + (b - a) * da / (da - db))
        ring = np.array(out).reshape(-1, 2)
        if not len(ring):
            break
    return ring
