"""Scale bars, GPS and common covariances in project.toml: there and back, and what is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import BadProject
from solvers.block import Gps, ScaleBar, Together
from solvers.io import read_project, write_project
from tests.projects import good_block


def test_there_and_back(tmp_path: Path) -> None:
    block = good_block()
    images = tuple(replace(i, strip="north") for i in block.images)
    q = 0.01 * np.eye(6) + 0.1
    full = replace(block, images=images, scale_bars=(ScaleBar("P1", "P2", 130.5, 0.01),), together=(Together(("P1", "P3"), q),),
                   gps=Gps((0.1, 0.0, 0.25), "strip", 5.0))
    write_project(full, tmp_path / "p")
    got = read_project(tmp_path / "p")
    assert got.scale_bars == full.scale_bars and got.gps == full.gps and got.images[0].strip == "north"
    assert got.together[0].points == ("P1", "P3")
    np.testing.assert_array_equal(got.together[0].covariance, q)


@pytest.mark.parametrize(("text", "said"), [
    ('[[scale_bars]]\nfrom = "P1"\nto = "P1"\nlength_m = 1.0\nsigma_m = 0.1\n', "begins and ends in 'P1'"),
    ('[[scale_bars]]\nfrom = "P1"\nto = "P2"\nlength_m = -1.0\nsigma_m = 0.1\n', "a positive length in metres"),
    ('[[scale_bars]]\nfrom = "P1"\nto = "P2"\nlength_m = 1.0\n', "sigma_m: this key is missing"),
    ('[scale_bars]\nfrom = "P1"\n', r"write \[\[scale_bars\]\]"),
    ('[gps]\nshift = "line"\n', 'write one of "none", "block", "strip"'),
    ('[gps]\nlever_arm = [1, 2, 3]\n', "write lever_arm_m"),
    ('[[control_covariance]]\npoints = ["P1"]\ncovariance_m2 = [[1, 0], [0, 1]]\n', "symmetric matrix of 3 rows"),
    ('[[control_covariance]]\npoints = ["P1"]\ncovariance_m2 = [[1,1,0],[1,1,0],[0,0,1]]\n', "a direction has no variance")])
def test_refusals(tmp_path: Path, text: str, said: str) -> None:
    write_project(good_block(), tmp_path / "p")
    with (tmp_path / "p" / "project.toml").open("a") as file:
        file.write("\n" + text)
    with pytest.raises(BadProject, match=said):
        read_project(tmp_path / "p")
