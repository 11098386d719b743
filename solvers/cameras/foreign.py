"""Cameras of other tools: their parameters by their own names <-> `Brown`, and `Brown` <-> our ten parameters.

Ours corrects measured coordinates, nearly all others distort ideal ones; neither polynomial is the inverse of the other. Going
across is a least-squares fit over the whole format, and its residual in pixels comes with the result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import Unsupported
from .brown import COEFFICIENTS, Brown
from .distortion import correct_derivatives
from .forward import Forward
from .interior import Interior

PITCH_MM = 0.004
"""Nominal pixel size where a tool states none: c and the coefficients scale with it, no projection changes."""
CORNER = 0.5
"""The centre of the top-left pixel, for tools that count from its outer corner."""


@dataclass(frozen=True)
class Fit:
    """What a change of camera model costs: largest and rms distance in pixels over the whole format; both 0 when exact."""

    max_px: float = 0.0
    rms_px: float = 0.0

    def told(self, camera: str) -> tuple[str, ...]:
        """A note for a person, none below 1e-6 px."""
        if self.max_px < 1e-6:
            return ()
        return (f"camera {camera}: its distortion is stated the other way or with other terms and was refitted over the whole "
                f"format: at most {self.max_px:.2g} px off, rms {self.rms_px:.2g} px",)


# -- ours <-> Brown -------------------------------------------------------------------------------------------------------


def to_brown(camera: Interior | Brown, terms: Sequence[str] = (*COEFFICIENTS[:4], "p1", "p2")) -> tuple[Brown, Fit]:
    """A camera as `Brown` with no other coefficients than `terms` ("aspect" and "skew" allow fx != fy and a skew), and the fit.

    Exact when the camera is a `Brown` within the terms, or distorts nothing. The principal point stays.
    """
    camera = _as_brown(camera) if isinstance(camera, Forward) else camera
    if isinstance(camera, Brown):
        if _within(camera, terms):
            return camera, Fit()
        start, pixels = camera, _grid(camera.width, camera.height)
        xy = camera.ideal(pixels)
    else:
        start, pixels = _pinhole(camera), _grid(camera.width, camera.height)
        ideal = camera.ideal(pixels) / camera.c
        xy = np.stack([ideal[..., 0], -ideal[..., 1]], -1)
        if not np.any(camera.coefficients[:5]) and _within(start, terms):
            return start, Fit()
    fitted = _solve(start, [t for t in terms if t in COEFFICIENTS], "aspect" in terms, "skew" in terms, xy, pixels)
    return fitted, _fit(fitted.measured(xy) - pixels)


def to_interior(camera: Interior | Brown) -> tuple[Interior, Fit]:
    """A camera as our ten parameters, and the fit; exact when it distorts nothing.

    Raises Unsupported where the other tool's distortion folds within the format.
    """
    camera = _as_brown(camera) if isinstance(camera, Forward) else camera
    if isinstance(camera, Interior):
        return camera, Fit()
    pitch = camera.pixel_mm or (PITCH_MM, PITCH_MM)
    c = camera.fy * pitch[1]
    xp, yp = (camera.cx - (camera.width - 1) / 2) * pitch[0], -(camera.cy - (camera.height - 1) / 2) * pitch[1]
    b1 = c / (pitch[0] * camera.fx) - 1
    b2 = camera.skew / camera.fx
    plain = Interior(c, xp, yp, b1=_clean(b1), b2=_clean(b2), pixel_mm=pitch, width=camera.width, height=camera.height)
    if not camera.distorts:
        return plain, Fit()
    pixels = _grid(camera.width, camera.height)
    xy = camera.ideal(pixels)
    seen = np.isfinite(xy).all(axis=-1)
    if seen.mean() < 0.9:
        raise Unsupported(f"the camera's distortion folds back on itself in {1 - seen.mean():.0%} of the format; calibrate it "
                          "with fewer coefficients, or undistort the photos in the tool it comes from")
    xy, pixels = xy[seen], pixels[seen]
    reduced = plain.photo(pixels) - plain.principal_point
    target = np.stack([xy[:, 0], -xy[:, 1]], -1) * c
    a = correct_derivatives(reduced).reshape(-1, 7)
    size = np.linalg.norm(a, axis=0)
    x = np.linalg.lstsq(a / size, (target - reduced).ravel(), rcond=None)[0] / size
    k1, k2, k3, p1, p2, b1, b2 = (float(v) for v in x)
    fitted = replace(plain, k1=k1, k2=k2, k3=k3, p1=p1, p2=p2, b1=b1, b2=b2)
    return fitted, _fit(fitted.measured(target) - pixels)


def project_camera(camera: Interior | Brown, rotated: np.ndarray) -> np.ndarray:
    """Pixels (..., 2) of points (..., 3) in the photo's axes (x right, y up, z back); NaN behind the camera."""
    u, v, w = np.moveaxis(np.asarray(rotated, float), -1, 0)
    with np.errstate(all="ignore"):
        x, y = np.where(w < 0, -u / w, np.nan), np.where(w < 0, -v / w, np.nan)
    if isinstance(camera, Interior):
        return camera.measured(camera.c * np.stack([x, y], -1))
    return camera.measured(np.stack([x, -y], -1))


