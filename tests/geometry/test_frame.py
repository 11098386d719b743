"""Map coordinates are not Cartesian: the tangent frame at the block's origin."""

import numpy as np
import pytest

from solvers import BadProject, Exterior
from solvers.geometry import LocalFrame
from solvers.orientation import resect
from tests.checks import assert_same
from tests.synthetic import SEED_CAMERA, block_of

CENTRE, EDGE = np.array([500000.0, 5400000.0, 300.0]), np.array([780000.0, 5400000.0, 300.0])


@pytest.mark.parametrize("origin", [CENTRE, EDGE])
def test_round_trip(origin):
    frame = LocalFrame(origin, "EPSG:32632")
    xyz = origin + np.random.default_rng(1).uniform(-5000, 5000, (50, 3)) * [1, 1, 0.1]
    assert np.abs(frame.to_map(frame.to_local(xyz)) - xyz).max() < 1e-7
    assert np.abs(frame.to_local(origin)).max() < 1e-8
    assert frame.to_local(xyz.reshape(5, 10, 3)).shape == (5, 10, 3)


@pytest.mark.parametrize("origin, scale", [(CENTRE, 0.9996), (EDGE, 1.0006)])
def test_grid_scale_curvature_and_axes(origin, scale):
    frame = LocalFrame(origin, "EPSG:32632")
    east, north, up = frame.to_local(origin + 100 * np.eye(3))
    assert abs(np.linalg.norm(east) - 100 / scale) < 0.02 and abs(np.linalg.norm(north) - 100 / scale) < 0.02
    assert abs(up[2] - 100) < 1e-6 and np.abs(up[:2]).max() < 1e-6  # heights are not scaled
    assert abs(east[1]) < 1e-6 and east[0] > 0 and north[1] > 0  # axes are the grid's, not the meridian's
    far = frame.to_local(origin + np.array([0, 10000, 0]))
    assert abs(far[2] + 10000**2 / 2 / 6.37e6) < 0.1  # the earth falls away


@pytest.mark.parametrize("origin", [CENTRE, EDGE])
def test_a_cartesian_truth_written_as_utm_is_found_again(origin):
    """The truth lives in the tangent frame, the project states UTM; taken as Cartesian it is biased by scale * height."""
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(-80, 80, 12), rng.uniform(-50, 50, 12), rng.uniform(-1, 1, 12)])
    points -= points.mean(axis=0)
    at = Exterior.from_angles(0.05, -0.03, 1.2, np.array([3.0, -4.0, 300.0]))
    frame = LocalFrame(origin, "EPSG:32632")
    block = block_of(points, at, crs="EPSG:32632", map_points=frame.to_map(points))
    got = resect(block, "a").exterior
    assert np.abs(got.centre - frame.to_map(at.centre)).max() < 1e-6
    assert np.abs(got.angles - at.angles).max() < 1e-6  # axes turn with the origin, some m away, by some 1e-7 rad
    plain = resect(block_of(points, at, crs="EPSG:32632", frame="grid", map_points=frame.to_map(points)), "a").exterior
    bias = plain.centre[2] - frame.to_map(at.centre)[2]
    scale = 100 / np.linalg.norm(frame.to_local(origin + np.array([100, 0, 0])))
    assert bias == pytest.approx(300 * (scale - 1), abs=0.01)
    assert origin is EDGE or bias == pytest.approx(-0.12, abs=0.02)  # and 0.014 for the terrain height


def test_local_and_grid_only_subtract_the_origin():
    xyz = np.array([[1e6, 2e6, 10.0], [1e6 + 1, 2e6, 11.0], [np.nan, 0, 0]])
    for frame in (LocalFrame.around(xyz), LocalFrame.around(xyz, "EPSG:32632", "grid")):
        assert frame.cartesian and frame.origin.tolist() == [1e6, 2e6, 10.0]
        assert np.allclose(frame.to_local(xyz[1]), [1, 0, 1])


@pytest.mark.parametrize("crs, word", [("EPSG:4326", "not a map projection"), ("nonsense", "not known"), ("EPSG:2263", "metres")])
def test_crs_that_cannot_serve_is_refused_with_a_cure(crs, word):
    with pytest.raises(BadProject, match=word):
        LocalFrame(np.zeros(3), crs).to_local(np.zeros((1, 3)))


def test_a_compound_crs_uses_its_horizontal_part():
    plain, compound = (LocalFrame(CENTRE, crs) for crs in ("EPSG:25832", "EPSG:5555"))
    assert np.abs(plain.to_local(CENTRE + 50) - compound.to_local(CENTRE + 50)).max() < 1e-6


def test_camera_far_from_the_control_survives_the_frame():
    points = np.random.default_rng(3).uniform(-400, 400, (10, 3)) * [1, 1, 0.1]
    at = Exterior.from_angles(0.0, 0.0, 0.0, np.array([0.0, 0.0, 5000.0]))
    frame = LocalFrame(CENTRE, "EPSG:32632")
    got = resect(block_of(points, at, SEED_CAMERA, crs="EPSG:32632", map_points=frame.to_map(points)), "a").exterior
    assert_same(Exterior(got.m, frame.to_local(got.centre)), at, 1e-3, 5e-5)  # axes at the centroid, 100 m off
