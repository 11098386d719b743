"""Georeferencing, intersection and monoplotting as text for a terminal."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .report import _digits, _notes, _rendered

if TYPE_CHECKING:
    from .orientation import Grade, ObjectPoint
    from .workflows_georeference import Direct
    from .workflows_orientation import IntersectedProject, MonoplottedProject


def georeference_text(done: Direct) -> str:
    """One line per image, the standard errors below, then everything a person should know of them."""
    table = _table("image", "X [m]", "Y [m]", "Z [m]", "omega [deg]", "phi [deg]", "kappa [deg]")
    for g in done.orientations:
        angles = np.round(np.degrees(g.exterior.angles), 3) + 0.0  # no -0.000
        table.add_row(g.image, *(f"{v:.2f}" for v in g.exterior.centre), *(f"{v:.3f}" for v in angles))
    sigma = np.array([np.concatenate([g.sigma[:3], np.degrees(g.sigma[3:])]) for g in done.orientations])
    table.add_row("sigma" if len(sigma) == 1 else "sigma (median)", *(f"{s:.2g}" for s in np.median(sigma, axis=0)))
    total = len(done.orientations)
    lines = _shared("heights", [(g.image, g.heights) for g in done.orientations], total)
    told = [(g.image, n) for g in done.orientations for n in g.notes if not n.startswith(("height:", "yaw corrected"))]
    lines += _shared("", told, total) + _wrapped(done.notes) + _notes("warning", list(done.warnings))
    lines += _shared("warning", [(g.image, w) for g in done.orientations for w in g.warnings], total)
    lines += _compared(done.grades)
    return "\n".join([f"exterior orientation from onboard data, {done.crs}", _rendered(table), *lines,
                      *_shared("left out", list(done.failed), 0), *_run(done.run)])


def _compared(grades: Sequence[Grade]) -> list[str]:
    """Errors at check points by each grade of control."""
    if not grades:
        return []
    table = _table("orientation by", "rms plan [m]", "rms height [m]", "predicted plan", "predicted height", "points")
    for g in grades:
        said = [f"{v:.3g}" if v is not None else "none stated" for v in (g.predicted_horizontal, g.predicted_vertical)]
        table.add_row(g.method, f"{g.rms_horizontal:.3g}", f"{g.rms_vertical:.3g}", *said, str(g.points))
    return ["errors at check points", _rendered(table)]


def intersection_text(done: IntersectedProject) -> str:
    """One line per point: coordinates, standard errors, geometry, and where the point is given the difference."""
    points = done.result.points
    digits = _digits(float(np.median([np.sqrt(np.trace(p.covariance) / 3) for p in points])))
    table = _table("point", "role", "X [m]", "Y [m]", "Z [m]", "sX", "sY", "sZ", "rays", "angle [deg]", "dX", "dY", "dZ")
    for p in points:
        off = [f"{d:.{digits}f}" if np.isfinite(d) else "" for d in p.xyz - p.given]
        sigma = np.sqrt(np.diag(p.covariance))
        table.add_row(p.name, p.role, *(f"{v:.{digits}f}" for v in p.xyz), *(f"{s:.{digits}f}" for s in sigma),
                      str(int(p.used.sum())), f"{np.degrees(p.angle):.2f}", *off)
    lines = [line for role in ("control", "check") for line in _rms(role, [p for p in points if p.role == role], digits)]
    lines += _wrapped(done.notes)
    lines += _notes("warning", [f"point '{p.name}': {w}" for p in points for w in p.warnings])
    return "\n".join(["object points; d = intersected minus given", _rendered(table), *lines,
                      *_notes("left out", [why for _, why in done.result.failed]), *_run(done.run)])


def monoplot_text(done: MonoplottedProject) -> str:
    """The ground point with its standard errors and its error ellipse."""
    p, ellipse = done.result, done.result.ellipse
    sigma = np.sqrt(np.diag(p.covariance))
    digits = _digits(float(sigma.max()))
    table = _table("", "ground", "sigma")
    for axis, value, s in zip("XYZ", p.ground, sigma, strict=True):
        table.add_row(f"{axis} [m]", f"{value:.{digits}f}", f"{s:.{digits}f}")
    lines = [f"95 % error ellipse: {ellipse.semi_major_m:.{digits}f} x {ellipse.semi_minor_m:.{digits}f} m, its longer axis "
             f"{ellipse.azimuth_deg:.0f} degrees from grid north",
             f"ground: {p.surface}, {p.distance:.1f} m from the camera, met at {np.degrees(p.grazing):.1f} degrees"]
    return "\n".join([f"image {p.image}, col {p.pixel[0]:g}, row {p.pixel[1]:g}", _rendered(table), *lines,
                      *_wrapped(done.notes), *_notes("warning", list(p.warnings))])


def _rms(role: str, points: Sequence[ObjectPoint], digits: int) -> list[str]:
    off = np.array([p.xyz - p.given for p in points if np.isfinite(p.given).all()])
    if not len(off):
        return []
    values = " ".join(f"{v:.{digits}f}" for v in np.sqrt((off**2).mean(axis=0)))
    return [f"rms at {len(off)} {role} points: {values} m in X, Y, Z"]


def _shared(word: str, said: Sequence[tuple[str, str]], total: int) -> list[str]:
    """Each sentence once, with the images it is about, unless it is about all of them (total)."""
    by: dict[str, list[str]] = defaultdict(list)
    for image, text in said:
        by[text].append(image)
    lines = []
    for text, images in by.items():
        who = "" if len(images) == total else f"image {images[0]}: " if len(images) == 1 else \
            f"{len(images)} images ({images[0]} ...): " if len(images) > 3 else f"images {', '.join(images)}: "
        lines.append(f"{who}{text}")
    return _notes(word, lines) if word else _wrapped(lines)


def _wrapped(texts: Sequence[str]) -> list[str]:
    """Sentences that begin with what they are about."""
    return [line for word, _, text in (t.partition(": ") for t in texts) for line in _notes(word, [text])]


def _run(run: object) -> list[str]:
    return [] if run is None else [f"run: {run}"]


def _table(*columns: str) -> Any:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(box=SIMPLE_HEAD, header_style="")
    for k, name in enumerate(columns):
        table.add_column(name, justify="left" if k == 0 or name == "role" else "right", no_wrap=True)
    return table
