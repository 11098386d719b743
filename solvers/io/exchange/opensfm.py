"""OpenSfM's and OpenDroneMap's reconstruction.json, and OpenDroneMap's shots.geojson.

A shot's rotation is a rotation vector, its translation t = -R C: object axes into x right, y down, z forward. Focal lengths,
principal points and tracks are divided by the longer side, from the image centre. The object frame is local (east, north, up at
reference_lla). In shots.geojson the "translation" is the perspective centre in UTM, the rotation the same. References:
opensfm.org/docs/geometry.html; OpenDroneMap opendm/shots.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...cameras.brown import Brown
from ...errors import PhotogrammetryError, Unsupported
from ...geometry import Exterior, exp
from ..crs import transformed, utm_zone
from ..geocentric import axes_at, from_geocentric, to_geocentric
from . import exact
from .conventions import CameraAxes, Position, RotationDirection, exterior_from, exterior_of
from .options import NOTHING, Reading
from .scene import Camera, Exchange, Shot, named, no_observations, points_from
from .structure import Item, read_json

CONVENTION = (CameraAxes.VISION, RotationDirection.OBJECT_TO_CAMERA, Position.TRANSLATION)
FISHEYE = "undistort the photos first (opensfm undistort) and take the reconstruction of those"


def looks_like(head: str) -> str | None:
    """"opensfm", "shots" or None, of the beginning of a JSON."""
    if '"FeatureCollection"' in head and '"translation"' in head and '"rotation"' in head:
        return "shots"
    return "opensfm" if '"projection_type"' in head and ('"shots"' in head or head.lstrip().startswith("[")) else None


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """The first reconstruction of the file; georeferenced by its reference_lla. Raises BadTable and Unsupported."""
    root = read_json(path)
    parts = root.entries() if isinstance(root.value, list) else [root]
    if not parts:
        raise root.error("is empty")
    part = parts[0]
    cameras = {k: camera_of(c) for k, c in part.get("cameras").members()}
    crs, place, notes = _reference(part, path, options)
    items = list(part.get("shots").members())
    shots = []
    for (_, shot), (name, file) in zip(items, named([label for label, _ in items]), strict=True):
        at = _pose(shot)
        camera = shot.get("camera").text()
        if camera not in cameras:
            raise shot.error(f"has camera '{camera}', which the file does not have")
        shots.append(Shot(name, camera, _placed(at, place, crs), file))
    points = [(k, p.get("coordinates").numbers(3)) for k, p in (part.maybe("points") or Item(path, "points", {})).members()]
    xyz = [_placed(Exterior(np.eye(3), x), place, crs).centre for _, x in points]
    if len(parts) > 1:
        notes = (*notes, f"the first of {len(parts)} reconstructions is read")
    return Exchange("OpenSfM reconstruction", path, crs, cameras, tuple(shots),
                    points_from(path, [k for k, _ in points], xyz, role="tie"),
                    no_observations(), notes)


def camera_of(c: Item) -> Camera:
    """A camera of reconstruction.json or cameras.json."""
    kind = c.get("projection_type").text() if c.maybe("projection_type") else "perspective"
    width, height = c.get("width").integer(), c.get("height").integer()
    side = max(width, height)
    if kind in ("perspective", "simple_radial", "radial"):
        f = c.get("focal") if c.maybe("focal") else c.get("focal_x")
        fx, fy = f.number(), c.number_or("focal_y", f.number())
    elif kind == "brown":
        fx, fy = c.get("focal_x").number(), c.get("focal_y").number()
    else:
        raise Unsupported(f"{c.path}: {c.where} is a {kind} camera; only perspective, radial and brown cameras are read, "
                          f"{FISHEYE}")
    d = {k: c.number_or(k, 0.0) for k in ("k1", "k2", "k3", "p1", "p2")}
    try:
        return Brown(fx * side, fy * side, c.number_or("c_x", 0.0) * side + (width - 1) / 2,
                     c.number_or("c_y", 0.0) * side + (height - 1) / 2, width=width, height=height, **d)  # type: ignore[arg-type]
    except PhotogrammetryError as error:
        raise c.error(str(error)) from None


def _pose(shot: Item) -> Exterior:
    r, t = shot.get("rotation").numbers(3), shot.get("translation").numbers(3)
    return exterior_of(exact.of_vector(r), t, CONVENTION[0])


def _reference(part: Item, path: Path, options: Reading) -> tuple[str, tuple[str, np.ndarray] | None, tuple[str, ...]]:
    """Our crs, the crs and place at which the file's frame lies (None: it is on no map), and notes."""
    lla = part.maybe("reference_lla")
    beside = path.parent / "reference_lla.json"
    if lla is None and beside.is_file():
        lla = read_json(beside)
    if lla is None:
        return options.crs or "local", None, ("no reference_lla: the coordinates are local",)
    at = np.array([lla.get("longitude").number(), lla.get("latitude").number(), lla.number_or("altitude", 0.0)])
    crs = options.crs if options.crs not in (None, "local") else utm_zone(at[1], at[0])
    return str(crs), ("EPSG:4326", at), (f"local frame at {at[1]:.6f}, {at[0]:.6f}, converted to {crs}",)


