"""The control of one image: points, pixels and weights in the local frame, and whether their geometry can orient it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..block import Block
from ..cameras import Interior, project_derivatives
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, LocalFrame
from .initial import Noise

COLLINEAR = 1e-5
"""Second singular value over the first, below which points lie on one line."""
PLANE = 1e-6
"""Third singular value over the first, below which points lie exactly in one plane."""


@dataclass(frozen=True)
class Control:
    """Control of one image. points (n, 3) m local; pixels (n, 2); sigma_px (n,); sigma_m (n, 3); names (n,)."""

    image: str
    interior: Interior
    names: tuple[str, ...]
    points: np.ndarray
    pixels: np.ndarray
    sigma_px: np.ndarray
    sigma_m: np.ndarray

    def __len__(self) -> int:
        return len(self.names)

    def take(self, rows: np.ndarray) -> Control:
        """Only some of the points."""
        rows = np.arange(len(self))[rows]
        return replace(self, names=tuple(self.names[i] for i in rows), points=self.points[rows], pixels=self.pixels[rows],
                       sigma_px=self.sigma_px[rows], sigma_m=self.sigma_m[rows])

    def same(self, other: Control) -> bool:
        """Whether two controls hold the same measurements of the same points through the same camera."""
        return self.names == other.names and self.interior == other.interior and all(
            np.array_equal(getattr(self, name), getattr(other, name)) for name in ("points", "pixels", "sigma_px", "sigma_m"))

    def weights(self, exterior: Exterior | None = None) -> np.ndarray:
        """(n, 2, 2) px^-2: inverse of sigma^2 I + J_X Sigma_X J_X^T; of sigma^2 I alone without an orientation."""
        cov = self.sigma_px[:, None, None] ** 2 * np.eye(2)
        if exterior is not None:
            jx = project_derivatives(self.interior, exterior, self.points).point
            cov = cov + (jx * self.sigma_m[:, None, :] ** 2) @ np.swapaxes(jx, 1, 2)
        return np.linalg.inv(cov)

    @property
    def noise(self) -> Noise:
        """What a search for starts may expect of the residuals."""
        return Noise(self.sigma_px * np.sqrt(np.prod(self.interior.pitch)), np.sqrt((self.sigma_m**2).mean(axis=1)))

    @cached_property
    def extent(self) -> np.ndarray:
        """(3,) singular values of the reduced points: length, width and relief of the control [m], times sqrt(n)."""
        return np.linalg.svd(self.points - self.points.mean(axis=0), compute_uv=False) if len(self) > 2 else np.zeros(3)

    @property
    def planar(self) -> bool:
        s = self.extent
        return bool(s[2] <= PLANE * s[0])


def control_of(block: Block, image: str, frame: LocalFrame, points: tuple[str, ...] | None = None) -> Control:
    """Control points (role "control") of an image, in the order of its observations; only the named ones if given.

    Raises BadProject for a named point that is unknown, is not control or is not observed in the image.
    """
    rows = block.seen_in(image, roles=("control",))
    if points is not None:
        for name in points:
            j = block.point_index(name)
            if block.points.role[j] != "control":
                raise BadProject(f"point '{name}' has the role '{block.points.role[j]}', not control; "
                                 "change its role in points.csv")
            if j not in block.observations.point[rows]:
                raise BadProject(f"point '{name}' is not observed in image '{image}'; add it to observations.csv or leave it out")
        rows = np.array([r for r in rows if block.points.names[block.observations.point[r]] in points], int)
    j = block.observations.point[rows]
    xyz, sigma = block.points.xyz[j], block.points.sigma[j]
    names = tuple(block.points.names[k] for k in j.tolist())
    for i in np.flatnonzero(~np.isfinite(xyz).all(axis=1)):
        raise BadProject(f"control point '{names[i]}' has no coordinates; give X, Y, Z in points.csv or make it a tie point")
    sigma_px, pixels = block.observations.sigma[rows], block.observations.pixel[rows]
    _refuse_nonsense(names, image, pixels, sigma_px, sigma)
    return Control(
        image=image,
        interior=block.camera_of(image),
        names=names,
        points=frame.to_local(xyz),
        pixels=pixels,
        sigma_px=np.where(np.isfinite(sigma_px), sigma_px, block.image_px),
        sigma_m=np.where(np.isfinite(sigma), sigma, block.control_m),
    )


def _refuse_nonsense(names: tuple[str, ...], image: str, pixels: np.ndarray, sigma_px: np.ndarray, sigma_m: np.ndarray) -> None:
    """Raises BadProject for a pixel that is no number and for sigmas that are none; NaN means the default."""
    fine = np.isfinite(pixels).all() and not ((sigma_px <= 0) | np.isinf(sigma_px)).any()
    if fine and not ((sigma_m < 0) | np.isinf(sigma_m)).any():
        return
    for name, pixel, px, m in zip(names, pixels, sigma_px, sigma_m, strict=True):
        if not np.isfinite(pixel).all():
            raise BadProject(f"point '{name}' in image '{image}' has the pixel {pixel[0]}, {pixel[1]}; give two numbers "
                             "in observations.csv or remove the line")
        if px <= 0 or np.isinf(px):
            raise BadProject(f"point '{name}' in image '{image}' has sigma = {px} px; give a positive number in "
                             "observations.csv or leave it empty for the default")
        if (m < 0).any() or np.isinf(m).any():
            raise BadProject(f"control point '{name}' has a sigma of {m.tolist()} m; give numbers of at least 0 in points.csv "
                             "or leave them empty for the default")


def require(control: Control, model: str) -> None:
    """Raises DegenerateGeometry when the control cannot orient the image by the model at all, naming the points."""
    n, who = len(control), f"image '{control.image}'"
    named = ", ".join(control.names[:6]) + (" ..." if n > 6 else "")
    least = 3 if model == "perspective" or (n >= 3 and control.planar) else 4
    if n < least:
        have = f"{n} ({named})" if n else "none"
        plane = "" if model == "perspective" else " that are not in one plane"
        raise DegenerateGeometry(f"{who}: the {model} model needs at least {least} control points{plane}, there are {have}; "
                                 "measure more control in this image")
    s = control.extent
    if s[1] <= COLLINEAR * s[0]:
        raise DegenerateGeometry(f"{who}: control points {named} lie on one line (or coincide); add control away from that line")
    rays = control.interior.ideal(control.pixels)
    spread = np.linalg.svd(rays - rays.mean(axis=0), compute_uv=False)
    if spread[1] <= COLLINEAR * spread[0]:
        raise DegenerateGeometry(f"{who}: control points {named} appear on one line in the photo: the camera lies in their plane "
                                 "or the measurements are mixed up; add control away from that line")


def geometry_warnings(control: Control) -> list[str]:
    """What a surveyor should know about the shape of the control before believing the result."""
    if len(control) < 3:
        return []
    reduced = control.points - control.points.mean(axis=0)
    _, s, axes = np.linalg.svd(reduced)
    length, _, relief = np.ptp(reduced @ axes.T, axis=0)
    out = []
    if s[1] < 0.05 * s[0]:
        out.append(f"control points nearly collinear: their spread across the main direction is only "
                   f"{s[1] / s[0]:.1%} of that along it")
    if len(control) > 3 and s[2] < 0.02 * s[0]:
        out.append(f"control points nearly coplanar: they depart by {relief:.2f} m from their plane over {length:.0f} m")
    return out
