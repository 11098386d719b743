"""Files written by hand from the tools' documentation, with the numbers that must come out of them."""

import json
from pathlib import Path

import numpy as np
import pytest

from solvers import BadTable, PhotogrammetryError, Unsupported
from solvers.cameras import Interior
from solvers.cameras.brown import Brown
from solvers.geometry import rotation
from solvers.io.exchange import registry
from solvers.io.exchange.conventions import AngleOrder, AngleUnit, angles_as, rotation_from
from solvers.io.exchange.options import Reading


def test_colmap_as_its_documentation_prints_it(tmp_path: Path) -> None:
    """colmap.github.io/format.html: identifiers with gaps, two lines an image, an empty second line."""
    (tmp_path / "cameras.txt").write_text("# Camera list\n1 SIMPLE_PINHOLE 3072 2304 2559.81 1536 1152\n"
                                          "7 OPENCV_FISHEYE 10 10 1 1 5 5 0 0 0 0\n")
    (tmp_path / "images.txt").write_text(
        "# Image list\n1 0.851773 0.0165051 0.503764 -0.142941 -0.737434 1.02973 3.74354 1 P1180141.JPG\n"
        "2362.39 248.498 58396 1784.7 268.254 59027 1784.7 268.254 -1\n"
        "2 0.851773 0.0165051 0.503764 -0.142941 -0.737434 1.02973 3.74354 1 P1180142.JPG\n\n")
    (tmp_path / "points3D.txt").write_text("58396 1.67241 0.292931 0.609726 115 121 122 1.33927 1 0\n"
                                           "59027 1.6 0.2 0.6 1 2 3 0.5 1 1\n")
    with pytest.raises(Unsupported, match=r"cameras\.txt line 3: the camera model OPENCV_FISHEYE"):
        registry.read(tmp_path)
    (tmp_path / "cameras.txt").write_text("1 SIMPLE_PINHOLE 3072 2304 2559.81 1536 1152\n")
    value = registry.read(tmp_path)
    assert [s.name for s in value.shots] == ["P1180141", "P1180142"] and value.points.names == ("58396", "59027")
    np.testing.assert_allclose(value.observations.pixel[0], [2361.89, 247.998])  # from the corner to the centre
    from scipy.spatial.transform import Rotation

    r = Rotation.from_quat([0.0165051, 0.503764, -0.142941, 0.851773]).as_matrix()
    at = value.shots[0].exterior
    assert at is not None
    np.testing.assert_allclose(at.centre, -r.T @ [-0.737434, 1.02973, 3.74354], atol=1e-6)
    np.testing.assert_allclose(np.diag([1, -1, -1]) @ at.m, r, atol=1e-6)


MARKERS = """<?xml version="1.0" encoding="UTF-8"?><document version="1.2.0"><chunk>
<cameras><camera id="0" label="IMG_1.JPG"/><camera id="5" label="IMG_2.JPG"/></cameras>
<markers next_id="3"><marker id="0" label="A"><reference x="684210.5" y="5334100.25" z="412.1" sx="0.01" sy="0.02" sz="0.03"
enabled="true"/></marker><marker id="1" label="B"><reference x="1" y="2" z="3" enabled="false"/></marker>
<marker id="2" label="C"/></markers>
<frames next_id="1"><frame id="0"><markers><marker marker_id="0"><location camera_id="0" pinned="true" x="100.5" y="200"/>
<location camera_id="5" pinned="false" x="1" y="2"/></marker><marker marker_id="2">
<location camera_id="5" pinned="true" x="7.5" y="8.5"/></marker></markers></frame></frames>
<reference>PROJCS["WGS 84 / UTM zone 32N",GEOGCS["WGS 84",DATUM["World Geodetic System 1984",
SPHEROID["WGS 84",6378137,298.257223563,
AUTHORITY["EPSG","7030"]],TOWGS84[0,0,0,0,0,0,0],AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],
UNIT["degree",0.01745329251994328,AUTHORITY["EPSG","9102"]],AUTHORITY["EPSG","4326"]],PROJECTION["Transverse_Mercator"],
PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",9],PARAMETER["scale_factor",0.9996],
PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1,AUTHORITY["EPSG","9001"]],
AUTHORITY["EPSG","32632"]]</reference></chunk></document>"""


def test_metashape_markers_that_are_only_predicted_are_no_measurements(tmp_path: Path) -> None:
    (tmp_path / "m.xml").write_text(MARKERS)
    value = registry.read(tmp_path / "m.xml")
    assert value.crs == "EPSG:32632" and value.points.role == ("control", "check", "tie")
    assert len(value.observations) == 2 and value.observations.pixel.tolist() == [[100.0, 199.5], [7.0, 8.0]]
    assert value.points.sigma[0].tolist() == [0.01, 0.02, 0.03]
    assert any("1 predicted" in n for n in value.notes)


