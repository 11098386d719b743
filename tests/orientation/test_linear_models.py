"""The direct linear transformation and the affine model: truth recovered, covariance true, degenerate control named."""

import numpy as np
import pytest

from solvers.cameras import ideal_photo
from solvers.errors import DegenerateGeometry
from solvers.geometry import Exterior
from solvers.orientation.linear_models import affine, direct_linear_transformation

TRUTH = Exterior.from_angles(0.3, -0.2, 1.5, np.array([679430.0, 9123750.0, 800.0]))


def control(n: int = 20) -> np.ndarray:
    return np.random.default_rng(4).uniform(-80, 80, (n, 3)) * [1, 1, 0.4] + [679400.0, 9123800.0, 500.0]


def test_dlt_recovers_camera_and_principal_point() -> None:
    points = control()
    photo = ideal_photo(35.0, TRUTH, points) + np.array([0.5, -0.3])
    found = direct_linear_transformation(points, photo)
    assert found.c == pytest.approx((35.0, 35.0), abs=1e-6)
    assert found.principal_point == pytest.approx([0.5, -0.3], abs=1e-6)
    assert found.skew == pytest.approx(0.0, abs=1e-9)
    assert found.exterior.centre == pytest.approx(TRUTH.centre, abs=1e-5)
    assert found.exterior.m == pytest.approx(TRUTH.m, abs=1e-8)


def test_dlt_covariance_predicts_the_scatter() -> None:
    points, rng, sigma = control(), np.random.default_rng(8), 0.002
    photo = ideal_photo(35.0, TRUTH, points)
    truth = direct_linear_transformation(points, photo, sigma).trace.last.x
    chi2 = []
    for _ in range(150):
        found = direct_linear_transformation(points, photo + rng.normal(0, sigma, photo.shape), sigma)
        gap = found.trace.last.x - truth
        chi2.append(gap @ np.linalg.solve(found.precision.covariance, gap))
    assert np.mean(chi2) == pytest.approx(11.0, abs=3.3 * np.sqrt(22.0 / 150))


def test_dlt_refuses_a_plane_and_too_few() -> None:
    flat = control() * [1, 1, 0]
    with pytest.raises(DegenerateGeometry, match="plane"):
        direct_linear_transformation(flat, ideal_photo(35.0, TRUTH, flat))
    with pytest.raises(DegenerateGeometry, match="6 points"):
        direct_linear_transformation(control(5), np.zeros((5, 2)))


def test_affine_is_exact_for_parallel_rays_and_its_covariance_true() -> None:
    points, rng, sigma = control(12), np.random.default_rng(9), 0.002
    a = np.array([[0.1, 0.02, 0.01, 3.0], [-0.02, 0.1, 0.03, -1.0]])
    exact = (points - points.mean(axis=0)) @ a[:, :3].T + a[:, 3]
    assert affine(points, exact).a == pytest.approx(a, abs=1e-9)
    chi2 = []
    for _ in range(200):
        found = affine(points, exact + rng.normal(0, sigma, exact.shape), sigma)
        gap = (found.a - a).ravel()
        chi2.append(gap @ np.linalg.solve(found.covariance, gap))
    assert np.mean(chi2) == pytest.approx(8.0, abs=3.3 * np.sqrt(16.0 / 200))
    with pytest.raises(DegenerateGeometry, match="plane"):
        affine(points * [1, 1, 0], exact)
