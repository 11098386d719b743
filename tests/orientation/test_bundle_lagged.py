"""Rolling shutter: derivatives, truth, covariance by Monte Carlo, free networks, words."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solvers import BadProject, Block
from solvers.adjustment import solve
from solvers.cameras import project
from solvers.geometry import Exterior, exp
from solvers.orientation.bundle import BundleRequest, adjust, prepare_bundle
from solvers.orientation.bundle.lagged import Lagged
from solvers.orientation.bundle.problem import Bundle
from solvers.orientation.bundle.statistics import statistics
from solvers.simulation import uav_block
from tests.checks import check_jacobian, chi_square_band

READOUT_MS = 30.0
SIGMA_V = 1.0


def flown(seed: int, noise: float = 1.0, rate: float = 0.0, control: int = 6,
          known: bool = True, jerk: float = 0.0) -> tuple[Block, dict[str, np.ndarray], Any]:
    """A small UAV block read row by row: each pixel is projected from where the camera is when its own row is read.

    jerk: rad/s by which the rates, that a gyroscope records, change from first to last row.
    """
    sim = uav_block(seed, strips=2, images=3, ties=60, control=control, checks=3, noise=0.0, fine=False)
    rng, block, of = np.random.default_rng([seed, 5]), sim.block, sim.block.observations
    pixel, truth, images = of.pixel.copy(), {}, []
    for i, image in enumerate(block.images):
        at, camera = sim.exteriors[image.name], sim.block.cameras[image.camera]
        v, w = np.array([0.0, 8.0, 0.0]) + rng.normal(0, 1.5, 3), rate * rng.normal(size=3)
        bend = jerk * rng.normal(size=3) / (READOUT_MS * 1e-3) / 2
        truth[image.name] = np.concatenate([v, w])
        for o in np.flatnonzero(of.image == i):
            row = of.pixel[o, 1]
            for _ in range(30):
                t = READOUT_MS * 1e-3 * (row - (camera.height - 1) / 2) / camera.height
                then = Exterior(exp(w * t) @ exp(bend * t * t) @ at.m, at.centre + v * t)
                pixel[o] = project(camera, then, sim.xyz[of.point[o]][None])[0]
                if abs(pixel[o, 1] - row) < 1e-11:
                    break
                row = pixel[o, 1]
        assert image.prior is not None
        prior = replace(image.prior, centre=at.centre + 0.05 * rng.normal(size=3), sigma_m=np.full(3, 0.05), angles=None,
                        sigma_rad=None, velocity=v + noise * rng.normal(0, SIGMA_V, 3), sigma_velocity=np.full(3, SIGMA_V))
        if jerk:
            prior = replace(prior, turning=np.outer((READOUT_MS * 1e-3 * np.linspace(-0.5, 0.5, 33)) ** 2, bend))
        images.append(replace(image, prior=prior if known else None))
    pixel += noise * rng.normal(size=pixel.shape) * block.image_px
    given = np.where(np.isfinite(block.points.sigma), block.points.sigma, block.control_m)
    xyz = block.points.xyz + noise * given * rng.normal(size=block.points.xyz.shape)
    block = replace(block, readout_ms={n: READOUT_MS for n in block.cameras}, points=replace(block.points, xyz=xyz))
    return replace(block, observations=replace(of, pixel=pixel), images=tuple(images)), truth, sim


@pytest.mark.parametrize(("how", "datum"), [("translation", "control"), ("rotation", "both")])
def test_jacobian_against_differences(how, datum) -> None:
    block, _, _ = flown(3, rate=0.3, jerk=1.0)
    start = prepare_bundle(block, BundleRequest(datum=datum, rolling_shutter=how, free=("c", "k1")))
    assert isinstance(start.problem.compiled, Lagged)
    plain = Bundle(start.problem.network)
    scale = plain.normal(start.x0).scale
    x = plain.retract(start.x0, np.random.default_rng(2).normal(size=len(scale)) / scale)
    check_jacobian(plain, x, rtol=5e-6)
    dense, sparse = plain.normal(x), start.problem.normal(x)
    scaled = dense.gradient / dense.scale
    np.testing.assert_allclose(sparse.gradient / dense.scale, scaled, atol=1e-7 * np.abs(scaled).max())
    np.testing.assert_allclose(sparse.step(1e-3)[0] * dense.scale, dense.step(1e-3)[0] * dense.scale, rtol=1e-5, atol=1e-6)
    one, two = statistics(plain, x), statistics(start.problem, x)
    for name in ("poses", "border", "points", "redundancy", "w", "cross"):
        p, q = getattr(one, name), getattr(two, name)
        np.testing.assert_allclose(q, p, rtol=1e-5, atol=1e-6 * np.nanmax(np.abs(p)), err_msg=name)


def test_truth_is_recovered_and_a_still_camera_is_told() -> None:
    block, truth, sim = flown(4, noise=0.0, rate=0.05)
    got = adjust(block, rolling_shutter="rotation")
    assert got.rms_px < 0.02  # what the rates' own prior pulls
    for o in got.orientations:
        assert np.abs(o.exterior.centre - sim.exteriors[o.image].centre).max() < 0.1
    block, truth, sim = flown(4, noise=0.0)
    got, still = adjust(block, rolling_shutter="translation"), adjust(block)
    assert got.rms_px < 1e-6 and still.rms_px > 0.3
    for o in got.orientations:
        np.testing.assert_allclose(o.exterior.centre, sim.exteriors[o.image].centre, atol=1e-5)
        np.testing.assert_allclose(got.motions[o.image][0], truth[o.image][:3], atol=1e-4)
    (said,) = [w for w in still.warnings if "rolling shutter: the camera moves by" in w]
    assert "(--rolling-shutter, or Rolling shutter in the tab Bundle)" in said  # right in both places
    assert not any("rolling shutter" in w for w in got.warnings)


def test_what_a_gyroscope_recorded_is_taken_in() -> None:
    block, _, sim = flown(7, noise=0.0, jerk=1.0)
    got, blind = adjust(block, rolling_shutter="auto"), adjust(forgetful(block), rolling_shutter="rotation")
    assert got.rms_px < 0.02 and blind.rms_px > 2  # what the even steps of the record leave
    assert len(next(iter(got.motions.values()))[0]) == 6
    for o in got.orientations:
        np.testing.assert_allclose(o.exterior.centre, sim.exteriors[o.image].centre, atol=0.05)
    assert not adjust(forgetful(block), rolling_shutter="auto").motions


def forgetful(block: Block) -> Block:
    return replace(block, images=tuple(replace(i, prior=replace(i.prior, turning=None)) for i in block.images if i.prior))


def monte_carlo(runs: int, seed: int) -> dict[str, np.ndarray]:
    """Squares, over their covariance, of the errors of one image's velocity and centre (3 each) and twice the cost, of many
    adjustments of one network: pixels, control and what is known of the velocities drawn anew each time."""
    rng = np.random.default_rng(seed)
    start = prepare_bundle(flown(51, noise=0.0, control=12)[0], BundleRequest(rolling_shutter="translation"))
    assert isinstance(start.problem, Bundle)
    true, net = solve(start.problem, start.x0, start.options).last.x, start.problem.network
    stats, first = statistics(start.problem, true), net.sizes[1] - net.extras.motions
    sd = np.where(net.weight > 0, 1 / np.sqrt(np.where(net.weight > 0, net.weight, 1.0)), 0.0)
    out = {name: np.empty(runs) for name in ("velocity", "centre", "cost")}
    for k in range(runs):
        motion = net.motion_at(true) + rng.normal(size=net.extras.motion_sigma.shape)[:, :3] * net.extras.motion_sigma[:, :3]
        drawn = replace(net, pixels=net.pixels + rng.normal(size=net.pixels.shape) * net.sigma[:, None],
                        known=net.known + sd * rng.normal(size=net.known.shape),
                        extras=replace(net.extras, motion=np.column_stack([motion, net.extras.motion[:, 3:]])))
        last = solve(Bundle.of(drawn), true, start.options).last
        i = k % len(net.images)
        columns = slice(first + 3 * i, first + 3 * i + 3)
        off = net.motion_at(last.x)[i] - net.motion_at(true)[i], net.split(last.x)[0][i, :3] - net.split(true)[0][i, :3]
        for name, v, q in zip(("velocity", "centre"), off, (stats.border[columns, columns], stats.poses[i, :3, :3]), strict=True):
            out[name][k] = v @ np.linalg.solve(q, v)
        out["cost"][k] = 2 * last.cost
    return out | {"dof": np.array(start.problem.dof)}


def test_covariance_by_monte_carlo() -> None:
    found = monte_carlo(60, 1)
    chi_square_band(found["velocity"], 3, 0.99)
    chi_square_band(found["centre"], 3, 0.99)
    chi_square_band(found["cost"], int(found["dof"]), 0.99)


def test_every_redundancy_is_counted_once() -> None:
    got = adjust(flown(50, control=12)[0], rolling_shutter="translation")
    assert sum(r for _, r in got.groups.values()) == pytest.approx(got.dof, abs=1e-4)


def test_a_free_network_keeps_its_datum_and_loses_the_misfit() -> None:
    block, _, _ = flown(6)
    got, still = adjust(block, datum="free", rolling_shutter="translation"), adjust(block, datum="free")
    assert got.trace.converged and got.sigma0 is not None and 0.85 < got.sigma0 < 1.15
    assert still.sigma0 is not None and still.sigma0 > 1.5 * got.sigma0
    assert sum(r for _, r in got.groups.values()) == pytest.approx(got.dof, abs=1e-3)


def test_refusals() -> None:
    block, _, _ = flown(6)
    with pytest.raises(BadProject, match="no camera has a readout time"):
        adjust(replace(block, readout_ms={}), rolling_shutter="translation")
    with pytest.raises(BadProject, match="knows no rolling shutter"):
        adjust(block, rolling_shutter="translation", model="orthogonal", datum="free")