def test_metashape_in_a_mapped_crs_is_geocentric(tmp_path: Path) -> None:
    """A camera straight above a place, its top to true north: chunk transform east, north, up there, in EPSG:4978."""
    lon, lat, h = np.radians(11.5), np.radians(48.1), 900.0
    east = np.array([-np.sin(lon), np.cos(lon), 0])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    north = np.cross(up, east)
    from pyproj import Transformer

    at = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True).transform(11.5, 48.1, h)
    r = np.stack([east, north, up], axis=1)
    camera = np.eye(4)
    camera[:3, :3] = np.diag([1.0, -1, -1])  # x east, y south, z down
    (tmp_path / "c.xml").write_text(MARKERS.replace(
        '<camera id="0" label="IMG_1.JPG"/>', f'<camera id="0" sensor_id="0" label="IMG_1.JPG"><transform>'
        f'{" ".join(map(str, camera.ravel()))}</transform></camera>').replace("</cameras>", "</cameras><transform><rotation>"
        f'{" ".join(repr(float(v)) for v in r.ravel())}</rotation><translation>'
        f'{" ".join(repr(float(v)) for v in at)}</translation>'
        "<scale>1</scale></transform>"))
    exterior = registry.read(tmp_path / "c.xml").shots[0].exterior
    assert exterior is not None
    to = Transformer.from_crs("EPSG:4326", "EPSG:32632", always_xy=True)
    np.testing.assert_allclose(exterior.centre[:2], to.transform(11.5, 48.1), atol=1e-4)
    assert exterior.centre[2] == pytest.approx(h, abs=1e-4)
    omega, phi, kappa = np.degrees(exterior.angles)
    convergence = np.degrees(np.arctan(np.tan(np.radians(2.5)) * np.sin(lat)))  # of the meridian 2.5 degrees east of 9 E
    assert abs(omega) < 1e-6 and abs(phi) < 1e-6 and kappa == pytest.approx(convergence,
                                                                            abs=2e-3)


OPF_CONTROL = {"format": "application/opf-input-control-points+json", "version": "1.0", "gcps": [
    {"id": "G1", "is_checkpoint": True, "geolocation": {"coordinates": [48.1, 11.5, 530.0], "sigmas": [0.1, 0.2, 0.3],
                                                        "crs": {"definition": "EPSG:4326+5773"}},
     "marks": [{"camera_id": 17, "position_px": [10.25, 20.5], "accuracy": 0.7}]},
    {"id": "G2", "is_checkpoint": False, "geolocation": {"coordinates": [48.2, 11.6, 531.0], "sigmas": [0.1, 0.2, 0.3],
                                                         "crs": {"definition": "EPSG:4326+5773"}}, "marks": []}], "mtps": []}


def test_opf_control_in_the_axis_order_of_its_crs(tmp_path: Path) -> None:
    (tmp_path / "icp.json").write_text(json.dumps(OPF_CONTROL))
    value = registry.read(tmp_path / "icp.json")
    assert value.points.xyz[0].tolist() == [11.5, 48.1, 530.0] and value.points.sigma[0].tolist() == [0.2, 0.1, 0.3]
    assert value.points.role == ("check", "control") and value.observations.pixel.tolist() == [[10.25, 20.5]]
    assert value.observations.sigma.tolist() == [0.7]


def test_pix4dmatic_takes_the_axis_order_of_the_crs(tmp_path: Path) -> None:
    (tmp_path / "g.csv").write_text("A,48.1,11.5,530,0.01,0.02\nB,48.2,11.6,531,0.01,0.02\n")
    value = registry.read(tmp_path / "g.csv", "gcp-pix4dmatic", Reading(crs="EPSG:4326"))
    assert value.points.xyz[0].tolist() == [11.5, 48.1, 530] and value.points.sigma[0].tolist() == [0.01, 0.01, 0.02]
    (tmp_path / "g.csv").write_text("A,684210.5,5334100.25,530\nB,684310.5,5334100.25,531\n")
    assert registry.read(tmp_path / "g.csv", "gcp-pix4dmatic", Reading(crs="EPSG:32632")).points.xyz[0, 0] == 684210.5
    (tmp_path / "g.csv").write_text("A,5334100.25,3684210.5,530\nB,5334100.25,3684310.5,531\n")  # EPSG:31467 defines X north
    assert registry.read(tmp_path / "g.csv", "gcp-pix4dmatic", Reading(crs="EPSG:31467")).points.xyz[0, 0] == 3684210.5
    with pytest.raises(BadTable, match=r"g\.csv: .*axis order.*--crs"):
        registry.read(tmp_path / "g.csv", "gcp-pix4dmatic")