def _as_brown(camera: Forward) -> Interior | Brown:
    """A forward camera as it is, y counted down; with affinity or shear (of ideal coordinates) it stays and is fitted."""
    if camera.b1 or camera.b2:
        return camera
    px, py = (float(p) for p in camera.pitch)
    return Brown(camera.c / px, camera.c / py, (camera.width - 1) / 2 + camera.xp / px, (camera.height - 1) / 2 - camera.yp / py,
                 k1=camera.k1, k2=camera.k2, k3=camera.k3, p1=-camera.p2, p2=camera.p1, width=camera.width, height=camera.height,
                 pixel_mm=(px, py))


def _clean(value: float) -> float:
    return 0.0 if abs(value) < 1e-15 else value


def _pinhole(camera: Interior) -> Brown:
    """The camera without its distortion, affinity and shear kept exactly."""
    px, py = (float(p) for p in camera.pitch)
    fx = camera.c / px / (1 + camera.b1)
    skew = fx * camera.b2  # measured x = (X - b2 Y) / (1 + b1) with X = c x, Y = -c y
    return Brown(fx, camera.c / py, (camera.width - 1) / 2 + camera.xp / px, (camera.height - 1) / 2 - camera.yp / py, skew,
                 width=camera.width, height=camera.height, pixel_mm=(px, py))


def _within(camera: Brown, terms: Sequence[str]) -> bool:
    free = all(getattr(camera, k) == 0 for k in COEFFICIENTS if k not in terms)
    square = abs(camera.fx - camera.fy) <= 1e-14 * camera.fx
    return free and ("aspect" in terms or square) and ("skew" in terms or camera.skew == 0)


def _grid(width: int, height: int, n: int = 25) -> np.ndarray:
    """Pixels (n * n, 2) over the whole format, denser towards its edges."""
    t = (1 - np.cos(np.linspace(0, np.pi, n))) / 2
    col, row = np.meshgrid(t * width - 0.5, t * height - 0.5)
    return np.stack([col.ravel(), row.ravel()], -1)


