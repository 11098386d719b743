"""A stranger's photo and list of control points become a project without a line of TOML."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from solvers import BadProject, BadTable
from solvers.cli import main
from solvers.io import read_exif, read_project
from solvers.workflows import init_project

ODM = """EPSG:32632
684210.5 5334100.25 412.125 100.5 50.25 b.JPG P1
684310.75 5334180.5 418 7 8 b.JPG P2
684210.5 5334100.25 412.125 1 2 z.JPG P1
"""
MUNICH = {1: "N", 2: (48.0, 8.0, 0.0), 3: "E", 4: (11.0, 29.0, 0.0), 5: b"\x00", 6: 530.25}


def photo(path: Path, size: tuple[int, int] = (120, 80), make: str = "DJI\0\0", model: str = "FC6310", focal: float | None = 8.8,
          gps: dict[int, Any] | None = None, **tags: Any) -> Path:
    exif = Image.Exif()
    exif[271], exif[272] = make, model
    inner = exif.get_ifd(0x8769)
    if focal is not None:
        inner[37386] = focal
    for tag, value in tags.items():
        inner[int(tag[1:])] = value
    if gps:
        exif.get_ifd(0x8825).update(gps)
    Image.new("RGB", size, (90, 120, 60)).save(path, exif=exif)
    return path


def test_photo_and_odm_list(tmp_path: Path) -> None:
    b = photo(tmp_path / "B.jpg", gps=MUNICH)
    (tmp_path / "gcp_list.txt").write_text(ODM)
    made = init_project([b, tmp_path / "gcp_list.txt"], tmp_path / "p", pixel_origin="corner")
    block = read_project(tmp_path / "p")
    assert block.crs == "EPSG:32632" and block.points.names == ("P1", "P2") and [i.name for i in block.images] == ["B"]
    np.testing.assert_array_equal(block.observations.pixel, [[100.0, 49.75], [6.5, 7.5]])  # from the corner to the centre
    assert "100.5,50.25" in (tmp_path / "p" / "observations.csv").read_text()  # the folder keeps the numbers as they came
    [camera] = block.cameras.values()
    assert camera.c == 8.8 and camera.width == 120 and camera.pitch[0] == pytest.approx(2.41e-3 * 5472 / 120)
    assert block.images[0].file == str(b.resolve())
    assert any("left out: 1 measurements" in n and "z.JPG" in n for n in made.notes)


def test_gps_priors_are_projected(tmp_path: Path) -> None:
    photo(tmp_path / "b.jpg", gps=MUNICH)
    init_project([tmp_path / "b.jpg"], tmp_path / "p")
    block = read_project(tmp_path / "p")
    prior = block.images[0].prior
    assert block.crs == "EPSG:32632" and prior is not None and prior.centre is not None and prior.sigma_m is not None
    # scale on the meridian 2.4833 degrees east of 9 E at 48.1333 N: the transverse Mercator easting by its series
    assert prior.centre[2] == 530.25 and prior.sigma_m.tolist() == [5, 5, 10]
    from pyproj import Geod

    other = init_project([photo(tmp_path / "c.jpg", gps={**MUNICH, 2: (48.0, 9.0, 0.0)})], tmp_path / "q").block.images[0].prior
    assert other is not None and other.centre is not None
    truth = Geod(ellps="WGS84").inv(11 + 29 / 60, 48 + 8 / 60, 11 + 29 / 60, 48.15)[2]
    k = 0.9996 * (1 + (184.7e3) ** 2 / (2 * 6.383e6**2))  # grid scale there, from the distance to the central meridian
    assert np.hypot(*(other.centre - prior.centre)[:2]) == pytest.approx(truth * k, rel=2e-5)


def test_positions_with_the_accuracy_that_xmp_states(tmp_path: Path) -> None:
    """An RTK photo's prior is as sharp as its XMP says; one without keeps what a navigation receiver has."""
    from tests.io.test_metadata import DJI, RTK
    from tests.io.test_metadata import photo as flown

    flown(tmp_path / "a.jpg", DJI.format(extra=RTK))
    flown(tmp_path / "b.jpg", DJI.format(extra=RTK.replace("RtkStd", "Other").replace("RtkFlag", "Flag")))
    made = init_project([tmp_path / "a.jpg", tmp_path / "b.jpg"], tmp_path / "p", pixel_um=3.0, c_mm=9.0)
    sharp, plain = (i.prior for i in made.block.images)
    assert sharp is not None and plain is not None and sharp.sigma_m is not None and plain.sigma_m is not None
    assert sharp.sigma_m.tolist() == [0.011, 0.012, 0.025] and plain.sigma_m.tolist() == [5, 5, 10]
    assert sharp.centre is not None and sharp.centre[2] == 512.31
    assert any("sigma by the XMP of 1, else 5, 5, 10 m" in n for n in made.notes)


