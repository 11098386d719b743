"""Every format by name: how it is recognised, read and written."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import BadTable, PhotogrammetryError
from ..bal import packed, unpacked_head
from ..files import MAX_BYTES
from ..gcp import IMAGE, is_crs
from ..photos import EXTENSIONS
from ..tables import NUMBER
from . import (
    blocks,
    bundler,
    calibration,
    colmap,
    control,
    metashape,
    micmac,
    nerf,
    opensfm,
    opf,
    opk,
    pix4d,
    positions,
    solid,
)
from .conventions import AngleOrder, AngleUnit
from .options import NOTHING, Reading
from .scene import Exchange
from .structure import AGAIN

Read = Callable[[Path, Reading], Exchange]
Write = Callable[[Exchange, Path], tuple[str, ...]]
HEAD = 65536


@dataclass(frozen=True)
class Format:
    """A format: what it holds ("cameras", "orientations", "points", "marks"), and its reader and writer where it has them."""

    title: str
    holds: tuple[str, ...]
    read: Read | None = None
    write: Write | None = None
    folder: bool = False


def _opk(style: str, order: AngleOrder = AngleOrder.OPK, unit: AngleUnit = AngleUnit.DEGREES) -> Write:
    return lambda scene, path: opk.write(scene, path, style, order, unit)


def _micmac_camera(path: Path, options: Reading) -> Exchange:
    from .structure import read_xml

    root = read_xml(path)
    inner = root if root.tag == "CalibrationInternConique" else root.get("CalibrationInternConique")
    camera, fit = micmac.interior_of(inner)
    return Exchange("MicMac calibration", path, None, {path.stem: camera}, notes=fit.told(path.stem))


def _calibration(write: Callable[[Any], tuple[str, tuple[str, ...]]]) -> Write:
    """A writer of the one camera of a scene."""
    def written(scene: Exchange, path: Path) -> tuple[str, ...]:
        from ..files import write_text

        if len(scene.cameras) != 1:
            raise BadTable(f"{path}: this format holds one camera and there are {len(scene.cameras)}; take a format that holds "
                           f"several, "
                           "such as blocks")
        text, notes = write(next(iter(scene.cameras.values())))
        write_text(path, text)
        return notes

    return written


ALL = ("cameras", "orientations", "points", "marks")
POSES = ("cameras", "orientations")
CONTROL = ("points", "marks")

FORMATS: dict[str, Format] = {
    "colmap": Format("COLMAP sparse model, text", ALL, lambda p, o: colmap.read(p), colmap.write_txt, True),
    "colmap-bin": Format("COLMAP sparse model, binary", ALL, lambda p, o: colmap.read(p), colmap.write_bin, True),
    "opf": Format("Open Photogrammetry Format (project.opf)", ALL, opf.read, opf.write, True),
    "blocks": Format("BlocksExchange XML", ALL, blocks.read, blocks.write),
    "metashape": Format("Metashape XML: cameras and markers", ALL, metashape.read),
    "metashape-csv": Format("Metashape reference CSV: markers", ("points",), control.read_list, control.write_metashape_csv),
    "opk": Format("OPK table, any columns", ("orientations",), opk.read, _opk("table")),
    "opk-metashape": Format("OPK text of Metashape", ("orientations",), opk.read, _opk("metashape")),
    "opk-pix4d": Format("OPK text of Pix4D", ("orientations",), opk.read, _opk("pix4d")),
    "pok": Format("phi, omega, kappa table", ("orientations",), opk.read, _opk("table", AngleOrder.POK)),
    "opk-gon": Format("OPK table in gon", ("orientations",), opk.read, _opk("table", unit=AngleUnit.GON)),
    "patb": Format("PATB orientations with matrices", ("orientations",), opk.read_patb, _opk("patb")),
    "pix4d": Format("Pix4D calibrated_camera_parameters.txt", POSES, pix4d.read, pix4d.write),
    "opensfm": Format("OpenSfM reconstruction.json", ("cameras", "orientations", "points"), opensfm.read),
    "shots": Format("OpenDroneMap shots.geojson", POSES, opensfm.read_shots),
    "bundler": Format("Bundler bundle.out", ALL, bundler.read, bundler.write),
    "bal": Format("bundle adjustment in the large", ALL, bundler.read_bal_problem, bundler.write_bal),
    "micmac": Format("MicMac Ori folder", POSES, micmac.read, None, True),
    "nerfstudio": Format("nerfstudio transforms.json", POSES, nerf.read, nerf.write),
    "gcp-odm": Format("OpenDroneMap gcp_list.txt", CONTROL, control.read_list, control.write_odm),
    "gcp": Format("control points, any table", CONTROL, control.read_list, control.write_table),
    "gcp-pix4dmatic": Format("PIX4Dmatic GCPs", ("points",), control.read_pix4dmatic, control.write_pix4dmatic),
    "gcp-opensfm": Format("OpenSfM ground_control_points.json", CONTROL, control.read_opensfm),
    "gcp-geojson": Format("control points as GeoJSON", CONTROL, control.read_geojson, control.write_geojson),
    "qgis": Format("QGIS .points", CONTROL, control.read_qgis, control.write_qgis),
    "geo": Format("positions: geo.txt or a table", (), positions.read_geo),
    "mrk": Format("DJI .MRK", (), positions.read_dji),
    "exif": Format("EXIF and XMP of photos", (), lambda p, o: positions.read_photos(_photos(p), o), None, True),
    "dewarp": Format("DJI DewarpData of a photo", ("cameras",), calibration.read_dewarp),
    "cal-opencv": Format("OpenCV calibration", ("cameras",), calibration.read_opencv,
                         _calibration(calibration.write_opencv)),
    "cal-metashape": Format("Metashape calibration XML", ("cameras",), metashape.read_calibration,
                            _calibration(metashape.calibration_text)),
    "cal-pix4d": Format("Pix4D .cam", ("cameras",), calibration.read_cam),
    "cal-australis": Format("Australis or iWitness calibration", ("cameras",), calibration.read_australis,
                            _calibration(calibration.write_australis)),
    "cal-micmac": Format("MicMac calibration XML", ("cameras",), _micmac_camera),
    "glb": Format("glTF 2.0 scene", ("orientations", "points"), None, solid.write_glb),
    "ply": Format("PLY scene", ("orientations", "points"), None, solid.write_ply),
}
"""What `convert` reads and writes beside project folders; dxf, world and footprints need the ground: the workflow makes them."""


def _photos(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    found = sorted(f for f in path.iterdir() if f.suffix.lower() in EXTENSIONS)
    if not found:
        raise BadTable(f"{path}: there are no photos in this folder; name the folder of the photos")
    return found


def read(path: Path | str, name: str | None = None, options: Reading = NOTHING) -> Exchange:
    """A file or folder of another tool, its format found out or given by name. Raises PhotogrammetryError, nothing else."""
    path = Path(path)
    if not path.exists():
        raise BadTable(f"{path}: there is no such file or folder; correct the path")
    if name is not None and (name not in FORMATS or FORMATS[name].read is None):
        raise BadTable(f"--from {name}: this format is not read; choose from "
                       f"{', '.join(k for k, f in FORMATS.items() if f.read)}")
    name = name or of_mapping(sniff(path), options.mapping)
    _bounded(path, name)
    reader = FORMATS[name].read
    assert reader is not None
    try:
        with np.errstate(all="ignore"):
            scene = reader(path, options)
    except PhotogrammetryError as error:
        if str(path) in str(error):
            raise
        raise type(error)(f"{path}: {error}") from None
    except OSError as error:
        raise BadTable(f"{path}: it cannot be read ({error.strerror or error}); check the path and its permissions") from None
    except (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError, RecursionError, AssertionError,
            np.linalg.LinAlgError) as error:
        raise BadTable(f"{path}: its content is not that of {FORMATS[name].title} ({type(error).__name__}: "
                       f"{' '.join(str(error).split())[:120]}); export it again, or name its format with --from") from None
    return scene if scene.crs or not options.crs else replace(scene, crs=options.crs)


def of_mapping(name: str, mapping: str | None) -> str:
    """The format of a file found out as `name`, when a person says its columns: a table of orientations or of control points."""
    if mapping is None or name not in ("gcp", "geo", "opk", "patb", "bal"):
        return name
    return "opk" if {p.partition("=")[0].strip() for p in mapping.split(",")} & {"omega", "phi", "kappa"} else "gcp"


def _bounded(path: Path, name: str) -> None:
    """Raises BadTable for a file that is too large to be what it should be, before it is read; photos are read by their heads."""
    size = path.stat().st_size if path.is_file() else 0
    if size > MAX_BYTES and name not in ("exif", "dewarp"):
        raise BadTable(f"{path}: the file has {size / 2**20:.0f} MB and at most {MAX_BYTES // 2**20} MB are read; {AGAIN}")


def sniff(path: Path) -> str:
    """The name of a file's or folder's format. Raises BadTable when it is none that is known."""
    _bounded(path, "exif" if path.suffix.lower() in EXTENSIONS else "")
    found = _folder(path) if path.is_dir() else _file(path)
    if found is None:
        raise BadTable(f"{path}: its format is not recognised; name it with --from, one of "
                       f"{', '.join(k for k, f in FORMATS.items() if f.read)}")
    return found


def _folder(path: Path) -> str | None:
    names = {f.name for f in path.iterdir()}
    if {"cameras.bin", "images.bin"} <= names:
        return "colmap-bin"
    if {"cameras.txt", "images.txt"} <= names:
        return "colmap"
    if any(n.endswith(".opf") for n in names):
        return "opf"
    if any(n.startswith("Orientation-") and n.endswith(".xml") for n in names):
        return "micmac"
    return "exif" if any(Path(n).suffix.lower() in EXTENSIONS for n in names) else None


def _file(path: Path) -> str | None:
    ending = path.suffix.lower()
    if path.name in ("cameras.bin", "images.bin", "points3D.bin"):
        return "colmap-bin"
    if path.name in ("cameras.txt", "images.txt", "points3D.txt") and (path.parent / "images.txt").exists():
        return "colmap"
    by_ending = {".opf": "opf", ".mrk": "mrk", ".points": "qgis", ".cam": "cal-pix4d"} | dict.fromkeys(EXTENSIONS, "exif")
    if ending in by_ending:
        return by_ending[ending]
    try:
        with open(path, "rb") as stream:
            raw = stream.read(HEAD)
    except OSError as error:
        raise BadTable(f"{path}: it cannot be read ({error.strerror or error}); check its permissions") from None
    if not raw.strip():
        raise BadTable(f"{path}: the file is empty; export it again")
    if packed(raw):
        return "bal" if bundler.looks_like_bal(unpacked_head(path).splitlines()) else None
    head = _decoded(raw)
    text = head.lstrip()
    if text.startswith("<"):
        return _xml(path, text)
    if text.startswith(("{", "[")):
        return _json(text)
    return _text(head)


def _decoded(raw: bytes) -> str:
    """The beginning of a file as text: UTF-16, UTF-8 (which may end within a letter) or Windows-1252."""
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", "replace").lstrip("\ufeff")
    text = raw.decode("utf-8", "replace")
    if "\ufffd" in text[:-1] and b"\0" not in raw:
        text = raw.decode("cp1252", "replace")
    return text.removesuffix("\ufffd").lstrip("\ufeff")


def _xml(path: Path, head: str) -> str | None:
    tests = {"cal-opencv": "<opencv_storage" in head, "metashape": metashape.looks_like(head), "blocks": blocks.looks_like(head),
             "micmac": micmac.looks_like(path, head) and "<OrientationConique" in head,
             "cal-micmac": "<CalibrationInternConique" in head,
             "cal-metashape": "<calibration" in head}
    return next((name for name, yes in tests.items() if yes), None)


def _json(head: str) -> str | None:
    kind = opensfm.looks_like(head)
    tests = {"opf": opf.looks_like(head), **({kind: True} if kind else {}), "gcp-opensfm": control.looks_like_opensfm(head),
             "nerfstudio": nerf.looks_like(head), "gcp-geojson": control.looks_like_geojson(head),
             "cal-opencv": calibration.looks_like_opencv(head)}
    return next((name for name, yes in tests.items() if yes), None)


def _text(head: str) -> str | None:
    lines = [line for line in head.splitlines() if line.strip()]
    content = [line for line in lines if not line.lstrip().startswith("#")]
    first = content[0] if content else ""
    if is_crs(first):
        second = content[1].split() if len(content) > 1 else []
        return "gcp-odm" if len(second) >= 6 and NUMBER.fullmatch(second[0]) and not NUMBER.fullmatch(second[5]) else \
            "geo" if len(second) >= 3 else "gcp-odm"
    tests = {"cal-opencv": head.startswith("%YAML") or calibration.looks_like_opencv(head), "bundler": bundler.looks_like(head),
             "pix4d": pix4d.looks_like(head), "cal-pix4d": calibration.looks_like_cam(head),
             "cal-australis": calibration.looks_like_australis(head), "qgis": control.looks_like_qgis(head),
             "opk": opk.looks_like(Path(), head), "patb": opk.looks_like_patb(head),
             "bal": bundler.looks_like_bal(content),
             "mrk": bool(re.search(r",\s*Lat\b.*,\s*Lon\b.*,\s*Ellh\b", first)),
             "geo": any(_positions(line.lstrip("# \t")) for line in [*_comments(lines), first])}
    found = next((name for name, yes in tests.items() if yes), None) or ("opk" if _bare_angles(content) else None)
    return found or ("gcp" if content and "\0" not in head and "\ufffd" not in head else None)


def _comments(lines: list[str]) -> list[str]:
    """The comments before the content."""
    return list(takewhile(lambda line: line.lstrip().startswith("#"), lines))


def _bare_angles(lines: list[str]) -> bool:
    """Whether lines without a header are image, X, Y, Z and three angles: the first names photos, or one of the last is negative
    or above 10, so they are no standard errors."""
    rows = [re.split(r"[,;\t]\s*|\s+", line.strip()) for line in lines[:200]]
    if not rows or any(len(r) != 7 or not all(NUMBER.fullmatch(c) for c in r[1:]) for r in rows):
        return False
    last = np.array([[float(c) for c in r[4:]] for r in rows])
    return bool(np.abs(last).max() <= 400 and ((last < 0).any() or last.max() > 10 or all(IMAGE.search(r[0]) for r in rows)))


def _positions(header: str) -> bool:
    """Whether a header names photos with their places: with latitude and longitude, with angles, or photos and no points."""
    keys = {re.sub(r"[^a-z]", "", c.lower()) for c in re.split(r"[,;\t]" if re.search(r"[,;\t]", header) else r"\s+", header)}
    photo = keys & {"image", "imagename", "photo", "photoname", "filename", "file", "img"}
    degrees, plain = keys & {"lat", "latitude"} and keys & {"lon", "lng", "long", "longitude"}, {"x", "y"} <= keys
    point = keys & {"name", "id", "label", "point", "gcp", "gcplabel", "gcpname", "marker"}
    measured = keys & {"col", "row", "px", "py", "imx", "imy", "pixelx", "pixely"}
    turned = any(k.startswith("yaw") for k in keys) and any(k.startswith("pitch") for k in keys)
    return not measured and bool((degrees or plain) and (turned or (photo and (degrees or not point))))
