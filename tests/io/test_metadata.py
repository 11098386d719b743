"""Flight data: XMP of every vendor, damage, clocks, .MRK, tables, logs, height grids."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from solvers.errors import BadProject, BadTable, Unsupported
from solvers.io import find_geoid, read_flight_log, read_mrk, read_onboard, read_positions, read_surface, write_heights
from solvers.io.metadata import clock

HEAD = '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
TAIL = "</rdf:RDF></x:xmpmeta>"
DJI = HEAD + '''xmlns:d="http://www.dji.com/drone-dji/1.0/" d:AbsoluteAltitude="+512.31" d:RelativeAltitude="+80.00"
 d:GimbalRollDegree="+1.50" d:GimbalYawDegree="-132.00"
 d:GimbalPitchDegree="-89.90" d:FlightRollDegree="+0.90" d:FlightYawDegree="-129.9"
 d:FlightPitchDegree="-1.6" {extra}/>''' + TAIL
RTK = ('d:RtkFlag="50" d:RtkStdLon="0.011" d:RtkStdLat="0.012" d:RtkStdHgt="0.025" d:GpsLatitude="+47.123456789" '
       'd:GpsLongtitude="+8.987654321"')


def photo(path: Path, xmp: str | bytes = "", make: str = "DJI", gps: bool = True, when: str = "2024:05:06 07:08:09") -> Path:
    """A small JPEG with EXIF and XMP."""
    exif = Image.Exif()
    exif[271], exif[272] = make, "Test"
    exif.get_ifd(0x8769)[36867] = when
    exif.get_ifd(0x8769)[37521] = "25"
    if gps:
        exif.get_ifd(0x8825).update({1: "N", 2: (47.0, 7.0, 24.44), 3: "W", 4: (8.0, 59.0, 15.56), 5: b"\0", 6: 498.0})
    packet = xmp.encode() if isinstance(xmp, str) else xmp
    if packet:
        Image.new("RGB", (32, 24)).save(path, exif=exif, xmp=packet)
    else:
        Image.new("RGB", (32, 24)).save(path, exif=exif)
    return path


def test_dji(tmp_path: Path) -> None:
    o = read_onboard(photo(tmp_path / "a.jpg", DJI.format(extra="")))
    assert o.image == "a" and o.mount == "gimbal" and o.attitude == (-132.0, -89.9, 1.5) and o.body == (-129.9, -1.6, 0.9)
    assert o.height == 498.0 and o.datum == "barometric" and o.relative == 80.0 and o.sigma_m is None
    assert o.lat is not None and abs(o.lat - 47.1234555555) < 1e-9 and o.lon is not None and o.lon < 0
    assert o.time is not None and abs(o.time % 60 - 9.25) < 1e-6
    assert any("barometric" in s for s in o.stated)


def test_dji_rtk(tmp_path: Path) -> None:
    """RTK: the tags' standard errors, the ellipsoidal height, all digits of the position, the old spelling of longitude."""
    o = read_onboard(photo(tmp_path / "a.jpg", DJI.format(extra=RTK)))
    assert o.sigma_m == (0.011, 0.012, 0.025) and o.datum == "ellipsoidal" and o.height == 512.31
    assert (o.lat, o.lon) == (47.123456789, 8.987654321) and any("RtkStd" in s for s in o.stated)
    for flag, across in (("50", 0.02), ("34", 0.5), ("45", 0.5), ("16", 3.0)):
        o = read_onboard(photo(tmp_path / "a.jpg", DJI.format(extra=f'd:RtkFlag="{flag}"')))
        assert o.sigma_m is not None and o.sigma_m[0] == across and any(f"assumed for RtkFlag {flag}" in s for s in o.stated)


