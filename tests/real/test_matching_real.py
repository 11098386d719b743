"""Targets and matches on real photos (COLLINEA_DATA, default ../shared/data beside the repository)."""

import os
from pathlib import Path

import numpy as np
import pytest

from solvers.matching import find_targets, match_lsm, number_targets

DATA = Path(os.environ.get("COLLINEA_DATA", Path(__file__).parents[2] / "../shared/data"))
pytestmark = pytest.mark.real


def photo(path: Path) -> np.ndarray:
    if not path.exists():
        pytest.skip(f"{path} is absent: set COLLINEA_DATA to the folder of real data")
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    assert image is not None
    return image[..., ::-1]


@pytest.mark.parametrize("index", [1, 10, 17])
def test_the_calibration_sheet_is_measured_completely_and_numbered(index: int):
    folder = DATA / "camcal_targets"
    image = photo(sorted(folder.glob("*.JPG"))[index - 1] if folder.exists() else folder / "P8250021.JPG")
    marks = np.loadtxt(folder / "markpts.txt", delimiter=",", comments="#")
    marks = marks[marks[:, 0] == index]
    found = number_targets(image, find_targets(image))
    distance = np.linalg.norm(found.pixel[:, None] - (marks[:, 2:4] - 0.5), axis=2)  # the marks count from the pixel's corner
    listed = distance.min(0) < 2
    assert listed[marks[:, 1] < 1000].mean() >= 0.97
    assert (distance.min(1) < 2).all()  # no false target
    error = found.pixel - (marks[distance.argmin(1), 2:4] - 0.5)
    assert np.sqrt((error**2).mean()) < 0.1
    assert (found.label != "").all() and len(set(found.label)) == len(found)


def test_a_photo_matches_itself_turned_and_dimmed():
    image = photo(DATA / "uav_brighton8/DJI_0020.JPG")[..., 1]
    rows, cols = image.shape
    turned = np.rot90(image).copy()  # (c, r) lies at (r, cols - 1 - c)
    rng = np.random.default_rng(0)
    at = np.stack([rng.integers(100, cols - 100, 300), rng.integers(100, rows - 100, 300)], 1).astype(float)
    truth = np.stack([at[:, 1], cols - 1 - at[:, 0]], 1)
    dim, turn = (0.7 * turned + 20).astype(np.float32), np.array([[0.0, 1.0], [-1.0, 0.0]])
    r = match_lsm(image, dim, at, truth + 3, search=8, shape=turn)
    assert r.ok.mean() > 0.8
    assert np.nanmax(np.abs(r.pixel - truth)) < 0.05
