"""Between geocentric orientations, geographic ones and those of a map: axes at the camera, meridian convergence included."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from ..geometry import Exterior
from .crs import is_geographic


@lru_cache(maxsize=32)
def _transformer(crs: str) -> Any:
    from pyproj import CRS, Transformer

    c = CRS.from_user_input(crs)
    c = c.sub_crs_list[0] if c.is_compound else c
    return Transformer.from_crs(c.to_3d(), "EPSG:4978", always_xy=True)


def axes_at(crs: str, xyz: np.ndarray) -> np.ndarray:
    """(3, 3) rows are grid (or true) east, north and up at a place of a crs, in geocentric axes; identity for "local"."""
    if crs == "local":
        return np.eye(3)
    to, step = _transformer(crs), 1e-3 if is_geographic(crs) else 100.0  # differences over 200 m: 1e-11 rad
    x, y, z = map(float, xyz)
    at = np.array(to.transform(x, y, z))
    up = np.array(to.transform(x, y, z + 1000.0)) - at
    up /= np.linalg.norm(up)
    east = np.array(to.transform(x + step, y, z)) - np.array(to.transform(x - step, y, z))  # about the place
    east -= up * (east @ up)
    east /= np.linalg.norm(east)
    return np.stack([east, np.cross(up, east), up])


def from_geocentric(exterior: Exterior, crs: str) -> Exterior:
    """An orientation in geocentric coordinates (EPSG:4978) in a crs, its axes those of the crs at the camera."""
    centre = np.array(_transformer(crs).transform(*exterior.centre, direction="INVERSE"))
    return Exterior(exterior.m @ axes_at(crs, centre).T, centre)


def to_geocentric(exterior: Exterior, crs: str) -> Exterior:
    """The inverse of `from_geocentric`."""
    return Exterior(exterior.m @ axes_at(crs, exterior.centre), np.array(_transformer(crs).transform(*exterior.centre)))


def converted(exterior: Exterior, source: str, target: str) -> Exterior:
    """An orientation in another crs, heights kept as they are; the same direction in space."""
    from .crs import transformed

    if source == target:
        return exterior
    centre = transformed(exterior.centre[None], source, target)[0]
    return Exterior(exterior.m @ axes_at(source, exterior.centre) @ axes_at(target, centre).T, centre)
