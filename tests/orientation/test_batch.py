"""Batched resection: truth to round-off, covariance against scatter, any attitude, UTM, and a word for every impossible image."""

from __future__ import annotations

import numpy as np
import pytest

from solvers import Interior
from solvers.errors import DegenerateGeometry
from solvers.orientation.batch import Status, resect_many, solve_candidates, three_point

CAMERA = Interior(35.0, 0.1, -0.05, 2e-5, -1e-8, 0.0, 3e-6, -2e-6, 1e-4, -5e-5, pixel_mm=0.00392, width=6000, height=4000)
SIGMA = 0.3


def images(rng, count, n, relief=30.0, noise=SIGMA, height=300.0, anyhow=True):
    """count images of n points: X (B, n, 3), pixels (B, n, 2), M (B, 3, 3), C (B, 3)."""
    turn = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))[:, None, None]
    tilt = np.linalg.qr(np.eye(3) + 0.05 * rng.normal(size=(count, 3, 3)))[0]
    tilt *= np.sign(np.einsum("bii->bi", tilt))[:, None, :]
    C = np.c_[rng.uniform(-50, 50, (count, 2)), np.full(count, height)]
    uv = rng.uniform(0.03, 0.97, (count, n, 2)) * [6000, 4000]
    ray = np.concatenate([CAMERA.ideal(uv), np.full((count, n, 1), -CAMERA.c)], -1) @ tilt
    Z = rng.uniform(0, relief, (count, n)) if relief else np.zeros((count, n))
    X = C[:, None] + ((Z - height) / ray[..., 2])[..., None] * ray
    if not anyhow:
        turn = np.broadcast_to(np.eye(3), turn.shape)
    return X @ turn, uv + noise * rng.normal(size=uv.shape), tilt @ turn, np.einsum("bi,bij->bj", C, turn)


def errors(result, M, C):
    """(B, 6) estimate minus truth: centre and left rotation vector."""
    D = np.einsum("bij,bkj->bik", result.rotation, M)
    d = 0.5 * np.stack([D[:, 2, 1] - D[:, 1, 2], D[:, 0, 2] - D[:, 2, 0], D[:, 1, 0] - D[:, 0, 1]], 1)
    return np.concatenate([result.centre - C, d], 1)


@pytest.mark.parametrize("model", ["perspective", "orthogonal"])
@pytest.mark.parametrize(("n", "relief", "anyhow"), [(12, 30.0, False), (12, 30.0, True), (8, 0.0, True), (6, 80.0, True)])
def test_truth_to_round_off(n, relief, anyhow, model):
    X, uv, M, C = images(np.random.default_rng(1), 40, n, relief, noise=0.0, anyhow=anyhow)
    r = resect_many(CAMERA, X, uv, model=model, sigma_px=SIGMA)
    assert np.all(r.status == Status.OK)
    np.testing.assert_allclose(r.centre, C, atol=2e-6)
    np.testing.assert_allclose(r.rotation, M, atol=1e-8)


@pytest.mark.parametrize("model", ["perspective", "orthogonal"])
def test_covariance_predicts_scatter(model):
    X, uv, M, C = images(np.random.default_rng(2), 1500, 8, relief=100.0)
    r = resect_many(CAMERA, X, uv, model=model, sigma_px=SIGMA)
    assert np.all(r.status == Status.OK)
    e = errors(r, M, C)
    m2 = np.einsum("bi,bi->b", e, np.linalg.solve(r.covariance, e[..., None])[..., 0])
    assert 0.93 < np.mean(m2 < 12.592) < 0.97  # 95 % quantile of chi-square with 6 degrees of freedom; sd 0.006
    assert np.mean(m2) == pytest.approx(6.0, abs=0.5)
    assert np.mean(r.sigma0**2) == pytest.approx(1.0, abs=0.06)


def test_perspective_is_the_least_squares_minimum():
    """No move along the tangent lowers the sum of squares, and sigma0 is that sum."""
    X, uv, *_ = images(np.random.default_rng(3), 1, 10)
    r = resect_many(CAMERA, X, uv, sigma_px=SIGMA)

    def cost(M, C):
        P = (X[0] - C) @ M.T
        v = CAMERA.ideal(uv[0]) + CAMERA.c * P[:, :2] / P[:, 2:]
        return np.sum((v / (SIGMA * 0.00392)) ** 2)

    best = cost(r.rotation[0], r.centre[0])
    assert r.sigma0[0] == pytest.approx(np.sqrt(best / 14), rel=1e-9)
    sd = np.sqrt(np.diag(r.covariance[0]))
    for k in range(6):
        for sign in (-0.05, 0.05):
            d = np.zeros(6)
            d[k] = sign * sd[k]
            w = d[3:]
            turned = r.rotation[0] + np.cross(w, r.rotation[0].T).T
            assert cost(turned, r.centre[0] + d[:3]) > best


