"""Between an `Exchange` and a project: metric coordinates, our camera model, orientations as priors in the project's frame.

An exchange's orientations refer to the grid axes at each camera; a project's angles refer to the tangent frame at the block's
origin (docs/conventions.md). The turn between them is the earth's curvature and the change of grid north, 0.009 degrees a km.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np

from ...block import Block, Image, Observations, Prior
from ...cameras import Interior
from ...cameras.foreign import to_interior
from ...errors import BadProject
from ...geometry import Exterior, LocalFrame
from ..crs import METRES, described, is_geographic, short_crs, transformed, utm_zone
from ..geocentric import axes_at, converted
from ..photos import EXTENSIONS
from ..whereabouts import Reading as Place
from .scene import Exchange, Shot


def metric(scene: Exchange, place: Place, target: str | None = None, height_unit: str | None = None) -> Exchange:
    """The scene in metres: as `place` reads its coordinates, in `target` (None: its own crs, the UTM zone of degrees and feet).

    Raises BadProject where heights in feet are not named and where a crs is on no map.
    """
    if place.crs == "local":
        if target not in (None, "local"):
            raise BadProject(f"{scene.path}: its coordinates are local and cannot be converted to {target}; say with --crs in "
                             f"which "
                             "system they are")
        return _moved(scene, place, "local", "local", height_unit)
    told = described(place.crs)
    if not told.geographic and not told.metric and told.height_unit is None and height_unit is None and place.unit is None:
        raise BadProject(f"{scene.path}: {told.text} is not in metres but in {told.units}, and does not say in what its heights "
                         f"are; "
                         f"say that with --height-unit {', '.join(METRES)}, and the coordinates are converted to metres")
    if target is None:
        target = told.text if told.metric else _zone(scene, place)
    target = short_crs(target)
    if is_geographic(target):
        raise BadProject(f"--to-crs {target}: it is in degrees; give a map projection in metres")
    return _moved(scene, place, told.text, target, height_unit)


def _zone(scene: Exchange, place: Place) -> str:
    """The UTM zone of the scene's points, else of its cameras."""
    at = scene.points.xyz if len(scene.points) else np.array([s.exterior.centre for s in scene.shots if s.exterior is not None])
    at = place.metric(np.asarray(at, float).reshape(-1, 3))
    at = at[np.isfinite(at[:, :2]).all(axis=1)]
    if not len(at):
        raise BadProject(f"{scene.path}: there is no place in it to choose a UTM zone by; give --to-crs")
    degrees = at if is_geographic(place.crs) else transformed(at, place.crs, "EPSG:4326")
    lon, lat = np.median(degrees[:, :2], axis=0)
    return utm_zone(float(lat), float(lon))


def _moved(scene: Exchange, place: Place, source: str, target: str, height_unit: str | None) -> Exchange:
    xyz = place.metric(scene.points.xyz, height_unit) if len(scene.points) else scene.points.xyz
    if source != target and len(xyz):
        xyz = transformed(xyz, source, target)
    shots = []
    for s in scene.shots:
        at = s.exterior
        if at is not None:
            at = Exterior(at.m, place.metric(at.centre[None], height_unit)[0])
            at = at if source == target else _converted(at, source, target)
        shots.append(replace(s, exterior=at))
    note = () if source == target else (f"crs: {source} converted to {target}, heights kept as they are",)
    return replace(scene, crs=target, points=replace(scene.points, xyz=xyz), shots=tuple(shots), notes=(*scene.notes, *note))


def _converted(at: Exterior, source: str, target: str) -> Exterior:
    if np.isfinite(at.centre).all() and np.isfinite(at.m).all():
        return converted(at, source, target)
    return Exterior(at.m, transformed(at.centre[None], source, target)[0])


def turn(crs: str, frame: LocalFrame, centre: np.ndarray) -> np.ndarray:
    """(3, 3) from the frame's axes to the grid axes at a camera; identity in a Cartesian frame."""
    if frame.cartesian:
        return np.eye(3)
    return axes_at(crs, centre) @ axes_at(crs, frame.origin).T


