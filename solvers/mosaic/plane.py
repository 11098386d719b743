"""Planar collinearity: the eight coefficients between a plane and a photo of it.

    x = (a1 X + b1 Y + c1) / (a3 X + b3 Y + 1),  y = (a2 X + b2 Y + c2) / (a3 X + b3 Y + 1)

from conjugate points, from a known orientation, and back to the orientation where the principal distance is known.
Reference: Tjahjadi, Handoko & Sai 2017, eq. (11) to (16); docs/formulas.md 6.1 and 6.2; Hartley 1997 (normalisation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..adjustment import Options, Trace, solve
from ..cameras import Interior
from ..errors import BadTable, DegenerateGeometry
from ..geometry import Exterior, closest_rotation
from .models import Coefficients
from .network import Network
from .problem import Registering
from .registration import plane_warp

NAMES = ("a1", "b1", "c1", "a2", "b2", "c2", "a3", "b3")
FLAT = 1e-9
"""Singular value, over the largest, of the normalised equations that counts as zero on exact data."""


@dataclass(frozen=True)
class PlaneFit:
    """Eight coefficients from conjugate points. h (3, 3): plane X, Y, 1 -> image x, y, 1 up to scale, positive third component
    at the points. coefficients (8,): a1 .. b3 of the equation above, covariance (8, 8) a priori (multiply by sigma0^2 for the
    fit's own scale). residuals (n, 2): observed minus computed, in the image's unit; sigma0: None without redundancy."""

    h: np.ndarray
    coefficients: np.ndarray
    covariance: np.ndarray
    residuals: np.ndarray
    sigma0: float | None
    dof: int
    trace: Trace

    def to_image(self, xy: np.ndarray) -> np.ndarray:
        """(..., 2) image coordinates of plane points (..., 2); NaN beyond the horizon."""
        return through(self.h, xy)

    def to_plane(self, xy: np.ndarray) -> np.ndarray:
        """(..., 2) plane points of image coordinates (..., 2); NaN at and beyond the horizon."""
        return through(np.linalg.inv(self.h), xy)


def through(h: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(..., 2) points mapped by a homography (3, 3); NaN where its third component is not positive."""
    p = np.asarray(xy, float) @ h[:, :2].T + h[:, 2]
    return p[..., :2] / np.where(p[..., 2:] > 0, p[..., 2:], np.nan)


def plane_coefficients(plane: np.ndarray, image: np.ndarray, sigma: np.ndarray | float = 1.0,
                       sigma_plane: np.ndarray | float | None = None, names: Sequence[str] | None = None) -> PlaneFit:
    """The eight coefficients from n >= 4 conjugate points: plane (n, 2), image (n, 2).

    sigma: of an image coordinate, one number or (n,); sigma_plane: of a plane coordinate, likewise, None where they are exact.
    Both sides are centred and scaled, a homogeneous solution by SVD starts, weighted least squares on the image residuals (and
    the plane's own) ends. Raises DegenerateGeometry where the points do not determine all eight, BadTable for bad numbers.
    """
    plane, image = np.asarray(plane, float).reshape(-1, 2), np.asarray(image, float).reshape(-1, 2)
    n = len(plane)
    if len(image) != n:
        raise BadTable(f"{n} plane points and {len(image)} image points: conjugate points come in pairs")
    if not (np.isfinite(plane).all() and np.isfinite(image).all()):
        raise BadTable("a conjugate point has a coordinate that is not a number; leave it out")
    if n < 4:
        raise DegenerateGeometry(f"{n} conjugate points: eight coefficients need four at least, no three of them on one line")
    s = np.broadcast_to(np.asarray(sigma, float), (n,))
    t, u = _centring(plane), _centring(image)
    p, q = through(t, plane), through(u, image)
    start = _homogeneous(p, q, 1 / (s * u[0, 0]))
    determined(p, q, s * u[0, 0], names)
    given = np.broadcast_to(0.0 if sigma_plane is None else np.asarray(sigma_plane, float), (n,)) * t[0, 0]
    information = np.zeros(n) if sigma_plane is None else 1 / np.maximum(given, 1e-9) ** 2
    net = Network(("photo",), np.zeros(n, int), np.arange(n), q, np.repeat(1 / (s * u[0, 0])[:, None], 2, axis=1), p,
                  np.repeat(information[:, None], 2, axis=1), np.zeros(n), np.zeros(1, bool))
    problem = Registering(net, Coefficients(), fixed_points=sigma_plane is None)
    trace = solve(problem, problem.pack(start[None], p), Options(), {"problem": "plane coefficients", "points": n})
    g, xy = problem.split(trace.last.x)
    h, d = g[0].reshape(3, 3), _photo_covariance(problem, trace.last.x)
    h, by_d = np.linalg.inv(u) @ h @ t, np.linalg.inv(u) @ _directions() @ h @ t
    if abs(h[2, 2]) < 1e-12 * np.abs(h[2]).max():
        raise DegenerateGeometry("the origin of the plane lies on the photo's horizon, where the coefficients are infinite; "
                                 "choose an origin near the points")
    a = h.ravel()[:8] / h[2, 2]
    j = (by_d.reshape(8, 9)[:, :8] / h[2, 2] - by_d[:, 2, 2, None] / h[2, 2] * a).T
    dof = 2 * n - 8
    residuals = (q - through(g[0].reshape(3, 3), p if sigma_plane is None else xy)) / u[0, 0]
    return PlaneFit(h, a, j @ d @ j.T, residuals, float(np.sqrt(2 * trace.last.cost / dof)) if dof else None, dof, trace)


def coefficients_of(interior: Interior, exterior: Exterior, plane: np.ndarray | None = None) -> np.ndarray:
    """(8,) a1 .. b3 over undistorted pixels from interior and exterior orientation; plane (3,): z0, zx, zy, None for Z = 0.

    Raises DegenerateGeometry where the plane's origin lies on the horizon (G = 0 in eq. 13).
    """
    h = plane_warp(interior, exterior, np.zeros(3) if plane is None else np.asarray(plane, float))
    if abs(h[2, 2]) < 1e-12 * np.abs(h[2]).max():
        raise DegenerateGeometry("the origin of the plane lies on the photo's horizon (G = 0 in eq. 13); choose an origin that "
                                 "the photo sees")
    return h.ravel()[:8] / h[2, 2]


@dataclass(frozen=True)
class FromPlane:
    """An orientation from plane coefficients. misfit (2,): r1 . r2 and |r1| - |r2| over the scale, the two conditions that eight
    free coefficients need not meet (0 for a true photo of the plane with this interior orientation)."""

    exterior: Exterior
    misfit: np.ndarray


def orientation_of(h: np.ndarray, interior: Interior, plane: np.ndarray | None = None) -> FromPlane:
    """Exterior orientation of a photo from its homography h (3, 3), plane -> undistorted pixels, with c known.

    plane (3,): z0, zx, zy. Raises DegenerateGeometry where h is singular. Reference: docs/formulas.md 6.1.
    """
    z0, zx, zy = np.zeros(3) if plane is None else np.asarray(plane, float)
    camera = plane_warp(interior, Exterior(np.eye(3), np.zeros(3)), np.array([1.0, 0, 0]))
    b = np.linalg.solve(camera, np.asarray(h, float))  # lambda M [ex, ey, P0 - C]
    ex, ey = np.array([1.0, 0, zx]), np.array([0, 1.0, zy])
    normal, turned = np.cross(ex, ey), np.cross(b[:, 0], b[:, 1])
    size = np.linalg.norm(turned)
    if not size > 1e-300 or not np.isfinite(b).all():
        raise DegenerateGeometry("these plane coefficients are singular: no photo has them")
    scale = np.sqrt(size / np.linalg.norm(normal))
    out = []
    for sign in (1.0, -1.0):
        r = np.column_stack([sign * b[:, 0] / scale, sign * b[:, 1] / scale, turned / scale**2])
        m = closest_rotation(r @ np.linalg.inv(np.column_stack([ex, ey, normal])))
        centre = np.array([0, 0, z0]) - m.T @ (sign * b[:, 2] / scale)
        out.append((centre[2] - z0 - zx * centre[0] - zy * centre[1], m, centre))
    _, m, centre = max(out, key=lambda o: o[0])  # the camera is above the plane
    level = b[:, :2] / scale @ _level(ex, ey)
    misfit = np.array([level[:, 0] @ level[:, 1], np.linalg.norm(level[:, 0]) - np.linalg.norm(level[:, 1])])
    return FromPlane(Exterior(m, centre), misfit)


@dataclass(frozen=True)
class Rectification:
    """How a photo looks at a plane. tilt: angle between the optical axis and the plane's normal [rad]. isocentre, nadir,
    principal (2,): measured pixels of the isocentre, of the foot of the plane's normal (NaN where the photo cannot show it) and
    of the principal point. gsd: plane units of one pixel at the isocentre, where a tilted photo has the scale of a vertical one.
    height: of the camera above the plane, along its normal. horizon: whether the plane's horizon lies within the photo."""

    tilt: float
    isocentre: np.ndarray
    nadir: np.ndarray
    principal: np.ndarray
    gsd: float
    height: float
    horizon: bool


def rectification(interior: Interior, exterior: Exterior, plane: np.ndarray | None = None) -> Rectification:
    """Tilt, isocentre and scale of a photo over a plane (3,): z0, zx, zy. Raises DegenerateGeometry from below the plane."""
    z0, zx, zy = np.zeros(3) if plane is None else np.asarray(plane, float)
    down = np.array([zx, zy, -1.0]) / np.sqrt(1 + zx**2 + zy**2)
    height = float((np.array([0, 0, z0]) - exterior.centre) @ down)
    if height <= 0:
        raise DegenerateGeometry(f"the camera is {-height:.4g} below the plane; give the plane's height below the camera")
    axis, plumb = np.array([0, 0, -1.0]), exterior.m @ down
    tilt = float(np.arctan2(np.linalg.norm(np.cross(axis, plumb)), axis @ plumb))
    edge = np.array([[0, 0], [interior.width, 0], [interior.width, interior.height], [0, interior.height]]) - 0.5
    rays = np.column_stack([interior.ideal(edge), np.full(4, -interior.c)])
    isocentre, nadir, principal = (interior.measured(-interior.c * v[:2] / v[2]) if v[2] < 0 else np.full(2, np.nan)
                                   for v in (axis + plumb, plumb, axis))
    return Rectification(tilt, isocentre, nadir, principal, gsd=height * float(interior.pitch.mean()) / interior.c, height=height,
                         horizon=bool((rays @ plumb <= 0).any()))


# -- what the points determine ------------------------------------------------------------------------------------------------


def determined(plane: np.ndarray, image: np.ndarray, sigma: np.ndarray, names: Sequence[str] | None = None) -> None:
    """Refuse points (n, 2), centred and scaled, that leave the eight coefficients undetermined within their noise."""
    a = _equations(plane, image)
    s = np.linalg.svd(a, compute_uv=False)
    noise = float(np.sqrt(np.mean(sigma**2)))
    if len(s) > 7 and s[7] > max(FLAT * s[0], 3 * noise * np.sqrt(len(plane))):
        return
    how = "are fewer than four in effect"
    for points, where in ((plane, "on the plane"), (image, "in the photo")):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if spread[1] < max(1e-6 * spread[0], 3 * noise * np.sqrt(len(points)) if where == "in the photo" else 0):
            how = f"lie on one line {where}"
            break
        off = _line_through_most(points, 3 * noise)
        if len(points) - len(off) < 2 and len(points) > len(off) - 1:
            rest = [k for k in range(len(points)) if k not in off]
            how = f"lie on one line {where} but for {len(rest)}" + (f" ({', '.join(names[k] for k in rest)})" if names else "")
            break
    raise DegenerateGeometry(f"the {len(plane)} conjugate points {how}: they do not determine eight coefficients; measure points "
                             "spread over the photo, no three of the four outermost on one line")


def _line_through_most(points: np.ndarray, tolerance: float) -> list[int]:
    """Indices of the largest set of points on one line (through any two of the first 40)."""
    best: list[int] = []
    few = points[:40]
    for i in range(len(few)):
        for j in range(i):
            d = few[i] - few[j]
            length = np.hypot(*d)
            if length < 1e-12:
                continue
            off = np.abs((points - few[j]) @ np.array([-d[1], d[0]]) / length)
            on = np.flatnonzero(off <= max(tolerance, 1e-9))
            best = [int(k) for k in on] if len(on) > len(best) else best
    return best


def _equations(plane: np.ndarray, image: np.ndarray) -> np.ndarray:
    """(2 n, 9) homogeneous equations A h = 0."""
    one, zero = np.column_stack([plane, np.ones(len(plane))]), np.zeros((len(plane), 3))
    return np.concatenate([np.hstack([one, zero, -image[:, :1] * one]), np.hstack([zero, one, -image[:, 1:] * one])])


def _homogeneous(plane: np.ndarray, image: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(9,) h of unit length that minimises A h, weighted; positive where the points are."""
    h = np.linalg.svd(_equations(plane, image) * np.tile(weight / weight.max(), 2)[:, None])[2][-1]
    side = np.column_stack([plane, np.ones(len(plane))]) @ h[6:]
    return h if np.median(side) > 0 else -h


def _centring(xy: np.ndarray) -> np.ndarray:
    """(3, 3) what brings points to mean 0 and rms sqrt(2)."""
    mean = xy.mean(axis=0)
    size = np.sqrt(((xy - mean) ** 2).sum(axis=1).mean() / 2)
    if not size > 0:
        raise DegenerateGeometry("all conjugate points are one point; measure points spread over the photo")
    return np.array([[1 / size, 0, -mean[0] / size], [0, 1 / size, -mean[1] / size], [0, 0, 1]])


def _directions() -> np.ndarray:
    """(8, 3, 3) the elements of D one by one."""
    return np.eye(9)[:8].reshape(8, 3, 3)


def _photo_covariance(problem: Registering, x: np.ndarray) -> np.ndarray:
    """(8, 8) covariance of D of the only photo."""
    try:
        if problem.fixed_points:
            n = problem.gather(x).u[0]
            scale = np.sqrt(np.diag(n))
            q = np.linalg.inv(n / np.outer(scale, scale))
            return q / np.outer(scale, scale)
        return problem.reduce(problem.gather(x), 0.0).inverse()[0][0]
    except np.linalg.LinAlgError:
        raise DegenerateGeometry("the conjugate points do not determine eight coefficients; spread them over the photo") from None


def _level(ex: np.ndarray, ey: np.ndarray) -> np.ndarray:
    """(2, 2) combinations of ex and ey that are orthonormal."""
    return np.linalg.inv(np.linalg.cholesky(np.array([[ex @ ex, ex @ ey], [ex @ ey, ey @ ey]]))).T


__all__ = ["NAMES", "FromPlane", "PlaneFit", "Rectification", "coefficients_of", "determined", "orientation_of",
           "plane_coefficients", "rectification", "through"]
