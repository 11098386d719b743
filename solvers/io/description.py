"""project.toml: its tables as values, every complaint naming file, table, key and cure."""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..block import Block, Gps, Image, Observations, Points, Prior, ScaleBar, Together
from ..cameras import PARAMETERS, Interior
from ..errors import BadProject, BadTable
from .files import decode_utf8, read_bytes

ORIGINS = ("center", "corner")
"""Pixel (0, 0): the centre of the top-left pixel, or its outer corner."""
COEFFICIENTS = PARAMETERS[3:]
CAMERA_KEYS = ("width", "height", "pixel_mm", "c_mm", "principal_point_px", "xp_mm", "yp_mm", *COEFFICIENTS, "readout_ms")
PRIOR_KEYS = ("X", "Y", "Z", "omega_deg", "phi_deg", "kappa_deg", "sigma_m", "sigma_deg", "velocity_m_s", "sigma_velocity_m_s",
              "turning_deg")


@dataclass(frozen=True)
class Section:
    """One table of project.toml, with its name for messages."""

    path: Path
    name: str
    values: Mapping[str, Any]

    def error(self, key: str, message: str) -> BadProject:
        return BadProject(f"{self.path} [{self.name}] {key}: {message}")

    def sub(self, key: str) -> Section:
        """A table inside this one, empty when absent."""
        value = self.values.get(key, {})
        if not isinstance(value, Mapping):
            raise self.error(key, f"{value!r} is not a table; write [{self._full(key)}] with its keys below")
        return Section(self.path, self._full(key), value)

    def tables(self, key: str) -> list[Section]:
        """The tables of an array [[key]], empty when absent."""
        value = self.values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(v, Mapping) for v in value):
            raise self.error(key, f"this is not a list of tables; write [[{key}]] with its keys below")
        return [Section(self.path, f"{key} {n + 1}", v) for n, v in enumerate(value)]

    def check_keys(self, known: Sequence[str]) -> None:
        """Raises BadProject for a key that looks like a misspelt known one (others are left alone)."""
        for key in self.values:
            near = [] if key in known else difflib.get_close_matches(key, [k for k in known if k not in self.values], 1, 0.75)
            if near:
                raise self.error(key, f"this key is not known; write {near[0]}")

    def text(self, key: str, default: str | None = None, choice: Sequence[str] = ()) -> str:
        value = self._get(key, default, "a text in double quotes")
        if not isinstance(value, str) or not value or (choice and value not in choice):
            wanted = "one of " + ", ".join(f'"{c}"' for c in choice) if choice else "a text in double quotes"
            raise self.error(key, f"{value!r} is not allowed; write {wanted}")
        return value

    def number(self, key: str, default: float | None = None, above: float | None = None, lowest: float | None = None,
               expected: str = "a number") -> float:
        return self._number(key, self._get(key, default, expected), above, lowest, expected)

    def integer(self, key: str, expected: str) -> int:
        value = self._get(key, None, expected)
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise self.error(key, f"{value!r} is not allowed; write {expected}")
        return value

    def vector(self, key: str, length: int, default: Sequence[float] | None = None, above: float | None = None,
               lowest: float | None = None, expected: str = "numbers") -> tuple[float, ...]:
        value = self._get(key, default, f"[{expected}]")
        if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != length:
            raise self.error(key, f"{value!r} is not allowed; write {length} numbers in brackets ({expected})")
        return tuple(self._number(key, v, above, lowest, expected) for v in value)

    def _get(self, key: str, default: Any, expected: str) -> Any:
        value = self.values.get(key, default)
        if value is None:
            raise self.error(key, f"this key is missing; write {key} = {expected}")
        return value

    def _number(self, key: str, value: Any, above: float | None, lowest: float | None, expected: str) -> float:
        fine = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not fine or (above is not None and value <= above) or (lowest is not None and value < lowest):
            raise self.error(key, f"{value!r} is not allowed; write {expected}")
        return float(value)

    def _full(self, key: str) -> str:
        quoted = key if key.replace("_", "").replace("-", "").isalnum() and key.isascii() else f'"{key}"'
        return f"{self.name}.{quoted}" if self.name else quoted


