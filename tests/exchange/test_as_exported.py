"""The quirks of files as programs export them: encodings, headers in comments, closing lines, packed files, local frames."""

import bz2
import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from solvers import BadTable, Exterior
from solvers.cameras.brown import Brown
from solvers.io.exchange import registry
from solvers.io.exchange.bundler import write_bal
from solvers.io.exchange.colmap import write_bin, write_txt
from solvers.io.exchange.options import Reading
from tests.exchange.scenes import pixels_of, scene

UTM = Reading(crs="EPSG:32632")


def written(at: Path, name: str, text: str, encoding: str = "utf-8") -> Path:
    path = at / name
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_words_with_umlauts_are_recognised_in_any_encoding(tmp_path: Path, encoding: str) -> None:
    path = written(tmp_path, "p.csv", "Punktnummer;Rechts;Hoch;Höhe NHN\r\n\"GCP 1\";439760,12;5261010,34;412,5\r\n", encoding)
    assert registry.sniff(path) == "gcp"
    value = registry.read(path, options=UTM)
    assert value.points.names == ("GCP 1",) and value.points.xyz.tolist() == [[439760.12, 5261010.34, 412.5]]


def test_a_letter_cut_at_the_end_of_the_sniffed_part_is_no_other_encoding(tmp_path: Path) -> None:
    text = "name;X;Y;Z\n" + "".join(f"Höhenpunkt {n};684{n:03d};5334000;400\n" for n in range(1, 3000))
    raw = text.encode()
    cut = next(k for k in range(registry.HEAD - 1, 0, -1) if raw[k] == 0xC3)
    path = tmp_path / "p.csv"
    path.write_bytes(b"#" + b" " * (registry.HEAD - 3 - cut) + b"\n" + raw)  # the sniffed part ends within an ö
    assert registry.sniff(path) == "gcp"


@pytest.mark.parametrize(("line", "names"), [("7 439760.12 5261010.34 412.5", "XY"), ("7,5261010.34,439760.12,412.5,GCP", "YX"),
                                             ("7;439760,12;5261010,34;412,5", "XY")])
def test_points_without_a_header_in_the_one_order_that_lies_in_the_crs(tmp_path: Path, line: str, names: str) -> None:
    path = written(tmp_path, "p.txt", line + "\n")
    value = registry.read(path, options=UTM)
    assert value.points.xyz.tolist() == [[439760.12, 5261010.34, 412.5]]
    assert f"name = column 1 (7), {names[0]} = column 2" in value.notes[0]
    with pytest.raises(BadTable, match=r"no header line.*--map"):
        registry.read(path)
    near_equator = written(tmp_path, "e.txt", "7 439760 461010 12\n")  # either order lies in the zone
    with pytest.raises(BadTable, match="in one order only"):
        registry.read(near_equator, options=UTM)


def test_a_receivers_table_with_the_map_and_degrees(tmp_path: Path) -> None:
    head = "Name,Easting,Northing,Elevation,Longitude,Latitude,Ellipsoidal height,Easting RMS,Northing RMS,Elevation RMS\n"
    path = written(tmp_path, "p.csv", head + "A,439760.12,5261010.34,412.5,8.2,47.5,460.5,0.01,0.02,0.03\n")
    value = registry.read(path, options=UTM)
    assert value.points.xyz.tolist() == [[439760.12, 5261010.34, 412.5]] and value.points.sigma.tolist() == [[0.01, 0.02, 0.03]]
    path.write_text("Name,Latitude,Longitude,Ellipsoidal height,Accuracy XY,Accuracy Z\nA,47.5,8.2,460.5,0.02,0.03\n")
    value = registry.read(path)
    assert value.crs == "EPSG:4326" and value.points.xyz.tolist() == [[8.2, 47.5, 460.5]]
    assert value.points.sigma.tolist() == [[0.02, 0.02, 0.03]]


