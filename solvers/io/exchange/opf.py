"""Open Photogrammetry Format (OPF) of Pix4D: cameras, calibration, control points with sigmas and marks, scene reference frame.

Calibrated positions are in the processing frame, shift + swap(scale * base); omega, phi, kappa turn the photo's axes (x right,
y up, z back) into it: R = Rx Ry Rz. Geolocations keep the axis order of their crs. Principal points count from the corner of the
top-left pixel, marks from its centre. Reference: github.com/Pix4D/opf-spec 1.0, pyopf.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlparse

import numpy as np

from ...block import Observations, Points
from ...cameras.brown import Brown
from ...cameras.foreign import PITCH_MM, as_pix4d, from_pix4d
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ...geometry import Exterior
from ..crs import north_first, short_crs, transformed
from ..files import write_json
from .conventions import AngleOrder, AngleUnit, angles_as, rotation_from
from .options import NOTHING, Reading
from .scene import Camera, Exchange, Shot, labels_of, named, no_observations, no_points, observations_from, points_from
from .structure import Item, read_json

PREFIX = "application/opf-"
LOCAL = ('ENGCRS["Arbitrary Local Coordinate System",EDATUM["Unknown engineering '
         'datum"],CS[Cartesian,3],AXIS["(E)",east,ORDER[1]],'
         'AXIS["(N)",north,ORDER[2]],AXIS["(U)",up,ORDER[3]],LENGTHUNIT["metre",1]]')
VERSION = "1.0"
SPACE = uuid.uuid5(uuid.NAMESPACE_URL, "https://github.com/Pix4D/opf-spec")


def looks_like(head: str) -> bool:
    """Whether a JSON's beginning is a part of OPF."""
    return PREFIX in head


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """A project (project.opf, or its folder), or one of its parts with those beside it. Raises BadTable and Unsupported."""
    parts = _parts(path)
    crs, to_base = _frame(parts.get("scene-reference-frame"), options)
    names = _names(parts.get("camera-list"), parts)
    cameras = _sensors(parts)
    shots, notes = [], []
    numbers: dict[str, int] = {}
    calibrated = parts.get("calibrated-cameras")
    poses = {c.get("id").text(): c for c in calibrated.get("cameras").entries()} if calibrated is not None else {}
    for number, (name, file) in names.items():
        numbers[number] = len(shots)
        c = poses.get(number)
        if c is None:
            shots.append(Shot(name, None, None, file))
            continue
        m = rotation_from(c.get("orientation_deg").numbers(3), AngleOrder.OPK, AngleUnit.DEGREES)
        sensor = c.get("sensor_id").text()
        shots.append(Shot(name, sensor if sensor in cameras else None, Exterior(m, to_base(c.get("position").numbers(3))), file))
    if _has_ties(parts.get("project")):
        notes.append("the project has tie points as glTF, which are not read: control points and manual tie points are")
    if calibrated is None and parts.get("input-cameras") is not None:
        notes.append("there are no calibrated cameras, their orientations are not known")
    crs, points, observations = _control(parts.get("input-control-points"), numbers, crs, path)
    used = {s.camera for s in shots}
    return Exchange("OPF", path, crs, {k: v for k, v in cameras.items() if k in used or not shots}, tuple(shots), points,
                    observations,
                    tuple(notes))


def _parts(path: Path) -> dict[str, Item]:
    """The JSON parts by the name of their format."""
    if path.is_dir():
        found = sorted(path.glob("*.opf"))
        if not found:
            raise BadTable(f"{path}: there is no .opf file in this folder; give project.opf")
        path = found[0]
    root = read_json(path)
    kind = root.get("format").text()
    if kind != f"{PREFIX}project+json":
        beside = [path, *sorted(p for p in path.parent.glob("*.json") if p != path)]
        return _by_format([read_json(p) for p in beside if p == path or PREFIX in _head(p)])
    files = []
    for item in root.get("items").entries():
        for resource in item.get("resources").entries():
            if not resource.get("format").text().endswith("+json") or not resource.get("format").text().startswith(PREFIX):
                continue
            uri = urlparse(resource.get("uri").text())
            if uri.scheme not in ("", "file") or uri.netloc not in ("", "localhost"):
                raise resource.error("is on another machine; only files beside the project are read")
            inside = path.parent / unquote(uri.path)
            if not inside.resolve().is_relative_to(path.parent.resolve()):
                raise resource.error("is outside the project's folder; put the file beside the project")
            files.append(inside)
    return {**_by_format([read_json(f) for f in files]), "project": root}


