"""Collinearity with all derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Exterior
from solvers.cameras import PARAMETERS, ideal_photo, project, project_derivatives
from tests.checks import central
from tests.synthetic import REAL_CAMERA, SEED_CAMERA, moved, scene


def test_golden_projection():
    """UTM numbers, reduced to the camera's position; tolerance 1e-8 mm."""
    centre = np.array([679421.0695, 9123785.2218, 794.8981])
    at = Exterior.from_angles(*np.radians([-2.6368, 3.9069, 88.933]), centre=centre)
    point = np.array([679430.0, 9123790.0, 495.0])
    xy = ideal_photo(35.0, at.shifted(centre), point - centre)
    assert np.abs(xy - [2.244313222591213, -3.4002199759975644]).max() < 1e-8
    assert np.abs(SEED_CAMERA.photo(project(SEED_CAMERA, at.shifted(centre), point - centre)) - xy).max() < 1e-12


def test_east_is_right_and_north_is_up_in_a_vertical_photo():
    at = Exterior.from_angles(0, 0, 0, np.array([0.0, 0, 100]))
    east, north = project(SEED_CAMERA, at, np.array([[10.0, 0, 0], [0, 10, 0]]))
    middle = project(SEED_CAMERA, at, np.zeros(3))
    assert east[0] > middle[0] and east[1] == middle[1]
    assert north[1] < middle[1] and north[0] == middle[0]


def test_behind_the_camera_is_nan():
    at = Exterior.from_angles(0, 0, 0, np.array([0.0, 0, 100]))
    assert np.isnan(project(SEED_CAMERA, at, np.array([[0.0, 0, 101], [0, 0, 100]]))).all()


def test_derivatives_against_differences():
    points, at = scene(np.random.default_rng(3), 15, 50, interior=REAL_CAMERA)
    got = project_derivatives(REAL_CAMERA, at, points)
    assert np.abs(got.pixels - project(REAL_CAMERA, at, points)).max() < 1e-9
    checked = {
        "centre": central(lambda e: project(REAL_CAMERA, moved(at, np.zeros(3), e), points), 3, 1e-3),
        "rotation": central(lambda e: project(REAL_CAMERA, moved(at, e, np.zeros(3)), points), 3, 1e-6),
        "point": central(lambda e: project(REAL_CAMERA, at, points + e), 3, 1e-3),
    }
    for name, numeric in checked.items():
        analytic = getattr(got, name)
        assert np.abs(numeric - analytic).max() < 2e-7 * np.abs(analytic).max(), name


@pytest.mark.parametrize("name", PARAMETERS)
def test_interior_derivatives_against_differences(name):
    points, at = scene(np.random.default_rng(4), 15, 36, interior=REAL_CAMERA)
    column = project_derivatives(REAL_CAMERA, at, points).interior[:, :, PARAMETERS.index(name)]
    h = 0.1 / np.abs(column).max()
    value = getattr(REAL_CAMERA, name)
    plus, minus = (project(replace(REAL_CAMERA, **{name: value + s * h}), at, points) for s in (1, -1))
    assert np.abs((plus - minus) / (2 * h) - column).max() < 1e-5 * np.abs(column).max()
