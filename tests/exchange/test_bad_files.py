"""Truncated, damaged and enormous files: one sentence that names the file, never another exception."""

from __future__ import annotations

import gzip
import json
import os
import random
import re
from pathlib import Path

import pytest
from PIL import Image

from solvers import PhotogrammetryError
from solvers.io.exchange import registry
from solvers.io.exchange.options import Reading

from .scenes import HANDMADE, MIDDLE, OURS, micmac_folder, scene
from .test_by_hand import MARKERS, PIX4D

TEXTS = {
    "gcp-odm": ("gcp_list.txt", "EPSG:32632\n684210.5 5334100.25 412.1 100.5 50.25 b.JPG P1\n684310.7 5334180.5 418 7 8 b.JPG "
                                "P2\n"),
    "gcp": ("g.csv",
            "name;E;N;H;image;col;row\nA;684210,5;5334100,25;500;a.jpg;10,5;20\nB;684310,5;5334100,25;510;a.jpg;30;40\n"),
    "gcp-pix4dmatic": ("p.csv", "A,48.1,11.5,530,0.01,0.02\nB,48.2,11.6,531,0.01,0.02\n"),
    "qgis": ("D.points", "#CRS: "
                         "EPSG:32632\nmapX,mapY,pixelX,pixelY,enable,dX,dY,residual\n684210.5,5334100.25,100.5,-200.5,1,0,0,0\n"),
    "metashape": ("m.xml", MARKERS), "pix4d": ("x_calibrated_camera_parameters.txt", PIX4D),
    "gcp-opensfm": ("gcp.json", '{"points": [{"id": "a", "position": {"latitude": 48.1, "longitude": 11.5, "altitude": 530}, '
                                '"observations": [{"shot_id": "x.jpg", "projection": [0.1, -0.2]}]}]}'),
    "geo": ("geo.txt", "EPSG:4326\nDSC1.JPG 11.5 48.1 530 10 0 0 0.02 0.03\nDSC2.JPG 11.5 48.1 530 10 0 0 0.02 0.03\n"),
    "mrk": ("f.MRK", "1\t375769.385\t[2052]\t-2,N\t-1,E\t195,V\t22.8,Lat\t114.05,Lon\t85.1,Ellh\t0.011, 0.012, 0.031\t50,Q\n"),
    "cal-pix4d": ("p.cam", "Pix4D camera calibration file 0\n#Focal Length mm assuming a sensor width of 12.8x9.6mm\nF 8.8\n"
                           "#Principal Point mm\nPx 6.5\nPy 4.7\nK1 -0.01\nT1 0.001\n"),
    "cal-australis": ("a.txt", "Australis\nSensor size: 4000 x 3000\nPixel size: 0.0024\nC 8.9\nXP 0.02\nYP -0.03\nK1 1.2e-4\n"),
    "cal-metashape": ("c.xml", "<calibration><projection>frame</projection><width>4000</width><height>3000</height><f>3000</f>"
                               "<cx>10</cx><cy>-5</cy><k1>-0.1</k1></calibration>"),
    "cal-opencv": ("c.yml", "%YAML:1.0\n---\nimage_width: 4000\nimage_height: 3000\ncamera_matrix: !!opencv-matrix\n   rows: 3\n "
                            "  cols: 3\n"
                            "   dt: d\n   data: [ 3000., 0., 1999., 0., 3000., 1499., 0., 0., 1. ]\n"),
    "cal-micmac": ("AutoCal_Foc-8800.xml", '<?xml version="1.0" ?><ExportAPERO><CalibrationInternConique>'
                   "<KnownConv>eConvApero_DistM2C</KnownConv><PP>1999.5 1499.5</PP><F>3000</F><SzIm>4000 3000</SzIm>"
                   "<CalibDistortion><ModRad><CDist>1999.5 1499.5</CDist><CoeffDist>1e-9</CoeffDist><CoeffDist>-2e-16</CoeffDist>"
                   "</ModRad></CalibDistortion></CalibrationInternConique></ExportAPERO>"),
}
WRITTEN = {"colmap": ("m", "images.txt"), "colmap-bin": ("m", "images.bin"), "opf": ("m", "calibrated_cameras.json"),
           "blocks": ("b.xml", ""), "nerfstudio": ("transforms.json", ""), "bundler": ("bundle.out", ""), "bal": ("p.txt", ""),
           "opk-metashape": ("o.txt", ""), "patb": ("o.ori", ""), "gcp-geojson": ("g.geojson", "")}
