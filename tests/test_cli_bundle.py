"""adjust and calibrate on the command line."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from solvers.cli import main
from solvers.io import demo_assets, load_trace, read_truth, write_project
from solvers.simulation import calibration_plate


@pytest.fixture
def demo(tmp_path: Path) -> Path:
    shutil.copytree(demo_assets(), tmp_path / "demo", ignore=shutil.ignore_patterns("images", "runs"))
    text = (tmp_path / "demo" / "project.toml").read_text()
    (tmp_path / "demo" / "project.toml").write_text(re.sub(r"^file = \"images/.*\n", "", text, flags=re.M))
    return tmp_path / "demo"


def run(capsys: pytest.CaptureFixture[str], *words: object) -> dict:
    assert main([*map(str, words), "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *words: object, code: int = 1) -> str:
    assert main([*map(str, words)]) == code
    err = capsys.readouterr().err
    assert err.startswith("collinea: ") and err.count("\n") == 1 and "Traceback" not in err
    return err


def test_adjust_agrees_with_the_truth_and_keeps_the_contract(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = read_truth(demo)
    assert truth is not None
    done = run(capsys, "adjust", demo)
    assert {"orientations", "interior", "points", "sigma0", "dof", "rms_px", "iterations", "cost", "control_rms_m", "check_rms_m",
            "reliability"} <= set(done)
    for o in done["orientations"]:
        true = truth["images"][o["image"]]
        off = [o[k] - true[k] for k in "XYZ"] + [np.radians(o[k] - true[k]) for k in ("omega_deg", "phi_deg", "kappa_deg")]
        assert np.array(off) @ np.linalg.solve(o["covariance"], off) < 30
        assert {"point", "col", "row", "redundancy", "w", "used"} <= set(o["residuals"][0])
    assert np.array(done["check_rms_m"]).max() < 0.05 and 0.8 < done["sigma0"] < 1.2
    folder = Path(done["run"])
    assert json.loads((folder / "result.json").read_text()) == done and (folder / "recording.rrd").stat().st_size > 10_000
    assert load_trace(folder).last.cost == pytest.approx(done["cost"])


@pytest.mark.parametrize("start", ["resection", "dlt", "affine"])
def test_every_start_ends_at_the_same_cost(demo: Path, capsys: pytest.CaptureFixture[str], start: str) -> None:
    costs = [run(capsys, "adjust", demo, "--start", s)["cost"] for s in ("auto", start)]
    assert costs[1] == pytest.approx(costs[0], rel=1e-9)


def test_calibrate_finds_the_camera_of_a_plate(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulated = calibration_plate(2)
    write_project(simulated.block, tmp_path / "plate")
    done = run(capsys, "calibrate", tmp_path / "plate")
    [camera], true = done["interior"].values(), simulated.cameras["camera"]
    for name, key in (("c", "c_mm"), ("xp", "xp_mm"), ("yp", "yp_mm"), ("k1", "k1"), ("p1", "p1"), ("b1", "b1"), ("b2", "b2")):
        assert abs(camera[key] - getattr(true, name)) < 4 * camera["sigma"][key]
    assert main(["calibrate", str(tmp_path / "plate")]) == 0
    assert "principal distance c [mm]" in capsys.readouterr().out


def test_refusals(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "not an interior orientation parameter" in refused(capsys, "adjust", demo, "--free", "c,focal")
    text = re.sub(r"\[images\.\w+\.prior\]\n(?:\w+ = .*\n)+", "", (demo / "project.toml").read_text())
    (demo / "project.toml").write_text(text)
    assert "no image has a prior" in refused(capsys, "adjust", demo, "--datum", "prior")
    assert "which project" in refused(capsys, "adjust")
    assert not (demo / "runs").exists()
