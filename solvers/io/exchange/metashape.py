"""Metashape's XML: cameras (sensors, transforms) and markers of one document.

A camera's transform (4 x 4) turns camera axes (x right, y down, z forward) into the chunk; the chunk's (or its component's)
transform scales, turns and shifts that into the world, which is geocentric when the chunk's reference is geographic or
projected. Markers: <location pinned="true"> was measured, pinned="false" is predicted and no measurement. Pixels count from the
corner. References: Metashape manual; Agisoft forum topics 12982, 15797.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...block import Points
from ...cameras.foreign import as_metashape, from_metashape
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ..crs import is_geographic, short_crs
from ..geocentric import from_geocentric
from .conventions import CameraAxes, PixelOrigin, Position, RotationDirection, exterior_from
from .options import NOTHING, Reading
from .scene import Camera, Exchange, Shot, named, no_points, observations_from, points_from
from .structure import Xml, read_xml

CONVENTION = (CameraAxes.VISION, RotationDirection.CAMERA_TO_OBJECT, Position.CENTRE)
CORNER = PixelOrigin.CORNER.value


def looks_like(head: str) -> bool:
    """Whether an XML's beginning is a Metashape document."""
    return "<document" in head and "<chunk" in head


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """Cameras, orientations, markers and their measurements. Raises BadTable and Unsupported."""
    root = read_xml(path)
    chunks = root.all("chunk")
    if not chunks:
        raise root.error("has no <chunk>")
    chunk, notes = chunks[0], []
    if len(chunks) > 1:
        notes.append(f"the first of {len(chunks)} chunks is read")
    crs = _crs(chunk, options)
    sensors, sensor_notes = _sensors(chunk)
    cameras = [c for c in chunk.all("cameras", "camera")] + [c for g in chunk.all("cameras", "group") for c in g.all("camera")]
    names = named([c.attribute("label") for c in cameras])
    numbers = {c.attribute("id"): n for n, c in enumerate(cameras)}
    geographic = crs is not None and crs != "local"
    shots, lost = [], 0
    for camera, (name, file) in zip(cameras, names, strict=True):
        sensor = camera.element.attrib.get("sensor_id", "")
        exterior = _pose(chunk, camera, geographic, crs)
        lost += exterior is None
        shots.append(Shot(name, sensor if sensor in sensors else None, exterior, file))
    points, observations, predicted = _markers(chunk, numbers, options)
    if lost and lost < len(shots):
        notes.append(f"{lost} images are not aligned")
    if predicted:
        notes.append(f"{predicted} predicted marks (not pinned) are no measurements and left out")
    if is_geographic_crs(crs):
        notes.append("the reference is geographic: positions in degrees")
    kind = "Metashape markers" if len(points) and not any(s.oriented for s in shots) else "Metashape XML"
    return Exchange(kind, path, crs, sensors, tuple(shots), points, observations, (*notes, *sensor_notes))


def is_geographic_crs(crs: str | None) -> bool:
    """Whether a crs is given and in degrees."""
    return crs is not None and crs != "local" and is_geographic(crs)


def _crs(chunk: Xml, options: Reading) -> str | None:
    said = chunk.maybe("reference")
    text = said.text() if said is not None else ""
    if not text:
        return options.crs
    if text.upper().startswith("LOCAL_CS"):
        return "local"
    try:
        return short_crs(text)
    except PhotogrammetryError as error:
        raise BadTable(f"{chunk.path}: <reference>: {error}") from None


def _sensors(chunk: Xml) -> tuple[dict[str, Camera], tuple[str, ...]]:
    out: dict[str, Camera] = {}
    notes = []
    for sensor in chunk.all("sensors", "sensor"):
        number = sensor.attribute("id")
        kind = sensor.element.attrib.get("type", "frame")
        found = sensor.all("calibration")
        if not found:
            continue
        if kind != "frame":
            raise Unsupported(f"{sensor.path}: sensor {number} is a {kind} camera; only frame cameras are read, undistort the "
                              f"photos "
                              "in Metashape and export again")
        adjusted = [c for c in found if c.element.attrib.get("class") == "adjusted"]
        chosen = (adjusted or found)[-1]
        if not adjusted:
            notes.append(f"sensor {number}: its initial calibration, there is no adjusted one")
        out[number] = _calibration(chosen, sensor)
    return out, tuple(notes)


