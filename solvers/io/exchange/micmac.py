"""MicMac's orientation folders: Orientation-IMAGE.xml with their calibrations (AutoCal_*.xml).

The matrix (rows L1, L2, L3) turns camera axes (x right, y down, z forward) into object axes, Centre is the perspective centre.
F and PP are pixels, distortion corrects measured pixels about CDist: ideal = m + (m - CDist) (a r^2 + b r^4 + c r^6), which is
our direction; a distortion centre away from PP is refitted. Pixel (0, 0) is taken as the centre of the top-left pixel.
References: MicMac wiki "OriExport" (the same matrix beside omega, phi, kappa); MicMac documentation, "Camera calibration".
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...cameras import Interior
from ...cameras.distortion import correct_derivatives
from ...cameras.foreign import PITCH_MM, Fit
from ...errors import BadTable, PhotogrammetryError, Unsupported
from ...geometry import Exterior
from .conventions import CameraAxes, Position, RotationDirection, exterior_from
from .options import NOTHING, Reading
from .scene import Exchange, Shot, named
from .structure import Xml, read_xml

CONVENTION = (CameraAxes.VISION, RotationDirection.CAMERA_TO_OBJECT, Position.CENTRE)


def looks_like(path: Path, head: str) -> bool:
    """Whether an XML's beginning is an orientation of MicMac."""
    return "<OrientationConique" in head or "<ExportAPERO" in head


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """All orientations of a folder, or of one file. Raises BadTable and Unsupported."""
    files = sorted(path.glob("Orientation-*.xml")) if path.is_dir() else [path]
    if not files:
        raise BadTable(f"{path}: there is no Orientation-*.xml in this folder; give MicMac's Ori-NAME folder")
    cameras: dict[str, Interior] = {}
    notes: list[str] = []
    shots = []
    names = named([f.name.removeprefix("Orientation-").removesuffix(".xml") for f in files])
    for file, (name, photo) in zip(files, names, strict=True):
        root = read_xml(file)
        o = root if root.tag == "OrientationConique" else root.get("OrientationConique")
        inner, camera = _calibration(o, file)
        if camera not in cameras:
            cameras[camera], fit = interior_of(inner)
            notes += fit.told(camera)
        shots.append(Shot(name, camera, _pose(o), photo))
    return Exchange("MicMac", path, options.crs or "local", dict(cameras), tuple(shots), notes=tuple(notes))


def _calibration(o: Xml, file: Path) -> tuple[Xml, str]:
    """The calibration, inside the file or beside it, and its name."""
    inside = o.maybe("Interne")
    if inside is not None:
        return inside, f"of-{file.stem.removeprefix('Orientation-')}"
    name = Path(o.get("FileInterne").text().replace("\\", "/")).name
    beside = file.parent / name
    if not beside.is_file():
        raise BadTable(f"{file}: its calibration {name} is not in the folder; copy it there")
    root = read_xml(beside)
    inner = root if root.tag == "CalibrationInternConique" else root.get("CalibrationInternConique")
    return inner, beside.stem


def _pose(o: Xml) -> Exterior:
    place = o.get("Externe")
    kind = o.maybe("ConvOri", "KnownConv")
    if kind is not None and kind.text() not in ("eConvApero_DistM2C", "eConvApero_DistC2M"):
        raise Unsupported(f"{o.path}: its convention is {kind.text()}; only eConvApero_DistM2C is read, export it with mm3d")
    rows = place.get("ParamRotation", "CodageMatr")
    r = np.stack([rows.get(k).numbers(3) for k in ("L1", "L2", "L3")])
    try:
        return exterior_from(r, place.get("Centre").numbers(3), *CONVENTION)
    except BadTable as error:
        raise rows.error(str(error)) from None