def read_description(path: Path) -> tuple[Block, str]:
    """The block of project.toml without its tables, and the pixel origin of observations.csv. Raises BadProject."""
    top = _load(path)
    top.check_keys(("project", "weights", "surface", "cameras", "images", "gps", "scale_bars", "control_covariance"))
    project, weights, surface = top.sub("project"), top.sub("weights"), top.sub("surface")
    project.check_keys(("name", "crs", "pixel_origin", "frame"))
    weights.check_keys(("image_px", "control_m"))
    surface.check_keys(("file", "z"))
    origin = project.text("pixel_origin", "center", ORIGINS)
    block = Block(
        name=project.text("name", path.parent.resolve().name or "project"),
        crs=project.text("crs"),
        frame=project.text("frame", "tangent", ("tangent", "grid")),
        cameras={name: _camera(top.sub("cameras").sub(name), origin) for name in top.sub("cameras").values},
        images=tuple(_image(top.sub("images").sub(name), name, top.sub("cameras")) for name in top.sub("images").values),
        points=Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
        observations=Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0)),
        image_px=weights.number("image_px", 0.5, above=0, expected="a positive number of pixels"),
        control_m=_three(weights.vector("control_m", 3, (0.02, 0.02, 0.04), lowest=0,
                                        expected="sX, sY, sZ in metres, not negative")),
        surface=_surface(surface),
        scale_bars=tuple(_bar(s) for s in top.tables("scale_bars")),
        together=tuple(_together(s) for s in top.tables("control_covariance")),
        gps=_gps(top.sub("gps")),
        readout_ms={name: s.number("readout_ms", above=0, expected="a positive number of milliseconds, first row to last")
                    for name in top.sub("cameras").values if "readout_ms" in (s := top.sub("cameras").sub(name)).values},
    )
    return block, origin


def describe(block: Block, origin: str = "center") -> dict[str, Any]:
    """What project.toml says of a block, as plain values in the order they are written."""
    frame = {"frame": block.frame} if block.frame != "tangent" else {}
    out: dict[str, Any] = {
        "project": {"name": block.name, "crs": block.crs, "pixel_origin": origin, **frame},
        "weights": {"image_px": float(block.image_px), "control_m": [float(s) for s in block.control_m]},
    }
    if block.surface:
        out["surface"] = dict(block.surface)
    if block.gps != Gps():
        out["gps"] = {"lever_arm_m": [float(v) for v in block.gps.lever_arm], "shift": block.gps.shift,
                      "shift_sigma_m": float(block.gps.shift_sigma)}
    if block.scale_bars:
        out["scale_bars"] = [{"from": b.first, "to": b.second, "length_m": float(b.length), "sigma_m": float(b.sigma)}
                             for b in block.scale_bars]
    if block.together:
        out["control_covariance"] = [{"points": list(t.points), "covariance_m2": t.covariance.tolist()} for t in block.together]
    readout = {name: {"readout_ms": float(block.readout_ms[name])} if name in block.readout_ms else {} for name in block.cameras}
    out["cameras"] = {name: _describe_camera(camera) | readout[name] for name, camera in block.cameras.items()}
    out["images"] = {image.name: _describe_image(image) for image in block.images}
    return out


def to_toml(value: Mapping[str, Any]) -> str:
    """TOML of plain values, every list of numbers on one line."""
    import tomli_w

    return re.sub(r"\[\n((?: +[^\s\[\]\"]+,\n)+)\]", lambda m: f"[{', '.join(m[1].replace(',', ' ').split())}]",
                  tomli_w.dumps(value))


