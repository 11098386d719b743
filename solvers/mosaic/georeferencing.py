"""From the plane of the reference photo to the map: by control points or by onboard positions."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..errors import DegenerateGeometry
from ..geometry import LocalFrame, angle_derivatives, rotation
from .data import Data
from .models import Exteriors, through
from .problem import PhotoPriors
from .simultaneous import Found

AFLOAT = 30.0
"""Onboard heights weigh less by this factor where the height of the plane comes from them."""


@dataclass(frozen=True)
class Placing:
    """A similarity from the reference photo's plane to the local frame: X' = scale R(turn) X + shift, heights over the plane by
    the same scale. plane (3,): z0, zx, zy. height: z0. wrong: control points that cannot be right. unit, frame: of the result.
    controlled: something weighted joins the adjustment. by_gps: onboard positions do. datum: of a bundle. pixel: size of a
    photo's pixel on the mosaic. afloat: nothing but onboard heights over it says how high the plane is. far: photos whose
    onboard positions seem wrong, and by how much [m]."""

    data: Data
    scale: float
    turn: float
    shift: np.ndarray
    plane: np.ndarray
    unit: Literal["m", "px"]
    frame: LocalFrame
    controlled: bool
    by_gps: bool
    datum: str
    pixel: float
    said: tuple[str, ...]
    wrong: tuple[str, ...] = ()
    afloat: bool = False
    far: tuple[tuple[int, float], ...] = ()

    def accused(self, oblique: Container[int] = ()) -> list[str]:
        """A sentence on onboard positions that disagree with the photos' content; not of photos so oblique that where they were
        taken was badly known then."""
        far = [f"'{self.data.names[k]}' ({o:.0f} m)" for k, o in self.far if k not in oblique]
        if not far:
            return []
        return [f"the onboard position of {len(far)} photo{'s' * (len(far) > 1)} disagrees with the photos' content: "
                + ", ".join(far[:5])]

    @property
    def height(self) -> float:
        return float(self.plane[0])

    def settled(self, exteriors: Exteriors, photos: np.ndarray) -> tuple[Placing, Exteriors, np.ndarray]:
        """The same with the plane, and photos (m, 12) over it, lifted to where onboard heights say."""
        if not self.afloat:
            return self, exteriors, photos
        rows = np.flatnonzero(np.isfinite(self.data.gps[:, 2]))
        lift = float(np.median(self.data.gps[rows, 2] - photos[rows, 2]))
        plane, out = self.plane + np.array([lift, 0.0, 0.0]), photos.copy()
        out[:, 2] += lift
        return replace(self, plane=plane), replace(exteriors, plane=(float(plane[0]), *exteriors.plane[1:])), out

    @property
    def _matrix(self) -> np.ndarray:
        c, s = self.scale * np.cos(self.turn), self.scale * np.sin(self.turn)
        return np.array([[c, -s, self.shift[0]], [s, c, self.shift[1]], [0, 0, 1]])

    def homographies(self, h: np.ndarray) -> np.ndarray:
        """(m, 3, 3) plane -> photo, from the map plane now."""
        return h @ np.linalg.inv(self._matrix)

    def points(self, xy: np.ndarray) -> np.ndarray:
        """(n, 2) places on the map plane; 0 where there are none."""
        return np.nan_to_num(xy) @ self._matrix[:2, :2].T + self.shift

    def exteriors(self, photos: np.ndarray) -> np.ndarray:
        """(m, 12) exterior orientations in the local frame."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        r = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        centre = self.scale * photos[:, :3] @ r.T + np.array([*self.shift, self.height])
        return np.hstack([centre, (photos[:, 3:].reshape(-1, 3, 3) @ r.T).reshape(-1, 9)])

    def priors(self, data: Data) -> PhotoPriors:
        """Onboard positions as weighted observations, or whole orientations with their covariance where these are known."""
        rows = np.flatnonzero(np.isfinite(data.gps).all(axis=1)) if self.by_gps else np.zeros(0, int)
        info, m = np.zeros((len(rows), 6, 6)), np.tile(np.eye(3), (len(rows), 1, 1))
        info[:, [0, 1, 2], [0, 1, 2]] = 1 / data.gps_sigma[rows] ** 2
        if self.afloat:  # the height of the plane is not known: heights over it must not give the scale
            info[:, 2, 2] /= AFLOAT**2
        for k, photo in enumerate(rows.tolist()):
            prior = data.whole.get(photo)
            if prior is not None and prior.angles is not None and prior.covariance is not None:
                m[k], j = rotation(*prior.angles), np.eye(6)
                j[3:, 3:] = np.linalg.pinv(angle_derivatives(m[k]))
                info[k] = np.linalg.inv(j @ prior.covariance @ j.T)
        return PhotoPriors(rows, data.gps[rows], m, info)


