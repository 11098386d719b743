"""calibrate on the command line: the report, what the parameters do together, repeated calibrations compared."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers.cameras import Calibrated, Interior, curve, difference
from solvers.cli import main
from solvers.io import write_project
from solvers.orientation import adjust
from solvers.simulation import calibration_plate
from tests.commands import run


def plate(folder: Path, seed: int, camera: Interior | None = None) -> Path:
    simulated = calibration_plate(seed) if camera is None else calibration_plate(seed, camera=camera)
    write_project(simulated.block, folder)
    return folder


def test_report_curves_and_conversions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, true = plate(tmp_path / "a", 2), calibration_plate(2).cameras["camera"]
    done = run(capsys, "calibrate", folder)
    told = done["calibration"]["camera"]
    wanted = curve(Calibrated(true, np.zeros((10, 10))))
    for row, radial in zip(told["curve"], wanted.radial, strict=True):
        assert abs(row["radial_um"] - radial) <= 4 * row["radial_sigma_um"] + 1e-9
    assert told["rms_um"] == pytest.approx(1e3 * true.pitch[0] * done["rms_px_coordinate"], rel=1e-6)
    assert 0.8 < told["sigma0_um"] / (0.1 * 1e3 * true.pitch[0]) < 1.2
    assert set(told["conversions"]) == {"opencv", "metashape", "pix4d", "colmap", "australis"}
    assert told["conversions"]["metashape"]["refit_max_px"] < 0.2
    assert main(["calibrate", str(folder)]) == 0
    text = capsys.readouterr().out
    for word in ("principal distance c [mm]", "standard deviation", "affinity B1", "correlations: ", "radial correction"):
        assert word in text


def test_the_same_camera_twice_and_another_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = calibration_plate(2).cameras["camera"]
    bent = replace(true, c=true.c + 0.02, k1=true.k1 * 1.3)
    for name, seed, camera in (("a", 2, true), ("b", 3, true), ("c", 4, bent)):  # the same camera, and one with another lens
        run(capsys, "calibrate", plate(tmp_path / name, seed, camera))
    done = run(capsys, "calibrate", tmp_path / "a", "--compare", tmp_path / "b", tmp_path / "c")
    same, other = done["comparisons"]
    assert not same["changed"] and same["chi_square"] < 30 and same["dof"] == 10
    assert other["changed"] and other["chi_square"] > 100
    assert main(["calibrate", str(tmp_path / "a"), "--compare", str(tmp_path / "c")]) == 0
    assert "they differ by more than their standard errors explain" in capsys.readouterr().out


def test_curves_of_a_difference_against_differences() -> None:
    """The sigma of the rays' difference follows from c and K as numbers say."""
    camera = calibration_plate(2).cameras["camera"]
    rng = np.random.default_rng(1)
    sigma = np.array([3e-3, 0, 0, 4e-6, 6e-8, 3e-10, 0, 0, 0, 0])
    covariance = np.diag(sigma**2)
    draws = camera.parameters + sigma * rng.normal(size=(4000, 10))
    cameras = [Interior(*row, pixel_mm=camera.pixel_mm, width=6000, height=4000) for row in draws]
    still = Calibrated(camera, np.zeros((10, 10)) + 1e-30 * np.eye(10))
    scatter = np.std([difference(still, Calibrated(c, covariance)).image_um for c in cameras[:400]], axis=0)
    told = difference(still, Calibrated(camera, covariance)).image_sigma
    np.testing.assert_allclose(scatter[1:], told[1:], rtol=0.15)


def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = plate(tmp_path / "a", 2)
    assert main(["calibrate", str(folder), "--compare", str(folder)]) == 1
    assert "there is no calibration in it" in capsys.readouterr().err


def test_the_plate_reaches_the_precision_of_an_independent_reference() -> None:
    """Free network, 35 mm on an APS-C sensor, eight photos tilted by 40 degrees and rolled by quarter turns from 1.417 m, 36
    targets, image coordinates to 0.68 um: standard errors of another program's simulation of such a plate (its posts differ)."""
    reference = {"c": 5.17e-3, "xp": 6.81e-3, "yp": 6.50e-3, "k1": 7.04e-6, "k2": 1.27e-7, "k3": 7.17e-10, "p1": 1.86e-6,
                 "p2": 1.79e-6, "b1": 3.01e-5, "b2": 2.91e-5}
    sim = calibration_plate(1, distance=1.417, tilts=(40.0, 40.0), image_px=0.68e-3 / (23.5 / 6000))
    got = adjust(sim.block, datum="free", free=tuple(reference))
    assert got.trace.converged and got.dof in range(410, 418)
    for name, wanted in reference.items():
        assert 0.7 < got.interior_sigma["camera"][name] / wanted < 1.3, name
