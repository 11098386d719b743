"""Normalized cross-correlation against OpenCV, its sub-pixel peak and its refusals."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from solvers.matching import Status, match_ncc


def scene(seed: int, size: int = 200) -> np.ndarray:
    image = gaussian_filter(np.random.default_rng(seed).normal(size=(size, size)), 1.5)
    return (120 + 30 * image / image.std()).astype(np.float32)


def test_scores_are_those_of_equation_1_and_do_not_see_gain_or_offset():
    left = scene(1)
    right = 0.5 * np.roll(left, (3, -4), (0, 1)) + 40 + np.random.default_rng(2).normal(0, 2, left.shape).astype(np.float32)
    at = np.array([[60.0, 70.0], [101.0, 99.0], [140.0, 50.0]])
    r = match_ncc(left, right, at, at + 1, search=9, smooth=0.0)
    assert r.ok.all()
    for (c, w), pixel, score in zip(at.astype(int), r.pixel, r.score, strict=True):
        patch = right[w + 1 - 19 : w + 1 + 20, c + 1 - 19 : c + 1 + 20]
        table = cv2.matchTemplate(patch, left[w - 10 : w + 11, c - 10 : c + 11], cv2.TM_CCOEFF_NORMED)
        assert abs(score - table.max()) < 1e-4
        assert np.abs(pixel - [c - 4, w + 3]).max() < 0.1


def test_the_peak_is_found_between_pixels():
    left = scene(3)
    half = np.fft.irfft2(np.fft.rfft2(left) * np.exp(-2j * np.pi * 0.4 * np.fft.rfftfreq(200))[None], left.shape)
    at = np.stack(np.meshgrid(np.arange(40.0, 160, 15), np.arange(40.0, 160, 15)), -1).reshape(-1, 2)
    r = match_ncc(left, half, at, at, search=5)
    assert r.ok.all()
    assert np.sqrt(np.mean((r.pixel - at - [0.4, 0]) ** 2)) < 0.05


def test_flat_windows_low_scores_borders_and_edges_of_the_photo_are_named():
    left, right = scene(4), scene(5)
    at = np.array([[100.0, 100.0]])
    assert match_ncc(left, right, at, at, threshold=0.7).status[0] == Status.LOW_SCORE
    assert match_ncc(np.full_like(left, 7), right, at, at).status[0] == Status.NO_TEXTURE
    assert np.isnan(match_ncc(left, np.full_like(left, 7), at, at).score[0])  # zero variance: undefined
    assert match_ncc(left, left, at, at + np.array([6, 0]), search=6).status[0] == Status.AT_BORDER
    near = match_ncc(left, left, np.array([[14.0, 100.0]]), np.array([[16.0, 101.0]]))
    assert near.ok[0] and np.abs(near.pixel[0] - [14, 100]).max() < 0.05
    assert match_ncc(left, left, at, at + 500).status[0] == Status.LEFT


def test_a_template_is_warped_by_the_predicted_affine():
    left = scene(6)
    turned = np.rot90(left).copy()  # pixel (c, r) of left lies at (r, 199 - c)
    at = np.array([[70.0, 110.0], [120.0, 60.0]])
    truth = np.stack([at[:, 1], 199 - at[:, 0]], 1)
    assert not match_ncc(left, turned, at, truth, threshold=0.7).ok.any()
    r = match_ncc(left, turned, at, truth + np.array([3, -2]), shape=np.array([[0.0, 1.0], [-1.0, 0.0]]))
    assert r.ok.all() and np.abs(r.pixel - truth).max() < 0.03
    assert r.score.min() > 0.999
