"""Perspective resection: recovers the truth, says how well, and does not care where the world lies."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import BadProject, Exterior, Interior, Prior
from solvers.adjustment import Trace, precision
from solvers.geometry import rotation
from solvers.orientation import PriorOrientation, Request, Resection, conclude, orient, prepare, resect
from tests.checks import angle_between, assert_same, check_jacobian, chi_square_band, normalised_error
from tests.synthetic import REAL_CAMERA, SEED_CAMERA, SEED_EXTERIOR, block_of, cluster, moved, prior_of, random_rotation, scene

ALL_TEN = ("c", "xp", "yp", "k1", "k2", "k3", "p1", "p2", "b1", "b2")


@pytest.mark.parametrize("free", [(), ALL_TEN])
@pytest.mark.parametrize("attitude", ["any", "gimbal", "near gimbal"])
@pytest.mark.parametrize("prior", [False, True])
def test_jacobian_against_differences(free, attitude, prior):
    rng = np.random.default_rng(1)
    phi = {"gimbal": np.pi / 2, "near gimbal": np.pi / 2 - 1e-5}.get(attitude)
    points, at = scene(rng, 20, 30, interior=REAL_CAMERA, m=None if phi is None else rotation(0.3, phi, 0.2))
    known = None
    if prior:
        known = PriorOrientation.of(moved(at, np.array([0.3, -0.2, 0.4]), np.ones(3)), np.diag([1, 2, 3, 0.1, 0.2, 0.3]) ** 2)
    pixels = block_of(points, at, REAL_CAMERA, noise_px=1).observations.pixel
    weights = np.broadcast_to([[4.0, 1], [1, 2]], (20, 2, 2))
    problem = Resection(REAL_CAMERA, points, pixels, weights, free, known)
    check_jacobian(problem, problem.start(at))


@pytest.mark.parametrize("seed", range(15))
def test_truth_is_recovered_to_round_off_under_any_attitude(seed):
    rng = np.random.default_rng(seed)
    n, fov = int(rng.integers(4, 15)), float(rng.choice([3, 10, 35]))
    points, at = scene(rng, n, fov)
    got = resect(block_of(points, at), "a")
    assert got.trace.converged
    assert_same(got.exterior, at, 1e-6 if fov > 3 else 1e-5, 1e-9 if fov > 3 else 1e-7)
    assert got.rms_px < 1e-6


@pytest.mark.parametrize("opk_deg", [(0, 0, 90), (0, 0, -90), (0, 0, 180), (3, 89.9999, 20), (0, 90, 0), (10, -90, 0), (90, 0, 0),
                                     (-90, 0, 90), (180, 0, 0), (0, 180, 45)])
def test_special_attitudes(opk_deg):
    points, at = scene(np.random.default_rng(3), 9, 35, m=rotation(*np.radians(opk_deg)))
    got = resect(block_of(points, at), "a")
    assert_same(got.exterior, at, 1e-6, 1e-9)
    assert np.isfinite(got.covariance[:3, :3]).all() and np.isfinite(np.array(got.exterior.angles)).all()


@pytest.mark.parametrize("far", [[1e7, 1e7, 0], [679421.0695, 9123785.2218, 494.8981]])
def test_large_coordinates_change_nothing(far):
    points = np.round(cluster(n=10, fov_deg=20) * 1024) / 1024  # exact in float64, there and here
    far = np.round(np.array(far) * 1024) / 1024
    here, there = (resect(block_of(points + o, Exterior(SEED_EXTERIOR.m, SEED_EXTERIOR.centre + o), noise_px=0.3), "a")
                   for o in (np.zeros(3), far))
    assert np.abs(there.exterior.centre - far - here.exterior.centre).max() < 1e-6
    assert np.abs(there.exterior.m - here.exterior.m).max() < 1e-9
    assert np.allclose(there.covariance, here.covariance, rtol=1e-5)


def test_moving_the_world_rigidly_moves_the_camera_with_it():
    rng = np.random.default_rng(4)
    points, at = scene(rng, 8, 30)
    base_block = block_of(points, at, noise_px=0.5, sigma_m=0.0)
    base = resect(base_block, "a")
    r, t = random_rotation(rng), rng.uniform(-1e4, 1e4, 3)
    turned_block = replace(base_block, points=replace(base_block.points, xyz=points @ r.T + t))
    got = resect(turned_block, "a")
    assert_same(got.exterior, Exterior(base.exterior.m @ r.T, r @ base.exterior.centre + t), 1e-6, 1e-10)
    assert np.abs(got.residuals - base.residuals).max() < 1e-6


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_scaling_the_world_scales_the_camera_distance(scale):
    points, at = scene(np.random.default_rng(5), 8, 30)
    base_block = block_of(points, at, noise_px=0.5, sigma_m=0.0)
    base = resect(base_block, "a")
    got = resect(replace(base_block, points=replace(base_block.points, xyz=points * scale)), "a")
    assert np.abs(got.exterior.centre / scale - base.exterior.centre).max() < 1e-6
    assert np.abs(got.residuals - base.residuals).max() < 1e-6
    assert np.allclose(got.sigma[:3] / scale, base.sigma[:3], rtol=1e-5)


def test_ten_parameters_are_applied_exactly():
    points, at = scene(np.random.default_rng(6), 12, 34, interior=REAL_CAMERA)
    block = block_of(points, at, REAL_CAMERA)
    assert_same(resect(block, "a").exterior, at, 1e-6, 1e-9)
    bare = replace(block, cameras={"cam": replace(REAL_CAMERA, k1=0.0)})
    assert resect(bare, "a").rms_px > 1


def test_freed_interior_parameters_are_found():
    points, at = scene(np.random.default_rng(7), 60, 36, depth=0.6, interior=REAL_CAMERA)
    wrong = replace(REAL_CAMERA, c=35.3, xp=0.0, yp=0.0, k1=0.0)
    block = replace(block_of(points, at, REAL_CAMERA), cameras={"cam": wrong})
    got = resect(block, "a", free=("c", "xp", "yp", "k1"))
    assert got.interior is not None
    for name in ("c", "xp", "yp", "k1"):
        assert getattr(got.interior, name) == pytest.approx(getattr(REAL_CAMERA, name), abs=1e-7), name
    assert_same(got.exterior, at, 1e-4, 1e-7)
    assert dict(got.interior_sigma)["c"] > 0 and got.dof == 110
    with pytest.raises(BadProject, match="not an interior"):
        resect(block, "a", free=("focal",))


def test_freed_principal_distance_scatters_as_predicted():
    points = cluster(n=12, fov_deg=20, relief=30)
    z = []
    for seed in range(40):
        got = resect(block_of(points, SEED_EXTERIOR, noise_px=0.3, noise_m=0.002, seed=seed), "a", free=("c",))
        assert got.interior is not None
        z.append((got.interior.c - 35.0) / dict(got.interior_sigma)["c"])
    chi_square_band(np.array(z) ** 2, 1)


# -- statistics -----------------------------------------------------------------------------------------------------------


def test_covariance_sigma0_and_standardized_residuals_against_scatter():
    """100 seeded runs of a cluster of ten: chi-square of the error, of the residuals, and w as a standard normal."""
    points = cluster((8.0, 5.0), n=10, fov_deg=20, relief=5)
    errors, sums, w = [], [], []
    for seed in range(100):
        got = resect(block_of(points, SEED_EXTERIOR, noise_px=0.3, noise_m=0.002, seed=seed), "a")
        gap = normalised_error(got, SEED_EXTERIOR)
        errors.append(gap @ np.linalg.solve(got.covariance, gap))
        assert got.sigma0 is not None
        sums.append(got.sigma0**2 * got.dof)
        w.append(got.w)
        if seed < 5:
            assert got.redundancy.sum() == pytest.approx(got.dof) and got.dof == 14
    chi_square_band(np.array(errors), 6)
    chi_square_band(np.array(sums), 14)
    w = np.array(w)
    assert abs(w.mean()) < 0.08 and abs(w.std() - 1) < 0.06 and np.mean(np.abs(w) > 1.96) == pytest.approx(0.05, abs=0.02)


def test_weighted_prior_joins_as_c_b_and_scatters_as_it_says():
    points = cluster(n=4, fov_deg=6, relief=1)
    errors = []
    rng = np.random.default_rng(8)
    for seed in range(50):
        block = block_of(points, SEED_EXTERIOR, noise_px=0.3, noise_m=0.002, seed=seed,
                         prior=prior_of(SEED_EXTERIOR, 0.1, 1.0, rng))
        got = resect(block, "a", prior="weighted")
        gap = normalised_error(got, SEED_EXTERIOR)
        errors.append(gap @ np.linalg.solve(got.covariance, gap))
    chi_square_band(np.array(errors), 6)
    exact = block_of(points, SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 0.1, 1.0))
    free, held = resect(exact, "a"), resect(exact, "a", prior="weighted")
    prior = np.diag([1.0] * 3 + [np.radians(0.1)] * 3) ** 2
    c_b = np.linalg.inv(np.linalg.inv(free.covariance) + np.linalg.inv(prior))
    assert np.allclose(held.covariance, c_b, rtol=1e-4, atol=1e-4 * np.sqrt(np.outer(np.diag(c_b), np.diag(c_b))))
    assert held.dof == free.dof + 6


def test_a_complete_prior_orients_with_too_few_points():
    block = block_of(cluster(n=4)[:2], SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 0.5, 2.0))
    got = resect(block, "a", prior="weighted")
    assert got.trace.converged and np.degrees(got.sigma[3]) < 0.5


def test_a_prior_of_position_only_leaves_the_angles_free():
    prior = replace(prior_of(SEED_EXTERIOR, 1, 0.05), sigma_rad=None)
    points = cluster(n=6, fov_deg=6)
    free = resect(block_of(points, SEED_EXTERIOR, prior=prior), "a")
    got = resect(block_of(points, SEED_EXTERIOR, prior=prior), "a", prior="weighted")
    assert got.dof == free.dof + 3 and (got.sigma[:3] < 0.0501).all() and (got.sigma[3:] < free.sigma[3:]).all()


def test_initial_prior_starts_there_and_nowhere_else():
    off = moved(SEED_EXTERIOR, np.array([0.02, -0.01, 0.03]), np.array([5.0, -3, 8]))
    block = block_of(cluster(n=6, fov_deg=20), SEED_EXTERIOR, prior=Prior(off.centre, off.angles))
    got = resect(block, "a", prior="initial")
    assert_same(got.initial, Exterior(off.m, got.initial.centre), 0, 1e-12)
    assert_same(got.exterior, SEED_EXTERIOR, 1e-6, 1e-9)
    with pytest.raises(BadProject, match="sigma"):
        resect(block, "a", prior="weighted")
    with pytest.raises(BadProject, match="no complete prior"):
        resect(block_of(cluster(), SEED_EXTERIOR), "a", prior="initial")


def test_control_uncertainty_enters_the_covariance():
    points = cluster(n=8, fov_deg=20)
    fine, coarse = (resect(block_of(points, SEED_EXTERIOR, sigma_m=s), "a") for s in (0.0, 0.05))
    assert (coarse.sigma > fine.sigma * 1.5).all()


def test_interfaces_of_start_and_trace():
    block = block_of(cluster(n=6, fov_deg=20), SEED_EXTERIOR, noise_px=0.3)
    start = prepare(block, Request("a"))
    whole = orient(block, Request("a"))
    assert np.array_equal(conclude(start, whole.trace).covariance, whole.covariance)
    m = whole.trace.manifest
    assert {"problem", "model", "image", "camera", "crs", "frame", "origin", "points", "xyz", "pixels", "sigma", "columns",
            "units", "options", "initial"} <= set(m)
    assert len(m["columns"]) == len(whole.trace.last.x) and Interior(**m["camera"]).c == SEED_CAMERA.c
    assert isinstance(whole.trace, Trace) and np.allclose(m["initial"], whole.trace.rows[0].x[:12])
    stats = precision(start.problem.linear(whole.trace.last.x))
    assert np.allclose(np.sqrt(np.diag(stats.covariance))[:3], whole.sigma[:3])


def test_three_points_return_all_roots_and_no_sigma0():
    points, at = scene(np.random.default_rng(9), 3, 35)
    got = resect(block_of(points, at), "a")
    every = [got, *got.alternatives]
    assert got.dof == 0 and got.sigma0 is None and all(o.rms_px < 1e-6 for o in every)
    assert min(np.abs(o.exterior.centre - at.centre).max() for o in every) < 1e-6
    assert len(every) == 1 or any("ambiguous" in w for w in got.warnings)


def test_a_prior_decides_between_reversal_solutions_and_the_run_ends_where_it_says():
    """Flat, narrow, off-centre: with a weighted prior the run ends in the minimum of least cost, whatever its crude start."""
    points, rng = cluster((8.0, 5.0), 4, 1.0, 0.0), np.random.default_rng(10)
    for seed in range(12):
        prior = prior_of(SEED_EXTERIOR, 2.0, 5.0, rng)
        block = block_of(points, SEED_EXTERIOR, noise_px=0.3, sigma_m=0.0, seed=seed, prior=prior)
        got = resect(block, "a", prior="weighted")
        assert angle_between(got.exterior, SEED_EXTERIOR) < np.radians(8)  # the mirrored one is 31 degrees away
        assert all(got.trace.last.cost <= o.trace.last.cost + 1e-6 for o in got.alternatives)
