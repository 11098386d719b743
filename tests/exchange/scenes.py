"""A known scene, and files of other tools made from it by the tools' own formulas, without the product's writers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from solvers import Exterior, Observations, Points
from solvers.cameras import Interior
from solvers.cameras.brown import Brown
from solvers.cameras.foreign import project_camera
from solvers.geometry import log, rotation
from solvers.io.exchange.scene import Camera, Exchange, Shot

FULL = Brown(3712.5, 3712.5, 2731.25, 1802.75, k1=-0.012, k2=0.009, k3=-0.002, p1=0.0009, p2=-0.0006, width=5472, height=3648)
"""Principal point off the middle, distortion ideal to measured."""
MIDDLE = Brown(3712.5, 3712.5, 2735.5, 1823.5, k1=-0.012, k2=0.009, width=5472, height=3648)
"""What Bundler and BAL can hold."""
OURS = Interior(9.2, 0.031, -0.017, 1.1e-5, -2e-8, 0.0, 1.5e-6, -2.5e-6, pixel_mm=0.0024, width=5472, height=3648)
"""Distortion measured to ideal."""
DEGREES = ((7.3, -5.1, 88.4), (-25.0, 12.5, -171.3), (38.0, -31.0, 12.7), (-3.2, 44.0, 100.1))
ORIGIN = np.array([684_210.0, 5_334_100.0, 400.0])


def scene(camera: Camera = FULL, crs: str = "local", origin: np.ndarray = ORIGIN) -> Exchange:
    """Four off-nadir images over a ground with relief, every point measured where it is seen."""
    rng = np.random.default_rng(11)
    centres = origin + np.array([[0, 0, 300.0], [40.5, 80.25, 310], [-75.125, -60, 325.5], [95, 20, 290]])
    shots = tuple(Shot(f"DSC0{n + 1}", "lens", Exterior(rotation(*np.radians(a)), c), f"DSC0{n + 1}.JPG")
                  for n, (a, c) in enumerate(zip(DEGREES, centres, strict=True)))
    rows, ground = [], []
    for shot in shots:  # points seen in each image, and by chance in others
        pixels = rng.uniform([300, 300], [5100, 3300], (6, 2))
        rays = _rays(camera, pixels) @ shot.exterior.m  # type: ignore[union-attr]
        height = origin[2] + rng.uniform(-10, 30, 6)
        ground += list(shot.exterior.centre + rays * ((height - shot.exterior.centre[2]) / rays[:, 2])[:, None])  # type: ignore
    xyz = np.array(ground)
    for i in range(len(shots)):
        p = pixels_of(camera, shots[i], xyz)
        rows += [(i, j, *p[j]) for j in range(len(xyz)) if camera.inside(p[j], -1.0)]
    table = np.array(rows)
    role = tuple("control" if j % 3 == 0 else "check" if j % 3 == 1 else "tie" for j in range(len(xyz)))
    sigma = np.where(np.array([r != "tie" for r in role])[:, None], [0.02, 0.02, 0.03], np.nan)
    points = Points(tuple(f"P{j + 1}" for j in range(len(xyz))), xyz, sigma, role)
    marks = Observations(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:], np.full(len(table), np.nan))
    return Exchange("made", Path("made"), crs, {"lens": camera}, shots, points, marks)


def _rays(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    if isinstance(camera, Brown):
        xy = camera.ideal(pixels)
        return np.column_stack([xy[:, 0], -xy[:, 1], -np.ones(len(xy))])
    return np.column_stack([camera.ideal(pixels) / camera.c, -np.ones(len(pixels))])


def pixels_of(camera: Camera, shot: Shot, xyz: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) by the product."""
    assert shot.exterior is not None
    return project_camera(camera, shot.exterior.camera(xyz))