def test_a_list_in_degrees_goes_to_utm(tmp_path: Path) -> None:
    photo(tmp_path / "b.jpg")
    (tmp_path / "g.csv").write_text("name,lat,lon,h\nA,48.1,11.5,500\nB,48.2,11.6,510\n")
    block = init_project([tmp_path / "b.jpg", tmp_path / "g.csv"], tmp_path / "p").block
    assert block.crs == "EPSG:32632" and block.points.xyz[0, 0] == pytest.approx(686_116, abs=50) and block.points.xyz[1,
                                                                                                                       2] == 510


def test_a_list_without_crs_near_the_photos(tmp_path: Path) -> None:
    b = photo(tmp_path / "b.jpg", gps=MUNICH)
    (tmp_path / "g.csv").write_text("name;E;N;H\nA;684210,5;5334100,25;500\nB;684310,5;5334100,25;510\n")
    made = init_project([b, tmp_path / "g.csv"], tmp_path / "p")
    assert made.block.crs == "EPSG:32632" and any("assumed" in n for n in made.notes)
    (tmp_path / "g.csv").write_text("name;E;N;H\nA;210,5;100,25;500\nB;310,5;100,25;510\n")
    with pytest.raises(BadProject, match=r"g\.csv.*--crs"):
        init_project([b, tmp_path / "g.csv"], tmp_path / "q")
    assert not (tmp_path / "q").exists()
    local = init_project([b, tmp_path / "g.csv"], tmp_path / "q", project_crs="local").block
    assert local.crs == "local" and local.images[0].prior is None


def test_a_person_is_asked(tmp_path: Path) -> None:
    b = photo(tmp_path / "b.jpg")
    (tmp_path / "g.csv").write_text("name,image,X,Y,Z,col,row\nA,b.jpg,1,2,3,4,5\n")
    answers, questions = iter(["local", "corner", "yes"]), []

    def ask(question: str) -> str:
        questions.append(question)
        return next(answers)

    block = init_project([b, tmp_path / "g.csv"], tmp_path / "p", ask=ask).block
    assert block.crs == "local" and block.observations.pixel.tolist() == [[3.5, 4.5]]
    assert len(questions) == 3 and "columns: name = name" in questions[2] and "camera fc6310" in questions[2]
    with pytest.raises(BadProject, match="nothing was written"):
        init_project([b, tmp_path / "g.csv"], tmp_path / "q", ask=lambda q: "no" if "right?" in q else "")
    assert not (tmp_path / "q").exists()


def test_photos_of_one_camera_share_it_and_folders_stand_for_their_photos(tmp_path: Path) -> None:
    (tmp_path / "d").mkdir()
    for name in ("a.jpg", "b.jpg"):
        photo(tmp_path / "d" / name)
    photo(tmp_path / "d" / "c.jpg", size=(80, 120))
    block = init_project([tmp_path / "d"], tmp_path / "d").block  # the folder of the photos may become the project
    assert len(block.cameras) == 2 and [i.file for i in block.images] == ["a.jpg", "b.jpg", "c.jpg"]
    with pytest.raises(BadProject, match="already there"):
        init_project([tmp_path / "d"], tmp_path / "d")