def _calibration(c: Xml, sensor: Xml | None) -> Camera:
    size = c.maybe("resolution") or (sensor.maybe("resolution") if sensor is not None else None)
    if size is not None:
        width, height = size.attribute_number("width"), size.attribute_number("height")
    else:
        width, height = c.number("width"), c.number("height")
    names = ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")
    values = {k: c.number(k, default=0.0) for k in names}
    fx, fy = c.maybe("fx"), c.maybe("fy")
    if fx is not None and fy is not None:  # Lens and PhotoScan before 1.2: fx, fy, skew, and cx, cy from the corner
        values |= {"f": fy.number(), "b1": fx.number() - fy.number(), "b2": c.number("skew", default=0.0),
                   "cx": values["cx"] - width / 2, "cy": values["cy"] - height / 2}
    for k in ("p3", "p4"):
        if c.number(k, default=0.0):
            raise Unsupported(f"{c.path}: <{c.where}>: {k} has no counterpart here; calibrate without p3 and p4")
    pitch = None
    if sensor is not None:
        p = {x.element.attrib.get("name"): x.element.attrib.get("value", "") for x in sensor.all("property")}
        try:
            pitch = (float(p["layer/pixel_width"]), float(p["layer/pixel_height"])) if "layer/pixel_width" in p else \
                (float(p["pixel_width"]), float(p["pixel_height"])) if "pixel_width" in p else None
        except (ValueError, KeyError):
            pitch = None
        pitch = pitch if pitch is not None and min(pitch) > 1e-7 and max(pitch) < 10 else None
    try:
        return from_metashape(values, round(width), round(height), pitch)
    except PhotogrammetryError as error:
        raise c.error(str(error)) from None


def read_calibration(path: Path, options: Reading = NOTHING) -> Exchange:
    """A camera calibration saved as XML by Metashape. Raises BadTable."""
    root = read_xml(path)
    if root.tag != "calibration":
        raise root.error("is not <calibration>")
    kind = root.maybe("projection")
    if kind is not None and kind.text() not in ("frame", "perspective"):
        raise Unsupported(f"{path}: this is a {kind.text()} camera; only frame cameras are read")
    return Exchange("Metashape calibration", path, None, {path.stem: _calibration(root, None)})


def _pose(chunk: Xml, camera: Xml, geographic: bool, crs: str | None) -> Any:
    at = camera.maybe("transform")
    if at is None:
        return None
    local = at.numbers(16).reshape(4, 4)
    component = camera.element.attrib.get("component_id")
    place = chunk.maybe("transform")
    for c in chunk.all("components", "component"):
        if component is not None and c.element.attrib.get("id") == component and c.maybe("transform") is not None:
            place = c.get("transform")
    r, t, s = np.eye(3), np.zeros(3), 1.0
    if place is not None:
        if place.maybe("rotation") is not None:
            r = place.get("rotation").numbers(9).reshape(3, 3)
        if place.maybe("translation") is not None:
            t = place.get("translation").numbers(3)
        s = place.number("scale", default=1.0)
    centre = t + s * r @ local[:3, 3]
    try:
        exterior = exterior_from(r @ local[:3, :3], centre, *CONVENTION)
    except BadTable as error:
        raise at.error(str(error)) from None
    located = place is not None and place.maybe("translation") is not None
    return from_geocentric(exterior, crs) if geographic and located and crs is not None else exterior


def _markers(chunk: Xml, cameras: dict[str, int], options: Reading) -> tuple[Points, Any, int]:
    markers = chunk.all("markers", "marker") + [m for g in chunk.all("markers", "group") for m in g.all("marker")]
    if not markers:
        return no_points(), observations_from([]), 0
    names, xyz, sigma, role = [], [], [], []
    for m in markers:
        reference = m.maybe("reference")
        names.append(m.attribute("label"))
        has = reference is not None and all(k in reference.element.attrib for k in "xyz")
        xyz.append([reference.attribute_number(k) if has and reference else np.nan for k in "xyz"])
        sigma.append(_accuracy(reference) if has and reference else [np.nan] * 3)
        enabled = has and reference is not None and reference.element.attrib.get("enabled", "true").lower() in ("true", "1")
        role.append("control" if enabled else "check" if has else "tie")
    index = {m.attribute("id"): n for n, m in enumerate(markers)}
    rows, predicted = [], 0
    for marker in chunk.all("frames", "frame", "markers", "marker"):
        number = marker.attribute("marker_id")
        for place in marker.all("location"):
            if place.element.attrib.get("pinned", "false").lower() not in ("true", "1"):
                predicted += 1
                continue
            if number not in index or place.attribute("camera_id") not in cameras:
                raise place.error("names a marker or camera that the file does not have")
            rows.append((cameras[place.attribute("camera_id")], index[number], place.attribute_number("x") - CORNER,
                         place.attribute_number("y") - CORNER, np.nan))
    return points_from(chunk.path, names, np.array(xyz), np.array(sigma), role), observations_from(rows), predicted


def _accuracy(reference: Xml) -> list[float]:
    """Standard errors of x, y, z: one of each, one of x and y (sxy), or one of all (sxyz)."""
    of_all = reference.attribute_number("sxyz", np.nan)
    level = reference.attribute_number("sxy", of_all)
    return [reference.attribute_number(k, default) for k, default in (("sx", level), ("sy", level), ("sz", of_all))]


def calibration_text(camera: Camera) -> tuple[str, tuple[str, ...]]:
    """The XML of a calibration as Metashape saves and opens it, and notes."""
    values, fit = as_metashape(camera)
    rows = "".join(f"  <{k}>{v!r}</{k}>\n" for k, v in values.items())
    return (f'<?xml version="1.0" encoding="UTF-8"?>\n<calibration>\n  <projection>frame</projection>\n  '
            f'<width>{camera.width}</width>\n'
            f"  <height>{camera.height}</height>\n{rows}</calibration>\n"), fit.told("camera")
