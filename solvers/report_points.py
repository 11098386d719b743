"""What a report says of points: residuals, plan, overlap, accuracy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from . import report_figures as figures
from .report_accuracy import Accuracy, remarks, statements
from .report_document import Figure, Number, Part, Section, Source, Table, Words, pointer
from .report_material import CRITICAL, MOST_ROWS, Ground, Material, Wanted, left


def points(m: Material, source: Source) -> Section:
    """Residuals of control and check points in object space."""
    parts: list[Part] = []
    points = source.get("points", [])
    if points and "dX" in points[0]:
        rows, marked = [], set()
        told = [k for k, p in enumerate(points) if p["role"] != "tie" and p.get("dX") is not None]
        for k in told[:MOST_ROWS]:
            p, at = points[k], f"points.{k}"
            if max((abs(w) for w in p.get("w", []) if w is not None), default=0.0) > CRITICAL:
                marked.add(len(rows))
            rows.append((p["name"], p["role"], *(source.number(f"{at}.{c}", 4) for c in ("dX", "dY", "dZ", "sX", "sY", "sZ")),
                         p.get("rays", "")))
        parts.append(Table(("point", "role", "dX [m]", "dY [m]", "dZ [m]", "sX [m]", "sY [m]", "sZ [m]", "rays"), rows,
                           "Control and check points, adjusted minus given",
                           "Check points took no part in the datum; s are standard errors of the adjusted coordinates." +
                           left(len(told), "points"), frozenset(marked)))
        parts.append(_rms(source, m))
    if m.grounds:
        parts += _rays(m.grounds)
    return Section("Control and check points", parts)


def _rays(grounds: Sequence[Ground]) -> list[Part]:
    """Differences on the ground of single photos: a summary by image, and the largest."""
    groups: dict[tuple[str, str], list[Ground]] = {}
    for g in grounds:
        groups.setdefault((g.image, g.role), []).append(g)
    summary = []
    for (image, role), of in list(groups.items())[:MOST_ROWS]:
        off = np.array([g.off for g in of])
        expected = np.sqrt(np.mean([np.diag(g.covariance) for g in of], axis=0))
        rms = np.sqrt((off**2).mean(axis=0))
        summary.append((image, role, len(of), *(Number(float(v), 4) for v in (*rms, *expected))))
    largest = sorted(grounds, key=lambda g: -float(g.off @ np.linalg.solve(g.covariance, g.off)))[:15]
    rows = [(g.image, g.point, g.role, *(Number(float(v), 4) for v in (*g.off, *np.sqrt(np.diag(g.covariance)))))
            for g in largest]
    how = ("The ray through the measured pixel meets the level of the point's given height; the standard errors come from the "
           "pixel's sigma and the orientation's covariance. Control took part in the orientation: its differences are "
           "residuals, not errors.")
    return [Table(("image", "role", "rays", "rms dX [m]", "rms dY [m]", "expected X [m]", "expected Y [m]"), summary,
                  "Where each photo puts the points at their given height, minus given", how),
            Table(("image", "point", "role", "dX [m]", "dY [m]", "sX [m]", "sY [m]"), rows,
                  "The fifteen largest of them, measured by their standard errors")]


def _rms(source: Source, m: Material) -> Table:
    rows = []
    for role in ("control", "check"):
        if source.get(f"{role}_rms_m") is not None:
            n = sum(p["role"] == role and p.get("dX") is not None for p in source.get("points", []))
            rows.append((role, n, *(source.number(f"{role}_rms_m.{k}", 4) for k in range(3))))
    return Table(("points", "number", "rms X [m]", "rms Y [m]", "rms Z [m]"), rows, "Root mean squares",
                 "Of adjusted minus given, not corrected for the uncertainty of the given coordinates.")


def maps(m: Material, source: Source) -> Section:
    """Plan of the vectors, footprints, overlap."""
    parts: list[Part] = []
    cameras = np.array([[o["X"], o["Y"]] for o in source.get("orientations", [])
                        if o["model"] != "orthogonal"]).reshape(-1, 2)
    outlines = list((m.outlines or {}).values())
    points = _vectors(m, source)
    if points:
        extent = float(np.ptp(np.vstack([p["xy"] for p in points]), axis=0).max())
        enlarged = figures.scale_of(np.array([np.hypot(*p["off"][:2]) for p in points]), extent)
        few = len(points) <= figures.MOST_ELLIPSES
        ellipses = " with 95 % error ellipses (factor 2.448) at the same enlargement" if few else ""
        parts.append(Figure(figures.plan(points, enlarged),
                            "Plan of the horizontal differences of control (circles) and check points (squares), found minus "
                            "given, "
                            f"drawn {enlarged:g} times larger than they are{ellipses}."))
    if outlines:
        picture, areas = figures.overlap(outlines, cameras)
        parts.append(Figure(picture, f"Footprints and overlap on {m.surface or 'level ground'}; triangles are the cameras."))
        total = sum(areas.values())
        rows = [(f"{k}", Number(a / 1e4, 4), f"{100 * a / total:.1f} %") for k, a in areas.items()]
        parts.append(Table(("photos that see it", "area [ha]", "share"), rows, "Overlap", "Counted on a raster of 1000 cells "
                                                                                          "along the longer "
                           "side."))
    elif source.get("orientations"):
        parts.append(Words("Footprints and overlap are not drawn: the height of the ground is not known. Add [surface] with file "
                           "or z to project.toml.", "note"))
    return Section("Plan, footprints and overlap", parts)


def _vectors(m: Material, source: Source) -> list[dict[str, Any]]:
    points = [p for p in source.get("points", []) if p["role"] != "tie" and p.get("dX") is not None]
    if points:
        return [{"name": p["name"], "role": p["role"], "xy": np.array([p["X"], p["Y"]]),
                 "off": np.array([p["dX"], p["dY"], p["dZ"]]),
                 "covariance": np.array(p["covariance"])[:2, :2] if p.get("covariance") else None} for p in points]
    return [{"name": g.point, "role": g.role, "xy": g.xy, "off": g.off, "covariance": g.covariance} for g in m.grounds]


def accuracy(m: Material, source: Source, wanted: Wanted) -> Section:
    """Positional accuracy at check points in the words of the standard."""
    points = [p for p in source.get("points", []) if p["role"] == "check" and p.get("dX") is not None]
    if not points:
        return Section("Positional accuracy", [Words(
            "No statement is made: this run determined no check point in object space. Give points the role check, measure "
            "them in two images or "
            "more and run collinea adjust.", "warning")])
    index = {n: k for k, n in enumerate(m.block.points.names)}
    sigma = np.array([m.block.points.sigma[index[p["name"]]] if p["name"] in index else np.full(3, np.nan) for p in points])
    default = ~np.isfinite(sigma)
    sigma = np.where(default, np.array(m.block.control_m), sigma)
    a = Accuracy.of(np.array([[p["dX"], p["dY"], p["dZ"]] for p in points]), sigma)
    rows = [(name, Number(float(a.mean[k]), 4), Number(float(a.rmse[k]), 4, pointer(f"check_rms_m.{k}")),
             Number(float(a.survey[k]), 4))
            for k, name in enumerate("XYZ")]
    edition = "edition 1 (2014)" if wanted.edition == "2014" else f"edition 2 ({wanted.edition})"
    rest = [("horizontal", Number(a.horizontal(wanted.edition), 4)), ("vertical", Number(a.vertical(wanted.edition), 4))]
    said = "the survey's own error included" if wanted.edition != "2014" else "the survey's own error not included"
    parts: list[Part] = [
        Table(("coordinate", "mean error [m]", "RMSE [m]", "survey [m]"), rows, f"{a.n} check points, product minus survey",
              "survey: root mean square of the check points' given standard errors"
              + (" (the project's default where none is given)." if default.any() else ".")),
        Table(("component", "RMSE [m]"), rest, f"As {edition} of the ASPRS standard counts", said + ".")]
    parts += [Words(t, "statement") for t in statements(a, wanted.edition, wanted.class_h_cm, wanted.class_v_cm)]
    parts += [Words(t, "warning") for t in remarks(a, wanted.edition, wanted.class_h_cm, wanted.class_v_cm)]
    return Section("Positional accuracy", parts)
