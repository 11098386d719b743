"""What intersection, monoplotting and footprints need of an oriented image, whoever oriented it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..block import Block
from ..errors import BadProject
from ..geometry import Exterior, LocalFrame, angle_derivatives

ELLIPSE95 = 2.447746830680816
"""Semi-axis of a 95 % ellipse in standard deviations: sqrt(chi-square of 2 degrees of freedom)."""


class Oriented(Protocol):
    """An image with its exterior orientation in project coordinates; Orientation and Georeferenced are such."""

    @property
    def image(self) -> str: ...
    @property
    def exterior(self) -> Exterior: ...
    @property
    def covariance(self) -> np.ndarray | None:
        """(6, 6) of X, Y, Z, omega, phi, kappa (m, rad); None: taken as free of error."""
        ...


@dataclass(frozen=True)
class Known:
    """An exterior orientation from anywhere (a table, a truth), with or without its covariance."""

    image: str
    exterior: Exterior
    covariance: np.ndarray | None = None


def by_image(orientations: Iterable[Oriented] | Mapping[str, Oriented]) -> dict[str, Oriented]:
    """Orientations by the name of their image. Raises BadProject for two of one image."""
    found: dict[str, Oriented] = {}
    for o in orientations.values() if isinstance(orientations, Mapping) else orientations:
        if o.image in found:
            raise BadProject(f"image '{o.image}' has two orientations; give the one to use")
        found[o.image] = o
    return found


def frame_of(block: Block, orientations: Mapping[str, Oriented]) -> LocalFrame:
    """The local frame that the orientations' angles refer to: around the known points, else around the cameras."""
    known = block.points.xyz[np.isfinite(block.points.xyz).all(axis=1)]
    where = known if len(known) else np.array([o.exterior.centre for o in orientations.values()]).reshape(-1, 3)
    return LocalFrame.around(where, block.crs, block.frame)


def local(oriented: Oriented, frame: LocalFrame) -> Exterior:
    """The exterior orientation in the local frame."""
    return Exterior(oriented.exterior.m, frame.to_local(oriented.exterior.centre))


def vector_covariance(oriented: Oriented) -> np.ndarray | None:
    """(6, 6) covariance of (centre [m], left rotation vector [rad])."""
    j = to_vector(oriented.exterior)
    return None if oriented.covariance is None else j @ oriented.covariance @ j.T


def to_vector(exterior: Exterior) -> np.ndarray:
    """(6, 6) d(centre, left rotation vector) / d(X, Y, Z, omega, phi, kappa)."""
    j = np.eye(6)
    j[3:, 3:] = np.linalg.pinv(angle_derivatives(exterior.m))
    return j


@dataclass(frozen=True)
class Ellipse:
    """95 % error ellipse in the horizontal plane: semi-axes [m] and the azimuth [degrees from grid north] of the longer one."""

    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float

    @classmethod
    def of(cls, covariance: np.ndarray) -> Ellipse:
        """Of a covariance whose first two rows are X, Y [m^2]."""
        values, vectors = np.linalg.eigh(covariance[:2, :2])
        major, minor = ELLIPSE95 * np.sqrt(np.maximum(values[::-1], 0))
        azimuth = np.degrees(np.arctan2(vectors[0, 1], vectors[1, 1])) % 180
        return cls(float(major), float(minor), float(azimuth))
