"""Runs and traces: saved and opened again unchanged, never with pickle."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from solvers import BadProject, Trace
from solvers.adjustment import Iteration
from solvers.io import latest_run, load_trace, new_run, save_trace, trace_name

ROWS = (Iteration(0, np.arange(12.0), 5.0, float("nan"), float("nan"), 0.5, 1e-4, 0),
        Iteration(1, np.arange(12.0) / 3, 1.25, 0.75, 2.5, 1e-13, 1e-5, 2, "step"))
MANIFEST = {"problem": "resection", "points": ["a", "b"], "xyz": [[1.0, 2.0, 3.0]], "options": {"robust": False, "points": None}}


def test_round_trip(tmp_path: Path) -> None:
    save_trace(Trace(ROWS, MANIFEST), tmp_path, "trace-a-perspective")
    back = load_trace(tmp_path, "trace-a-perspective")
    assert back.manifest == MANIFEST and back.converged and len(back) == 2
    for a, b in zip(ROWS, back.rows, strict=True):
        np.testing.assert_array_equal(a.x, b.x)
        assert (a.index, a.cost, a.gradient, a.damping, a.trials, a.stop) == (b.index, b.cost, b.gradient, b.damping, b.trials,
                                                                              b.stop)
        np.testing.assert_array_equal([a.sigma0, a.step], [b.sigma0, b.step])
    assert json.loads((tmp_path / "trace-a-perspective.json").read_text())["stop"] == "step"
    with np.load(tmp_path / "trace-a-perspective.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {"x", "index", "cost", "sigma0", "step", "gradient", "damping", "trials"}


def test_damaged_traces_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadProject, match=r"trace\.json: there is no such file"):
        load_trace(tmp_path)
    save_trace(Trace(ROWS, MANIFEST), tmp_path)
    whole = (tmp_path / "trace.npz").read_bytes()
    for part in (whole[:100], b"", b"x" * 500):
        (tmp_path / "trace.npz").write_bytes(part)
        with pytest.raises(BadProject, match=r"trace\.npz: the file is damaged"):
            load_trace(tmp_path)
    np.savez(tmp_path / "trace.npz", x=np.array([{"a": 1}], dtype=object), allow_pickle=True)  # never unpickled
    with pytest.raises(BadProject, match="damaged"):
        load_trace(tmp_path)
    (tmp_path / "trace.npz").write_bytes(whole)
    (tmp_path / "trace.json").write_text('{"rows": 2}')
    with pytest.raises(BadProject, match="not a trace of this version"):
        load_trace(tmp_path)


def test_runs_have_a_time_and_an_order(tmp_path: Path) -> None:
    assert latest_run(tmp_path) is None
    runs = [new_run(tmp_path, "resect") for _ in range(12)]
    assert len(set(runs)) == 12 and latest_run(tmp_path) == runs[-1]
    (tmp_path / "runs" / "notes").mkdir()
    (tmp_path / "runs" / "99999999-999999-file").write_text("")
    assert latest_run(tmp_path) == runs[-1] and latest_run(tmp_path, "recording.rrd") is None
    (runs[3] / "recording.rrd").write_text("")
    assert latest_run(tmp_path, "recording.rrd") == runs[3]
    shutil.rmtree(tmp_path / "runs")
    assert latest_run(tmp_path) is None


@pytest.mark.parametrize(("image", "name"), [("8811", "trace-8811-orthogonal"), ("../../etc/x", "trace-_.._etc_x-orthogonal"),
                                             ("a b/c", "trace-a_b_c-orthogonal"), ("..", "trace-_-orthogonal")])
def test_names_of_traces_stay_in_the_run(image: str, name: str) -> None:
    assert trace_name(image, "orthogonal") == name
