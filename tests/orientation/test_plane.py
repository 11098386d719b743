"""Control in one plane: both reversal solutions, how far apart they are, and which was chosen with what probability."""

import numpy as np
import pytest

from solvers import Exterior
from solvers.geometry import rotation
from solvers.orientation import resect, resect_orthogonal
from tests.checks import angle_between, assert_same
from tests.synthetic import SEED_EXTERIOR, block_of, cluster, scene

NECKER = [  # where, points, field of view [deg], D at 0.3 px and control without error
    ('centre', 4, 0.5, 0.09282999754380492),
    ('centre', 4, 1.0, 0.3697382326600812),
    ('centre', 4, 2.0, 1.4520320388337906),
    ('centre', 4, 3.0, 3.14588179293002),
    ('centre', 4, 6.0, None),
    ('centre', 4, 10.0, None),
    ('corner', 4, 0.5, 0.3178123527385486),
    ('corner', 4, 1.0, 1.2707846750639995),
    ('corner', 4, 2.0, 5.075673932378329),
    ('corner', 4, 3.0, 11.392033648001558),
    ('corner', 4, 6.0, 44.93441775030349),
    ('corner', 4, 10.0, 119.90439703510592),
    ('centre', 10, 0.5, 0.1021424827829272),
    ('centre', 10, 1.0, 0.4026796367742121),
    ('centre', 10, 2.0, 1.5471010151802824),
    ('centre', 10, 3.0, 3.259255520299336),
    ('centre', 10, 6.0, None),
    ('centre', 10, 10.0, None),]


@pytest.mark.parametrize("where, n, fov, d", NECKER)
def test_discrimination_against_independent_values(where, n, fov, d):
    points = cluster((0.0, 0.0) if where == "centre" else (8.0, 5.0), n, fov, 0.0)
    block = block_of(points, SEED_EXTERIOR, sigma_m=0.0)
    for solve in (resect, resect_orthogonal):
        got = solve(block, "a")
        if d is None:
            assert got.discrimination is None or got.discrimination > 100
        else:
            assert got.discrimination == pytest.approx(d, rel=0.01)
            assert (d < 6) == any("ambiguous" in w for w in got.warnings)
        if d is not None and d < 6 and solve is resect:
            both = [got, *got.alternatives]
            assert len(both) >= 2, "both reversal solutions are reported"
            assert min(angle_between(o.exterior, SEED_EXTERIOR) for o in both) < 1e-6


def test_the_second_solution_mirrors_the_plane_about_the_viewing_ray():
    points = cluster((8.0, 5.0), 6, 1.0, 0.0)
    got = resect(block_of(points, SEED_EXTERIOR, sigma_m=0.0), "a")
    other = got.alternatives[0]
    ray = points.mean(axis=0) - SEED_EXTERIOR.centre
    ray /= np.linalg.norm(ray)
    separation = np.degrees(2 * np.arccos(abs(ray[2])))  # the plane is horizontal
    assert np.degrees(angle_between(got.exterior, other.exterior)) == pytest.approx(separation, abs=1.0)
    assert other.model == "perspective" and other.trace.converged and np.isfinite(other.covariance).all()


def test_the_choice_is_right_as_often_as_stated():
    """P(correct) = Phi(D / 2) = 0.737 at the corner, 1 degree, 0.3 px; 60 runs: +-3.5 sd."""
    points = cluster((8.0, 5.0), 4, 1.0, 0.0)
    right = 0
    for seed in range(60):
        got = resect(block_of(points, SEED_EXTERIOR, noise_px=0.3, sigma_m=0.0, seed=seed), "a")
        right += angle_between(got.exterior, SEED_EXTERIOR) < np.radians(15.5)
    assert 0.54 < right / 60 < 0.93


@pytest.mark.parametrize("tilt_deg", [0, 30, 70, 90])
@pytest.mark.parametrize("n", [3, 4, 9])
@pytest.mark.parametrize("solve", [resect, resect_orthogonal])
def test_truth_is_among_the_solutions(tilt_deg, n, solve):
    """A plane of control under any tilt towards the photo, up to a horizontal camera before a wall."""
    rng = np.random.default_rng(10 * n + tilt_deg)
    plane = np.column_stack([rng.uniform(-40, 40, (n, 2)), np.zeros(n)])
    to_camera = rotation(np.radians(min(tilt_deg, 75)), 0.1, 0.4)
    at = Exterior(to_camera, to_camera.T @ [3.0, -2.0, 300.0])
    turn = rotation(np.radians(90 if tilt_deg == 90 else 0), 0, 0)  # the wall: plane and camera turned together
    points, at = plane @ turn.T, Exterior(at.m @ turn.T, turn @ at.centre)
    got = solve(block_of(points, at), "a")
    every = [got, *got.alternatives]
    assert min(angle_between(o.exterior, at) for o in every) < 1e-7, got.warnings
    assert n == 3 or angle_between(got.exterior, at) < 1e-7


def test_nearly_plane_control_is_named_and_choice_said_in_words():
    points = cluster(n=8, fov_deg=6, relief=0.2)
    got = resect(block_of(points, SEED_EXTERIOR), "a")
    assert any("nearly coplanar" in w for w in got.warnings)
    flat = resect(block_of(cluster((8.0, 5.0), n=8, fov_deg=6, relief=0.0), SEED_EXTERIOR), "a")
    assert any("one plane" in w or "ambiguous" in w for w in flat.warnings)


def test_relief_removes_the_ambiguity():
    points, at = scene(np.random.default_rng(1), 10, 20)
    got = resect(block_of(points, at), "a")
    assert got.discrimination is None or got.discrimination > 6
    assert not any("ambiguous" in w for w in got.warnings)
    assert_same(got.exterior, at, 1e-6, 1e-9)
