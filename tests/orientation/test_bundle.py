"""Bundle adjustment by its plain dense path: derivatives, truth, statistics, datums, blunders and what is not determined."""

import json
from dataclasses import replace

import numpy as np
import pytest

from solvers import BadProject, Block, DegenerateGeometry, Prior
from solvers.adjustment import Trace, iterate, solve
from solvers.adjustment.losses import COSTS, LOSSES
from solvers.geometry import rotation
from solvers.orientation.bundle import BundleRequest, adjust, conclude_bundle, exteriors, prepare_bundle
from solvers.orientation.bundle.datum import motions, similarity
from solvers.orientation.bundle.problem import Bundle
from solvers.orientation.bundle.statistics import defects
from solvers.simulation import calibration_plate, field_long_range, ono_stereo, ono_triplet, uav_block
from tests.checks import assert_same, check_jacobian, chi_square_band, normalised_error

ALL_TEN = ("c", "xp", "yp", "k1", "k2", "k3", "p1", "p2", "b1", "b2")


def small_uav(seed: int = 1, noise: float = 1.0, **options):
    return uav_block(seed, strips=2, images=3, ties=60, control=6, checks=3, noise=noise, fine=False, **options)


def with_priors(block: Block, every: int = 1) -> Block:
    return replace(block, images=tuple(i if k % every == 0 else replace(i, prior=None) for k, i in enumerate(block.images)))


# -- derivatives and truth ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("free", "datum", "loss"), [((), "control", None), (ALL_TEN, "control", None),
                                                     (("c", "k1"), "both", None),
                                                     (ALL_TEN, "free", None)])
def test_jacobian_against_differences(free, datum, loss):
    block = calibration_plate(3).block
    of = block.observations
    keep = (of.point % 3 == 0)
    some = replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep], sigma=of.sigma[keep])
    request = BundleRequest(datum=datum, free=free, loss=loss, images=("plate1", "plate2", "plate4"))
    start = prepare_bundle(with_priors(replace(block, observations=some), 2), request)
    problem = Bundle(start.problem.network, None, start.problem.compiled)
    rng = np.random.default_rng(2)
    u = len(problem.normal(start.x0).gradient)
    check_jacobian(problem, problem.retract(start.x0, rng.normal(size=u) / problem.normal(start.x0).scale), rtol=3e-6)


def test_a_robust_gradient_is_that_of_its_cost():
    block = calibration_plate(3).block
    for loss in LOSSES:
        problem, x = (s := prepare_bundle(block, BundleRequest(loss=loss))).problem, s.x0
        g, scale = problem.normal(x).gradient, problem.normal(x).scale
        d = np.random.default_rng(5).normal(size=len(g)) / scale * 1e-4
        slope = (problem.cost(problem.retract(x, d)) - problem.cost(problem.retract(x, -d))) / 2
        assert slope == pytest.approx(-g @ d, rel=1e-4), loss
        t = np.linspace(0.01, 9, 400)
        np.testing.assert_allclose(np.gradient(COSTS[loss](t), t)[1:-1], (LOSSES[loss](t) * t)[1:-1], atol=0.06)


@pytest.mark.parametrize("options", [{}, {"start": "relative"}, {"start": "prior"}, {"datum": "free"}])
def test_truth_is_recovered_to_round_off(options):
    sim = small_uav(noise=0.0)
    block = sim.block
    if options.get("datum") == "free":
        block = replace(block, points=replace(block.points, xyz=sim.xyz))
    got = adjust(block, **options)
    assert got.trace.converged and got.rms_px < 1e-5 and len(got.orientations) == 6
    for o in got.orientations:
        assert_same(o.exterior, sim.exteriors[o.image], 2e-5, 1e-7)
    names = list(block.points.names)
    assert max(np.abs(p.xyz - sim.xyz[names.index(p.name)]).max() for p in got.points) < 2e-5


def test_all_ten_interior_parameters_are_found_and_scatter_as_they_say():
    errors = []
    for seed in range(8):
        sim = calibration_plate(seed)
        got = adjust(sim.block, free=ALL_TEN)
        off = got.interiors["camera"].parameters - sim.cameras["camera"].parameters
        errors.append(off @ np.linalg.solve(got.interior_covariance, off))
    chi_square_band(np.array(errors), 10, 0.999)


