"""Calibrations from photos made by others: a target sheet in 21 photos, a chessboard in 13."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Image, Interior, Observations, Points
from solvers.cameras import PARAMETERS
from solvers.matching import find_targets, number_targets
from solvers.orientation import adjust

OLYMPUS = Interior(7.5, pixel_mm=5.43764 / 1704, width=2272, height=1704)
CORNERS = {"1001": (0, 1, 0), "1002": (1, 1, 0), "1003": (0, 0, 0), "1004": (1, 0, 0)}
GRID = dict(zip(("0-0", "0-9", "9-0", "9-9"), CORNERS.values(), strict=True))


def sheet(photos: Sequence[str], image: np.ndarray, names: np.ndarray, pixel: np.ndarray, sigma: float) -> Block:
    """The sheet's four coded corners fix the datum, all other targets are unknown."""
    points = tuple(dict.fromkeys(map(str, names)))
    index = {name: j for j, name in enumerate(points)}
    known = {**CORNERS, **GRID}
    xyz = np.array([known.get(n, (np.nan,) * 3) for n in points], float)
    role = tuple("control" if n in known else "tie" for n in points)
    return Block("sheet", "local", {"c4040z": OLYMPUS}, tuple(Image(p, "c4040z") for p in photos),
                 Points(points, xyz, np.where(np.isfinite(xyz), 0.0, np.nan), role),
                 Observations(image, np.array([index[str(n)] for n in names]), pixel, np.full(len(pixel), sigma)))


def test_the_sheet_from_its_marks(data: Path) -> None:
    marks = np.loadtxt(data / "camcal_targets" / "markpts.txt", delimiter=",", comments="#")
    names = np.array([str(int(n)) for n in marks[:, 1]])
    control = [line.split(",") for line in (data / "camcal_targets" / "camcal-fixed.txt").read_text().splitlines()
               if line.strip() and not line.startswith("#")]
    assert {c[0]: tuple(float(v) for v in c[2:5]) for c in control} == {k: tuple(map(float, v)) for k, v in CORNERS.items()}
    got = adjust(sheet([f"{i + 1}" for i in range(21)], marks[:, 0].astype(int) - 1, names, marks[:, 2:4] - 0.5, 0.1),
                 free=PARAMETERS)
    camera, sigma = got.interiors["c4040z"], got.interior_sigma["c4040z"]
    assert got.trace.converged and len(got.orientations) == 21 and got.dof == 3724
    assert got.rms_px < 0.21 and got.sigma0 is not None and got.sigma0 < 1.6
    assert camera.c == pytest.approx(7.4525, abs=0.004) and camera.xp == pytest.approx(-0.0143, abs=0.003)
    assert sigma["c"] < 0.001 and sigma["k1"] < 2e-5 and sigma["b1"] < 2e-5


def test_the_sheet_from_its_photos(data: Path) -> None:
    """Seven of the photos, measured here: the same camera as from the marks, to their standard errors of that smaller network."""
    import cv2

    paths = [sorted((data / "camcal_targets").glob("*.JPG"))[k] for k in (0, 2, 4, 9, 13, 16, 18)]
    image, names, pixel = [], [], []
    for i, path in enumerate(paths):
        photo = cv2.imread(str(path), cv2.IMREAD_COLOR)
        assert photo is not None
        photo = photo[..., ::-1]
        found = number_targets(photo, find_targets(photo))
        named = np.array([n != "" for n in found.label])
        image.append(np.full(int(named.sum()), i))
        names.append(np.array(found.label)[named])
        pixel.append(found.pixel[named])
    marks = np.concatenate(names)
    got = adjust(sheet([p.stem for p in paths], np.concatenate(image), marks, np.concatenate(pixel), 0.1), free=PARAMETERS)
    camera = got.interiors["c4040z"]
    assert got.trace.converged and len(got.orientations) == len(paths) and got.rms_px < 0.25
    assert camera.c == pytest.approx(7.4525, abs=0.03) and camera.k1 == pytest.approx(4.59e-3, rel=0.05)


def test_the_chessboard(data: Path) -> None:
    """Corners by OpenCV; its own calibration gives 0.41 px and f = 536 px."""
    import cv2

    paths, pixel = sorted((data / "chess").glob("left*.jpg")), []
    for path in paths:
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert grey is not None
        found, corners = cv2.findChessboardCorners(grey, (9, 6))
        assert found
        pixel.append(cv2.cornerSubPix(grey, corners, (11, 11), (-1, -1), (3, 30, 0.01)).reshape(-1, 2))
    n = len(paths)
    board = np.array([(x, -y, 0.0) for y in range(6) for x in range(9)])
    block = Block("chess", "local", {"left": Interior(5.0, pixel_mm=0.01, width=640, height=480)},
                  tuple(Image(p.stem, "left") for p in paths),
                  Points(tuple(f"{j + 1}" for j in range(54)), board, np.zeros((54, 3)), ("control",) * 54),
                  Observations(np.repeat(np.arange(n), 54), np.tile(np.arange(54), n), np.concatenate(pixel).astype(float),
                               np.full(54 * n, 0.3)))
    got = adjust(block, free=PARAMETERS)
    camera = got.interiors["left"]
    assert n == 13 and got.trace.converged and got.rms_px < 0.41
    assert camera.c / 0.01 == pytest.approx(536.4, abs=1.5)
    assert camera.pixels(camera.principal_point) == pytest.approx([342.8, 235.6], abs=1.5)
