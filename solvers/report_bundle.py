"""Adjusted blocks and calibrated cameras as text for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .cameras import PARAMETERS
from .report import _digits, _notes, _rendered
from .report_orientation import _run, _table

if TYPE_CHECKING:
    from .block import Block
    from .orientation import Adjusted
    from .orientation.models import ModelInSpace, ModelOfImage
    from .workflows_bundle import AdjustedProject

UNKNOWNS = {"dlt": 11, "affine": 8, "orthogonal": 6, "perspective": 6}
SHOWN = 40
"""Lines of a table before the rest is left to the JSON."""
SAID = {"c": "principal distance c [mm]", "xp": "principal point xp [mm]", "yp": "principal point yp [mm]",
        "k1": "radial K1 [mm^-2]", "k2": "radial K2 [mm^-4]", "k3": "radial K3 [mm^-6]", "p1": "decentring P1 [mm^-1]",
        "p2": "decentring P2 [mm^-1]", "b1": "affinity B1", "b2": "shear B2"}
GROUPS = {"tie image": "image coordinates of tie points", "control image": "image coordinates of control", "control": "control "
          "coordinates", "GPS": "GPS positions", "IMU": "IMU angles", "level": "assumed to look down",
          "GPS/IMU": "GPS and IMU together"}


def adjusted_text(done: AdjustedProject) -> str:
    """The block in one line, its images, interiors, control and check points, and everything a person should know of it."""
    result = done.result
    interior = [interior_text(result, name) for name in result.interiors if result.interior_sigma[name]]
    return "\n".join([headline(done.block.name, result), images_text(result), *interior, *points_lines(result),
                      *group_lines(result), *_notes("warning", list(result.warnings)), *_run(done.run)])


def headline(name: str, result: Adjusted) -> str:
    """How the adjustment ended."""
    sigma0 = "undetermined (no redundancy)" if result.sigma0 is None else f"{result.sigma0:.3f} (redundancy {result.dof})"
    return (f"{name}: {len(result.orientations)} images, {len(result.points)} points, sigma0 {sigma0}, "
            f"rms {result.rms_px:.3g} px, {result.trace.iterations} iterations, stop: {result.trace.last.stop}")


def images_text(result: Adjusted) -> str:
    """One line per image, the standard errors below."""
    table = _table("image", "X [m]", "Y [m]", "Z [m]", "omega [deg]", "phi [deg]", "kappa [deg]", "points", "rms [px]")
    sigma = np.array([np.concatenate([o.sigma[:3], np.degrees(o.sigma[3:])]) for o in result.orientations])
    middle = np.median(sigma, axis=0)
    digits = [_digits(s) for s in middle]
    for o in result.orientations[:SHOWN]:
        values = np.concatenate([o.exterior.centre, np.degrees(o.exterior.angles)])
        cells = [f"{v:.{d}f}" for v, d in zip(values, digits, strict=True)]
        table.add_row(o.image, *cells, str(len(o.points)), f"{o.rms_px:.2f}")
    table.add_row("sigma" if len(sigma) == 1 else "sigma (median)", *(f"{s:.2g}" for s in middle), "", "")
    more = len(result.orientations) - SHOWN
    return _rendered(table) + (f"\n  ... and {more} more images: see result.json" if more > 0 else "")


def interior_text(result: Adjusted, camera: str) -> str:
    """The interior orientation of a camera: value and standard error of what was freed."""
    table = _table(f"camera {camera}", "value", "sigma")
    sigma, interior = result.interior_sigma[camera], result.interiors[camera]
    for name in PARAMETERS:
        value = getattr(interior, name)
        if name in sigma:
            table.add_row(SAID[name], f"{value:.{significant(value, sigma[name])}g}", f"{sigma[name]:.2g}")
        elif value or name == "c":
            table.add_row(SAID[name], f"{value:.7g}", "fixed")
    return _rendered(table)


def points_lines(result: Adjusted) -> list[str]:
    """Control and check points: rms of the differences, adjusted minus given."""
    lines, apart = [], result.trace.manifest["options"]["datum"] in ("prior", "free")
    for role, rms in (("control", result.control_rms), ("check", result.check_rms)):
        if rms is not None:
            n = sum(p.role == role and bool(np.isfinite(p.off).all()) for p in result.points)
            values = " ".join(f"{v:.{_digits(float(rms.min()))}f}" for v in rms)
            unused = ", which took no part" if apart and role == "control" else ""
            lines.append(f"rms at {n} {role} points: {values} m in X, Y, Z{unused}")
    return lines


def group_lines(result: Adjusted) -> list[str]:
    """sigma0 of each kind of observation."""
    return [f"{GROUPS.get(name, name)}: sigma0 {'undetermined' if s is None else f'{s:.3f}'} (redundancy {r:.1f})"
            for name, (s, r) in result.groups.items() if len(result.groups) > 1]


def significant(value: float, sigma: float) -> int:
    """Digits that show a value down to the second digit of its standard error."""
    if not (sigma > 0 and value):
        return 6
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(sigma)) + 2, 2, 12))


def models_text(block: Block, images: Sequence[ModelOfImage], space: Sequence[ModelInSpace]) -> str:
    """Four models beside each other: every image from its control, then what their rays give at check points."""
    table = _table("image", "model", "points", "unknowns", "redundancy", "sigma0", "rms [px]", "least r", "condition",
                   "check points", "check rms [px]")
    for f in images:
        if f.refused:
            table.add_row(f.image, f.model, str(f.points), str(UNKNOWNS[f.model]), *["-"] * 7)
            continue
        table.add_row(f.image, f.model, str(f.points), str(UNKNOWNS[f.model]), str(f.dof),
                      "-" if f.sigma0 is None else f"{f.sigma0:.3f}", f"{f.rms_px:.3f}", f"{f.redundancy[0]:.2f}",
                      f"{f.condition:.1e}", str(f.checks), "-" if f.check_px is None else f"{f.check_px:.3f}")
    below = _table("in space", "images", "check points", "rms X [m]", "rms Y [m]", "rms Z [m]")
    for m in space:
        values = ["-"] * 3 if m.rms is None else [f"{v:.4f}" for v in m.rms]
        below.add_row(m.model, str(m.images), str(m.points), *values)
    refused = _notes("no model", [f"{f.image}, {f.model}: {f.refused}" for f in images if f.refused])
    return "\n".join([f"{block.name}: the same control by four models", _rendered(table), _rendered(below), *refused])
