"""The local metric frame of a block: map coordinates are not Cartesian, adjustments are.

With a projected crs, points go map -> geocentric -> the tangent plane at the block origin, turned to grid north, so that
omega, phi, kappa refer to the grid axes there. With crs "local", or frame "grid", only the origin is subtracted.
Heights are taken as they come (ellipsoidal, or levelled with a constant undulation over the block).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import BadProject


@dataclass(frozen=True)
class LocalFrame:
    """Right-handed metric frame with its origin (3,) at a round map position; `crs` "local" means Cartesian already."""

    origin: np.ndarray
    crs: str = "local"

    @classmethod
    def around(cls, xyz: np.ndarray, crs: str = "local", frame: str = "tangent") -> LocalFrame:
        """The frame at the rounded centroid of known points (n, 3), NaN rows ignored."""
        known = np.asarray(xyz, float)[np.isfinite(xyz).all(axis=1)]
        origin = np.round(known.mean(axis=0)) if len(known) else np.zeros(3)
        return cls(origin, "local" if frame == "grid" else crs)

    @property
    def cartesian(self) -> bool:
        return self.crs == "local"

    @cached_property
    def _to_geocentric(self) -> Any:
        from pyproj import CRS, Transformer
        from pyproj.exceptions import CRSError

        try:
            crs = CRS.from_user_input(self.crs)
        except CRSError:
            raise BadProject(f"crs '{self.crs}' is not known; write \"local\" or an EPSG code such as \"EPSG:32632\"") from None
        if crs.is_compound:
            crs = crs.sub_crs_list[0]
        if not crs.is_projected:
            raise BadProject(f"crs '{self.crs}' is not a map projection in metres; use the UTM zone or national grid of the site")
        if any(abs(axis.unit_conversion_factor - 1) > 1e-12 for axis in crs.axis_info[:2]):
            raise BadProject(f"crs '{self.crs}' is not in metres; convert the coordinates to a metric crs first")
        return Transformer.from_crs(crs.to_3d(), "EPSG:4978", always_xy=True)

    @cached_property
    def _tangent(self) -> tuple[np.ndarray, np.ndarray]:
        """Geocentric origin (3,) and axes (3, 3): rows are grid east, grid north and up."""
        at = np.array(self._to_geocentric.transform(*self.origin))
        east, _, higher = self.origin + np.eye(3)
        up = np.array(self._to_geocentric.transform(*higher)) - at
        up /= np.linalg.norm(up)
        x = np.array(self._to_geocentric.transform(*east)) - at
        x -= up * (x @ up)
        x /= np.linalg.norm(x)
        return at, np.stack([x, np.cross(up, x), up])

    def to_local(self, xyz: np.ndarray) -> np.ndarray:
        """Local coordinates (..., 3) m of map coordinates (..., 3) m."""
        xyz = np.asarray(xyz, float)
        if self.cartesian:
            return xyz - self.origin
        at, axes = self._tangent
        return (np.stack(self._to_geocentric.transform(xyz[..., 0], xyz[..., 1], xyz[..., 2]), -1) - at) @ axes.T

    def to_map(self, local: np.ndarray) -> np.ndarray:
        """Map coordinates (..., 3) m of local coordinates (..., 3) m: the inverse of `to_local`."""
        local = np.asarray(local, float)
        if self.cartesian:
            return local + self.origin
        at, axes = self._tangent
        g = local @ axes + at
        return np.stack(self._to_geocentric.transform(g[..., 0], g[..., 1], g[..., 2], direction="INVERSE"), -1)

    @cached_property
    def _to_degrees(self) -> Any:
        from pyproj import CRS, Transformer

        _ = self._to_geocentric  # refuses what is no map projection
        crs = CRS.from_user_input(self.crs)
        return Transformer.from_crs((crs.sub_crs_list[0] if crs.is_compound else crs).to_2d(), "EPSG:4326", always_xy=True)

    def to_degrees(self, local: np.ndarray) -> np.ndarray:
        """Longitude, latitude [degrees WGS84] and height as it comes [m], (..., 3), of local coordinates (..., 3) m.

        Raises BadProject in a frame that is on no map.
        """
        return self.map_to_degrees(self.to_map(self._mapped(local)))

    def map_to_degrees(self, xyz: np.ndarray) -> np.ndarray:
        """Longitude, latitude [degrees WGS84] and height [m], (..., 3), of map coordinates (..., 3) m."""
        xyz = self._mapped(xyz)
        lon, lat = self._to_degrees.transform(xyz[..., 0], xyz[..., 1])
        return np.stack([lon, lat, xyz[..., 2]], -1)

    def from_degrees(self, degrees: np.ndarray) -> np.ndarray:
        """Local coordinates (..., 3) m of longitude, latitude [degrees WGS84] and height [m]: the inverse of `to_degrees`."""
        return self.to_local(self.map_of_degrees(degrees))

    def map_of_degrees(self, degrees: np.ndarray) -> np.ndarray:
        """Map coordinates (..., 3) m of longitude, latitude [degrees WGS84] and height [m]."""
        d = self._mapped(degrees)
        x, y = self._to_degrees.transform(d[..., 0], d[..., 1], direction="INVERSE")
        return np.stack([x, y, d[..., 2]], -1)

    def north_east_down(self, local: np.ndarray) -> np.ndarray:
        """(3, 3) unit vectors to true north, east and down at a local position (3,), as rows, in local axes.

        Grid north against true north (meridian convergence) and the curvature of the earth since the origin are in them.
        """
        lon, lat = np.radians(self.to_degrees(local)[:2])
        east, up = np.array([-np.sin(lon), np.cos(lon), 0]), np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon),
                                                                       np.sin(lat)])
        _, axes = self._tangent
        return np.stack([np.cross(up, east), east, -up]) @ axes.T

    def _mapped(self, values: np.ndarray) -> np.ndarray:
        if self.cartesian:
            raise BadProject("longitude and latitude have no place in a project with crs \"local\"; give the project the crs of "
                             "its map")
        return np.asarray(values, float)