def _solve(start: Brown, names: Sequence[str], aspect: bool, skew: bool, xy: np.ndarray, pixels: np.ndarray) -> Brown:
    from scipy.optimize import least_squares

    known = np.isfinite(xy).all(axis=-1)
    free = [*names, *(["fx"] if aspect else []), *(["skew"] if skew else [])]
    base = replace(start, **dict.fromkeys(COEFFICIENTS, 0.0))
    base = base if aspect else replace(base, fx=base.fy)
    base = base if skew else replace(base, skew=0.0)
    if not free:
        return base
    r2 = float(np.nanmax((xy[known] ** 2).sum(axis=-1)))
    order = {"k1": 1.0, "k2": 2.0, "k3": 3.0, "k4": 4.0, "d1": 1.0, "d2": 2.0, "d3": 3.0, "p1": 0.5, "p2": 0.5}
    scale = np.array([1e-2 / r2 ** order[n] if n in order else 1.0 for n in free])

    def camera(x: np.ndarray) -> Brown:
        return replace(base, **{n: float(getattr(base, n) + v) for n, v in zip(free, x * scale, strict=True)})

    found = least_squares(lambda x: (camera(x).measured(xy[known]) - pixels[known]).ravel(), np.zeros(len(free)), method="lm",
                          xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return camera(found.x)


def _fit(off: np.ndarray) -> Fit:
    d = np.linalg.norm(off, axis=-1)
    d = d[np.isfinite(d)]
    return Fit(float(d.max(initial=0.0)), float(np.sqrt(np.mean(d**2))) if len(d) else 0.0)


# -- by name --------------------------------------------------------------------------------------------------------------


def from_opencv(matrix: np.ndarray, distortion: np.ndarray, width: int, height: int) -> Brown:
    """OpenCV's camera matrix (3, 3) and distortion (0, 4, 5 or 8: k1, k2, p1, p2, k3, k4 ...). Raises Unsupported for more."""
    k, d = np.asarray(matrix, float).reshape(3, 3), np.asarray(distortion, float).ravel()
    if len(d) > 8 and np.any(d[8:]):
        raise Unsupported("thin prism and tilted sensor coefficients (more than 8) have no counterpart here; calibrate with 8 or "
                          "fewer")
    d = np.pad(d[:8], (0, 8 - len(d[:8])))
    return Brown(k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1], k1=d[0], k2=d[1], k3=d[4], d1=d[5], d2=d[6], d3=d[7], p1=d[2],
                 p2=d[3], width=width, height=height)


def as_opencv(camera: Interior | Brown) -> tuple[np.ndarray, np.ndarray, Fit]:
    """OpenCV's camera matrix (3, 3), its distortion (5,) or (8,), and the fit; OpenCV knows no skew of the axes."""
    radial = ("k1", "k2", "k3", "d1", "d2", "d3") if isinstance(camera, Brown) else ("k1", "k2", "k3")
    b, fit = to_brown(camera, (*radial, "p1", "p2", "aspect"))
    names = ("k1", "k2", "p1", "p2", "k3", *(("d1", "d2", "d3") if any((b.d1, b.d2, b.d3)) else ()))
    return (np.array([[b.fx, 0.0, b.cx], [0.0, b.fy, b.cy], [0.0, 0.0, 1.0]]),
            np.array([float(getattr(b, name)) for name in names]), fit)


def from_metashape(p: Mapping[str, float], width: int, height: int, pixel_mm: tuple[float, float] | None = None) -> Brown:
    """Metashape's frame camera: f, cx, cy (from the image centre), k1..k4, p1, p2 (the other way round), b1, b2 [px].

    Reference: Metashape manual, appendix "Camera models": u = w/2 + cx + x' f + x' b1 + y' b2, v = h/2 + cy + y' f.
    """
    g = {k: float(p.get(k, 0.0)) for k in ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")}
    return Brown(g["f"] + g["b1"], g["f"], width / 2 + g["cx"] - CORNER, height / 2 + g["cy"] - CORNER, g["b2"], k1=g["k1"],
                 k2=g["k2"], k3=g["k3"], k4=g["k4"], p1=g["p2"], p2=g["p1"], width=width, height=height, pixel_mm=pixel_mm)


METASHAPE_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2", "aspect", "skew")


def as_metashape(camera: Interior | Brown) -> tuple[dict[str, float], Fit]:
    """Metashape's parameters by name, and the fit."""
    b, fit = to_brown(camera, METASHAPE_TERMS)
    return {"f": b.fy, "cx": b.cx + CORNER - b.width / 2, "cy": b.cy + CORNER - b.height / 2, "k1": b.k1, "k2": b.k2, "k3": b.k3,
            "k4": b.k4, "p1": b.p2, "p2": b.p1, "b1": b.fx - b.fy, "b2": b.skew}, fit


def from_pix4d(focal_px: float, principal_point: Sequence[float], radial: Sequence[float], tangential: Sequence[float],
               width: int, height: int, pixel_mm: tuple[float, float] | None = None) -> Brown:
    """Pix4D's and OPF's perspective camera: principal point from the corner, R1..R3, T1, T2 in OpenCV's order."""
    return Brown(focal_px, focal_px, principal_point[0] - CORNER, principal_point[1] - CORNER, k1=radial[0], k2=radial[1],
                 k3=radial[2], p1=tangential[0], p2=tangential[1], width=width, height=height, pixel_mm=pixel_mm)


PIX4D_TERMS = ("k1", "k2", "k3", "p1", "p2")


def as_pix4d(camera: Interior | Brown) -> tuple[dict[str, Any], Fit]:
    """focal_length_px, principal_point_px, radial_distortion, tangential_distortion as OPF names them, and the fit."""
    b, fit = to_brown(camera, PIX4D_TERMS)
    return {"focal_length_px": b.fy, "principal_point_px": [b.cx + CORNER, b.cy + CORNER],
            "radial_distortion": [b.k1, b.k2, b.k3], "tangential_distortion": [b.p1, b.p2]}, fit


COLMAP_MODELS: dict[str, tuple[int, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": (0, ("f", "cx", "cy")), "PINHOLE": (1, ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": (2, ("f", "cx", "cy", "k1")), "RADIAL": (3, ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": (4, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": (6, ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "d1", "d2", "d3")),
}
"""Model numbers and parameters of COLMAP's cameras without fisheye; its principal points count from the corner."""
COLMAP_OTHERS = {5: ("OPENCV_FISHEYE", 8), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5),
                 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16)}