def test_a_block_far_away_is_the_same_block():
    sim = small_uav()
    block = sim.block
    far = np.array([4194304.0, 8388608.0, 0.0])
    block = replace(block, images=tuple(replace(i, prior=None) for i in block.images))
    there = replace(block, points=replace(block.points, xyz=block.points.xyz + far))
    a, b = adjust(block), adjust(there)
    assert b.cost == pytest.approx(a.cost, rel=1e-8) and abs(b.trace.iterations - a.trace.iterations) <= 1  # round-off decides
    for p, q in zip(a.orientations, b.orientations, strict=True):
        np.testing.assert_allclose(q.exterior.centre - far, p.exterior.centre, atol=1e-5)
        np.testing.assert_allclose(q.covariance, p.covariance, rtol=1e-3, atol=1e-6 * np.abs(p.covariance).max())


# -- statistics -----------------------------------------------------------------------------------------------------------


def test_covariance_of_poses_points_and_sums_of_squares_by_monte_carlo():
    errors, ties, sums, checks = [], [], [], []
    for seed in range(20):
        sim = small_uav(seed)
        got = adjust(sim.block)
        assert got.trace.converged
        names = list(sim.block.points.names)
        for o in got.orientations[:1]:
            gap = normalised_error(o, sim.exteriors[o.image])
            errors.append(gap @ np.linalg.solve(o.covariance, gap))
        for p in [p for p in got.points if p.role == "tie"][:1] + [p for p in got.points if p.role == "check"][:1]:
            gap = p.xyz - sim.xyz[names.index(p.name)]
            (ties if p.role == "tie" else checks).append(gap @ np.linalg.solve(p.covariance, gap))
        sums.append((2 * got.cost, got.dof))
        assert sum(r for _, r in got.groups.values()) == pytest.approx(got.dof)
        assert sum(o.redundancy.sum() for o in got.orientations) == pytest.approx(
            got.groups["tie image"][1] + got.groups["control image"][1])
    chi_square_band(np.array(errors), 6, 0.999)
    chi_square_band(np.array(ties), 3, 0.999)
    chi_square_band(np.array(checks), 3, 0.999)
    cost, dof = np.sum(sums, axis=0)
    chi_square_band(np.array([cost]), int(dof), 0.999)


def test_check_points_take_no_part():
    sim = small_uav(2)
    block = sim.block
    j = block.points.role.index("check")
    xyz = block.points.xyz.copy()
    xyz[j] += [0.0, 0.0, 5.0]
    a, b = adjust(block), adjust(replace(block, points=replace(block.points, xyz=xyz)))
    assert b.cost == pytest.approx(a.cost, rel=1e-9)
    assert a.check_rms is not None and b.check_rms is not None and a.check_rms[2] < 0.2 and b.check_rms[2] > 2


def test_fixed_control_is_not_moved_and_weighted_control_is():
    sim = small_uav(3)
    block = sim.block
    fixed = replace(block, points=replace(block.points, sigma=np.where(np.isfinite(block.points.sigma), 0.0, np.nan)))
    held, free = adjust(fixed), adjust(block)
    assert all(np.abs(p.off).max() < 1e-9 for p in held.points if p.role == "control")
    assert free.control_rms is not None and (free.control_rms > 1e-4).all()
    assert held.dof == free.dof and held.cost > free.cost


def test_json_keeps_the_contract():
    got = adjust(small_uav().block, free=("c",), datum="both").to_json()
    out = json.loads(json.dumps(got, allow_nan=False))
    assert {"orientations", "interior", "points", "sigma0", "dof", "rms_px", "iterations", "cost", "control_rms_m", "check_rms_m",
            "reliability"} <= set(out)
    assert {"image", "model", "X", "omega_deg", "sigma", "covariance", "residuals", "rejected",
            "warnings"} <= set(out["orientations"][0])
    assert {"c_mm", "xp_mm", "b2", "sigma"} <= set(out["interior"]["nex"]) and list(out["interior"]["nex"]["sigma"]) == ["c_mm"]
    assert {"name", "X", "Y", "Z", "sX", "sY", "sZ", "role", "dX", "dY", "dZ"} <= set(out["points"][0])
    assert set(out["reliability"]["groups"]) == {"tie image", "control image", "control", "GPS", "IMU"}
    joint = out["orientations"][0]["interior_covariance"]
    assert joint["parameters"] == ["c_mm"] and np.shape(joint["matrix"]) == (6, 1)
    tie = next(p for p in out["points"] if p["role"] == "tie")
    axes = tie["ellipsoid"]["half_axes_m"]
    assert axes[0] >= axes[1] >= axes[2] > 0
    assert np.sum(np.square(axes)) == pytest.approx(2.7954834829**2 * (tie["sX"]**2 + tie["sY"]**2 + tie["sZ"]**2))


