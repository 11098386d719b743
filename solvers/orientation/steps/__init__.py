"""One image, compiled: the same rows as the engine's on a plain perspective resection, and many starts improved together."""

from __future__ import annotations

from functools import lru_cache
from types import ModuleType

import numpy as np

from ...adjustment import Iteration, Options, Trace, solve
from ...cameras import Interior
from ...cameras.distortion import fold
from ...compiled import kernels as load
from ..resection import Resection

KINDS = {"correction": 1.0, "forward": 2.0}
WHY = ("step", "gradient", "cost", "max_iterations", "diverged")
_FLIP = np.array([1.0, -1.0, -1.0])  # photo frame <-> camera frame of the kernels (x right, y down, z forward)


def run(problem: Resection, x0: np.ndarray, options: Options) -> Trace:
    """`adjustment.solve(problem, x0, options)`, compiled where nothing but the orientation is sought and no prior joins."""
    if problem.free or problem.prior is not None or options.accept_all or problem.interior.kind not in KINDS:
        return solve(problem, x0, options)
    most, dof = options.max_iterations, problem.dof
    x, scalars = np.empty((most + 1, 12)), np.empty((most + 1, 5))
    x[0] = x0
    limits = np.array([options.damping, options.step_tolerance, options.gradient_tolerance, options.cost_tolerance])
    count, why = _compiled().iterate(*_given(problem), limits, most, options.max_trials, x, scalars, np.empty((2, 16, 7)))
    cost = scalars[:count, 0]
    sigma0 = np.sqrt(2 * np.where(np.isfinite(cost), cost, np.nan) / dof) if dof > 0 else np.full(count, np.nan)
    ends = [None] * (count - 1) + [WHY[why]]
    return Trace(tuple(
        Iteration(i, x[i].copy(), cost, s, step, gradient, damping, int(trials), end)
        for i, ((cost, step, gradient, damping, trials), s, end) in enumerate(zip(scalars[:count].tolist(), sigma0.tolist(), ends,
                                                                                   strict=True))))


def costs(problem: Resection, xs: list[np.ndarray]) -> list[float]:
    """`problem.cost` at several places; inf where a point cannot be seen."""
    if problem.free or problem.prior is not None or problem.interior.kind not in KINDS:
        return [problem.cost(x) for x in xs]
    given, kernel, room = _given(problem), _compiled().linearised, np.empty((15, 6))
    return [kernel(*given, np.ascontiguousarray(x), room[:6], room[6], room[7:9]) for x in xs]


def improve(points: np.ndarray, xy: np.ndarray, c: float, m: np.ndarray, t: np.ndarray, steps: int, patience: int,
            far: float) -> np.ndarray:
    """Starts that see M X + t, m (k, 3, 3) and t (k, 3), improved in place; their costs (k,), unit of c squared."""
    n, count = len(points), len(m)
    y = np.empty((6, n))
    y[:3], y[3], y[4], y[5] = points.T, xy[:, 0] / c, xy[:, 1] / -c, c
    r, s, cost = m * _FLIP[:, None], t * _FLIP, np.empty(count)
    room = np.empty((count + 2, 6, 6))
    _compiled().together(y, n, r, s, cost, steps, patience, far, room[0], room[2:], room[1], np.empty((count, 6)), np.empty(6),
                        np.empty((3, 3)), np.empty(3), np.empty(count, bool), np.empty(count))
    m[:], t[:] = r * _FLIP[:, None], s * _FLIP
    return cost


def parallel(reduced: np.ndarray, xy: np.ndarray, c: float, along: np.ndarray, axes: np.ndarray, signs: list[float],
             updates: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(M, t) of each solution by parallel projection that exists, M X + t seen; see `initial.scaled_orthography`."""
    out, depth, kernel = [], np.empty(len(reduced)), _compiled().parallel
    for sign in signs:
        m, t = np.empty((3, 3)), np.empty(3)
        if kernel(reduced, xy, c, along, axes, sign, updates, m, t, depth):
            out.append((m, t))
    return out


def _compiled() -> ModuleType:
    return load("solvers.orientation.steps._kernels", "the resection of single images")


def _given(problem: Resection) -> tuple[np.ndarray, ...]:
    arrays = (np.ascontiguousarray(a, float) for a in (problem.points, problem.pixels, problem.weights))
    return (*arrays, camera_row(problem.interior))


@lru_cache(maxsize=64)
def camera_row(i: Interior) -> np.ndarray:
    """(16,) a camera as the kernels take it."""
    kind = KINDS[i.kind] if i.coefficients.any() else 0.0
    middle = [(i.width - 1) / 2, (i.height - 1) / 2]
    return np.array([*i.parameters, *i.pitch, *middle, fold(i.k1, i.k2, i.k3), kind])
