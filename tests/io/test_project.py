"""Project folders: written and read back unchanged, by hand-written files and by blocks."""

from pathlib import Path

import numpy as np
import pytest

from solvers import BadProject, Block, Image, Interior, Observations, Points, Prior
from solvers.io import read_project, read_truth, write_observations, write_project
from solvers.simulation import uav_block

TOML = """
[project]
name = "Strasbourg"
crs = "EPSG:32632"
pixel_origin = "center"
[weights]
image_px = 0.5
control_m = [0.02, 0.02, 0.04]
[surface]
z = 120.0
[cameras.rc30]
width = 8858
height = 12996
pixel_mm = 0.006
c_mm = 123.9392
principal_point_px = [4429.0, 6468.0]
k1 = 1e-8
[images.8811]
file = "images/8811.jpg"
camera = "rc30"
[images.8811.prior]
X = 999660.0
Y = 112368.0
Z = 1916.0
omega_deg = 0.0
phi_deg = 0.0
kappa_deg = -90.0
sigma_m = [1.0, 1.0, 1.0]
sigma_deg = [1.0, 1.0, 1.0]
"""
POINTS = """name,X,Y,Z,sX,sY,sZ,role,group
317,999604.58,112344.443,139.453,0.02,0.02,0.04,control,a
375,999619.041,112370.818,138.97,,,,check,
9,,,,,,,tie,
"""
OBSERVATIONS = "image,point,col,row,sigma\n8811,317,5007.6667,7275.6667,0.3\n8811,9,0,0,\n"


def folder(at: Path, toml: str = TOML, points: str = POINTS, observations: str = OBSERVATIONS) -> Path:
    for name, text in (("project.toml", toml), ("points.csv", points), ("observations.csv", observations)):
        (at / name).write_text(text, encoding="utf-8")
    return at


def same(a: Block, b: Block) -> None:
    assert (a.name, a.crs, a.frame, dict(a.cameras), a.image_px, a.control_m, dict(a.surface)) == (
        b.name, b.crs, b.frame, dict(b.cameras), b.image_px, b.control_m, dict(b.surface))
    assert a.points.names == b.points.names and a.points.role == b.points.role and a.points.group == b.points.group
    for x, y in ((a.points.xyz, b.points.xyz), (a.points.sigma, b.points.sigma), (a.observations.image, b.observations.image),
                 (a.observations.point, b.observations.point), (a.observations.sigma, b.observations.sigma)):
        np.testing.assert_array_equal(x, y)
    np.testing.assert_allclose(a.observations.pixel, b.observations.pixel, atol=1e-12, rtol=0)
    for i, j in zip(a.images, b.images, strict=True):
        assert (i.name, i.camera, i.file) == (j.name, j.camera, j.file)
        for k in ("centre", "angles", "sigma_m", "sigma_rad"):
            p, q = getattr(i.prior, k, None), getattr(j.prior, k, None)
            assert (p is None) == (q is None)
            if p is not None and q is not None:
                np.testing.assert_allclose(p, q, atol=1e-15, rtol=1e-15)


def test_reads_the_documented_example(tmp_path: Path) -> None:
    block = read_project(folder(tmp_path))
    camera = block.cameras["rc30"]
    assert (camera.xp, camera.yp) == pytest.approx((0.003, 0.177), abs=1e-12)  # the same point in the other form
    assert camera.k1 == 1e-8 and block.crs == "EPSG:32632" and block.surface == {"z": 120.0}
    prior = block.images[0].prior
    assert prior is not None and prior.angles is not None and prior.angles[2] == pytest.approx(-np.pi / 2)
    assert block.points.group == ("a", "", "") and block.points.role == ("control", "check", "tie")
    assert np.isnan(block.points.xyz[2]).all() and np.isnan(block.observations.sigma[1])
    assert block.observations.pixel[0] == pytest.approx([5007.6667, 7275.6667])


def test_corner_origin_moves_observations_and_principal_point_together(tmp_path: Path) -> None:
    centre = read_project(folder(tmp_path))
    toml = TOML.replace('"center"', '"corner"').replace("[4429.0, 6468.0]", "[4429.5, 6468.5]")
    corner = read_project(folder(tmp_path, toml,
                                 observations="image,point,col,row,sigma\n8811,317,5008.1667,7276.1667,0.3\n8811,9,.5,.5,\n"))
    same(centre, corner)


