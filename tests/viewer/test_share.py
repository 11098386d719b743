"""Ways out: the replay plays from disk without a server, tables and archives hold what they should."""

from __future__ import annotations

import csv
import io
import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image as Picture

from solvers import PhotogrammetryError
from solvers.cli import main
from solvers.cli_project import EXPORTS
from solvers.io import photo_path, read_project
from solvers.io.photos import photo_size
from tests.browser import LOCAL, chromium_page, require_chromium
from tests.viewer.sessions import DEMO
from tests.viewer.test_actions import solve_all  # type: ignore[import-not-found]
from viewer_app import pictures
from viewer_app.acting import update
from viewer_app.actions import ChooseImage, ChoosePoint, Show, SwitchPoint
from viewer_app.actions_points import EditPoint
from viewer_app.exporting import KINDS, settled
from viewer_app.home import home
from viewer_app.keeping import Keeper, resume
from viewer_app.lists import Tables
from viewer_app.loading import open_project
from viewer_app.panels.share import TERMINAL
from viewer_app.pictures import scene_png
from viewer_app.session import to_json
from viewer_app.share import project_zip, replay_html, tables
from viewer_app.state import State
from viewer_app.tabs import whole_scene
from viewer_app.values import Mesh


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
    words += ["--glb", f"{out}/scene.glb", "--ply", f"{out}/scene.ply", "--zip", f"{out}/project.zip"]
    assert main([*words, "--json", f"{out}/said.json"]) == 0
    return out


TABLES = {f"{n}.csv" for n in ("points", "images", "observations", "cameras", "orientations", "residuals", "iterations")}


def test_the_command_writes_every_file_and_says_which(shared: Path) -> None:
    said = json.loads((shared / "said.json").read_text(encoding="utf-8"))
    files = [Path(f) for f in said["files"]]
    assert {f.name for f in files} == {"project.zip", "replay.html", "run.rrd", "scene.glb", "scene.ply", *TABLES}
    assert said["failed"] == [] and all(f.stat().st_size > 100 for f in files)
    assert (shared / "replay.html").stat().st_size < 10_000_000 and (shared / "run.rrd").read_bytes()[:3] == b"RRF"


def test_the_terminal_offers_what_the_tab_does() -> None:
    assert TERMINAL.split()[3::2] == [f"--{kind}" for kind, _, _ in EXPORTS]
    assert [kind for kind, _, _ in EXPORTS] == list(KINDS)


def test_tables_are_whole_and_read_back_to_the_last_bit(shared: Path, folder: Path) -> None:
    block = read_project(folder)
    table = {f.stem: list(csv.DictReader(f.open(encoding="utf-8"))) for f in (shared / "tables").iterdir()}
    xyz = np.array([[float(row[f"{k} [m]"]) for k in "XYZ"] for row in table["points"]])
    assert [row["point"] for row in table["points"]] == list(block.points.names) and np.array_equal(xyz, block.points.xyz)
    pixel = np.array([[float(row["col [px]"]), float(row["row [px]"])] for row in table["observations"]])
    assert np.array_equal(pixel, block.observations.pixel)
    state = settled(open_project(folder))
    for row in table["orientations"]:
        solution = state.solution(row["model"], row["image"])
        assert solution and solution.orientation
        found = solution.orientation
        assert [float(row[f"{k} [m]"]) for k in "XYZ"] == found.exterior.centre.tolist()
        assert [float(row[f"s{k} [°]"]) for k in "ωφκ"] == np.degrees(found.sigma[3:]).tolist()
        rows = [r for r in table["iterations"] if (r["image"], r["model"]) == (row["image"], row["model"])]
        assert [float(r["cost"]) for r in rows] == [r.cost for r in found.trace.rows]
        mine = [r for r in table["residuals"] if (r["image"], r["model"]) == (row["image"], row["model"])]
        v = [[float(r["v col [px]"]), float(r["v row [px]"])] for r in mine]
        assert v == found.residuals.tolist() and [r["point"] for r in mine] == list(found.points)
    assert len(table["orientations"]) == 2 * len(block.images)


def test_tables_hold_every_row_whatever_the_screen_shows(state: State) -> None:
    n = 1000
    points = replace(state.block.points, names=tuple(f"P{k}" for k in range(n)), xyz=np.zeros((n, 3)), sigma=np.zeros((n, 3)),
                     role=("tie",) * n, group=())  # fmt: skip
    block = replace(state.block, points=points)
    looked_for = replace(state, work=replace(state.work, block=block)).with_room(Tables({}, "P1*"))
    assert tables(looked_for)["points.csv"].count("\n") == n + 1