def _placed(at: Exterior, place: tuple[str, np.ndarray] | None, crs: str) -> Exterior:
    """An orientation in the local east, north, up frame, in the crs."""
    if place is None:
        return at
    axes = axes_at(*place)
    origin = to_geocentric(Exterior(np.eye(3), place[1]), place[0]).centre
    return from_geocentric(Exterior(at.m @ axes, origin + axes.T @ at.centre), crs)


def read_shots(path: Path, options: Reading = NOTHING) -> Exchange:
    """OpenDroneMap's shots.geojson, with cameras.json beside or above it where it is. Raises BadTable."""
    features = read_json(path).get("features").entries()
    if not features:
        raise read_json(path).error("has no features")
    cameras = _odm_cameras(path)
    crs, labels, found = options.crs, [], []
    for feature in features:
        p = feature.get("properties")
        centre = p.get("translation").numbers(3)
        if crs is None:
            crs = _utm_of(feature, centre)
        at = exterior_from(exp(p.get("rotation").numbers(3)), centre, CONVENTION[0], CONVENTION[1], Position.CENTRE)
        camera = p.get("camera").text() if p.maybe("camera") else "camera"
        if camera not in cameras:
            width, height = p.get("width").integer(), p.get("height").integer()
            f = p.get("focal").number() * max(width, height)
            cameras[camera] = Brown(f, f, (width - 1) / 2, (height - 1) / 2, width=width, height=height)
        labels.append(p.get("filename").text())
        found.append((camera, at))
    shots = tuple(Shot(name, camera, at, file) for (name, file), (camera, at) in zip(named(labels), found, strict=True))
    plain = any(isinstance(c, Brown) and not c.distorts for c in cameras.values())
    notes = ("cameras: focal length only, without principal point and distortion; put cameras.json beside the file to have them",
             ) \
        if plain else ()
    used = {s.camera for s in shots}
    return Exchange("ODM shots.geojson", path, crs, {k: v for k, v in cameras.items() if k in used}, shots, notes=notes)


def _odm_cameras(path: Path) -> dict[str, Camera]:
    for folder in (path.parent, path.parent.parent):
        if (folder / "cameras.json").is_file():
            return {k.removeprefix("v2 "): camera_of(c) for k, c in read_json(folder / "cameras.json").members()} | {
                k: camera_of(c) for k, c in read_json(folder / "cameras.json").members()}
    return {}


def _utm_of(feature: Item, centre: np.ndarray) -> str:
    """The UTM zone in which the geometry's longitude and latitude are the translation."""
    geometry = feature.get("geometry").get("coordinates").numbers((2, 3))
    zone = utm_zone(float(geometry[1]), float(geometry[0]))
    there = transformed(np.array([[geometry[0], geometry[1], 0.0]]), "EPSG:4326", zone)[0]
    if np.hypot(*(there - centre)[:2]) > 50:
        raise feature.error(f"lies {np.hypot(*(there - centre)[:2]):.0f} m from its translation in {zone}; say with --crs in "
                            f"which "
                            "system the translations are")
    return zone
