"""simulate cliff_epochs and compare on the command line."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from solvers.cli import main
from solvers.io import read_truth
from solvers.simulation.monitoring import MOVED
from tests.commands import refused, run


@pytest.fixture(scope="module")
def cliff(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("cliff") / "wall"
    assert main(["simulate", "cliff_epochs", "-o", str(folder), "--seed", "5", "--quiet"]) == 0
    return [folder / f"epoch{k}" for k in (1, 2, 3)]


def test_epochs_are_compared_and_agree_with_the_truth(cliff: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    done = run(capsys, "compare", *cliff)
    assert set(done["moved"]) == set(MOVED) and done["level"] == 0.05 and not done["warnings"]
    truth = [(read_truth(f) or {})["points"] for f in cliff]
    for k, pair in enumerate(done["pairs"]):
        assert pair["first"] == "epoch1" and not pair["global_test"]["congruent"] and pair["datum_test"]["congruent"]
        assert set(pair["stable"]) == set(done["datum"]) and not set(done["datum"]) & set(MOVED)
        for p in pair["points"]:
            moved = np.array(truth[k + 1][p["name"]]) - truth[0][p["name"]]
            off = np.array([p["dX"], p["dY"], p["dZ"]]) - moved
            assert off @ np.linalg.solve(p["covariance"], off) < 30
            assert p["significant"] == (p["name"] in MOVED) == (p["statistic_over_critical"] > 1)
            assert sorted(p["ellipsoid_95"]["axes_m"], reverse=True) == p["ellipsoid_95"]["axes_m"]
    assert (Path(done["run"]) / "result.json").exists() and Path(done["run"]).parent.parent == cliff[2]
    assert set(done["coordinates"]) == {"epoch1", "epoch2", "epoch3"}
    assert main(["compare", *map(str, cliff[:2])]) == 0
    text = capsys.readouterr().out
    assert "not congruent as a whole" in text and "moved: 7, 18, 26, 33" in text.replace("18, 7", "7, 18")


def test_an_adjust_run_is_taken_over_while_it_is_newer(cliff: list[Path], capsys: pytest.CaptureFixture[str]) -> None:
    first = run(capsys, "compare", *cliff[:2])
    assert all("adjusted now" in n for n in first["notes"])
    run(capsys, "adjust", cliff[1], "--datum", "free", "--free", "c")
    second = run(capsys, "compare", *cliff[:2])
    assert any("as the run" in n for n in second["notes"]) and second["epochs"][1]["dof"] == first["epochs"][1]["dof"] - 1
    assert second["moved"] == first["moved"]
    anew = run(capsys, "compare", *cliff[:2], "--adjust", "now")
    assert anew["epochs"][1]["dof"] == first["epochs"][1]["dof"]
    later = (cliff[1] / "observations.csv").stat().st_mtime + 1e4
    os.utime(cliff[1] / "observations.csv", (later, later))
    third = run(capsys, "compare", *cliff[:2])
    assert any("older than the project's files" in n for n in third["notes"])


def test_a_blunder_is_warned_of_and_does_not_harm_a_robust_comparison(cliff: list[Path], tmp_path: Path,
                                                                      capsys: pytest.CaptureFixture[str]) -> None:
    spoilt = tmp_path / "spoilt"
    spoilt.mkdir()
    for name in ("project.toml", "points.csv"):
        (spoilt / name).write_text((cliff[1] / name).read_text())
    lines = (cliff[1] / "observations.csv").read_text().splitlines()
    cells = lines[4].split(",")
    cells[2] = str(float(cells[2]) + 30)
    (spoilt / "observations.csv").write_text("\n".join([*lines[:4], ",".join(cells), *lines[5:]]) + "\n")
    done = run(capsys, "compare", cliff[0], spoilt)
    assert any("bad fit" in w and "spoilt" in w for w in done["warnings"])
    done = run(capsys, "compare", cliff[0], spoilt, "--robust")
    assert set(done["moved"]) == set(MOVED)


def test_what_cannot_be_compared_is_one_sentence(cliff: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "two epochs" in refused(capsys, "compare", cliff[0])
    assert "given twice" in refused(capsys, "compare", cliff[0], cliff[0])
    assert "no point 'nowhere'" in refused(capsys, "compare", *cliff[:2], "--stable", "1,2,3,nowhere")
    assert "nothere" in refused(capsys, "compare", cliff[0], tmp_path / "nothere")
    refused(capsys, "compare", *cliff[:2], "--level", "zero", code=2)
    assert "already there" in refused(capsys, "simulate", "cliff_epochs", "-o", cliff[0].parent)
    before = sorted(p.name for p in (cliff[2] / "runs").iterdir())
    assert "crs" in refused(capsys, "compare", _in_utm(cliff[0], tmp_path / "utm"), cliff[2])
    assert sorted(p.name for p in (cliff[2] / "runs").iterdir()) == before


def _in_utm(folder: Path, to: Path) -> Path:
    to.mkdir()
    for name in ("project.toml", "observations.csv"):
        (to / name).write_text((folder / name).read_text().replace('crs = "local"', 'crs = "EPSG:32632"'))
    lines = (folder / "points.csv").read_text().splitlines()
    moved = [lines[0]]
    for line in lines[1:]:
        cells = line.split(",")
        cells[1:4] = [str(float(c) + s) for c, s in zip(cells[1:4], (4e5, 5.4e6, 200.0), strict=True)]
        moved.append(",".join(cells))
    (to / "points.csv").write_text("\n".join(moved) + "\n")
    return to
