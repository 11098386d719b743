"""adjust and calibrate on the command line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rerun.chunk import RrdReader

from solvers import BadProject, Trace
from solvers.adjustment import LARGE, Iteration, thin
from solvers.cli import main
from solvers.io import RowReader, RowWriter, load_trace, read_project, read_truth, save_trace, write_project
from solvers.simulation import calibration_plate
from solvers.workflows_bundle import AdjustedProject, StoppedRun, adjust_project
from solvers.workflows_report import read_result, report_project
from tests.commands import demo_without_photos, refused, run
from viewer_app.bundle_state import Bundle
from viewer_app.loading import open_project
from viewer_app.rerun_bundle import Live


@pytest.fixture
def demo(tmp_path: Path) -> Path:
    return demo_without_photos(tmp_path)


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


def test_residuals_of_a_large_block_stay_beside_the_json(demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = adjust_project(demo)
    monkeypatch.setattr("solvers.workflows_bundle.MANY", 10)
    thin = adjust_project(demo)
    assert isinstance(whole, AdjustedProject) and isinstance(thin, AdjustedProject) and whole.run and thin.run
    said = json.loads((thin.run / "result.json").read_text())
    assert said["observations_file"] == "observations.npz" and not any(o["residuals"] for o in said["orientations"])
    first, second = read_result(whole.run), read_result(thin.run)
    for a, b in zip(first["orientations"], second["orientations"], strict=True):
        assert [r["point"] for r in a["residuals"]] == [r["point"] for r in b["residuals"]]
        assert a["observations"] == b["observations"] == sum(r["used"] for r in b["residuals"])
        for r, s in zip(a["residuals"], b["residuals"], strict=True):
            assert s["col"] == pytest.approx(r["col"], rel=1e-6) and s["w"] == pytest.approx(r["w"], rel=1e-6)
    report_project(thin.run, thin.run / "report.html")
    assert "observed points; redundancy numbers" in (thin.run / "report.html").read_text()
    (thin.run / "observations.npz").write_bytes(b"PK")
    with pytest.raises(BadProject, match=r"observations\.npz: it cannot be read"):
        read_result(thin.run)


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


def test_positions_hold_a_block_without_control(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command takes the datum that the viewer does, and says so."""
    table = demo / "points.csv"
    table.write_text(table.read_text().replace(",control", ",check"))
    block = read_project(demo)
    assert block.datum == "prior" and open_project(demo).room(Bundle).datum == "prior"
    done = run(capsys, "adjust", demo)
    count = len(block.images)
    assert done["warnings"][0] == f"there is no control: the positions (GPS) of {count} images hold the block (datum prior)"
    said = refused(capsys, "adjust", demo, "--datum", "control")
    assert f"no control is measured, and the GPS positions of {count} images take no part" in said and "--datum prior" in said


def test_refusals(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "not an interior orientation parameter" in refused(capsys, "adjust", demo, "--free", "c,focal")
    text = re.sub(r"\[images\.\w+\.prior\]\n(?:\w+ = .*\n)+", "", (demo / "project.toml").read_text())
    (demo / "project.toml").write_text(text)
    assert "no image has a prior" in refused(capsys, "adjust", demo, "--datum", "prior")
    assert "which project" in refused(capsys, "adjust")
    assert not (demo / "runs").exists()


class StopsAt:
    """A recording during which somebody presses Ctrl+C."""

    def __init__(self, at: int) -> None:
        self.at = at

    def __call__(self, path: Path, *begun: Any) -> StopsAt:
        self.live = Live(path, *begun)
        return self

    def row(self, row: Iteration) -> None:
        self.live.row(row)
        if row.index == self.at:
            raise KeyboardInterrupt

    def close(self) -> None:
        pass


def test_an_adjustment_is_stopped_and_continued_from_any_row(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = {"free": ("c",), "datum": "free"}
    whole = adjust_project(demo, **options)
    stopped = adjust_project(demo, live=StopsAt(2), **options)
    assert isinstance(whole, AdjustedProject) and isinstance(stopped, StoppedRun) and stopped.last.index == 2
    assert not (stopped.run / "running").exists() and not (stopped.run / "result.json").exists()
    kept = RowReader(stopped.run)
    assert len(kept) == 3
    for row, wanted in zip(kept.rows(), whole.result.trace.rows, strict=False):
        np.testing.assert_allclose(row.x, wanted.x, rtol=0, atol=1e-6)
        assert (row.index, row.cost, row.trials) == (wanted.index, wanted.cost, wanted.trials)
    drawn = [chunk.to_record_batch()["iteration"].to_pylist() for chunk in RrdReader(stopped.run / "recording.rrd").stream()
             if str(chunk.entity_path) == "/bundle/points"]
    assert sorted(k for part in drawn for k in part) == [0, 1, 2]  # each is in the file before anybody closes it
    for further in (stopped.run.name, f"{stopped.run.name}:1", str(stopped.run), f"{whole.run.name}:0" if whole.run else ""):
        done = run(capsys, "adjust", demo, "--continue", further)
        assert done["cost"] == pytest.approx(whole.result.cost, rel=1e-9) and done["dof"] == whole.result.dof
        assert done["points"][0]["X"] == pytest.approx(whole.result.to_json()["points"][0]["X"], abs=1e-5)
    assert "there is no row 9" in refused(capsys, "adjust", demo, "--continue", f"{stopped.run.name}:9")
    assert "no run elsewhere" in refused(capsys, "adjust", demo, "--continue", "elsewhere")
    text = (demo / "points.csv").read_text().splitlines()
    (demo / "points.csv").write_text("\n".join(line for line in text if not line.startswith("C03,")) + "\n")
    rows = [line for line in (demo / "observations.csv").read_text().splitlines() if ",C03," not in line]
    (demo / "observations.csv").write_text("\n".join(rows) + "\n")
    assert "'C03' of the run is not in the project any more" in refused(capsys, "adjust", demo, "--continue", stopped.run.name)


def test_large_traces_are_kept_thin(tmp_path: Path) -> None:
    """Rows of a large block are read back to a ten-millionth of what each point moved; a record cut off is not there."""
    rng = np.random.default_rng(3)
    head, size = 24, LARGE + 24
    first = rng.normal(0, 500, size)
    xs = [first, first + rng.normal(0, 2, size), first + rng.normal(0, 2, size)]
    rows = [Iteration(k, x, 10.0 - k, 1.0, 0.5, 0.1, 1e-4, 1, "step" if k == 2 else None) for k, x in enumerate(xs)]
    writer = RowWriter(tmp_path, {"problem": "bundle"}, head, size)
    for row in rows:
        writer.add(row)
    writer.close()
    trace = Trace((rows[0], thin(rows[1]), rows[2]), {"problem": "bundle"})
    assert trace.rows[1].x.dtype == np.float32 and thin(rows[0]) is rows[0]
    save_trace(trace, tmp_path)
    assert not (tmp_path / "trace.npz").exists() and (tmp_path / "rows.bin").stat().st_size < 21 * size
    back = load_trace(tmp_path)
    assert back.last.stop == "step" and [r.index for r in back.rows] == [0, 1, 2]
    for row, x in zip(back.rows, xs, strict=True):
        np.testing.assert_array_equal(row.x[:head], x[:head])
        np.testing.assert_allclose(row.x, x, rtol=0, atol=1e-6)
    with (tmp_path / "rows.bin").open("r+b") as stream:
        stream.truncate((tmp_path / "rows.bin").stat().st_size - 1)
    assert len(RowReader(tmp_path)) == 2
    with pytest.raises(BadProject, match="do not agree"):
        load_trace(tmp_path)