def _load(path: Path) -> Section:
    try:
        text = decode_utf8(path,
                           read_bytes(path, "'collinea init' makes a project folder from photos and a list of control points"))
        return Section(path, "", tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise BadProject(f"{path}: this is not TOML: {_one_line(error)}; correct it there") from None
    except BadTable as error:
        raise BadProject(str(error)) from None


def _camera(table: Section, origin: str) -> Interior:
    table.check_keys(CAMERA_KEYS)
    width = table.integer("width", "the width of the photos in pixels, a positive whole number")
    height = table.integer("height", "the height of the photos in pixels, a positive whole number")
    pitch = "a positive pixel size in mm, or two of them [x, y]"
    if isinstance(table.values.get("pixel_mm"), Sequence) and not isinstance(table.values["pixel_mm"], str):
        pixel_mm = table.vector("pixel_mm", 2, above=0, expected=pitch)
    else:
        pixel_mm = (table.number("pixel_mm", above=0, expected=pitch),) * 2
    interior = Interior(
        table.number("c_mm", above=0, expected="a positive principal distance in mm"),
        *(0.0, 0.0),
        *(table.number(k, 0.0) for k in COEFFICIENTS),
        pixel_mm=(pixel_mm[0], pixel_mm[1]), width=width, height=height,
    )
    xp, yp = _principal_point(table, interior, origin)
    return replace(interior, xp=xp, yp=yp)


def _principal_point(table: Section, interior: Interior, origin: str) -> tuple[float, float]:
    """xp, yp in mm from whichever of the two forms is given."""
    in_px, in_mm = "principal_point_px" in table.values, "xp_mm" in table.values or "yp_mm" in table.values
    if in_px and in_mm:
        raise table.error("principal_point_px",
                          "the principal point is given twice; keep either principal_point_px or xp_mm and yp_mm")
    if in_px:
        pixel = table.vector("principal_point_px", 2, expected="col, row") - np.full(2, 0.5 if origin == "corner" else 0.0)
        x, y = interior.photo(pixel)
        return float(x), float(y)
    if in_mm:
        return table.number("xp_mm"), table.number("yp_mm")
    raise table.error("principal_point_px",
                      "the principal point is missing; write principal_point_px = [col, row], or xp_mm and yp_mm "
                      "(both 0 when it is not known)")


def _image(table: Section, name: str, cameras: Section) -> Image:
    table.check_keys(("file", "camera", "prior", "strip"))
    camera = table.text("camera")
    if camera not in cameras.values:
        there = ", ".join(cameras.values) or "none: add [cameras.NAME]"
        raise table.error("camera", f"there is no camera '{camera}'; the cameras are {there}")
    file = table.text("file") if "file" in table.values else None
    strip = table.text("strip") if "strip" in table.values else ""
    return Image(name, camera, file, _prior(table.sub("prior")) if "prior" in table.values else None, strip)


def _bar(table: Section) -> ScaleBar:
    table.check_keys(("from", "to", "length_m", "sigma_m"))
    length = table.number("length_m", above=0, expected="a positive length in metres")
    sigma = table.number("sigma_m", above=0, expected="a positive standard error in metres")
    bar = ScaleBar(table.text("from"), table.text("to"), length, sigma)
    if bar.first == bar.second:
        raise table.error("to", f"the bar begins and ends in '{bar.first}'; write two points")
    return bar


def _together(table: Section) -> Together:
    table.check_keys(("points", "covariance_m2"))
    names, rows = table.values.get("points"), table.values.get("covariance_m2")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names) or len(set(names)) < len(names):
        raise table.error("points", "write a list of different point names in double quotes")
    try:
        covariance = np.array(rows, float)
    except (TypeError, ValueError):
        covariance = np.zeros(0)
    size = 3 * len(names)
    if covariance.shape != (size, size) or not np.isfinite(covariance).all() or not np.allclose(covariance, covariance.T):
        raise table.error("covariance_m2", f"write a symmetric matrix of {size} rows with {size} numbers: X, Y, Z of each point "
                          "in turn, in square metres")
    if np.linalg.eigvalsh(covariance)[0] <= 0:
        raise table.error("covariance_m2", "this is no covariance: a direction has no variance; add the points' own errors")
    return Together(tuple(names), covariance)


def _gps(table: Section) -> Gps:
    table.check_keys(("lever_arm_m", "shift", "shift_sigma_m"))
    lever = _three(table.vector("lever_arm_m", 3, (0.0, 0.0, 0.0), expected="forward, right, down in metres"))
    return Gps(lever, table.text("shift", "none", ("none", "block", "strip")),
               table.number("shift_sigma_m", 10.0, above=0, expected="a positive number of metres"))


