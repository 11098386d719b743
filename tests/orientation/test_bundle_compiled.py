"""The compiled bundle: the same steps, the same statistics as the plain path, for any number of threads."""

from dataclasses import replace

import numpy as np
import pytest

from solvers.adjustment import solve
from solvers.cameras import Forward
from solvers.orientation.bundle import Bundle, BundleRequest, adjust, prepare_bundle
from solvers.orientation.bundle.compiled import Compiled
from solvers.orientation.bundle.statistics import defects, statistics
from solvers.simulation import calibration_plate, uav_block

ALL_TEN = ("c", "xp", "yp", "k1", "k2", "k3", "p1", "p2", "b1", "b2")


def fixed(block):
    return replace(block, points=replace(block.points, sigma=np.zeros_like(block.points.sigma)))


def forward(block):
    """The same block seen by a forward camera."""
    ten = (35.0, 0.05, -0.03, -0.02, 0.01, -0.005, 1e-4, -2e-4, 1e-4, -1e-4)
    lens = Forward(*ten, pixel_mm=23.5 / 6000, width=6000, height=4000)
    return replace(block, cameras={"camera": lens})


@pytest.mark.parametrize(("request_", "change"), [
    (BundleRequest(free=ALL_TEN, loss="huber"), forward),
    (BundleRequest(), None), (BundleRequest(free=ALL_TEN, datum="both"), None), (BundleRequest(free=ALL_TEN), fixed),
    (BundleRequest(free=ALL_TEN, loss="huber"), None), (BundleRequest(free=ALL_TEN, loss="cauchy"), None),
    (BundleRequest(free=ALL_TEN, loss="danish"), None),
    (BundleRequest(free=("c", "xp", "yp", "k1"), per_image=("xp", "yp")), None),
    (BundleRequest(datum="free", free=("c", "xp", "yp"), per_image=("xp", "yp")), None),
    (BundleRequest(datum="free", free=ALL_TEN), None)])
def test_it_agrees_with_the_plain_path(request_, change):
    block = calibration_plate(5).block
    start = prepare_bundle(change(block) if change else block, request_)
    plain, x0 = replace(start.problem, compiled=None), start.x0
    u = len(plain.normal(x0).gradient)
    x = plain.retract(x0, 3 * np.random.default_rng(1).normal(size=u) / plain.normal(x0).scale)
    wanted = plain.normal(x)
    for threads in (1, 3):
        fast = replace(plain, compiled=Compiled(plain.network, threads))
        got = fast.normal(x)
        assert fast.cost(x) == pytest.approx(plain.cost(x), rel=1e-9)
        np.testing.assert_allclose(got.gradient / wanted.scale, wanted.gradient / wanted.scale, rtol=0,
                                   atol=1e-8 * np.abs(wanted.gradient / wanted.scale).max())
        if not plain.inner:
            np.testing.assert_allclose(got.scale, wanted.scale, rtol=1e-9)
            for damping in (1e-3, 1e-8):
                a, b = (n.step(damping)[0] * wanted.scale for n in (wanted, got))
                np.testing.assert_allclose(b, a, atol=1e-6 * np.abs(a).max())
    a, b = solve(plain, x0, start.options), solve(fast, x0, start.options)
    assert a.converged and b.converged and b.last.cost == pytest.approx(a.last.cost, rel=1e-8)
    x = a.last.x
    one, two = statistics(plain, x), statistics(fast, x)
    for name in ("poses", "interior", "points", "redundancy", "w", "cross"):
        p, q = getattr(one, name), getattr(two, name)
        np.testing.assert_allclose(q, p, rtol=1e-6, atol=1e-6 * np.nanmax(np.abs(p), initial=0.0), err_msg=name)


def test_a_point_behind_a_camera_costs_infinitely_much():
    start = prepare_bundle(calibration_plate(5).block, BundleRequest(compiled=True))
    x = start.x0.copy()
    x[2] = -5.0
    assert np.isinf(start.problem.cost(x)) and np.isinf(replace(start.problem, compiled=None).cost(x))


def test_rank_defects_are_named_by_both_paths():
    block = calibration_plate(5).block
    of = block.observations
    keep = (of.image != 3) | (of.point < 2)
    poor = replace(block, observations=replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep],
                                               sigma=of.sigma[keep]))
    start = prepare_bundle(poor, BundleRequest(datum="control", start="prior"))
    for problem in (Bundle.of(start.problem.network, None, True), Bundle.of(start.problem.network, None, False)):
        named = defects(problem, start.x0)
        assert len(named) == 2 and all("plate4" in text for text in named)


def test_a_block_of_forty_images_with_everything():
    sim = uav_block(2, strips=5, images=8, ties=1500, side=0.6, fine=False)
    got = adjust(sim.block, free=("c", "xp", "yp", "k1"), datum="both")
    assert got.trace.converged and got.sigma0 is not None and 0.95 < got.sigma0 < 1.05
    assert got.check_rms is not None and (got.check_rms < 0.15).all()
    assert abs(got.interiors["nex"].c - 35.0) < 5 * got.interior_sigma["nex"]["c"]
    assert sum(r for _, r in got.groups.values()) == pytest.approx(got.dof, rel=1e-6)
