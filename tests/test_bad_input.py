"""Bad input: one sentence on standard error naming file, line, item and cure; exit code 1; no traceback; nothing half-written."""

import re
from pathlib import Path

import numpy as np
import pytest

from solvers import Block, Image, Observations, Prior
from solvers.cli import main
from solvers.io import files, write_project
from tests.commands import refused
from tests.projects import good_block


@pytest.fixture
def site(tmp_path: Path) -> Path:
    write_project(good_block(), tmp_path / "site")
    return tmp_path / "site"


def edit(path: Path, pattern: str, put: str, count: int = 1) -> None:
    text = path.read_text(encoding="utf-8")
    changed = re.sub(pattern, put, text, count=count, flags=re.MULTILINE)
    assert changed != text
    path.write_text(changed, encoding="utf-8")


def test_the_good_project_is_good(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["resect", str(site)]) == 0
    assert "image a" in capsys.readouterr().out


TABLES = [
    # file, what is changed, into what, what the sentence must say
    ("points.csv", r"^name,X,Y,Z", "name,X,Y,H", ["points.csv line 1", "'Z' is missing"]),
    ("points.csv", r"^name,", "Name,", ["points.csv line 1", "'name' is missing", "rename column 'Name'"]),
    ("observations.csv", r",row,", ",zeile,", ["observations.csv line 1", "'row' is missing"]),
    ("points.csv", r"^P2,70.0", "P2,seventy", ["points.csv line 3", "X is 'seventy'", "metres"]),
    ("points.csv", r"^P2,70.0", "P2,nan", ["points.csv line 3", "X is 'nan'"]),
    ("points.csv", r"^P2,70.0", "P2,1e999", ["points.csv line 3", "X is 1e999"]),
    ("points.csv", r"^P2,70.0", 'P2,"70,0"', ["points.csv line 3", "X is '70,0'", "decimal points"]),
    ("points.csv", r"^P2,70.0", "P2,70,0", ["points.csv line 3", "9 cells", "8 columns"]),
    ("points.csv", r"^P2,70.0", "P2,", ["points.csv line 3", "'P2' has no X", "role tie"]),
    ("points.csv", r"^P3,", "P2,", ["points.csv line 4", "'P2' is already in line 3"]),
    ("points.csv", r"^P2,", ",", ["points.csv line 3", "name is empty"]),
    ("points.csv", r"0,,,,control$", "0,-0.02,,,control", ["points.csv line 2", "sX is -0.02", "at least 0"]),
    ("points.csv", r"control$", "Kontrolle", ["points.csv line 2", "'Kontrolle'", "control, check or tie"]),
    ("observations.csv", r"^a,P2,\d+", "a,P2,x", ["observations.csv line 3", "col is 'x", "pixels"]),
    ("observations.csv", r"^a,P2,[\d.]+,", "a,P2,NaN,", ["observations.csv line 3", "col is 'NaN'"]),
    ("observations.csv", r"^a,P2,[\d.]+,", "a,P2,,", ["observations.csv line 3", "col is empty"]),
    ("observations.csv", r"^a,P3,", "a,P2,", ["observations.csv line 4", "'P2' in image 'a' is already in line 3"]),
    ("observations.csv", r"^a,P2,", "a,P99,", ["observations.csv line 3", "no point 'P99'", "points.csv"]),
    ("observations.csv", r"^a,P2,", "b,P2,", ["observations.csv line 3", "no image 'b'", "project.toml"]),
    ("observations.csv", r"^a,P2,[\d.]+,", "a,P2,6000.0,",
     ["observations.csv line 3", "'P2'", "outside image 'a' of 6000 x 4000"]),
    ("observations.csv", r"^a,P2,[\d.]+,", "a,P2,-0.6,", ["observations.csv line 3", "outside"]),
    ("observations.csv", r",$", ",-0.5", ["observations.csv line 2", "sigma is -0.5", "more than 0"]),
    ("observations.csv", r",$", ",0", ["observations.csv line 2", "sigma is 0"]),
    ("observations.csv", r'^a,P2,', 'a,"P2,', ["observations.csv line", "quotes"]),
    ("project.toml", r'camera = "cam"', 'camera = "kam"', ["project.toml [images.a] camera", "no camera 'kam'", "cam"]),
    ("project.toml", r"\[project\]", "[project", ["project.toml", "not TOML", "line 1"]),
    ("project.toml", r"c_mm = 35.0", "c_mm = -35.0", ["project.toml [cameras.cam] c_mm", "positive"]),
    ("project.toml", r"image_px = 0.5", "image_px = 0", ["project.toml [weights] image_px"]),
    ("project.toml", r'crs = "local"', 'crs = "EPSG:99999"', ["EPSG:99999", "not known", "local"]),
    ("project.toml", r'crs = "local"', 'crs = "EPSG:4326"', ["EPSG:4326", "UTM"]),
    ("project.toml", r'camera = "cam"', 'camera = "cam"\nfile = "images/a.jpg"',
     ["project.toml [images.a] file", "no photo 'images/a.jpg'"]),
    ("project.toml", r'camera = "cam"', 'camera = "cam"\nfile = "../../a.jpg"',
     ["project.toml [images.a] file", "leaves the project folder"]),
    ("project.toml", r'camera = "cam"', 'camera = "cam"\nfile = "points.csv"', ["points.csv", "not a photo"]),
]


