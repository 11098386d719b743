"""Tracks measured anew by least squares matching: one photo shows the template, all others are matched to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import PhotogrammetryError
from .lsm import LsmOptions, match_lsm
from .patches import Photo, prepare

_CORRELATION = 0.6
"""Least correlation of a place that is searched for."""
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
        template = _pyramid(read(reference.name), reference.levels, options.smooth)
    except (PhotogrammetryError, OSError) as error:
        return Refined(tuple(pixel), tuple(sigma), tuple(score), {reference.name: str(error)})
    photo: list[Photo] = []
    for n, target in enumerate(reference.targets):
        try:
            if n == 0 or reference.targets[n - 1].name != target.name:
                photo = _pyramid(read(target.name), reference.levels, options.smooth)
        except (PhotogrammetryError, OSError) as error:
            photo, why[target.name] = [], str(error)
        for level, a, b in zip(reference.levels, template, photo, strict=False):  # no photo, no levels
            rest = np.flatnonzero(np.isnan(score[n]) & _sound(target.shape))
            found = match_lsm(a, b, _coarser(reference.at[target.row[rest]], level), _coarser(target.start[rest], level), window,
                              search=-(-target.search // level), threshold=_CORRELATION, shape=target.shape[rest],
                              options=replace(options, max_move=max(options.max_move / level, 2.0)))
            good = rest[found.ok]
            pixel[n][good] = (found.pixel[found.ok] + 0.5) * level - 0.5
            sigma[n][good], score[n][good] = found.sigma[found.ok].max(1) * level, found.score[found.ok]
    return Refined(tuple(pixel), tuple(sigma), tuple(score), why)


def _pyramid(image: np.ndarray, levels: tuple[int, ...], smooth: float) -> list[Photo]:
    """The photo, 1, 2 .. times smaller, ready for matching."""
    import cv2

    rows, cols = image.shape[:2]
    smaller = (image if n == 1 else cv2.resize(image[: rows // n * n, : cols // n * n], (cols // n, rows // n),
                                               interpolation=cv2.INTER_AREA) for n in levels)
    return [prepare(picture, smooth) for picture in smaller]


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
