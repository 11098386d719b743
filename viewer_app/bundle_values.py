"""What a bundle's rows and its end say, as values: how a row is read, what the end is worth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from solvers import Interior
from solvers.cameras import PARAMETERS
from solvers.geometry import LocalFrame

from .kept import by_identity


@dataclass(frozen=True, eq=False)
class Layout:
    """How the x of a row is read. camera_of (m,): of every image; turn (3, 3), shift (3,): from the bundle's axes to the
    scene's, x' = turn x + shift."""

    images: tuple[str, ...]
    cameras: tuple[str, ...]
    interiors: tuple[Interior, ...]
    camera_of: np.ndarray
    points: tuple[str, ...]
    manifest: Mapping[str, Any]
    turn: np.ndarray
    shift: np.ndarray

    def poses(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres (m, 3) m and matrices (m, 3, 3), object to photo axes, in the scene's frame."""
        rows = x[: 12 * len(self.images)].reshape(-1, 12)
        return rows[:, :3] @ self.turn.T + self.shift, rows[:, 3:].reshape(-1, 3, 3) @ self.turn.T

    def places(self, x: np.ndarray) -> np.ndarray:
        """Object points (n, 3) m in the scene's frame."""
        return _places(self, x)

    def interiors_at(self, x: np.ndarray) -> tuple[Interior, ...]:
        first = 12 * len(self.images)
        rows = x[first : first + 10 * len(self.cameras)].reshape(-1, 10)
        return tuple(replace(i, **dict(zip(PARAMETERS, map(float, row), strict=True)))
                     for i, row in zip(self.interiors, rows, strict=True))


@by_identity(4)
def _places(layout: Layout, x: np.ndarray) -> np.ndarray:
    first = 12 * len(layout.images) + 10 * len(layout.cameras)
    own = x[first : first + 3 * len(layout.points)].reshape(-1, 3)
    if np.array_equal(layout.turn, np.eye(3)):
        return own + layout.shift
    return np.einsum("nj,ij->ni", own, layout.turn) + layout.shift  # BLAS would wake threads for so little


def layout_of(manifest: Mapping[str, Any], interiors: tuple[Interior, ...], frame: LocalFrame) -> Layout:
    """How the rows of a bundle's trace are read, for a scene in `frame`. interiors: of its cameras, as they were given."""
    own = LocalFrame.around(np.asarray(manifest["origin"], float)[None], manifest["crs"], manifest["frame"])
    at = frame.to_local(own.to_map(np.concatenate([np.zeros((1, 3)), 1000 * np.eye(3)])))
    u, _, vt = np.linalg.svd((at[1:] - at[0]).T / 1000)
    return Layout(
        tuple(manifest["images"]), tuple(manifest["cameras"]), interiors,
        np.array(manifest["camera_of"], int), tuple(manifest["points"]), manifest,
        np.eye(3) if own.cartesian else u @ vt, at[0])


@dataclass(frozen=True, eq=False)
class Judged:
    """What the end of a bundle is worth, as arrays. In the scene's frame: image_covariance (m, 3, 3) of the centres, covariance
    (n, 3, 3) of the points, off (n, 3) adjusted minus given. Of the images: values (m, 6) X Y Z [m] omega phi kappa [degrees] of
    the project, exterior (m, 6, 6) their covariance (m, rad), seen (m,), rms (m,) px, sigma0 (m,). Of the observations (o,), by
    image and point of the layout: pixel, v, w, redundancy (o, 2), used. Of the points: w (n, 3), rays, roles.
    """

    values: np.ndarray
    exterior: np.ndarray
    image_covariance: np.ndarray
    seen: np.ndarray
    rms: np.ndarray
    image_sigma0: np.ndarray
    image: np.ndarray
    point: np.ndarray
    pixel: np.ndarray
    v: np.ndarray
    w: np.ndarray
    redundancy: np.ndarray
    used: np.ndarray
    roles: tuple[str, ...]
    xyz: np.ndarray
    covariance: np.ndarray
    off: np.ndarray
    point_w: np.ndarray
    rays: np.ndarray
    interiors: tuple[Interior, ...]
    freed: tuple[tuple[str, str], ...]
    interior_covariance: np.ndarray
    sigma0: float | None
    dof: int
    rms_px: float
    converged: bool
    groups: Mapping[str, tuple[float | None, float]]
    control_rms: np.ndarray | None
    check_rms: np.ndarray | None
    suspects: tuple[Mapping[str, Any], ...]
    warnings: tuple[str, ...]
    joint: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class Kept:
    """Where a bundle was kept, and its image of the largest residuals ("" where there is none)."""

    run: str
    worst: str = ""


@dataclass(frozen=True)
class Ended:
    """There is nothing more to come."""

    said: str


def stopped_at(row: int) -> str:
    """What is said of a bundle that somebody stopped."""
    return f"Stopped; row {row} is kept, without standard errors."
