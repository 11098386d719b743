"""Pixels and photo frame, the ten-parameter correction and its inverse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import BadProject, Interior
from solvers.cameras import PARAMETERS, correct, correct_derivatives, correct_jacobian, distort
from tests.checks import central
from tests.synthetic import REAL_CAMERA, SEED_CAMERA

GOLDEN = Interior(35.0, 0.12, -0.08, 6e-5, -4e-8, 1e-11, 5e-6, -3e-6, 1e-4, -5e-5, pixel_mm=0.004, width=6000, height=4000)
MEASURED = np.array([[10.0, 6.0], [-11.0, -7.0], [0.5, 0.3]])
IDEAL = np.array([[9.954835092310882, 6.12481360425285], [-11.221057997469597, -6.983460299933239],
                  [0.3800276049723288, 0.3800062945723289]])


def test_golden_ten_parameters_both_ways():
    pixels = GOLDEN.pixels(MEASURED)
    assert np.abs(GOLDEN.ideal(pixels) - IDEAL).max() < 1e-12
    assert np.abs(GOLDEN.photo(GOLDEN.measured(IDEAL)) - MEASURED).max() < 1e-10


def test_centre_of_the_format_and_directions():
    camera = Interior(35.0, pixel_mm=(0.004, 0.005), width=101, height=51)
    assert np.allclose(camera.photo(np.array([50.0, 25.0])), 0)
    right, down = camera.photo(np.array([51.0, 25.0])), camera.photo(np.array([50.0, 26.0]))
    assert np.allclose(right, [0.004, 0]) and np.allclose(down, [0, -0.005])


@pytest.mark.parametrize("camera", [SEED_CAMERA, REAL_CAMERA])
def test_round_trips(camera):
    pixels = np.random.default_rng(1).uniform([-0.5, -0.5], [5999.5, 3999.5], (200, 2))
    assert np.abs(camera.pixels(camera.photo(pixels)) - pixels).max() < 1e-9
    assert np.abs(camera.measured(camera.ideal(pixels)) - pixels).max() < 1e-8


def test_corners_of_the_format_are_inside_and_no_more():
    edges = np.array([[-0.5, -0.5], [5999.5, 3999.5], [-0.51, 0], [0, 3999.51]])
    assert SEED_CAMERA.inside(edges).tolist() == [True, True, False, False]
    assert SEED_CAMERA.inside(edges, margin=0.02).all()


def test_correction_derivatives_against_differences():
    xy = np.random.default_rng(2).uniform(-12, 12, (20, 2))
    coefficients = REAL_CAMERA.coefficients
    by_xy = central(lambda e: correct(coefficients, xy + e), 2, 1e-4)
    assert np.abs(by_xy - correct_jacobian(coefficients, xy)).max() < 1e-9
    steps = 1e-3 / np.abs(correct_derivatives(xy)).max(axis=(0, 1))
    by_k = central(lambda e: correct(coefficients + e, xy), 7, steps)
    assert np.abs((by_k - correct_derivatives(xy)) * steps).max() < 1e-12


def test_beyond_the_range_of_the_correction_is_nan_never_a_guess():
    coefficients = np.array([-1e-3, 0, 0, 0, 0, 0, 0])  # folds at r = sqrt(1000 / 3) = 18.3 mm, ideal 12.2 mm
    assert np.isfinite(distort(coefficients, np.array([12.0, 0.0]))).all()
    assert np.isnan(distort(coefficients, np.array([[13.0, 0.0], [100.0, -50.0]]))).all()


@settings(max_examples=40, deadline=None)
@given(k1=st.floats(-2e-4, 2e-4), p1=st.floats(-1e-5, 1e-5), b2=st.floats(-1e-3, 1e-3),
       x=st.floats(-14, 14), y=st.floats(-14, 14))
def test_distort_inverts_or_says_nan(k1, p1, b2, x, y):
    coefficients = np.array([k1, -4e-8, 0, p1, -p1, 0, b2])
    ideal = np.array([x, y])
    back = distort(coefficients, ideal)
    assert np.isnan(back).all() or np.abs(correct(coefficients, back) - ideal).max() < 1e-9


@pytest.mark.parametrize("wrong", [{"c": 0.0}, {"c": -35.0}, {"c": np.nan}, {"pixel_mm": 0.0}, {"pixel_mm": (0.1, -0.1)},
                                   {"width": 0}, {"k1": np.inf}])
def test_impossible_cameras_are_refused(wrong):
    with pytest.raises(BadProject):
        Interior(**{"c": 35.0, "pixel_mm": 0.004, "width": 6000, "height": 4000, **wrong})


def test_parameters_keep_their_order():
    assert dict(zip(PARAMETERS, REAL_CAMERA.parameters, strict=True))["b1"] == 1e-4
    assert REAL_CAMERA.coefficients[0] == 6e-5 and REAL_CAMERA.principal_point.tolist() == [0.12, -0.08]
