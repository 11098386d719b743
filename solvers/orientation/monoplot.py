"""Monoplotting: one oriented image and the ground it shows (a plane or a DEM) give ground coordinates."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from ..block import Block
from ..cameras import Interior
from ..cameras.distortion import correct_jacobian
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, LocalFrame, Surface, skew
from .oriented import Ellipse, Oriented, frame_of, local, vector_covariance

PIECE = 200.0
"""Length [m] of the straight pieces a ray is cut into on a map: it bends by less than a millimetre in between."""
GRAZING = np.radians(5.0)
"""Angle between ray and ground below which the result is warned of."""


@dataclass(frozen=True)
class Monoplotted:
    """A ground point. ground (3,): project coordinates [m]; covariance (3, 3) m^2 in the axes of the local frame.

    distance: from the camera [m]. grazing: angle between ray and surface [rad]. others (k, 3): farther places where the ray
    meets the surface again from above.
    """

    image: str
    pixel: tuple[float, float]
    ground: np.ndarray
    covariance: np.ndarray
    distance: float
    grazing: float
    surface: str
    others: np.ndarray
    warnings: tuple[str, ...] = ()

    @property
    def ellipse(self) -> Ellipse:
        """95 % error ellipse in X, Y."""
        return Ellipse.of(self.covariance)

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command monoplot."""
        sigma = np.sqrt(np.diag(self.covariance))
        return {"image": self.image, "col": self.pixel[0], "row": self.pixel[1],
                **dict(zip("XYZ", map(float, self.ground), strict=True)),
                "sigma": dict(zip("XYZ", map(float, sigma), strict=True)), "covariance": self.covariance.tolist(),
                "ellipse95": asdict(self.ellipse), "surface": self.surface, "distance_m": self.distance,
                "grazing_deg": float(np.degrees(self.grazing)), "other_hits": self.others.tolist(),
                "warnings": list(self.warnings)}


@dataclass(frozen=True)
class Plane:
    """Level ground at height z [m] with its standard error [m]."""

    z: float
    sigma: float = 0.0

    @property
    def name(self) -> str:
        return f"plane z = {self.z:g}"


Ground = Plane | Surface


def monoplot(block: Block, oriented: Oriented, pixel: tuple[float, float], ground: Ground, *,
             sigma_px: float | None = None) -> Monoplotted:
    """Ground coordinates of a pixel (col, row) of an oriented image, with their covariance.

    The covariance has the image noise sigma_px (None: the block's), the orientation's covariance and the ground's height
    error, each carried along the sloping ground. Raises BadProject (a pixel outside the photo, a DEM in another crs) and
    DegenerateGeometry (horizon, miss, camera below the ground).
    """
    interior = block.camera_of(oriented.image)
    frame = frame_of(block, {oriented.image: oriented})
    if not interior.inside(np.array(pixel)):
        raise BadProject(f"image '{oriented.image}': pixel col {pixel[0]:g}, row {pixel[1]:g} lies outside its {interior.width} "
                         "x "
                         f"{interior.height} pixels")
    if isinstance(ground, Surface) and ground.grid.crs != block.crs:
        raise BadProject(f"{ground.name}: its crs is '{ground.grid.crs}' and the project's is '{block.crs}'; "
                         "warp the DEM to the project's crs")
    noise = block.image_px if sigma_px is None else sigma_px
    return trace_ray(oriented.image, interior, local(oriented, frame), frame, pixel, ground, noise, vector_covariance(oriented))


