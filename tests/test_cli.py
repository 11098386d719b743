"""The command line: help, JSON, exit codes, and errors of the machine as one sentence."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from solvers import cli_project, simulation, workflows
from solvers.cli import main
from solvers.io import load_trace, read_project, read_truth, write_project
from tests.projects import AT, good_block

COLLINEA = [sys.executable, "-m", "solvers.cli"]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    write_project(good_block(), tmp_path / "site")
    return tmp_path / "site"


def call(*words: object, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COLLINEA, *map(str, words)], capture_output=True, text=True, timeout=120, check=False, **options)


def test_help_is_quick_and_names_the_commands() -> None:
    before = os.times()
    done = call("--help")
    after = os.times()
    assert done.returncode == 0 and done.stderr == ""
    for word in ("demo", "init", "view", "resect", "simulate", "log"):
        assert word in done.stdout
    used = after.children_user + after.children_system - before.children_user - before.children_system
    assert used < 1.0  # 0.35 s on a quiet machine; under 0.5 s is what counts


@pytest.mark.parametrize("command", ["demo", "init", "view", "resect", "simulate", "log"])
def test_every_command_has_help_json_and_quiet(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    out = capsys.readouterr().out
    assert "--json" in out and "--quiet" in out


@pytest.mark.parametrize("words", [["fly"], ["resect"], ["resect", "x", "--model", "affine"], ["init", "a.jpg"],
                                   ["simulate", "moon", "-o", "x"],
                                   ["init", "a.jpg", "-o", "x", "--pixel-um", "-3"], ["view", "x", "--port", "many"],
                                   ["resect", "x", "--points", ","]])
def test_usage_errors_exit_with_2(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("collinea: ") and err.count("\n") == 1 and "--help" in err


def test_no_command_is_the_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(cli_project, "_demo", lambda args: seen.append(args) or 0)
    assert main([]) == 0 and main(["--no-browser", "--port", "8123"]) == 0 and main(["demo"]) == 0
    assert [a.port for a in seen] == [0, 8123, 0] and [a.no_browser for a in seen] == [False, True, False]


def test_resect_json_and_run(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resect", str(site), "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [(o["image"], o["model"]) for o in result["orientations"]] == [("a", "perspective"), ("a", "orthogonal")]
    o = result["orientations"][0]
    np.testing.assert_allclose([o["X"], o["Y"], o["Z"]], AT.centre, atol=1.5)
    assert o["converged"] and np.shape(o["covariance"]) == (6, 6) and len(o["residuals"]) == 7
    np.testing.assert_allclose(o["sigma"]["omega_deg"], np.degrees(np.sqrt(o["covariance"][3][3])), rtol=1e-12)
    assert result["advice"]["a"]["model"] and result["advice"]["a"]["reasons"]

    [run] = (site / "runs").iterdir()
    assert str(run) == result["run"] and run.name.endswith("-resect")
    names = {f.name for f in run.iterdir()}
    assert names == {"result.json", "recording.rrd", "trace.npz", "trace.json", "trace-a-perspective.npz",
                     "trace-a-perspective.json",
                     "trace-a-orthogonal.npz", "trace-a-orthogonal.json"}
    assert json.loads((run / "result.json").read_text()) == result
    trace = load_trace(run, "trace-a-perspective")
    assert trace.iterations == o["iterations"] and trace.last.stop == o["stop"] and trace.manifest["image"] == "a"


def test_resect_options_reach_the_solver(site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r.json"
    assert main(["resect", str(site), "--image", "a", "--model", "perspective", "--points", "P1,P2,P3,P4,P5", "--free", "c",
                 "--quiet", "--json", str(out)]) == 0
    [o] = json.loads(out.read_text())["orientations"]
    assert [r["point"] for r in o["residuals"]] == ["P1", "P2", "P3", "P4", "P5"] and o["interior"]["sigma"]["c_mm"] > 0
    # with both models, only the perspective one frees c
    assert main(["resect", str(site), "--free", "c", "--quiet", "--json", str(out)]) == 0
    assert [("interior" in o) for o in json.loads(out.read_text())["orientations"]] == [True, False]
    assert main(["resect", str(site), "--model", "orthogonal", "--form", "printed", "--recentre", "off", "--quiet", "--json",
                 str(out)]) == 0
    manifest = load_trace(Path(json.loads(out.read_text())["run"])).manifest
    assert manifest["options"]["form"] == "printed" and manifest["options"]["recentre"] is False
    assert capsys.readouterr() == ("", "")


def test_the_table_shows_both_models_and_their_difference(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resect", str(site)]) == 0
    lines = capsys.readouterr().out.splitlines()
    head = next(line for line in lines if "perspective" in line)
    assert head.split() == ["perspective", "sigma", "orthogonal", "sigma", "difference"]
    row = next(line for line in lines if line.strip().startswith("Z [m]"))
    p, sp, q, sq, gap = map(float, row.split()[2:])
    assert abs(p - 300) < 1 and abs(q - p - gap) < 2e-3 and sp > 0 and sq > 0


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """The simulation with a coarsely painted ground: the same numbers, quicker photos."""
    monkeypatch.setattr(simulation, "uav_cluster", partial(simulation.uav_cluster, fine=False))


@pytest.mark.usefixtures("coarse")
def test_simulate_makes_a_project_with_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "uav_cluster", "-o", str(tmp_path / "s"), "--reduction", "16", "--json", "-"]) == 0
    made = json.loads(capsys.readouterr().out)
    block, truth = read_project(tmp_path / "s"), read_truth(tmp_path / "s")
    assert truth is not None and set(truth["images"]) == {i.name for i in block.images} == set(made["images"])
    assert main(["resect", str(tmp_path / "s"), "--model", "perspective", "--json", "-"]) == 0
    for o in json.loads(capsys.readouterr().out)["orientations"]:
        true, got = truth["images"][o["image"]], o
        for k in ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg"):
            assert abs(got[k] - true[k]) < 6 * o["sigma"][k], (o["image"], k)
    assert main(["simulate", "uav_cluster", "-o", str(tmp_path / "s")]) == 1
    assert "already there" in capsys.readouterr().err


# -- the machine ------------------------------------------------------------------------------------------------------------


def raising(error: BaseException):
    def run(*_: Any, **__: Any) -> None:
        raise error
    return run


def refusal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], site: Path, error: BaseException) -> str:
    monkeypatch.setattr(workflows, "orient", raising(error))
    assert main(["resect", str(site)]) == 1
    out, err = capsys.readouterr()
    assert out == "" and "Traceback" not in err and err.count("\n") == 1 and err.startswith("collinea: ")
    assert not [r for r in (site / "runs").glob("*-resect")]
    return err


def test_ctrl_c(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], site: Path) -> None:
    assert "Ctrl+C" in refusal(monkeypatch, capsys, site, KeyboardInterrupt())


def test_memory(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], site: Path) -> None:
    assert "memory" in refusal(monkeypatch, capsys, site, MemoryError())


def test_the_unforeseen_leaves_a_log(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], site: Path) -> None:
    (site / "runs").mkdir()
    message = refusal(monkeypatch, capsys, site, RuntimeError("the moon\nis blue"))
    assert "RuntimeError: the moon is blue" in message
    [log] = (site / "runs").glob("collinea-error-*.log")
    assert str(log) in message and "Traceback" in log.read_text()


def test_a_full_disk_leaves_nothing_half_written(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
                                                 site: Path) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    assert main(["resect", str(site)]) == 1
    out, err = capsys.readouterr()
    assert out == "" and "No space left on device" in err and err.count("\n") == 1
    assert not list((site / "runs").iterdir())
    photo = site.parent / "b.png"
    Image.new("RGB", (60, 40)).save(photo)
    assert main(["init", str(photo), "-o", str(site.parent / "new"), "--pixel-um", "4", "--c-mm", "35"]) == 1
    assert not (site.parent / "new").exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_may_not_be_written(capsys: pytest.CaptureFixture[str], site: Path) -> None:
    site.chmod(0o555)
    assert main(["resect", str(site)]) == 1
    assert "Permission denied" in capsys.readouterr().err
    site.chmod(0o755)


def test_a_closed_pipe(site: Path) -> None:
    process = subprocess.Popen([*COLLINEA, "resect", str(site), "--model", "perspective"], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    err = process.stderr.read()
    assert process.wait(60) == 1 and "Traceback" not in err and "Exception" not in err and err.count("\n") == 1


def test_a_real_interrupt(site: Path) -> None:
    code = ("import sys, time\nimport solvers.workflows as w\nfrom solvers.cli import main\n"
            "def orient(*_):\n    print('ready', flush=True)\n    time.sleep(60)\nw.orient = orient\nsys.exit(main(['resect', "
            "sys.argv[1]]))")
    process = subprocess.Popen([sys.executable, "-c", code, str(site)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 1 and err == "collinea: stopped by Ctrl+C\n"


@pytest.mark.parametrize("command", ["demo", "view", "log"])
def test_what_stays_open_says_where_and_ends_with_ctrl_c(command: str, site: Path, tmp_path: Path) -> None:
    if command == "log":
        assert main(["resect", str(site), "--quiet", "--model", "perspective"]) == 0
    words = [command, "--no-browser"] if command == "demo" else [command, str(site), "--no-browser"]
    environment = {**os.environ, "XDG_DATA_HOME": str(tmp_path / "data")}
    process = subprocess.Popen([*COLLINEA, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
    assert process.stdout is not None
    said = ""
    for line in process.stdout:
        said += line
        if "http://127.0.0.1:" in line and "Ctrl+C" in line:
            break
    assert "http://127.0.0.1:" in said, said
    process.send_signal(signal.SIGINT)
    said += process.communicate(timeout=60)[0]
    assert process.returncode == 0 and "Traceback" not in said, said


def test_refusal_as_a_user_sees_it(site: Path) -> None:
    (site / "points.csv").write_text("name;X\n")
    done = call("resect", site)
    assert done.returncode == 1 and done.stdout == "" and done.stderr.startswith("collinea: ") and done.stderr.count("\n") == 1


def test_every_simulation_is_offered() -> None:
    from solvers.cli_project import SIMULATIONS
    from solvers.simulation import KINDS, SERIES

    assert set(SIMULATIONS) == {*KINDS, *SERIES}