def _has_ties(project: Item | None) -> bool:
    return project is not None and any("gltf" in r.get("format").text() for item in project.get("items").entries()
                                       for r in item.get("resources").entries())


def _head(path: Path) -> str:
    with open(path, "rb") as stream:
        return stream.read(4096).decode("utf-8", "replace")


def _by_format(items: list[Item]) -> dict[str, Item]:
    out: dict[str, Item] = {}
    for item in items:
        kind = item.get("format").text()
        out.setdefault(kind.removeprefix(PREFIX).removesuffix("+json"), item)
    return out


def _frame(frame: Item | None, options: Reading) -> tuple[str | None, Any]:
    """Our crs, and a function from processing coordinates (3,) to it (east, north, up)."""
    if frame is None:
        return options.crs, lambda p: p
    crs = _crs(frame.get("crs"))
    b = frame.get("base_to_canonical")
    scale, shift = b.get("scale").numbers(3), b.get("shift").numbers(3)
    swap = b.get("swap_xy").value is True
    if np.abs(scale).min() == 0:
        raise b.error("has a scale of zero")
    turned = north_first(crs)

    def to_base(p: np.ndarray) -> np.ndarray:
        q = p - shift
        q = (q[[1, 0, 2]] if swap else q) / scale
        return q[[1, 0, 2]] if turned else q

    return crs, to_base


def _crs(item: Item) -> str:
    text = item.get("definition").text()
    if text.startswith(("ENGCRS", "LOCAL_CS", "ENGINEERINGCRS")):
        return "local"
    try:
        return short_crs(text)
    except PhotogrammetryError as error:
        raise item.error(str(error)) from None


def _names(cameras: Item | None, parts: Mapping[str, Item]) -> dict[str, tuple[str, str | None]]:
    if cameras is not None:
        rows = [(c.get("id").text(), unquote(urlparse(c.get("uri").text()).path)) for c in cameras.get("cameras").entries()]
    else:
        source = parts.get("calibrated-cameras")
        rows = [(c.get("id").text(), c.get("id").text()) for c in source.get("cameras").entries()] if source is not None else []
        if source is None and parts.get("input-control-points") is not None:
            marks = [m for g in parts["input-control-points"].get("gcps").entries() for m in g.get("marks").entries()]
            rows = [(n, n) for n in dict.fromkeys(m.get("camera_id").text() for m in marks)]
    return dict(zip([r[0] for r in rows], named([r[1] for r in rows]), strict=True))


def _sensors(parts: Mapping[str, Item]) -> dict[str, Camera]:
    given = parts.get("input-cameras")
    if given is None:
        return {}
    sizes = {s.get("id").text(): s for s in given.get("sensors").entries()}
    best = parts.get("calibrated-cameras")
    out: dict[str, Camera] = {}
    for sensor in best.get("sensors").entries() if best is not None else list(sizes.values()):
        number = sensor.get("id").text()
        if number not in sizes:
            raise sensor.error(f"is sensor {number}, which the input cameras do not have")
        p = sensor.get("internals")
        if p.get("type").text() != "perspective":
            raise Unsupported(f"{p.path}: sensor {number} is a {p.get('type').text()} camera; only perspective cameras are read")
        width, height = sizes[number].get("image_size_px").numbers(2)
        um = sizes[number].number_or("pixel_size_um", 0.0)
        try:
            out[number] = from_pix4d(p.get("focal_length_px").number(), list(p.get("principal_point_px").numbers(2)),
                                     list(p.get("radial_distortion").numbers(3)), list(p.get("tangential_distortion").numbers(2)),
                                     round(width), round(height), (um * 1e-3, um * 1e-3) if um > 0 else None)
        except PhotogrammetryError as error:
            raise p.error(str(error)) from None
    return out