def test_orthogonal_is_the_fixed_point_of_retransformation():
    """Plain re-transformation in the re-centred camera (depth form) leaves the pose where it is, noise or not."""
    X, uv, _M, _C = images(np.random.default_rng(4), 5, 12)
    r = resect_many(CAMERA, X, uv, model="orthogonal", sigma_px=SIGMA)
    for b in range(5):
        rays = np.c_[CAMERA.ideal(uv[b]), np.full(12, -CAMERA.c)]
        m = (rays / np.linalg.norm(rays, axis=1)[:, None]).sum(0)
        m /= -np.linalg.norm(m)  # re-centred axis: z back to the viewer
        v = np.cross(m, [0, 0, 1.0])
        Kx = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        V = np.eye(3) + Kx + Kx @ Kx / (1 + m[2])
        q = rays @ V.T
        x = -CAMERA.c * q[:, :2] / q[:, 2:]
        M, mean = V @ r.rotation[b], X[b].mean(0)
        P = (X[b] - r.centre[b]) @ M.T
        xa = P[:, 2:] / P[:, 2].mean() * x
        s = -CAMERA.c / P[:, 2].mean()
        residual = xa - xa.mean(0) - s * (X[b] - mean) @ M[:2].T
        Y = (X[b] - mean) @ M.T  # stationary over scale and the three rotations of min |xa - s M12 (X - mean) - t|^2
        gradient = [np.sum(residual * Y[:, :2]), np.sum(residual[:, 1] * Y[:, 2]), np.sum(residual[:, 0] * Y[:, 2])]
        gradient.append(np.sum(residual[:, 0] * Y[:, 1] - residual[:, 1] * Y[:, 0]))
        assert np.abs(gradient).max() < 1e-6
        np.testing.assert_allclose(s * P[:, :2].mean(0), xa.mean(0), atol=1e-8)


def test_utm_equals_local():
    X, uv, *_ = images(np.random.default_rng(5), 50, 12)
    shift = np.array([679421.0, 9123785.0, 100.0])
    a, b = resect_many(CAMERA, X, uv), resect_many(CAMERA, X + shift, uv)
    np.testing.assert_allclose(b.centre - shift, a.centre, atol=1e-6)


def test_masked_points_do_not_count():
    X, uv, *_ = images(np.random.default_rng(6), 30, 12)
    valid = np.ones((30, 12), bool)
    valid[:, 9:] = False
    a = resect_many(CAMERA, X[:, :9], uv[:, :9])
    uv[:, 9:] = np.nan
    b = resect_many(CAMERA, X, uv, valid=valid)
    np.testing.assert_array_equal(a.centre, b.centre)
    np.testing.assert_array_equal(a.status, b.status)


def test_threads_do_not_change_results():
    X, uv, *_ = images(np.random.default_rng(7), 300, 6)
    a, b = resect_many(CAMERA, X, uv, threads=1), resect_many(CAMERA, X, uv, threads=2)
    np.testing.assert_array_equal(a.covariance, b.covariance)


@pytest.mark.parametrize(("model", "n", "relief"), [("perspective", 4, 0.0), ("perspective", 4, 5.0), ("orthogonal", 6, 0.0)])
def test_no_garbage_in_silence_in_weak_geometry(model, n, relief):
    X, uv, M, C = images(np.random.default_rng(12), 6000, n, relief=relief)
    r = resect_many(CAMERA, X, uv, model=model, sigma_px=SIGMA)
    ok = r.status == Status.OK
    e = errors(r, M, C)[ok]
    m2 = np.einsum("bi,bi->b", e, np.linalg.solve(r.covariance[ok], e[..., None])[..., 0])
    assert ok.mean() > 0.5 and np.all(m2 < 100) and 0.935 < np.mean(m2 < 12.592) < 0.965
    assert np.mean(r.status == Status.WEAK) < (0.1 if model == "perspective" else 0.35)