def from_colmap(model: str, params: Sequence[float], width: int, height: int) -> Brown:
    """A camera of COLMAP. Raises Unsupported for fisheye models and a wrong number of parameters."""
    if model not in COLMAP_MODELS:
        raise Unsupported(f"the camera model {model} is not one of {', '.join(COLMAP_MODELS)}; undistort the photos in COLMAP "
                          "(image_undistorter) and take the model it writes")
    names = COLMAP_MODELS[model][1]
    if len(params) != len(names):
        raise Unsupported(f"the camera model {model} has {len(params)} parameters where it takes {len(names)}; export it again")
    p = dict(zip(names, map(float, params), strict=True))
    f = p.pop("f", None)
    if f is not None:
        p["fx"] = p["fy"] = f
    p["cx"], p["cy"] = p["cx"] - CORNER, p["cy"] - CORNER
    return Brown(**p, width=width, height=height)  # type: ignore[arg-type]


def as_colmap(camera: Interior | Brown) -> tuple[str, list[float], Fit]:
    """The simplest of COLMAP's models that holds the camera, its parameters, and the fit."""
    b, fit = to_brown(camera, ("k1", "k2", "k3", "d1", "d2", "d3", "p1", "p2", "aspect") if isinstance(camera, Brown)
                      else ("k1", "k2", "k3", "p1", "p2", "aspect"))
    if not b.distorts:
        model = "PINHOLE" if abs(b.fx - b.fy) > 1e-14 * b.fx else "SIMPLE_PINHOLE"
    elif not any((b.k3, b.d1, b.d2, b.d3, b.p1, b.p2)) and abs(b.fx - b.fy) <= 1e-14 * b.fx:
        model = "RADIAL" if b.k2 else "SIMPLE_RADIAL"
    else:
        model = "FULL_OPENCV" if any((b.k3, b.d1, b.d2, b.d3)) else "OPENCV"
    shifted = {"f": b.fy, "cx": b.cx + CORNER, "cy": b.cy + CORNER}
    return model, [float(shifted.get(n, getattr(b, n, 0.0))) for n in COLMAP_MODELS[model][1]], fit


AUSTRALIS = {"c": "c", "xp": "xp", "yp": "yp", "k1": "k1", "k2": "k2", "k3": "k3", "p1": "p1", "p2": "p2", "b1": "b1", "b2": "b2"}


def from_australis(p: Mapping[str, float], width: int, height: int, pixel_mm: tuple[float, float]) -> Interior:
    """Australis's and iWitness's ten parameters [mm]: the same model as ours, x right, y up, correcting measured coordinates."""
    return Interior(**{k: float(p.get(k, 0.0)) for k in AUSTRALIS}, pixel_mm=pixel_mm, width=width, height=height)
