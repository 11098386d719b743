"""Image corners as weighted control of a mosaic."""

from dataclasses import replace

import numpy as np

from solvers import Exterior
from solvers.block import Prior
from solvers.mosaic import RegistrationRequest, register
from solvers.orientation import corner_control, with_corners
from solvers.orientation.oriented import Known

from .test_register import flight


def test_corners_place_and_turn_a_mosaic():
    block, poses, _ = flight(gps=False)
    rng, corners = np.random.default_rng(3), []
    sigma = np.array([0.05, 0.05, 0.05, 2e-4, 2e-4, 2e-4])
    for image, pose in zip(block.images, poses, strict=True):
        off = sigma * rng.standard_normal(6)
        angles = np.asarray(pose.angles) + off[3:]
        at = Exterior.from_angles(float(angles[0]), float(angles[1]), float(angles[2]), pose.centre + off[:3])
        corners.append(corner_control(block, Known(image.name, at, np.diag(sigma**2)), 50.0, 0.01, 0.1))
    by_corners = with_corners(block, corners)
    assert all(i.prior is not None and i.prior.covariance is not None for i in by_corners.images)
    positions = replace(block, images=tuple(replace(i, prior=Prior(i.prior.centre, None, np.full(3, 0.05)))
                                            for i in by_corners.images if i.prior is not None))
    worst = []
    for given in (by_corners, positions):
        done = register(given, RegistrationRequest(model="exterior"))
        assert done.level == "semicontrolled" and len(done.names) == len(poses)
        at = {n: k for k, n in enumerate(done.names)}
        off = [np.linalg.norm(done.frame.to_map(done.exteriors[at[i.name]].centre) - p.centre)
               for i, p in zip(given.images, poses, strict=True)]
        turned = [np.linalg.norm(done.exteriors[at[i.name]].m - p.m) for i, p in zip(given.images, poses, strict=True)]
        worst.append((max(off), np.median(turned)))
    assert worst[0][0] < 0.2 and worst[0][1] < 5e-4
    assert worst[0][1] < worst[1][1]  # the corners know angles, too