def _control(part: Item | None, numbers: Mapping[str, int], crs: str | None, path: Path,
             ) -> tuple[str | None, Points, Observations]:
    if part is None:
        return crs, no_points(), no_observations()
    names, xyz, sigma, role, rows = [], [], [], [], []
    gcps = part.get("gcps").entries()
    mtps = part.get("mtps").entries() if part.maybe("mtps") else []
    for n, point in enumerate(gcps + mtps):
        names.append(point.get("id").text())
        if n < len(gcps):
            place = point.get("geolocation")
            own = _crs(place.get("crs"))
            order = [1, 0, 2] if north_first(own) else [0, 1, 2]
            at, sd = place.get("coordinates").numbers(3)[order], place.get("sigmas").numbers(3)[order]
            crs = crs or own
            xyz.append(transformed(at[None], own, crs)[0] if own != crs else at)
            sigma.append(sd)
            role.append("check" if point.get("is_checkpoint").value is True else "control")
        else:
            xyz.append(np.full(3, np.nan))
            sigma.append(np.full(3, np.nan))
            role.append("tie")
        for mark in point.get("marks").entries():
            camera = mark.get("camera_id").text()
            if camera not in numbers:
                raise mark.error(f"is in camera {camera}, which the camera list does not have")
            col, row = mark.get("position_px").numbers(2)
            accuracy = mark.number_or("accuracy", np.nan) if mark.maybe("accuracy") else np.nan
            rows.append((numbers[camera], n, col, row, accuracy))
    return crs, points_from(path, names, xyz, sigma, role), observations_from(rows)


# -- writing --------------------------------------------------------------------------------------------------------------


def write(scene: Exchange, path: Path) -> tuple[str, ...]:
    """project.opf and its parts in a folder; returns notes."""
    folder = path if path.suffix != ".opf" else path.parent
    folder.mkdir(parents=True, exist_ok=True)
    crs = scene.crs or "local"
    shift = _shift(scene)
    numbers = {name: n + 1 for n, name in enumerate(scene.cameras)}
    sensors, notes = _written_sensors(scene)
    files: dict[str, tuple[str, dict[str, Any]]] = {
        "scene_reference_frame": ("scene-reference-frame", {
            "base_to_canonical": {"scale": [1.0, 1.0, 1.0], "shift": shift, "swap_xy": north_first(crs)},
            "crs": {"definition": LOCAL if crs == "local" else crs}}),
        "camera_list": ("camera-list", {"cameras": [
            {"id": n, "uri": quote(s.file or label, safe="/\\:")} for n, (s, label) in
            enumerate(zip(scene.shots, labels_of(scene.shots), strict=True))]}),
        "input_cameras": ("input-cameras", {"captures": _captures(scene, numbers), "sensors": sensors}),
        "calibration": ("calibrated-cameras", {
            "sensors": [{"id": s["id"], "internals": s["internals"]} for s in sensors],
            "cameras": [{"id": n, "sensor_id": numbers[s.camera], "position": s.exterior.centre + shift,
                         "orientation_deg": angles_as(s.exterior.m, AngleOrder.OPK, AngleUnit.DEGREES)}
                        for n, s in enumerate(scene.shots) if s.oriented and s.exterior is not None and s.camera is not None]}),
        "input_control_points": ("input-control-points", _written_control(scene, crs)),
    }
    items = []
    for name, (kind, value) in files.items():
        file = f"{'calibrated_cameras' if name == 'calibration' else name}.json"
        write_json(folder / file, {"format": f"{PREFIX}{kind}+json", "version": VERSION, **value})
        items.append({"id": str(uuid.uuid5(SPACE, f"{scene.path.stem}/{name}")), "name": name, "type": name, "sources": [],
                      "resources": [{"uri": file, "format": f"{PREFIX}{kind}+json"}]})
    items[3]["sources"] = [{"id": items[k]["id"], "type": items[k]["type"]} for k in (0, 2)]
    write_json(folder / (path.name if path.suffix == ".opf" else "project.opf"), {
        "format": f"{PREFIX}project+json", "version": VERSION, "name": scene.path.stem or "project", "description": "",
        "generator": {"name": "collinea", "version": _version()}, "id": str(uuid.uuid5(SPACE, scene.path.stem)), "items": items})
    return notes