def opencv_pixels(camera: Brown, exterior: Exterior, xyz: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) by OpenCV, from the centre of the top-left pixel."""
    import cv2

    r = np.diag([1.0, -1, -1]) @ exterior.m
    k = np.array([[camera.fx, camera.skew, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    d = np.array([camera.k1, camera.k2, camera.p1, camera.p2, camera.k3])
    return cv2.projectPoints((xyz - exterior.centre) @ r.T, np.zeros(3), np.zeros(3), k, d)[0].reshape(-1, 2)


# -- files by hand --------------------------------------------------------------------------------------------------------


def vision(s: Shot) -> tuple[np.ndarray, np.ndarray]:
    """Rotation to x right, y down, z forward, and centre."""
    assert s.exterior is not None
    return np.diag([1.0, -1, -1]) @ s.exterior.m, s.exterior.centre


def metashape_xml(scene: Exchange, path: Path, scale: float = 2.5) -> Path:
    """cameras.xml with a chunk transform of scale, rotation and shift, as Metashape exports a chunk in local coordinates."""
    b = scene.cameras["lens"]
    assert isinstance(b, Brown)
    r, t = rotation(0.3, -0.2, 1.1).T, scene.shots[0].exterior.centre.copy()  # type: ignore[union-attr]
    cameras = []
    for n, s in enumerate(scene.shots):
        rot, c = vision(s)
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = r.T @ rot.T, r.T @ (c - t) / scale
        cameras.append(f'<camera id="{n}" sensor_id="7" component_id="0" label="{s.file}"><transform>'
                       f'{" ".join(repr(float(v)) for v in local.ravel())}</transform></camera>')
    numbers = dict(f=b.fy, cx=b.cx + 0.5 - b.width / 2, cy=b.cy + 0.5 - b.height / 2, k1=b.k1, k2=b.k2, k3=b.k3, p1=b.p2, p2=b.p1)
    path.write_text(f"""<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="Chunk 1" enabled="true">
<sensors next_id="8"><sensor id="7" label="FC6310, 8.8mm" type="frame"><resolution width="{b.width}" height="{b.height}"/>
<property name="pixel_width" value="0.0024"/><property name="pixel_height" value="0.0024"/>
<calibration type="frame" class="initial"><resolution width="{b.width}" height="{b.height}"/><f>1000</f></calibration>
<calibration type="frame" class="adjusted"><resolution width="{b.width}" height="{b.height}"/>
{"".join(f"<{k}>{float(v)!r}</{k}>" for k, v in numbers.items())}</calibration></sensor></sensors>
<components next_id="1"><component id="0" label="Component 1"><transform>
<rotation locked="false">{" ".join(repr(float(v)) for v in r.ravel())}</rotation>
<translation locked="false">{" ".join(repr(float(v)) for v in t)}</translation><scale locked="false">{scale}</scale>
</transform></component></components>
<cameras next_id="4" next_group_id="0">{"".join(cameras)}</cameras>
<reference>LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]</reference>
</chunk></document>""")
    return path


def opensfm_json(scene: Exchange, path: Path) -> Path:
    """reconstruction.json with a brown camera."""
    b = scene.cameras["lens"]
    assert isinstance(b, Brown)
    side = max(b.width, b.height)
    shots = {}
    for s in scene.shots:
        r, c = vision(s)
        shots[s.file] = {"rotation": log(r).tolist(), "translation": (-r @ c).tolist(), "camera": "v2 dji fc6310 brown"}
    camera = {"projection_type": "brown", "width": b.width, "height": b.height, "focal_x": b.fx / side, "focal_y": b.fy / side,
              "c_x": (b.cx + 0.5 - b.width / 2) / side, "c_y": (b.cy + 0.5 - b.height / 2) / side, "k1": b.k1, "k2": b.k2,
              "k3": b.k3,
              "p1": b.p1, "p2": b.p2}
    points = {n: {"coordinates": x.tolist(), "color": [1, 2, 3]} for n,
              x in zip(scene.points.names, scene.points.xyz, strict=True)}
    path.write_text(json.dumps([{"cameras": {"v2 dji fc6310 brown": camera}, "shots": shots, "points": points}]))
    return path


def shots_geojson(scene: Exchange, path: Path) -> Path:
    """OpenDroneMap's shots.geojson and its cameras.json; translation is the centre in UTM."""
    from pyproj import Transformer

    b = scene.cameras["lens"]
    assert isinstance(b, Brown)
    to = Transformer.from_crs(scene.crs, "EPSG:4326", always_xy=True)
    features, side = [], max(b.width, b.height)
    for s in scene.shots:
        r, c = vision(s)
        lon, lat = to.transform(c[0], c[1])
        features.append({"type": "Feature", "properties": {"filename": s.file, "camera": "dji fc6310 brown", "focal": b.fx / side,
                                                            "width": b.width, "height": b.height, "translation": c.tolist(),
                                                            "rotation": log(r).tolist()},
                         "geometry": {"type": "Point", "coordinates": [lon, lat, float(c[2])]}})
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    camera = {"projection_type": "brown", "width": b.width, "height": b.height, "focal_x": b.fx / side, "focal_y": b.fy / side,
              "c_x": (b.cx + 0.5 - b.width / 2) / side, "c_y": (b.cy + 0.5 - b.height / 2) / side, "k1": b.k1, "k2": b.k2,
              "k3": b.k3,
              "p1": b.p1, "p2": b.p2}
    (path.parent / "cameras.json").write_text(json.dumps({"dji fc6310 brown": camera}))
    return path


