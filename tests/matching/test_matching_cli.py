"""The commands match, targets and tiepoints on small photos: their JSON, what they write, how they refuse."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from solvers.block import Block, Image, Observations, Points, Prior
from solvers.cameras import Interior
from solvers.cli import main
from solvers.execution import Progress
from solvers.io import read_project, write_image, write_project
from solvers.matching import TieOptions
from solvers.matching.verify import apply
from solvers.workflows_matching import find_ties
from tests.matching.test_ties import SIZE, photograph, plane_to_photo


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("photos")
    for n in range(3):
        write_image(made / f"p{n}.png", np.repeat(photograph(n)[..., None], 3, 2))
    return made


def asked(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    assert main([*map(str, words), "--json", "-"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("method", ["ncc", "lsm"])
def test_match_finds_the_point(folder: Path, capsys: pytest.CaptureFixture[str], method: str) -> None:
    found = asked(capsys, "match", folder / "p0.png", folder / "p1.png", "--at", "230,140", "--method", method)
    truth = apply(plane_to_photo(1) @ np.linalg.inv(plane_to_photo(0)), np.array([[230.0, 140.0]]))[0]
    assert np.hypot(found["col"] - truth[0], found["row"] - truth[1]) < (0.1 if method == "lsm" else 0.5)
    assert found["method"] == method and 0.8 < found["score"] <= 1 and len(found["affine"]) == 6
    assert found["start"]["from"] == "features"
    if method == "lsm":
        assert len(found["sigma_px"]) == 2 and len(found["radiometric"]) == 2 and found["iterations"] >= 1


def test_match_refuses_in_one_sentence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in [(("p0.png", "p1.png", "--at", "500,10"), "outside the photo of 420 x 320 pixels"),
                        (("p0.png", "p2.png", "--at", "3,140"), "does not show the point of col 3, row 140"),
                        (("p0.png", "nothing.png", "--at", "3,140"), "nothing.png: there is no such photo")]:
        assert main(["match", *(str(folder / w) if w.endswith("png") else w for w in words)]) == 1
        err = capsys.readouterr().err
        assert said in err and err.count("\n") == 1


def test_targets_are_written_as_observations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row, col = np.mgrid[0:200, 0:260]
    grey = np.full((200, 260), 220.0)
    centres = [(60.3 + 70 * i, 50.2 + 60 * j) for j in range(2) for i in range(3)]
    for x, y in centres:
        grey -= 180 * np.clip(12.5 - np.hypot(col - x, row - y), 0, 1)
    write_image(tmp_path / "sheet.png", np.repeat(grey.astype(np.uint8)[..., None], 3, 2))
    found = asked(capsys, "targets", tmp_path / "sheet.png", "-o", tmp_path / "observations.csv")
    assert found["kind"] == "dot" and not found["numbered"] and found["targets"][0]["eccentricity_px"] is None
    rows = list(csv.DictReader((tmp_path / "observations.csv").read_text().splitlines()))
    at = np.array([(float(r["col"]), float(r["row"])) for r in rows])
    distance = np.linalg.norm(at[:, None] - centres, axis=2)
    assert len(rows) == 6 and (np.sort(distance.min(0)) < 0.05).all() and {r["image"] for r in rows} == {"sheet"}
    write_image(tmp_path / "blank.png", np.full((100, 100, 3), 90, np.uint8))
    assert main(["targets", str(tmp_path / "blank.png")]) == 1
    assert "no target of kind dot" in capsys.readouterr().err


def test_tiepoints_of_a_folder(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "broken.jpg").write_bytes(b"no photo")
    try:
        found = asked(capsys, "tiepoints", folder, "-o", tmp_path / "ties.csv", "--workers", 1, "--per-photo", 200)
    finally:
        (folder / "broken.jpg").unlink()
    rows = list(csv.DictReader((tmp_path / "ties.csv").read_text().splitlines()))
    assert len(rows) == found["observations"] > 200 and sum(found["rays"].values()) == found["points"]
    broken = next(i for i in found["images"] if i["name"] == "broken")
    assert not broken["used"] and "broken.jpg" in broken["why"]
    assert found["groups"] == [["p0", "p1", "p2"], ["broken"]]
    assert {f.name for f in tmp_path.iterdir()} == {"ties.csv"}


def test_tiepoints_of_a_folder_go_on_where_they_were_interrupted(folder: Path, tmp_path: Path) -> None:
    out, kept = tmp_path / "ties.csv", tmp_path / "ties-kept"
    options = TieOptions(per_photo=200)

    class Stopped(Exception):
        pass

    def stop(at: Progress) -> None:
        if at.stage == "pairs":
            raise Stopped

    with pytest.raises(Stopped):
        find_ties(folder, out, options, report=stop)
    done = {f.name: f.stat().st_mtime_ns for f in kept.iterdir()}
    assert sorted(n.split("-")[0] for n in done) == ["features"] * 3 + ["pair"] and not out.exists()
    (kept / "notes.npz").write_bytes(b"of somebody else")
    seen: list[dict[str, int]] = []
    first = find_ties(folder, out, options,
                      report=lambda _: seen.append({f.name: f.stat().st_mtime_ns for f in kept.iterdir() if f.name in done}))
    assert all(s == done for s in seen)
    assert [f.name for f in kept.iterdir()] == ["notes.npz"]
    assert len(first.ties.points) == len(find_ties(folder, tmp_path / "again.csv", options).ties.points)
    assert (tmp_path / "again.csv").read_bytes() == out.read_bytes()


def test_tiepoints_join_a_project_and_replace_earlier_ones(folder: Path, tmp_path: Path,
                                                           capsys: pytest.CaptureFixture[str]) -> None:
    camera = Interior(10.0, pixel_mm=0.01, width=2 * SIZE[0], height=2 * SIZE[1])  # the photos show the format at half its size
    images = tuple(Image(f"i{n}", "cam", str(folder / f"p{n}.png"), Prior(np.array([70.0 * n, 0, 500]))) for n in range(3))
    points = Points(("P1",), np.array([[1.0, 2, 3]]), np.full((1, 3), np.nan), ("control",))
    seen = Observations(np.array([0]), np.array([0]), np.array([[100.0, 50.0]]), np.array([np.nan]))
    block = Block("site", "local", {"cam": camera}, images, points, seen)
    write_project(block, tmp_path / "site", pixel_origin="corner")
    first = asked(capsys, "tiepoints", tmp_path / "site", "--workers", 1, "--per-photo", 200)
    once = read_project(tmp_path / "site")
    assert len(once.points) == 1 + first["points"] and once.points.names[:2] == ("P1", "tie00001")
    assert (once.observations.pixel[0] == [100, 50]).all() and len(once.observations) == 1 + first["observations"]
    of = once.observations
    a, b = (of.pixel[of.image == n] for n in (0, 1))
    both = np.intersect1d(of.point[of.image == 0], of.point[of.image == 1])
    a, b = (np.array([of.pixel[(of.image == n) & (of.point == p)][0] for p in both]) for n in (0, 1))
    truth = apply(plane_to_photo(1) @ np.linalg.inv(plane_to_photo(0)), (a + 0.5) / 2 - 0.5)
    assert np.median(np.linalg.norm((b + 0.5) / 2 - 0.5 - truth, axis=1)) < 0.06
    second = asked(capsys, "tiepoints", tmp_path / "site", "--workers", 1, "--per-photo", 60)
    again = read_project(tmp_path / "site")
    assert second["points"] < first["points"] and len(again.points) == 1 + second["points"]
    write_project(replace(block, images=images[:1]), tmp_path / "single")
    assert main(["tiepoints", str(tmp_path / "single")]) == 1
    assert "two and more" in capsys.readouterr().err