def test_the_scene_says_where_it_is(shared: Path, folder: Path) -> None:
    state = settled(open_project(folder))
    frame, terrain = state.assets.frame, whole_scene(state)["/ground/terrain"]
    assert isinstance(terrain, Mesh)
    loaded: Any = trimesh.load(shared / "scene.glb")
    assert np.allclose(loaded.metadata["origin"], frame.origin) and loaded.metadata["unit"] == "metre"
    turn, name = loaded.graph.get("/ground/terrain")
    assert np.allclose(loaded.geometry[name].vertices, terrain.vertices, atol=1e-3)  # z up, as the node says
    assert np.allclose((turn @ [0, 0, 1, 0])[:3], [0, 1, 0])  # and y up as glTF has it
    head = (shared / "scene.ply").read_bytes().partition(b"end_header")[0].decode()
    assert f"comment origin [{frame.origin[0]}" in head and "comment unit metre" in head
    mesh: Any = trimesh.load(shared / "scene.ply")
    assert np.allclose(mesh.vertices[: len(terrain.vertices)], terrain.vertices, atol=1e-3)


def test_the_archive_is_the_project(shared: Path, tmp_path: Path, folder: Path) -> None:
    with zipfile.ZipFile(shared / "project.zip") as file:
        assert not [n for n in file.namelist() if n.startswith("/") or ".." in n or "/runs/" in n]
        file.extractall(tmp_path)
    one, two = read_project(folder), read_project(tmp_path / folder.name)
    assert one.name == two.name and (one.observations.pixel == two.observations.pixel).all()


def test_photos_from_elsewhere_come_along_and_nothing_else(folder: Path, tmp_path: Path) -> None:
    project, other = tmp_path / "site", tmp_path / "other"
    shutil.copytree(folder, project)
    other.mkdir()
    text = (project / "project.toml").read_text(encoding="utf-8")
    for name in ("DSC00229.jpg", "DSC00230.jpg"):
        shutil.move(project / "images" / name, other / name)
        text = text.replace(f'"images/{name}"', f'"{other / name}"')
    (project / "images" / "DSC00230.jpg").symlink_to(other / "DSC00229.jpg")
    (project / "project.toml").write_text(text, encoding="utf-8")
    with zipfile.ZipFile(io.BytesIO(project_zip(project))) as file:
        assert not [n for n in file.namelist() if n.startswith("/") or ".." in n]
        file.extractall(tmp_path / "there")
    shutil.rmtree(other)
    there, block = tmp_path / "there" / "site", read_project(tmp_path / "there" / "site")
    assert [photo_size(photo_path(there, block, i.name)) for i in block.images] == [(1500, 1000)] * 5
    assert len(list((there / "images").iterdir())) == 5
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    (project / "project.toml").write_text(text.replace(str(other / "DSC00229.jpg"), str(secret)), encoding="utf-8")
    with pytest.raises(PhotogrammetryError, match=r"secret\.txt: this is not a photo"):
        project_zip(project)


def test_a_project_in_an_archive_opens_as_it_was_left(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "site")
    state = open_project(tmp_path / "site")
    keeper = Keeper(tmp_path / "site", state.block, lambda: state)
    edits = SwitchPoint("G02"), EditPoint("G01", "sX", "0.05")
    for action in (ChooseImage("DSC00231"), Show("rays", False), ChoosePoint("G05"), *edits):
        state = update(state, action)
    keeper.write()
    with zipfile.ZipFile(io.BytesIO(project_zip(tmp_path / "site"))) as file:
        file.extractall(tmp_path / "there")
    again = resume(open_project(tmp_path / "there" / "site"))
    assert to_json(again, open_project(tmp_path / "there" / "site").block) == to_json(state, keeper.disk)
    assert again.work.off == {"G02"} and again.image == "DSC00231" and len(again.past) == len(state.past) > 0


