"""Block: cameras, images, object points, observations and weights as one value for every task."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .cameras import Interior
from .errors import BadProject

ROLES = ("control", "check", "tie")


@dataclass(frozen=True)
class Prior:
    """Onboard GPS/IMU or an approximate value: centre (3,) m, angles (3,) rad (omega, phi, kappa); None where unknown.

    covariance (6, 6): of X, Y, Z, omega, phi, kappa together (m, rad), in place of the sigmas where they are correlated.
    velocity (3,), sigma_velocity (3,): of the flight at the exposure, along X, Y, Z [m/s]. turning (k, 3): rotation vectors [rad]
    from the attitude at the middle row to that at k instants, evenly from the first row to the last: exp(turning) M, photo axes.
    """

    centre: np.ndarray | None = None
    angles: np.ndarray | None = None
    sigma_m: np.ndarray | None = None
    sigma_rad: np.ndarray | None = None
    covariance: np.ndarray | None = None
    velocity: np.ndarray | None = None
    sigma_velocity: np.ndarray | None = None
    turning: np.ndarray | None = None


@dataclass(frozen=True)
class Image:
    """One photo: its name, its camera's name, its file (None when there are measurements only), its prior and its strip."""

    name: str
    camera: str
    file: str | None = None
    prior: Prior | None = None
    strip: str = ""


@dataclass(frozen=True)
class ScaleBar:
    """A measured distance [m] between two points, with its standard error."""

    first: str
    second: str
    length: float
    sigma: float


@dataclass(frozen=True)
class Together:
    """Control points whose coordinates are known together: covariance (3 k, 3 k) m^2 of X1, Y1, Z1, X2 ..."""

    points: tuple[str, ...]
    covariance: np.ndarray


@dataclass(frozen=True)
class Gps:
    """How priors are to be read. lever_arm: from the antenna to the camera in body axes (forward, right, down) [m], the photo's
    top forward. shift: unknown offsets that positions share, of the "block" or of every "strip"; shift_sigma [m] of each."""

    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift: str = "none"
    shift_sigma: float = 10.0


@dataclass(frozen=True)
class Points:
    """Object points as rows: xyz (n, 3) m, sigma (n, 3) m, both NaN where unknown; role control, check or tie."""

    names: tuple[str, ...]
    xyz: np.ndarray
    sigma: np.ndarray
    role: tuple[str, ...]
    group: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Observations:
    """Image observations as rows: image and point are indices (m,); pixel (m, 2) col, row; sigma (m,) px."""

    image: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    sigma: np.ndarray

    def __len__(self) -> int:
        return len(self.image)


@dataclass(frozen=True)
class Block:
    """All that an adjustment starts from. Coordinates are as the project gives them (crs, metres)."""

    name: str
    crs: str
    cameras: Mapping[str, Interior]
    images: tuple[Image, ...]
    points: Points
    observations: Observations
    image_px: float = 0.5
    control_m: tuple[float, float, float] = (0.02, 0.02, 0.04)
    frame: str = "tangent"  # "grid" takes map coordinates as Cartesian, to repeat a published grid solution
    surface: Mapping[str, Any] = field(default_factory=dict)
    scale_bars: tuple[ScaleBar, ...] = ()
    together: tuple[Together, ...] = ()
    gps: Gps = Gps()
    readout_ms: Mapping[str, float] = field(default_factory=dict)  # of cameras with a rolling shutter, first row to last

    def image_index(self, name: str) -> int:
        """Position of an image. Raises BadProject naming those there are."""
        for k, image in enumerate(self.images):
            if image.name == name:
                return k
        return _index([i.name for i in self.images], name, "image", self.name)

    def point_index(self, name: str) -> int:
        """Position of an object point. Raises BadProject."""
        return _index(self.points.names, name, "point", self.name)

    def camera_of(self, image: str) -> Interior:
        """Interior orientation of an image."""
        return self.cameras[self.images[self.image_index(image)].camera]

    def seen_in(self, image: str, roles: Sequence[str] = ROLES) -> np.ndarray:
        """Rows of `observations` that lie in an image, for points of the given roles, in file order."""
        of = self.observations
        rows = np.flatnonzero(of.image == self.image_index(image))
        return rows[[self.points.role[p] in roles for p in of.point[rows].tolist()]] if len(rows) else rows

    @property
    def placed(self) -> int:
        """Images whose position is known with a standard error."""
        priors = [i.prior for i in self.images if i.prior is not None and i.prior.centre is not None]
        return sum(p.sigma_m is not None or p.covariance is not None for p in priors)

    @property
    def datum(self) -> str:
        """What gives a bundle place, attitude and scale until somebody says otherwise: control, else GPS/IMU, else nothing."""
        return "control" if "control" in self.points.role else "prior" if self.placed else "free"

    def with_role(self, point: str, role: str) -> Block:
        """A block in which one point has another role."""
        j = self.point_index(point)
        roles = (*self.points.role[:j], role, *self.points.role[j + 1:])
        return replace(self, points=replace(self.points, role=roles))


def _index(names: Sequence[str], name: str, what: str, where: str) -> int:
    try:
        return names.index(name)
    except ValueError:
        shown = ", ".join(list(names)[:8]) + (" ..." if len(names) > 8 else "")
        raise BadProject(f"{where}: there is no {what} '{name}'; choose one of {shown}") from None
