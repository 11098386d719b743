"""The walk of a calibration: adjust with the interior orientation free, tell what its parameters do, compare with others."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .cameras import PARAMETERS, Calibrated, Difference, Interior, curve, difference
from .cameras.foreign import as_colmap, as_metashape, as_pix4d, to_brown
from .errors import BadProject, Unsupported
from .io import latest_run, write_json
from .orientation import Adjusted
from .workflows_bundle import AdjustedProject, BundleRecorder, StoppedRun, adjust_project

OPENCV_TERMS = ("k1", "k2", "k3", "p1", "p2", "aspect")


@dataclass(frozen=True)
class Comparison:
    """Another calibration of a camera beside this one; scaled: covariances times sigma0 squared, where it is larger than 1."""

    camera: str
    other: str
    difference: Difference


@dataclass(frozen=True)
class CalibratedProject:
    """A calibration and what it was compared with."""

    adjusted: AdjustedProject
    comparisons: tuple[Comparison, ...]

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command calibrate."""
        return {**self.adjusted.to_json(), "calibration": facts(self.adjusted.result),
                "comparisons": [comparison_json(c) for c in self.comparisons]}


def calibrate_project(folder: Path | str, compare: Sequence[Path | str] = (), recorder: BundleRecorder | None = None,
                      **options: Any) -> CalibratedProject | StoppedRun:
    """Calibrate the cameras of a project and compare with other runs (or the latest calibrations of other projects).

    options: as in `BundleRequest`. Raises PhotogrammetryError.
    """
    others = [(str(at), earlier(at)) for at in compare]
    done = adjust_project(folder, "calibrate", recorder, **options)
    if isinstance(done, StoppedRun):
        return done
    mine = calibrated(done.result)
    comparisons = tuple(_compared(name, mine[name], where, theirs[name]) for where, theirs in others for name in mine
                        if name in theirs)
    missing = [where for where, theirs in others if not set(theirs) & set(mine)]
    if missing:
        raise BadProject(f"{missing[0]}: it calibrates none of the cameras {', '.join(mine)}; name the cameras alike")
    result = CalibratedProject(done, comparisons)
    if done.run is not None:
        write_json(done.run / "result.json", result.to_json())
    return result


def calibrated(result: Adjusted) -> dict[str, Calibrated]:
    """Every camera with adjusted parameters; covariances are scaled by sigma0 where it is larger than 1 (and can be known)."""
    factor = max(result.sigma0 or 1.0, 1.0) ** 2 if result.dof > 30 else 1.0
    out = {}
    for camera, interior in result.interiors.items():
        rows = result.interior_rows(camera)
        at = [PARAMETERS.index(result.interior_names[k][1]) for k in rows]
        whole = np.zeros((10, 10))
        whole[np.ix_(at, at)] = factor * result.interior_covariance[np.ix_(rows, rows)]
        if rows:
            out[camera] = Calibrated(interior, whole)
    return out


def facts(result: Adjusted) -> dict[str, Any]:
    """For each camera: sigma0 and rms of the image coordinates in micrometres, distortion curves, other tools' parameters."""
    out: dict[str, Any] = {}
    for camera, of in calibrated(result).items():
        pitch = 1e3 * float(of.interior.pitch.mean())
        v, r = (np.concatenate([getattr(o, name)[o.used] for o in result.orientations]) for name in ("residuals", "redundancy"))
        c = curve(of)
        out[camera] = {
            "sigma0_um": None if result.sigma0 is None else float(np.sqrt((v**2).sum() / r.sum())) * pitch,
            "rms_um": float(np.sqrt((v**2).mean())) * pitch,
            "curve": [dict(zip(("r_mm", "radial_um", "radial_sigma_um", "decentring_um", "decentring_sigma_um"), map(float, row),
                               strict=True)) for row in zip(c.radius, c.radial, c.radial_sigma, c.decentring, c.decentring_sigma,
                                                            strict=True)],
            "conversions": conversions(of.interior),
            "format": {"pixel_mm": [float(p) for p in of.interior.pitch], "width": of.interior.width,
                       "height": of.interior.height},
        }
    return out