KINDS = [*TEXTS, *WRITTEN, *HANDMADE, "micmac", "dewarp"]
DEWARP = (b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
          b'<rdf:Description rdf:about="" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:DewarpFlag="0" '
          b'drone-dji:DewarpData="2022-06-08;305.5,305.2,1.5,-2.1,-0.11,0.015,0.0001,-0.0001,-0.02"/>'
          b'</rdf:RDF></x:xmpmeta>')
OPTIONS = Reading(crs="EPSG:32632", size=(4000, 3000))


def made(kind: str, folder: Path) -> tuple[Path, Path]:
    """What is read, and the file in it that is damaged."""
    if kind == "micmac":
        path = micmac_folder(scene(OURS), folder / "Ori-X")
        return path, path / "Orientation-DSC01.JPG.xml"
    if kind == "dewarp":
        path = folder / "DJI_0001.JPG"
        Image.new("RGB", (400, 300)).save(path, xmp=DEWARP)
        return path, path
    if kind in TEXTS:
        path = folder / TEXTS[kind][0]
        path.write_text(TEXTS[kind][1])
        return path, path
    if kind in HANDMADE:
        name, write = HANDMADE[kind]
        path = write(scene(crs="EPSG:32632"), folder / name)
        return path, path
    name, part = WRITTEN[kind]
    write = registry.FORMATS[kind].write
    assert write is not None
    write(scene(MIDDLE, crs="EPSG:32632"), folder / name)
    return folder / name, folder / name / part if part else folder / name


def refused(path: Path, kind: str | None) -> None:
    """Either it is read, or one sentence that names a file says why not."""
    try:
        registry.read(path, kind, OPTIONS)
    except PhotogrammetryError as error:
        text = str(error)
        assert "\n" not in text and "Traceback" not in text and len(text) < 1500, text
        assert ";" in text or "," in text, text
        assert str(path) in text, text


@pytest.mark.parametrize("kind", KINDS)
def test_the_whole_file_is_read(tmp_path: Path, kind: str) -> None:
    path, _ = made(kind, tmp_path)
    value = registry.read(path, kind, OPTIONS)
    assert value.shots or value.cameras or len(value.points)


@pytest.mark.parametrize("kind", KINDS)
def test_truncated(tmp_path: Path, kind: str) -> None:
    path, part = made(kind, tmp_path)
    data = part.read_bytes()
    for share in (0.0, 0.03, 0.1, 0.27, 0.5, 0.73, 0.9, 0.97, 0.995):
        part.write_bytes(data[:int(len(data) * share)])
        refused(path, kind)
        refused(path, None)


@pytest.mark.parametrize("kind", KINDS)
def test_garbage(tmp_path: Path, kind: str) -> None:
    path, part = made(kind, tmp_path)
    data, rng = part.read_bytes(), random.Random(7)
    words = [b"NaN", b"1e999", b"-1", b"x", b"", b"0", b"\xff\xfe", b"null", b"{}", b"99999999999999999999", b"\0", b",", b"inf"]
    numbers = [m.span() for m in re.finditer(rb"-?\d+(\.\d+)?", data)] or [(0, 1)]
    for _ in range(30):
        a, b = rng.choice(numbers)
        part.write_bytes(data[:a] + rng.choice(words) + data[b:])
        refused(path, kind)
        at = rng.randrange(len(data))
        part.write_bytes(data[:at] + bytes(rng.randrange(256) for _ in range(rng.randrange(1, 9))) + data[at + rng.randrange(9):])
        refused(path, kind)
    part.write_bytes(os.urandom(3000))
    refused(path, kind)
    refused(path, None)


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "dewarp"])
def test_a_gigabyte_is_refused_before_it_is_read(tmp_path: Path, kind: str) -> None:
    path, part = made(kind, tmp_path)
    with open(part, "r+b") as stream:
        stream.truncate(2**30 + 1)  # sparse
    with pytest.raises(PhotogrammetryError, match=r"1024 MB|1 GB|larger"):
        registry.read(path, kind, OPTIONS)


