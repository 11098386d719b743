"""From photos and a list of control points to a block: cameras, images, priors, measurements."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..block import Image, Observations, Points, Prior
from ..cameras import Interior
from ..errors import BadProject, BadTable
from .crs import transformed, utm_zone
from .exif import Exif
from .gcp import ControlList
from .lens import read_lens
from .photos import EXTENSIONS

GPS_SIGMA_M = (5.0, 5.0, 10.0)
"""Stated standard errors of a position in EXIF: navigation GPS."""


def sort_files(files: Sequence[Path]) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Photos (a folder stands for its photos) and the other files: tables, and models of other tools. Raises BadProject."""
    photos: list[Path] = []
    tables: list[Path] = []
    for file in files:
        if file.is_dir():
            inside = sorted(f for f in file.iterdir() if f.suffix.lower() in EXTENSIONS)
            if not inside and _is_model(file):
                tables.append(file)
                continue
            if not inside:
                raise BadProject(f"{file}: there are no photos ({', '.join(EXTENSIONS)}) in it; name the photos themselves")
            photos += inside
        elif not file.exists():
            raise BadProject(f"{file}: there is no such file; correct the path")
        else:
            (photos if file.suffix.lower() in EXTENSIONS else tables).append(file)
    if not photos:
        raise BadProject("there is no photo among the files; name at least one photo, or a folder of photos")
    twice = [p for p, n in Counter(p.resolve() for p in photos).items() if n > 1]
    if twice:
        raise BadProject(f"{twice[0]}: this photo is named twice; name it once")
    return tuple(photos), tuple(tables)


def _is_model(folder: Path) -> bool:
    """Whether a folder without photos is a model of another tool (COLMAP, OPF, MicMac)."""
    names = {f.name for f in folder.iterdir()}
    return bool(names & {"cameras.txt", "cameras.bin"}) or any(n.endswith(".opf") or n.startswith("Orientation-") for n in names)


def image_names(photos: Sequence[Path]) -> tuple[str, ...]:
    """Names of images: the file name without its ending where that is unique, else with it, else with its folder."""
    for name in (lambda p: p.stem, lambda p: p.name, lambda p: f"{p.resolve().parent.name}_{p.name}"):
        names = tuple(name(p).strip() for p in photos)
        if len(set(names)) == len(names):
            return names
    return tuple(f"{n + 1}_{p.name.strip()}" for n, p in enumerate(photos))


def cameras_of(photos: Sequence[Path], exifs: Sequence[Exif], pixel_um: float | None, c_mm: float | None,
               ) -> tuple[dict[str, Interior], tuple[str, ...], tuple[str, ...]]:
    """Cameras, the camera name of each photo, and notes that say where each number comes from.

    Photos of one make, model, focal length and format share a camera. Raises BadProject with the cure when a photo does not
    say its pixel size or its focal length and they are not given.
    """
    cameras: dict[str, Interior] = {}
    keys: dict[tuple[str, Interior], str] = {}
    of, notes = [], []
    for photo, exif in zip(photos, exifs, strict=True):
        pitch = exif.pitch_mm if pixel_um is None else pixel_um * 1e-3
        c = exif.focal_mm if c_mm is None else c_mm
        who = " ".join(dict.fromkeys(f"{exif.make} {exif.model}".split())) or "a camera that EXIF does not name"
        if pitch is None:
            raise BadProject(f"{photo}: the pixel size of {who} is not known; give it in micrometres with --pixel-um")
        if c is None:
            raise BadProject(f"{photo}: EXIF states no focal length; give the principal distance in millimetres with --c-mm")
        lens = read_lens(photo, exif) if pixel_um is None and c_mm is None else None
        interior = Interior(c, pixel_mm=pitch, width=exif.width, height=exif.height) if lens is None else lens[0]
        if (who, interior) not in keys:
            base = re.sub(r"[^a-z0-9]+", "-", (exif.model or "camera").lower()).strip("-") or "camera"
            name = base if base not in cameras else f"{base}-{sum(n.startswith(base) for n in cameras) + 1}"
            keys[who, interior], cameras[name] = name, interior
            source = "given" if c_mm is not None else "EXIF focal length" if lens is None else "XMP"
            rest = "principal point in the centre, no distortion" if lens is None else "principal point and distortion too"
            of_pixels = "given" if pixel_um is not None else exif.pitch_source
            notes.append(f"camera {name}: {exif.width} x {exif.height} pixels of {pitch * 1e3:.4g} micrometres ({of_pixels}), "
                         f"c = {interior.c:.6g} mm ({source}), {rest}")
            notes += lens[1].told(name) if lens is not None else ()
        of.append(keys[who, interior])
    return cameras, tuple(of), tuple(notes)