def trace_ray(image: str, interior: Interior, exterior: Exterior, frame: LocalFrame, pixel: tuple[float, float], ground: Ground,
              sigma_px: float = 0.0, covariance: np.ndarray | None = None) -> Monoplotted:
    """`monoplot` of values: exterior in the local frame, covariance (6, 6) of (centre, left rotation vector) or None."""
    who = f"image '{image}': the ray of pixel col {pixel[0]:g}, row {pixel[1]:g}"
    ray = exterior.m.T @ np.append(interior.ideal(np.array(pixel)), -interior.c)
    unit = ray / np.linalg.norm(ray)
    hits = _plane_hit(who, exterior.centre, unit, frame, ground) if isinstance(ground, Plane) else \
        _surface_hits(who, exterior.centre, unit, frame, ground)
    t, point = hits[0], exterior.centre + hits[0] * unit
    at = frame.to_map(point)
    normal, slope = _normal(frame, point, at, ground)
    grazing = float(np.arcsin(min(abs(normal @ unit) / float(np.linalg.norm(normal)), 1.0)))
    height = ground.sigma**2 + (float(slope @ slope) * ground.sigma_xy**2 if isinstance(ground, Surface) else 0.0)
    by = partials(interior, exterior, np.array(pixel), t, normal)
    cov = by.pixel @ by.pixel.T * sigma_px**2 + np.outer(by.height, by.height) * height
    if covariance is not None:
        cov = cov + by.orientation @ covariance @ by.orientation.T
    cov = (cov + cov.T) / 2
    others = np.array([frame.to_map(exterior.centre + s * unit) for s in hits[1:]]).reshape(-1, 3)
    warnings = []
    if len(others):
        warnings.append(f"the ray meets the surface {len(hits)} times from above: the nearest place is given, the others are "
                        f"{', '.join(f'{s - t:.1f}' for s in hits[1:])} m behind it")
    if grazing < GRAZING:
        warnings.append(f"the ray grazes the ground at {np.degrees(grazing):.1f} degrees: errors along it are magnified "
                        f"{1 / np.sin(grazing):.0f} times")
    if covariance is None:
        warnings.append("the orientation has no covariance: its error is not in the ellipse")
    return Monoplotted(image, (float(pixel[0]), float(pixel[1])), at, cov, float(t), grazing, ground.name, others,
                       tuple(warnings))


class Partials(NamedTuple):
    """Derivatives of a ground point (3,) by its pixel (3, 2) m/px, the orientation (3, 6) (centre, left rotation vector) and
    the height of the ground (3,)."""

    pixel: np.ndarray
    orientation: np.ndarray
    height: np.ndarray


def partials(interior: Interior, exterior: Exterior, pixel: np.ndarray, distance: float, normal: np.ndarray) -> Partials:
    """With X = C + s d on the surface n (X - X_0) = dz: dX = (I - d n^T / n d) (dC + s dd) + d / (n d) dz."""
    r = np.append(interior.ideal(pixel), -interior.c)
    d = exterior.m.T @ r
    scale, onto = distance / float(np.linalg.norm(d)), np.eye(3) - np.outer(d, normal) / (normal @ d)
    reduced = interior.photo(pixel) - interior.principal_point
    to_mm = correct_jacobian(interior.coefficients, reduced) @ np.diag(np.array([1.0, -1.0]) * interior.pitch)
    return Partials(onto @ (scale * exterior.m.T[:, :2] @ to_mm), onto @ np.hstack([np.eye(3), scale * exterior.m.T @ skew(r)]),
                    d / (normal @ d))


def _normal(frame: LocalFrame, point: np.ndarray, at: np.ndarray, ground: Ground) -> tuple[np.ndarray, np.ndarray]:
    """Normal (3,) of the ground in local axes with unit height gain, and its slope (2,) dz/dx, dz/dy on the map."""
    slope = np.zeros(2) if isinstance(ground, Plane) else ground.slope(at[:2])
    step = np.eye(3)
    mapped = np.array([(frame.to_map(point + e) - frame.to_map(point - e)) / 2 for e in step])  # rows: d map / d local axis
    return mapped[:, 2] - mapped[:, :2] @ slope, slope


def _plane_hit(who: str, centre: np.ndarray, unit: np.ndarray, frame: LocalFrame, plane: Plane) -> np.ndarray:
    above = float(frame.to_map(centre)[2]) - plane.z
    if above <= 0:
        raise DegenerateGeometry(f"{who}: the camera is {-above:.2f} m below the plane z = {plane.z:g}; check the height datum "
                                 "of the plane "
                                 "and of the camera")
    t = _reach(centre, unit, frame, plane.z)
    if t is None:
        raise DegenerateGeometry(f"{who} points above the horizon and never meets the plane z = {plane.z:g}; "
                                 "take a pixel below the horizon")
    return np.array([t])


