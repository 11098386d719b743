"""Scale bars, control known together, lever arms and shifts of GPS: derivatives, truth, statistics, both paths the same."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import BadProject, Block
from solvers.adjustment import solve
from solvers.block import Gps, ScaleBar, Together
from solvers.geometry import Exterior
from solvers.orientation.bundle import BundleRequest, adjust, prepare_bundle
from solvers.orientation.bundle.compiled import Compiled
from solvers.orientation.bundle.problem import Bundle
from solvers.orientation.bundle.statistics import statistics
from solvers.simulation import calibration_plate, field_long_range, uav_block
from tests.checks import check_jacobian, chi_square_band

TEN = ("c", "xp", "yp", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
LEVER = (0.4, -0.2, 0.3)
SHIFTS = {"A": np.array([1.0, -2.0, 0.5]), "B": np.array([-1.5, 0.3, 2.0])}


def flown(seed: int, noise: float = 1.0, control: int = 6, gps_m: float = 0.05, gps: Gps | None = None):
    """A small UAV block in two strips whose GPS sits beside the camera and is shifted for each strip."""
    sim = uav_block(seed, strips=2, images=3, ties=60, control=control, checks=3, noise=noise, gps_m=gps_m, fine=False)
    forward, right, down = LEVER
    rng, images = np.random.default_rng([seed, 9]), []
    for k, image in enumerate(sim.block.images):
        strip, true = "AB"[k // 3], sim.exteriors[image.name]
        antenna = true.centre - true.m.T @ np.array([right, forward, -down]) + SHIFTS[strip] + noise * rng.normal(0, gps_m, 3)
        assert image.prior is not None
        prior = replace(image.prior, centre=antenna, sigma_m=np.full(3, gps_m), sigma_rad=np.full(3, np.radians(2)))
        images.append(replace(image, strip=strip, prior=prior))
    return replace(sim.block, images=tuple(images), gps=gps or Gps(LEVER, "strip", 20.0)), sim


def barred(block: Block, xyz: np.ndarray, pairs, sigma: float, rng=None) -> Block:
    """Bars between points by name, with the true lengths."""
    at = dict(zip(block.points.names, xyz, strict=True))
    noise = 0.0 if rng is None else sigma * rng.normal(size=len(pairs))
    lengths = [float(np.linalg.norm(at[b] - at[a])) for a, b in pairs] + np.asarray(noise)
    return replace(block, scale_bars=tuple(ScaleBar(a, b, float(v), sigma) for (a, b), v in zip(pairs, lengths, strict=True)))


def together(block: Block, xyz: np.ndarray, names, common: float, own: float, rng=None) -> Block:
    """Control points that move together by `common` [m], each on its own by `own`."""
    q = own**2 * np.eye(3 * len(names)) + np.kron(np.ones((len(names), len(names))), common**2 * np.eye(3))
    e = np.zeros(3 * len(names)) if rng is None else rng.multivariate_normal(np.zeros(len(q)), q)
    rows = [block.points.names.index(n) for n in names]
    given = block.points.xyz.copy()
    given[rows] = xyz[rows] + e.reshape(-1, 3)
    return replace(block, points=replace(block.points, xyz=given), together=(Together(tuple(names), q),))


def everything(seed: int = 3, noise: float = 1.0) -> Block:
    block, sim = flown(seed, noise)
    names = sim.block.points.names
    return together(barred(block, sim.xyz, [(names[0], names[20]), (names[25], names[40])], 0.01), sim.xyz, names[1:4], 0.1,
                    0.02)


@pytest.mark.parametrize(("block", "request_"), [
    (everything(), BundleRequest(datum="both", free=("c", "k1"))), (everything(), BundleRequest(datum="control")),
    (everything(), BundleRequest(datum="prior", free=("c",)))])
def test_jacobian_against_differences(block: Block, request_: BundleRequest) -> None:
    start = prepare_bundle(block, request_)
    problem = Bundle(start.problem.network)
    scale = problem.normal(start.x0).scale
    check_jacobian(problem, problem.retract(start.x0, np.random.default_rng(2).normal(size=len(scale)) / scale), rtol=5e-6)


@pytest.mark.parametrize(("request_"), [
    BundleRequest(datum="both", free=("c", "k1")), BundleRequest(datum="control", loss="huber"), BundleRequest(datum="prior"),
    BundleRequest(datum="free", free=("c",))])
def test_the_compiled_path_gives_the_same(request_: BundleRequest) -> None:
    start = prepare_bundle(replace(everything(), gps=Gps(LEVER, "strip", 3.0)), request_)
    plain = replace(start.problem, compiled=None)
    fast = replace(plain, compiled=Compiled(plain.network, 2))
    wanted, got = plain.normal(start.x0), fast.normal(start.x0)
    scaled = wanted.gradient / wanted.scale
    np.testing.assert_allclose(got.gradient / wanted.scale, scaled, rtol=0, atol=1e-8 * np.abs(scaled).max())
    a, b = solve(plain, start.x0, start.options), solve(fast, start.x0, start.options)
    assert a.converged and b.converged and b.last.cost == pytest.approx(a.last.cost, rel=1e-8)
    one, two = statistics(plain, a.last.x), statistics(fast, a.last.x)
    for name in ("poses", "interior", "points", "border", "redundancy", "w"):
        p, q = getattr(one, name), getattr(two, name)
        loose = 2e-3 if request_.datum == "prior" else 1e-6  # a block as a whole known to metres, its parts to millimetres
        np.testing.assert_allclose(q, p, rtol=1e-5, atol=loose * np.nanmax(np.abs(p), initial=0.0), err_msg=name)


def test_truth_is_recovered_to_round_off() -> None:
    block, sim = flown(4, noise=0.0)
    block = together(barred(block, sim.xyz, [("G0001", "T0013")], 0.01), sim.xyz, ("G0002", "G0003"), 0.1, 0.02)
    got = adjust(block, datum="both")
    assert got.cost == pytest.approx(0.5 * sum((s**2).sum() for s in SHIFTS.values()) / 20**2, rel=1e-2)  # the shifts' own
    for name, shift in SHIFTS.items():
        np.testing.assert_allclose(got.shifts[name][0], shift, atol=2e-4)
    for o in got.orientations:
        assert np.abs(o.exterior.centre - sim.exteriors[o.image].centre).max() < 1e-4


def test_a_shift_left_unsaid_spoils_the_block_and_shows() -> None:
    block, _ = flown(5)
    good, bad = adjust(block, datum="both"), adjust(replace(block, gps=Gps(LEVER)), datum="both")
    assert good.groups["GPS"][0] is not None and 0.5 < good.groups["GPS"][0] < 1.5
    assert bad.groups["GPS"][0] is not None and bad.groups["GPS"][0] > 5


def test_shifts_and_sums_of_squares_by_monte_carlo() -> None:
    errors, sums, dof = [], [], 0
    for seed in range(10):
        block, sim = flown(seed + 100, control=4)
        rng = np.random.default_rng(seed)
        block = barred(block, sim.xyz, [("T0012", "T0015")], 0.01, rng)
        block = together(block, sim.xyz, ("G0001", "G0002"), 0.1, 0.02, rng)
        got = adjust(block, datum="both")
        value, covariance = got.shifts["A"]  # of one run they share their control: only one of them counts
        errors.append((value - SHIFTS["A"]) @ np.linalg.solve(covariance, value - SHIFTS["A"]))
        sums.append(2 * got.cost)
        assert sum(r for _, r in got.groups.values()) == pytest.approx(got.dof, abs=1e-4)
        dof = got.dof - 6  # the shifts are not drawn from their own sigma
    chi_square_band(np.array(errors), 3, 0.999)
    chi_square_band(np.array(sums), dof, 0.999)


def test_a_bar_gives_a_free_network_its_scale() -> None:
    sim = field_long_range(2, noise=0.0)
    names, true = sim.block.points.names, sim.xyz
    shrunk = replace(sim.block, points=replace(sim.block.points, xyz=sim.block.points.xyz * 0.9))
    got = adjust(barred(shrunk, true, [(names[0], names[27])], 0.001), datum="free")
    at = {p.name: p.xyz for p in got.points}
    length = np.linalg.norm(at[names[3]] - at[names[20]])
    assert length == pytest.approx(np.linalg.norm(true[3] - true[20]), rel=1e-6)
    assert got.groups["scale bars"][1] == pytest.approx(0.0, abs=1e-6)  # it alone knows the scale: nothing checks it


def test_interiors_of_every_image_on_its_own() -> None:
    sim = calibration_plate(6, noise=0.0)
    block = replace(sim.block, cameras=dict(sim.cameras))  # what stays fixed is true: every image's own c comes out
    got = adjust(block, free=("c",), per_image=True, datum="control")
    assert got.trace.converged and all(abs(i.c - sim.cameras["camera"].c) < 1e-3 for i in got.interiors.values())
    assert len(got.interiors) == 8 and set(got.interior_sigma) == {f"camera@plate{i}" for i in range(1, 9)}
    one = adjust(block, free=("c",))
    mixed = adjust(block, free=("c", "xp"), per_image=("xp",))  # c of the camera, xp of every image
    assert mixed.interior_names[0] == ("camera", "c") and len(mixed.interior_names) == 9
    assert len({i.c for i in mixed.interiors.values()}) == 1 and len({i.xp for i in mixed.interiors.values()}) == 8
    assert len({s["c"] for s in mixed.interior_sigma.values()}) == 1
    with pytest.raises(BadProject, match="k1 of every image"):
        adjust(block, free=("c",), per_image=("k1",))
    assert max(s["c"] for s in got.interior_sigma.values()) > 2 * one.interior_sigma["camera"]["c"]


def test_refusals_and_what_is_left_out() -> None:
    block, sim = flown(5)
    with pytest.raises(BadProject, match="no point 'X'"):
        adjust(replace(block, scale_bars=(ScaleBar("X", "G0001", 1.0, 0.1),)))
    of = block.observations
    keep = of.point != block.point_index("T0012")
    lost = replace(block, observations=replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep],
                                               sigma=of.sigma[keep]))
    got = adjust(barred(lost, sim.xyz, [("T0012", "G0001")], 0.01))
    assert any("takes no part: an end is not measured" in w for w in got.warnings)


def test_lever_arm_in_the_photo_frame() -> None:
    """Forward is up in the photo, right is right, down is away from the viewer's side."""
    block, _ = flown(5, noise=0.0, gps=Gps((1.0, 2.0, 3.0)))
    start = prepare_bundle(block, BundleRequest(datum="both"))
    at = Exterior.from_vector(start.problem.network.split(start.x0)[0][0])
    antenna = start.problem.antennas(start.x0)[0]
    np.testing.assert_allclose(at.m @ (at.centre - antenna), [2.0, 1.0, -3.0], atol=1e-9)