def micmac_folder(scene: Exchange, path: Path) -> Path:
    """Ori folder; the distortion corrects measured pixels about the principal point."""
    c = scene.cameras["lens"]
    assert isinstance(c, Interior)
    path.mkdir()
    p = float(c.pitch[0])
    pp = (c.width - 1) / 2 + c.xp / p, (c.height - 1) / 2 - c.yp / p
    radial = [c.k1 * p**2, c.k2 * p**4, c.k3 * p**6]
    (path / "AutoCal_Foc-8800_Cam-FC6310.xml").write_text(f"""<?xml version="1.0" ?>
<ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv><PP>{pp[0]!r} {pp[1]!r}</PP><F>{c.c / p!r}</F>
<SzIm>{c.width} {c.height}</SzIm><CalibDistortion><ModPhgrStd><RadialePart><CDist>{pp[0]!r} {pp[1]!r}</CDist>
{"".join(f"<CoeffDist>{v!r}</CoeffDist>" for v in radial)}<PPaEqPPs>true</PPaEqPPs></RadialePart>
<P1>{c.p1 * p!r}</P1><P2>{-c.p2 * p!r}</P2><b1>{c.b1!r}</b1><b2>{-c.b2!r}</b2></ModPhgrStd></CalibDistortion>
</CalibrationInternConique></ExportAPERO>""")
    for s in scene.shots:
        r, centre = vision(s)
        rows = "".join(f"<L{k + 1}>{' '.join(repr(float(v)) for v in r.T[k])}</L{k + 1}>" for k in range(3))
        (path / f"Orientation-{s.file}.xml").write_text(f"""<?xml version="1.0" ?>
<ExportAPERO><OrientationConique><OrIntImaM2C><I00>0 0</I00><V10>1 0</V10><V01>0 1</V01></OrIntImaM2C>
<TypeProj>eProjStenope</TypeProj>
<FileInterne>Ori-Rel/AutoCal_Foc-8800_Cam-FC6310.xml</FileInterne><RelativeNameFI>true</RelativeNameFI>
<Externe><Profondeur>300</Profondeur><Centre>{' '.join(repr(float(v)) for v in centre)}</Centre>
<ParamRotation><CodageMatr>{rows}</CodageMatr></ParamRotation></Externe>
<ConvOri><KnownConv>eConvApero_DistM2C</KnownConv></ConvOri></OrientationConique></ExportAPERO>""")
    return path


HANDMADE: dict[str, tuple[str, Callable[[Exchange, Path], Path]]] = {
    "metashape": ("cameras.xml", metashape_xml), "opensfm": ("reconstruction.json", opensfm_json),
    "shots": ("shots.geojson", shots_geojson)}
