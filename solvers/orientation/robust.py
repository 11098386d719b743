"""Which control points are blunders: consensus over three-point orientations, a robust adjustment of all points from
there, then data snooping to the end."""

from __future__ import annotations

import numpy as np

from ..adjustment import Options, precision
from ..adjustment.losses import LOSSES
from ..cameras import project
from ..errors import DegenerateGeometry
from ..geometry import Exterior
from .control import Control
from .initial import candidates, three_points
from .resection import Resection
from .steps import run

CONSENSUS = 6.0
"""Residual length, in standard deviations, that still counts as agreeing with a three-point orientation."""
REJECT = 5.0
"""Length of the standardized two-dimensional residual beyond which a point is a blunder (chance of a good one: 4e-6)."""
_SEED = 1981  # Fischler & Bolles


def inliers(control: Control, loss: str = "danish", trials: int = 400) -> np.ndarray:
    """(n,) which points agree with one orientation; loss: one of `adjustment.losses.LOSSES`.

    Reference: Fischler & Bolles 1981; Chum et al. 2003 (local optimization); Baarda 1968 (data snooping).

    Raises DegenerateGeometry when no orientation has the agreement of at least four points.
    """
    n = len(control)
    if n < 5:
        return np.ones(n, bool)
    mean = control.points.mean(axis=0)
    points, xy, c = control.points - mean, control.interior.ideal(control.pixels), control.interior.c
    rng = np.random.default_rng(_SEED)
    best, best_score = np.zeros(n, bool), np.inf
    for _ in range(trials):
        rows = rng.choice(n, 3, replace=False)
        for exterior in three_points(points[rows], xy[rows], c):
            r2 = _squared(control, exterior, mean)
            score = float(np.minimum(r2, CONSENSUS**2).sum())
            if score < best_score:
                keep = r2 < (3 * CONSENSUS) ** 2  # three points carry their own noise far: widen, then refine
                if keep.sum() < 4:
                    continue
                refined = candidates(points[keep], xy[keep], c)
                if refined:
                    r2 = np.minimum(r2, _squared(control, refined[0].exterior, mean))
                    score = float(np.minimum(_squared(control, refined[0].exterior, mean), CONSENSUS**2).sum())
                    if score < best_score:
                        best_score, best = score, _squared(control, refined[0].exterior, mean) < CONSENSUS**2
        share = max(best.mean(), 3 / n)
        if _ >= np.log(1e-6) / np.log(max(1 - share**3, 1e-12)) and best_score < np.inf:
            break
    if best.sum() < 4:
        raise DegenerateGeometry(f"image '{control.image}': no four control points agree with one orientation; "
                                 "check point names, pixel order and the camera")
    return _snoop(control, _reweighted(control, best, loss))


def _reweighted(control: Control, used: np.ndarray, loss: str, rounds: int = 10) -> np.ndarray:
    """(n,) the points that keep more than half their weight in a robust adjustment of all, begun at the agreeing ones."""
    some = control.take(used)
    mean = some.points.mean(axis=0)
    found = candidates(some.points - mean, some.interior.ideal(some.pixels), some.interior.c)
    if not found:
        return used
    at = found[0].exterior.shifted(-mean)
    factor = np.where(used, 1.0, 0.0)
    for _ in range(rounds):
        live = factor > 1e-3
        if live.sum() < 4:
            return used
        part, weight = control.take(live), factor[live]
        problem = Resection(part.interior, part.points, part.pixels, part.weights(at) * weight[:, None, None])
        at = Exterior.from_vector(run(problem, problem.start(at), Options()).last.x)
        before, factor = factor, LOSSES[loss](np.sqrt(_squared(control, at, np.zeros(3))))
        if np.abs(factor - before).max() < 1e-3:
            break
    return factor > 0.5 if (factor > 0.5).sum() >= 4 else used


def _squared(control: Control, exterior: Exterior, mean: np.ndarray) -> np.ndarray:
    """(n,) squared residual lengths in units of their standard deviation; inf behind the camera."""
    at = exterior.shifted(-mean)
    v = control.pixels - project(control.interior, at, control.points)
    v = np.where(np.isfinite(v), v, 1e9)
    return np.einsum("na,nab,nb->n", v, control.weights(), v)


def _snoop(control: Control, used: np.ndarray) -> np.ndarray:
    """Take in every point that the others confirm, leave out the worst that they refuse, until nothing changes."""
    seen = set()
    while used.tobytes() not in seen:
        seen.add(used.tobytes())
        some = control.take(used)
        mean = some.points.mean(axis=0)
        found = candidates(some.points - mean, some.interior.ideal(some.pixels), some.interior.c)
        if not found:
            return used
        at = found[0].exterior.shifted(-mean)
        problem = Resection(some.interior, some.points, some.pixels, some.weights(at))
        x = run(problem, problem.start(at), Options()).last.x
        test = _tests(control, used, problem, x)
        refused = used & (test > REJECT)
        if refused.any() and used.sum() > 4:
            used = used.copy()
            used[np.argmax(np.where(refused, test, -np.inf))] = False
            continue
        joined = used | (~used & (test < REJECT))
        if (joined == used).all():
            return used
        used = joined
    return used


def _tests(control: Control, used: np.ndarray, problem: Resection, x: np.ndarray) -> np.ndarray:
    """(n,) length of each point's residual over its own standard error: of the residual where it took part in the
    adjustment, of the prediction where it did not."""
    stats = precision(problem.linear(x), f"image '{control.image}': the robust orientation")
    whole = Resection(control.interior, control.points, control.pixels, control.weights(Exterior.from_vector(x)))
    linear = whole.linear(x)
    computed = linear.j @ stats.covariance @ np.swapaxes(linear.j, 1, 2)
    sigma = np.linalg.inv(linear.p)
    cov = np.where(used[:, None, None], sigma - computed, sigma + computed)
    v = np.where(np.isfinite(linear.v), linear.v, 1e9)
    values, vectors = np.linalg.eigh(cov)
    checked = values > 1e-6 * sigma.max(axis=(1, 2))[:, None]
    along = np.einsum("nab,na->nb", vectors, v)
    return np.sqrt(np.where(checked, along**2 / np.where(checked, values, 1.0), 0.0).sum(axis=1))