@pytest.mark.parametrize("origin", ["center", "corner"])
def test_round_trip(tmp_path: Path, origin: str) -> None:
    rng = np.random.default_rng(7)
    camera = Interior(35.123456789, 0.01, -0.02, 1e-5, p1=-2e-6, b2=1e-4, pixel_mm=(0.0039, 0.004), width=6000, height=4000)
    plain = Interior(152.222, pixel_mm=0.01, width=23000, height=23000)
    prior = Prior(rng.normal(size=3) * 1e6, rng.normal(size=3), np.array([1.0, 2, 3]), np.array([0.01, 0.02, 0.03]))
    names = tuple(["a,b", 'quote"d', "Höhe 3", *(f"p{i}" for i in range(9))])
    sigma = rng.uniform(0.01, 0.1, (12, 3))
    sigma[4] = np.nan
    block = Block(
        "Ω site", "EPSG:32632", {"cam 1": camera, "b": plain},
        (Image("DSC 1", "cam 1", "images/DSC 1.jpg", prior), Image("2", "b"),
         Image("x.y", "b", None, Prior(centre=np.array([1.0, 2, 3])))),
        Points(names, rng.normal(size=(12, 3)) * 1e6, sigma, ("control",) * 6 + ("check",) * 6, tuple("g" * 12)),
        Observations(np.array([0, 0, 1, 2]), np.array([0, 1, 0, 11]), rng.uniform(0, 3999, (4, 2)),
                     np.array([0.1, np.nan, 0.5, 1 / 3])),
        image_px=0.3, control_m=(0.0, 0.01, 0.02), frame="grid", surface={"file": "dem.tif"})
    truth = {"images": {"2": {"X": 1.5, "omega_deg": 0.25}}, "cameras": {}, "points": {"a,b": [1.0, 2.0, 3.0]}}
    write_project(block, tmp_path / "p", truth=truth, pixel_origin=origin)
    same(block, read_project(tmp_path / "p"))
    assert read_truth(tmp_path / "p") == truth
    assert not [f for f in (tmp_path / "p").iterdir() if f.name.startswith(".")]  # no temporary file stays
    write_observations(block, tmp_path / "p")
    same(block, read_project(tmp_path / "p"))


def test_no_truth_is_none(tmp_path: Path) -> None:
    assert read_truth(tmp_path) is None


@pytest.mark.parametrize(("find", "put", "says"), [
    ("c_mm = 123.9392", "c_mm = -1", "[cameras.rc30] c_mm"),
    ("c_mm = 123.9392", "c_m = 123.9392", "write c_mm"),
    ("c_mm = 123.9392", "c_mm = nan", "c_mm"),
    ("c_mm = 123.9392", 'c_mm = "long"', "c_mm"),
    ("pixel_mm = 0.006", "pixel_mm = [0.006]", "2 numbers"),
    ("width = 8858", "width = 88.58", "[cameras.rc30] width"),
    ("k1 = 1e-8", "xp_mm = 0.003", "given twice"),
    ("principal_point_px = [4429.0, 6468.0]", "", "principal point is missing"),
    ("principal_point_px = [4429.0, 6468.0]", "xp_mm = 0.0", "yp_mm"),
    ('camera = "rc30"', 'camera = "rc31"', "there is no camera 'rc31'; the cameras are rc30"),
    ('"center"', '"middle"', "[project] pixel_origin"),
    ('crs = "EPSG:32632"', "", "[project] crs"),
    ("image_px = 0.5", "image_px = -0.5", "[weights] image_px"),
    ("[0.02, 0.02, 0.04]", "[0.02, -0.02, 0.04]", "[weights] control_m"),
    ("Z = 1916.0", "", "[images.8811.prior] Z"),
    ("sigma_deg = [1.0, 1.0, 1.0]", "sigma_deg = [1.0, 0, 1.0]", "sigma_deg"),
    ("[project]", "[project", "not TOML"),
    ("z = 120.0", 'z = 120.0\nfile = "dem.tif"', "[surface] z"),
])
def test_project_toml_names_table_key_and_cure(tmp_path: Path, find: str, put: str, says: str) -> None:
    assert find in TOML
    with pytest.raises(BadProject) as error:
        read_project(folder(tmp_path, TOML.replace(find, put)))
    assert says in str(error.value) and "project.toml" in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("origin", ["center", "corner"])
def test_a_plain_table_is_read_at_once_and_gives_what_its_rows_give(tmp_path: Path, origin: str, monkeypatch) -> None:
    from solvers.io import project

    write_project(uav_block(1, strips=2, images=2, ties=20, fine=False).block, tmp_path, pixel_origin=origin)
    for name in ("points", "observations"):
        path = tmp_path / f"{name}.csv"
        path.write_text(path.read_text().replace("\n", "\r\n"), newline="")
        assert project.read_columns(path, ()) is not None
    quick = read_project(tmp_path)
    monkeypatch.setattr(project, "read_columns", lambda *_: None)
    slow = read_project(tmp_path)
    assert quick.points.names == slow.points.names and quick.points.role == slow.points.role
    for part in ("points", "observations"):
        for field in ("xyz", "sigma") if part == "points" else ("image", "point", "pixel", "sigma"):
            np.testing.assert_array_equal(getattr(getattr(quick, part), field), getattr(getattr(slow, part), field))


@pytest.mark.parametrize("cell", ["nan", "1_0", "inf", "1e999", "x", "", "-7000", '"12"'])
def test_whatever_is_odd_in_a_table_is_left_to_its_rows(tmp_path: Path, cell: str) -> None:
    from solvers.io import project

    block = uav_block(1, strips=2, images=2, ties=20, fine=False).block
    write_project(block, tmp_path)
    path = tmp_path / "observations.csv"
    lines = path.read_text().splitlines()
    lines[5] = ",".join([*lines[5].split(",")[:2], cell, *lines[5].split(",")[3:]])
    path.write_text("\n".join(lines) + "\n")
    assert project._plain_observations(path, block, "center") is None