def test_a_gigabyte_of_anything_is_refused_by_its_size(tmp_path: Path) -> None:
    for name in ("big.csv", "big.xml", "big.json", "big.bin"):
        with open(tmp_path / name, "wb") as stream:
            stream.truncate(2**30)
        with pytest.raises(PhotogrammetryError, match=r"1024 MB and at most 256 MB are read"):
            registry.read(tmp_path / name)


def test_entities_are_refused(tmp_path: Path) -> None:
    head, tail = '<?xml version="1.0"?><!DOCTYPE d [', "]><document><chunk>&a;</chunk></document>"
    bomb = head + '<!ENTITY b "bbbbbbbbbb"><!ENTITY a "&b;&b;&b;&b;">' + tail
    outside = head + '<!ENTITY a SYSTEM "file:///etc/hostname">' + tail
    for text in (bomb, outside):
        (tmp_path / "b.xml").write_text(text)
        with pytest.raises(PhotogrammetryError, match=r"b\.xml: its XML defines entities"):
            registry.read(tmp_path / "b.xml")


def test_announced_counts_are_not_believed(tmp_path: Path) -> None:
    path, part = made("colmap-bin", tmp_path)
    data = part.read_bytes()
    part.write_bytes(b"\xff" * 8 + data[8:])
    with pytest.raises(PhotogrammetryError, match=r"images\.bin byte 8: .*announced"):
        registry.read(path)
    (tmp_path / "bundle.out").write_text("# Bundle file v0.3\n1000000 20000000\n")
    with pytest.raises(PhotogrammetryError, match=r"bundle\.out line 2"):
        registry.read(tmp_path / "bundle.out")


def test_deep_nesting(tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text('{"a":' + "[" * 100000)
    with pytest.raises(PhotogrammetryError, match=r"d\.json"):
        registry.read(tmp_path / "d.json", "opensfm")


def test_files_outside_are_not_read(tmp_path: Path) -> None:
    """A project of another tool names files beside it; what it names elsewhere, or what is no photo, is not opened."""
    from solvers.workflows_exchange import Wanted, convert

    home = tmp_path / "in"
    home.mkdir()
    (tmp_path / "secret.json").write_text("{}")
    item = {"resources": [{"uri": "../secret.json", "format": "application/opf-camera-list+json"}]}
    (home / "project.opf").write_text(json.dumps({"format": "application/opf-project+json", "items": [item]}))
    with pytest.raises(PhotogrammetryError, match="outside the project's folder"):
        registry.read(home)
    frame = {"file_path": "../secret.json", "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}
    (home / "transforms.json").write_text(json.dumps({"w": 8, "h": 8, "fl_x": 9, "frames": [frame]}))
    convert(home / "transforms.json", tmp_path / "site", Wanted(crs="local"))
    assert "file =" not in (tmp_path / "site" / "project.toml").read_text()


def test_empty_and_overfull_files(tmp_path: Path) -> None:
    (tmp_path / "e.csv").write_text("\n \n")
    with pytest.raises(PhotogrammetryError, match=r"e\.csv: the file is empty"):
        registry.read(tmp_path / "e.csv")
    full = gzip.compress(b"49 7776 31843\n0 0 1.0 2.0\n" + b"0 " * (33 * 2**20), 1)  # 66 MB in a few bytes
    (tmp_path / "p.gz").write_bytes(full)
    with pytest.raises(PhotogrammetryError, match="holds more than 64 MB"):
        registry.read(tmp_path / "p.gz")
