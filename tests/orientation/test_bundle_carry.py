"""The datum of weak priors, found anew in every iteration: few rows, the same minimum, no image residual touched."""

from dataclasses import replace

import numpy as np
import pytest

from solvers.adjustment import solve
from solvers.block import Prior
from solvers.geometry import exp
from solvers.orientation.bundle import BundleRequest, prepare_bundle
from solvers.orientation.bundle.adjust import BUNDLE
from solvers.orientation.bundle.carry import Carried, Datum
from solvers.orientation.bundle.datum import moved
from solvers.orientation.bundle.problem import Bundle
from solvers.orientation.bundle.statistics import statistics
from solvers.simulation import uav_block
from tests.checks import central
from tests.orientation.test_bundle_extras import everything


def weakly_placed(seed: int = 3):
    """A block that GPS places to metres and no angle turns, its tie points measured to a tenth of a pixel."""
    block = uav_block(seed, strips=2, images=3, ties=60, control=6, checks=3, fine=False).block
    images = tuple(replace(i, prior=Prior(i.prior.centre, None, np.array([5.0, 5.0, 10.0]))) for i in block.images if i.prior)
    return replace(block, images=images, observations=replace(block.observations, sigma=0.1 * np.ones(len(block.observations))))


def test_a_start_of_wrong_scale_converges_in_few_rows_to_the_same_minimum() -> None:
    start = prepare_bundle(weakly_placed(), BundleRequest(datum="prior"))
    assert isinstance(start.problem, Carried)
    far = moved(start.problem.network, start.x0, 1.6, exp(np.radians([10.0, -15.0, 30.0])), np.array([40.0, -30.0, 60.0]))
    got = solve(start.problem, far, start.options)
    assert got.converged and len(got) - 1 <= 10
    plain = Bundle(start.problem.network, None, start.problem.compiled)
    slow = solve(plain, far, replace(BUNDLE, max_iterations=len(got) - 1))
    assert slow.last.cost > 1.001 * got.last.cost  # damping holds the datum back
    long = solve(plain, got.last.x, replace(BUNDLE, max_iterations=50))
    assert got.last.cost == pytest.approx(long.last.cost, rel=1e-6)
    one, two = statistics(plain, got.last.x), statistics(plain, long.last.x)
    np.testing.assert_allclose(one.poses, two.poses, rtol=1e-2, atol=1e-3 * np.abs(two.poses).max())
    off = (got.last.x - long.last.x)[:12 * len(plain.network.images)].reshape(-1, 12)[:, :3]
    assert (np.abs(off) < 5e-3 * np.sqrt(np.einsum("nii->ni", two.poses)[:, :3])).all()


def test_the_datum_as_a_problem_agrees_with_differences_and_touches_no_image() -> None:
    start = prepare_bundle(everything(), BundleRequest(datum="prior", free=("c",)))
    problem, net = Datum(start.problem), start.problem.network
    x = moved(net, start.x0, 1.1, exp(np.array([0.05, -0.1, 0.2])), np.array([3.0, -2.0, 4.0]))
    normal = problem.normal(x)
    h = 1e-4 / normal.scale
    slope = central(lambda e: np.array(problem.cost(problem.retract(x, e))), 7, h)
    np.testing.assert_allclose(slope * h, -normal.gradient * h, rtol=1e-4, atol=1e-6 * np.abs(normal.gradient * h).max())
    assert isinstance(start.problem, Carried)
    there = start.problem.carried(x)
    assert problem.cost(there) < 0.5 * problem.cost(x)
    np.testing.assert_allclose(start.problem.residuals(there), start.problem.residuals(x), atol=1e-6)