def block_of(scene: Exchange, name: str, folder: Path, photos: Mapping[str, Path] | None = None) -> tuple[Block, tuple[str, ...]]:
    """The scene as the block of a new project, orientations as priors. photos: files by image name where they are known.

    Raises BadProject without a metric crs or a camera for an image.
    """
    if scene.crs is None:
        raise BadProject(f"{scene.path}: it does not say its coordinate system; give it with --crs EPSG:CODE, or --crs local")
    notes: list[str] = []
    cameras: dict[str, Interior] = {}
    for key, camera in scene.cameras.items():
        cameras[key], fit = to_interior(camera)
        notes += fit.told(key)
    frame = frame_of(scene)
    images, kept = [], []
    for n, shot in enumerate(scene.shots):
        camera = shot.camera or (next(iter(cameras)) if len(cameras) == 1 else None)
        if camera is None or camera not in cameras:
            raise BadProject(f"{scene.path}: image '{shot.name}' has no camera; give its calibration with --camera FILE, or "
                             "give the file to collinea init beside the photos, whose EXIF has one")
        images.append(Image(shot.name, camera, _file(scene, shot, folder, photos), prior_of(shot, scene.crs, frame)))
        kept.append(n)
    points = scene.points
    observations, left = _inside(scene, images, cameras)
    if left:
        notes.append(f"{left} measurements outside their photos are left out")
    missing = sum(i.file is None for i in images)
    if missing:
        notes.append(f"photos: {missing} of {len(images)} are not found beside the file; name their folder with --photos")
    return Block(name, scene.crs, cameras, tuple(images), points, observations), tuple(notes)


def frame_of(scene: Exchange) -> LocalFrame:
    """The frame a project of this scene will have: around its points, else around its cameras."""
    known = scene.points.xyz[np.isfinite(scene.points.xyz).all(axis=1)]
    where = known if len(known) else np.array([s.exterior.centre for s in scene.shots if s.exterior is not None]).reshape(-1, 3)
    return LocalFrame.around(where, scene.crs or "local")


def prior_of(shot: Shot, crs: str, frame: LocalFrame) -> Prior | None:
    """The orientation as a prior of a project, None where not even the position is whole."""
    at = shot.exterior
    if at is None or not np.isfinite(at.centre).all():
        return None
    angles = Exterior(at.m @ turn(crs, frame, at.centre), at.centre).angles if shot.oriented else None
    return Prior(at.centre, angles, shot.sigma_m, shot.sigma_rad if angles is not None else None)


def _file(scene: Exchange, shot: Shot, folder: Path, photos: Mapping[str, Path] | None) -> str | None:
    """The photo, where there is one: among those given, or beside the file."""
    found = (photos or {}).get(shot.name.lower())
    if found is None and shot.file is not None:
        pure = PureWindowsPath(shot.file) if "\\" in shot.file else PurePosixPath(shot.file)
        home = scene.path if scene.path.is_dir() else scene.path.parent
        places = (home / Path(*pure.parts), home / pure.name, home / "images" / pure.name)
        found = next((p for p in places if p.suffix.lower() in EXTENSIONS and p.is_file()), None)  # no other file is a photo
    if found is None:
        return None
    at, home = found.resolve(), folder.resolve()
    return at.relative_to(home).as_posix() if at.is_relative_to(home) else str(at)


def _inside(scene: Exchange, images: list[Image], cameras: Mapping[str, Interior]) -> tuple[Observations, int]:
    of = scene.observations
    good = np.zeros(len(of), bool)
    for i, image in enumerate(images):
        rows = np.flatnonzero(of.image == i)
        good[rows] = cameras[image.camera].inside(of.pixel[rows])
    return Observations(of.image[good], of.point[good], of.pixel[good], of.sigma[good]), int((~good).sum())


def scene_of(block: Block, folder: Path, exteriors: Mapping[str, tuple[Exterior, np.ndarray | None]], frame: LocalFrame,
             notes: tuple[str, ...] = ()) -> Exchange:
    """A project's block with orientations in its frame (and covariances of X, Y, Z, omega, phi, kappa) as an exchange."""
    shots = []
    for image in block.images:
        at, covariance = exteriors.get(image.name, (None, None))
        sigma = None if covariance is None else np.sqrt(np.maximum(np.diag(covariance), 0.0))
        if at is not None:
            at = Exterior(at.m @ turn(block.crs, frame, at.centre).T, at.centre)
        shots.append(Shot(image.name, image.camera, at, image.file, None if sigma is None else sigma[:3],
                          None if sigma is None else sigma[3:]))
    return Exchange("project", folder, block.crs, dict(block.cameras), tuple(shots), block.points, block.observations, notes)