@pytest.mark.parametrize(("file", "find", "put", "says"), TABLES, ids=[f"{t[0]}-{i}" for i, t in enumerate(TABLES)])
def test_one_wrong_thing(site: Path, capsys: pytest.CaptureFixture[str], file: str, find: str, put: str, says: list[str]) -> None:
    edit(site / file, find, put)
    message = refused(capsys, "resect", site)
    for part in says:
        assert part in message
    assert not (site / "runs").exists()


@pytest.mark.parametrize("file", ["points.csv", "observations.csv", "project.toml"])
@pytest.mark.parametrize(("change", "says"), [
    (lambda b: b"", "the file is empty"),
    (lambda b: b" \n\n", "the file is empty"),
    (lambda b: b.decode().replace("a", "\xe9", 1).encode("cp1252"), "the byte 0xe9 is not UTF-8 text; save the file as UTF-8"),
    (lambda b: b.decode().encode("utf-16"), "not UTF-8"),
    (lambda b: b[:20] + b"\0" + b[20:], "zero bytes"),
], ids=["empty", "blank", "cp1252", "utf16", "binary"])
def test_unreadable_files(site: Path, capsys: pytest.CaptureFixture[str], file: str, change, says: str) -> None:
    (site / file).write_bytes(change((site / file).read_bytes()))
    message = refused(capsys, "resect", site)
    assert says in message and str(site / file) in message


@pytest.mark.parametrize("file", ["points.csv", "observations.csv"])
@pytest.mark.parametrize(("old", "new", "says"), [(",", ";", "semicolons"), (",", "\t", "tabs")])
def test_other_delimiters(site: Path, capsys: pytest.CaptureFixture[str], file: str, old: str, new: str, says: str) -> None:
    (site / file).write_text((site / file).read_text().replace(old, new))
    assert says in (message := refused(capsys, "resect", site)) and f"{file} line 1" in message and "commas" in message


