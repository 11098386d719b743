"""Places, distances and areas measured on a mosaic, each with its standard error from the registration's covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..geometry import Exterior, exp
from .bends import by_bend
from .models import tangent
from .registration import Registration, plane_warp


class Value(NamedTuple):
    """A quantity and its standard error, NaN where the registration has no covariance."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Measured:
    """What k places on a mosaic say. xy (k, 2): the places, local; sigma (k, 2): their standard errors; photos: by which photo
    each was judged; length: of the line through them, None for one place; area: of the polygon, None below three places."""

    xy: np.ndarray
    sigma: np.ndarray
    photos: tuple[str, ...]
    length: Value | None
    area: Value | None


def seen_by(r: Registration, xy: np.ndarray) -> list[int]:
    """The photos that show a place X, Y (2,) of the mosaic plane, the one whose middle is nearest first."""
    found = []
    for k, interior in enumerate(r.interiors):
        pixel = r.to_pixels(k, np.asarray(xy, float))
        if np.isfinite(pixel).all() and bool(interior.inside(pixel)):
            middle = np.array([interior.width - 1.0, interior.height - 1.0]) / 2
            found.append((float(np.linalg.norm((pixel - middle) / middle)), k))
    return [k for _, k in sorted(found)]


def place_jacobian(r: Registration, photo: int, xy: np.ndarray) -> np.ndarray:
    """(2, s) how the place X, Y (2,) that a photo shows moves on the mosaic with the photo's own parameters, those of
    `Registration.covariance`; its pixel stays."""
    h = _over_c(r, photo)
    q, by_place = _seen(h, xy)
    if r.kind == "plane":
        by_photo = tangent(q[None])[0]
        if r.covariance.shape[1] > by_photo.shape[1]:  # the photo's bend is in it
            by_photo = np.hstack([by_photo, by_bend(r.interiors, np.array([photo]), q[None])[0]])
    else:
        e = r.exteriors[photo]
        height = abs(float(e.centre[2] - r.heights(np.asarray(xy, float))))
        by_photo = np.empty((2, 6))
        for j in range(6):
            step = np.zeros(6)
            step[j] = 1e-5 * (height if j < 3 else 1.0)
            ends = [_seen(_over_c(r, photo, Exterior(exp(s * step[3:]) @ e.m, e.centre + s * step[:3])), xy)[0] for s in (1, -1)]
            by_photo[:, j] = (ends[0] - ends[1]) / (2 * step[j])
    return -np.linalg.solve(by_place, by_photo)


def measure(r: Registration, xy: Sequence[Sequence[float]] | np.ndarray) -> Measured:
    """Places (k, 2) of the mosaic plane with what they span.

    Errors of places that one photo shows are correlated through its covariance; errors of different photos are taken as
    independent, which is cautious: neighbours err alike. Pointing errors are not included.
    """
    at = np.asarray(xy, float).reshape(-1, 2)
    photos = _judges(r, at)
    rows = [None if k is None else place_jacobian(r, k, p) for k, p in zip(photos, at, strict=True)]
    sigma = np.full(at.shape, np.nan)
    for i, (k, j) in enumerate(zip(photos, rows, strict=True)):
        if k is not None and j is not None:
            sigma[i] = np.sqrt(np.diag(j @ r.covariance[k] @ j.T))
    names = tuple("" if k is None else r.names[k] for k in photos)
    length = area = None
    if len(at) >= 2:
        steps = np.diff(at, axis=0)
        long = np.linalg.norm(steps, axis=1)
        along = steps / np.where(long > 0, long, 1.0)[:, None]
        by = np.zeros(at.shape)
        by[:-1] -= along
        by[1:] += along
        length = Value(float(long.sum()), _sigma(r, photos, rows, by))
    if len(at) >= 3:
        before, after = np.roll(at, 1, axis=0), np.roll(at, -1, axis=0)
        signed = float((at[:, 0] * after[:, 1] - at[:, 1] * after[:, 0]).sum() / 2)
        by = np.sign(signed) * np.stack([after[:, 1] - before[:, 1], before[:, 0] - after[:, 0]], axis=1) / 2
        area = Value(abs(signed), _sigma(r, photos, rows, by))
    return Measured(at, sigma, names, length, area)


def _judges(r: Registration, at: np.ndarray) -> list[int | None]:
    """The photo that judges each place: one that shows all of them where there is one, else the best of each."""
    seen = [seen_by(r, p) for p in at]
    common = set(seen[0]).intersection(*seen[1:]) if seen else set()
    if common:
        best = min(common, key=lambda k: sum(s.index(k) for s in seen))
        return [best] * len(at)
    return [s[0] if s else None for s in seen]


def _sigma(r: Registration, photos: list[int | None], rows: list[np.ndarray | None], by: np.ndarray) -> float:
    """Standard error of a quantity whose derivatives by the places are by (k, 2)."""
    total: dict[int, np.ndarray] = {}
    for k, j, b in zip(photos, rows, by, strict=True):
        if k is None or j is None:
            return float("nan")
        total[k] = total.get(k, 0) + b @ j
    return float(np.sqrt(sum(float(g @ r.covariance[k] @ g) for k, g in total.items())))


def _over_c(r: Registration, photo: int, exterior: Exterior | None = None) -> np.ndarray:
    """(3, 3) mosaic plane X, Y, 1 -> ideal photo coordinates over c (x right, y up), up to scale."""
    i = r.interiors[photo]
    (px, py), (xp, yp) = i.pitch, i.principal_point
    camera = np.array([[i.c / px, 0, (i.width - 1) / 2 + xp / px], [0, -i.c / py, (i.height - 1) / 2 - yp / py], [0, 0, 1.0]])
    return np.linalg.solve(camera, r.warps[photo] if exterior is None else plane_warp(i, exterior, r.plane))


def _seen(h: np.ndarray, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(2,) photo coordinates of a place and (2, 2) their derivatives by it."""
    p = h[:, :2] @ np.asarray(xy, float) + h[:, 2]
    q = p[:2] / p[2]
    return q, (h[:2, :2] - q[:, None] * h[2, :2]) / p[2]


__all__ = ["Measured", "Value", "measure", "place_jacobian", "seen_by"]
