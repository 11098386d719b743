"""georeference, intersect and monoplot on the command line, and the page of commands."""

from __future__ import annotations

import csv
import json
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Exterior, Image, Interior, Observations, Points, Prior
from solvers.cameras import project
from solvers.cli import main, parser
from solvers.geometry import LocalFrame, yaw_pitch_roll
from solvers.io import read_project, read_truth, write_priors, write_project
from tests.commands import demo_without_photos, refused, run

CAMERA = Interior(35.0, pixel_mm=0.006, width=4000, height=3000)
CENTRE = np.array([652300.0, 5401200.0, 320.0])
CRS = "EPSG:32632"


@pytest.fixture
def demo(tmp_path: Path) -> Path:
    return demo_without_photos(tmp_path)


# -- intersect --------------------------------------------------------------------------------------------------------------


def test_intersect_agrees_with_the_truth_within_its_errors(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = read_truth(demo)
    assert truth is not None
    done = run(capsys, "intersect", demo)
    assert len(done["images"]) == 5 and "5 images resected now" in done["notes"][0]
    gaps = [np.array([p[k] for k in "XYZ"]) - truth["points"][p["name"]] for p in done["points"]]
    test = np.array([g @ np.linalg.solve(p["covariance"], g) for g, p in zip(gaps, done["points"], strict=True)])
    assert len(test) == 39 and test.max() < 30 and 0.5 < test.mean() / 3 < 2
    assert json.loads((Path(done["run"]) / "result.json").read_text()) == done and (Path(done["run"]) / "trace.npz").exists()


def test_intersect_takes_the_latest_run_while_it_is_not_older_than_the_project(demo: Path,
                                                                              capsys: pytest.CaptureFixture[str]) -> None:
    names = ["DSC00229", "DSC00230", "DSC00231"]
    assert main(["resect", str(demo), "--model", "perspective", "--quiet", "--image", *names]) == 0
    done = run(capsys, "intersect", demo, "--points", "C01,C02")
    assert [p["name"] for p in done["points"]] == ["C01", "C02"] and len(done["images"]) == 5
    assert "DSC00229, DSC00230, DSC00231 of the run" in done["notes"][0] and "resected now" in done["notes"][1]
    [result] = (demo / "runs").glob("*-resect*/result.json")
    os.utime(result, (1, 1))
    stale = run(capsys, "intersect", demo, "--points", "C01,C02")
    assert "older than the project's files" in stale["notes"][0]
    np.testing.assert_allclose([[p[k] for k in "XYZ"] for p in stale["points"]],
                               [[p[k] for k in "XYZ"] for p in done["points"]], atol=1e-4, rtol=0)


def test_a_freed_principal_distance_is_used(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resect", str(demo), "--model", "perspective", "--free", "c", "--quiet"]) == 0
    truth = read_truth(demo)
    assert truth is not None
    for p in run(capsys, "intersect", demo)["points"]:
        assert np.linalg.norm(np.array([p[k] for k in "XYZ"]) - truth["points"][p["name"]]) < 0.2


def test_intersect_robust_names_the_refuted_ray_and_says_what_it_leaves_out(demo: Path,
                                                                            capsys: pytest.CaptureFixture[str]) -> None:
    block = read_project(demo)
    rows = np.flatnonzero(block.observations.point == block.point_index("C01"))
    pixel = block.observations.pixel.copy()
    pixel[rows[0]] += 40
    once = [r for r in range(len(pixel)) if block.observations.point[r] != block.point_index("C02") or
            block.observations.image[r] == 0]
    of = block.observations
    write_project(replace(block, observations=Observations(of.image[once], of.point[once], pixel[once], of.sigma[once])), demo)
    bad = block.images[of.image[rows[0]]].name
    assert main(["intersect", str(demo), "--robust", "--points", "C01,C02", "--json", str(demo / "r.json")]) == 1
    out, err = capsys.readouterr()
    [point] = json.loads((demo / "r.json").read_text())["points"]
    assert point["rejected"] == [bad] and f"rejected: the rays of {bad}" in out
    assert err.startswith("collinea: point 'C02': ") and "one ray" in err and "left out: point 'C02'" in out


def test_the_table_of_points(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["intersect", str(demo), "--points", "C01"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:8] == ["point", "role", "X", "[m]", "Y", "[m]", "Z", "[m]"]
    row = next(line for line in lines if line.strip().startswith("C01")).split()
    assert row[1] == "check" and len(row) == 13 and any("rms at 1 check points" in line for line in lines)


# -- monoplot ---------------------------------------------------------------------------------------------------------------


def test_monoplot_finds_a_known_point_on_the_dem_and_on_a_plane(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block, truth = read_project(demo), read_truth(demo)
    assert truth is not None
    row = np.flatnonzero((block.observations.point == block.point_index("G25")) & (block.observations.image == 0))[0]
    at = ",".join(str(v) for v in block.observations.pixel[row])
    true = np.array(truth["points"]["G25"])
    on_dem = run(capsys, "monoplot", demo, "--image", "DSC00229", "--at", at)
    assert on_dem["surface"] == "dem.tif" and np.abs(np.array([on_dem[k] for k in "XYZ"]) - true).max() < 0.6
    assert any("--sigma-z" in n for n in on_dem["notes"])
    on_plane = run(capsys, "monoplot", demo, "--image", "DSC00229", "--at", at, "--z", true[2], "--sigma-z", 0.05)
    gap = np.array([on_plane[k] for k in "XYZ"]) - true
    assert np.abs(gap).max() < 0.05 and abs(on_plane["sigma"]["Z"] - 0.05) < 1e-3
    assert on_plane["ellipse95"]["semi_major_m"] < 0.1 and not any("--sigma-z" in n for n in on_plane["notes"])
    assert main(["monoplot", str(demo), "--image", "DSC00229", "--at", at]) == 0
    assert "95 % error ellipse" in capsys.readouterr().out


def test_refusals_of_monoplot_and_intersect(demo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mono = ("monoplot", demo, "--image", "DSC00229", "--at")
    assert "outside its 6000 x 4000" in refused(capsys, *mono, "7000,1")
    assert "below the plane" in refused(capsys, *mono, "10,10", "--z", 900)
    assert "no such height grid" in refused(capsys, *mono, "10,10", "--dem", demo / "no.tif")
    assert "COL,ROW" in refused(capsys, *mono, "10", code=2)
    assert "not allowed" in refused(capsys, *mono, "1,1", "--z", 1, "--dem", "x", code=2)
    assert "there is no georeference run" in refused(capsys, *mono, "1,1", "--from", "georeference")
    assert "there is no image 'X'" in refused(capsys, "monoplot", demo, "--image", "X", "--at", "1,1")
    assert "there is no point 'X'" in refused(capsys, "intersect", demo, "--points", "X")
    text = (demo / "project.toml").read_text()
    (demo / "project.toml").write_text(re.sub(r"\[surface\]\n.*\n", "", text))
    assert "give --dem DEM.tif or --z H" in refused(capsys, *mono, "10,10")
    assert not (demo / "runs").exists()


# -- georeference -------------------------------------------------------------------------------------------------------------


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    """A project of six images in a straight line, with control, and the table of what their aircraft recorded, exact."""
    frame = LocalFrame.around(CENTRE[None], CRS)
    ground = CENTRE + np.array([[x, y, -300 + 7 * np.sin(x + y)] for x in (-60, 0, 60, 120, 170) for y in (-45, 0, 45)])
    frame = LocalFrame.around(ground, CRS)
    rng, image, point, pixel, rows = np.random.default_rng(7), [], [], [], []
    for k in range(6):
        omega, phi = (float(a) for a in rng.normal(0, 0.03, 2))
        at = Exterior.from_angles(omega, phi, 0.4, np.array([25.0 * k - 60, 3.0 * k, 300.0]))
        ned = frame.north_east_down(at.centre)
        lon, lat, height = frame.to_degrees(at.centre)
        yaw, pitch, roll = np.degrees(yaw_pitch_roll(at.m, "nadir", ned))
        rows.append([f"p{k}.jpg", repr(float(lat)), repr(float(lon)), repr(float(height)), yaw, pitch, roll, 0.05, 0.08])
        seen = project(CAMERA, at, frame.to_local(ground))
        for j in np.flatnonzero(CAMERA.inside(seen)):
            image.append(k)
            point.append(j)
            pixel.append(seen[j])
    with (tmp_path / "positions.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows([["image", "lat", "lon", "height", "yaw", "pitch", "roll", "hacc", "vacc"], *rows])
    n = len(ground)
    write_project(Block("flight", CRS, {"cam": CAMERA}, tuple(Image(f"p{k}", "cam") for k in range(6)),
                        Points(tuple(f"G{j}" for j in range(n)), ground, np.full((n, 3), np.nan), ("control",) * n),
                        Observations(np.array(image), np.array(point), np.array(pixel), np.full(len(image), np.nan))),
                  tmp_path / "flight")
    return tmp_path / "flight"


def test_georeference_by_a_table_agrees_with_the_resection(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = flight.parent / "positions.csv"
    onboard = run(capsys, "georeference", flight, "--positions", table, "--footprints", flight / "f.geojson", "--ground-z", 20,
                  "--sigma-deg", 0.05, 0.05, 0.05)
    solved = run(capsys, "resect", flight, "--model", "perspective")["orientations"]
    for a, b in zip(onboard["orientations"], solved, strict=True):
        assert a["image"] == b["image"] and a["model"] == "georeferenced" and a["sigma0"] is None
        np.testing.assert_allclose([a[k] for k in "XYZ"], [b[k] for k in "XYZ"], atol=2e-3)
        np.testing.assert_allclose([a[f"{k}_deg"] for k in ("omega", "phi", "kappa")],
                                   [b[f"{k}_deg"] for k in ("omega", "phi", "kappa")], atol=1e-3)
        np.testing.assert_allclose([a["sigma"][k] for k in "XYZ"], [0.05, 0.05, 0.08], rtol=1e-3)
    shapes = json.loads((flight / "f.geojson").read_text())
    assert [f["properties"]["image"] for f in shapes["features"]] == [f"p{k}" for k in range(6)]
    lon, lat = np.array(shapes["features"][0]["geometry"]["coordinates"][0]).T
    assert 11.06 < lon.mean() < 11.09 and 48.74 < lat.mean() < 48.76
    for f in onboard["footprints"]:  # 300 m above ground, nearly vertical
        assert abs(f["area_m2"] / (4000 * 3000 * (300 * 0.006 / 35) ** 2) - 1) < 0.1
    assert json.loads((Path(onboard["run"]) / "result.json").read_text()) == onboard
    # intersection from onboard data alone finds the control again
    points = run(capsys, "intersect", flight, "--from", "georeference")["points"]
    assert len(points) > 8 and max(np.hypot(p["dX"], p["dY"]) for p in points) < 0.02
    mono = run(capsys, "monoplot", flight, "--from", "georeference", "--image", "p2", "--at", "1999.5,1499.5", "--z", "20")
    assert "georeference" in mono["notes"][0] and abs(mono["X"] - onboard["orientations"][2]["X"]) < 50


def test_a_height_bias_is_found_by_control(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = flight.parent / "positions.csv"
    rows = list(csv.DictReader(table.open()))
    with table.open("w", newline="") as stream:
        out = csv.DictWriter(stream, list(rows[0]))
        out.writeheader()
        out.writerows({**r, "height": float(r["height"]) - 31.5} for r in rows)
    done = run(capsys, "georeference", flight, "--positions", table, "--height-bias", "control", "--sigma-deg", 0.02, 0.02, 0.02)
    said = next(n for n in done["notes"] if n.startswith("height bias: "))
    assert abs(float(said.split()[2]) - 31.5) < 0.3
    plain = run(capsys, "georeference", flight, "--positions", table, "--image", "p1", "--height-bias", 31.5)
    assert abs(plain["orientations"][0]["Z"] - done["orientations"][1]["Z"]) < 0.3


def test_a_log_matched_by_time(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = list(csv.DictReader((flight.parent / "positions.csv").open()))
    at = np.array([[float(r[k]) for k in ("lat", "lon", "height", "yaw", "pitch", "roll")] for r in rows])
    log = flight.parent / "log.csv"
    with log.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time", "lat", "lon", "height", "yaw", "pitch", "roll"])
        writer.writerows([100 + 3 * k, *at[k]] for k in range(6))
    with (flight.parent / "times.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["image", "lat", "lon", "time"])
        writer.writerows([rows[k]["image"], *at[k, :2], 3 * k] for k in range(6))
    done = run(capsys, "georeference", flight, "--positions", flight.parent / "times.csv", "--log", log, "--log-offset", 100)
    exact = run(capsys, "georeference", flight, "--positions", flight.parent / "positions.csv")
    for a, b in zip(done["orientations"], exact["orientations"], strict=True):
        np.testing.assert_allclose([a[k] for k in ("X", "Y", "Z", "kappa_deg")], [b[k] for k in ("X", "Y", "Z", "kappa_deg")],
                                   atol=1e-4)
    assert "+100.00 s" in done["notes"][0] and "entered" in done["notes"][0]


def test_a_table_alone_and_its_crs(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = flight.parent / "positions.csv"
    done = run(capsys, "georeference", table)
    assert done["crs"] == CRS and done["run"] is None and len(done["orientations"]) == 6
    other = run(capsys, "georeference", table, "--crs", "EPSG:25832", "--lever-arm", 0, 0, -0.5)
    assert other["crs"] == "EPSG:25832" and abs(other["orientations"][0]["Z"] - done["orientations"][0]["Z"] - 0.5) < 0.01
    assert main(["georeference", str(table)]) == 0
    out = capsys.readouterr().out
    assert "sigma (median)" in out and f"crs: {CRS}, the UTM zone" in out and "heights: as recorded (unknown)" in out


def test_priors_are_written_and_the_rest_of_the_file_stays(flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    toml = flight / "project.toml"
    toml.write_text("# flown in spring\n" + toml.read_text() + "\n# the end\n")
    done = run(capsys, "georeference", flight, "--positions", flight.parent / "positions.csv", "--write-priors")
    block, text = read_project(flight), toml.read_text()
    assert text.startswith("# flown in spring\n") and "# the end" in text
    for image, o in zip(block.images, done["orientations"], strict=True):
        assert image.prior is not None and image.prior.centre is not None and image.prior.angles is not None
        np.testing.assert_allclose(image.prior.centre, [o[k] for k in "XYZ"], atol=1e-4)
        np.testing.assert_allclose(np.degrees(image.prior.angles), [o[f"{k}_deg"] for k in ("omega", "phi", "kappa")], atol=1e-6)
        assert image.prior.sigma_m is not None and abs(image.prior.sigma_m[2] - 0.08) < 1e-4
    again = run(capsys, "georeference", flight, "--positions", flight.parent / "positions.csv", "--write-priors")
    assert any("6 in place of older ones" in n for n in again["notes"]) and toml.read_text() == text
    assert main(["resect", str(flight), "--prior", "weighted", "--quiet"]) == 0


def test_priors_of_a_file_written_inline(tmp_path: Path) -> None:
    write_project(Block("b", "local", {"cam": CAMERA}, (Image("a b", "cam"), Image("c", "cam")),
                        Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
                        Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))), tmp_path)
    toml = tmp_path / "project.toml"
    text = toml.read_text()
    toml.write_text(text[:text.index("[images.")] + '[images]\n"a b" = {camera = "cam", prior = {X = 1.0, Y = 2.0, Z = 3.0}}\n'
                    'c = {camera = "cam"}\n')
    assert write_priors(tmp_path, {"a b": Prior(np.array([4.0, 5.0, 6.0]))}) == 1
    first, second = read_project(tmp_path).images
    assert first.prior is not None and first.prior.centre is not None and second.prior is None
    np.testing.assert_array_equal(first.prior.centre, [4, 5, 6])


def test_refusals_of_georeference(demo: Path, flight: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = flight.parent / "positions.csv"
    assert "crs \"local\"" in refused(capsys, "georeference", demo)
    assert "no GPS position" in refused(capsys, "georeference", flight)
    assert "leave --crs out" in refused(capsys, "georeference", flight, "--crs", "EPSG:25832", "--positions", table)
    assert "UTM zone" in refused(capsys, "georeference", table, "--crs", "EPSG:4326")
    assert "collinea init" in refused(capsys, "georeference", table, "--write-priors")
    assert "need the photos" in refused(capsys, "georeference", table, "--check-headings")
    assert "no such folder" in refused(capsys, "georeference", flight, "--positions", table, "--footprints", flight / "no" / "f")
    assert "control" in refused(capsys, "georeference", flight, "--height-bias", "much", code=2)
    low = flight.parent / "low.csv"
    low.write_text("image,lat,lon\np0,48.7,11.0\n")
    assert "--flying-height" in refused(capsys, "georeference", low)
    assert "above the take-off point" in refused(capsys, "georeference", low, "--take-off", 12)
    assert not (flight / "runs").exists() or not list((flight / "runs").iterdir())


# -- the page of commands -----------------------------------------------------------------------------------------------------


def test_every_command_is_on_the_page() -> None:
    page = (Path(__file__).parent.parent / "docs" / "commands.md").read_text(encoding="utf-8")
    [commands] = [a.choices for a in parser()._actions if isinstance(a.choices, dict)]
    for name in commands:
        assert f"\n## {name}\n" in page and f"\n    $ collinea {name}" in page, f"docs/commands.md lacks {name}"
    listed = re.findall(r"^## (\w+)$", page, flags=re.M)
    assert set(listed) == set(commands), "docs/commands.md names a command that there is not"
