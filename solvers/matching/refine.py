"""Tracks measured anew by least squares matching: one photo shows the template, all others are matched to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import PhotogrammetryError
from .lsm import LsmOptions, match_lsm
from .patches import prepare

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
    """One photo with the templates at (N, 2) px, and the photos to match."""

    name: str
    at: np.ndarray
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class Refined:
    """Of each target: (N, 2) px, NaN where the match is refused, sigma (N,) px and score (N,); why: photos that failed."""

    pixel: tuple[np.ndarray, ...]
    sigma: tuple[np.ndarray, ...]
    score: tuple[np.ndarray, ...]
    why: dict[str, str]


def refine(reference: Reference, read: Reader, window: int, options: LsmOptions) -> Refined:
    """Conjugate points of one photo's templates in the others, photo by photo: two photos are in memory at a time."""
    pixel = [np.full((len(t.row), 2), np.nan) for t in reference.targets]
    sigma = [np.full(len(t.row), np.nan) for t in reference.targets]
    score = [np.full(len(t.row), np.nan) for t in reference.targets]
    why: dict[str, str] = {}
    photo, smooth = None, options.smooth
    try:
        template = prepare(read(reference.name), smooth)
    except (PhotogrammetryError, OSError) as error:
        return Refined(tuple(pixel), tuple(sigma), tuple(score), {reference.name: str(error)})
    for n, target in enumerate(reference.targets):
        try:
            photo = photo if photo and n and reference.targets[n - 1].name == target.name else prepare(read(target.name), smooth)
        except (PhotogrammetryError, OSError) as error:
            why[target.name] = str(error)
            continue
        some = np.flatnonzero(_sound(target.shape))
        found = match_lsm(template, photo, reference.at[target.row[some]], target.start[some], window, search=target.search,
                          threshold=_CORRELATION, shape=target.shape[some], options=options)
        pixel[n][some], sigma[n][some], score[n][some] = found.pixel, found.sigma.max(1), found.score
    return Refined(tuple(pixel), tuple(sigma), tuple(score), why)


def similarity(scale: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """(N, 2, 2) offsets from ratios of feature sizes and differences of feature angles."""
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def _sound(shape: np.ndarray) -> np.ndarray:
    """(N,) shapes that a template may take: finite, not turned over, 0.4 to 2.5 times as large."""
    det = np.linalg.det(np.nan_to_num(shape))
    return np.isfinite(shape).all((1, 2)) & (det > 0.16) & (det < 6.25)