def interior_of(c: Xml) -> tuple[Interior, Fit]:
    """A calibration as our ten parameters, and what a distortion centre off the principal point costs."""
    f, pp, size = c.number("F"), c.get("PP").numbers(2), c.get("SzIm").numbers(2)
    width, height = round(size[0]), round(size[1])
    p = PITCH_MM
    try:
        camera = Interior(f * p, (pp[0] - (width - 1) / 2) * p, -(pp[1] - (height - 1) / 2) * p, pixel_mm=p, width=width,
                          height=height)
    except PhotogrammetryError as error:
        raise c.error(str(error)) from None
    lens = c.all("CalibDistortion")
    if not lens:
        return camera, Fit()
    d = lens[-1]
    model = d.maybe("ModRad") or d.maybe("ModPhgrStd", "RadialePart")
    if model is None:
        if d.maybe("ModNoDist") is not None:
            return camera, Fit()
        kinds = ", ".join(x.tag for x in d.children()) or "nothing"
        raise Unsupported(f"{c.path}: its distortion is {kinds}; only ModRad and ModPhgrStd are read, calibrate with RadialStd "
                          f"or Fraser")
    centre = model.get("CDist").numbers(2) if model.maybe("CDist") is not None else pp
    radial = [e.number() for e in model.all("CoeffDist")] + [0.0] * 3
    extra = d.maybe("ModPhgrStd")
    more = [extra.number(k, default=0.0) if extra is not None else 0.0 for k in ("P1", "P2", "b1", "b2")]
    if any(radial[3:]):
        raise Unsupported(f"{c.path}: its distortion has more than three radial coefficients; calibrate with RadialStd or Fraser")
    return _fitted(camera, pp, centre, np.array(radial[:3]), np.array(more), f)


def corrected(pixels: np.ndarray, centre: np.ndarray, radial: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Ideal pixels (n, 2) of measured ones: MicMac's radial, decentring and affine correction (P1, P2, b1, b2) about `centre`."""
    x, y = (pixels - centre).T
    r2 = x * x + y * y
    s = r2 * (radial[0] + r2 * (radial[1] + r2 * radial[2]))
    p1, p2, b1, b2 = more
    return pixels + np.stack([x * s + p1 * (2 * x * x + r2) + 2 * p2 * x * y + b1 * x + b2 * y,
                              y * s + p2 * (2 * y * y + r2) + 2 * p1 * x * y], -1)


def _fitted(camera: Interior, pp: np.ndarray, centre: np.ndarray, radial: np.ndarray, more: np.ndarray, f: float,
            ) -> tuple[Interior, Fit]:
    from dataclasses import replace

    from ...cameras.foreign import _grid

    pixels = _grid(camera.width, camera.height)
    target = (corrected(pixels, centre, radial, more) - pp) * [PITCH_MM, -PITCH_MM]
    reduced = camera.photo(pixels) - camera.principal_point
    a = correct_derivatives(reduced)
    if not np.allclose(centre, pp, atol=1e-9):  # the constant part of a distortion about another centre moves the principal point
        a = np.concatenate([a, np.broadcast_to(np.eye(2), (len(pixels), 2, 2))], axis=-1)
    a = a.reshape(2 * len(pixels), -1)
    size = np.linalg.norm(a, axis=0)
    x = np.linalg.lstsq(a / size, (target - reduced).ravel(), rcond=None)[0] / size
    names = ("k1", "k2", "k3", "p1", "p2", "b1", "b2")
    fitted = replace(camera, **dict(zip(names, map(float, x[:7]), strict=True)))
    if len(x) > 7:
        fitted = replace(fitted, xp=camera.xp - float(x[7]), yp=camera.yp - float(x[8]))
        # about the moved point the fit is repeated once, linear again
        reduced = fitted.photo(pixels) - fitted.principal_point
        a = correct_derivatives(reduced).reshape(-1, 7)
        size = np.linalg.norm(a, axis=0)
        x = np.linalg.lstsq(a / size, (target - reduced).ravel(), rcond=None)[0] / size
        fitted = replace(fitted, **dict(zip(names, map(float, x), strict=True)))
    off = (fitted.ideal(pixels) - target) / PITCH_MM
    d = np.linalg.norm(off, axis=-1)
    return fitted, Fit(float(d.max()), float(np.sqrt(np.mean(d**2))))


