"""The large block: everything seen where it should be, errors as large as said, sizes that make no sense refused."""

import numpy as np
import pytest

from solvers import BadProject
from solvers.cameras import project
from solvers.cli import main
from solvers.io import read_project
from solvers.simulation import large_block


def test_marks_are_where_the_truth_projects_them() -> None:
    made = large_block(3, images=60)
    of, block = made.block.observations, made.block
    assert len(block.images) == 60 and np.bincount(of.image, minlength=60).min() > 50
    assert np.bincount(of.point, minlength=len(block.points)).min() >= 2
    v = np.concatenate([of.pixel[of.image == i] - project(made.cameras["uav"], made.exteriors[image.name],
                                                          made.xyz[of.point[of.image == i]])
                        for i, image in enumerate(block.images)])
    assert v.std() == pytest.approx(0.3, rel=0.03) and abs(v.mean()) < 0.01
    roles = np.array(block.points.role)
    assert all((roles == r).sum() > 2 for r in ("control", "check", "tie"))
    assert np.isfinite(block.points.xyz[roles != "tie"]).all() and np.isnan(block.points.xyz[roles == "tie"]).all()


def test_it_becomes_a_project_of_as_many_images_as_asked(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "large_block", "--images", "30", "-o", str(tmp_path / "block")]) == 0
    assert len(read_project(tmp_path / "block").images) == 30
    assert main(["simulate", "uav_cluster", "--images", "30", "-o", str(tmp_path / "other")]) == 1
    assert "--images belongs to large_block" in capsys.readouterr().err


def test_too_few_images_are_refused() -> None:
    with pytest.raises(BadProject, match="12 to 10,000 images, not 5"):
        large_block(images=5)
