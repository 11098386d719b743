"""Tie points of real flights, their photos made smaller; one warped with known truth."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks.matching import SCALE, digital, photograph, random_warp, scene
from solvers.io import read_project
from solvers.matching import TieOptions, TiePhoto, tie_points
from solvers.orientation.bundle import adjust
from solvers.workflows_init import init_project
from solvers.workflows_matching import find_ties


def read_small(name: str, folder: Path, reduction: int) -> np.ndarray:
    import cv2

    grey = cv2.imread(str(folder / name), {1: cv2.IMREAD_GRAYSCALE, 4: cv2.IMREAD_REDUCED_GRAYSCALE_4}[reduction])
    assert grey is not None
    return grey


@pytest.mark.parametrize(("flight", "photos", "reduction"), [("uav_brighton8", 8, 4), ("uav_strip5", 5, 1)])
def test_a_flight_hangs_together(data: Path, flight: str, photos: int, reduction: int) -> None:
    folder = data / flight
    names = sorted(f.name for f in folder.glob("*.JPG"))
    read = partial(read_small, folder=folder, reduction=reduction)
    ties = tie_points([TiePhoto(n) for n in names], read, TieOptions(count=2000))
    assert len(names) == photos and ties.groups == (tuple(names),) and not ties.failed
    assert (ties.rays >= 3).mean() >= 0.5
    assert len(ties.points) > 300 and ties.per_photo.min() > 60


@pytest.mark.parametrize(("flight", "photos", "rms"), [("uav_strip5", 5, 0.4), ("uav_brighton8", 8, 0.5)])
def test_a_flight_becomes_a_free_block(data: Path, tmp_path: Path, flight: str, photos: int, rms: float) -> None:
    init_project([data / flight], tmp_path / "p")
    ties = find_ties(tmp_path / "p").ties
    assert len(ties.groups) == 1 and (ties.rays >= 3).mean() >= 0.5
    found = adjust(read_project(tmp_path / "p"), datum="free", rolling_shutter="auto")
    assert len(found.orientations) == photos and found.trace.converged and found.rms_px < rms


def test_five_positions_in_a_row_hold_a_flight_that_looks_down(data: Path, tmp_path: Path) -> None:
    init_project([data / "uav_strip5"], tmp_path / "p")
    find_ties(tmp_path / "p")
    block = read_project(tmp_path / "p")
    still, found = (adjust(block, datum="prior", rolling_shutter=how, free=free)
                    for how, free in (("none", ()), ("auto", ("c", "xp", "yp", "k1", "k2", "k3"))))
    for done in (still, found):
        assert done.trace.converged and any("of one line and hardly hold the rotation" in w for w in done.warnings)
        assert np.mean([o.exterior.m[2, 2] for o in done.orientations]) > 0.95
        at = np.array([o.exterior.centre for o in done.orientations])
        assert np.linalg.norm(np.diff(at, axis=0), axis=1) == pytest.approx(28, abs=4)
    assert (still.sigma0 or 0) > 10  # what the shutter leaves, as in the free network
    assert (found.sigma0 or 9) < 0.9 and (found.groups["GPS"][0] or 9) < 1 and (found.groups["motion"][0] or 9) < 1.5


def test_least_squares_matching_makes_features_exact(data: Path) -> None:
    rng = np.random.default_rng(7)
    fine = scene(data / "uav_brighton8/DJI_0026.JPG")
    shape = (fine.shape[0] // SCALE, fine.shape[1] // SCALE)
    warp = random_warp(rng, shape, 3, 0.03, 0.02)  # second photo -> first
    identity = np.array([[1.0, 0, 0], [0, 1, 0]])
    views = {"first": digital(photograph(fine, identity, shape), rng, 0, 0, 2),
             "second": digital(photograph(fine, warp, shape), rng, 0.1, 10, 2)}

    def rms(window: int) -> float:
        ties = tie_points([TiePhoto(n) for n in views], views.__getitem__, TieOptions(window=window))
        of = ties.observations
        first, second = of.pixel[of.image == 0], of.pixel[of.image == 1]
        error = second @ warp[:, :2].T + warp[:, 2] - first
        assert len(error) > 300
        near = np.linalg.norm(error, axis=1) < 1
        assert near.mean() > 0.99
        return float(np.sqrt((error[near] ** 2).mean()))

    assert rms(21) < 0.03 and rms(0) > 3 * rms(21)
