"""Where the orthogonal bundle begins: from the values at hand, or, where repeating its transformation runs away, from the
perspective solution; and how a false fixed point is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...adjustment import Options, solve
from ...errors import BadProject, DegenerateGeometry
from .given import Given
from .orthogonal import OrthogonalBundle, orthogonal
from .problem import Bundle

BUNDLE = Options(max_iterations=60, max_trials=20, step_tolerance=1e-6, cost_tolerance=1e-13)
FIXED_POINT = Options.gauss_newton(max_iterations=150, step_tolerance=1e-7)
AIMED = Options.gauss_newton(max_iterations=30, step_tolerance=1e-7)
PERSPECTIVE = "the perspective projection (--model perspective, or Projection in the tab Bundle)"
FITS = 1.3
"""sigma0 below which a fixed point is not suspected to be a false one."""


def orthogonal_start(perspective: Bundle, x0: np.ndarray, data: Given,
                     loss: Options) -> tuple[OrthogonalBundle, np.ndarray, Options, list[str]]:
    """The orthogonal twin of a bundle, its transformation iterated or frozen, where and how it is iterated (loss: with a robust
    loss, frozen), and what to know of it.

    Raises BadProject where other interior parameters than c are free, DegenerateGeometry where a large network leaves more than
    its datum free.
    """
    net, request = perspective.network, data.request
    others = [p for free in net.free for p in free if p != "c"]
    if others:
        raise BadProject(f"the orthogonal model can free the principal distance c only, not {', '.join(dict.fromkeys(others))}; "
                         "take --model perspective for them")
    x0 = softened(perspective, x0)
    dense = None if request.compiled is None else not request.compiled
    problem = orthogonal(net, perspective, x0, request.transform == "frozen", dense)
    if problem.extra and problem.sparse:
        raise DegenerateGeometry(f"{data.block.name}: beyond the seven of the datum, {problem.extra} or more combinations of "
                                 "unknowns stay free in the orthogonal network (stereo pairs do not determine the angle between "
                                 "their rays); give points a third image, take control or --model perspective")
    warnings: list[str] = []
    if problem.extra:
        warnings.append(f"beyond the seven of the datum, {problem.extra} combination(s) of unknowns stay free in the orthogonal "
                        "network (a stereo pair does not determine the angle between its rays: depths may be deformed); held as "
                        "the start values have them. Take a third image, control or " + PERSPECTIVE)
    if problem.frozen:
        return problem, x0, loss if request.loss else BUNDLE, warnings
    options = FIXED_POINT if request.loss is None else replace(FIXED_POINT, step_tolerance=1e-4)
    last = solve(problem, x0, options).last
    if last.stop == "step" and (problem.extra or not _far_off(last.cost, problem, perspective, last.x)):
        return problem, x0, options, warnings
    why = "does not settle" if last.stop != "step" else "settles at a false fixed point"
    better = solve(perspective, x0, BUNDLE).last.x
    for other, how in ((problem, options), (replace(problem, aimed=True), AIMED)):
        end = solve(other, better, how).last
        if end.stop == "step" and not _far_off(end.cost, problem, perspective, end.x):
            aimed = " and every step was aimed at the fixed point" if other is not problem else ""
            warnings.append(f"repeating the transformation {why} from these start values: it was begun at the perspective "
                            f"solution{aimed}")
            return other, better, how, warnings
    warnings.append(f"repeating the transformation {why}: the orthogonal model is for narrow fields of view and objects with "
                    "relief; take " + PERSPECTIVE)
    return problem, x0, options, warnings


def _far_off(cost: float, problem: OrthogonalBundle, perspective: Bundle, x: np.ndarray) -> bool:
    """Whether the perspective model, from a fixed point x, falls to a far lower cost: then it is a false one."""
    if problem.dof < 1 or 2 * cost / problem.dof < FITS**2:
        return False
    best = solve(perspective, x, replace(BUNDLE, max_iterations=15)).last.cost
    return cost > 2 * best + 5 * np.sqrt(2 * problem.dof)


def false_fixed_point(problem: OrthogonalBundle, x: np.ndarray) -> list[str]:
    """What to say of a solution that is a false fixed point."""
    plain = Bundle.of(problem.network, problem.inner)
    if problem.frozen or problem.extra or not _far_off(plain.cost(x), problem, plain, x):
        return []
    return ["false fixed point: the perspective model, from the same values, has far smaller residuals; do not use, take "
            + PERSPECTIVE]


def softened(problem: Bundle, x0: np.ndarray) -> np.ndarray:
    """Where a loss begins: losses that forget far observations would forget all at a crude start, so Huber's goes first, unless
    one mark far off drags it to where the loss itself is worse than at the start."""
    if problem.network.loss in (None, "huber"):
        return x0
    gentle = type(problem).of(replace(problem.network, loss="huber"), problem.inner, problem.compiled is None)
    last = solve(gentle, x0, replace(BUNDLE, step_tolerance=0.01)).last
    return last.x if np.isfinite(last.cost) and problem.cost(last.x) < problem.cost(x0) else x0
