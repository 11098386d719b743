"""BlocksExchange XML of Bentley (ContextCapture, iTwin Capture), which nearly every reconstruction program reads and writes.

R turns object axes into the camera axes that <CameraOrientation> names (x right, y down, z forward unless said); omega, phi,
kappa make it as M = Mk Mp Mo, so a nadir photo has omega near 180 degrees. Pixels count from the centre of the top-left pixel.
K1..K3 distort ideal coordinates; P1 and P2 are the other way round than OpenCV's. Reference: Bentley, ContextCapture User Guide,
"BlocksExchange XML/XMLZ format" and "Perspective camera model".
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ...cameras.brown import Brown
from ...cameras.foreign import to_brown
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ...geometry import Exterior
from ..crs import short_crs, utm_zone
from ..files import write_text
from ..geocentric import from_geocentric, to_geocentric
from .conventions import AngleOrder, AngleUnit, CameraAxes, Position, RotationDirection, exterior_as, exterior_from, rotation_from
from .options import NOTHING, Reading
from .scene import Camera, Exchange, Shot, label_of, named, observations_from, points_from
from .structure import Xml, read_xml

CONVENTION = (CameraAxes.VISION, RotationDirection.OBJECT_TO_CAMERA, Position.CENTRE)
SIDES = {"Right": (1.0, 0, 0), "Left": (-1.0, 0, 0), "Down": (0, 1.0, 0), "Up": (0, -1.0, 0)}
TERMS = ("k1", "k2", "k3", "p1", "p2", "aspect", "skew")
GEOCENTRIC = "EPSG:4978"


def looks_like(head: str) -> bool:
    """Whether an XML's beginning is a BlocksExchange document."""
    return "<BlocksExchange" in head


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """Cameras, orientations, control and tie points of the first block. Raises BadTable and Unsupported."""
    root = read_xml(path)
    block = root.get("Block")
    srs = {s.get("Id").text(): s.get("Definition").text() for s in root.all("SpatialReferenceSystems", "SRS")}
    crs, where, frame = _crs(block, srs, options)
    cameras: dict[str, Camera] = {}
    photos: list[tuple[Xml, str, np.ndarray]] = []
    for n, group in enumerate(block.all("Photogroups", "Photogroup"), 1):
        name = f"{group.get('Name').text() or 'camera'}-{n}" if group.maybe("Name") is not None else f"camera-{n}"
        cameras[name] = _camera(group)
        turn = _orientation(group)
        photos += [(photo, name, turn) for photo in group.all("Photo")]
    if where == GEOCENTRIC:
        crs = crs or _zone(photos, frame)
    labels = named([p.get("ImagePath").text() for p, _, _ in photos])
    shots = []
    for (photo, camera, turn), (name, file) in zip(photos, labels, strict=True):
        at = _pose(photo, turn)
        if at is not None and where == GEOCENTRIC and crs is not None:
            at = from_geocentric(_of_frame(at, frame), crs)
        shots.append(Shot(name, camera, at, file))
    number = {p.get("Id").text(): n for n, (p, _, _) in enumerate(photos) if p.maybe("Id") is not None}
    names, xyz, sigma, role, rows = [], [], [], [], []
    ties = block.all("TiePoints", "TiePoint")
    controls = block.all("ControlPoints", "ControlPoint")
    for n, point in enumerate([*controls, *ties]):
        tie = n >= len(controls)
        names.append(f"tie{n - len(controls) + 1}" if tie else point.get("Name").text() if point.maybe("Name") is not None
                     else f"cp{n + 1}")
        place = point.maybe("Position")
        at3 = np.full(3, np.nan) if place is None else np.array([place.number(k) for k in "xyz"])
        if where == GEOCENTRIC and crs is not None and np.isfinite(at3).all():
            at3 = from_geocentric(_of_frame(Exterior(np.eye(3), at3), frame), crs).centre
        xyz.append(at3)
        h, v = point.number("HorizontalAccuracy", default=np.nan), point.number("VerticalAccuracy", default=np.nan)
        sigma.append([h, h, v])
        check = point.maybe("CheckPoint")
        role.append("tie" if tie or place is None else "check" if check is not None and check.text().lower() == "true"
                    else "control")
        for m in point.all("Measurement"):
            photo = m.get("PhotoId").text()
            if photo not in number:
                raise m.error(f"is in photo {photo}, which the file does not have")
            rows.append((number[photo], n, m.number("x"), m.number("y"), np.nan))
    return Exchange("BlocksExchange", path, crs, cameras, tuple(shots), points_from(path, names, xyz, sigma, role),
                    observations_from(rows), _notes(root, where, crs, frame))


def _notes(root: Xml, where: str | None, crs: str | None, frame: Exterior | None) -> tuple[str, ...]:
    blocks, what = len(root.all("Block")), "geocentric coordinates" if frame is None else "local frame (east, north, up)"
    return (*((f"the first of {blocks} blocks is read",) if blocks > 1 else ()),
            *((f"{what}, converted to {crs}",) if where == GEOCENTRIC else ()))


