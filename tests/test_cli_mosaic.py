"""The commands mosaic and rectify on the demo project: what they write, say and refuse."""

import json
import shutil
from pathlib import Path

import pytest

from solvers.cli import main

DEMO = Path(__file__).parent.parent / "assets" / "demo"


@pytest.fixture
def demo(tmp_path):
    shutil.copytree(DEMO, tmp_path / "demo", ignore=shutil.ignore_patterns("runs"))
    return tmp_path / "demo"


def run(*words):
    return main([*map(str, words), "--quiet"])


def test_rectify_shows_tilt_and_isocentre(demo, tmp_path):
    assert run("rectify", demo, "--image", "DSC00229", "-o", tmp_path / "r.tif", "--json", tmp_path / "r.json") == 0
    done = json.loads((tmp_path / "r.json").read_text())
    assert done["tilt_deg"] == pytest.approx(4.7, abs=0.05) and (tmp_path / "r.tif").exists()
    assert done["isocentre_gsd_m"] == pytest.approx(done["height_m"] / 35 * 23.5 / 6000, rel=1e-3)


def test_what_cannot_be_is_said_in_one_sentence(demo, tmp_path, capsys):
    (tmp_path / "one").mkdir()
    shutil.copy(next((demo / "images").iterdir()), tmp_path / "one")
    for words, said in ((("mosaic", tmp_path / "one"), "two and more"),
                        (("mosaic", tmp_path / "none"), "no such"),
                        (("mosaic", demo, "--crs", "EPSG:32632"), "own crs"),
                        (("rectify", demo, "--image", "X"), "no image 'X'")):
        assert run(*words, "-o", tmp_path / "x.tif") == 1
        error = capsys.readouterr().err
        assert said in error and len(error.strip().splitlines()) == 1
    assert not (tmp_path / "x.tif").exists()