def test_names_stay_apart(tmp_path: Path) -> None:
    for d in ("x", "y"):
        (tmp_path / d).mkdir()
        photo(tmp_path / d / "a.jpg")
    block = init_project([tmp_path / "x", tmp_path / "y"], tmp_path / "p").block
    assert [i.name for i in block.images] == ["x_a.jpg", "y_a.jpg"]


@pytest.mark.parametrize(("tags", "pitch", "source"), [
    ({"model": "FC6310"}, 2.41e-3 * 5472 / 120, "sensor table"),
    ({"model": "new", "_41486": 500.0, "_41488": 4}, 1 / 500, "focal plane"),
    ({"model": "new", "_41486": 12700.0, "_41488": 2}, 25.4 / 12700, "focal plane"),
    ({"model": "new", "_41486": 500.0, "_41488": 4, "_40962": 480}, 1 / 500 * 4, "focal plane"),  # made smaller afterwards
    ({"model": "new", "_41989": 35}, 43.267 * 8.8 / 35 / np.hypot(120, 80), "35-mm"),
    ({"model": "new"}, None, ""),
])
def test_pixel_size_from_exif(tmp_path: Path, tags: dict[str, Any], pitch: float | None, source: str) -> None:
    exif = read_exif(photo(tmp_path / "b.jpg", **tags))
    assert source in exif.pitch_source and exif.make == "DJI"
    assert exif.pitch_mm is None if pitch is None else exif.pitch_mm == pytest.approx(pitch, rel=1e-4)


def test_southern_western_and_negative_heights(tmp_path: Path) -> None:
    exif = read_exif(photo(tmp_path / "b.jpg", gps={**MUNICH, 1: "S", 3: "W", 5: b"\x01", 6: 12.5}))
    assert exif.lat == pytest.approx(-48.13333333) and exif.lon == pytest.approx(-11.48333333) and exif.alt == -12.5


@pytest.mark.parametrize(("change", "says"), [
    ({"model": "new"}, "--pixel-um"), ({"focal": None}, "--c-mm"),
])
def test_unknown_cameras_name_the_cure(tmp_path: Path, change: dict[str, Any], says: str) -> None:
    b = photo(tmp_path / "b.jpg", **change)
    with pytest.raises(BadProject, match=rf"b\.jpg.*{says}"):
        init_project([b], tmp_path / "p")
    assert init_project([b], tmp_path / "p", pixel_um=2.5, c_mm=9.0).block.cameras


@pytest.mark.parametrize(("text", "says"), [
    ("EPSG:32632\n1 2 3 500 5 b.jpg P1\n", r"line 2: point 'P1' at col 500, row 5 lies outside photo 'b.jpg' of 120 x 80"),
    ("EPSG:32632\n1 2 3 4 5 y.jpg P1\n", r"none of its measurements is in the photos given"),
    ("EPSG:2225\n1 2 3 4 5 b.jpg P1\n", r"not in metres"),
    ("EPSG:99999\n1 2 3 4 5 b.jpg P1\n", r"not known"),
])
def test_lists_that_do_not_fit(tmp_path: Path, text: str, says: str) -> None:
    b = photo(tmp_path / "b.jpg")
    (tmp_path / "gcp_list.txt").write_text(text)
    with pytest.raises((BadTable, BadProject), match=says):
        init_project([b, tmp_path / "gcp_list.txt"], tmp_path / "p")
    assert not (tmp_path / "p").exists()


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    b = photo(tmp_path / "b.jpg")
    (tmp_path / "gcp_list.txt").write_text(ODM)
    assert main(["init", str(b), str(tmp_path / "gcp_list.txt"), "-o", str(tmp_path / "p"), "--json", "-"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made["points"] == 2 and made["observations"] == 2 and any("pixel origin: center" in n for n in made["notes"])
    assert main(["init", str(tmp_path / "none.jpg"), "-o", str(tmp_path / "q")]) == 1
    assert "none.jpg: there is no such file" in capsys.readouterr().err
    (tmp_path / "fake.jpg").write_text("no photo")
    assert main(["init", str(tmp_path / "fake.jpg"), "-o", str(tmp_path / "q")]) == 1
    assert "not a photo" in capsys.readouterr().err and not (tmp_path / "q").exists()