def _crs(block: Xml, srs: dict[str, str], options: Reading) -> tuple[str | None, str | None, Exterior | None]:
    """The crs for our values, the one in the file, and the frame (in geocentric axes) of a file in local east, north, up."""
    said = block.maybe("SRSId")
    if said is None:
        return options.crs or "local", "local", None
    if said.text() not in srs:
        raise said.error(f"is {said.text()}, and there is no such <SRS>")
    text = srs[said.text()]
    enu = re.fullmatch(r"ENU:\s*([+-]?[\d.]+)\s*,\s*([+-]?[\d.]+)", text)
    if enu:
        at = Exterior(np.eye(3), np.array([float(enu[2]), float(enu[1]), 0.0]))  # latitude before longitude
        return options.crs, GEOCENTRIC, to_geocentric(at, "EPSG:4326")
    if text.upper().startswith(("LOCAL_CS", "ENGCRS")) or text.strip().lower() == "local":
        return options.crs or "local", "local", None
    try:
        crs = short_crs(text, metric=False)
    except PhotogrammetryError as error:
        raise said.error(str(error)) from None
    return (options.crs, crs, None) if crs == GEOCENTRIC else (crs, crs, None)


def _of_frame(at: Exterior, frame: Exterior | None) -> Exterior:
    """An orientation in geocentric coordinates of one in the frame."""
    return at if frame is None else Exterior(at.m @ frame.m, frame.centre + frame.m.T @ at.centre)


def _zone(photos: list[tuple[Xml, str, np.ndarray]], frame: Exterior | None) -> str:
    for photo, _, _ in photos:
        centre = photo.maybe("Pose", "Center")
        if centre is not None:
            at = _of_frame(Exterior(np.eye(3), np.array([centre.number(k) for k in "xyz"])), frame)
            lon, lat, _ = from_geocentric(at, "EPSG:4326").centre
            return utm_zone(float(lat), float(lon))
    return "local"


def _camera(group: Xml) -> Camera:
    model = group.maybe("CameraModelType")
    if model is not None and model.text() != "Perspective":
        raise Unsupported(f"{group.path}: <{group.where}> is a {model.text()} camera; only perspective cameras are read, "
                          f"undistort the "
                          "photos first")
    width, height = group.get("ImageDimensions").integer("Width"), group.get("ImageDimensions").integer("Height")
    pitch = None
    if group.maybe("SensorSize") is not None:
        pitch = group.number("SensorSize") / max(width, height)
    if group.maybe("FocalLengthPixels") is not None:
        f = group.number("FocalLengthPixels")
    elif pitch:
        f = group.number("FocalLength") / pitch
    else:
        raise group.error("has neither <FocalLengthPixels> nor <FocalLength> with <SensorSize>")
    pp = group.maybe("PrincipalPoint")
    cx, cy = (pp.number("x"), pp.number("y")) if pp is not None else ((width - 1) / 2, (height - 1) / 2)
    d = group.maybe("Distortion")
    k1, k2, k3, p1, p2 = (d.number(k, default=0.0) if d is not None else 0.0 for k in ("K1", "K2", "K3", "P1", "P2"))
    try:
        return Brown(f, f * group.number("AspectRatio", default=1.0), cx, cy, group.number("Skew", default=0.0), k1, k2, k3,
                     p1=p2,
                     p2=p1, width=width, height=height, pixel_mm=(pitch, pitch) if pitch else None)
    except PhotogrammetryError as error:
        raise group.error(str(error)) from None


def _orientation(group: Xml) -> np.ndarray:
    """(3, 3) turns the camera axes of the group into x right, y down, z forward."""
    said = group.maybe("CameraOrientation")
    if said is None:
        return np.eye(3)
    for x, a in SIDES.items():
        for y, b in SIDES.items():
            if said.text() == f"X{x}Y{y}" and abs(np.dot(a, b)) < 1:
                return np.stack([a, b, np.cross(a, b)], axis=1)
    raise said.error(f"is {said.text()}, expected a word such as XRightYDown")


def _pose(photo: Xml, turn: np.ndarray) -> Exterior | None:
    pose = photo.maybe("Pose")
    if pose is None or pose.maybe("Center") is None:
        return None
    centre = np.array([pose.get("Center").number(k) for k in "xyz"])
    r = pose.maybe("Rotation")
    if r is None:
        return Exterior(np.full((3, 3), np.nan), centre)
    if r.maybe("M_00") is not None:
        m = np.array([[r.number(f"M_{i}{j}") for j in range(3)] for i in range(3)])
    elif r.maybe("Omega") is not None:
        m = rotation_from(np.array([r.number(k) for k in ("Omega", "Phi", "Kappa")]), AngleOrder.OPK, AngleUnit.DEGREES)
    else:
        raise r.error("has neither a matrix nor omega, phi, kappa (yaw, pitch, roll are not read); export with one of them")
    try:
        return exterior_from(turn @ m, centre, *CONVENTION)
    except BadTable as error:
        raise r.error(str(error)) from None


# -- writing --------------------------------------------------------------------------------------------------------------


