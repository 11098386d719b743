"""Bends: their inverse, and photos of a rolling shutter that meet with them and do not without."""

from dataclasses import replace

import numpy as np
import pytest

from solvers.mosaic import RegistrationRequest, check_ties, register
from solvers.mosaic.bends import bent, by_bend, straightened
from solvers.mosaic.measured import measure, place_jacobian, seen_by
from solvers.mosaic.precision import GRID
from solvers.mosaic.registration import plane_warp, undistorted
from solvers.workflows_compose import placed_at

from .test_register import CAMERA, flight

BEND = np.array([4.0, -3.0, 2.0, -1.0, 5.0, -4.0])


def test_straightened_is_the_inverse_of_bent_also_outside_the_photo():
    rng = np.random.default_rng(0)
    pixels = rng.uniform([-2000, -2000], [3500, 3000], (500, 2))
    assert np.abs(straightened(BEND, CAMERA, bent(BEND, CAMERA, pixels)) - pixels).max() < 1e-6
    edge = bent(BEND, CAMERA, np.array([[CAMERA.width - 1.0, (CAMERA.height - 1) / 2]]))
    assert edge - [[CAMERA.width - 1.0, (CAMERA.height - 1) / 2]] == pytest.approx(np.array([[4, -1]]), abs=0.02)


def test_photo_coordinates_move_with_bends_as_pixels_do():
    rng = np.random.default_rng(1)
    pixels = rng.uniform([0, 0], [1499, 999], (20, 2))
    ideal = replace(CAMERA, k1=0.0)

    def over_c(p):
        return (ideal.photo(p) - ideal.principal_point) / ideal.c

    moved = (over_c(bent(BEND, CAMERA, pixels)) - over_c(pixels))
    by = by_bend([CAMERA, CAMERA], np.ones(20, int), over_c(pixels))
    assert by @ BEND == pytest.approx(moved, abs=1e-12)


@pytest.fixture(scope="module")
def made():
    """A level block whose photos are bent, every tenth of its points kept apart."""
    block, _, _ = flight(3, 4, noise=0.2, per=45)
    of, rng = block.observations, np.random.default_rng(5)
    pixel = of.pixel.copy()
    for k in range(len(block.images)):
        mine = of.image == k
        pixel[mine] = bent(rng.normal(0, 4, 6), CAMERA, pixel[mine])
    held = of.point % 10 == 3
    whole = replace(of, pixel=pixel)
    parts = [replace(whole, **{f: np.asarray(getattr(whole, f))[m] for f in ("image", "point", "pixel", "sigma")})
             for m in (~held, held)]
    block = replace(block, observations=parts[0])
    return block, parts[1], register(block, RegistrationRequest(model="adapted"))


def test_photos_that_are_no_central_projections_meet_when_they_bend(made):
    block, held, soft = made
    names = tuple(i.name for i in block.images)
    rigid = register(block, RegistrationRequest(model="plane"))
    off = [np.nanmedian(check_ties(r, names, held)) for r in (rigid, soft)]
    assert off[1] < 0.5 * off[0] and off[1] < 0.6
    assert rigid.bends is None and soft.bends is not None and any("bent by up to" in w for w in soft.warnings)
    at = soft.on_plane(3, np.array([[10.0, 20.0], [1490.0, 980.0]]))
    assert soft.to_pixels(3, at) == pytest.approx(np.array([[10.0, 20.0], [1490.0, 980.0]]), abs=1e-5)


def test_a_smaller_picture_of_a_bent_photo_shows_the_same_places(made):
    soft = made[2]
    at = np.concatenate([soft.on_plane(2, np.array([[100.0, 200.0], [1400.0, 900.0]])), np.zeros((2, 1))], 1)
    whole, half = (placed_at(soft, 2, size).pixels(at) for size in ((1500, 1000), (750, 500)))
    assert whole == pytest.approx(np.array([[100.0, 200.0], [1400.0, 900.0]]), abs=1e-5)
    assert half == pytest.approx((whole + 0.5) / 2 - 0.5, abs=1e-5)


def test_photos_that_fit_stay_as_they_are():
    block, _, _ = flight(2, 3, noise=0.2, per=40)
    assert register(block, RegistrationRequest(model="adapted")).bends is None


def test_predicted_errors_hold_for_photos_that_bend():
    """Truth against prediction over many draws of bends: those that look like tilts turn the photos, and the sigma knows."""
    ratio, grid = [], GRID * [CAMERA.width / 2, CAMERA.height / 2] + [(CAMERA.width - 1) / 2, (CAMERA.height - 1) / 2]
    for seed in range(4):
        block, poses, _ = flight(2, 4, noise=0.2, per=40, seed=seed)
        of, rng = block.observations, np.random.default_rng(seed + 500)
        bends, pixel = rng.normal(0, 4, (len(poses), 6)), of.pixel.copy()
        for k, bend in enumerate(bends):
            pixel[of.image == k] = bent(bend, CAMERA, pixel[of.image == k])
        made = register(replace(block, observations=replace(of, pixel=pixel)), RegistrationRequest(model="adapted"))
        off = []
        for k, (bend, pose) in enumerate(zip(bends, poses, strict=True)):
            h = np.linalg.inv(plane_warp(CAMERA, pose, np.array([50.0, 0, 0])))
            at = undistorted(CAMERA, grid) @ h[:, :2].T + h[:, 2]
            shown = made.on_plane(k, bent(bend, CAMERA, grid)) + made.frame.origin[:2]
            off.append(np.mean(np.sum((shown - at[:, :2] / at[:, 2:]) ** 2, axis=1)))
        assert made.covariance.shape[1:] == (14, 14) and any("bent alike" in w for w in made.warnings)
        ratio.append(np.mean(off) / np.mean(made.corner_sigma**2))
    assert 0.6 < np.sqrt(np.mean(ratio)) < 1.5, ratio


def test_what_is_measured_on_a_bent_photo_has_the_error_of_its_bend_too(made):
    soft = made[2]
    at = soft.on_plane(5, np.array([[60.0, 60.0]]))
    whole = measure(soft, at).sigma
    rigid = measure(replace(soft, covariance=soft.covariance[:, :8, :8]), at).sigma
    j = place_jacobian(soft, seen_by(soft, at[0])[0], at[0])
    assert j.shape == (2, 14) and np.all(whole > rigid) and np.all(np.isfinite(whole))
