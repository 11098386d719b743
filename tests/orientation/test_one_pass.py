"""One orthogonal pass: the error of an uncertain approximation comes through as predicted, also beyond the linear leak."""

from dataclasses import replace

import numpy as np
import pytest

from solvers.adjustment import Options, solve
from solvers.cameras import project
from solvers.geometry import Exterior, exp, log
from solvers.orientation import Orthogonal, PriorOrientation, resect_orthogonal
from solvers.orientation.one_pass import one_pass_covariance, one_pass_error
from solvers.orientation.single import Request, conclude, prepare
from tests.synthetic import SEED_CAMERA, SEED_EXTERIOR, block_of, cluster, prior_of

NOISE = 0.3


def model(printed: bool, relief: float) -> Orthogonal:
    points = cluster((8.0, 5.0), 4, 6.0, relief)
    return Orthogonal(SEED_CAMERA, points, project(SEED_CAMERA, SEED_EXTERIOR, points),
                      np.broadcast_to(np.eye(2) * NOISE**2, (4, 2, 2)), "printed" if printed else "depth", not printed)


def prior(degrees: float) -> PriorOrientation:
    return PriorOrientation.of(SEED_EXTERIOR, np.diag([25.0] * 3 + [np.radians(degrees) ** 2] * 3))


def tilt(covariance: np.ndarray) -> float:
    return float(np.degrees(np.sqrt(covariance[3, 3] + covariance[4, 4])))


def scatter(problem: Orthogonal, degrees: float, runs: int, rng: np.random.Generator) -> float:
    """Root mean square tilt error of passes through drawn approximations."""
    sigma, errors = np.array([5.0] * 3 + [np.radians(degrees)] * 3), []
    for _ in range(runs):
        d = sigma * rng.standard_normal(6)
        given = Exterior(exp(d[3:]) @ SEED_EXTERIOR.m, SEED_EXTERIOR.centre + d[:3])
        one = replace(problem, pixels=problem.pixels + NOISE * rng.standard_normal((4, 2)), frozen=given)
        x = solve(one, one.start(one.affine_of(given)), Options.gauss_newton(30)).last.x
        errors.append(log(Exterior.from_vector(x).m @ SEED_EXTERIOR.m.T))
    return float(np.degrees(np.sqrt((np.array(errors)[:, :2] ** 2).sum(axis=1).mean())))


def test_small_errors_come_through_linearly() -> None:
    problem = model(False, 5.0)
    leak, c0 = problem.statistics(SEED_EXTERIOR), np.diag([0.01] * 3 + [np.radians(0.05) ** 2] * 3)
    near = PriorOrientation.of(SEED_EXTERIOR, c0)
    np.testing.assert_allclose(one_pass_error(problem, SEED_EXTERIOR, near), leak.noise + leak.leak @ c0 @ leak.leak.T, rtol=0.02,
                               atol=1e-3 * np.abs(leak.noise).max())
    assert not one_pass_covariance(problem, SEED_EXTERIOR, near)[1]


def test_re_centred_passes_scatter_as_the_linear_leak_says() -> None:
    problem = model(False, 5.0)
    leak, c0 = problem.statistics(SEED_EXTERIOR), np.diag([25.0] * 3 + [np.radians(2.5) ** 2] * 3)
    assert "simulated" not in one_pass_covariance(problem, SEED_EXTERIOR, prior(2.5))[1]
    expected = tilt(leak.noise + leak.leak @ c0 @ leak.leak.T)
    assert scatter(problem, 2.5, 150, np.random.default_rng(4)) == pytest.approx(expected, rel=0.2)


def test_where_the_printed_form_leaves_linear_theory_it_is_said() -> None:
    """Far from the centre over flat ground, with a tilt known to 2.5 degrees."""
    assert "simulated" in one_pass_covariance(model(True, 0.0), SEED_EXTERIOR, prior(2.5))[1]
    assert not one_pass_covariance(model(True, 0.0), SEED_EXTERIOR, prior(0.1))[1]
    block = block_of(cluster((8.0, 5.0), 4, 6.0, 0.0), SEED_EXTERIOR, noise_px=0.3, prior=prior_of(SEED_EXTERIOR, 2.5, 5.0))
    got = resect_orthogonal(block, "a", one_pass=True, form="printed", recentre=False)
    assert any("simulated passes" in w for w in got.warnings)
    fine = resect_orthogonal(block, "a", one_pass=True)
    assert not any("simulated passes" in w for w in fine.warnings)


def test_where_linear_theory_ends_the_prediction_is_simulated() -> None:
    """The printed form far from the centre over flat ground: passes scatter by 11 degrees, and it is foreseen."""
    rng, errors, stated = np.random.default_rng(6), [], []
    points = cluster((8.0, 5.0), 4, 6.0, 0.0)
    for seed in range(12):
        given = prior_of(SEED_EXTERIOR, 2.5, 5.0, rng)
        block = block_of(points, SEED_EXTERIOR, noise_px=NOISE, seed=seed, prior=given)
        start = prepare(block, Request("a", "orthogonal", one_pass=True, form="printed", recentre=False))
        off = Exterior.from_vector(start.trace.last.x).angles - SEED_EXTERIOR.angles
        errors.append(np.degrees(np.hypot(off[0], off[1])))
        if seed < 2:
            stated.append(tilt(conclude(start, start.trace).covariance))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(stated), rel=0.4)
