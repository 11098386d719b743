"""The orthogonal projection model: one pass, fixed point, every attitude, and no false fixed point in silence."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import BadProject, Exterior
from solvers.adjustment import Options, precision, solve
from solvers.cameras import project
from solvers.geometry import log, rotation
from solvers.orientation import Orthogonal, resect, resect_orthogonal
from solvers.orientation.orthogonal import Form
from tests.checks import angle_between, assert_same, central, check_jacobian
from tests.synthetic import REAL_CAMERA, SEED_CAMERA, SEED_EXTERIOR, block_of, cluster, moved, prior_of, scene

MODELS = [(form, recentre) for form in ("depth", "printed") for recentre in (True, False)]


def model_of(points, at, form: Form = "depth", recentre=True, interior=SEED_CAMERA, noise=0.0, frozen=None) -> Orthogonal:
    pixels = project(interior, at, points) + noise * np.random.default_rng(1).standard_normal((len(points), 2))
    return Orthogonal(interior, points, pixels, np.broadcast_to(np.eye(2) * 0.09, (len(points), 2, 2)), form, recentre, frozen)


@pytest.mark.parametrize("form, recentre", MODELS)
def test_jacobians_against_differences(form, recentre):
    """The adjustment's design through retract, the constraints, the models' derivatives and the transformation's."""
    points, at = scene(np.random.default_rng(2), 10, 30, interior=REAL_CAMERA, m=SEED_EXTERIOR.m)
    model = model_of(points, at, form, recentre, REAL_CAMERA, 1.0, frozen=at)
    x = model.start(model.affine_of(at))
    check_jacobian(model, x)
    h = central(lambda e: -np.asarray(model.linear(model.retract(x, e)).w), 8, 1e-7)
    design = model.linear(x).h
    assert design is not None and np.abs(h - design).max() < 1e-8 * np.abs(h).max()
    jg, jp, _ = model.models(at)
    _, t = model.transform(at)
    steps = np.array([1e-3] * 3 + [1e-5] * 3)

    def orthogonal(e):
        a = model.affine_of(moved(at, e[3:], e[:3])).reshape(2, 4)
        return (np.linalg.inv(t) @ (model.reduced @ a[:, :3].T + a[:, 3])[..., None])[..., 0]

    for analytic, f in ((jg, orthogonal), (jp, lambda e: project(REAL_CAMERA, moved(at, e[3:], e[:3]), points))):
        error = np.abs(central(f, 6, steps) - analytic).max(axis=(0, 1))
        assert (error < 1e-8 * np.abs(analytic).max(axis=(0, 1))).all()
    if not recentre:
        by_pixel = central(lambda e: replace(model, pixels=model.pixels + e).transform(at)[0], 2, 0.01)
        assert np.abs(by_pixel - t).max() < 1e-8 * np.abs(t).max()


@pytest.mark.parametrize("form, recentre", MODELS)
def test_leak_is_the_derivative_of_one_pass_by_its_approximation(form, recentre):
    points, at = scene(np.random.default_rng(3), 10, 20, m=SEED_EXTERIOR.m)
    model = model_of(points, at, form, recentre)

    def one_pass(e):
        frozen = model.refrozen(moved(at, e[3:], e[:3]))
        end = Exterior.from_vector(solve(frozen, frozen.start(frozen.affine_of(at)), Options.gauss_newton()).last.x)
        return np.concatenate([end.centre - at.centre, log(end.m @ at.m.T)])

    steps = np.array([1e-3] * 3 + [1e-5] * 3)
    leak = model.statistics(at).leak
    assert np.abs((central(one_pass, 6, steps) - leak) * steps).max() < 1e-8


@pytest.mark.parametrize("form, recentre", MODELS)
def test_exact_data_and_the_true_orientation_fulfil_the_model(form, recentre):
    points, at = scene(np.random.default_rng(4), 7, 40, m=SEED_EXTERIOR.m)
    model = model_of(points, at, form, recentre)
    xa, _ = model.transform(at)
    a = model.affine_of(at).reshape(2, 4)
    assert np.abs(xa - model.reduced @ a[:, :3].T - a[:, 3]).max() < 1e-11
    assert np.abs(model.constraints(model.start(model.affine_of(at)))).max() < 1e-13
    assert_same(model.exterior_of(model.affine_of(at)), at, 1e-8, 1e-11)


@pytest.mark.parametrize("seed", range(8))
def test_fixed_point_on_narrow_clusters_is_the_perspective_solution_on_exact_data(seed):
    rng = np.random.default_rng(seed)
    points, at = scene(rng, int(rng.integers(4, 12)), 6, depth=0.1)
    block = block_of(points, at)
    got, perspective = resect_orthogonal(block, "a"), resect(block, "a")
    assert got.trace.converged
    assert_same(got.exterior, perspective.exterior, 1e-6, 1e-9)
    assert np.array_equal(got.trace.rows[0].x[:12], got.initial.vector) and len(got.trace.last.x) == 20


@pytest.mark.parametrize("opk_deg", [(0, 0, 90), (0, 0, -90), (90, 0, 0), (-90, 0, 30), (0, 90, 0), (2, 1, 89.9999), (180, 0, 0)])
def test_special_attitudes(opk_deg):
    """kappa 90 degrees, where the printed (19) divides by zero, and horizontal cameras, where m33 = 0."""
    points, at = scene(np.random.default_rng(5), 8, 15, m=rotation(*np.radians(opk_deg)))
    got = resect_orthogonal(block_of(points, at), "a")
    assert_same(got.exterior, at, 1e-6, 1e-9)