def _prior(table: Section) -> Prior:
    table.check_keys(PRIOR_KEYS)
    centre = _all_or_none(table, ("X", "Y", "Z"))
    angles = _all_or_none(table, ("omega_deg", "phi_deg", "kappa_deg"))
    sigma_m = table.vector("sigma_m", 3, above=0,
                           expected="three positive numbers of metres") if "sigma_m" in table.values else None
    sigma_deg = table.vector("sigma_deg", 3, above=0,
                             expected="three positive numbers of degrees") if "sigma_deg" in table.values else None
    speed = "three numbers of metres per second, along X, Y and Z"
    velocity = table.vector("velocity_m_s", 3, expected=speed) if "velocity_m_s" in table.values else None
    sigma_v = table.vector("sigma_velocity_m_s", 3, above=0,
                           expected=f"{speed}, positive") if "sigma_velocity_m_s" in table.values else None
    return Prior(centre, None if angles is None else np.radians(angles), None if sigma_m is None else np.array(sigma_m),
                 None if sigma_deg is None else np.radians(sigma_deg), None, None if velocity is None else np.array(velocity),
                 None if sigma_v is None else np.array(sigma_v), _turning(table))


def _turning(table: Section) -> np.ndarray | None:
    """(k, 3) rad of the numbers under turning_deg, three an instant."""
    if "turning_deg" not in table.values:
        return None
    given = table.values["turning_deg"]
    count = len(given) if isinstance(given, list) else 0
    if count < 9 or count % 3:
        raise table.error("turning_deg", "write three numbers of degrees for each of three and more instants, evenly from the "
                          "first row to the last, in one list; or leave it out")
    return np.radians(table.vector("turning_deg", count, expected="degrees")).reshape(-1, 3)


def _all_or_none(table: Section, keys: Sequence[str]) -> np.ndarray | None:
    return np.array([table.number(k) for k in keys]) if any(k in table.values for k in keys) else None


def _surface(table: Section) -> dict[str, Any]:
    if "file" in table.values and "z" in table.values:
        raise table.error("z", "the surface is given twice; keep either file or z")
    if "file" in table.values:
        table.text("file")
    if "z" in table.values:
        table.number("z", expected="a height in metres")
    return dict(table.values)


def _describe_camera(camera: Interior) -> dict[str, Any]:
    x, y = (float(p) for p in camera.pitch)
    out = {"width": int(camera.width), "height": int(camera.height), "pixel_mm": x if x == y else [x, y], "c_mm": float(camera.c),
           "xp_mm": float(camera.xp), "yp_mm": float(camera.yp)}
    return out | {k: float(getattr(camera, k)) for k in COEFFICIENTS if getattr(camera, k) != 0}


def _describe_image(image: Image) -> dict[str, Any]:
    out: dict[str, Any] = {} if image.file is None else {"file": image.file}
    out["camera"] = image.camera
    if image.strip:
        out["strip"] = image.strip
    prior = image.prior
    if prior is None:
        return out
    table: dict[str, Any] = {}
    if prior.centre is not None:
        table |= dict(zip(PRIOR_KEYS[:3], map(float, prior.centre), strict=True))
    if prior.angles is not None:
        table |= dict(zip(PRIOR_KEYS[3:6], map(float, np.degrees(prior.angles)), strict=True))
    if prior.sigma_m is not None:
        table["sigma_m"] = [float(s) for s in prior.sigma_m]
    if prior.sigma_rad is not None:
        table["sigma_deg"] = [float(s) for s in np.degrees(prior.sigma_rad)]
    for key, values in (("velocity_m_s", prior.velocity), ("sigma_velocity_m_s", prior.sigma_velocity)):
        if values is not None:
            table[key] = [float(v) for v in values]
    if prior.turning is not None:
        table["turning_deg"] = [float(v) for v in np.round(np.degrees(prior.turning), 6).ravel()]
    return out | {"prior": table}


def _three(values: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
