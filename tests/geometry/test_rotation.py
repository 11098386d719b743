"""omega, phi, kappa, the rotation vector, and the frame of computer vision."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from solvers import Exterior
from solvers.geometry import angle_derivatives, angles, closest_rotation, exp, from_opencv, log, rotation, skew, to_opencv
from solvers.geometry.rotation import exp_many, log_many
from tests.checks import central
from tests.synthetic import random_rotation

GOLDEN_M = np.array([[0.018578311671115465, 0.9987096445835933, -0.04726406828832473],
                     [-0.997503086855344, 0.021735870730774605, 0.06719481853264433],
                     [0.06813543901312182, 0.04589768773356219, 0.9966197691252173]])
turn = st.floats(-np.pi, np.pi)
tilt = st.floats(-np.pi / 2, np.pi / 2)


def test_golden_rotation():
    assert np.abs(rotation(*np.radians([-2.6368, 3.9069, 88.933])) - GOLDEN_M).max() < 1e-12


@settings(max_examples=100, deadline=None)
@given(turn, tilt, turn)
def test_angles_give_the_same_rotation_back(omega, phi, kappa):
    m = rotation(omega, phi, kappa)
    assert np.abs(m @ m.T - np.eye(3)).max() < 1e-14 and np.linalg.det(m) > 0
    assert np.abs(rotation(*angles(m)) - m).max() < 2e-12


@pytest.mark.parametrize("phi", [np.pi / 2, -np.pi / 2])
@pytest.mark.parametrize("off", [0.0, 1e-13, 1e-11, 1e-8, 1e-5])
def test_gimbal_lock_keeps_the_rotation_and_sets_kappa_to_zero(phi, off):
    m = rotation(0.3, phi - np.sign(phi) * off, 1.1)
    got = angles(m)
    assert np.isfinite(got).all()
    assert np.abs(rotation(*got) - m).max() < 3e-12
    assert off > 1e-12 or got[2] == 0


def test_kappa_turns_the_photo_about_its_axis():
    """A camera turned by +90 degrees about Z sees north at its right."""
    assert np.allclose(rotation(0, 0, np.pi / 2) @ [0, 1, 0], [1, 0, 0])


@settings(max_examples=100, deadline=None)
@given(st.tuples(*(3 * [st.floats(-1, 1)])),
       st.sampled_from([0.0, 1e-12, 1e-7, 1e-5, 0.1, 3.0, np.pi - 1e-5, np.pi - 1e-9, np.pi]))
def test_log_inverts_exp_up_to_pi(axis, theta):
    axis = np.array(axis)
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0, 1])
    d = theta * axis / np.linalg.norm(axis)
    r = exp(d)
    assert np.abs(r @ r.T - np.eye(3)).max() < 1e-14
    assert np.abs(exp(log(r)) - r).max() < 1e-13
    assert np.linalg.norm(log(r)) <= np.pi + 1e-12
    if theta < np.pi - 1e-6:
        assert np.abs(log(r) - d).max() < 1e-9


def test_exp_of_a_small_vector_is_its_cross_product():
    d = np.array([1e-9, -2e-9, 3e-9])
    assert np.abs(exp(d) - np.eye(3) - skew(d)).max() < 1e-16
    assert np.allclose(skew(d) @ [4, 5, 6], np.cross(d, [4, 5, 6]))


@pytest.mark.parametrize("phi_deg", [0, 40, -80, 89.9])
def test_angle_derivatives_against_differences(phi_deg):
    m = rotation(0.4, np.radians(phi_deg), -2.0)
    h = 1e-6 * np.cos(np.radians(phi_deg))
    numeric = central(lambda d: angles(exp(d) @ m), 3, h)
    assert np.abs(numeric - angle_derivatives(m)).max() < 1e-6 * np.abs(numeric).max()


def test_closest_rotation_undoes_a_small_deformation_and_never_mirrors():
    rng = np.random.default_rng(1)
    m = random_rotation(rng)
    assert np.abs(closest_rotation(2.5 * m) - m).max() < 1e-14
    assert np.linalg.det(closest_rotation(np.diag([1.0, 1, -0.5]) @ m)) > 0


def test_opencv_frame_looks_forward_with_y_down_and_back():
    at = Exterior.from_angles(0.1, 0.2, 0.3, np.array([1.0, 2, 3]))
    r, centre = to_opencv(at)
    point = at.centre + at.m.T @ [0.5, 0.25, -4.0]  # right of, above and in front of the camera
    assert np.allclose(r @ (point - centre), [0.5, -0.25, 4.0])
    assert np.linalg.det(r) > 0
    back = from_opencv(r, centre)
    assert np.array_equal(back.m, at.m) and np.array_equal(back.centre, at.centre)


def test_exterior_vector_round_trip_and_angle_covariance():
    at = Exterior.from_angles(0.1, -0.4, 2.0, np.array([1e6, 5e6, 300.0]))
    again = Exterior.from_vector(at.vector)
    assert np.array_equal(again.m, at.m) and np.array_equal(again.centre, at.centre)
    rng = np.random.default_rng(2)
    root = rng.standard_normal((6, 6)) * 1e-4
    draws = rng.standard_normal((4000, 6)) @ root.T
    samples = np.array([[*(at.centre * 0 + d[:3]), *(Exterior(exp(d[3:]) @ at.m, at.centre).angles - at.angles)] for d in draws])
    predicted = at.angle_covariance(root @ root.T)
    assert np.allclose(np.cov(samples.T) / np.sqrt(np.outer(np.diag(predicted), np.diag(predicted))),
                       predicted / np.sqrt(np.outer(np.diag(predicted), np.diag(predicted))), atol=0.08)


def test_many_rotation_vectors_are_those_one_by_one() -> None:
    rng = np.random.default_rng(4)
    d = rng.normal(size=(60, 3)) * np.r_[np.full(20, 1e-9), np.full(20, 0.3), np.full(20, 1.0)][:, None]
    m = np.concatenate([exp_many(d), np.eye(3)[None], np.diag([1.0, -1.0, -1.0])[None]])
    np.testing.assert_allclose(log_many(m), [log(one) for one in m], rtol=0, atol=1e-12)