def test_qgis_counts_up_from_the_corner(tmp_path: Path) -> None:
    (tmp_path / "DSC1.JPG.points").write_text("#CRS: EPSG:32632\nmapX,mapY,pixelX,pixelY,enable,dX,dY,residual\n"
                                              "684210.5,5334100.25,100.5,-200.5,1,0,0,0\n1,2,3,-4,0,0,0,0\n")
    value = registry.read(tmp_path / "DSC1.JPG.points")
    assert value.shots[0].name == "DSC1" and value.observations.pixel.tolist() == [[100.0, 200.0]] and len(value.points) == 1


def test_opk_text_says_its_order_and_unit_by_its_matrix(tmp_path: Path) -> None:
    angles = np.array([7.3, -5.1, 88.4])
    m = rotation(*np.radians(angles))
    row = " ".join(repr(float(v)) for v in m.ravel()).replace(" ", "\t")
    head = "# Cameras (1)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33\n"
    for written in (angles, angles / 0.9):  # degrees, gon
        (tmp_path / "o.txt").write_text(head + "DSC 1.JPG\t1\t2\t3\t" + "\t".join(repr(float(v)) for v in written) + f"\t{row}\n")
        value = registry.read(tmp_path / "o.txt")
        assert value.shots[0].exterior is not None and value.shots[0].name == "DSC 1"
        np.testing.assert_allclose(value.shots[0].exterior.m, m, atol=1e-12)
    assert any("gon" in n for n in value.notes)
    (tmp_path / "o.txt").write_text(head + f"a\t1\t2\t3\t5\t5\t5\t{row}\n")
    with pytest.raises(BadTable, match=r"o\.txt: angles and rotation matrix"):
        registry.read(tmp_path / "o.txt")


def test_phi_omega_kappa_of_the_wuhan_exercise() -> None:
    """Its answer is phi -0.00399, omega 0.00211, kappa -0.06758 with R = R_y(phi) R_x(omega) R_z(kappa), phi the other way."""
    m = rotation_from(np.array([-0.00399, 0.00211, -0.06758]), AngleOrder.POK_LEFT, AngleUnit.RADIANS)
    r = m.T
    assert np.arctan2(-r[0, 2], r[2, 2]) == pytest.approx(-0.00399) and -np.arcsin(r[1, 2]) == pytest.approx(0.00211)
    for order in AngleOrder:
        for unit in AngleUnit:
            for degrees in ((7.3, -5.1, 88.4), (-70.0, 60.0, -179.0), (12.0, -89.0, 3.0)):
                made = rotation_from(np.radians(degrees) / unit.value, order, unit)
                np.testing.assert_allclose(rotation_from(angles_as(made, order, unit), order, unit), made, atol=1e-12)


def test_patb_records(tmp_path: Path) -> None:
    m = rotation(*np.radians([1.0, 2.0, 30.0]))
    r = m.T.ravel()
    text = (f"{'101':>16}{'':16}" + "".join(f"{v:16.5f}" for v in (1000.5, 2000.25,
                                                                   300.125)) + "\n" + "".join(f"{v:16.12f}" for v in r[:5])
            + "\n" + "".join(f"{v:16.12f}" for v in r[5:]) + "\n")
    (tmp_path / "x.ori").write_text(text)
    at = registry.read(tmp_path / "x.ori").shots[0].exterior
    assert at is not None and at.centre.tolist() == [1000.5, 2000.25, 300.125]
    np.testing.assert_allclose(at.m, m, atol=1e-11)
    other = registry.read(tmp_path / "x.ori", None, Reading(matrix="object-to-photo")).shots[0].exterior
    assert other is not None
    np.testing.assert_allclose(other.m, m.T, atol=1e-11)


PIX4D = """fileName imageWidth imageHeight
camera matrix K [3x3]
radial distortion [3x1]
tangential distortion [2x1]
camera position t [3x1]
camera rotation R [3x3]
camera model m = K [R|-Rt] X

DSC00002.JPG 6000 4000
5246.67817210519115178613 0 3014.21699955007488824776
0 5246.67817210519115178613 2056.96346303672453359468
0 0 1
-0.15994587090269449248 0.13993097057610345835 0.00932908149389201011
0.00077353649206159862 -0.00081332657209028754
-892.50251487949105921871 11.21358547207746880758 -4.01732550695115442352
-0.99840813078053458618 -0.01161539151567758145 -0.05519317957190545548
-0.00681563617726710196 0.99623997911544937001 -0.08636811399786505083
0.05598885152258621656 -0.08585445062421988294 -0.99473326164012199069
"""


