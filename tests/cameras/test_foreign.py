"""Cameras of other tools: their own formulas, there and back, and what a change of direction costs."""

import numpy as np
import pytest

from solvers import BadProject, Interior, Unsupported
from solvers.cameras import Forward
from solvers.cameras.brown import Brown
from solvers.cameras.foreign import (
    METASHAPE_TERMS,
    as_colmap,
    as_metashape,
    as_pix4d,
    from_colmap,
    from_metashape,
    from_opencv,
    from_pix4d,
    project_camera,
    to_brown,
    to_interior,
)

OURS = Interior(35.0, 0.21, -0.13, 2e-6, -1e-9, 0.0, 3e-6, -2e-6, 2e-4, -1e-4, pixel_mm=(0.004, 0.0041), width=6000, height=4000)
RAYS = np.column_stack([*np.random.default_rng(5).uniform([-0.3, -0.2], [0.3, 0.2], (60, 2)).T, -np.ones(60)])
"""In the photo's axes."""


def test_opencv_projects_as_opencv_does() -> None:
    import cv2

    matrix = np.array([[3000.0, 0, 1990.5], [0, 3010.0, 1480.25], [0, 0, 1]])
    d = np.array([-0.11, 0.05, 0.0012, -0.0007, -0.01, 0.02, -0.003, 0.001])
    vision = RAYS * [1, -1, -1]
    expected = cv2.projectPoints(vision, np.zeros(3), np.zeros(3), matrix, d)[0].reshape(-1, 2)
    camera = from_opencv(matrix, d, 4000, 3000)
    np.testing.assert_allclose(project_camera(camera, RAYS), expected, atol=1e-9)
    np.testing.assert_allclose(camera.ideal(expected), vision[:, :2], atol=1e-12)
    with pytest.raises(Unsupported, match="8"):
        from_opencv(matrix, np.full(12, 0.01), 4000, 3000)


def test_metashape_projects_by_its_manual() -> None:
    f, cx, cy, k1, k2, k3, k4, p1, p2, b1, b2 = 3650.0, 12.5, -8.25, -0.05, 0.03, -0.02, 0.004, 1.1e-3, -4e-4, 1.5, -0.7
    x, y = RAYS[:, 0], -RAYS[:, 1]
    r2 = x * x + y * y
    s = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
    xd = x * s + p1 * (r2 + 2 * x * x) + 2 * p2 * x * y
    yd = y * s + p2 * (r2 + 2 * y * y) + 2 * p1 * x * y
    corner = np.stack([5472 / 2 + cx + xd * f + xd * b1 + yd * b2, 3648 / 2 + cy + yd * f], -1)
    named = dict(f=f, cx=cx, cy=cy, k1=k1, k2=k2, k3=k3, k4=k4, p1=p1, p2=p2, b1=b1, b2=b2)
    camera = from_metashape(named, 5472, 3648)
    np.testing.assert_allclose(project_camera(camera, RAYS), corner - 0.5, atol=1e-9)  # its origin is the corner
    back, fit = as_metashape(camera)
    assert fit.max_px == 0 and back == pytest.approx(named, abs=1e-12)


def test_the_ten_parameters_there_and_back() -> None:
    brown, there = to_brown(OURS, METASHAPE_TERMS)
    ours, back = to_interior(brown)
    gap = np.abs(project_camera(brown, RAYS) - project_camera(OURS, RAYS)).max()
    assert 1e-9 < gap <= there.max_px < 1e-3  # told, not zero, and an upper bound
    assert np.abs(project_camera(ours, RAYS) - project_camera(brown, RAYS)).max() <= back.max_px < 1e-3
    assert np.abs(project_camera(ours, RAYS) - project_camera(OURS, RAYS)).max() < 1e-5
    assert (there.told("rc30")[0]).startswith("camera rc30: its distortion")


def test_what_distorts_nothing_is_exact() -> None:
    plain = Interior(35.0, 0.21, -0.13, b1=2e-4, b2=-1e-4, pixel_mm=(0.004, 0.0041), width=6000, height=4000)
    brown, fit = to_brown(plain, METASHAPE_TERMS)
    np.testing.assert_allclose(project_camera(brown, RAYS), project_camera(plain, RAYS), atol=1e-9)
    assert fit.max_px == 0 and not fit.told("x")
    np.testing.assert_allclose(to_interior(brown)[0].parameters, plain.parameters, atol=1e-12)


def test_our_forward_camera_is_theirs() -> None:
    camera = Forward(35.0, 0.21, -0.13, -0.02, 0.01, -0.003, 6e-4, -4e-4, pixel_mm=0.004, width=6000, height=4000)
    brown, fit = to_brown(camera)
    np.testing.assert_allclose(project_camera(brown, RAYS), project_camera(camera, RAYS), atol=1e-9)
    assert fit.max_px == 0 and type(to_interior(camera)[0]) is Interior


def test_terms_a_tool_lacks_are_fitted_and_told() -> None:
    brown, fit = to_brown(OURS, ("k1", "k2"))
    assert brown.fx == brown.fy and brown.p1 == 0 and fit.max_px > 1  # a pixel that is not square, in a square one
    gap = np.abs(project_camera(brown, RAYS) - project_camera(OURS, RAYS)).max()
    assert 0.3 * fit.max_px < gap <= fit.max_px


def test_pix4d_and_colmap_there_and_back() -> None:
    camera = from_pix4d(3700.5, (2740.25, 1820.75), (-0.01, 0.02, -0.003), (1e-4, -2e-4), 5472, 3648)
    assert (camera.cx, camera.cy) == (2739.75, 1820.25)
    values, _ = as_pix4d(camera)
    assert from_pix4d(*values.values(), 5472, 3648) == camera  # type: ignore[arg-type]
    for model, params in (("SIMPLE_PINHOLE", [3000, 2000, 1500]), ("PINHOLE", [3000, 3010, 2000, 1500]),
                          ("SIMPLE_RADIAL", [3000, 2000, 1500, -0.1]), ("RADIAL", [3000, 2000, 1500, -0.1, 0.02]),
                          ("OPENCV", [3000, 3010, 2000, 1500, -0.1, 0.02, 1e-3, 2e-3]),
                          ("FULL_OPENCV", [3000, 3010, 2000, 1500, -0.1, 0.02, 1e-3, 2e-3, 1e-3, 2e-3, -1e-3, 1e-4])):
        camera = from_colmap(model, params, 4000, 3000)
        assert camera.cx == 1999.5
        assert as_colmap(camera)[:2] == (model, params)
    with pytest.raises(Unsupported, match="undistort"):
        from_colmap("FOV", [1, 2, 3, 4, 5], 4000, 3000)


def test_folding_and_nonsense_are_refused() -> None:
    with pytest.raises(Unsupported, match="folds"):
        to_interior(Brown(1000, 1000, 999.5, 999.5, k1=-2.0, width=2000, height=2000))
    with pytest.raises(BadProject):
        Brown(float("nan"), 1, 0, 0, width=1, height=1)
    with pytest.raises(BadProject):
        Brown(-1, 1, 0, 0, width=1, height=1)
