"""Initial values without approximate values: every start, all three-point roots, all local minima."""

import numpy as np
import pytest

from solvers.cameras import ideal_photo
from solvers.geometry import rotation
from solvers.orientation import candidates, three_points
from solvers.orientation.initial import direct_linear, plane_homography, recentring, scaled_orthography, turned
from tests.checks import angle_between
from tests.synthetic import random_rotation, scene


@pytest.mark.parametrize("seed", range(12))
def test_three_points_roots_are_exact_and_hold_the_truth(seed):
    points, at = scene(np.random.default_rng(seed), 3, 40)
    xy = ideal_photo(35.0, at, points)
    found = three_points(points, xy, 35.0)
    assert 1 <= len(found) <= 4
    assert min(angle_between(e, at) for e in found) < 1e-7
    for e in found:
        assert np.nanmax(np.abs(ideal_photo(35.0, e, points) - xy)) < 1e-4
        assert np.linalg.det(e.m) == pytest.approx(1)


def test_a_symmetric_triangle_has_several_roots():
    """An equilateral triangle seen from above its centre: four roots (Wolfe et al. 1991)."""
    corners = np.array([[np.cos(a), np.sin(a), 0.0] for a in np.radians([90, 210, 330])])
    xy = ideal_photo(1.0, type(scene(np.random.default_rng(0), 3)[1])(np.eye(3), np.array([0, 0, 2.0])), corners)
    found = three_points(corners, xy, 1.0)
    distinct = []
    for e in found:
        if all(angle_between(e, o) > 1e-3 for o in distinct):
            distinct.append(e)
    assert len(distinct) == 4


def test_each_start_is_near_the_truth_where_it_applies():
    rng = np.random.default_rng(1)
    points, at = scene(rng, 12, 30)
    mean = points.mean(axis=0)
    xy = ideal_photo(35.0, at, points)
    assert min(angle_between(e, at) for e in direct_linear(points, xy, 35.0)) < 1e-6
    flat = points * [1, 1, 0]
    view = rotation(0.3, 0.2, 1.0)
    tilted = type(at)(view, view.T @ [0, 0, 400.0])
    assert min(angle_between(e, tilted) for e in plane_homography(flat, ideal_photo(35.0, tilted, flat), 35.0)) < 1e-6
    narrow, at = scene(rng, 8, 3, depth=0.02)
    xy = ideal_photo(35.0, at, narrow)
    r = recentring(xy, 35.0)
    views = scaled_orthography(narrow, turned(xy, 35.0, r), 35.0)
    assert min(angle_between(type(at)(r.T @ e.m, e.centre), at) for e in views) < 1e-3
    assert np.isfinite(mean).all()


def test_recentring_turns_the_mean_ray_to_the_axis():
    xy = np.random.default_rng(2).uniform(5, 9, (6, 2))
    r = recentring(xy, 35.0)
    assert np.abs(r @ r.T - np.eye(3)).max() < 1e-14 and np.linalg.det(r) > 0
    v = np.column_stack([turned(xy, 35.0, r), np.full(6, -35.0)])
    mean = (v / np.linalg.norm(v, axis=1, keepdims=True)).mean(axis=0)
    assert np.abs(mean[:2]).max() < 1e-12


@pytest.mark.parametrize("fov", [2, 6, 20, 50])
def test_random_attitudes_are_found_without_approximate_values(fov):
    """docs/formulas.md, section 4: fields of 2 to 50 degrees, 4 to 11 points, any attitude; the best candidate is the truth."""
    rng = np.random.default_rng(fov)
    for _ in range(15):
        n = int(rng.integers(4, 12))
        points, at = scene(rng, n, fov, m=random_rotation(rng))
        xy = ideal_photo(35.0, at, points) + 0.0003 * rng.standard_normal((n, 2))
        found = candidates(points - points.mean(axis=0), xy, 35.0)
        costs = [k.cost for k in found]
        assert costs == sorted(costs)
        near = np.radians(3 if fov == 2 else 0.5)
        assert min(angle_between(k.exterior, at) for k in found[:2]) < near
        for i, k in enumerate(found):
            assert k.source and all(angle_between(k.exterior, o.exterior) > np.radians(0.01) for o in found[:i])


def test_nothing_in_front_gives_no_candidate():
    points, at = scene(np.random.default_rng(3), 8, 40)
    xy = ideal_photo(35.0, at, points)
    for k in candidates(points, xy * [1, -1], 35.0):  # a mirrored photo
        assert (k.exterior.camera(points)[:, 2] < 0).all() and k.cost > 1e-3