def _version() -> str:
    from ... import __version__

    return __version__


def _shift(scene: Exchange) -> np.ndarray:
    """Minus the rounded middle of the perspective centres, so that processing coordinates are small."""
    at = np.array([s.exterior.centre for s in scene.shots if s.exterior is not None]).reshape(-1, 3)
    at = at[np.isfinite(at).all(axis=1)]
    return -np.round(at.mean(axis=0)) if len(at) else np.zeros(3)


def _written_sensors(scene: Exchange) -> tuple[list[dict[str, Any]], tuple[str, ...]]:
    out, notes = [], []
    for n, (name, camera) in enumerate(scene.cameras.items(), 1):
        values, fit = as_pix4d(camera)
        notes += fit.told(name)
        pitch = camera.pixel_mm if isinstance(camera, Brown) else camera.pitch
        um = float((pitch if pitch is not None else (PITCH_MM,))[0]) * 1e3
        bands = [{"name": band, "weight": weight} for band, weight in (("Red", 0.2126), ("Green", 0.7152), ("Blue", 0.0722))]
        out.append({"id": n, "name": name, "bands": bands, "image_size_px": [camera.width, camera.height], "pixel_size_um": um,
                    "shutter_type": "global", "internals": {"type": "perspective", **values}})
    return out, tuple(notes)


def _captures(scene: Exchange, numbers: Mapping[str, int]) -> list[dict[str, Any]]:
    return [{"id": n, "reference_camera_id": n, "rig_model_source": "not_applicable", "time": "1970-01-01T00:00:00+00:00",
             "cameras": [{"id": n, "sensor_id": numbers[s.camera], "model_source": "user", "pixel_type": "uint8",
                          "pixel_range": {"min": 0, "max": 255}}]} for n, s in enumerate(scene.shots) if s.camera is not None]


def _written_control(scene: Exchange, crs: str) -> dict[str, Any]:
    p, of = scene.points, scene.observations
    order = [1, 0, 2] if north_first(crs) else [0, 1, 2]
    marks: dict[int, list[dict[str, Any]]] = {}
    for i, j, pixel, sigma in zip(of.image, of.point, of.pixel, of.sigma, strict=True):
        marks.setdefault(int(j), []).append({"camera_id": int(i), "position_px": pixel, "accuracy": 1.0 if np.isnan(sigma)
                                             else sigma})
    gcps, mtps = [], []
    for j, (name, role) in enumerate(zip(p.names, p.role, strict=True)):
        entry: dict[str, Any] = {"id": name, "is_checkpoint": role == "check", "marks": marks.get(j, [])}
        if role != "tie" and np.isfinite(p.xyz[j]).all():
            sigmas = np.where(np.isfinite(p.sigma[j]), p.sigma[j], (0.02, 0.02, 0.04))[order]
            entry["geolocation"] = {"coordinates": p.xyz[j][order], "sigmas": sigmas,
                                    "crs": {"definition": LOCAL if crs == "local" else crs}}
            gcps.append(entry)
        elif marks.get(j):
            mtps.append(entry)
    return {"gcps": gcps, "mtps": mtps}
