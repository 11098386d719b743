"""One orthogonal pass through an uncertain approximation: its error where the linear leak no longer tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..adjustment import Options, Trace, solve
from ..cameras import project
from ..geometry import Exterior, exp, log
from .orthogonal import Orthogonal
from .resection import PriorOrientation

CERTAIN_DEG = 0.5
"""Length of a prior's rotation error below which its leak is linear."""
RUNS = 60
"""Simulated passes where it does not hold: their root mean square is good to a tenth."""
BENT = 2.0
"""Mean square over linear variance, in the worst direction, beyond which an error region counts as bent."""
PASS = Options.gauss_newton(max_iterations=8, step_tolerance=1e-3)


def one_pass_error(problem: Orthogonal, at: Exterior, prior: PriorOrientation) -> np.ndarray:
    """(6, 6) mean square of the error of (centre [m], left rotation vector [rad]) of one pass, its bias included.

    C_n + K Sigma_0 K^T is its linear part. What it holds beyond that shows where linear theory ends; a pass may still settle in
    another minimum, which neither foresees. Here the pass is run, without noise, through approximations on both ends of
    sqrt(3) sigma along six axes of the prior: exact in each axis to the fourth moment of the error, mixed moments left out. What
    comes of it all, other minima included, `simulated_error` tells.
    Reference: Julier & Uhlmann 2004, "Unscented filtering and nonlinear estimation", with kappa = 3 - n.
    """
    perfect = replace(problem, pixels=project(problem.interior, at, problem.points), frozen=None)
    axes = np.sqrt(3) * np.linalg.inv(prior.root)
    out = problem.statistics(at).noise.copy()
    for d in (*axes.T, *-axes.T):
        frozen = perfect.refrozen(Exterior(exp(d[3:]) @ at.m, at.centre + d[:3]))
        if not np.isfinite(frozen.cost(x := frozen.start(frozen.affine_of(at)))):
            return np.full((6, 6), np.inf)
        got = Exterior.from_vector(solve(frozen, x, PASS).last.x)
        error = np.concatenate([got.centre - at.centre, log(got.m @ at.m.T)])
        out += np.outer(error, error) / 6
    return out


def simulated_error(problem: Orthogonal, at: Exterior, prior: PriorOrientation, runs: int = RUNS) -> np.ndarray:
    """(6, 6) mean square of the error of (centre [m], left rotation vector [rad]) of one pass, simulated: noise and
    approximations are drawn, every start is run and the one with the smallest perspective residual kept, as the pass itself
    does. Bias and other minima are in it. For where linear theory does not hold."""
    rng, inverse = np.random.default_rng(2004), np.linalg.inv(prior.root)
    pixels, spread = project(problem.interior, at, problem.points), np.linalg.cholesky(problem.sigma)
    out, count = np.zeros((6, 6)), 0
    for _ in range(runs):
        d = inverse @ rng.standard_normal(6)
        noise = (spread @ rng.standard_normal((len(pixels), 2, 1)))[..., 0]
        given = Exterior(exp(d[3:]) @ at.m, at.centre + d[:3])
        drawn = replace(problem, pixels=pixels + noise, frozen=given)
        ends = [solve(drawn, x0, PASS) for x0 in drawn.starts()]
        got = Exterior.from_vector(min(ends, key=lambda end: _misfit(drawn, end)).last.x) if ends else given
        error = np.concatenate([got.centre - at.centre, log(got.m @ at.m.T)])
        if np.isfinite(error).all():
            out, count = out + np.outer(error, error), count + 1
    return out / count if count else np.full((6, 6), np.inf)


def _misfit(problem: Orthogonal, end: Trace) -> float:
    """Root mean square of the perspective residual at the end of a pass; inf behind the camera."""
    v = problem.pixels - project(problem.interior, Exterior.from_vector(end.last.x), problem.points)
    size = float(np.sqrt((v**2).mean()))
    return size if np.isfinite(size) else np.inf


def one_pass_covariance(problem: Orthogonal, at: Exterior, prior: PriorOrientation) -> tuple[np.ndarray, str]:
    """Covariance (6, 6) of (centre [m], left rotation vector [rad]) of one pass through a prior, and what is to be said of it.

    C_n + K Sigma_0 K^T where that holds. Where it misses a fifth of the mean square of the rotation error, simulated passes;
    where only the error region is bent, so that errors leave the linear ellipsoid sideways, the mean square with its bias.
    """
    inverse = np.linalg.inv(prior.root)
    c0, leak = inverse @ inverse.T, problem.statistics(at)
    linear = leak.noise + leak.leak @ c0 @ leak.leak.T
    if np.trace(c0[3:, 3:]) < np.radians(CERTAIN_DEG) ** 2:
        return linear, ""
    whole = one_pass_error(problem, at, prior)
    if not 0.8 < np.trace(whole[3:, 3:]) / np.trace(linear[3:, 3:]) < 1.2:
        return simulated_error(problem, at, prior), (
            f"the approximate orientation is too uncertain for linear error theory: the standard errors are those of {RUNS} "
            "simulated passes, bias included, and such errors are not normal; iterate, or re-centre and use the depth form")
    scale = np.sqrt(np.diag(linear))
    root = np.linalg.inv(np.linalg.cholesky(linear / np.outer(scale, scale)))
    if np.linalg.eigvalsh(root @ (whole / np.outer(scale, scale)) @ root.T)[-1] > BENT:
        return whole, ("the approximate orientation is uncertain enough to bend the error region of this pass: its bias is part "
                       "of the standard errors, and they are not those of a normal distribution")
    return linear, ""
