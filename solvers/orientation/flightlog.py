"""Photos matched with an autopilot's log by time, when the two clocks do not agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import BadProject, DegenerateGeometry
from ..geometry import FlightLog, Onboard

EARTH = 6.371e6


@dataclass(frozen=True)
class Offset:
    """Log time minus photo time [s], its standard error, and how it was found, in words."""

    seconds: float
    sigma: float
    how: str


def match_log(log: FlightLog, photos: Sequence[Onboard], offset: float | None = None,
              sigma_m: float = 5.0) -> tuple[list[Onboard], Offset]:
    """Photos with position and attitude of the log at their times.

    offset: log time minus photo time [s]; None: estimated, from the photos' own coarse positions where they have them, else from
    the log's triggers, matched to the photos by the intervals between them. The offset's error moves a photo along its flight:
    it is in the stated sigma. Raises BadProject (no times, photos outside the log) and DegenerateGeometry (cannot be estimated).
    """
    for p in photos:
        if p.time is None:
            raise BadProject(f"image '{p.image}' has no time; take photos with their EXIF date, or a table with a column time")
    times = np.array([p.time for p in photos], float)
    found = Offset(offset, 0.0, "entered") if offset is not None else estimate_offset(log, photos, sigma_m)
    at = times + found.seconds
    for p, t in zip(photos, at, strict=True):
        if not log.time[0] <= t <= log.time[-1]:
            raise BadProject(f"image '{p.image}' was taken {min(abs(t - log.time[0]), abs(t - log.time[-1])):.1f} s outside "
                             f"{log.name} "
                             "(with the clocks' offset); give the log of this flight")
    degrees = np.stack([np.interp(at, log.time, log.degrees[:, k]) for k in range(3)], 1)
    attitude = np.degrees(np.stack([np.interp(at, log.time, np.unwrap(np.radians(log.attitude[:, k]))) for k in range(3)], 1)) \
        if np.isfinite(log.attitude).all() else np.full((len(at), 3), np.nan)
    speed = np.linalg.norm(_metres(np.stack([np.interp(at + 0.5, log.time, log.degrees[:, k]) for k in range(3)], 1)
                                   - np.stack([np.interp(at - 0.5, log.time, log.degrees[:, k]) for k in range(3)], 1), degrees),
                                   axis=1)
    said = f"position: {log.name}, clocks {found.seconds:+.2f} s apart (sigma {found.sigma:.2f} s, {found.how})"
    out = []
    for p, d, a, v in zip(photos, degrees, attitude, speed, strict=True):
        across = float(np.hypot(sigma_m, v * found.sigma))
        three = (float(a[0]), float(a[1]), float(a[2])) if np.isfinite(a).all() else None
        height = float(d[2]) if np.isfinite(d[2]) else p.height
        out.append(replace(p, lon=float(d[0]), lat=float(d[1]), height=height, datum="unknown" if np.isfinite(d[2]) else p.datum,
                           attitude=three or p.attitude, body=three or p.body, mount="nadir" if three else p.mount,
                           sigma_m=(across, across, 2 * sigma_m), stated=(said,)))
    return out, found


def estimate_offset(log: FlightLog, photos: Sequence[Onboard], sigma_m: float = 5.0) -> Offset:
    """Offset of the clocks by the photos' own positions, else by the log's triggers. Raises DegenerateGeometry."""
    located = [p for p in photos if p.lat is not None and p.lon is not None]
    if len(located) >= 2:
        return _by_position(log, located, sigma_m)
    if log.trigger.sum() >= len(photos) >= 3:
        return _by_triggers(log.time[log.trigger], np.array([p.time for p in photos], float), log.name)
    raise DegenerateGeometry(f"{log.name}: the clocks' offset cannot be estimated: the photos have no positions of their own "
                             "and the log does "
                             "not mark at least three triggers; enter the offset")


def _by_position(log: FlightLog, photos: Sequence[Onboard], sigma_m: float) -> Offset:
    """Least squares of the distances between the photos' own positions and the flight line, over every possible offset."""
    times = np.array([p.time for p in photos], float)
    own = np.array([[p.lon, p.lat] for p in photos], float)
    low, high = log.time[0] - times.min(), log.time[-1] - times.max()
    if high < low:
        raise DegenerateGeometry(f"{log.name}: the photos were taken over a longer time than the log lasts; give the whole log")

    def cost(offset: np.ndarray) -> np.ndarray:
        at = np.atleast_1d(offset)[:, None] + times
        d = np.stack([np.interp(at, log.time, log.degrees[:, k]) for k in (0, 1)], -1) - own
        east, north = EARTH * np.radians(d[..., 0]) * np.cos(np.radians(own[:, 1])), EARTH * np.radians(d[..., 1])
        return (east**2 + north**2).sum(axis=1) / sigma_m**2

    step = max(min(float(np.median(np.diff(log.time))), 0.5), (high - low) / 200_000)
    grid = np.arange(low, high + step, step)
    values = np.concatenate([cost(part) for part in np.array_split(grid, max(len(grid) // 20_000, 1))])
    k = int(np.argmin(values))
    best, width = float(grid[k]), step
    for _ in range(40):
        near = best + width * np.linspace(-1, 1, 9)
        best, width = float(near[int(np.argmin(cost(near)))]), width / 2
    h = max(step, 0.2)
    curvature = float((cost(np.array([best + h])) - 2 * cost(np.array([best])) + cost(np.array([best - h])))[0]) / h**2
    if not curvature > 0:
        raise DegenerateGeometry(f"{log.name}: the positions do not tell the clocks' offset (the aircraft stood still); enter it")
    sigma = float(np.sqrt(2 / curvature))
    far = np.abs(grid - best) > 8 * sigma + 2 * step
    least = float(cost(np.array([best]))[0])
    if far.any() and values[far].min() < least + 9:
        other = float(grid[far][int(np.argmin(values[far]))])
        raise DegenerateGeometry(f"{log.name}: two offsets of the clocks fit alike, {best:.1f} s and {other:.1f} s; enter the "
                                 "right one")
    return Offset(best, sigma, f"{len(photos)} photo positions")


def _by_triggers(triggers: np.ndarray, times: np.ndarray, name: str) -> Offset:
    """The run of triggers whose intervals are those of the photos; a missed trigger or photo shows as a large residual."""
    order = np.sort(times)
    runs = np.stack([triggers[k:k + len(order)] - order for k in range(len(triggers) - len(order) + 1)])
    spread = np.sqrt(((runs - runs.mean(axis=1, keepdims=True)) ** 2).sum(axis=1) / (len(order) - 1))
    best = int(np.argmin(spread))
    second = np.delete(spread, best).min(initial=np.inf)
    if spread[best] > 1.0 or second < 2 * max(float(spread[best]), 0.05):
        raise DegenerateGeometry(f"{name}: the intervals between photos do not tell which triggers are theirs (best fit "
                                 f"{spread[best]:.2f} s, next "
                                 f"{second:.2f} s); enter the clocks' offset")
    sigma = max(float(spread[best]), 0.01) / np.sqrt(len(order))
    return Offset(float(runs[best].mean()), float(sigma), f"{len(order)} triggers")


def _metres(step: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(n, 3) east, north, up of small steps in longitude, latitude [degrees] and height, heights that are unknown left out."""
    east = EARTH * np.radians(step[:, 0]) * np.cos(np.radians(at[:, 1]))
    return np.stack([east, EARTH * np.radians(step[:, 1]), np.nan_to_num(step[:, 2])], 1)
