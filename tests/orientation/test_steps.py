"""The compiled twin of the engine: the same rows, for every camera, attitude and weight; starts improved to the same minima."""

import numpy as np
import pytest

from solvers import Exterior
from solvers.adjustment import Options, solve
from solvers.cameras import Forward, project
from solvers.geometry import exp
from solvers.orientation.resection import Resection
from solvers.orientation.steps import costs, run
from tests.checks import angle_between
from tests.synthetic import REAL_CAMERA, SEED_CAMERA, scene

FORWARD = Forward(35.0, 0.1, -0.2, -0.05, 0.02, 0.0, 1e-3, -2e-3, 1e-4, 2e-4, pixel_mm=0.004, width=6000, height=4000)


def problem_of(rng: np.random.Generator, camera, n: int = 9) -> tuple[Resection, Exterior]:
    points, at = scene(rng, n, 30)
    a = rng.normal(size=(n, 2, 2))
    weights = a @ np.swapaxes(a, 1, 2) + np.eye(2)  # full blocks
    return Resection(camera, points, project(camera, at, points) + rng.normal(size=(n, 2)), weights), at


@pytest.mark.parametrize("camera", [SEED_CAMERA, REAL_CAMERA, FORWARD], ids=["plain", "ten parameters", "forward"])
@pytest.mark.parametrize("seed", range(8))
def test_rows_are_those_of_the_engine(camera, seed):
    rng = np.random.default_rng(seed)
    problem, at = problem_of(rng, camera)
    off = Exterior(exp(0.2 * rng.normal(size=3)) @ at.m, at.centre + 30 * rng.normal(size=3))
    loose = Options(damping=1e-3, step_tolerance=0.1, gradient_tolerance=0.0, cost_tolerance=0.0)  # ends above round-off
    slow, fast = (f(problem, problem.start(off), loose) for f in (solve, run))
    assert len(slow) == len(fast) and slow.last.stop == fast.last.stop
    for a, b in zip(slow.rows, fast.rows, strict=True):
        assert np.allclose(a.x, b.x, rtol=0, atol=1e-7)
        assert (a.index, a.trials) == (b.index, b.trials)
        assert [a.cost, a.sigma0, a.damping] == pytest.approx([b.cost, b.sigma0, b.damping], rel=1e-6)
        assert [a.step, a.gradient] == pytest.approx([b.step, b.gradient], rel=1e-5, abs=1e-7, nan_ok=True)


def test_a_start_behind_the_camera_diverges_in_both():
    problem, at = problem_of(np.random.default_rng(1), SEED_CAMERA)
    x = problem.start(Exterior(np.diag([1.0, -1.0, -1.0]) @ at.m, at.centre))
    for trace in (solve(problem, x), run(problem, x, Options())):
        assert len(trace) == 1 and trace.last.stop == "diverged" and np.isnan(trace.last.sigma0)


def test_costs_are_the_problem_s():
    problem, at = problem_of(np.random.default_rng(2), REAL_CAMERA)
    xs = [problem.start(at), problem.retract(problem.start(at), np.array([1.0, 2, 3, 0.01, 0.02, 0.03]))]
    assert costs(problem, xs) == pytest.approx([problem.cost(x) for x in xs], rel=1e-9)


def test_freed_parameters_go_to_the_engine_and_many_points_end_alike():
    problem, at = problem_of(np.random.default_rng(3), SEED_CAMERA, 300)
    free = Resection(problem.interior, problem.points, problem.pixels, problem.weights, ("c",))
    assert run(free, free.start(at), Options()).last.x.shape == (13,)
    ends = [Exterior.from_vector(f(problem, problem.start(at), Options()).last.x) for f in (solve, run)]
    assert angle_between(*ends) < 1e-9
