"""What a report says of a run: warnings first, then the project, the images, the points, the tests, the accuracy."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from .block import Block
from .report_document import Document, Number, Part, Section, Source, Table, Words, pointer
from .report_material import MOST_ROWS, Material, Wanted, crs_text, left
from .report_mosaic_quality import mosaic
from .report_points import accuracy, maps, points
from .report_tests import correlations, iterations, tests

PARAMETERS = ("c_mm", "xp_mm", "yp_mm", "k1", "k2", "k3", "p1", "p2", "b1", "b2")
UNITS = ("mm", "mm", "mm", "mm⁻²", "mm⁻⁴", "mm⁻⁶", "mm⁻¹", "mm⁻¹", "", "")


def contents(m: Material, wanted: Wanted) -> Document:
    """The report of a run."""
    source = Source(m.result)
    facts = {"Run": f"{m.run} (collinea {m.command})", "Made": m.when, "Coordinates": crs_text(m.block),
             "Block": f"{len(m.block.images)} images, {len(m.block.points)} points, {len(m.block.observations)} observations",
             "By": f"Collinea {m.version}"}
    sections = [_warnings(m, source), _project(m), _cameras(m, source), _images(m, source), points(m, source),
                maps(m, source),
                correlations(source), tests(m, source), iterations(m), mosaic(m), accuracy(m, source, wanted), _how()]
    return Document(f"{m.block.name}: report", facts, [s for s in sections if s is not None and s.parts])


def _warnings(m: Material, source: Source) -> Section:
    said = [("", w) for w in [*m.said, *source.get("warnings", [])]]
    for o in source.get("orientations", []):
        who = f"{o['image']}, {o['model']}"
        if not o.get("converged", True):
            said.append((who, f"not converged (stop: {o['stop']})"))
        said += [(who, w) for w in o.get("warnings", [])]
        if o.get("rejected"):
            said.append((who, f"rejected as blunders: {', '.join(o['rejected'])}"))
    said += [(f"{f['image']}, {f['model']}", f"not oriented: {f['why']}") for f in source.get("failed", [])]
    mosaic = m.mosaic or {}
    said += [("mosaic", w) for w in mosaic.get("warnings", [])]
    said += [("mosaic", f"{i['name']} was not used: {i['why']}") for i in mosaic.get("images", []) if not i.get("used", True)]
    parts = [Words(w, "warning") for w in grouped(said)]
    return Section("Warnings", parts or [Words("No warning was raised by this run.")])


def grouped(said: Sequence[tuple[str, str]]) -> list[str]:
    """Warnings of several images or models that differ by their numbers only are told once, with all they concern; those of one
    source are all told, up to a dozen."""
    groups: dict[str, list[tuple[str, str]]] = {}
    for who, text in said:
        groups.setdefault(re.sub(r"[-+]?\d[\d.e+-]*", "#", text), []).append((who, text))
    out = []
    for same in groups.values():
        who = same[0][0]
        texts = list(dict.fromkeys(t for w, t in same if w == who))
        others = list(dict.fromkeys(w for w, _ in same if w != who))
        more = f" and {len(others) - 6} more" if len(others) > 6 else ""
        also = f" (alike for {', '.join(others[:6])}{more})" if others else ""
        left = f" ({len(texts) - 12} more like this)" if len(texts) > 12 else ""
        texts = [f"{who}: {t}" if who else t for t in texts[:12]]
        out += [*texts[:-1], texts[-1] + also + left]
    return out


def _project(m: Material) -> Section:
    b = m.block
    roles = {r: sum(x == r for x in b.points.role) for r in ("control", "check", "tie")}
    rows = [("Project", b.name), ("Coordinate system", crs_text(b)), ("Frame of the adjustment", _frame(b)),
            ("Images", str(len(b.images))), ("Cameras", str(len(b.cameras))),
            ("Points", ", ".join(f"{n} {r}" for r, n in roles.items() if n) or "none"),
            ("Image observations", str(len(b.observations))),
            ("Default sigma of an image coordinate", f"{b.image_px:g} px"),
            ("Default sigmas of control X, Y, Z", f"{', '.join(f'{s:g}' for s in b.control_m)} m"),
            ("Surface", m.surface or ("none given: level ground at the control's mean height" if m.outlines else "none given"))]
    return Section("Project", [Table(("what", "value"), rows)])


def _frame(block: Block) -> str:
    if block.crs == "local":
        return "the local system, taken as Cartesian"
    if block.frame == "grid":
        return "the map grid taken as Cartesian (as the project asks)"
    return "tangent frame at the middle of the block, turned to grid north there"


def _cameras(m: Material, source: Source) -> Section:
    parts: list[Part] = []
    rows = [(name, f"{c.width} × {c.height}", f"{c.pitch[0] * 1000:.4f} × {c.pitch[1] * 1000:.4f}", Number(c.c, 4),
             Number(c.xp, 4),
             Number(c.yp, 4), "as given") for name, c in m.block.cameras.items()]
    parts.append(Table(("camera", "format [px]", "pixel [µm]", "c [mm]", "xp [mm]", "yp [mm]", "source"), rows,
                       "As the project gives them"))
    for name, adjusted in source.get("interior", {}).items():
        if adjusted.get("sigma"):
            values = [(p, u, _figure(source, ("interior", name, p)), _figure(source, ("interior", name, "sigma", p)))
                      for p, u in zip(PARAMETERS, UNITS, strict=True)]
            parts.append(Table(("parameter", "unit", "value", "standard error"), values, f"Camera {name}, adjusted",
                               "Ten-parameter model that corrects measured photo coordinates (docs: conventions); standard "
                               "errors a priori."))
    return Section("Cameras", parts)


def _figure(source: Source, path: tuple[str, ...]) -> Any:
    """A parameter with six significant digits, whatever its size."""
    value = source.get(path)
    return Number(None, 0) if not isinstance(value, int | float) else _Scientific(float(value), 6, pointer(path))


class _Scientific(Number):
    def __str__(self) -> str:
        return "–" if self.value is None else f"{self.value:.{self.decimals}g}".replace("-", "−")


def _images(m: Material, source: Source) -> Section:
    header = ("image", "model", "X [m]", "Y [m]", "Z [m]", "omega [°]", "phi [°]", "kappa [°]", "points", "sigma0", "rms [px]")
    rows: list[Sequence[Any]] = []
    marked = set()
    for i, o in enumerate(source.get("orientations", [])[:MOST_ROWS]):
        at = f"orientations.{i}"
        if o.get("warnings") or not o.get("converged", True):
            marked.add(len(rows))
        rows.append((o["image"], o["model"], *(source.number(f"{at}.{k}") for k in "XYZ"),
                     *(source.number(f"{at}.{k}_deg", 4) for k in ("omega", "phi", "kappa")),
                     o.get("observations", sum(r["used"] for r in o.get("residuals", []))) or "", source.number(f"{at}.sigma0"),
                     source.number(f"{at}.rms_px")))
        rows.append(("", "± standard error", *(source.number(f"{at}.sigma.{k}") for k in "XYZ"),
                     *(source.number(f"{at}.sigma.{k}_deg", 4) for k in ("omega", "phi", "kappa")), "", "", ""))
    how = ("Standard errors are a priori: from the given sigmas, control included; times sigma0 they are scaled by the fit. "
           "rms is the root "
           "mean square length of the image residual." + left(len(source.get("orientations", [])), "images"))
    parts: list[Part] = [Table(header, rows, "Exterior orientations", how, frozenset(marked))] if rows else []
    advice = source.get("advice", {})
    parts += [Words(f"Advice for {image}: {a['model']}: {'; '.join(a['reasons'])}") for image,
              a in list(advice.items())[:MOST_ROWS]]
    return Section("Images", parts)


def _how() -> Section:
    return Section("How the numbers were got", [Words(t, "note") for t in (
        "Least squares by the collinearity equations (perspective) or the orthogonal projection model; control and priors "
        "enter as weighted "
        "observations. Angles: M = M_kappa M_phi M_omega turns object axes into photo axes; degrees.",
        "sigma0 is relative to the given sigmas: 1 means residuals as large as they should be. A priori standard errors use "
        "the given sigmas; "
        "multiply by sigma0 where the sigmas themselves are in doubt.",
        "Pixels count from the centre of the top-left pixel (0, 0), col to the right, row down. Residuals are observed minus "
        "projected.",
        "A 95 % error ellipse has the factor 2.448 (two dimensions, given sigmas).",
        "Every number of a result stands in result.json of the run; in the HTML form each carries its place there (data-key) "
        "and its full value "
        "(data-value).")])
