"""Tracks measured anew by least squares matching: one photo shows the template, all others are matched to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import PhotogrammetryError
from .lsm import LsmOptions, match_lsm

_CORRELATION = 0.6
"""Least correlation of a place that is searched for."""
_TILE = 2048
"""px, side of the parts of a photo that are filtered at a time: a photo as splines is four to eight times as large as its file's
pixels."""
Reader = Callable[[str], np.ndarray]
"""read(name) -> grey (rows, cols) or colour (rows, cols, 3) values of a photo"""


@dataclass(frozen=True)
class Target:
    """What is looked for in one photo. row (N,) of the reference's points; start (N, 2) px; shape (N, 2, 2) template -> target
    offsets; search: px around the start, 0 where a feature was matched there."""

    name: str
    row: np.ndarray
    start: np.ndarray
    shape: np.ndarray
    search: int = 0


@dataclass(frozen=True)
class Reference:
    """One photo with the templates at (N, 2) px, the photos to match, and the reductions at which that is tried in turn."""

    name: str
    at: np.ndarray
    targets: tuple[Target, ...]
    levels: tuple[int, ...] = (1,)


@dataclass(frozen=True)
class Refined:
    """Of each target: (N, 2) px, NaN where the match is refused, sigma (N,) px and score (N,); why: photos that failed."""

    pixel: tuple[np.ndarray, ...]
    sigma: tuple[np.ndarray, ...]
    score: tuple[np.ndarray, ...]
    why: dict[str, str]


def refine(reference: Reference, read: Reader, window: int, options: LsmOptions) -> Refined:
    """Conjugate points of one photo's templates in the others, photo by photo: two photos are in memory at a time.

    What the finest level refuses, for want of texture or because leaves moved, is tried at the next coarser one.
    """
    pixel = [np.full((len(t.row), 2), np.nan) for t in reference.targets]
    sigma = [np.full(len(t.row), np.nan) for t in reference.targets]
    score = [np.full(len(t.row), np.nan) for t in reference.targets]
    why: dict[str, str] = {}
    try:
        template = _pyramid(read(reference.name), reference.levels)
    except (PhotogrammetryError, OSError) as error:
        return Refined(tuple(pixel), tuple(sigma), tuple(score), {reference.name: str(error)})
    photo: list[np.ndarray] = []
    for n, target in enumerate(reference.targets):
        try:
            if n == 0 or reference.targets[n - 1].name != target.name:
                photo = []  # the one before goes first
                photo = _pyramid(read(target.name), reference.levels)
        except (PhotogrammetryError, OSError) as error:
            photo, why[target.name] = [], str(error)
        for level, a, b in zip(reference.levels, template, photo, strict=False):  # no photo, no levels
            rest = np.flatnonzero(np.isnan(score[n]) & _sound(target.shape))
            at, start = _coarser(reference.at[target.row[rest]], level), _coarser(target.start[rest], level)
            for part in _tiles(at, start):
                k = rest[part]
                found = match_lsm(a, b, at[part], start[part], window, search=-(-target.search // level), threshold=_CORRELATION,
                                  shape=target.shape[k], options=replace(options, max_move=max(options.max_move / level, 2.0)))
                good = k[found.ok]
                pixel[n][good] = (found.pixel[found.ok] + 0.5) * level - 0.5
                sigma[n][good], score[n][good] = found.sigma[found.ok].max(1) * level, found.score[found.ok]
    return Refined(tuple(pixel), tuple(sigma), tuple(score), why)


def _pyramid(image: np.ndarray, levels: tuple[int, ...]) -> list[np.ndarray]:
    """The photo, 1, 2 .. times smaller."""
    import cv2

    rows, cols = image.shape[:2]
    return [image if n == 1 else cv2.resize(image[: rows // n * n, : cols // n * n], (cols // n, rows // n),
                                            interpolation=cv2.INTER_AREA) for n in levels]


def _tiles(at: np.ndarray, start: np.ndarray) -> list[np.ndarray]:
    """Indices of points that lie in the same part of both photos, part by part."""
    part = np.floor(np.hstack([at, start]) / _TILE).astype(int)
    _, which = np.unique(part, axis=0, return_inverse=True)
    return [np.flatnonzero(which == k) for k in range(which.max(initial=-1) + 1)]


def _coarser(pixel: np.ndarray, level: int) -> np.ndarray:
    return (pixel + 0.5) / level - 0.5


def similarity(scale: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(N, 2, 2) offsets from ratios of feature sizes and differences of feature angles."""
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def _sound(shape: np.ndarray) -> np.ndarray:
    """(N,) shapes that a template may take: finite, not turned over, 0.4 to 2.5 times as large."""
    det = np.linalg.det(np.nan_to_num(shape))
    return np.isfinite(shape).all((1, 2)) & (det > 0.16) & (det < 6.25)
