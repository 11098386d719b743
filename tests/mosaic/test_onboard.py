"""Plane coefficients held by onboard positions: stated errors predict the scatter under tilt, relief and a lens nobody knows."""

from dataclasses import replace

import numpy as np
import pytest

from solvers import Prior
from solvers.mosaic import RegistrationRequest, register
from solvers.mosaic.onboard import BACK, BASIS
from tests.mosaic.test_register import CAMERA, flight

PLANE = RegistrationRequest(model="plane")
PLACES = np.stack(np.meshgrid(np.linspace(75, 1424, 5), np.linspace(50, 949, 5)), -1).reshape(-1, 2)


def disturbed(rows, columns, seed, relief=3.0, lens=3.0, tilt=None):
    """A block whose relief [m], distortion [px at the corners] and tilts [degrees] are drawn, positions good to 1 m."""
    rng = np.random.default_rng(4000 + seed)
    block, poses, _ = flight(rows, columns, per=10, relief=relief * abs(rng.standard_normal()), tilt=tilt or rng.uniform(1, 4),
                             seed=seed)
    of, k = block.observations, lens * rng.standard_normal()
    c = (of.pixel - [749.5, 499.5]) / 901
    images = tuple(replace(i, prior=Prior(p.centre + rng.normal(0, 1, 3), None, np.ones(3)))
                   for i, p in zip(block.images, poses, strict=True))
    return replace(block, images=images, observations=replace(of, pixel=of.pixel + k * c * (c**2).sum(1)[:, None])), poses


def squared_errors(r, poses):
    """(m,) mean squared distance on the mosaic of places in each photo from where they belong."""
    out = []
    for k, n in enumerate(r.names):
        e = poses[int(n[1:])]
        ray = np.column_stack([CAMERA.ideal(PLACES) / CAMERA.c, -np.ones(len(PLACES))]) @ e.m
        true = e.centre[:2] + ray[:, :2] * ((50 - e.centre[2]) / ray[:, 2])[:, None]
        out.append(((r.on_plane(k, PLACES) + r.frame.origin[:2] - true) ** 2).sum(axis=1).mean())
    return np.array(out)


@pytest.mark.parametrize(("rows", "columns"), [(2, 4), (1, 8)])
def test_stated_errors_predict_the_scatter_under_relief_lens_and_tilt(rows, columns):
    actual, stated = [], []
    for seed in range(10):
        block, poses = disturbed(rows, columns, seed)
        r = register(block, PLANE)
        assert np.isfinite(r.corner_sigma).all()
        actual.append(squared_errors(r, poses).mean())
        stated.append((r.corner_sigma**2).mean())
    assert 1 / 1.3 < np.sqrt(np.mean(actual) / np.mean(stated)) < 1.3
    ratios = np.sqrt(np.array(actual) / stated)  # not only in the mean
    assert np.median(ratios) < 1.3 and (ratios < 2.5).all()


def test_positions_hold_a_strip_of_coefficients_and_tilts_are_found():
    block, poses = disturbed(1, 16, 3, relief=0.0, lens=0.0, tilt=2.0)
    r = register(block, PLANE)
    assert np.sqrt(squared_errors(r, poses)).max() < 4  # by a similarity alone its ends are tens of metres off
    said = next(w for w in r.warnings if "nearly vertical" in w)
    assert 1.5 < float(said.split("tilts of ")[1].split()[0]) < 2.8
    assert "distortion" in said and r.trace.manifest["stages"][-1]["stage"] == "positions"


def test_a_photo_known_to_be_oblique_is_not_taken_to_be_vertical():
    block, _ = disturbed(2, 4, 5, relief=0.0, lens=0.0, tilt=1.0)
    images = [replace(i, prior=Prior(i.prior.centre, np.radians([20.0 if k == 3 else 0.5, 0.0, 0.0]), np.ones(3)))
              for k, i in enumerate(block.images) if i.prior is not None]
    free, held = register(replace(block, images=tuple(images)), PLANE), register(block, PLANE)
    assert free.corner_sigma[3] > 1.05 * held.corner_sigma[3]


def test_the_basis_of_a_photo_is_its_motion():
    """A photo that turns by a small angle about its y axis changes its coefficients by the seventh column."""
    a = 1e-6
    turn = np.array([[1, 0, a], [0, 1, 0], [-a, 0, 1.0]])  # of (x, y, 1): x moves by a (1 + x^2)
    assert np.allclose((turn / turn[2, 2] - np.eye(3)).ravel()[:8] / a, BASIS[:, 6], atol=1e-5)
    assert np.allclose(BACK @ BASIS, np.eye(8))