def test_pix4d_camera_parameters_of_the_published_example(tmp_path: Path) -> None:
    """docs.nframes.com, orientation formats, Pix4D; the camera looks down."""
    (tmp_path / "s_calibrated_camera_parameters.txt").write_text(PIX4D)
    (tmp_path / "s_offset.xyz").write_text("500000.000 5400000.000 300.000\n")
    value = registry.read(tmp_path / "s_calibrated_camera_parameters.txt")
    at = value.shots[0].exterior
    [camera] = value.cameras.values()
    assert at is not None and isinstance(camera, Brown)
    np.testing.assert_allclose(at.centre, [499107.49748512, 5400011.21358547, 295.98267449], atol=1e-8)
    x = at.centre + np.array([3.0, -2.0, -50.0])
    vision = np.array([[-0.99840813, -0.01161539, -0.05519318], [-0.00681564, 0.99623998, -0.08636811],
                       [0.05598885, -0.08585445, -0.99473326]]) @ [3.0, -2.0, -50.0]
    u, v = vision[:2] / vision[2]
    r2 = u * u + v * v
    k = 1 - 0.15994587090269449 * r2 + 0.13993097057610346 * r2**2 + 0.00932908149389201 * r2**3
    t1, t2 = 0.00077353649206159862, -0.00081332657209028754
    corner = 5246.678172105191 * np.array([k * u + 2 * t1 * u * v + t2 * (r2 + 2 * u * u),
                                           k * v + 2 * t2 * u * v + t1 * (r2 + 2 * v * v)]) + [
        3014.216999550075, 2056.9634630367245]
    from solvers.cameras.foreign import project_camera

    np.testing.assert_allclose(project_camera(camera, at.camera(x)), corner - 0.5, atol=1e-3)  # the matrix has 8 digits here


def test_calibrations(tmp_path: Path) -> None:
    import cv2

    matrix, d = np.array([[3000.5, 0, 1999], [0, 3001.5, 1499], [0, 0, 1]]), np.array([-0.1, 0.05, 1e-3, -2e-3, 0.01])
    for name in ("c.yml", "c.xml", "c.json"):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 4000)
        storage.write("image_height", 3000)
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", d)
        storage.release()
        [camera] = registry.read(tmp_path / name).cameras.values()
        assert isinstance(camera, Brown) and (camera.fx, camera.cx, camera.p1, camera.k3) == (3000.5, 1999, 1e-3, 0.01), name
    (tmp_path / "p.json").write_text(json.dumps({"K": matrix.tolist(), "dist": d.tolist(), "width": 4000, "height": 3000}))
    [camera] = registry.read(tmp_path / "p.json", "cal-opencv").cameras.values()
    assert isinstance(camera, Brown) and camera.fy == 3001.5
    (tmp_path / "p.cam").write_text("Pix4D camera calibration file 0\n#Focal Length mm assuming a sensor width of 12.8x9.6mm\nF "
                                    "8.8\n"
                                    "#Principal Point mm\nPx 6.5\nPy 4.7\n#Symmetrical Lens Distortion Coeffs\nK1 -0.01\nK2 "
                                    "0.02\nK3 0\n"
                                    "#Tangential Lens Distortion Coeffs\nT1 0.001\nT2 -0.002\n")
    with pytest.raises(BadTable, match=r"p\.cam: .*--size"):
        registry.read(tmp_path / "p.cam")
    [camera] = registry.read(tmp_path / "p.cam", None, Reading(size=(4000, 3000))).cameras.values()
    assert isinstance(camera, Brown) and camera.fx == pytest.approx(2750) and camera.cx == pytest.approx(6.5 / 0.0032 - 0.5)
    (tmp_path / "a.txt").write_text("Australis camera\nSensor size: 4000 x 3000\nPixel size: 0.0024 x 0.0024 mm\nC 8.9\nXP "
                                    "0.02\nYP -0.03\n"
                                    "K1 1.2e-4\nK2 -3e-7\nK3 0\nP1 1e-5\nP2 2e-5\nB1 0\nB2 0\n")
    [camera] = registry.read(tmp_path / "a.txt").cameras.values()
    assert isinstance(camera, Interior) and (camera.c, camera.yp, camera.k1, camera.pitch[0]) == (8.9, -0.03, 1.2e-4, 0.0024)
    (tmp_path / "m.xml").write_text('<?xml version="1.0"?><calibration><projection>frame</projection><width>4000</width>'
                                    "<height>3000</height><f>3000</f><cx>10</cx><cy>-5</cy><k1>-0.1</k1><p1>0.001</p1><p2>0.002</p2>"
                                    "<b1>1</b1></calibration>")
    [camera] = registry.read(tmp_path / "m.xml").cameras.values()
    assert isinstance(camera, Brown) and (camera.fx, camera.fy, camera.cx, camera.p1,
                                          camera.p2) == (3001, 3000, 2009.5, 0.002, 0.001)