# -- datum ----------------------------------------------------------------------------------------------------------------


def test_what_a_free_network_estimates_does_not_depend_on_its_datum():
    """Residuals, sigma0 and redundancy are the same in a world turned, scaled and shifted, and with other datum points."""
    block = ono_triplet(4).block
    base = adjust(block, datum="free")
    r, s, t = rotation(0.4, -0.8, 2.0), 3.0, np.array([5.0, -7.0, 2.0])
    turned = adjust(replace(block, points=replace(block.points, xyz=s * block.points.xyz @ r.T + t)), datum="free")
    xyz = block.points.xyz.copy()
    xyz[5:] = np.nan
    fewer = adjust(replace(block, points=replace(block.points, xyz=xyz), images=block.images), datum="free", start="relative")
    assert base.dof == 3 * 12 * 2 - 18 - 36 + 7
    for other in (turned, fewer):
        assert other.sigma0 == pytest.approx(base.sigma0, rel=1e-7)
        for a, b in zip(base.orientations, other.orientations, strict=True):
            order = [b.points.index(p) for p in a.points]
            np.testing.assert_allclose(b.residuals[order], a.residuals, atol=2e-6)
            np.testing.assert_allclose(b.redundancy[order], a.redundancy, atol=1e-6)
    for p, q in zip(sorted(base.points, key=lambda p: p.name), sorted(turned.points, key=lambda p: p.name), strict=True):
        np.testing.assert_allclose(q.covariance, s**2 * r @ p.covariance @ r.T, rtol=1e-4, atol=1e-12)


def test_inner_constraints_keep_the_datum_points_and_give_the_least_trace():
    block = ono_stereo(2).block
    got = adjust(block, datum="free")
    names = list(block.points.names)
    reference = np.array([block.points.xyz[names.index(p.name)] for p in got.points])
    scale, r, t = similarity(np.array([p.xyz for p in got.points]), reference)
    assert scale == pytest.approx(1, abs=1e-9) and np.abs(r - np.eye(3)).max() < 1e-9 and np.abs(t).max() < 1e-8
    control = replace(block, points=replace(block.points, role=("control",) * 3 + ("tie",) * 9,
                                            sigma=np.full_like(block.points.xyz, 1e-5)))
    other = adjust(control)
    assert sum(np.trace(p.covariance) for p in got.points) < sum(np.trace(p.covariance) for p in other.points)
    start = prepare_bundle(block, BundleRequest(datum="free"))
    assert np.linalg.matrix_rank(motions(start.problem.network, start.x0)) == 7


def test_a_long_range_network_converges_from_crude_points():
    sim = field_long_range(1)
    got = adjust(sim.block, datum="free")
    assert got.trace.converged and got.sigma0 is not None and 0.8 < got.sigma0 < 1.2


def test_priors_alone_give_a_datum():
    sim = small_uav(5)
    got = adjust(sim.block, datum="prior")
    assert got.trace.converged and set(got.groups) == {"tie image", "GPS", "IMU"}
    assert got.control_rms is not None and (got.control_rms < 6).all() and (got.control_rms > 0.01).all()
    alone = replace(sim.block, images=tuple(replace(i, prior=Prior(i.prior.centre, None, i.prior.sigma_m))
                                            for i in sim.block.images if i.prior))
    positions = adjust(alone, datum="both")
    assert positions.trace.converged and positions.groups["GPS"][1] < 18 and "IMU" not in positions.groups


# -- wrong data -----------------------------------------------------------------------------------------------------------


