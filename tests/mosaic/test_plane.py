"""Planar collinearity: coefficients from points, from orientation and back; what they do not determine."""

import numpy as np
import pytest

from solvers import Exterior, Interior
from solvers.errors import BadTable, DegenerateGeometry
from solvers.mosaic import coefficients_of, orientation_of, plane_coefficients, rectification
from solvers.mosaic.plane import through
from solvers.mosaic.registration import plane_warp
from tests.checks import chi_square_band

CAMERA = Interior(35.0, 0.1, -0.2, 1e-5, pixel_mm=(0.004, 0.0041), width=6000, height=4000)
PHOTO = Exterior.from_angles(0.1, -0.15, 1.2, np.array([10.0, 20.0, 300.0]))
PLANE = np.array([2.0, 0.05, -0.02])
H = plane_warp(CAMERA, PHOTO, PLANE)


def points(n=12, seed=1):
    return np.random.default_rng(seed).uniform(-80, 80, (n, 2))


def test_four_points_give_the_coefficients_of_the_orientation():
    xy = np.array([[-70, -60], [80, -50], [70, 60], [-60, 75.0]])
    fit = plane_coefficients(xy, through(H, xy))
    assert fit.dof == 0 and fit.sigma0 is None
    assert np.allclose(fit.coefficients, coefficients_of(CAMERA, PHOTO, PLANE), rtol=1e-9)


def test_map_coordinates_lose_no_digits():
    xy = points()
    fit = plane_coefficients(xy + np.array([500_000, 5_400_000]), through(H, xy), 0.3)
    assert np.abs(fit.residuals).max() < 1e-6


def test_orientation_and_coefficients_are_inverses():
    found = orientation_of(H * -3.7, CAMERA, PLANE)
    assert np.abs(found.exterior.centre - PHOTO.centre).max() < 1e-9 and np.abs(found.exterior.m - PHOTO.m).max() < 1e-12
    assert np.abs(found.misfit).max() < 1e-12


@pytest.mark.parametrize("sigma_plane", [None, 0.05])
def test_covariance_predicts_the_scatter(sigma_plane):
    rng, xy, truth = np.random.default_rng(7), points(), coefficients_of(CAMERA, PHOTO, PLANE)
    px = through(H, xy)
    sigma = np.linspace(0.2, 0.6, len(xy))
    q = np.linalg.inv(plane_coefficients(xy, px, sigma, sigma_plane).covariance)
    values = []
    for _ in range(60):
        seen = xy + (rng.normal(0, sigma_plane, xy.shape) if sigma_plane else 0)
        d = plane_coefficients(seen, px + rng.normal(0, 1, px.shape) * sigma[:, None], sigma, sigma_plane).coefficients - truth
        values.append(d @ q @ d)
    chi_square_band(np.array(values), 8, 0.998)


@pytest.mark.parametrize(("xy", "word"), [
    (np.array([[0, 0], [1, 1], [2, 2], [5, 0]]) * 10.0, "line"),
    (np.arange(7)[:, None] * np.array([[10.0, 10.0]]), "line"),
    (np.vstack([np.arange(6)[:, None] * np.array([[10.0, 10.0]]), [[-30, 30]]]), "but for 1 (g)"),
    (points(3), "four"),
    (np.zeros((5, 2)), "one point"),
])
def test_what_is_not_determined_is_said(xy, word):
    seen = through(H, xy) + np.random.default_rng(3).normal(0, 0.3, xy.shape) * (len(xy) > 4 and xy.any())
    with pytest.raises(DegenerateGeometry) as error:
        plane_coefficients(xy, seen, 0.3, names="abcdefg")
    assert word in str(error.value)


def test_bad_numbers_are_refused():
    with pytest.raises(BadTable):
        plane_coefficients(np.array([[0, 0], [1, 0], [1, 1], [0, np.nan]]), np.zeros((4, 2)))


def test_the_isocentre_has_the_scale_of_a_vertical_photo():
    level = Exterior.from_angles(0.2, -0.1, 0.7, np.array([5.0, -3.0, 120.0]))
    plain = Interior(35.0, pixel_mm=0.004, width=6000, height=4000)
    seen = rectification(plain, level)
    assert seen.tilt == pytest.approx(np.arccos(level.m[2, 2])) and seen.height == pytest.approx(120.0)
    back = np.linalg.inv(plane_warp(plain, level, np.zeros(3)))
    at = seen.isocentre + np.array([[0.0, 0], [0.01, 0], [0, 0.01]])
    xy = through(back, at)
    j = np.array([xy[1] - xy[0], xy[2] - xy[0]]) / 0.01
    assert np.allclose(np.linalg.norm(j, axis=1), seen.gsd, rtol=1e-5)  # the same in both directions
    assert abs(j[0] @ j[1]) < 1e-5 * seen.gsd**2
    assert np.allclose(through(back, seen.nadir), [5.0, -3.0], atol=1e-6)


def test_from_below_is_refused():
    with pytest.raises(DegenerateGeometry, match="below"):
        rectification(CAMERA, PHOTO, np.array([400.0, 0, 0]))
