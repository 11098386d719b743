"""collinea convert and init with files of other tools, on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from solvers import BadProject, BadTable
from solvers.cameras import Interior
from solvers.cameras.brown import Brown
from solvers.cli import main
from solvers.geometry import Exterior, LocalFrame, rotation
from solvers.io import read_project
from solvers.io.exchange import project as projects
from solvers.io.exchange import registry
from solvers.workflows_exchange import Wanted, convert, target_of
from solvers.workflows_init import init_project

from .scenes import FULL, OURS, opencv_pixels, pixels_of, scene


def written(kind: str, path: Path, value=None) -> Path:
    write = registry.FORMATS[kind].write
    assert write is not None
    write(value or scene(), path)
    return path


def test_a_model_becomes_a_project_and_goes_out_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = written("colmap", tmp_path / "model")
    assert main(["convert", str(model), str(tmp_path / "site"), "--crs", "local", "--json", "-"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["from"] == "COLMAP" and any("refitted" in n
                                            for n in said["notes"]) and any("as priors" in n for n in said["notes"])
    block = read_project(tmp_path / "site")
    assert [i.name for i in block.images] == ["DSC01", "DSC02", "DSC03", "DSC04"] and len(block.observations) > 20
    assert main(["convert", str(tmp_path / "site"), str(tmp_path / "block.xml"), "--to", "blocks", "--json", "-"]) == 0
    value, truth = registry.read(tmp_path / "block.xml"), scene()
    most = max(float(n.split("at most ")[1].split()[0]) for n in said["notes"] + json.loads(capsys.readouterr().out)["notes"]
               if "at most " in n)
    for a, b in zip(truth.shots, value.shots, strict=True):
        assert a.exterior is not None and b.exterior is not None
        np.testing.assert_allclose(b.exterior.centre, a.exterior.centre, atol=1e-8)
        np.testing.assert_allclose(b.exterior.m, a.exterior.m, atol=1e-9)
        expected = opencv_pixels(FULL, a.exterior, truth.points.xyz)
        depth = -a.exterior.camera(truth.points.xyz)[:, 2]
        wide = np.hypot(*a.exterior.camera(truth.points.xyz)[:, :2].T) / depth < 0.9  # farther out the polynomial folds
        seen = truth.cameras["lens"].inside(expected) & wide
        np.testing.assert_allclose(pixels_of(value.cameras[b.camera or ""], b, truth.points.xyz)[seen], expected[seen],
                                   atol=2.5 * most)


def test_monoplot_takes_imported_orientations_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = scene(OURS)
    assert convert(written("opk", tmp_path / "opk.csv", truth), tmp_path / "out.txt", Wanted(target="opk-pix4d", crs="local"))
    text = written("cal-australis", tmp_path / "lens.txt", truth)
    convert(tmp_path / "opk.csv", tmp_path / "site", Wanted(crs="local", camera=str(text)))
    shot, xyz = truth.shots[0], truth.points.xyz[0]
    col, row = pixels_of(OURS, shot, xyz[None])[0]
    words = ["monoplot", str(tmp_path / "site"), "--image", "DSC01", "--at", f"{col},{row}", "--z", repr(float(xyz[2])), "--json",
             "-"]
    assert main([*words, "--from", "prior"]) == 0
    found = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose([found[k] for k in "XYZ"], xyz, atol=1e-6)
    assert any("the priors of project.toml" in n for n in found["notes"])


def test_turned_into_the_projects_frame_and_back() -> None:
    """Grid axes at a camera 3 km from the origin differ from those there by the earth's curvature."""
    frame = LocalFrame(np.array([684_210.0, 5_334_100.0, 400.0]), "EPSG:32632")
    at = Exterior(rotation(0.3, -0.2, 1.1), frame.origin + np.array([3000.0, -1500, 300]))
    t = projects.turn("EPSG:32632", frame, at.centre)
    angle = np.degrees(np.arccos((np.trace(t) - 1) / 2))
    assert angle == pytest.approx(np.degrees(np.hypot(3000, 1500) / 6.383e6), rel=0.35)
    np.testing.assert_allclose(t @ t.T, np.eye(3), atol=1e-12)
    # a vertical photo at the camera looks at the point below it, which the frame knows too
    down = np.array([at.centre[0], at.centre[1], 0.0])
    local = frame.to_local(at.centre) - frame.to_local(down)
    np.testing.assert_allclose(t @ local / np.linalg.norm(local), [0, 0, 1], atol=1e-6)