def test_rank_defects_are_named():
    block = small_uav().block
    start = prepare_bundle(block, BundleRequest(datum="free"))
    assert "there is neither control nor a prior" in defects(replace(start.problem, inner=None), start.x0)[0]
    two = replace(block, points=replace(block.points, role=("control",) * 2 + ("tie",) * (len(block.points) - 2)))
    with pytest.raises(DegenerateGeometry, match="rotation about the direction"):
        adjust(two, start="relative")
    flat = calibration_plate(1).block  # one image of a flat field tells c from distance no more
    rows = flat.observations.image == 0
    level = np.abs(flat.points.xyz[:, 2]) < 0.01
    rows &= level[flat.observations.point]
    of = flat.observations
    one = replace(flat, observations=replace(of, image=of.image[rows], point=of.point[rows], pixel=of.pixel[rows],
                                             sigma=of.sigma[rows]))
    with pytest.raises(DegenerateGeometry, match="xp of camera 'camera'"):
        adjust(replace(one, points=replace(one.points, xyz=one.points.xyz * [1, 1, 0])), free=("c", "xp", "yp", "b1", "b2"))


def test_a_wrong_name_or_a_mislabelled_point_is_named():
    sim = small_uav(6)
    block = sim.block
    with pytest.raises(BadProject, match="focal"):
        adjust(block, free=("focal",))
    of = block.observations
    ties = [k for k in range(len(of)) if block.points.role[of.point[k]] == "tie"]
    wrong = of.pixel.copy()
    rays = np.bincount(of.point)
    k = max(ties, key=lambda k: rays[of.point[k]])
    wrong[k] += [12.0, -9.0]
    got = adjust(replace(block, observations=replace(of, pixel=wrong)))
    assert got.suspects[0]["point"] == block.points.names[of.point[k]]
    assert got.suspects[0]["image"] == block.images[of.image[k]].name
    robust = adjust(replace(block, observations=replace(of, pixel=wrong)), loss="danish")
    o = next(o for o in robust.orientations if o.image == block.images[of.image[k]].name)
    assert block.points.names[of.point[k]] in o.rejected
    assert robust.sigma0 is not None and got.sigma0 is not None and robust.sigma0 < got.sigma0
    xyz = block.points.xyz.copy()
    xyz[0] += [0.5, 0.0, 0.0]
    got = adjust(replace(block, points=replace(block.points, xyz=xyz)))
    assert got.suspects[0] == got.suspects[0] | {"kind": "control", "point": block.points.names[0]}


def test_an_image_with_two_observations_and_parts_without_ties_are_named():
    block = small_uav(7).block
    of = block.observations
    rows = np.flatnonzero(of.image == 5)
    keep = np.setdiff1d(np.arange(len(of)), rows[2:])
    poor = replace(block, observations=replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep],
                                               sigma=of.sigma[keep]),
                   images=tuple(replace(i, prior=None) for i in block.images))
    got = adjust(poor)
    assert len(got.orientations) == 5 and any(block.images[5].name in w and "2 observations" in w for w in got.warnings)
    twice = replace(of, point=np.where(np.arange(len(of)) == rows[1], of.point[rows[0]], of.point))
    with pytest.raises(BadProject, match="measured twice"):
        adjust(replace(block, observations=twice))
    left = of.image < 3
    seen = [set(of.point[left]), set(of.point[~left])]
    common = np.array(sorted(seen[0] & seen[1]))
    keep = ~(np.isin(of.point, common) & ~left)
    apart = replace(block, observations=replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep],
                                                sigma=of.sigma[keep]))
    with pytest.raises(DegenerateGeometry, match="falls into 2 parts"):
        adjust(apart, datum="free", start="prior")


def test_a_trace_can_be_stopped_and_continued_from_any_row():
    start = prepare_bundle(small_uav().block, BundleRequest(free=("c",)))
    rows = list(iterate(start.problem, start.x0, start.options))
    again = solve(start.problem, rows[2].x, start.options, start.manifest)
    a, b = (conclude_bundle(start, t) for t in (Trace(tuple(rows), start.manifest), again))
    assert b.cost == pytest.approx(a.cost, rel=1e-9)
    for o in a.orientations:
        assert_same(exteriors(a.trace)[o.image], o.local, 0, 0)
        assert_same(o.exterior, next(q.exterior for q in b.orientations if q.image == o.image), 1e-4, 1e-7)
