"""georeference on real flights, as a person calls it."""

import json
from pathlib import Path

import pytest

from solvers.cli import main
from solvers.io import read_project
from tests.commands import run


def test_brighton_names_the_reversed_strip_and_turns_it(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A project of eight photos: the second strip is named, turned, written as priors and as footprints."""
    site = tmp_path / "site"
    assert main(["init", str(data / "uav_brighton8"), "-o", str(site), "--quiet"]) == 0
    done = run(capsys, "georeference", site, "--correct-headings", "--write-priors", "--footprints", site / "f.geojson")
    assert done["crs"] == "EPSG:32615" and "take-off point" in done["ground"]
    reversed_ = [h["image"] for h in done["headings"] if "reversed" in h["words"]]
    assert reversed_ == ["DJI_0024", "DJI_0025", "DJI_0026", "DJI_0027"] and len(done["headings"]) == 8
    assert sum("is reversed" in w and w.endswith("corrected") for w in done["warnings"]) == 4
    assert all(-52 < o["kappa_deg"] < -36 for o in done["orientations"])  # now all alike
    assert [f["image"] for f in done["footprints"]] == [o["image"] for o in done["orientations"]]
    assert all(2500 < f["area_m2"] < 2900 for f in done["footprints"])
    shapes = json.loads((site / "f.geojson").read_text())["features"]
    assert len(shapes) == 8 and all(-91.996 < x < -91.992 and 46.842 < y < 46.844
                                    for f in shapes for x, y in f["geometry"]["coordinates"][0])
    assert all(i.prior is not None and i.prior.angles is not None for i in read_project(site).images)
    mono = run(capsys, "monoplot", site, "--image", "DJI_0024", "--at", "2000,1125", "--z", "158.5", "--from", "georeference")
    assert mono["ellipse95"]["semi_major_m"] > 10 and mono["distance_m"] < 41  # navigation GPS is no better


def test_strip_of_five_has_wrong_yaw_alike(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = run(capsys, "georeference", data / "uav_strip5", "--ground-z", "401", "--check-headings")
    assert done["crs"] == "EPSG:32632" and all("is wrong by" in h["words"] for h in done["headings"])
    assert len(done["headings"]) == 5 and all(45 < h["correction_deg"] < 100 for h in done["headings"])
    assert any("--correct-headings" in w for w in done["warnings"])
    assert all(3 < o["sigma"]["X"] < 3.4 for o in done["orientations"])


def test_positions_of_another_tool(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = run(capsys, "georeference", data / "resection_uav_odm_br" / "exif_lalo_4326dms.txt", "--flying-height", "960")
    assert done["crs"] == "EPSG:32722" and all(o["Z"] == pytest.approx(960, abs=1e-6) for o in done["orientations"])
    assert all("no attitude" in o["warnings"][0] for o in done["orientations"])