def test_orientations_in_a_mapped_crs_survive_a_project(tmp_path: Path) -> None:
    truth = scene(OURS, crs="EPSG:32632")
    convert(written("opf", tmp_path / "opf", truth), tmp_path / "site", Wanted())
    convert(tmp_path / "site", tmp_path / "o.txt", Wanted(target="opk-metashape"))
    value = registry.read(tmp_path / "o.txt")
    for a, b in zip(truth.shots, value.shots, strict=True):
        assert a.exterior is not None and b.exterior is not None
        np.testing.assert_allclose(b.exterior.m, a.exterior.m, atol=1e-9)
        np.testing.assert_allclose(b.exterior.centre, a.exterior.centre, rtol=0, atol=2e-8)


def test_geocentric_blocks_come_home(tmp_path: Path) -> None:

    from solvers.io.geocentric import to_geocentric

    truth = scene(crs="EPSG:32632")
    earth = [to_geocentric(Exterior(np.eye(3), x), "EPSG:32632").centre for x in truth.points.xyz]
    shots = tuple(replace(s, exterior=to_geocentric(s.exterior, "EPSG:32632")) for s in truth.shots if s.exterior is not None)
    moved = replace(truth, crs="EPSG:4978", shots=shots, points=replace(truth.points, xyz=np.array(earth)))
    value = registry.read(written("blocks", tmp_path / "b.xml", moved))
    assert value.crs == "EPSG:32632" and any("geocentric" in n for n in value.notes)
    for a, b in zip(truth.shots, value.shots, strict=True):
        assert a.exterior is not None and b.exterior is not None
        np.testing.assert_allclose(b.exterior.centre, a.exterior.centre, atol=1e-4)
        np.testing.assert_allclose(b.exterior.m, a.exterior.m, atol=1e-8)


def photo(path: Path, size: tuple[int, int] = (547, 365)) -> Path:
    exif = Image.Exif()
    exif[271], exif[272] = "DJI", "FC6310"
    exif.get_ifd(0x8769)[37386] = 8.8
    Image.new("RGB", size).save(path, exif=exif)
    return path


def test_init_takes_calibration_orientations_and_control_of_any_format(tmp_path: Path) -> None:

    truth = replace(scene(crs="EPSG:32632"), cameras={"lens": replace(FULL, fx=371.0, fy=371.0, cx=272.5, cy=181.0, width=547,
                                                                      height=365)})
    photos = [photo(tmp_path / f"DSC0{n}.JPG") for n in (1, 2, 3, 4)]
    lens = written("cal-metashape", tmp_path / "lens.xml", truth)
    small = replace(truth, observations=replace(truth.observations, pixel=truth.observations.pixel / 10))
    files = [lens, written("opk-metashape", tmp_path / "opk.txt", truth), written("gcp-geojson", tmp_path / "g.geojson", small)]
    made = init_project([*photos, *files], tmp_path / "p", project_crs="EPSG:32632")
    block = made.block
    [camera] = block.cameras.values()
    assert camera.width == 547 and camera.k1 != 0 and any("Metashape calibration" in n for n in made.notes)
    assert len(block.points) == 16 and all(i.prior is not None and i.prior.angles is not None for i in block.images)
    with pytest.raises(BadProject, match=r"opk2\.txt: .*is a file of orientations"):
        init_project([*photos, *files, written("opk-pix4d", tmp_path / "opk2.txt", truth)], tmp_path / "q",
                     project_crs="EPSG:32632")
    with pytest.raises(BadProject, match=r"lens\.xml: the calibration is for photos of 547 x 365"):
        init_project([photo(tmp_path / "x.jpg", (100, 80)), lens], tmp_path / "q")


def test_names_say_the_format_or_are_refused() -> None:
    assert target_of(Path("a/transforms.json")) == "nerfstudio" and target_of(Path("site")) == "project"
    assert target_of(Path("x.jgw")) == "world" and target_of(Path("p_calibrated_camera_parameters.txt")) == "pix4d"
    with pytest.raises(BadTable, match=r"x\.csv: .*--to, gcp, "):
        target_of(Path("x.csv"))


