"""Ways out: the replay plays from disk without a server, tables and archives hold what they should."""

from __future__ import annotations

import io
import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Picture

from solvers import PhotogrammetryError
from solvers.cli import main
from solvers.io import read_project
from tests.browser import LOCAL, chromium_page, require_chromium
from tests.viewer.sessions import DEMO
from tests.viewer.test_actions import solve_all  # type: ignore[import-not-found]
from viewer_app.pictures import scene_png
from viewer_app.share import project_zip, replay_html
from viewer_app.state import State


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("share") / "demo"
    shutil.copytree(DEMO, made, ignore=shutil.ignore_patterns("runs"))
    return made


@pytest.fixture(scope="module")
def shared(folder: Path) -> Path:
    out = folder.parent / "out"
    out.mkdir()
    words = ["export", str(folder), "--html", f"{out}/replay.html", "--rrd", f"{out}/run.rrd", "--csv", f"{out}/tables"]
    assert main([*words, "--zip", f"{out}/project.zip", "--json", f"{out}/said.json"]) == 0
    return out


def test_the_command_writes_every_file_and_says_which(shared: Path) -> None:
    files = [Path(f) for f in json.loads((shared / "said.json").read_text(encoding="utf-8"))["files"]]
    assert {f.name for f in files} == {"project.zip", "replay.html", "run.rrd", "points.csv", "images.csv", "orientations.csv"}
    assert all(f.stat().st_size > 100 for f in files)
    assert (shared / "replay.html").stat().st_size < 10_000_000 and (shared / "run.rrd").read_bytes()[:3] == b"RRF"
    orientations = (shared / "tables" / "orientations.csv").read_text(encoding="utf-8").splitlines()
    assert orientations[0].startswith("image,X [m]") and len(orientations) == 6 and "±" not in orientations[1]


def test_the_archive_is_the_project(shared: Path, tmp_path: Path, folder: Path) -> None:
    with zipfile.ZipFile(shared / "project.zip") as file:
        assert not [n for n in file.namelist() if n.startswith("/") or ".." in n or "/runs/" in n]
        file.extractall(tmp_path)
    one, two = read_project(folder), read_project(tmp_path / folder.name)
    assert one.name == two.name and (one.observations.pixel == two.observations.pixel).all()


def test_links_do_not_lead_out_of_the_archive(tmp_path: Path) -> None:
    project = tmp_path / "project"
    (project / "runs").mkdir(parents=True)
    (project / "project.toml").write_text("x")
    (project / "runs" / "old.txt").write_text("derived")
    (tmp_path / "secret.txt").write_text("secret")
    (project / "photo.jpg").symlink_to(tmp_path / "secret.txt")
    with zipfile.ZipFile(io.BytesIO(project_zip(project))) as file:
        assert file.namelist() == ["project/project.toml"]


def test_nothing_wished_for_is_a_sentence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(folder)]) == 1
    assert "--html FILE" in capsys.readouterr().err
    assert main(["export", str(folder / "nowhere"), "--zip", "x.zip"]) == 1
    with pytest.raises(PhotogrammetryError):
        read_project(folder / "nowhere")


def plays(page_file: Path, name: str) -> None:
    """Opened from disk, without a server, a node of the page moves, and nothing is asked of anyone."""
    require_chromium()
    with chromium_page(page_file.as_uri(), size=(640, 480), drawn=False) as (page, log):
        page.wait_for_function("n => window.__viserMutable?.nodeRefFromName?.[n]", arg=name, timeout=90_000)
        first = page.evaluate("n => [...window.__viserMutable.nodePoseData[n].position]", name)
        moved = "([n, p]) => window.__viserMutable.nodePoseData[n].position.some((v, i) => Math.abs(v - p[i]) > 1e-3)"
        page.wait_for_function(moved, arg=[name, first], timeout=60_000)
        assert log.errors == [] and not [url for url in log.requests if not LOCAL.match(url)]


@pytest.mark.browser
@pytest.mark.timeout(240)
def test_the_replay_plays_from_disk_without_a_server(shared: Path) -> None:
    plays(shared / "replay.html", "/images/DSC00229/perspective/camera")


def test_a_picture_without_a_browser_is_a_sentence(monkeypatch: pytest.MonkeyPatch, state: State) -> None:
    monkeypatch.setattr("viewer_app.pictures.shutil.which", lambda name: None)
    with pytest.raises(PhotogrammetryError, match=r"needs Chromium or Chrome.*install"):
        scene_png(state)


@pytest.mark.browser
@pytest.mark.timeout(240)
def test_the_scene_is_drawn_as_a_picture_of_the_size_asked_for(state: State) -> None:
    require_chromium()
    drawn = np.asarray(Picture.open(io.BytesIO(scene_png(state, (270, 480)))), int)
    assert drawn.shape == (270, 480, 3) and tuple(drawn[2, 2]) == (255, 255, 255)
    assert (np.abs(drawn - 255).sum(axis=2) > 24).mean() > 0.02  # something is drawn


@pytest.mark.browser
@pytest.mark.timeout(240)
def test_a_replay_of_fifty_rows_stays_below_ten_megabytes_and_plays_from_disk(state: State, tmp_path: Path) -> None:
    rows = solve_all(state).solution("perspective")
    assert rows and rows.orientation
    last = rows.rows[-1]
    many = [replace(last, index=k, x=last.x + np.r_[0.7**k, 0.3 * 0.7**k, 0.7**k, np.zeros(len(last.x) - 3)]) for k in range(50)]
    solutions = {("left", "perspective"): replace(rows, rows=tuple(many))}
    text = replay_html(replace(state, work=replace(state.work, solutions=solutions), row=49))
    assert 1e5 < len(text.encode()) < 10e6
    (tmp_path / "replay.html").write_text(text, encoding="utf-8")
    plays(tmp_path / "replay.html", "/images/left/perspective/camera")