@pytest.mark.parametrize("kappa_deg", [0, 90, 180])
def test_printed_form_holds_at_every_kappa_of_a_vertical_photo(kappa_deg):
    points, at = scene(np.random.default_rng(6), 8, 15, m=rotation(0.05, -0.03, np.radians(kappa_deg)))
    got = resect_orthogonal(block_of(points, at), "a", form="printed", recentre=False)
    assert_same(got.exterior, at, 1e-6, 1e-9)


def test_one_pass_needs_a_prior_and_uses_it():
    points = cluster(n=8, fov_deg=6)
    with pytest.raises(BadProject, match="no complete prior"):
        resect_orthogonal(block_of(points, SEED_EXTERIOR), "a", one_pass=True)
    block = block_of(points, SEED_EXTERIOR, prior=prior_of(SEED_EXTERIOR, 1.0, 5.0))
    got = resect_orthogonal(block, "a", one_pass=True)
    assert_same(got.exterior, SEED_EXTERIOR, 1e-7, 1e-9)
    assert any("comes through" in w for w in got.warnings)


def test_recentring_cures_the_amplified_prior_off_centre():
    """A 1 degree prior error in a flat corner cluster: 3.3 degrees through the printed form, next to nothing re-centred."""
    points = cluster((8.0, 5.0), 4, 6.0, 0.0)
    off = moved(SEED_EXTERIOR, np.radians([1.0, 0, 0]), np.zeros(3))
    block = block_of(points, SEED_EXTERIOR, prior=prior_of(off, 1.0, 1.0))
    printed = resect_orthogonal(block, "a", one_pass=True, form="printed", recentre=False)
    recentred = resect_orthogonal(block, "a", one_pass=True)
    assert angle_between(printed.exterior, SEED_EXTERIOR) > np.radians(2)
    assert angle_between(recentred.exterior, SEED_EXTERIOR) < np.radians(0.1)


def test_accelerated_and_plain_repetition_end_in_the_same_point():
    for seed in range(4):
        points, at = scene(np.random.default_rng(seed), 10, 12, depth=0.2)
        model = model_of(points, at, noise=0.3)
        assert model.statistics(at).radius < 0.7
        x0 = model.start(model.affine_of(at))
        plain, aimed = (solve(replace(model, accelerated=a), x0, Options.gauss_newton(100)) for a in (False, True))
        assert plain.converged and aimed.converged and aimed.iterations <= plain.iterations
        # aimed steps stop at a zero of the rays' own residuals, which re-centring bends by parts of a millionth
        assert np.abs(plain.last.x[:3] - aimed.last.x[:3]).max() < 1e-4
        assert angle_between(*(Exterior.from_vector(t.last.x) for t in (plain, aimed))) < 1e-6


def test_no_false_fixed_point_is_returned_in_silence():
    """Wide and flat scenes with noise: whatever comes back is the perspective solution, or says that it is not to be used."""
    said = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        points = np.column_stack([rng.uniform(-90, 90, 8), rng.uniform(-60, 60, 8), rng.uniform(0, 8, 8)])
        block = block_of(points, SEED_EXTERIOR, noise_px=0.3, seed=seed)
        got = resect_orthogonal(block, "a")
        if any("false fixed point" in w or "did not converge" in w for w in got.warnings):
            said += 1
        else:
            assert got.rms_px < 3, f"seed {seed}: {got.rms_px} px in silence"
            assert angle_between(got.exterior, SEED_EXTERIOR) < np.radians(2)
    assert said < 25


def test_statistics_of_the_constrained_adjustment_are_those_of_the_pose():
    """The bordered 8-parameter covariance and the 6-parameter one are the same thing: both give C_n of the six."""
    points, at = scene(np.random.default_rng(7), 9, 10)
    model = model_of(points, at, frozen=at)
    x = model.start(model.affine_of(at))
    q = precision(model.linear(x)).covariance
    steps = np.array([1e-3] * 3 + [1e-6] * 3)
    j = central(lambda e: model.affine_of(moved(at, e[3:], e[:3])), 6, steps)
    jg, _, p = model.models(at)
    six = np.linalg.inv(np.einsum("nai,nab,nbj->ij", jg, p, jg))
    assert np.allclose(q, j @ six @ j.T, rtol=1e-4, atol=1e-6 * np.abs(q).max())
    assert np.linalg.matrix_rank(q, tol=1e-9 * np.abs(q).max()) <= 6


def test_bordered_covariance_scatters_as_predicted():
    """Helmert's covariance of A1 .. A8 against 300 runs (the published check allows 5 % with many more)."""
    points, at = scene(np.random.default_rng(8), 8, 10)
    model = model_of(points, at, frozen=at, recentre=False)
    x0, rng, sigma = model.start(model.affine_of(at)), np.random.default_rng(9), 0.3
    q = precision(model.linear(x0)).covariance
    runs = []
    for _ in range(300):
        noisy = replace(model, pixels=model.pixels + sigma * rng.standard_normal((8, 2)))
        runs.append(solve(noisy, x0, Options.gauss_newton()).last.x[12:])
    ratio = np.std(runs, axis=0) / np.sqrt(np.diag(q))
    assert (np.abs(ratio - 1) < 0.15).all(), ratio


def test_the_orthogonal_model_frees_no_lens():
    with pytest.raises(BadProject, match="perspective"):
        resect_orthogonal(block_of(cluster(n=8), SEED_EXTERIOR), "a", free=("k1",))