def write(scene: Exchange, path: Path) -> tuple[str, ...]:
    """One block with one photogroup a camera, poses as matrices, control and tie points; returns notes."""
    notes: list[str] = []
    out = ['<?xml version="1.0" encoding="utf-8"?>', '<BlocksExchange version="2.1">']
    if scene.crs not in (None, "local"):
        out += ["<SpatialReferenceSystems><SRS><Id>0</Id><Name>project</Name>"
                f"<Definition>{escape(str(scene.crs))}</Definition></SRS></SpatialReferenceSystems>"]
    out += ["<Block>", f"<Name>{escape(scene.path.stem or 'block')}</Name>"]
    out += ["<SRSId>0</SRSId>"] if scene.crs not in (None, "local") else []
    out.append("<Photogroups>")
    for name, camera in scene.cameras.items():
        b, fit = to_brown(camera, TERMS)
        notes += fit.told(name)
        out += _group(name, b)
        for n, shot in enumerate(scene.shots):
            if shot.camera == name:
                out += _photo(n, shot)
        out.append("</Photogroup>")
    out.append("</Photogroups>")
    out += _written_points(scene)
    out += ["</Block>", "</BlocksExchange>"]
    write_text(path, "\n".join(out) + "\n")
    return tuple(notes)


def _n(value: float) -> str:
    return repr(float(value))


def _group(name: str, b: Brown) -> list[str]:
    size = [f"<FocalLengthPixels>{_n(b.fx)}</FocalLengthPixels>"]
    if b.pixel_mm is not None:
        size.append(f"<SensorSize>{_n(b.pixel_mm[0] * max(b.width, b.height))}</SensorSize>")
    return ["<Photogroup>", f"<Name>{escape(name)}</Name>",
            f"<ImageDimensions><Width>{b.width}</Width><Height>{b.height}</Height></ImageDimensions>",
            "<CameraModelType>Perspective</CameraModelType>", *size, "<CameraOrientation>XRightYDown</CameraOrientation>",
            f"<PrincipalPoint><x>{_n(b.cx)}</x><y>{_n(b.cy)}</y></PrincipalPoint>",
            f"<Distortion><K1>{_n(b.k1)}</K1><K2>{_n(b.k2)}</K2><K3>{_n(b.k3)}</K3><P1>{_n(b.p2)}</P1><P2>{_n(b.p1)}</P2></Distortion>",
            f"<AspectRatio>{_n(b.fy / b.fx)}</AspectRatio>", f"<Skew>{_n(b.skew)}</Skew>"]


def _photo(n: int, shot: Shot) -> list[str]:
    out = [f"<Photo><Id>{n}</Id><ImagePath>{escape(shot.file or label_of(shot))}</ImagePath>"]
    if shot.exterior is not None:
        r, c = exterior_as(shot.exterior, *CONVENTION)
        turned = "".join(f"<M_{i}{j}>{_n(r[i, j])}</M_{i}{j}>" for i in range(3) for j in range(3)) if shot.oriented else ""
        out.append(f"<Pose>{f'<Rotation>{turned}<Accurate>true</Accurate></Rotation>' if turned else ''}<Center>"
                   + "".join(f"<{k}>{_n(v)}</{k}>" for k,
                             v in zip("xyz", c, strict=True)) + "<Accurate>true</Accurate></Center></Pose>")
    return [*out, "</Photo>"]


def _written_points(scene: Exchange) -> list[str]:
    p, of = scene.points, scene.observations
    rows: dict[int, list[int]] = {}
    for r, j in enumerate(of.point):
        rows.setdefault(int(j), []).append(r)
    control, ties = ["<ControlPoints>"], ["<TiePoints>"]
    for j, (name, role) in enumerate(zip(p.names, p.role, strict=True)):
        known = np.isfinite(p.xyz[j]).all()
        place = "<Position>" + "".join(f"<{k}>{_n(v)}</{k}>" for k, v in zip("xyz", p.xyz[j], strict=True)) + "</Position>"
        marks = "".join(f"<Measurement><PhotoId>{of.image[r]}</PhotoId><x>{_n(of.pixel[r, 0])}</x><y>{_n(of.pixel[r, 1])}</y>"
                        "</Measurement>" for r in rows.get(j, ()))
        if role == "tie":
            ties.append(f"<TiePoint>{place if known else ''}{marks}</TiePoint>")
            continue
        sd = p.sigma[j]
        accuracy = (f"<HorizontalAccuracy>{_n(max(sd[0], sd[1]))}</HorizontalAccuracy>"
                    f"<VerticalAccuracy>{_n(sd[2])}</VerticalAccuracy>") if np.isfinite(sd).all() else ""
        check = "<CheckPoint>true</CheckPoint>" if role == "check" else ""
        srs = "" if scene.crs in (None, "local") else "<SRSId>0</SRSId>"
        control.append(f"<ControlPoint><Name>{escape(name)}</Name>{srs}"
                       f"{place}{accuracy}{check}{marks}</ControlPoint>")
    return [*control, "</ControlPoints>", *ties, "</TiePoints>"] if len(p) else []
