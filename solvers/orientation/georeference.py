"""Direct georeferencing: exterior orientation from onboard GPS and IMU, with heights and standard errors always stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..block import Block, Prior
from ..cameras import project_derivatives
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, LocalFrame, Onboard, Surface, body_to_ned, photo_rotation, skew
from .oriented import Oriented, by_image, frame_of, local, vector_covariance
from .result import ANGLES

GPS_SIGMA_M = (5.0, 5.0, 10.0)
"""Assumed standard errors of a position (east, north, up) where none is stated: navigation GPS."""
ATTITUDE_SIGMA_DEG = {"gimbal": (1.0, 1.0, 3.0), "nadir": (3.0, 3.0, 6.0), "none": (5.0, 5.0, 20.0)}
"""Assumed standard errors of an attitude (tilt, tilt, yaw) by mount where none is stated; "none": there was no attitude."""


@dataclass(frozen=True)
class Vertical:
    """How heights come to the project's datum.

    target: the project's heights. source: what the photos' heights are, None for what they say of themselves. undulation:
    geoid above the ellipsoid [m], entered or as a geoid grid in longitude and latitude (EPSG:4326). bias: added at the end,
    entered or estimated (`height_bias`), with its sigma. take_off: project height of the take-off point [m], to use heights
    above it instead. entered: height for photos that state none.
    """

    target: Literal["as given", "ellipsoidal", "levelled"] = "as given"
    source: Literal["ellipsoidal", "levelled"] | None = None
    undulation: float | Surface | None = None
    undulation_sigma: float = 0.0
    bias: float = 0.0
    bias_sigma: float = 0.0
    take_off: float | None = None
    entered: float | None = None


@dataclass(frozen=True)
class Rig:
    """How the camera sits. lever_arm (3,): from the GPS antenna to the camera in body axes (forward, right, down) [m].
    boresight_deg (3,): small rotation vector from the nominal to the true photo axes. sigma_m, sigma_deg: standard errors to
    use for all photos instead of stated or assumed ones."""

    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    boresight_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_m: tuple[float, float, float] | None = None
    sigma_deg: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Georeferenced:
    """Exterior orientation of one image from onboard data alone.

    exterior: in project coordinates; covariance (6, 6): X, Y, Z, omega, phi, kappa (m, rad). heights: their datum and how they
    came to it, in words. convergence_deg: grid north minus true north at the camera, clockwise positive. relative: height
    above the take-off point [m], where stated. notes: where everything comes from; warnings: what to beware of.
    """

    image: str
    exterior: Exterior
    covariance: np.ndarray
    heights: str
    convergence_deg: float
    relative: float | None
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def model(self) -> str:
        return "georeferenced"

    @property
    def sigma(self) -> np.ndarray:
        """(6,) standard errors of X, Y, Z [m], omega, phi, kappa [rad]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def prior(self) -> Prior:
        """The same as the prior of an image."""
        return Prior(self.exterior.centre, self.exterior.angles, self.sigma[:3], self.sigma[3:])

    def turned(self, degrees: float) -> Georeferenced:
        """The same with the camera turned clockwise about the vertical (to correct a wrong yaw)."""
        a = np.radians(degrees)
        about = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
        return replace(self, exterior=Exterior(self.exterior.m @ about, self.exterior.centre),
                       covariance=_same_errors(self, self.exterior.m @ about),
                       notes=(*self.notes, f"yaw corrected by {degrees:+.1f} degrees"))

    def to_json(self) -> dict[str, Any]:
        """The orientation object of the JSON contract; no observations, so no sigma0 and no residuals."""
        keys = ("X", "Y", "Z", *ANGLES)
        values = [*map(float, self.exterior.centre), *map(float, np.degrees(self.exterior.angles))]
        sigma = np.concatenate([self.sigma[:3], np.degrees(self.sigma[3:])])
        return {"image": self.image, "model": self.model, **dict(zip(keys, values, strict=True)),
                "sigma": dict(zip(keys, map(float, sigma), strict=True)), "sigma_scaled": None,
                "covariance": self.covariance.tolist(),
                "sigma0": None, "dof": 0, "rms_px": None, "rms_px_coordinate": None, "iterations": 0, "converged": True,
                "stop": None,
                "residuals": [], "rejected": [], "heights": self.heights, "convergence_deg": self.convergence_deg,
                "notes": list(self.notes), "warnings": list(self.warnings), "alternatives": [], "discrimination": None}


def georeference(onboard: Sequence[Onboard], crs: str, *, frame: LocalFrame | None = None, vertical: Vertical | None = None,
                 rig: Rig | None = None) -> tuple[Georeferenced, ...]:
    """Exterior orientations of photos from what was recorded onboard, in flight order.

    crs: of the project (a map projection). frame: the local frame that omega, phi, kappa refer to, None for one around the
    cameras. Raises BadProject where a photo has no position or no height, or the crs is no map.
    """
    vertical, rig = vertical or Vertical(), rig or Rig()
    heights = [_height(o, vertical) for o in onboard]
    degrees = np.array([[*_position(o), h] for o, (h, *_) in zip(onboard, heights, strict=True)], float).reshape(-1, 3)
    if not len(degrees):
        return ()
    frame = frame or LocalFrame.around(LocalFrame(np.zeros(3), crs).map_of_degrees(degrees), crs)
    antennas = frame.from_degrees(degrees)
    return tuple(_one(o, a, _course(antennas, k), h, frame, rig) for k,
                 (o, a, h) in enumerate(zip(onboard, antennas, heights, strict=True)))