def test_three_points_return_every_root():
    X, uv, M, C = images(np.random.default_rng(8), 60, 3, noise=0.0)
    r = resect_many(CAMERA, X, uv, sigma_px=SIGMA)
    assert np.isnan(r.sigma0).all()
    for b in np.flatnonzero(np.isfinite(r.centre[:, 0])):
        roots = r.solutions(int(b))
        assert np.linalg.norm(roots.centre - C[b], axis=1).min() < 1e-3
        assert len(roots) == 1 or r.status[b] in (Status.AMBIGUOUS, Status.WEAK)
        assert r.status[b] == Status.AMBIGUOUS or len(roots) == 1
        raw = three_point(X[b], CAMERA.ideal(uv[b]), CAMERA.c)
        assert np.linalg.norm(raw.rotation - M[b], axis=(1, 2)).min() < 1e-3
    assert np.sum(r.status == Status.AMBIGUOUS) > 40


def test_flat_narrow_control_returns_both_reversals():
    narrow = Interior(35.0 * 20, pixel_mm=0.00392, width=6000, height=4000)
    rng = np.random.default_rng(9)
    X, uv, _M, C = images(rng, 1, 8, relief=0.0, noise=0.0, anyhow=False)
    a = np.deg2rad(20)
    M = np.array([[1, 0, 0], [0, np.cos(a), np.sin(a)], [0, -np.sin(a), np.cos(a)]])
    centre = X[0].mean(0) + M.T @ [0, 0, 20 * 300.0]
    P = (X[0] - centre) @ M.T
    uv = narrow.measured(-narrow.c * P[:, :2] / P[:, 2:]) + SIGMA * rng.normal(size=(8, 2))
    few = resect_many(narrow, X[:, :8], uv[None], sigma_px=20 * SIGMA)  # at this noise the twin cannot be told apart
    assert few.status[0] == Status.AMBIGUOUS
    both = few.solutions(0)
    assert len(both) >= 2
    assert both.cost[1] - both.cost[0] < 36
    nearest = np.linalg.norm(both.rotation - M, axis=(1, 2)).min()
    assert nearest < 0.1
    np.testing.assert_allclose(few.discrimination[0], np.sqrt(both.cost[1] - both.cost[0]), rtol=1e-3, atol=1e-3)
    assert C.shape == (1, 3)


def test_every_impossible_image_gets_its_word():
    X, uv, _M, _C = images(np.random.default_rng(10), 7, 12, anyhow=False)
    X[0] = X[0, 0] + np.linspace(0, 1, 12)[:, None] * [60.0, 35.0, 4.0]  # a line
    X[1] = X[1, 0]  # one place
    uv[2, 3, 0] = np.nan
    X[3, 3, 2] = np.inf
    uv[4, 5] += [200, -150]
    valid = np.ones((7, 12), bool)
    valid[5, 2:] = False
    r = resect_many(CAMERA, X, uv, valid=valid, sigma_px=SIGMA)
    expected = ["COLLINEAR", "COLLINEAR", "NOT_FINITE", "NOT_FINITE", "OUTLIER", "TOO_FEW", "OK"]
    assert [Status(s).name for s in r.status] == expected
    assert r.worst[4] == 5
    for b in (0, 1, 2, 3, 5):
        assert not Status(r.status[b]).has_pose
        assert np.isnan(r.centre[b]).all() and np.isnan(r.rotation[b]).all() and np.isnan(r.covariance[b]).all()
    assert all(Status(s).words for s in Status)


def test_candidates_are_ordered_minima_and_refuse_by_name():
    X, uv, M, C = images(np.random.default_rng(11), 1, 6)
    found = solve_candidates(X[0], CAMERA.ideal(uv[0]), CAMERA.c)
    assert np.all(np.diff(found.cost) >= 0)
    assert np.linalg.norm(found.centre[0] - C[0]) < 3
    np.testing.assert_allclose(found.rotation[0], M[0], atol=0.02)
    with pytest.raises(DegenerateGeometry, match="one line"):
        solve_candidates(np.linspace(0, 1, 5)[:, None] * [1.0, 2, 3], CAMERA.ideal(uv[0, :5]), CAMERA.c)
    with pytest.raises(DegenerateGeometry, match="three points"):
        solve_candidates(X[0, :2], CAMERA.ideal(uv[0, :2]), CAMERA.c)
    with pytest.raises(ValueError, match="expected"):
        resect_many(CAMERA, X[0], uv[0])
    with pytest.raises(ValueError, match="model"):
        resect_many(CAMERA, X, uv, model="affine")
