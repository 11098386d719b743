"""The one adjustment engine: Levenberg-Marquardt, Gauss-Newton as its special case, Helmert constraints, every row seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .normal import Normal
from .trace import Iteration, Trace


class Problem(Protocol):
    """What the engine adjusts. The problem owns its parameters and its tangent."""

    @property
    def dof(self) -> int:
        """Redundancy: observations + constraints - unknowns."""
        ...

    def cost(self, x: np.ndarray) -> float:
        """Half the weighted sum of squared residuals at x; inf or NaN where x is impossible (a point behind the camera)."""
        ...

    def constraints(self, x: np.ndarray) -> np.ndarray:
        """(k,) misclosure h(x) of the equality constraints; (0,) where there are none."""
        ...

    def normal(self, x: np.ndarray) -> Normal:
        """Normal equations at x."""
        ...

    def retract(self, x: np.ndarray, dx: np.ndarray) -> np.ndarray:
        """The parameters reached from x by the tangent step dx."""
        ...


@dataclass(frozen=True)
class Options:
    """How to iterate. damping 0 with `accept_all` is plain Gauss-Newton (and any fixed-point iteration)."""

    max_iterations: int = 50
    max_trials: int = 12  # proposals per iteration before giving up
    damping: float = 1e-4  # first Levenberg-Marquardt lambda, relative to the unit diagonal of the scaled N
    step_tolerance: float = 1e-8  # standard deviations
    gradient_tolerance: float = 1e-11  # scaled gradient, relative to the residuals (a cosine)
    cost_tolerance: float = 1e-15  # relative fall of the cost
    shift_tolerance: float = 0.0  # standard errors (all unknowns free, times sigma0) that the last step moves any of them by
    accept_all: bool = False  # Gauss-Newton: take every finite step, never damp

    @classmethod
    def gauss_newton(cls, max_iterations: int = 50, step_tolerance: float = 1e-8) -> Options:
        """Undamped: every step is taken."""
        return cls(max_iterations=max_iterations, damping=0.0, step_tolerance=step_tolerance, accept_all=True)


def iterate(problem: Problem, x0: np.ndarray, options: Options | None = None) -> Iterator[Iteration]:
    """Rows of the adjustment, from the start (row 0) to the row that carries the stop reason, which is always yielded.

    Asking for the next row is the step; to cancel, stop asking. With constraints, steps are judged by the cost plus an
    exact penalty on the misclosure. Reference: Marquardt 1963; Nielsen 1999 (damping); Mikhail 1970 (bordering).
    """
    options = options or Options()
    x, cost, misclosure = np.array(x0, float), problem.cost(x0), problem.constraints(x0)
    first = max(cost, 1.0)
    if not np.isfinite(cost):
        yield Iteration(0, x, cost, np.nan, np.nan, np.nan, options.damping, 0, "diverged")
        return
    normal, damping, growth, penalty = problem.normal(x), options.damping, 2.0, 0.0
    yield Iteration(0, x, cost, _sigma0(cost, problem.dof), np.nan, _gradient(normal, cost), damping, 0)
    for index in range(1, options.max_iterations + 1):
        stop, fall, used, trial, length, reach, settled = None, -np.inf, damping, 0, np.nan, np.nan, False
        proposal, new_cost, new_misclosure = x, cost, misclosure
        for trial in range(1, options.max_trials + 1):
            used = damping
            dx, multipliers = normal.step(damping)
            length = float(np.sqrt(_dot(scaled := dx * normal.scale, scaled) / len(dx)))
            reach = length if trial == 1 else reach
            proposal = problem.retract(x, dx) if np.isfinite(length) else x
            new_cost = problem.cost(proposal) if np.isfinite(length) else np.inf
            new_misclosure = problem.constraints(proposal)
            if np.isfinite(new_cost):
                penalty = max(penalty, 2 * float(np.abs(multipliers).max(initial=0.0)))
                fall = cost - new_cost + penalty * float(np.abs(misclosure).sum() - np.abs(new_misclosure).sum())
            if options.accept_all:
                fall = fall if np.isfinite(new_cost) and new_cost < 1e15 * first else -np.inf
                break
            if fall >= 0:
                held = damping * _dot(scaled, scaled) / 2  # what damping keeps back
                expected = _dot(dx, normal.gradient) / 2 + held
                settled = _settled(expected, held, cost, problem.dof, options.shift_tolerance)
                ratio = fall / expected if expected > 0 else 1.0
                damping, growth = damping * max(1 / 3, 1 - (2 * min(ratio, 1.0) - 1) ** 3), 2.0
                break
            damping, growth = max(damping, 1e-9) * growth, growth * 2
        if fall < 0 and not (options.accept_all and np.isfinite(fall)):
            # Nothing better was found: at the minimum to round-off, or truly stuck.
            done = not options.accept_all and (_gradient(normal, cost) < 1e-7 or reach < 1e-6)
            yield Iteration(index, x, cost, _sigma0(cost, problem.dof), 0.0, _gradient(normal, cost), used, trial,
                            "cost" if done else "diverged")
            return
        relative = fall / cost if cost > 0 else 0.0
        x, cost, misclosure = proposal, new_cost, new_misclosure
        del normal  # never two of them in memory
        normal = problem.normal(x)
        gradient = _gradient(normal, cost)
        if length <= options.step_tolerance or settled:
            stop = "step"
        elif not options.accept_all and gradient <= options.gradient_tolerance and not misclosure.any():
            stop = "gradient"
        elif not options.accept_all and 0 <= relative <= options.cost_tolerance and used < 1e-2:
            stop = "cost"
        elif index == options.max_iterations:
            stop = "max_iterations"
        yield Iteration(index, x, cost, _sigma0(cost, problem.dof), length, gradient, used, trial, stop)
        if stop:
            return


def solve(problem: Problem, x0: np.ndarray, options: Options | None = None,
          manifest: Mapping[str, Any] | None = None) -> Trace:
    """Run `iterate` to its end. Not converging is a result: look at `trace.converged` and `trace.last.stop`."""
    return Trace(tuple(iterate(problem, x0, options)), dict(manifest or {}))


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    """Their product, without BLAS, which would wake its threads for long vectors and let them wait in a busy loop."""
    return float((a * b).sum())


def _settled(expected: float, held: float, cost: float, dof: int, tolerance: float) -> bool:
    """Whether no unknown moves by more than `tolerance` of its standard error times sigma0: the largest such shift, squared, is
    at most dx^T N dx, twice the fall that is expected. Damping must have kept back next to nothing."""
    return 0 < expected <= 0.5 * tolerance**2 * 2 * cost / max(dof, 1) and held <= 0.1 * expected


def _sigma0(cost: float, dof: int) -> float:
    return float(np.sqrt(2 * cost / dof)) if dof > 0 else float("nan")


def _gradient(normal: Normal, cost: float) -> float:
    """Largest cosine between the residual vector and a column of the Jacobian: 0 at the minimum, whatever the units."""
    size = float(np.sqrt(max(2 * cost, 0.0)))
    return float(np.abs(normal.gradient / normal.scale).max(initial=0.0)) / size if size > 0 else 0.0
