"""What a report says of the adjustment itself: correlations, blunder tests, iterations."""

from __future__ import annotations

import numpy as np

from . import report_figures as figures
from .legend import INKS
from .report_document import Figure, Number, Part, Section, Source, Table, Words
from .report_material import CRITICAL, MOST_ROWS, Material, left


def correlations(source: Source) -> Section:
    """The highest correlations, as heat maps."""
    parts: list[Part] = []
    labels = ("X", "Y", "Z", "omega", "phi", "kappa")
    found = [(f"{o['image']}, {o['model']}", np.array(o["correlation"])) for o in source.get("orientations", [])
             if o.get("correlation")]
    if found:
        worst = sorted(found, key=lambda f: -np.abs(f[1] - np.eye(6)).max())[:2]
        parts.append(Figure(figures.correlations(dict(worst), {n: labels for n, _ in worst}),
                            "Correlations of the exterior orientation in the images where they are highest"
                            + (f" (2 of {len(found)})." if len(found) > 2 else ".")))
    interior = source.get("interior_correlation.matrix", [])
    if interior:
        names = [n.split(".")[-1].removesuffix("_mm") for n in source.get("interior_correlation.parameters")]
        parts.append(Figure(figures.correlations({"interior orientation": np.array(interior)}, {"interior orientation": names}),
                            "Correlations of the adjusted interior orientation. High ones among k1, k2, k3 are normal: judge "
                            "the "
                            "distortion curve, not single coefficients."))
    return Section("Correlations", parts)


def tests(m: Material, source: Source) -> Section:
    """Redundancy numbers, standardized residuals, fit by group."""
    rows, every, redundancy = [], [], []
    for i, o in enumerate(source.get("orientations", [])):
        for k, r in enumerate(o.get("residuals", [])):
            redundancy += r["redundancy"]
            finite = [abs(w) for w in r["w"] if w is not None]
            every += [w for w in r["w"] if w is not None and r["used"]]
            rows.append((max(finite, default=0.0), i, k, o, r))
    if not rows:
        return Section("Redundancy and blunder tests", [])
    rows.sort(key=lambda r: -r[0])
    table = [(o["image"], o["model"], r["point"], *(source.number(f"orientations.{i}.residuals.{k}.{c}", 2)
                                                    for c in ("col", "row")),
              *(source.number(f"orientations.{i}.residuals.{k}.w.{c}", 2) for c in (0, 1)),
              *(source.number(f"orientations.{i}.residuals.{k}.redundancy.{c}", 2) for c in (0, 1)),
              source.number(f"orientations.{i}.residuals.{k}.detectable_px.0", 1), "yes" if r["used"] else "rejected")
             for _, i, k, o, r in rows[:20]]
    over = sum(w > CRITICAL for w, *_ in rows)
    expected = 2 * len(rows) * 0.001
    parts: list[Part] = [
        Words(f"{len(rows)} observed points; redundancy numbers from {min(redundancy):.2f} to {max(redundancy):.2f}, mean "
              f"{np.mean(redundancy):.2f} (0: an error cannot be seen, 1: it is seen whole). {over} points have |w| above "
              f"{CRITICAL} "
              f"(0.1 % of good coordinates do: about {expected:.1f} here)."),
        Table(("image", "model", "point", "v col [px]", "v row [px]", "w col", "w row", "r col", "r row", "detectable [px]",
               "used"), table,
              "The twenty largest standardized residuals",
              "v observed minus projected; w = v / sigma_v (Baarda); r redundancy number; detectable: the smallest blunder "
              "in col found with "
              "80 % power at 0.1 %.", frozenset(k for k, r in enumerate(rows[:20]) if r[0] > CRITICAL)),
        Figure(figures.standardized(np.array(every), CRITICAL), "Standardized residuals of the observations used, beside the "
                                                                "standard normal "
               f"they should follow; dashed: ±{CRITICAL}.", wide=False)]
    parts += _on_format(m, source)
    groups = source.get("reliability.groups", {})
    if groups:
        parts.append(Table(("observations", "sigma0", "redundancy"),
                           [(g, *_of_group(source, g))
                            for g in groups], "Fit by group", "sigma0 of each group relative to its given sigmas: 1 is as "
                                                              "expected."))
    return Section("Redundancy and blunder tests", parts)


def _of_group(source: Source, group: str) -> tuple[Number, Number]:
    at = ("reliability", "groups", group)
    return source.number((*at, "sigma0")), source.number((*at, "redundancy"), 1)


def _on_format(m: Material, source: Source) -> list[Part]:
    """Residuals of all images of a camera on its format."""
    parts: list[Part] = []
    at = {(m.block.images[i].name, m.block.points.names[p]): px for i, p, px in
          zip(m.block.observations.image, m.block.observations.point, m.block.observations.pixel, strict=True)}
    of = {i.name: i.camera for i in m.block.images}
    for camera, c in m.block.cameras.items():
        pairs = [(at[o["image"], r["point"]], (r["col"], r["row"])) for o in source.get("orientations", [])
                 if o["model"] == source.get("orientations.0.model") and of.get(o["image"]) == camera
                 for r in o.get("residuals", [])
                 if (o["image"], r["point"]) in at and r["used"]]
        if pairs:
            pixels, v = (np.array(x) for x in zip(*pairs, strict=True))
            enlarged = figures.scale_of(np.hypot(*v.T), float(c.width))
            parts.append(Figure(figures.photo_residuals(pixels, v, (c.width, c.height), enlarged,
                                                        INKS["perspective"]),
                                f"Image residuals of camera {camera} on its format, all images together, drawn {enlarged:g} "
                                f"times larger. A "
                                "pattern here is distortion or a wrong point, not noise."))
    return parts


def iterations(m: Material) -> Section:
    """Course and end of every adjustment."""
    rows = {n: [{"index": r.index, "sigma0": r.sigma0, "step": r.step} for r in t.rows] for n, t in m.traces.items()}
    if not rows:
        return Section("Iterations", [])
    stops = [(n, t.iterations, t.last.stop, "yes" if t.converged else "NO") for n, t in list(m.traces.items())[:MOST_ROWS]]
    return Section("Iterations", [
        Figure(figures.iterations(rows), "sigma0 and step of every iteration; blue perspective, orange orthogonal. Row 0 is "
                                         "the start."),
        Table(("trace", "iterations", "stop", "converged"), stops, "How the adjustments ended",
              left(len(rows), "traces").strip())])