def test_semicolons_with_decimal_commas(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (site / "points.csv").read_text()
    (site / "points.csv").write_text(text.replace(",", ";").replace(".", ","))
    assert "decimal points" in refused(capsys, "resect", site)


def test_a_bom_and_windows_line_ends_are_no_trouble(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for file in ("points.csv", "observations.csv", "project.toml"):
        text = (site / file).read_text(encoding="utf-8")
        (site / file).write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert main(["resect", str(site), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("file", ["points.csv", "observations.csv", "project.toml"])
def test_missing_files(site: Path, capsys: pytest.CaptureFixture[str], file: str) -> None:
    (site / file).unlink()
    assert f"{file}: there is no such file" in refused(capsys, "resect", site)


def test_no_project_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no such folder" in refused(capsys, "resect", tmp_path / "nowhere")
    (tmp_path / "file").write_text("x")
    assert "not a project folder" in refused(capsys, "resect", tmp_path / "file")
    assert "there is no such folder" in refused(capsys, "view", tmp_path / "nowhere")
    assert "no run with a recording" in refused(capsys, "log", tmp_path)


@pytest.mark.parametrize("file", ["points.csv", "observations.csv", "project.toml"])
def test_huge_files_are_refused_before_they_are_read(site: Path, capsys: pytest.CaptureFixture[str], file: str) -> None:
    with open(site / file, "ab") as stream:
        stream.truncate(files.MAX_BYTES + 2**20)  # a hole: nothing is written to the disk
    message = refused(capsys, "resect", site)
    assert f"{file}: the file has 257 MB" in message


def test_one_endless_line(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open(site / "points.csv", "a") as stream:
        stream.write("x" * 1_000_000)
    assert "points.csv line 9" in refused(capsys, "resect", site)


def test_a_large_table_is_read(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open(site / "points.csv", "a") as stream:
        stream.writelines(f"T{i},,,,,,,tie\n" for i in range(20_000))
    assert main(["resect", str(site), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")


# -- geometry ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("model", "points", "says"), [
    ("perspective", "P1,P2", ["perspective model needs at least 3 control points", "2 (P1, P2)"]),
    ("orthogonal", "P1,P2,P5", ["orthogonal"]),
    ("perspective", "P1,P2,P77", ["no point 'P77'"]),
])
def test_too_few_points(site: Path, capsys: pytest.CaptureFixture[str], model: str, points: str, says: list[str]) -> None:
    code = main(["resect", str(site), "--model", model, "--points", points])
    out, err = capsys.readouterr()
    if model == "orthogonal":  # three points are always in one plane: the orthogonal model may use them
        assert code == 0 and "image a" in out
        return
    assert code == 1 and not out and err.count("\n") == 1
    assert all(s in err for s in says), err


def test_no_observation_at_all(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (site / "observations.csv").write_text("image,point,col,row,sigma\n")
    assert "no point is observed" in refused(capsys, "resect", site)
    assert "needs at least 3 control points, there are none" in refused(capsys, "resect", site, "--image", "a", "--model",
                                                                        "perspective")


def test_unknown_image(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "there is no image 'z'; choose one of a" in refused(capsys, "resect", site, "--image", "z")


def test_collinear_points(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = np.linspace(-60, 60, 6)[:, None] * np.array([1.0, 0.5, 0.1])
    write_project(good_block(line), tmp_path / "site")
    assert "on one line" in refused(capsys, "resect", tmp_path / "site")


def test_points_behind_the_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    upwards = Prior(np.array([4.0, -6.0, 300.0]), np.radians([180.0, 0.0, 0.0]), np.full(3, 1.0), np.full(3, 0.01))
    write_project(good_block(prior=upwards), tmp_path / "site")
    message = refused(capsys, "resect", tmp_path / "site", "--prior", "initial", "--model", "perspective")
    assert "behind the camera" in message and "'a'" in message


def test_a_wild_value_is_told_in_words(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    edit(site / "points.csv", r"^P5,5.0,-3.0,15.0", "P5,5.0,-3.0,1000000.0")
    code = main(["resect", str(site)])
    out, err = capsys.readouterr()
    assert "unforeseen" not in err and ((code == 0 and "warning" in out) or (code == 1 and "image 'a'" in err))


def test_no_prior(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "[images.a.prior]" in refused(capsys, "resect", site, "--prior", "weighted", "--model", "perspective")


def test_what_can_be_done_is_done(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block = good_block()
    two = Observations(np.array([*block.observations.image, 1, 1]), np.array([*block.observations.point, 0, 1]),
                       np.vstack([block.observations.pixel, block.observations.pixel[:2]]),
                       np.full(len(block.observations) + 2, np.nan))
    block = Block("site", "local", block.cameras, (*block.images, Image("b", "cam")), block.points, two)
    write_project(block, tmp_path / "site")
    assert main(["resect", str(tmp_path / "site"), "--model", "perspective"]) == 1
    out, err = capsys.readouterr()
    assert "image a" in out and "1 of 2 orientations cannot be computed" in err and "'b'" in err and err.count("\n") == 1