@pytest.mark.parametrize(("text", "angles"), [
    ("#Label,Longitude,Latitude,Altitude,Yaw,Pitch,Roll\nDJI_1.JPG,9.0012,47.5003,512.5,10,0,0\n", True),
    ("imagename;latitude;longitude;altitude [m];accuracy horizontal [m];accuracy vertical [m]\n"
     "DJI_1.JPG;47,5003;9,0012;512,5;0,02;0,03\n", False),
    ("imagename,X,Y,Z\nDJI_1.JPG,500090.3756,5260763.0746,512.5\n", False)])
def test_places_of_photos_are_no_control_points(tmp_path: Path, text: str, angles: bool) -> None:
    path = written(tmp_path, "p.csv", text)
    assert registry.sniff(path) == "geo"
    [shot] = registry.read(path, options=UTM).shots
    assert shot.exterior is not None and shot.oriented is angles
    np.testing.assert_allclose(shot.exterior.centre, [500090.3756, 5260763.0746, 512.5], atol=1e-3)
    if angles:
        np.testing.assert_allclose(np.degrees(shot.exterior.angles), [0, 0, -10], atol=2e-3)
    if "accuracy" in text:
        assert shot.sigma_m is not None and shot.sigma_m.tolist() == [0.02, 0.02, 0.03]


def test_orientations_without_a_header_and_with_one_in_a_comment(tmp_path: Path) -> None:
    bare = written(tmp_path, "b.txt", "a.jpg 500123.4 5260321.2 512.7 1.5 357.7 120.7\nb.jpg 500153.4 5260351.2 515.5 0 0 0\n")
    assert registry.sniff(bare) == "opk"
    head = "# ID, EVENT, TIME (s), EASTING, NORTHING, ELLIPSOID HEIGHT, OMEGA, PHI, KAPPA, LAT, LONG\n"
    said = written(tmp_path, "c.txt", head + "a.jpg 1 412345.1 500123.4 5260321.2 512.7 1.5 -2.3 120.7 47.5 9.0\n"
                                             "b.jpg 2 412346.1 500153.4 5260351.2 515.5 0 0 0 47.5 9.0\n")
    for path in (bare, said):
        first = registry.read(path, options=UTM).shots[0].exterior
        assert first is not None
        np.testing.assert_allclose(first.centre, [500123.4, 5260321.2, 512.7])
        np.testing.assert_allclose(np.degrees(first.angles), [1.5, -2.3, 120.7])
    said.write_text(said.read_text().split("\n", 1)[1])  # eleven items, and nothing says which is which
    with pytest.raises(BadTable, match="11 items and no header"):
        registry.read(said, "opk")
    german = written(tmp_path, "g.csv", "Bild;Rechts;Hoch;Höhe;Phi [gon];Omega [gon];Kappa\na;5,5;6,5;7,5;1;2;3\n", "cp1252")
    shot = registry.read(german, options=UTM).shots[0].exterior
    assert shot is not None and shot.centre.tolist() == [5.5, 6.5, 7.5]


def test_patb_ends_with_its_own_mark(tmp_path: Path) -> None:
    path = written(tmp_path, "b.ori", "101 500123.4 5260321.2 512.7\n1 0 0 0 1\n0 0 0 1\n    -99\n")
    assert [s.name for s in registry.read(path).shots] == ["101"]


def test_ros_and_plain_json_calibrations(tmp_path: Path) -> None:
    ros = ("image_width: 640\nimage_height: 480\ncamera_name: cam\ncamera_matrix:\n  rows: 3\n  cols: 3\n"
           "  data: [500, 0, 321, 0, 501, 239, 0, 0, 1]\ndistortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n"
           "  cols: 5\n  data: [-0.1, 0.02, 0.001, -0.002, 0.003]\n")
    plain = json.dumps({"mtx": [[500, 0, 321], [0, 501, 239], [0, 0, 1]], "dist": [[-0.1, 0.02, 0.001, -0.002, 0.003]]})
    for name, text in (("cam.yaml", ros), ("cam.json", plain)):
        [camera] = registry.read(written(tmp_path, name, text), options=Reading(size=(640, 480))).cameras.values()
        assert camera == Brown(500, 501, 321, 239, k1=-0.1, k2=0.02, p1=0.001, p2=-0.002, k3=0.003, width=640, height=480)


