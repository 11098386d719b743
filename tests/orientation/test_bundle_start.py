"""Start values of large blocks without approximations; where rays meet, all points at once."""

from dataclasses import replace

import numpy as np

from solvers.orientation.bundle.given import BundleRequest, given
from solvers.orientation.bundle.meeting import misses, points, without_wrong_rays
from solvers.orientation.bundle.start import start
from solvers.orientation.rays import Intersection
from solvers.simulation import large_block

MADE = large_block(3, images=150, points=15)
BLOCK = replace(MADE.block, images=tuple(replace(i, prior=None) for i in MADE.block.images))
DATA = given(BLOCK, BundleRequest())
TRUE = {i: replace(MADE.exteriors[image.name], centre=DATA.frame.to_local(MADE.exteriors[image.name].centre))
        for i, image in enumerate(BLOCK.images)}


def test_errors_do_not_grow_from_image_to_image() -> None:
    poses, _, said = start(DATA)
    assert len(poses) == 150 and not said
    off = np.array([poses[i].centre - TRUE[i].centre for i in poses])
    assert np.abs(off).max() < 0.25
    assert np.nanpercentile(misses(DATA, poses, points(DATA, poses)), 90) < 2.3


def test_without_control_the_shape_is_found_all_the_same() -> None:
    known = BLOCK.points
    bare = replace(BLOCK, points=replace(known, xyz=np.full_like(known.xyz, np.nan), role=("tie",) * len(known)))
    data = given(bare, BundleRequest(datum="free"))
    poses, xyz, said = start(data)
    assert len(poses) == 150 and "arbitrary" in said[0]
    assert np.nanpercentile(misses(data, poses, xyz), 90) < 2.3


def test_points_are_where_their_rays_meet() -> None:
    xyz, rows = points(DATA, TRUE), np.flatnonzero(np.bincount(DATA.point)[DATA.point] >= 2)
    names, point = np.unique(DATA.point[rows], return_inverse=True)
    problem = Intersection(tuple((DATA.camera(i), TRUE[i]) for i in sorted(TRUE)), DATA.image[rows], point, DATA.pixels[rows],
                           DATA.sigma[rows], np.broadcast_to(np.eye(2), (len(rows), 2, 2)), len(names))
    np.testing.assert_allclose(xyz[names], problem.start().reshape(-1, 3), atol=1e-8)
    assert np.linalg.norm(xyz[names] - DATA.frame.to_local(MADE.xyz[names]), axis=1).max() < 0.2
    one_image = {0: TRUE[0]}
    assert np.isnan(points(DATA, one_image)).all() and np.isnan(misses(DATA, one_image, xyz)[DATA.image != 0]).all()


def test_a_ray_that_misses_all_others_does_not_move_the_point() -> None:
    rays = np.bincount(DATA.point)
    j = int(np.flatnonzero(rays == 5)[0])
    row = int(np.flatnonzero(DATA.point == j)[2])
    pixels = DATA.pixels.copy()
    pixels[row] += [300.0, -200.0]
    wrong = replace(DATA, pixels=pixels)
    xyz, good = points(wrong, TRUE), points(DATA, TRUE)
    before = np.linalg.norm(xyz[j] - good[j])
    without_wrong_rays(wrong, TRUE, xyz)
    assert before > 0.5 and np.linalg.norm(xyz[j] - good[j]) < 0.05
    others = np.arange(len(xyz)) != j
    np.testing.assert_array_equal(xyz[others], points(wrong, TRUE)[others])
