"""Resampling: ramps and parabolas are what they were, edges end at the outer pixels' edges."""

import numpy as np
import pytest

from solvers.mosaic.resample import sample

COLUMNS, ROWS = 400, 300
COL, ROW = np.meshgrid(np.arange(COLUMNS, dtype=np.float32), np.arange(ROWS, dtype=np.float32))
AT = np.random.default_rng(0).uniform([2, 2], [COLUMNS - 3, ROWS - 3], (3000, 2))


@pytest.mark.parametrize(("method", "worst"), [("nearest", 0.5), ("bilinear", 1e-4), ("bicubic", 2e-4)])
def test_a_ramp_is_reproduced(method, worst):
    values = sample(np.dstack([COL, ROW]), AT, method)
    assert np.abs(values - AT).max() <= worst
    if method != "nearest":
        assert np.abs((values - AT).mean(0)).max() < 1e-5  # no bias


def test_bicubic_reproduces_a_parabola_and_bilinear_does_not():
    parabola = ((COL - 200) ** 2 / 100)[..., None]
    truth = (AT[:, 0] - 200) ** 2 / 100
    assert np.abs(sample(parabola, AT, "bicubic")[:, 0] - truth).max() < 1e-3
    fraction = AT[:, 0] % 1
    assert np.allclose(sample(parabola, AT)[:, 0] - truth, fraction * (1 - fraction) / 100, atol=1e-4)


def test_bytes_and_floats_agree_and_a_photo_ends_at_its_pixel_edges():
    image = np.random.default_rng(1).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    at = np.array([[-0.5, -0.5], [6.5, 4.5], [3.25, 2.5], [6.51, 2], [-0.51, 2], [np.nan, 1]])
    for method in ("nearest", "bilinear", "bicubic"):
        values = sample(image, at, method)
        assert np.allclose(values, sample(image.astype(np.float32), at, method), atol=1e-4, equal_nan=True)
        assert np.isfinite(values[:3]).all() and np.isnan(values[3:]).all()
    assert np.allclose(sample(image, at[:2], "bilinear"), image[[0, -1], [0, -1]])