def _reach(centre: np.ndarray, unit: np.ndarray, frame: LocalFrame, z: float) -> float | None:
    """Distance [m] along a ray at which its map height has sunk to z; None where it never does. Newton on the true height."""
    if unit[2] >= 0 and frame.cartesian:
        return None
    t = (z - float(frame.to_map(centre)[2])) / unit[2] if unit[2] < 0 else np.inf
    if not np.isfinite(t) or t > 1e5:
        return None  # farther than the curvature of the earth lets anything be seen from the air
    for _ in range(20):
        here, next_ = frame.to_map(centre + t * unit)[2], frame.to_map(centre + (t + 0.5) * unit)[2]
        step = (z - here) / ((next_ - here) / 0.5)
        t += step
        if not np.isfinite(t) or t < 0 or t > 3e5:
            return None
        if abs(step) < 1e-9 * max(t, 1.0):
            break
    return float(t)


def _surface_hits(who: str, centre: np.ndarray, unit: np.ndarray, frame: LocalFrame, surface: Surface) -> np.ndarray:
    """Distances [m] of all places where the ray goes below the surface, nearest first."""
    start = frame.to_map(centre)
    under = float(surface.sample(start[:2]))
    if np.isfinite(under) and under >= start[2]:
        raise DegenerateGeometry(f"{who}: the camera is {under - start[2]:.2f} m below {surface.name}; its heights and the "
                                 "camera's have "
                                 "different datums, or the height is wrong")
    corners = np.column_stack([surface.grid.corners, np.full(4, surface.range[0])])
    far = float(np.linalg.norm(frame.to_local(corners) - centre, axis=1).max())
    floor = _reach(centre, unit, frame, surface.range[0] - 1.0)
    end = min(far + 1.0, np.inf if floor is None else floor)
    t = np.linspace(0.0, end, 2 if frame.cartesian else min(int(end / PIECE) + 2, 5000))
    path = frame.to_map(centre + t[:, None] * unit)
    s, down = surface.crossings(path)
    if not down.any():
        raise DegenerateGeometry(_miss(who, path, surface))
    piece = np.minimum(s[down].astype(int), len(t) - 2)
    near = t[piece] + (s[down] - piece) * (t[piece + 1] - t[piece])
    return np.array([_polish(x, centre, unit, frame, surface) for x in near])


def _polish(t: float, centre: np.ndarray, unit: np.ndarray, frame: LocalFrame, surface: Surface) -> float:
    """The root on the true ray, which a piece on the map only touches at its ends."""
    def above(x: float) -> float:
        at = frame.to_map(centre + x * unit)
        return float(at[2] - surface.sample(at[:2]))

    if frame.cartesian:
        return t
    step = 1e-3
    for _ in range(3):
        here, ahead = above(t), above(t + step)
        if not np.isfinite(here) or not np.isfinite(ahead) or ahead == here:
            break
        t -= float(np.clip(here * step / (ahead - here), -0.5, 0.5))
    return t


def _miss(who: str, path: np.ndarray, surface: Surface) -> str:
    """Why a ray meets nothing, in words."""
    dense = np.concatenate([np.linspace(a, b, 200) for a, b in pairwise(path)])
    inside = np.isfinite(surface.sample(dense[:, :2]))
    rising = path[-1, 2] >= path[0, 2]
    if rising:
        return f"{who} points above the horizon and never meets {surface.name}; take a pixel below the horizon"
    if not inside.any():
        return f"{who} never passes over {surface.name} (or only over its voids); take a larger DEM"
    last = dense[np.flatnonzero(inside)[-1]]
    over = last[2] - float(surface.sample(last[:2]))
    return (f"{who} leaves {surface.name} (its edge or a void) near X {last[0]:.1f}, Y {last[1]:.1f}, {over:.1f} m above it, "
            "without meeting it; take a larger DEM")