def test_australis_final_values_and_its_sensor(tmp_path: Path) -> None:
    report = ("Australis Bundle Adjustment Results: Camera Parameters\n\n  Sensor Size   Pixel Size (mm)\nH   3008   0.00780\n"
              "V   2000   0.00770\n\nCamera    Initial   Total       Final    Initial     Final\n"
              "Variable  Value     Adjustment  Value    Std. Error  Std. Error\n\n"
              "C   20.4000  0.0190  20.4190  1.0e+03 2.6e-03\nXP  0.0000 0.0790 0.0790 1.0e+03 2e-3\nYP  0.0 -0.05 -0.05 1 1\n"
              "K1 0 2.1e-04 2.1e-04 1 1\n")
    [camera] = registry.read(written(tmp_path, "a.txt", report)).cameras.values()
    assert (camera.c, camera.xp, camera.yp, camera.k1) == (20.419, 0.079, -0.05, 2.1e-4)  # type: ignore[union-attr]
    assert (camera.width, camera.height, camera.pixel_mm) == (3008, 2000, (0.0078, 0.0077))
    plain = "iWitness\nSensor size (mm) 13.2 x 8.8\nPixel size 2.4 um\nC 8.8 0.1 0.001\nXP 0.01\nYP 0.02\nK1 1e-5\n"
    path = written(tmp_path, "i.txt", plain)
    with pytest.raises(BadTable, match="--size"):  # the millimetres are no pixels
        registry.read(path)
    [camera] = registry.read(path, options=Reading(size=(5472, 3648))).cameras.values()
    assert (camera.width, camera.c, camera.pixel_mm) == (5472, 8.8, (0.0024, 0.0024))  # type: ignore[union-attr]


