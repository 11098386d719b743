"""Exposure and vignetting of all photos, solved jointly from what overlapping photos show of the same places.

ln(grey of photo a) - ln(grey of photo b) = e_a + v(r_a) - e_b - v(r_b): e an exposure per photo, v one polynomial in r^2, r^4,
r^6 for each camera. Linear least squares with weights after Huber; the exposures add up to nothing but for
a common shift that keeps the lights from being clipped. Reference: Goldman 2010,
"Vignette and exposure calibration and compensation".
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import DegenerateGeometry
from .survey import Look, Survey
from .tones import Tone, radial

MOST = 400
"""Places compared for each pair of photos, at most, ..."""
ALL = 300_000
"""... and of all pairs, but never fewer than 20 of one."""
_DARK, _LIGHT, _FULL = 12.0, 243.0, 245.0


@dataclass(frozen=True)
class Tones:
    """A tone for each photo; before, after: rms of the differences of ln(grey) in the overlaps; places: compared."""

    tones: tuple[Tone, ...]
    before: float
    after: float
    places: int


def solve_tones(survey: Survey, count: int, cameras: tuple[int, ...]) -> Tones:
    """Tones of `count` photos, whose cameras are numbered; photos without overlap keep theirs.

    Raises DegenerateGeometry when no two photos overlap.
    """
    from scipy.sparse import coo_array, diags_array
    from scipy.sparse.linalg import spsolve

    rows = _differences(survey)
    if not len(rows.difference):
        raise DegenerateGeometry("no two photos overlap: there is nothing to even out their brightness by; leave --gain out")
    kinds = max(cameras) + 1
    n, of = count + 3 * kinds, np.array(cameras)
    m = len(rows.difference)
    columns = [rows.first, rows.second, *(count + 3 * of[k] + j for k in (rows.first, rows.second) for j in range(3))]
    values = [np.ones(m), -np.ones(m), *rows.radial_first.T, *-rows.radial_second.T]
    a = coo_array((np.concatenate(values), (np.tile(np.arange(m), 8), np.concatenate(columns))), shape=(m, n)).tocsr()
    weight, x, v, scale = np.ones(m), np.zeros(n), np.zeros(m), 1.0
    prior = np.concatenate([np.full(count, 1e-3), np.full(3 * kinds, 1e-2 * m / max(count, 1) / 100)])
    for _ in range(8):
        w = diags_array(weight) @ a
        x = np.asarray(spsolve((a.T @ w + diags_array(prior)).tocsc(), w.T @ rows.difference))
        v = np.abs(rows.difference - a @ x)
        scale = max(1.4826 * float(np.median(v)), 1e-4)
        weight = np.minimum(1.0, 1.5 * scale / np.maximum(v, 1e-12))
    x[:count] -= x[:count].mean()
    good = v < 3 * scale
    before, after = (float(np.sqrt((d[good] ** 2).mean())) for d in (rows.difference, rows.difference - a @ x))
    touched = np.bincount(np.concatenate([rows.first, rows.second]), minlength=count) > 0
    tones = tuple(Tone(float(x[k]) if touched[k] else 0.0, _three(x[count + 3 * of[k]:]))
                  for k in range(count))
    return Tones(_unclipped(survey, tones), before, after, m)


def _unclipped(survey: Survey, tones: tuple[Tone, ...]) -> tuple[Tone, ...]:
    """All tones shifted alike, so that photos made brighter do not lose their lights: the overlaps tell nothing of the level."""
    over = []
    for k in survey.looks:
        factor = tones[k.number].factor(k.photo, *np.moveaxis(k.pixels(), -1, 0))
        light = k.colours.max(-1).astype(np.float32)
        over.append((np.log(np.maximum(light * factor, 1.0) / np.maximum(light, _FULL)))[k.seen][::7])
    shift = max(float(np.percentile(np.concatenate(over), 99)), 0.0)
    return tuple(replace(t, exposure=t.exposure + shift) for t in tones)


def _three(x: np.ndarray) -> tuple[float, float, float]:
    return float(x[0]), float(x[1]), float(x[2])


@dataclass(frozen=True)
class _Rows:
    first: np.ndarray
    second: np.ndarray
    difference: np.ndarray
    radial_first: np.ndarray
    radial_second: np.ndarray


def _differences(survey: Survey) -> _Rows:
    grey = {k.number: _smooth(k) for k in survey.looks}
    parts: list[tuple[np.ndarray, ...]] = []
    pairs = [(a, b, both) for i, a in enumerate(survey.looks) for b in survey.looks[i + 1:] if (both := overlap(a, b))]
    most = int(np.clip(ALL // max(len(pairs), 1), 20, MOST))
    for a, b, (in_a, in_b) in pairs:
        ga, gb = grey[a.number][in_a], grey[b.number][in_b]
        ok = np.isfinite(ga) & np.isfinite(gb) & (ga > _DARK) & (gb > _DARK) & (ga < _LIGHT) & (gb < _LIGHT)
        at = np.flatnonzero(ok)
        if len(at) < 20:
            continue
        at = at[np.linspace(0, len(at) - 1, min(most, len(at))).astype(int)]
        parts.append((np.full(len(at), a.number), np.full(len(at), b.number), np.log(ga.ravel()[at] / gb.ravel()[at]),
                      *(_radial(k, window, at) for k, window in ((a, in_a), (b, in_b)))))
    if not parts:
        none = np.empty(0, int)
        return _Rows(none, none, np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
    return _Rows(*(np.concatenate(p) for p in zip(*parts, strict=True)))


def _radial(look: Look, window: tuple[slice, slice], at: np.ndarray) -> np.ndarray:
    """(k, 3) `radial` at places, counted through in a window of a look."""
    rows, columns = np.divmod(at, window[1].stop - window[1].start)
    return radial(look.photo, *look.pixels_of(rows + window[0].start, columns + window[1].start).T)


def _smooth(look: Look) -> np.ndarray:
    """Grey of a look, a mean over some cells, NaN near its edges."""
    import cv2

    grey = cv2.blur(look.colours.mean(-1), (5, 5))
    whole = cv2.erode(look.seen.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0)
    return np.where(whole > 0, grey, np.nan).astype(np.float32)


def overlap(a: Look, b: Look) -> tuple[tuple[slice, slice], tuple[slice, slice]] | None:
    """The common window of two looks, as slices of each; None where there is none."""
    top, left = max(a.tile.top, b.tile.top), max(a.tile.left, b.tile.left)
    bottom = min(a.tile.top + a.tile.height, b.tile.top + b.tile.height)
    right = min(a.tile.left + a.tile.width, b.tile.left + b.tile.width)
    if bottom <= top or right <= left:
        return None
    return tuple((slice(top - k.tile.top, bottom - k.tile.top), slice(left - k.tile.left, right - k.tile.left))
                 for k in (a, b))  # pyright: ignore[reportReturnType]
