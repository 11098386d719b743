"""Are the yaw angles true? Photos that overlap say so: their content must agree with the line between their positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..block import Block
from ..geometry import LocalFrame
from .georeference import Georeferenced
from .monoplot import Plane, trace_ray
from .oriented import Oriented, by_image, frame_of, local

REVERSED = 20.0
"""A correction within this of 180 degrees is called reversed."""

Matches = Mapping[tuple[str, str], tuple[np.ndarray, np.ndarray]]
"""Pixels (k, 2) in one image and (k, 2) of the same objects in another, by the two names."""


@dataclass(frozen=True)
class Heading:
    """Correction of one image's yaw [degrees, clockwise], its standard error, the pairs it rests on, and the height above
    ground that the content asks for, relative to the assumed one."""

    image: str
    correction_deg: float
    sigma_deg: float
    pairs: int
    height_ratio: float
    words: str


def check_headings(block: Block, georeferenced: Sequence[Georeferenced], matches: Matches, ground_z: float,
                   sigma_m: float = 1.0) -> tuple[Heading, ...]:
    """Correction of each image's yaw by matched content and GPS baselines.

    In a pair (a, b) the ground offsets u (from a's nadir) and w (from b's) of the same objects obey, with yaw corrections da
    and db and scale s of the height: s Rz(da) u - s Rz(db) w = C_b - C_a. A plane similarity w -> u gives db - da and, by its
    translation, da. ground_z: level ground [m]; sigma_m: relative error of neighbouring positions. Images without a
    usable pair are left out.
    """
    by = by_image(georeferenced)
    frame, found = frame_of(block, by), {g.image: [] for g in georeferenced}
    for (a, b), (pa, pb) in matches.items():
        if a not in by or b not in by or len(pa) < 6:
            continue
        u, w = _offsets(block, by[a], frame, pa, ground_z), _offsets(block, by[b], frame, pb, ground_z)
        fit = _similarity(w, u)
        base = (local(by[b], frame).centre - local(by[a], frame).centre)[:2]
        length = float(np.hypot(*base))
        if fit is None or length < 3 * sigma_m:
            continue
        turn, shift, inliers = fit
        if inliers < 6 or np.hypot(*shift) < 1e-3 * length:
            continue
        da = np.arctan2(base[1], base[0]) - np.arctan2(shift[1], shift[0])  # counterclockwise
        ratio, sigma = length / float(np.hypot(*shift)), sigma_m * np.sqrt(2) / length
        found[a].append((da, sigma, ratio))
        found[b].append((da - turn, sigma, ratio))
    return tuple(_heading(image, np.array(rows)) for image, rows in found.items() if rows)


def _heading(image: str, rows: np.ndarray) -> Heading:
    """Weighted circular mean of the corrections of one image."""
    weight = 1 / rows[:, 1] ** 2
    mean = np.angle((weight * np.exp(1j * rows[:, 0])).sum())
    scatter = np.angle(np.exp(1j * (rows[:, 0] - mean)))
    sigma = float(np.degrees(np.sqrt(max(1.0, float((weight * scatter**2).sum()) / max(len(rows) - 1, 1)) / weight.sum())))
    clockwise = float(-np.degrees(mean))
    if abs(abs(clockwise) - 180) < max(REVERSED, 3 * sigma):
        words = f"yaw of image '{image}' is reversed: wrong by {abs(clockwise):.0f} degrees (sigma {sigma:.0f})"
    elif abs(clockwise) > max(15.0, 3 * sigma):
        words = f"yaw of image '{image}' is wrong by {-clockwise:+.0f} degrees (sigma {sigma:.0f})"
    else:
        words = f"yaw of image '{image}' agrees with the content within {abs(clockwise):.0f} degrees (sigma {sigma:.0f})"
    return Heading(image, clockwise, sigma, len(rows), float(np.median(rows[:, 2])), words)


def _offsets(block: Block, g: Oriented, frame: LocalFrame, pixels: np.ndarray, z: float) -> np.ndarray:
    """(k, 2) horizontal offsets of pixels' ground points from the camera's nadir, local axes."""
    at, interior = local(g, frame), block.camera_of(g.image)
    return np.array([frame.to_local(trace_ray(g.image, interior, at, frame, (p[0], p[1]),
                                              Plane(z)).ground)[:2] for p in pixels]) - at.centre[:2]


def _similarity(source: np.ndarray, target: np.ndarray, trials: int = 200) -> tuple[float, np.ndarray, int] | None:
    """Rotation [rad], translation (2,) and number of agreeing pairs of the similarity source -> target, by consensus of pairs."""
    s, t = source[:, 0] + 1j * source[:, 1], target[:, 0] + 1j * target[:, 1]
    rng, best = np.random.default_rng(1981), np.zeros(len(s), bool)
    limit = 0.05 * float(np.abs(t - np.median(t)).max())
    for _ in range(trials):
        i, j = rng.choice(len(s), 2, replace=False)
        if s[i] == s[j]:
            continue
        q = (t[i] - t[j]) / (s[i] - s[j])
        if not 0.5 < abs(q) < 2:
            continue
        ok = np.abs(t - t[i] - q * (s - s[i])) < limit
        best = ok if ok.sum() > best.sum() else best
    if best.sum() < 3:
        return None
    a = np.column_stack([s[best], np.ones(best.sum())])
    q, shift = np.linalg.lstsq(a, t[best], rcond=None)[0]
    return float(np.angle(q)), np.array([shift.real, shift.imag]), int(best.sum())
