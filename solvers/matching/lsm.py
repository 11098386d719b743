"""Least squares matching: conjugate points to a hundredth of a pixel, with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..compiled import kernels
from . import batch
from .ncc import match_ncc
from .patches import SMOOTH, Photo, smoothing
from .result import LsmResult, NccResult, Status

_SCORE, _ITERATIONS, _KEPT, _STATUS = 8, 13, 14, 15  # columns of the compiled batch
_PEAK_MOVE = 4.0  # px, a correlation's peak is never farther from the place
_MISLED = (Status.LOW_SCORE, Status.AT_BORDER, Status.DIVERGED, Status.NOT_CONVERGED)
_AWAY = 2.0  # px, a correlation's peak is another place than the adjusted one beyond that
_ALL = 63  # bits of the six geometric parameters
_SHAPE = 0.05  # standard deviation of shaping parameters that are held, where nothing else tells it
_TELLING = 10  # points that determine their shape tell how far off the shapes of others are
_CLEAR = 3.0  # times its residual variance, that others leave, make a place unique although not all others are adjusted


@dataclass(frozen=True)
class LsmOptions:
    """When a least squares match is done, and when it is refused."""

    max_iterations: int = 30
    step: float = 0.01  # px, the last correction; what is left after it is about a tenth
    max_sigma: float = 0.25  # px, largest standard deviation in any direction
    min_score: float = 0.6  # least correlation after the adjustment
    max_move: float = 10.0  # px from the start (of the adjustment, after a correlation)
    smooth: float = SMOOTH  # px, presmoothing of raw images
    min_gap: float = 1.35  # a rival place must leave this many times the residual variance, in a window of 21 px


def match_lsm(template_image: np.ndarray | Photo, target_image: np.ndarray | Photo, at: np.ndarray, start: np.ndarray,
              window: int = 21, *, search: int = 0, threshold: float = 0.5, shape: np.ndarray | None = None,
              options: LsmOptions | None = None, workers: int = 1) -> LsmResult:
    """Least squares matches of N points: six affine and two radiometric parameters each, in one compiled batch.

    at, start (N, 2) col, row (pixel centres are integers): window centres in the template image, approximate places in
    the target, within 1 to 2 px; with search (px) > 0 a normalized cross-correlation above `threshold` finds them first
    and places that another one rivals are refused. shape (2, 2) or (N, 2, 2): template -> target offsets where known.

    f(x0, y0) = r0 + (1 + r1) g(a1 + a2 x0 + a3 y0, b1 + b2 x0 + b3 y0), solved by inverse composition (the design matrix
    is the template's); shaping parameters that a window cannot determine are dropped. The covariance passes white pixel
    noise, of both images, through smoothing and solution and removes what noise adds to the normal matrix; where shaping
    parameters are dropped it allows for their being off by 0.05, or by as much as those of the other points together are.

    Raises Unsupported for nonsense input. Reference: Gruen 1985; Baker & Matthews 2004 (inverse composition).
    """
    options = options or LsmOptions()
    at, start = batch.points(at, "at"), batch.points(start, "start")
    matrices, half = batch.shapes(shape, len(at)), batch.half_window(window)
    margin = half + 2 + search + int(options.max_move)
    reach = int(np.ceil(half * max(1.0, np.abs(np.linalg.inv(matrices)).sum(2).max(initial=1.0)))) + 3
    wide = margin + int(np.ceil(half * np.abs(matrices).sum(2).max(initial=1.0)))
    if batch.is_sparse(template_image, at, reach) or batch.is_sparse(target_image, start, wide):
        parts = [match_lsm(template_image, target_image, at[i], start[i], window, search=search, threshold=threshold,
                           shape=matrices[i], options=options) for i in range(len(at))]
        return LsmResult(*(np.concatenate([getattr(part, name) for part in parts]) for name in LsmResult.__dataclass_fields__))
    template, corner = batch.cut(template_image, at, reach, options.smooth)
    target, origin = batch.cut(target_image, start, wide, options.smooth)
    at, start = at - corner, start - origin
    if search <= 0:
        return _result(_adjust(template, target, at, start, matrices, half, options, workers), origin)
    coarse = match_ncc(template, target, at, start, window, search, threshold, shape=matrices, uniqueness=2.0, workers=workers)
    return _result(_from_peaks(template, target, at, start, coarse, matrices, half, options, workers), origin)


def _from_peaks(template: Photo, target: Photo, at: np.ndarray, start: np.ndarray, coarse: NccResult, matrices: np.ndarray,
                half: int, options: LsmOptions, workers: int) -> np.ndarray:
    """(N, 16) rows adjusted from the correlation's best peaks; where rivals come near, from them too, and compared.

    Where turn and scale have misled the correlation, what is adjusted from a lesser peak or from the start itself counts when
    it leaves far less than all other places do.
    """
    options = replace(options, max_move=min(options.max_move, _PEAK_MOVE))
    best = np.full((len(at), 16), np.nan)
    best[:, _SCORE], best[:, _STATUS] = coarse.score, coarse.status
    best[:, _ITERATIONS] = best[:, _KEPT] = 0
    found = np.flatnonzero(coarse.ok)
    best[found] = _adjust(template, target, at[found], coarse.pixel[found], matrices[found], half, options, workers)
    border = coarse.status == Status.AT_BORDER
    which, rank = np.nonzero(np.isfinite(coarse.rival_score) & (coarse.ok | border)[:, None])
    rivals = np.full((len(at), coarse.rival_score.shape[1], 16), np.nan)
    rivals[which, rank] = _adjust(template, target, at[which], coarse.rival[which, rank], matrices[which], half, options, workers)
    gap = options.min_gap ** max(1.0, 10.5 / (half + 0.5))  # the logarithm of a variance scatters as 1 / the window's side
    rows = np.concatenate([best[:, None], rivals], axis=1)  # what was highest is a rival too of what is taken in its place
    for rival in np.moveaxis(rivals, 1, 0):
        best[:] = _better(best, rival, gap)
    others = _least_loss(best, rows)
    places = np.concatenate([coarse.peak[:, None], coarse.rival], axis=1)
    scores = np.concatenate([coarse.score[:, None], coarse.rival_score], axis=1)
    away = np.linalg.norm(places - best[:, None, :2], axis=2) > _AWAY  # rivals as correlated, where adjusting lost them
    others = np.fmin(others, np.fmin.reduce(np.where(away, 1 - scores**2, np.nan), axis=1))
    best[(best[:, _STATUS] == Status.OK) & (others < gap * _loss(best)), _STATUS] = Status.NOT_UNIQUE
    crowded = (coarse.count > coarse.rival_score.shape[1]) & (best[:, _STATUS] == Status.OK)
    best[crowded & ~(_CLEAR * _loss(best) < others), _STATUS] = Status.NOT_UNIQUE
    if (edge := np.flatnonzero(border & (best[:, _STATUS] == Status.OK))).size:
        row = _adjust(template, target, at[edge], coarse.peak[edge], matrices[edge], half, options, workers)
        others = np.fmin(_least_loss(best[edge], row[:, None]), 1 - coarse.score[edge] ** 2)
        best[edge[~(_CLEAR * _loss(best[edge]) < others)], _STATUS] = Status.AT_BORDER
    if (lost := np.flatnonzero(np.isin(best[:, _STATUS], _MISLED))).size:
        row = _adjust(template, target, at[lost], start[lost], matrices[lost], half, options, workers)
        others = np.fmin(_least_loss(row, rivals[lost]), 1 - np.maximum(coarse.score[lost], 0) ** 2)
        found = (row[:, _STATUS] == Status.OK) & (_CLEAR * _loss(row) < others)
        best[lost[found]] = row[found]
    return best


def _loss(rows: np.ndarray) -> np.ndarray:
    """Share of the template's variance that a match leaves."""
    return 1 - rows[..., _SCORE] ** 2


def _least_loss(best: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(N,) the least that others (N, k, 16) leave more than a pixel away, wherever they have come to; NaN where nothing is."""
    apart = np.linalg.norm(others[..., :2] - best[:, None, :2], axis=2) > 1.0
    return np.fmin.reduce(np.where(apart, _loss(others), np.nan), axis=1)


def _better(best: np.ndarray, rival: np.ndarray, gap: float) -> np.ndarray:
    """(N, 16) the better of two rows; not unique where both fit about as well at different places."""
    fits = np.isin(best[:, _STATUS], (Status.OK, Status.NOT_UNIQUE))
    also = rival[:, _STATUS] == Status.OK
    loss, other = _loss(best), _loss(rival)
    apart = np.linalg.norm(best[:, :2] - rival[:, :2], axis=1) > 1.0
    low, high = np.minimum(loss, other), np.maximum(loss, other)
    close = fits & also & apart & (high < gap * low)
    swap = also & ~(fits & (loss <= other))
    result = np.where(swap[:, None], rival, best)
    result[close, _STATUS] = Status.NOT_UNIQUE
    return result


def _adjust(template: Photo, target: Photo, at: np.ndarray, start: np.ndarray, matrices: np.ndarray, half: int,
            options: LsmOptions, workers: int) -> np.ndarray:
    """(N, 16) rows of the compiled batch.

    The template is taken at the whole pixel next to the point and the rest of the way carried through the adjusted affine:
    interpolated, a sharp photo's template is off by up to 0.05 px, the affine by a hundredth of the result's standard error.
    """
    whole = np.floor(at + 0.5)
    rest = (at - whole)[:, :, None]
    start = start - (matrices @ rest)[:, :, 0]
    match_batch = kernels("solvers.matching._kernels", "image matching").match_batch
    gains = smoothing(template.smooth)
    quantum = max(template.quantum, target.quantum)
    noise = (gains.value, gains.slope, gains.laplacian, gains.extra_value, gains.spread, quantum**2 / 12)
    out = np.empty((len(at), 16))

    def adjust(which: np.ndarray, doubt: float) -> None:
        limits = tuple(float(v) for v in (options.max_iterations, options.step, options.max_sigma, options.min_score,
                                          options.max_move, doubt))

        def kernel(part: slice) -> None:
            k = which[part]
            rows = np.empty((len(k), 16))
            match_batch(template.coefficients, target.coefficients, whole[k], start[k], matrices[k], half, gains.taps,
                        gains.extra, noise, limits, rows)
            out[k] = rows

        batch.spread(kernel, len(which), workers)

    adjust(np.arange(len(at)), _SHAPE**2)
    held = np.isin(out[:, _STATUS], (Status.OK, Status.UNCERTAIN)) & (out[:, _KEPT] < _ALL)
    if held.any() and (doubt := _doubt(out, matrices)) > 1.2 * _SHAPE**2:
        adjust(np.flatnonzero(held), doubt)
    out[:, :2] += (out[:, 2:6].reshape(-1, 2, 2) @ rest)[:, :, 0]
    return out


def _doubt(rows: np.ndarray, matrices: np.ndarray) -> float:
    """Variance of shaping parameters before they are adjusted, as the windows that determine all of them tell."""
    full = (rows[:, _STATUS] == Status.OK) & (rows[:, _KEPT] == _ALL)
    if full.sum() < _TELLING:
        return _SHAPE**2
    off = np.linalg.solve(matrices[full], rows[full, 2:6].reshape(-1, 2, 2)) - np.eye(2)
    return float(np.median(off**2, axis=0).max())


def _result(rows: np.ndarray, origin: np.ndarray) -> LsmResult:
    status = rows[:, _STATUS].astype(int)
    known = np.where((status == Status.OK)[:, None], rows[:, :13], np.nan)
    covariance = known[:, [9, 10, 10, 11]].reshape(-1, 2, 2)
    free = (np.nan_to_num(rows[:, _KEPT]).astype(int)[:, None] >> np.arange(6)) & 1 == 1
    return LsmResult(
        pixel=known[:, :2] + origin,
        sigma=np.sqrt(np.einsum("naa->na", covariance)),
        covariance=covariance,
        score=rows[:, _SCORE],
        status=status,
        shape=known[:, 2:6].reshape(-1, 2, 2),
        radiometric=known[:, 6:8] - [0, 1],
        noise=known[:, 12],
        iterations=rows[:, _ITERATIONS].astype(int),
        kept=free.sum(1),
        free=free,
    )
