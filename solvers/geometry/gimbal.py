"""From yaw, pitch, roll of a gimbal or an aircraft to the photo's rotation M, through whole rotations.

Yaw, pitch, roll turn the body axes (x forward, y right, z down) from north-east-down: R = Rz(yaw) Ry(pitch) Rx(roll), body to
NED (aerospace order ZYX). What the camera looks along is the mount's affair:

"gimbal"  the camera looks along body x, the photo's top is up: pitch 0 looks at the horizon, -90 degrees straight down (DJI)
"nadir"   the camera looks along body z, the photo's top is forward: pitch 0 looks straight down (senseFly, Pix4D)

Adding 90 degrees to the pitch turns one into the other only where roll is zero, so nothing here does that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .rotation import exp

Mount = Literal["gimbal", "nadir"]
Datum = Literal["ellipsoidal", "levelled", "barometric", "unknown"]

MOUNTS: dict[str, np.ndarray] = {
    "gimbal": np.array([[0.0, 1, 0], [0, 0, -1], [-1, 0, 0]]),
    "nadir": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
}
"""Body axes to photo axes (x right, y up, z back)."""


@dataclass(frozen=True)
class Onboard:
    """What an aircraft recorded for one photo; None where it says nothing.

    lat, lon [degrees, WGS84]; height [m] and its datum; relative: height above the take-off point [m]. attitude (3,): yaw,
    pitch, roll [degrees] of the camera's mount, yaw from true north. body (3,): the same of the aircraft (for a lever arm).
    sigma_m (3,): east, north, up [m]. sigma_deg (3,): tilt about north, tilt about east, yaw [degrees]. time: seconds, any
    epoch. stated: where the standard errors and the datum come from, in words.
    """

    image: str
    lat: float | None = None
    lon: float | None = None
    height: float | None = None
    datum: Datum = "unknown"
    relative: float | None = None
    attitude: tuple[float, float, float] | None = None
    mount: Mount = "nadir"
    body: tuple[float, float, float] | None = None
    sigma_m: tuple[float, float, float] | None = None
    sigma_deg: tuple[float, float, float] | None = None
    time: float | None = None
    stated: tuple[str, ...] = ()


def body_to_ned(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """R (3, 3) of yaw, pitch, roll [rad]: turns body axes (forward, right, down) into north, east, down."""
    return exp(np.array([0, 0, yaw])) @ exp(np.array([0, pitch, 0])) @ exp(np.array([roll, 0, 0]))


def photo_rotation(attitude: np.ndarray, mount: Mount, ned: np.ndarray, boresight: np.ndarray | None = None) -> np.ndarray:
    """M (3, 3), object axes to photo axes, of attitude (3,) yaw, pitch, roll [rad].

    ned (3, 3): rows are north, east, down at the camera, in object axes (meridian convergence is in them). boresight (3,):
    rotation vector [rad] from the mount's nominal photo axes to the true ones.
    """
    m = MOUNTS[mount] @ body_to_ned(*attitude).T @ ned
    return m if boresight is None else exp(boresight) @ m


def yaw_pitch_roll(m: np.ndarray, mount: Mount, ned: np.ndarray) -> np.ndarray:
    """(3,) yaw, pitch, roll [rad] of M: the inverse of `photo_rotation`; roll is 0 where pitch is +-90 degrees."""
    r = (MOUNTS[mount].T @ m @ ned.T).T
    pitch = np.arctan2(-r[2, 0], np.hypot(r[2, 1], r[2, 2]))
    if np.hypot(r[2, 1], r[2, 2]) < 1e-12:
        return np.array([np.arctan2(-r[0, 1], r[1, 1]), pitch, 0.0])
    return np.array([np.arctan2(r[1, 0], r[0, 0]), pitch, np.arctan2(r[2, 1], r[2, 2])])


@dataclass(frozen=True)
class FlightLog:
    """An autopilot's record. time (n,) s, increasing, any epoch; degrees (n, 3): longitude, latitude [WGS84], height [m, NaN
    where not recorded]; attitude (n, 3): yaw, pitch, roll [degrees] of the aircraft, NaN where not recorded; trigger (n,)
    bool: rows at which the camera was released, all False where the log does not say."""

    name: str
    time: np.ndarray
    degrees: np.ndarray
    attitude: np.ndarray
    trigger: np.ndarray