def test_pix4d_sensefly_parrot(tmp_path: Path) -> None:
    """Camera tags as attributes or as elements; fractions; senseFly's roll is turned; Parrot's camera is a gimbal."""
    tags = {"Yaw": "-40.5", "Pitch": "2.75", "Roll": "-5.75", "GPSXYAccuracy": "329/100", "GPSZAccuracy": "4.1",
            "IMUYawAccuracy": "4", "IMURollAccuracy": "1", "IMUPitchAccuracy": "1.5"}
    space = 'xmlns:C="http://pix4d.com/camera/1.0"'
    by_attribute = HEAD + space + " ".join(f' C:{k}="{v}"' for k, v in tags.items()) + "/>" + TAIL
    by_element = HEAD + space + ">" + "".join(f"<C:{k}>{v}</C:{k}>" for k, v in tags.items()) + "</rdf:Description>" + TAIL
    for xmp in (by_attribute, by_element):
        o = read_onboard(photo(tmp_path / "a.jpg", xmp, make="Parrot"))
        assert o.mount == "nadir" and o.attitude == (-40.5, 2.75, -5.75) and o.sigma_deg == (1.5, 1.5, 4.0)
        assert o.sigma_m == (3.29, 3.29, 4.1) and o.datum == "unknown"
    sensefly = read_onboard(photo(tmp_path / "s.jpg", by_attribute, make="senseFly"))
    assert sensefly.attitude == (-40.5, 2.75, 5.75) and any("senseFly" in s for s in sensefly.stated)
    parrot = HEAD + ('xmlns:p="http://www.parrot.com/drone-parrot/1.0/" p:CameraYawDegree="10" p:CameraPitchDegree="-90" '
                     'p:CameraRollDegree="0"/>') + TAIL
    assert read_onboard(photo(tmp_path / "p.jpg", parrot, make="Parrot")).mount == "gimbal"


def test_damage_and_absence(tmp_path: Path) -> None:
    """No XMP, broken XMP, an entity bomb: the position stays and the damage is said."""
    bomb = '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'
    for k, (xmp, said) in enumerate((("", False), ("<x:xmpmeta", True), (bomb, True), (b"\xff\xfe<", True))):
        o = read_onboard(photo(tmp_path / f"{k}.jpg", xmp))
        assert o.lat is not None and o.attitude is None and any("XMP is damaged" in s for s in o.stated) == said
    assert read_onboard(photo(tmp_path / "n.jpg", gps=False)).lat is None
    (tmp_path / "x.jpg").write_text("no photo")
    with pytest.raises(Unsupported):
        read_onboard(tmp_path / "x.jpg")


def test_clock() -> None:
    same = [clock(t) for t in ("2016:07:29 07:13:49.5", "2016-07-29T07:13:49.5", "2016/07/29 07:13:49.5",
                               "2016-07-29T09:13:49.5+02:00")]
    assert same == [same[0]] * 4 and clock("123.25") == 123.25 and clock("soon") is None and clock("nan") is None


MRK = ("1\t290321.6\t[2010]\t  -10,N\t   20,E\t  190,V\t47.10000000,Lat\t8.20000000,Lon\t512.310,Ellh\t0.011, 0.012, "
       "0.025\t50,Q\n"
       "2\t290324.6\t[2010]\t    0,N\t    0,E\t    0,V\t47.10010000,Lat\t8.20010000,Lon\t512.410,Ellh\t0.013, 0.014, "
       "0.026\t50,Q\n")


def test_mrk(tmp_path: Path) -> None:
    (tmp_path / "t.MRK").write_text(MRK)
    a, b = read_mrk(tmp_path / "t.MRK", ["p1", "p2"])
    assert (a.image, a.lat, a.lon, a.height, a.datum, a.time) == ("p1", 47.1, 8.2, 512.31, "ellipsoidal", 290321.6)
    assert a.sigma_m == (0.012, 0.011, 0.025) and b.lat == 47.1001
    ppk, _ = read_mrk(tmp_path / "t.MRK", ["p1", "p2"], ppk=True)
    assert ppk.lat is not None and ppk.lon is not None and ppk.height is not None
    north, east = np.radians(ppk.lat - 47.1) * 6.371e6, np.radians(ppk.lon - 8.2) * 6.371e6 * np.cos(np.radians(47.1))
    np.testing.assert_allclose([north, east, ppk.height - 512.31], [-0.010, 0.020, -0.190], atol=1e-6)
    with pytest.raises(BadTable, match="2 lines for 1 photos"):
        read_mrk(tmp_path / "t.MRK", ["p1"])
    (tmp_path / "u.MRK").write_text("1 2 3\n")
    with pytest.raises(BadTable, match="line 1: expected number, time"):
        read_mrk(tmp_path / "u.MRK", ["p1"])