def test_no_file_of_the_project_is_written_over(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {f: f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    wrong = [("--csv", folder), ("--html", folder / "points.csv"), ("--zip", folder / "images" / "DSC00229.jpg"),
             ("--ply", folder / "dem.tif"), ("--glb", folder), ("--rrd", tmp_path / "nowhere" / "x.rrd")]  # fmt: skip
    for option, target in wrong:
        assert main(["export", str(folder), option, str(target)]) == 1
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and ("part of the project" in said or "folder" in said), said
    assert main(["export", str(folder), "--glb", f"{tmp_path}/x", "--ply", f"{tmp_path}/x"]) == 1
    assert {f: f.read_bytes() for f in folder.rglob("*") if f.is_file()} == before


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


def plays(page_file: Path, name: str, rows: int, last: np.ndarray) -> None:
    """Opened from disk, without a server, a node of the page moves, keys step through its rows, nobody is asked for anything."""
    require_chromium()
    with chromium_page(page_file.as_uri(), size=(640, 480), drawn=False) as (page, log):
        page.wait_for_function("n => window.__viserMutable?.nodeRefFromName?.[n]", arg=name, timeout=90_000)
        first = page.evaluate("n => [...window.__viserMutable.nodePoseData[n].position]", name)
        moved = "([n, p]) => window.__viserMutable.nodePoseData[n].position.some((v, i) => Math.abs(v - p[i]) > 1e-3)"
        page.wait_for_function(moved, arg=[name, first], timeout=60_000)
        for key, row in (("Home", 0), ("ArrowRight", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", rows - 1), ("Home", 0)):
            page.keyboard.press(key)
            page.wait_for_function("row => collineaReplay.row() === row", arg=row, timeout=60_000)
            page.locator("#collinea-row", has_text=f"perspective row {row}:").wait_for()
        page.get_by_role("button", name="Last row").click()
        page.wait_for_function("row => collineaReplay.row() === row", arg=rows - 1, timeout=60_000)
        page.wait_for_function("p => Math.max(...[0, 1, 2].map(i => Math.abs(p[1][i] - window.__viserMutable.nodePoseData[p[0]]"
                               ".position[i]))) < 1e-3", arg=[name, list(last)])  # fmt: skip
        assert page.get_by_text("ground control point").is_visible()
        assert log.errors == [] and not [url for url in log.requests if not LOCAL.match(url)]


@pytest.mark.browser
@pytest.mark.timeout(240)
def test_the_replay_plays_from_disk_without_a_server(shared: Path, folder: Path) -> None:
    state = settled(open_project(folder))
    solution, at = state.solution("perspective"), state.exterior("perspective")
    assert solution and at
    plays(shared / "replay.html", "/images/DSC00229/perspective/camera", len(solution.rows), at.centre)


def test_a_picture_without_a_browser_is_a_sentence(monkeypatch: pytest.MonkeyPatch, state: State) -> None:
    monkeypatch.setattr("viewer_app.pictures.shutil.which", lambda name: None)
    with pytest.raises(PhotogrammetryError, match=r"needs Chromium or Chrome.*install"):
        scene_png(state)


@pytest.mark.browser
@pytest.mark.timeout(240)
@pytest.mark.parametrize("fov", [45.0, 1.0])
def test_the_scene_is_drawn_as_a_picture_of_the_size_asked_for(
    state: State, monkeypatch: pytest.MonkeyPatch, fov: float
) -> None:
    """Through a long lens from beyond the 1000 m after which viser ends a picture as well."""
    require_chromium()
    away, at = pictures.home_alone(state, *pictures.VIEW, np.radians(fov), pictures.LEGEND)
    distance = float(np.linalg.norm(away - at))
    assert (distance > 1000) == (fov == 1)
    monkeypatch.setattr(pictures, "PATIENCE", 60.0)
    monkeypatch.setattr(pictures, "home", lambda state: (*home(state)[:2], 10 * distance))
    monkeypatch.setattr(pictures, "FOV", np.radians(fov))
    drawn = np.asarray(Picture.open(io.BytesIO(scene_png(state, (270, 480)))), int)
    assert drawn.shape == (270, 480, 3) and tuple(drawn[2, 2]) == (255, 255, 255)
    assert (np.abs(drawn[:, 200:] - 255).sum(axis=2) > 24).mean() > 0.02  # something is drawn
    words = np.abs(drawn[:, :180] - 255).sum(axis=2) > 200
    assert words.any(axis=1).sum() > 12  # and told


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
    plays(tmp_path / "replay.html", "/images/left/perspective/camera", 50, many[-1].x[:3])