def home_zone(exifs: Sequence[Exif]) -> str | None:
    """The UTM zone of the photos' mean position, None without any."""
    at = np.array([(e.lat, e.lon) for e in exifs if e.lat is not None and e.lon is not None], float)
    return utm_zone(*np.median(at, axis=0)) if len(at) else None


def plausible(xyz: np.ndarray, crs: str, exifs: Sequence[Exif]) -> bool:
    """Whether control (n, 3) taken in a crs lies within 50 km of the photos' positions."""
    at = np.array([(e.lon, e.lat, 0.0) for e in exifs if e.lat is not None], float).reshape(-1, 3)
    known = xyz[np.isfinite(xyz).all(axis=1)]
    if not len(at) or not len(known):
        return False
    photos = transformed(at, "EPSG:4326", crs)
    return bool(np.hypot(*(np.median(photos, axis=0) - np.median(known, axis=0))[:2]) < 50e3)


def priors_of(exifs: Sequence[Exif], crs: str) -> tuple[Prior | None, ...]:
    """A position prior per photo that states latitude, longitude and height; none in a local crs."""
    out: list[Prior | None] = []
    for exif in exifs:
        if crs == "local" or exif.lat is None or exif.lon is None or exif.alt is None:
            out.append(None)
            continue
        centre = transformed(np.array([[exif.lon, exif.lat, exif.alt]]), "EPSG:4326", crs)[0]
        out.append(Prior(centre=np.round(centre, 3), sigma_m=np.array(GPS_SIGMA_M)))
    return tuple(out)


def measurements(control: ControlList, images: Sequence[Image], photos: Sequence[Path], cameras: Mapping[str, Interior],
                 origin: str) -> tuple[Observations, tuple[str, ...]]:
    """The marks of a control list as observations (pixel centre origin), and notes on marks in photos that were not given.

    Raises BadTable for a mark outside its photo, and when no mark lies in any of the photos.
    """
    index = {p.stem.lower(): i for i, p in enumerate(photos)} | {p.name.lower(): i for i, p in enumerate(photos)}
    points = {name: j for j, name in enumerate(control.names)}
    shift, rows, strangers = (0.5 if origin == "corner" else 0.0), [], Counter[str]()
    for mark in control.marks:
        i = index.get(Path(mark.image).name.lower())
        if i is None:
            strangers[mark.image] += 1
            continue
        camera, pixel = cameras[images[i].camera], np.array([mark.col, mark.row]) - shift
        if not camera.inside(pixel):
            raise BadTable(f"{control.path} line {mark.line}: point '{mark.point}' at col {mark.col:g}, row {mark.row:g} lies "
                           f"outside photo '{mark.image}' of {camera.width} x {camera.height} pixels; give the photo at the "
                           "size it was measured in")
        rows.append((i, points[mark.point], *pixel, mark.sigma))
    if strangers and not rows:
        raise BadTable(f"{control.path}: none of its measurements is in the photos given, they are in {_first(strangers)}; "
                       "name those photos")
    table = np.array(sorted(rows, key=lambda r: r[0]), float).reshape(-1, 5)
    observations = Observations(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:4], table[:, 4])
    if not strangers:
        return observations, ()
    return observations, (f"left out: {strangers.total()} measurements in photos that were not given ({_first(strangers)})",)


def points_of(control: ControlList | None, xyz: np.ndarray) -> Points:
    """The control list as the points of a block, at coordinates (n, 3)."""
    if control is None:
        return Points((), np.empty((0, 3)), np.empty((0, 3)), ())
    return Points(control.names, xyz, control.sigma, control.role)


def _first(names: Mapping[str, int]) -> str:
    return ", ".join(list(names)[:5]) + (" ..." if len(names) > 5 else "")