def conversions(interior: Interior) -> dict[str, Any]:
    """The camera in the conventions of other tools, each with the residual of its refit [px]."""
    out: dict[str, Any] = {}

    def put(name: str, make: Any) -> None:
        try:
            values, fit = make()
            out[name] = {**values, "refit_max_px": fit.max_px, "refit_rms_px": fit.rms_px}
        except Unsupported as error:
            out[name] = {"refused": str(error)}

    def opencv() -> Any:
        b, fit = to_brown(interior, OPENCV_TERMS)
        return {"camera_matrix": [[b.fx, 0.0, b.cx], [0.0, b.fy, b.cy], [0.0, 0.0, 1.0]],
                "dist_coeffs": [b.k1, b.k2, b.p1, b.p2, b.k3]}, fit

    def colmap() -> Any:
        model, params, fit = as_colmap(interior)
        return {"model": model, "params": params}, fit

    put("opencv", opencv)
    put("metashape", lambda: as_metashape(interior))
    put("pix4d", lambda: as_pix4d(interior))
    put("colmap", colmap)
    out["australis"] = {**{n: float(getattr(interior, n)) for n in PARAMETERS}, "refit_max_px": 0.0, "refit_rms_px": 0.0}
    return out


# -- comparing ----------------------------------------------------------------------------------------------------------------


def earlier(at: Path | str) -> dict[str, Calibrated]:
    """The cameras of an earlier calibration: a run, or the latest calibration of a project. Raises BadProject."""
    at = Path(at)
    run = at if (at / "result.json").is_file() else latest_run(at, "result.json", "calibrate")
    if run is None:
        raise BadProject(f"{at}: there is no calibration in it; make one with: collinea calibrate PROJECT")
    try:
        told = json.loads((run / "result.json").read_text(encoding="utf-8"))
        return {name: _read(told, name) for name in told["calibration"]}
    except (KeyError, ValueError, TypeError, OSError):
        raise BadProject(f"{run / 'result.json'}: this is not the result of a calibration; make one with: collinea calibrate "
                         "PROJECT") from None


def _read(told: Mapping[str, Any], camera: str) -> Calibrated:
    values, shape = told["interior"][camera], told["calibration"][camera]["format"]
    keys = {p: f"{p}_mm" if p in ("c", "xp", "yp") else p for p in PARAMETERS}
    interior = Interior(*(float(values[keys[p]]) for p in PARAMETERS), pixel_mm=tuple(shape["pixel_mm"]), width=shape["width"],
                        height=shape["height"])
    names, matrix = told["interior_correlation"]["parameters"], np.array(told["interior_correlation"]["matrix"], float)
    factor = max(told["sigma0"] or 1.0, 1.0) ** 2 if told["dof"] > 30 else 1.0
    rows = [k for k, n in enumerate(names) if n.startswith(f"{camera}.")]
    at = [p for k in rows for p, key in enumerate(keys.values()) if names[k] == f"{camera}.{key}"]
    sigma = np.array([values["sigma"][list(keys.values())[p]] for p in at])
    whole = np.zeros((10, 10))
    whole[np.ix_(at, at)] = factor * np.outer(sigma, sigma) * matrix[np.ix_(rows, rows)]
    return Calibrated(interior, whole)


def _compared(camera: str, mine: Calibrated, where: str, theirs: Calibrated) -> Comparison:
    try:
        return Comparison(camera, where, difference(theirs, mine))
    except ValueError as error:
        raise BadProject(f"{where}: {error}; calibrate with the same --free") from None


def comparison_json(c: Comparison) -> dict[str, Any]:
    """Parameters and curves, this calibration minus the other."""
    d = c.difference
    return {"camera": c.camera, "other": c.other, "chi_square": d.chi_square, "dof": d.dof, "probability": d.probability,
            "changed": d.changed,
            "parameters": [{"name": n, "difference": float(v), "sigma": float(s), "ratio": float(v / s)}
                           for n, v, s in zip(d.names, d.difference, d.sigma, strict=True)],
            "curve": [{"r_mm": float(r), "difference_um": float(v), "sigma_um": float(s)}
                      for r, v, s in zip(d.radius, d.image_um, d.image_sigma, strict=True)]}