def test_dewarp_data_in_a_photo(tmp_path: Path) -> None:
    from PIL import Image

    xmp = b"""<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description
     xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" 
     drone-dji:DewarpData="2021-05-01;3666.0,3665.5,-12.5,8.25,-0.26,0.11,0.0002,-0.0001,-0.03"
     drone-dji:DewarpFlag="0"/></rdf:RDF></x:xmpmeta>"""
    Image.new("RGB", (400, 300)).save(tmp_path / "d.jpg", xmp=xmp)
    [camera] = registry.read(tmp_path / "d.jpg", "dewarp").cameras.values()
    assert isinstance(camera, Brown)
    assert (camera.fx, camera.fy, camera.cx, camera.cy, camera.k3) == (3666, 3665.5, 200 - 12.5 - 0.5, 150 + 8.25 - 0.5, -0.03)
    Image.new("RGB", (400, 300)).save(tmp_path / "d.jpg", xmp=xmp.replace(b'Flag="0"', b'Flag="1"'))
    value = registry.read(tmp_path / "d.jpg", "dewarp")
    plain = value.cameras["d"]
    assert isinstance(plain, Brown) and not plain.distorts and any("already" in n
                                                                   for n in value.notes)  # type: ignore[union-attr]
    Image.new("RGB", (40, 30)).save(tmp_path / "e.jpg")
    with pytest.raises(Unsupported, match=r"e\.jpg"):
        registry.read(tmp_path / "e.jpg", "dewarp")


def test_positions(tmp_path: Path) -> None:
    (tmp_path / "geo.txt").write_text("EPSG:4326\nDSC1.JPG 11.5 48.1 530 10 0 0 0.02 0.03\n")
    value = registry.read(tmp_path / "geo.txt")
    at = value.shots[0].exterior
    assert value.kind == "positions" and value.crs == "EPSG:32632" and at is not None
    assert np.degrees(at.angles)[2] == pytest.approx(-10 + 1.861, abs=0.01)  # yaw 10 from true north, grid north 1.86 to the west
    (tmp_path / "f_Timestamp.MRK").write_text("1\t375769.385\t[2052]\t   -2,N\t   -1,E\t  "
                                              "195,V\t22.80,Lat\t114.05,Lon\t85.1,Ellh\t0.011, "
                                              "0.012, 0.031\t50,Q\n".replace("22.80,", "22.80000000,"))
    value = registry.read(tmp_path / "f_Timestamp.MRK")
    assert value.shots[0].name == "0001" and value.heights == "ellipsoidal"
    assert value.shots[0].sigma_m is not None and value.shots[0].sigma_m.tolist() == [0.012, 0.011, 0.031]


def test_what_is_not_recognised_names_the_formats(tmp_path: Path) -> None:
    (tmp_path / "x.bin").write_bytes(b"\0\1\2\3" * 50)
    with pytest.raises(PhotogrammetryError, match=r"x\.bin: its format is not recognised.*--from.*colmap"):
        registry.read(tmp_path / "x.bin")
    with pytest.raises(PhotogrammetryError, match="no such file"):
        registry.read(tmp_path / "none")


def test_opf_says_that_tie_points_are_not_read(tmp_path: Path) -> None:
    from .scenes import scene

    write = registry.FORMATS["opf"].write
    assert write is not None
    write(scene(), tmp_path / "site")
    assert not any("glTF" in n for n in registry.read(tmp_path / "site").notes)
    [project] = (tmp_path / "site").glob("*.opf")
    content = json.loads(project.read_text())
    content["items"].append({"id": "f0a8c1f4-6b3c-4ad5-9d6f-0d5f0e0c1a11", "type": "point_cloud", "name": "tracks", "labels": [],
                             "resources": [{"uri": "tracks.gltf", "format": "model/gltf+json"}], "sources": []})
    project.write_text(json.dumps(content))
    assert any("tie points as glTF, which are not read" in n for n in registry.read(tmp_path / "site").notes)