def test_tables_of_positions(tmp_path: Path) -> None:
    file = tmp_path / "geo.txt"
    file.write_text("EPSG:32632\nDJI_1.JPG 439197.0 5205565.0 512.0 30 1 2 0.5 0.9 extra\nDJI_2.JPG 439200 5205565\n")
    a, b = read_positions(file)
    assert a.image == "DJI_1" and a.attitude == (30, 1, 2) and a.sigma_m == (0.5, 0.5, 0.9) and a.mount == "nadir"
    assert a.lat is not None and abs(a.lat - 47.0) < 0.01 and b.height is None and b.attitude is None
    file.write_text("lat\tlon\timg\n-25 36 21.73\t-49 25 17.51\tIMG_1.JPG\n25°36'21.73\"S\t49°25'17.51\"W\tIMG_2.JPG\n")
    a, b = read_positions(file)
    assert a.lat == b.lat and a.lon == b.lon and a.lat is not None and abs(a.lat + 25.60603611) < 1e-8 and a.height is None
    for text, words in (("lat,lon\n1,2\n", "no column for image"), ("image,lat,lon\na,north,2\n", "line 2: 'north' is no number"),
                        ("image,lat,lon\na,99,2\n", "no place on earth"), ("image,lat,lon\na,9\n", "2 cells where"),
                        ("", "empty")):
        file.write_text(text)
        with pytest.raises(BadTable, match=words):
            read_positions(file)


def test_flight_log(tmp_path: Path) -> None:
    """Columns by any usual name; rows in the order of time, once each; triggers; incomplete rows left out."""
    file = tmp_path / "log.csv"
    file.write_text("TimeUS;Lat;Lng;Alt;Roll;Pitch;Yaw;Event\n2000000;47.2;8.2;500;1;2;359;0\n1000000;47.1;8.1;499;1;2;358;1\n"
                    "2000000;47.2;8.2;500;1;2;359;0\n3000000;;8.3;501;1;2;3;0\n")
    log = read_flight_log(file)
    np.testing.assert_allclose(log.time, [1, 2])
    np.testing.assert_allclose(log.degrees, [[8.1, 47.1, 499], [8.2, 47.2, 500]])
    np.testing.assert_allclose(log.attitude[0], [358, 2, 1])
    assert log.trigger.tolist() == [True, False]
    file.write_text("time,lat,lon\n1,2,3\n")
    with pytest.raises(BadTable, match="fewer than two lines"):
        read_flight_log(file)


def test_surface(tmp_path: Path) -> None:
    """A height grid keeps its heights, places and crs, whole or in part."""
    z = np.random.default_rng(0).uniform(0, 9, (30, 40)).astype(np.float32)
    write_heights(tmp_path / "dem.tif", z, 500000.0, 5200000.0, 2.0, "EPSG:32632")
    whole = read_surface(tmp_path / "dem.tif", sigma=0.2)
    part = read_surface(tmp_path / "dem.tif", (500020.0, 5199960.0, 500040.0, 5199980.0))
    assert whole.grid.crs == "EPSG:32632" and whole.z.shape == (30, 40) and part.z.size < 300 and whole.sigma == 0.2
    at = np.array([[500020.0, 5199980.0], [500033.3, 5199966.6], [500040.0, 5199960.0]])
    np.testing.assert_allclose(part.sample(at), whole.sample(at), atol=1e-12)
    assert abs(whole.sample(at)[0] - z[10, 10]) < 1e-6
    with pytest.raises(BadProject, match="no cells at this place"):
        read_surface(tmp_path / "dem.tif", (0, 0, 10, 10))
    with pytest.raises(BadProject, match="no such height grid"):
        read_surface(tmp_path / "none.tif")
    found = find_geoid()
    assert found is None or found.is_file()