def placing_of(data: Data, h: np.ndarray, found: Found | None, plane: float | str | None = None) -> Placing:
    """The similarity by control points where there are two, else by onboard positions; none for an uncontrolled mosaic.

    h (m, 3, 3), NaN for photos without a place. Raises DegenerateGeometry where positions or points coincide.
    """
    pixel = float(np.nanmedian(_pixel(h, data.scale)))
    if data.level == "uncontrolled":
        return Placing(data, 1.0, 0.0, np.zeros(2), np.zeros(3), "px", data.frame, False, False, "free", pixel, ())
    with np.errstate(invalid="ignore"):
        under = through(np.linalg.inv(np.where(np.isfinite(h), h, np.eye(3))), np.zeros((len(h), 2)))[0]
    tall = 1 / _pixel(h, data.scale) ** -1 * data.scale  # height over the plane, in its unit
    exterior = found is not None and isinstance(found.problem.model, Exteriors)
    if exterior:
        assert found is not None
        under, tall = found.photos[:, :2], found.photos[:, 2]
    under = np.where(np.isfinite(h[:, :1, 0]), under, np.nan)
    control, place = data.controls, _places(data, h)
    control = control[np.isfinite(place[control, 0])]
    placed = np.flatnonzero(np.isfinite(data.gps).all(axis=1) & np.isfinite(under).all(axis=1))
    said: list[str] = []
    wrong: tuple[str, ...] = ()
    far: tuple[tuple[int, float], ...] = ()
    if len(control) >= 2:
        scale, turn, shift, off = similarity(place[control], data.xyz[control, :2], data.sigma_xyz[control, :2].mean(axis=1))
        height = float(plane) if isinstance(plane, (int, float)) else float(np.median(data.xyz[control, 2]))
        wrong, told = _wrong_control(data, control, _off_affinity(place[control], data.xyz[control, :2], off), scale * pixel)
        said += told
    elif len(placed) >= 2:
        scale, turn, shift, off = similarity(under[placed], data.gps[placed, :2], data.gps_sigma[placed, :2].mean(axis=1))
        height = float(plane) if isinstance(plane, (int, float)) else float(np.median(data.gps[placed, 2] - scale * tall[placed]))
        limit = 10 * float(np.median(data.gps_sigma[placed, :2]))  # the reference photo's own tilt is still in it
        far = tuple((int(p), float(o)) for p, o in zip(placed, off, strict=True) if o > limit)
    else:
        raise DegenerateGeometry(f"{data.block.name}: of the photos that hang together, fewer than two have a position and fewer "
                                 "than two control points are seen; take --kind uncontrolled")
    by_gps = exterior and len(placed) >= 2 and (data.level == "semicontrolled" or len(control) < 3 or bool(data.whole))
    controlled = len(control) >= 2 or by_gps
    datum = ("both" if by_gps else "control") if len(control) >= 3 else "prior"
    if found is None and len(control) < 2:
        said.append("onboard positions scale, turn and shift the mosaic; with plane coefficients they do not stop its drift")
    return Placing(data, scale, turn, shift, np.array([height, 0.0, 0.0]), "m", data.frame, controlled, by_gps, datum,
                   scale * pixel, tuple(said), wrong,
                   by_gps and len(control) < 2 and not isinstance(plane, (int, float)) and not data.whole, far)


