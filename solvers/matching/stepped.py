"""One match to be looked at: the correlation over its search window, every iteration of least squares matching, the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..adjustment import Iteration, Options, iterate
from ..errors import DegenerateGeometry
from . import batch
from .lsm import LsmOptions, match_lsm
from .ncc import flat_variance, match_ncc
from .patches import SMOOTH, Photo, prepare
from .problem import LsmProblem, lsm_problem, spline
from .result import LsmResult, NccResult, Status


class Patches(NamedTuple):
    """Windows (side, side) of grey values at one iteration: the template, the target warped onto it, template minus warped; and
    their correlation. NaN where the window has left the photo."""

    template: np.ndarray
    warped: np.ndarray
    difference: np.ndarray
    score: float


@dataclass(frozen=True, eq=False)
class Stepped:
    """One match with all between. at (2,) px in the template's photo; start (2,) where it was looked for; surface (2 search +
    1)^2 correlations, its middle at `middle` (2,) px, NaN where undefined; ncc, lsm: results of one point; problem and rows: the
    least squares matching as iterated from the correlation's best place, None and () where there was none to start from."""

    at: np.ndarray
    start: np.ndarray
    surface: np.ndarray
    middle: np.ndarray
    ncc: NccResult
    lsm: LsmResult
    problem: LsmProblem | None
    rows: tuple[Iteration, ...]

    @property
    def status(self) -> Status:
        return Status(int(self.lsm.status[0]))

    def patches(self, row: int) -> Patches | None:
        """What the match looks like at an iteration (the last one beyond the end)."""
        if self.problem is None or not self.rows:
            return None
        template = self.problem.template
        warped = self.problem.warped(self.rows[min(row, len(self.rows) - 1)].x)
        return Patches(template, warped, template - warped, correlation(template, warped))


def match_stepped(template_image: np.ndarray | Photo, target_image: np.ndarray | Photo, at: np.ndarray, start: np.ndarray,
                  window: int = 21, search: int = 12, *, threshold: float = 0.5, shape: np.ndarray | None = None,
                  options: LsmOptions | None = None) -> Stepped:
    """One point matched as `match_lsm` does, with what `match_lsm` does not keep. Arguments as there, at and start (2,).

    The rows are those of the engine on the same parameters as the result; the result's standard deviations alone know what
    smoothing does to the noise. Raises Unsupported for nonsense input.
    """
    options = options or LsmOptions()
    at, start = batch.points(at, "at")[:1], batch.points(start, "start")[:1]
    matrix = batch.shapes(shape, 1)
    half = batch.half_window(window)
    template, target = prepare(template_image, options.smooth), prepare(target_image, options.smooth)
    ncc = match_ncc(template, target, at, start, window, search, threshold, shape=matrix, uniqueness=2.0)
    lsm = match_lsm(template, target, at, start, window, search=search, threshold=threshold, shape=matrix, options=options)
    middle = np.floor(start[0] + 0.5)
    surface = correlations(template, target, at[0], middle, half, search, matrix[0])
    problem, rows = None, ()
    begin = ncc.pixel[0] if np.isfinite(ncc.pixel[0]).all() else None
    if begin is not None:
        if lsm.ok[0]:  # of rivals, the one that was taken
            places = np.vstack([begin, ncc.rival[0]])
            begin = places[np.nanargmin(np.linalg.norm(places - lsm.pixel[0], axis=1))]
        free = lsm.free[0] if lsm.free[0].any() else None
        try:
            problem, x0 = lsm_problem(template, target, at[0], begin, window, matrix[0], SMOOTH, free)
            rows = tuple(_rows(problem, x0, options))
        except DegenerateGeometry:
            problem = None
    return Stepped(at[0], start[0], surface, middle, ncc, lsm, problem, rows)


def _rows(problem: LsmProblem, x0: np.ndarray, options: LsmOptions) -> Iterator[Iteration]:
    """Iterations as far as the batch goes: to the first that moves the window's middle by less than `options.step`."""
    last = problem.middle(x0)
    for row in iterate(problem, x0, Options.gauss_newton(options.max_iterations)):
        middle = problem.middle(row.x)
        if row.index and np.abs(middle - last).max() < options.step:
            yield replace(row, stop="step")
            return
        last = middle
        yield row


def correlations(template: Photo, target: Photo, at: np.ndarray, middle: np.ndarray, half: int, search: int,
                 shape: np.ndarray) -> np.ndarray:
    """(2 search + 1)^2 correlations of the template, warped by `shape`, centred on whole pixels around `middle`."""
    v, u = np.mgrid[-half:half + 1, -half:half + 1].astype(float)
    back = np.linalg.inv(shape)
    f = spline(template, at[0] + back[0, 0] * u + back[0, 1] * v, at[1] + back[1, 0] * u + back[1, 1] * v)[0]
    reach = half + search
    row, col = np.mgrid[-reach:reach + 1, -reach:reach + 1].astype(float)
    g = spline(target, middle[0] + col, middle[1] + row)[0]
    windows = np.lib.stride_tricks.sliding_window_view(g, (2 * half + 1, 2 * half + 1))
    flat = flat_variance(template, target)
    textured = windows.var((2, 3)) > np.maximum(1e-7 * windows.mean((2, 3)) ** 2, flat)
    textured &= f.var() > max(1e-7 * f.mean() ** 2, flat)
    f, spread = f - f.mean(), windows.std((2, 3)) * f.std()
    return np.einsum("ijab,ab->ij", windows, f) / np.where(textured & (spread > 0), spread * f.size, np.nan)


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Of two windows of the same shape, NaN where one is flat or incomplete."""
    spread = a.std() * b.std()
    return float(((a - a.mean()) * (b - b.mean())).mean() / spread) if spread > 0 else float("nan")