@pytest.mark.parametrize(("words", "says"), [
    (["convert", "g.csv", "out.glb", "--to", "colmap", "--crs", "local"], "it has no cameras, which COLMAP"),
    (["convert", "g.csv", "none/out.glb"], "no such folder"),
    (["convert", "g.csv", "x.ply", "--from", "nothing"], "--from nothing: this format is not read"),
    (["convert", "g.csv", "x.ply", "--to", "nothing", "--crs", "local"], "--to nothing: this format is not written"),
    (["convert", "opk.csv", "site", "--crs", "local"], "image 'DSC01' has no camera; give its calibration with --camera"),
    (["convert", "opk.csv", "site"], "does not say its coordinate system"),
    (["convert", "g.csv", "g.geojson", "--to", "gcp-geojson"], "on no map|coordinate system"),
    (["convert", "b.xml", "f.geojson", "--to", "footprints"], "height of the ground is not known"),
    (["convert", "b.xml", "w.jgw", "--z", "400"], "name it with --image"),
])
def test_refusals(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str],
                  says: str) -> None:
    import re

    monkeypatch.chdir(tmp_path)
    Path("g.csv").write_text("name,X,Y,Z\nA,1,2,3\nB,2,3,4\n")
    written("opk", Path("opk.csv"))
    written("blocks", Path("b.xml"))
    assert main(words) == 1
    error = capsys.readouterr().err
    assert re.search(says, error) and error.count("\n") == 1, error


def test_drawings_on_level_ground(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = scene(OURS, crs="EPSG:32632")
    path = written("opf", tmp_path / "opf", truth)
    convert(path, tmp_path / "site", Wanted())
    (tmp_path / "lines.csv").write_text("line,image,col,row\nroof,DSC01,1000,1000\nroof,DSC01,3000,2000\nroof,DSC01,4000,2500\n"
                                        "yard,DSC02,1000,1000\nyard,DSC02,3000,1000\nyard,DSC02,3000,2000\nyard,DSC02,1000,1000\n")
    done = convert(tmp_path / "site", tmp_path / "d.dxf", Wanted(lines=str(tmp_path / "lines.csv"), z=400.0))
    assert any("drawn: 2 lines" in n for n in done.notes)
    from solvers.io.exchange.drawing import read_dxf_lines

    roof, yard = read_dxf_lines(tmp_path / "d.dxf")["LINES"]
    assert roof.shape == (3, 3) and yard.shape == (3, 3)
    frame = projects.frame_of(truth)
    shot = truth.shots[0]
    assert shot.exterior is not None
    local = Exterior(shot.exterior.m @ projects.turn("EPSG:32632", frame, shot.exterior.centre),
                     frame.to_local(shot.exterior.centre))

    seen = pixels_of(OURS, replace(shot, exterior=local), frame.to_local(roof))
    np.testing.assert_allclose(seen, [[1000, 1000], [3000, 2000], [4000, 2500]], atol=1e-3)
    convert(tmp_path / "site", tmp_path / "f.geojson", Wanted(target="footprints", z=400.0))
    assert len(json.loads((tmp_path / "f.geojson").read_text())["features"]) == 4
    done = convert(tmp_path / "site", tmp_path / "DSC01.jgw", Wanted(image="DSC01", z=400.0))
    assert "off by at most" in done.notes[-1]


def test_a_list_of_formats(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", "--list", "--json", "-"]) == 0
    listed = {f["name"] for f in json.loads(capsys.readouterr().out)}
    assert {*registry.FORMATS, "project", "dxf", "world", "footprints"} == listed
    page = (Path(__file__).parent.parent.parent / "docs" / "formats.md").read_text(encoding="utf-8")
    assert not [k for k in listed if k not in page]
    assert main(["convert"]) == 2


LIST = "Punkt;Bemerkung;Hochwert;Rechtswert;Hoehe\n7;x;5334100,25;684210,5;412,1\n8;y;5334180,5;684310,7;abc\n"


def test_columns_are_shown_before_they_are_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "g.csv").write_text(LIST)  # one of its heights is no number
    words = ["convert", str(tmp_path / "g.csv"), str(tmp_path / "o.geojson"), "--to", "gcp-geojson", "--crs", "EPSG:25832"]
    assert main(words) == 1 and not (tmp_path / "o.geojson").exists()
    shown, wrong = capsys.readouterr()
    assert "X = Rechtswert (684210,5), Y = Hochwert (5334100,25)" in shown and "not read: Bemerkung" in shown
    assert "line 3" in wrong and len(wrong.splitlines()) == 1
    assert main([*words, "--quiet"]) == 1 and capsys.readouterr().out == ""
    (tmp_path / "g.csv").write_text(LIST.replace("abc", "418"))
    assert main(words) == 0 and capsys.readouterr().out.count("columns: ") == 1
    assert main([*words, "--json", "-"]) == 0
    out, err = capsys.readouterr()
    assert "columns: name = Punkt" in err and any(n.startswith("columns: ") for n in json.loads(out)["notes"])


def test_columns_are_only_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "g.csv").write_text(LIST.replace("abc", "418"))
    (tmp_path / "o.csv").write_text("photo,East,North,H,omega,phi,kappa\na.jpg,1,2,3,0,0,90\n")
    (tmp_path / "f.csv").write_text("file;latitude;longitude;altitude\na.jpg;48.1;11.5;500\n")
    before = sorted(tmp_path.iterdir())
    for name, says in (("g.csv", "gcp, columns: name = Punkt (7)"),
                       ("o.csv", "opk, columns: image = photo (a.jpg), X = East (1)"),
                       ("f.csv", "geo, columns: image = file (a.jpg), lat = latitude (48.1)")):
        assert main(["convert", str(tmp_path / name), "--show-mapping"]) == 0
        assert says in capsys.readouterr().out
    assert main(["init", str(tmp_path / "g.csv"), "--show-mapping", "--map", "name=Punkt,X=4,Y=3,Z=5", "--json", "-"]) == 0
    assert "X = Rechtswert" in json.loads(capsys.readouterr().out)[0]["columns"]
    assert main(["init", str(tmp_path / "g.csv")]) == 2 and "-o PROJECT" in capsys.readouterr().err
    (tmp_path / "n.txt").write_text("A 684210.5 5334100.25 412\nB 684310.5 5334180 418\n")
    assert main(["convert", str(tmp_path / "n.txt"), "--show-mapping"]) == 1
    told = capsys.readouterr().err
    assert "there is no header line" in told and "say which they are with --map" in told
    assert main(["convert", str(tmp_path / "n.txt"), "--show-mapping", "--crs", "EPSG:32632"]) == 0  # only one order lies in it
    assert "name = column 1 (A), X = column 2 (684210.5), Y = column 3" in capsys.readouterr().out
    assert sorted(p for p in tmp_path.iterdir() if p.name != "n.txt") == before