def similarity(source: np.ndarray, target: np.ndarray, sigma: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Scale, rotation [rad], shift (2,) and distances (k,) left, of the weighted similarity source (k, 2) -> target (k, 2),
    wrong pairs weighted down (Cauchy over the median). Raises DegenerateGeometry where all coincide."""
    z, w, weight = source[:, 0] + 1j * source[:, 1], target[:, 0] + 1j * target[:, 1], 1 / sigma
    a, b = _agreed(z, w)
    off = np.abs(a * z + b - w) if len(z) > 3 else np.zeros(len(z))
    for _ in range(12 if len(z) > 3 else 1):
        r = np.sqrt(1 / (1 + (off / np.maximum(2.385 * 1.5 * np.median(off), 1e-12)) ** 2)) if off.any() else np.ones(len(z))
        design = np.column_stack([z, np.ones(len(z))]) * (weight * r)[:, None]
        (a, b), *_ = np.linalg.lstsq(design, w * weight * r, rcond=None)
        off = np.abs(a * z + b - w)
    if not np.abs(a) > 0 or np.ptp(np.abs(z - z.mean())) + np.abs(z - z.mean()).max() <= 0:
        raise DegenerateGeometry("the positions that should place the mosaic coincide; give others")
    return float(np.abs(a)), float(np.angle(a)), np.array([b.real, b.imag]), off


def _agreed(z: np.ndarray, w: np.ndarray, trials: int = 400) -> tuple[complex, complex]:
    """a, b of the pair of positions whose similarity z -> w leaves the smallest median distance."""
    i, j = np.triu_indices(len(z), 1)
    if len(i) > trials:
        i, j = np.random.default_rng(1960).integers(0, len(z), (2, trials))
    apart = np.abs(z[i] - z[j]) > 1e-9 * max(float(np.abs(z - z.mean()).max()), 1e-300)
    i, j = i[apart], j[apart]
    if not len(i):
        return 0j, 0j
    a = (w[i] - w[j]) / (z[i] - z[j])
    b = w[i] - a * z[i]
    best = int(np.argmin(np.median(np.abs(a[:, None] * z + b[:, None] - w), axis=1)))
    return complex(a[best]), complex(b[best])


def plane_at(points: np.ndarray, wish: float | str | None) -> np.ndarray:
    """(3,) z0, zx, zy: a given height, the tilted plane through most points (n, 3), or a level one at their median height."""
    if isinstance(wish, (int, float)):
        return np.array([float(wish), 0.0, 0.0])
    if wish is None or len(points) < 3:
        return np.array([float(np.median(points[:, 2])), 0.0, 0.0])
    design, weight = np.column_stack([np.ones(len(points)), points[:, :2]]), np.ones(len(points))
    plane = np.zeros(3)
    for _ in range(20):
        plane = np.linalg.lstsq(design * weight[:, None], points[:, 2] * weight, rcond=None)[0]
        off = np.abs(points[:, 2] - design @ plane)
        weight = 1 / np.sqrt(1 + (off / max(2.385 * 1.4826 * float(np.median(off)), 1e-9)) ** 2)
    return plane


def _places(data: Data, h: np.ndarray) -> np.ndarray:
    """(n, 2) mean places of points on the plane of h, NaN for points that no placed photo sees."""
    ok = np.isfinite(h[data.image, 0, 0])
    p = np.full((len(data.image), 2), np.nan)
    p[ok] = through(np.linalg.inv(h[data.image[ok]]), data.q[ok])[0]
    ok = np.isfinite(p[:, 0])
    count = np.bincount(data.point[ok], minlength=len(data.xyz))
    mean = np.stack([np.bincount(data.point[ok], p[ok, k], len(data.xyz)) for k in (0, 1)], axis=1)
    return np.where(count[:, None] > 0, mean / np.maximum(count, 1)[:, None], np.nan)


def _pixel(h: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(m,) plane units of a pixel in the middle of each photo."""
    out = np.full(len(h), np.nan)
    for k, g in enumerate(h):
        if np.isfinite(g).all():
            i = np.linalg.inv(g)
            at = i[:, 2] / i[2, 2]
            j = (i[:2, :2] - at[:2, None] * i[2, :2]) / i[2, 2]
            out[k] = np.sqrt(abs(np.linalg.det(j))) / scale[k]
    return out


def _off_affinity(source: np.ndarray, target: np.ndarray, off: np.ndarray) -> np.ndarray:
    """(k,) distances left by an affinity that most of at least six points agree with (the reference photo's own tilt is in it);
    `off` where there are fewer."""
    if len(source) < 6:
        return off
    design, weight = np.column_stack([source, np.ones(len(source))]), np.ones(len(source))
    for _ in range(40):  # least absolute distances, by reweighting
        fit = np.linalg.lstsq(design * weight[:, None], target * weight[:, None], rcond=None)[0]
        off = np.linalg.norm(target - design @ fit, axis=1)
        weight = 1 / np.sqrt(np.maximum(off, 1e-3 * max(float(off.max()), 1e-9)))
    return off


def _wrong_control(data: Data, control: np.ndarray, off: np.ndarray, pixel: float) -> tuple[tuple[str, ...], list[str]]:
    """Control points that stand out, far more than the others and than their own errors: their names, and a sentence."""
    if len(control) < 4:
        return (), []
    limit = np.maximum(6 * np.median(off), 20 * pixel + 5 * data.sigma_xyz[control, :2].max(axis=1))
    bad = [(data.points[c], o) for c, o, li in zip(control, off, limit, strict=True) if o > li]
    if not bad or len(control) - len(bad) < 3:
        return (), []
    listed = ", ".join(f"'{n}' ({o:.2f} m off)" for n, o in bad[:5])
    several = len(bad) > 1
    return tuple(n for n, _ in bad), [f"{'control points that disagree' if several else 'a control point that disagrees'} with "
                                      f"the photos {'were' if several else 'was'} left out: {listed}; check "
                                      f"{'their names' if several else 'its name'}, coordinates and marks"]