def test_packed_bal_problems(tmp_path: Path) -> None:
    made = scene(Brown(3712.5, 3712.5, 2735.5, 1823.5, k1=-0.012, k2=0.009, width=5472, height=3648))
    write_bal(made, tmp_path / "p.txt")
    plain = registry.read(tmp_path / "p.txt")
    for name, pack in (("p.txt.bz2", bz2.compress), ("p.gz", gzip.compress)):
        (tmp_path / name).write_bytes(pack((tmp_path / "p.txt").read_bytes()))
        value = registry.read(tmp_path / name)
        np.testing.assert_array_equal(value.points.xyz, plain.points.xyz)
    whole = (tmp_path / "p.gz").read_bytes()
    (tmp_path / "cut.gz").write_bytes(whole[:len(whole) // 2])
    with pytest.raises(BadTable, match="cannot be unpacked"):
        registry.read(tmp_path / "cut.gz")


def test_blanks_in_names_are_kept_where_colmap_can(tmp_path: Path) -> None:
    from dataclasses import replace

    made = scene()
    made = replace(made, shots=(replace(made.shots[0], name="my photo", file="my photo.JPG"), *made.shots[1:]))
    with pytest.raises(BadTable, match="--to colmap-bin"):
        write_txt(made, tmp_path / "t")
    write_bin(made, tmp_path / "b")
    assert registry.read(tmp_path / "b").shots[0].name == "my photo"


def test_a_scale_that_nerfstudio_applied_is_undone(tmp_path: Path) -> None:
    turn = np.array([[1.0, 0, 0, 3], [0, 0, 1, -2], [0, -1, 0, 5]])
    pose = np.vstack([np.column_stack([np.eye(3), [10.0, 20, 30]]), [0, 0, 0, 1]])
    moved = np.vstack([turn, [0, 0, 0, 1]]) @ pose
    moved[:3, 3] *= 0.25
    (tmp_path / "transforms.json").write_text(json.dumps({
        "w": 640, "h": 480, "fl_x": 500, "applied_transform": turn.tolist(), "applied_scale": 0.25,
        "frames": [{"file_path": "a.jpg", "transform_matrix": moved.tolist()}]}))
    at = registry.read(tmp_path / "transforms.json").shots[0].exterior
    assert at is not None
    np.testing.assert_allclose(at.centre, [10, 20, 30], atol=1e-12)
    np.testing.assert_allclose(at.m, np.eye(3), atol=1e-12)


def test_blocks_in_a_local_frame_at_a_place(tmp_path: Path) -> None:
    """Definition "ENU:latitude,longitude": east, north, up in metres at that place, height 0; checked by pyproj alone."""
    from pyproj import Transformer

    photo = ("<Photo><Id>0</Id><ImagePath>a.jpg</ImagePath><Pose><Rotation><Omega>180</Omega><Phi>0</Phi><Kappa>0</Kappa>"
             "</Rotation><Center><x>120.5</x><y>-310.25</y><z>95</z></Center></Pose></Photo>")
    path = written(tmp_path, "b.xml", '<BlocksExchange version="3.2"><SpatialReferenceSystems><SRS><Id>3</Id><Name>Local</Name>'
                   "<Definition>ENU:47.50000,8.20000</Definition></SRS></SpatialReferenceSystems><Block><SRSId>3</SRSId><Photogroups>"
                   "<Photogroup><ImageDimensions><Width>640</Width><Height>480</Height></ImageDimensions><FocalLengthPixels>500"
                   f"</FocalLengthPixels>{photo}</Photogroup></Photogroups></Block></BlocksExchange>")
    value = registry.read(path)
    at = value.shots[0].exterior
    assert value.crs == "EPSG:32632" and at is not None
    lat, lon = np.radians([47.5, 8.2])
    enu = np.array([[-np.sin(lon), np.cos(lon), 0], [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
                    [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]])
    origin = np.array(Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(8.2, 47.5, 0.0))
    to_map = Transformer.from_crs("EPSG:4978", "EPSG:32632", always_xy=True)
    np.testing.assert_allclose(at.centre, to_map.transform(*(origin + enu.T @ [120.5, -310.25, 95])), atol=1e-8)
    below = to_map.transform(*(origin + enu.T @ [150.5, -290.25, 5]))  # in the photo at (30, -20, 90) in its axes
    camera = value.cameras["camera-1"]
    assert isinstance(camera, Brown)
    pixel = pixels_of(camera, value.shots[0], np.array([below]))[0]
    np.testing.assert_allclose(pixel, [319.5 + 500 * 30 / 90, 239.5 - 500 * 20 / 90], atol=0.1)  # the map's scale costs this much


def test_axes_of_a_map_are_those_of_geodesy() -> None:
    """East along the parallel and up along the normal, to 1e-10 rad: differences are taken about the place."""
    from solvers.io.geocentric import axes_at

    lat, lon = np.radians([47.5, 8.2])
    east = [-np.sin(lon), np.cos(lon), 0]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    np.testing.assert_allclose(axes_at("EPSG:4326", np.array([8.2, 47.5, 400.0])), [east, np.cross(up, east), up], atol=3e-10)
    assert Exterior(axes_at("EPSG:32632", np.array([439760.0, 5261010.0, 400.0])), np.zeros(3)).m[2] @ up > 1 - 1e-6


def test_metashape_markers_with_one_accuracy_for_all(tmp_path: Path) -> None:
    rows = "".join(f'<marker id="{n}" label="{n}"><reference x="1" y="2" z="3" {s} enabled="true"/></marker>'
                   for n, s in enumerate(('sxyz="0.005"', 'sxy="0.01" sz="0.02"', 'sx="0.01" sy="0.02" sz="0.03"', "")))
    path = written(tmp_path, "m.xml", f'<document version="2.0.0"><chunk><cameras/><markers>{rows}</markers></chunk></document>')
    sigma = registry.read(path).points.sigma
    np.testing.assert_array_equal(sigma, [[0.005] * 3, [0.01, 0.01, 0.02], [0.01, 0.02, 0.03], [np.nan] * 3])