def _one(o: Onboard, antenna: np.ndarray, course: float | None, height: tuple[float, float, str, list[str]], frame: LocalFrame,
         rig: Rig) -> Georeferenced:
    """One photo. antenna (3,): local; course: azimuth of flight in the local frame [rad]."""
    ned, notes, warnings = frame.north_east_down(antenna), list(o.stated), list(height[3])
    if o.attitude is None:
        attitude, mount, kind = np.array([_true(course or 0.0, ned), 0, 0]), "nadir", "none"
        warnings.append("no attitude was recorded: taken as vertical with the photo's top "
                        + ("along the flight" if course is not None else "to the north"))
    else:
        attitude, mount, kind = np.radians(o.attitude), o.mount, o.mount
    m = photo_rotation(attitude, mount, ned, np.radians(rig.boresight_deg))
    body = np.radians(o.body) if o.body is not None else np.array([attitude[0], 0, 0])
    lever = body_to_ned(*body) @ np.asarray(rig.lever_arm, float)
    if lever.any() and o.body is None:
        notes.append("lever arm: the aircraft's attitude was not recorded, taken as level")
    sigma_m = rig.sigma_m or o.sigma_m or GPS_SIGMA_M
    unknown = ATTITUDE_SIGMA_DEG[kind] if kind != "none" or course is not None else (5.0, 5.0, 104.0)  # uniform over the circle
    sigma_deg = rig.sigma_deg or o.sigma_deg or unknown
    notes += [f"{what} sigma {' '.join(f'{s:g}' for s in values)} {unit}: {'entered' if given else 'assumed'}" for what, values,
              unit, given, said in
              (("position", sigma_m, "m", rig.sigma_m, o.sigma_m), ("attitude", sigma_deg, "degrees", rig.sigma_deg, o.sigma_deg))
              if given or not said]
    up = np.hypot(sigma_m[2], height[1])  # attitude errors are about north, east, down: at pitch -90 yaw and roll are one axis
    north_first = np.diag(np.array([sigma_m[1], sigma_m[0], up]) ** 2)
    j = np.block([[ned.T, -ned.T @ skew(lever)], [np.zeros((3, 3)), -m @ ned.T]])
    sources = np.zeros((6, 6))
    sources[:3, :3], sources[3:, 3:] = north_first, np.diag(np.radians(sigma_deg) ** 2)
    exterior = Exterior(m, frame.to_map(antenna + ned.T @ lever))
    return Georeferenced(o.image, exterior, exterior.angle_covariance(j @ sources @ j.T), height[2],
                         float(-np.degrees(np.arctan2(ned[0, 0], ned[0, 1]))), o.relative, tuple(notes), tuple(warnings))


def _same_errors(g: Georeferenced, m: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) in angles of the same errors about the object axes when the photo has another attitude."""
    vector = vector_covariance(g)
    assert vector is not None
    turn = np.eye(6)
    turn[3:, 3:] = m @ g.exterior.m.T
    return Exterior(m, g.exterior.centre).angle_covariance(turn @ vector @ turn.T)


# -- positions and heights ------------------------------------------------------------------------------------------------


def _position(o: Onboard) -> tuple[float, float]:
    if o.lat is None or o.lon is None:
        raise BadProject(f"image '{o.image}' has no GPS position; give a table of positions (image, lat, lon, height) or a "
                         "flight log, "
                         "or leave the image out")
    return o.lon, o.lat


def _height(o: Onboard, v: Vertical) -> tuple[float, float, str, list[str]]:
    """Height in the project's datum, what converting it adds to its standard error, how in words, and warnings."""
    warnings: list[str] = []
    if v.take_off is not None:
        if o.relative is None:
            raise BadProject(f"image '{o.image}' states no height above the take-off point; leave the take-off height out")
        return o.relative + v.take_off + v.bias, v.bias_sigma, f"take-off point {v.take_off:g} m + height above it{_bias(v)}", []
    height, source = o.height, v.source or o.datum
    if height is None:
        if v.entered is None:
            raise BadProject(f"image '{o.image}' has no height; enter the flying height in the project's datum")
        return v.entered + v.bias, v.bias_sigma, f"entered flying height {v.entered:g} m{_bias(v)}", []
    sigma, words, shift = v.bias_sigma, f"as recorded ({source})", 0.0
    if v.target != "as given" and source != v.target:
        if source in ("ellipsoidal", "levelled") and v.undulation is not None:
            n, how = _undulation(o, v.undulation)
            shift = -n if v.target == "levelled" else n
            sigma, words = float(np.hypot(sigma, v.undulation_sigma)), f"{source} to {v.target} by {how} N = {n:.2f} m"
        elif source in ("ellipsoidal", "levelled"):
            warnings.append(f"heights are {source} and the project's are {v.target}: give a geoid grid, the undulation or a bias")
        elif not v.bias and not v.bias_sigma:
            warnings.append(f"the datum of the recorded heights is not known ({source}): they are taken as {v.target}; estimate "
                            "a bias with "
                            "control points, or enter it")
    return height + shift + v.bias, sigma, words + _bias(v), warnings


