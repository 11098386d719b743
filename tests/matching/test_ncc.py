"""Normalized cross-correlation against OpenCV, its sub-pixel peak and its refusals."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from solvers.matching import Status, match_lsm, match_ncc
from solvers.matching.ncc import peak_sigma
from solvers.matching.patches import smoothing


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


@pytest.mark.parametrize(("window", "blur", "texture"), [(21, 3.0, 2.0), (21, 6.0, 6.0), (31, 6.0, 3.0), (15, 6.0, 6.0),
                                                         (15, 3.0, 2.0), (11, 6.0, 6.0), (11, 6.0, 12.0), (11, 3.0, 4.0)])
def test_texture_below_its_noise_gives_no_confident_wrong_place(window: int, blur: float, texture: float):
    rng = np.random.default_rng(window + int(blur))
    clean = gaussian_filter(rng.normal(size=(500, 500)), blur)
    clean = 120 + texture * clean / clean.std()
    left, right = (np.round(v + rng.normal(0, 3, v.shape)).astype(np.uint8) for v in (clean, np.roll(clean, (3, -5), (0, 1))))
    at = rng.uniform(60, 440, (600, 2))
    for found in (match_ncc(left, right, at, np.round(at), window), match_lsm(left, right, at, np.round(at), window, search=12)):
        off = np.linalg.norm(found.pixel - at - [-5, 3], axis=1)
        assert (found.ok & (off > 1.5)).mean() < 0.005


def test_the_standard_deviation_of_a_peak_is_that_of_its_scatter_or_up_to_thrice():
    rng = np.random.default_rng(8)
    clean, at = scene(9).astype(float), np.array([[100.0, 100.0]])
    places = []
    for _ in range(150):
        left, right = (v + rng.normal(0, 12, v.shape) for v in (clean, clean))
        places.append(match_ncc(left, right, at, at, search=3).pixel[0])
    values = gaussian_filter(clean, 0.6)[90:111, 90:111]
    gy, gx = np.gradient(values)
    least = np.linalg.eigvalsh(np.cov(gx.ravel(), gy.ravel()) / values.var())[0]  # curvature of the noise-free correlation
    score = values.var() / (values.var() + smoothing(0.6).value ** 0.5 * 144)
    predicted = peak_sigma(np.array([score]), score * np.array([least]), 21**2 * smoothing(0.6).value)[0]
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(np.array(places).T))[-1])
    assert 0.8 < predicted / worst < 3.0  # on the safe side