def test_columns_of_orientations_are_said_or_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "o.csv").write_text("photo,E,Easting,N,H,omega,phi,kappa\na.jpg,1,684210,5334100,3,0,0,90\n")
    words = ["convert", str(tmp_path / "o.csv"), str(tmp_path / "o.txt"), "--to", "opk-pix4d", "--crs", "local"]
    assert main(words) == 1 and "for X there is 'E' and 'Easting'" in capsys.readouterr().err
    assert main([*words, "--map", "image=photo,X=Easting,Y=N,Z=H,omega=omega,phi=phi,kappa=kappa"]) == 0
    assert (tmp_path / "o.txt").read_text().splitlines()[1].split()[1] == "684210.0"


def test_a_local_project_may_be_given_its_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the refusal of a list that begins with its crs asks for, works."""
    demo, out = str(Path(__file__).parents[2] / "assets" / "demo"), str(tmp_path / "gcp_list.txt")
    assert main(["convert", demo, out]) == 1 and "give --crs" in capsys.readouterr().err
    assert main(["convert", demo, out, "--crs", "EPSG:32725"]) == 0
    assert "local coordinates are taken in EPSG:32725" in capsys.readouterr().out
    assert (tmp_path / "gcp_list.txt").read_text().startswith("EPSG:32725\n679")


@pytest.mark.parametrize("camera", [OURS, FULL, replace(FULL, d1=0.004, d2=-0.001, d3=0.0002)])
def test_a_calibration_for_opencv_gives_its_pixels(tmp_path: Path, camera) -> None:
    write = registry.FORMATS["cal-opencv"].write
    assert write is not None
    notes = write(scene(camera), tmp_path / "lens.yml")
    most = max((float(n.split("at most ")[1].split()[0]) for n in notes), default=1e-6)
    assert most < 0.3 and (most > 1e-6) == (camera is OURS)
    [back] = registry.read(tmp_path / "lens.yml").cameras.values()
    pixels = np.stack(np.meshgrid(np.linspace(0, 5471, 23), np.linspace(0, 3647, 17)), -1).reshape(-1, 2)
    if isinstance(camera, Interior):
        xy = camera.ideal(pixels) / [camera.c, -camera.c]
    else:
        xy = camera.ideal(pixels)
    seen = np.isfinite(xy).all(axis=1)
    assert isinstance(back, Brown) and seen.mean() > 0.5
    np.testing.assert_allclose(back.measured(xy[seen]), pixels[seen], atol=1.05 * most)
    storage = cv2.FileStorage(str(tmp_path / "lens.yml"), cv2.FILE_STORAGE_READ)
    k, d = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    assert d.size == (8 if not isinstance(camera, Interior) and camera.d1 else 5)
    rays = np.column_stack([xy[seen], np.ones(seen.sum())])
    own, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), k, d)
    np.testing.assert_allclose(own[:, 0], pixels[seen], atol=1.05 * most)