def _bias(v: Vertical) -> str:
    return f", bias {v.bias:+.2f} m (sigma {v.bias_sigma:.2f} m)" if v.bias or v.bias_sigma else ""


def _undulation(o: Onboard, undulation: float | Surface) -> tuple[float, str]:
    if not isinstance(undulation, Surface):
        return float(undulation), "the entered undulation"
    lon, lat = _position(o)
    n = float(undulation.sample(np.array([lon, lat])))
    if not np.isfinite(n):
        n = float(undulation.sample(np.array([lon % 360, lat])))
    if not np.isfinite(n):
        raise BadProject(f"image '{o.image}' at latitude {lat:.4f}, longitude {lon:.4f} lies outside the geoid grid "
                         f"{undulation.name}; "
                         "take a grid of the site")
    return n, f"the geoid grid {undulation.name}"


TURN = np.radians(40.0)
"""Change of direction between two photos of a flight beyond which it turns there, from one strip to the next."""


def _course(antennas: np.ndarray, k: int) -> float | None:
    """Azimuth of flight [rad, from the local y axis clockwise] at photo k from its neighbours; None for a single photo.

    Where the flight turns, of the leg before and the leg after the one that its own strip goes on with."""
    legs = np.diff(antennas[:, :2], axis=0)
    near = [i for i in (k - 1, k) if 0 <= i < len(legs) and np.hypot(*legs[i]) > 0.1]
    if len(near) == 2 and _between(*legs[near]) > TURN:
        bend = [_between(legs[i], legs[j]) if 0 <= j < len(legs) else np.pi for i, j in ((k - 1, k - 2), (k, k + 1))]
        near = [near[int(np.argmin(bend))]]
    step = legs[near].sum(axis=0)
    return float(np.arctan2(step[0], step[1])) if np.hypot(*step) > 0.1 else None


def _between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two directions (2,) [rad]."""
    return float(abs(np.arctan2(a[0] * b[1] - a[1] * b[0], a @ b)))


def _true(course: float, ned: np.ndarray) -> float:
    """Azimuth from true north of an azimuth in the local frame."""
    return course - float(np.arctan2(ned[0, 0], ned[0, 1]))


def height_bias(block: Block, georeferenced: Sequence[Oriented]) -> tuple[float, float, int]:
    """What must be added to the heights of all cameras so that they show the control points where they are measured.

    Gives the bias [m], its standard error and the number of measurements it rests on. The cameras' own covariances weigh them
    (a wrong attitude shifts a point as well). Raises DegenerateGeometry without control points in these images.
    """
    by = by_image(georeferenced)
    frame, bias, sigma, count = frame_of(block, by), 0.0, float("inf"), 0
    for _ in range(20):
        n, g, count = 0.0, 0.0, 0
        for name, o in by.items():
            rows = block.seen_in(name, roles=("control",))
            if not len(rows):
                continue
            e = local(o, frame)
            of = block.observations
            at = project_derivatives(block.camera_of(name), Exterior(e.m, e.centre + np.array([0, 0, bias])),
                                     frame.to_local(block.points.xyz[of.point[rows]]))
            s = np.where(np.isfinite(of.sigma[rows]), of.sigma[rows], block.image_px)
            c = vector_covariance(o)
            c = np.zeros((6, 6)) if c is None else c.copy()
            c[2, :], c[:, 2] = 0.0, 0.0  # the height is what is looked for
            j = np.concatenate([at.centre, at.rotation], axis=2).reshape(-1, 6)
            p = np.linalg.inv(np.diag(np.repeat(s, 2) ** 2) + j @ c @ j.T)
            v, a = (of.pixel[rows] - at.pixels).ravel(), at.centre[:, :, 2].ravel()
            n, g, count = n + a @ p @ a, g + a @ p @ v, count + len(rows)
        if not count:
            raise DegenerateGeometry(f"{block.name}: no control point is measured in a georeferenced image; a height bias needs "
                                     "at least one")
        if not n > 0:
            raise DegenerateGeometry(f"{block.name}: the control points do not determine a height bias; enter it")
        bias, sigma = bias + g / n, float(1 / np.sqrt(n))
        if abs(g / n) < 1e-6 * sigma:
            break
    return float(bias), sigma, count


__all__ = ["ATTITUDE_SIGMA_DEG", "GPS_SIGMA_M", "Georeferenced", "Rig", "Vertical", "georeference", "height_bias"]
