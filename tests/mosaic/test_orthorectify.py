"""Orthophotos: every pixel where its coordinates say, on planes and over hills, and nothing shown that is hidden."""

import numpy as np
import pytest

from solvers import Exterior, Interior
from solvers.cameras import project
from solvers.errors import DegenerateGeometry
from solvers.geometry import Grid, Surface
from solvers.mosaic import Ground, MosaicPlane, Placed, fit_plane, orthorectify

from .land import CAMERA, FLAT, FRAME, hills, land, offset, seen_from, strip
from .land import at as place

COL, ROW = np.meshgrid(np.arange(400, dtype=np.float32), np.arange(300, dtype=np.float32))


def centres(grid: Grid) -> np.ndarray:
    col, row = np.meshgrid(np.arange(grid.shape[1]), np.arange(grid.shape[0]))
    return grid.to_map(np.stack([col, row], -1))


@pytest.mark.parametrize("surface", [MosaicPlane(0.0), MosaicPlane(1.0, 0.05, -0.08), hills()], ids=["level", "tilted", "hills"])
def test_a_pixel_shows_the_photo_pixel_that_its_place_is_projected_to(surface):
    photo = strip(1)[0]
    values, seen, grid = orthorectify(np.dstack([COL, ROW]), CAMERA, place(photo), surface, gsd=0.4, frame=FRAME)
    local = Ground(FRAME, surface).local(centres(grid))
    pixels = project(CAMERA, place(photo), local)
    inner = CAMERA.inside(pixels, -1.0)
    assert seen[inner].all() and inner.mean() > 0.5
    assert np.abs(values - pixels)[inner].max() < 0.02
    assert not seen[~CAMERA.inside(pixels, 0.02)].any()


def test_the_land_lies_where_its_coordinates_say():
    photo = strip(1)[0]
    for surface in (MosaicPlane(0.0), hills()):
        ground = Ground(FRAME, surface)
        values, seen, grid = orthorectify(seen_from(photo, ground), CAMERA, place(photo), surface, frame=FRAME)
        assert grid.affine[0] == pytest.approx(0.25, rel=0.05)
        assert np.abs(offset(values, centres(grid), seen, grid.affine[0])).max() < 0.02


def test_a_wall_hides_the_ground_behind_it():
    cell, n = 1.0, 80
    z = np.zeros((n, n))
    z[:, 40:43] = 15.0  # a wall from north to south, 15 m high
    surface = Surface(Grid((n, n), (cell, 0.0, 0.0, 0.0, -cell, float(n))), z)
    camera = Interior(10.0, pixel_mm=0.05, width=400, height=400)
    exterior = Exterior.from_angles(0.0, 0.0, 0.0, np.array([10.0, 40.0, 60.0]))  # west of the wall
    _, seen, grid = orthorectify(np.ones((400, 400), np.float32), camera, exterior, surface, gsd=0.5)
    x = centres(grid)[0, :, 0]
    row = seen[grid.shape[0] // 2]
    shadow = 43 + 15 * (42.5 - 10) / 45  # the ray over the wall's upper edge meets the ground there
    assert row[(x > 2) & (x < 38)].all()
    assert not row[(x > 44.5) & (x < shadow - 2)].any()
    assert row[(x > shadow + 2) & (x < 58)].all()


def test_the_horizon_is_clipped_and_the_sky_refused():
    camera = Interior(10.0, pixel_mm=0.05, width=300, height=200)
    oblique = Exterior.from_angles(np.radians(75.0), 0.0, 0.0, np.array([0.0, 0.0, 50.0]))
    _, seen, grid = orthorectify(np.ones((200, 300), np.float32), camera, oblique, 0.0, gsd=0.5)
    away = np.linalg.norm(centres(grid)[seen], axis=1)
    assert away.max() < 50 * np.tan(np.radians(75.5)) and seen.any()
    with pytest.raises(DegenerateGeometry, match=r"'photo'.*sky"):
        orthorectify(np.ones((200, 300), np.float32), camera,
                     Exterior.from_angles(np.radians(130.0), 0.0, 0.0, np.array([0.0, 0.0, 50.0])), 0.0)


def test_a_plane_is_fitted_and_a_line_of_points_is_not():
    rng = np.random.default_rng(2)
    xy = rng.uniform(-50, 50, (40, 2))
    z = 3 + 0.02 * xy[:, 0] - 0.05 * xy[:, 1] + 0.1 * rng.standard_normal(40)
    plane = fit_plane(np.column_stack([xy, z]))
    assert (plane.z, plane.slope_x, plane.slope_y) == pytest.approx((3, 0.02, -0.05), abs=0.06)
    assert plane.sigma == pytest.approx(0.1, rel=0.4)
    assert fit_plane(np.column_stack([xy, z]), tilted=False).slope_x == 0
    with pytest.raises(DegenerateGeometry, match="one line"):
        fit_plane(np.column_stack([xy[:, 0], 2 * xy[:, 0], z]))


def test_a_photo_placed_by_plane_coefficients_is_the_same():
    from solvers.mosaic.registration import plane_warp

    photo = strip(1)[0]
    warped = Placed("p0", CAMERA, warp=plane_warp(CAMERA, place(photo), np.zeros(3)))
    at = np.random.default_rng(3).uniform(-30, 30, (50, 3)) * [1, 1, 0]
    assert np.allclose(warped.pixels(at), photo.pixels(at), atol=1e-7)
    assert np.allclose(warped.outline(FLAT)[0], photo.outline(FLAT)[0], atol=1e-5)
    assert warped.resolution(FLAT) == pytest.approx(photo.resolution(FLAT), rel=1e-6)
    assert np.abs(land(warped.outline(FLAT)[0]) - 128).max() < 110
