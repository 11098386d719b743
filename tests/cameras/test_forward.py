"""The forward camera: the same picture as OpenCV's, its inverse, its derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Exterior
from solvers.cameras import PARAMETERS, Forward, Unsided, project, project_derivatives
from tests.checks import central
from tests.synthetic import moved, scene

CAMERA = Forward(35.0, 0.1, -0.2, -0.08, 0.06, -0.02, 1e-3, -7e-4, 2e-4, -1e-4, pixel_mm=0.004, width=6000, height=4000)


def test_the_same_picture_as_opencv():
    """p1, p2 change places and the sign of y; cv2.projectPoints is an independent implementation."""
    import cv2

    camera = replace(CAMERA, b1=0.0, b2=0.0)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.3, 0.3, (50, 2)), np.full(50, -1.0)])  # photo axes: z back
    f, (cx, cy) = camera.c / camera.pitch[0], camera.pixels(camera.principal_point)
    k = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]])
    d = np.array([camera.k1, camera.k2, -camera.p2, camera.p1, camera.k3])
    wanted, _ = cv2.projectPoints(points * [1, -1, -1], np.zeros(3), np.zeros(3), k, d)
    got = project(camera, Exterior(np.eye(3), np.zeros(3)), points)
    np.testing.assert_allclose(got, wanted[:, 0], atol=1e-9)


def test_there_and_back():
    pixels = np.random.default_rng(2).uniform(0, [5999, 3999], (200, 2))
    np.testing.assert_allclose(CAMERA.measured(CAMERA.ideal(pixels)), pixels, atol=1e-9)


def test_derivatives_against_differences():
    points, at = scene(np.random.default_rng(3), 20, 40, interior=CAMERA)
    got = project_derivatives(CAMERA, at, points)
    for analytic, numeric in ((got.centre, central(lambda e: project(CAMERA, moved(at, np.zeros(3), e), points), 3, 1e-3)),
                              (got.rotation, central(lambda e: project(CAMERA, moved(at, e, np.zeros(3)), points), 3, 1e-6))):
        assert np.abs(numeric - analytic).max() < 2e-7 * np.abs(analytic).max()
    for k, name in enumerate(PARAMETERS):
        column = got.interior[:, :, k]
        h = 0.1 / np.abs(column).max()
        plus, minus = (project(replace(CAMERA, **{name: getattr(CAMERA, name) + s * h}), at, points) for s in (1, -1))
        assert np.abs((plus - minus) / (2 * h) - column).max() < 1e-5 * np.abs(column).max(), name


def test_only_the_unsided_one_sees_what_is_behind():
    at, point = Exterior(np.eye(3), np.zeros(3)), np.array([[0.1, 0.2, 3.0]])
    assert np.isnan(project(CAMERA, at, point)).all()
    both = Unsided(500.0, pixel_mm=1.0, width=100, height=100)
    x, y = both.photo(project(both, at, point))[0]
    assert (x, y) == (pytest.approx(-500 * 0.1 / 3), pytest.approx(-500 * 0.2 / 3))
