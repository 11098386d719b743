import numpy as np
import pytest

from solvers.cameras import Interior, project
from solvers.errors import BadProject
from solvers.simulation import KINDS, simulate
from solvers.simulation.scene import look_at


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_observes_its_truth(kind: str):
    exact, noisy = simulate(kind, 3, noise=0.0), simulate(kind, 3)
    of, block = exact.block.observations, exact.block
    rows = np.unique(np.linspace(0, len(of) - 1, 4000).astype(int))
    pixels = np.stack([project(exact.cameras[block.images[i].camera], exact.exteriors[block.images[i].name], exact.xyz[p])
                       for i, p in zip(of.image[rows], of.point[rows], strict=True)])
    assert np.abs(pixels - of.pixel[rows]).max() < 1e-6
    off = (noisy.block.observations.pixel[rows] - pixels) / noisy.block.observations.sigma[rows, None]
    assert 0.65 < off.std() < 1.35 and np.abs(off).max() < 5.5
    assert len(set(block.points.names)) == len(block.points) == len(exact.xyz)
    assert set(np.unique(of.point)) <= set(range(len(exact.xyz))) and len(np.unique(of.image)) == len(block.images)
    assert set(exact.truth) == {"images", "cameras", "points"}


def test_look_at_aims_and_keeps_upright():
    centre, target = np.array([3.0, -1.0, 8.0]), np.array([0.2, 0.4, 0.3])
    for roll in (0.0, 90.0):
        exterior = look_at(centre, target, roll)
        assert np.allclose(exterior.m @ exterior.m.T, np.eye(3), atol=1e-14) and np.linalg.det(exterior.m) == pytest.approx(1)
        u, v, w = exterior.camera(target)
        assert (u, v) == pytest.approx((0, 0), abs=1e-13) and w == pytest.approx(-np.linalg.norm(centre - target))
    up = look_at(centre, target).camera(target + np.array([0, 0.1, 0]))
    assert up[1] > 0 and up[0] == pytest.approx(0, abs=1e-13)


def test_ono_stations_and_points_are_those_of_their_table():
    """Ono & Hattori 2002, Table 1 (mm there, m here)."""
    triplet, stereo = simulate("ono_triplet", 0), simulate("ono_stereo", 0)
    assert [e.centre.tolist() for e in triplet.exteriors.values()] == [[-3, 0.5, 10], [3, 0.4, 10], [0, 0.4, 11]]
    assert list(stereo.exteriors) == ["A", "B"] and len(stereo.xyz) == 12
    assert stereo.xyz[7].tolist() == [0.25, 0.8, 0.35]
    assert (stereo.block.cameras["camera"].c, stereo.block.image_px * 0.005) == (300.0, pytest.approx(0.001))
    assert (stereo.block.points.xyz - stereo.xyz).std() == pytest.approx(0.010, rel=0.4)


def test_the_long_range_field_has_its_distance_span_and_middle_images():
    field = simulate("field_long_range", 2, relief=0.2, span=60.0)
    a, *_, e = field.exteriors.values()
    assert np.hypot(a.centre[0], a.centre[2]) == pytest.approx(105)
    assert np.degrees(np.arctan2(e.centre[0], e.centre[2]) - np.arctan2(a.centre[0], a.centre[2])) == pytest.approx(60)
    assert len(field.xyz) == 28 and np.ptp(field.xyz[:, 2]) < 0.45
    assert list(simulate("field_long_range", 2, images=3).exteriors) == ["B", "C", "D"]


def test_the_plate_hides_its_true_camera_and_rolls_by_quarter_turns():
    plate = simulate("calibration_plate", 1)
    known, true = plate.block.cameras["camera"], plate.cameras["camera"]
    assert known == Interior(true.c, pixel_mm=true.pixel_mm, width=true.width, height=true.height) and true.coefficients.any()
    assert len(plate.xyz) == 36 and len(plate.exteriors) == 8
    assert len(plate.block.observations) > 0.9 * 36 * 8
    rolls = {round(np.degrees(np.arctan2(e.m[0, 1], e.m[0, 0])) / 90) % 4 for e in plate.exteriors.values()}
    assert rolls == {0, 1, 2, 3}


def test_the_uav_block_overlaps_as_asked_and_hides_its_tie_points():
    scene = simulate("uav_block", 5, strips=2, images=5, forward=0.8, side=0.5, height=150.0, ties=200)
    centres = np.stack([e.centre for e in scene.exteriors.values()])
    photo = 150 * 4000 * 23.5 / 6000 / 35
    assert np.abs(np.diff(centres[:5, 1])).mean() == pytest.approx(0.2 * photo, rel=0.2)
    roles = np.array(scene.block.points.role)
    assert (roles == "control").sum() == 8 and (roles == "check").sum() == 8
    assert np.isnan(scene.block.points.xyz[roles == "tie"]).all() and np.isfinite(scene.block.points.xyz[roles != "tie"]).all()
    rays = np.bincount(scene.block.observations.point, minlength=len(roles))
    assert rays[roles == "tie"].min() >= 2 and rays[roles == "tie"].mean() > 3


def test_a_block_beyond_the_country_is_refused():
    with pytest.raises(BadProject, match="fly lower, overlap more, or take fewer images"):
        simulate("uav_block", 0, strips=9)
