"""Does a mosaic drift? Sequential against simultaneous registration of 36 photos; control, relief, distortion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DegenerateGeometry
from ..mosaic.words import BAD
from .mosaics import HEIGHT, METHODS, METRES, SIGMA_PX, WIDTH, C, Layout, layout, sequential, systematic
from .page import COLOURS, figure, flow, number, read_csv, save, table, write_csv

RUNS = 2000
NETWORKS = tuple((k, *o, g) for k in ("strip", "block") for o in ((0.6, 0.3), (0.8, 0.6 if k == "block" else 0.3))
                 for g in (1000.0, 600.0))
CASES = ((0.0, 0.0), (0.3, 0.0), (1.0, 0.0), (3.0, 0.0), (0.0, 2.0), (0.0, 10.0), (0.0, 30.0))
"""Relief [m, standard deviation, at 300 m] and distortion left at the corners [px]."""
CONTROL = {"free": 0, "gcp4": 4, "gcp12": 12}
WEAK_PX = BAD * float(np.hypot(WIDTH, HEIGHT))
"""Predicted drift [px] from which a registration is called nearly rank deficient."""


def study(folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run the study into a folder: drift.csv, drift-systematic.csv, two figures (PNG, SVG) and drift.md."""
    runs = runs or RUNS
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for k, spec in enumerate(NETWORKS):
        net = layout(*spec)
        progress(f"{net.name} ({k + 1} of {len(NETWORKS)})")
        rows += deterministic(net, runs)
    progress("relief and distortion")
    harm = [r for kind in (("strip", 0.6, 0.3, 600.0), ("block", 0.8, 0.6, 600.0))
            for r in disturbed(layout(*kind), max(2, min(runs // 60, 30)))]
    files = [write_csv(folder / "drift.csv", rows), write_csv(folder / "drift-systematic.csv", harm)]
    files += figures(folder)
    page = folder / "drift.md"
    page.write_text(flow(_page(rows, harm, runs)), encoding="utf-8")
    return [*files, page]


def figures(folder: Path) -> list[Path]:
    """The figures, drawn from the tables in the folder."""
    return (_drift_figure(folder, read_csv(folder / "drift.csv"))
            + _harm_figure(folder, read_csv(folder / "drift-systematic.csv")))


def deterministic(net: Layout, runs: int) -> list[dict[str, Any]]:
    """Drift of each photo: predicted for the simultaneous methods, rms and median of runs for the sequential one. weak:
    predicted too badly to be used, or singular."""
    rows = []
    base = {"kind": net.kind, "forward": net.forward, "side": net.side, "grid_px": net.grid}
    q = net.q + np.random.default_rng(2017).normal(0, 0.3 / C, (runs, len(net.image), 2))
    with np.errstate(all="ignore"):  # nearly deficient networks run away
        h = sequential(net, q)
        off = net.drift(h)
        seam = net.seam(h[0], q[0])
    weak = {m: _weak(net, m) for m in METHODS}
    good = off[np.isfinite(off).all(axis=1)]
    good = good if len(good) else np.full((1, off.shape[1]), np.nan)
    for name, values in (("rms", np.sqrt((good**2).mean(axis=0))), ("median", np.median(good, axis=0))):
        rows += [{**base, "method": "sequential", "control": "free", "what": name, "photo": k + 1, "drift_px": float(v),
                  "seam_px": seam, "nearly_deficient": weak["coefficients"]} for k, v in enumerate(values)]
    for method in METHODS:
        for control, count in CONTROL.items():
            values = _predicted(net, method, count)
            rows += [{**base, "method": method, "control": control, "what": "predicted", "photo": k + 1, "drift_px": float(v),
                      "seam_px": "", "nearly_deficient": weak[method] if not count else bool(values.max() > WEAK_PX or
                                                                                          np.isnan(values).any())}
                     for k, v in enumerate(values)]
    return rows


def _predicted(net: Layout, method: str, gcps: int) -> np.ndarray:
    try:
        return net.response(method, net.gcps(gcps) if gcps else np.zeros(0, int)).noise()
    except DegenerateGeometry:
        return np.full(len(net.centre), np.nan)


def _weak(net: Layout, method: str) -> bool:
    values = _predicted(net, method, 0)
    return bool(np.isnan(values).any() or values.max() > WEAK_PX)


def disturbed(net: Layout, runs: int) -> list[dict[str, Any]]:
    """Drift under relief and distortion: rms and the middle 80 % over runs of the engine's adjustments, each with heights of its
    own, and predicted by linear theory."""
    rows, none = [], np.zeros(0, int)
    for relief, corner in CASES:
        q = systematic(net, relief, corner, np.random.default_rng(11), runs)
        with np.errstate(all="ignore"):
            found: dict[str, tuple[list[np.ndarray], list[bool]]] = {"sequential": (list(sequential(net, q)), [True] * runs)}
        for name, method, gcps in (("coefficients", "coefficients", none), ("exterior", "exterior", none),
                                   ("coefficients gcp12", "coefficients", net.gcps(12)),
                                   ("exterior gcp12", "exterior", net.gcps(12))):
            made = [net.adjusted(method, gcps, one, net.points[gcps] + np.random.default_rng(k).normal(0, 0.3, (len(gcps), 2)))
                    for k, one in enumerate(q)]
            found[name] = ([h for h, _ in made], [ok for _, ok in made])
        for name, (h, ok) in found.items():
            with np.errstate(all="ignore"):
                off = net.drift(np.array(h))
            good = np.isfinite(off).all(axis=1) & np.array(ok)
            last = float(np.sqrt((off[good, -1] ** 2).mean())) if good.any() else float("nan")
            tenth, most = np.percentile(off[good, -1], [10, 90]).tolist() if good.any() else (float("nan"),) * 2
            mean = float(np.sqrt((off[good] ** 2).mean(axis=0)).mean()) if good.any() else float("nan")
            seam = net.seam(h[int(np.argmax(good))], q[int(np.argmax(good))]) if good.any() else float("nan")
            rows.append({"kind": net.kind, "relief_m": relief, "corner_px": corner, "method": name, "last_px": last,
                         "last_p10_px": tenth, "last_p90_px": most, "mean_px": mean, "seam_px": seam, "runs": runs,
                         "came_to_rest": int(good.sum()),
                         **_expected(net, name, relief, corner)})
    return rows


def _expected(net: Layout, name: str, relief: float, corner: float) -> dict[str, float]:
    """Predicted drift of the last photo: by the covariance alone, and with the terms for relief and distortion."""
    if name == "sequential":
        return {"covariance_px": float("nan"), "predicted_px": float("nan")}
    response = net.response(name.split()[0], net.gcps(12) if "gcp" in name else np.zeros(0, int))
    noise, total = response.noise(), response.noise() ** 2
    if relief:
        total = total + response.relief(relief / METRES * C) ** 2
    if corner:
        total = total + response.distortion(corner / C) ** 2
    return {"covariance_px": float(noise[-1]), "predicted_px": float(np.sqrt(total[-1]))}


# -- figures and page -------------------------------------------------------------------------------------------------------


def _curve(rows: list[dict[str, Any]], spec: tuple[Any, ...], method: str, control: str, what: str) -> np.ndarray:
    return np.array([r["drift_px"] for r in rows if (r["kind"], r["forward"], r["side"], r["grid_px"]) == spec
                     and (r["method"], r["control"], r["what"]) == (method, control, what)])


CURVES = (("sequential", "free", "rms", "sequential, 8 coefficients", COLOURS["printed"], "-"),
          ("coefficients", "free", "predicted", "simultaneous, 8 coefficients", COLOURS["orthogonal"], "-"),
          ("exterior", "free", "predicted", "simultaneous, exterior orientations", COLOURS["perspective"], "-"),
          ("coefficients", "gcp4", "predicted", "8 coefficients, 4 GCPs", COLOURS["orthogonal"], "--"),
          ("exterior", "gcp4", "predicted", "exterior orientations, 4 GCPs", COLOURS["perspective"], "--"),
          ("exterior", "gcp12", "predicted", "exterior orientations, 12 GCPs", COLOURS["perspective"], ":"))


def _drift_figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = figure(10, 4.4, ncols=2, sharey=True)
    for axis, spec in zip(axes, (("strip", 0.6, 0.3, 600.0), ("block", 0.8, 0.6, 600.0)), strict=True):
        for method, control, what, label, colour, style in CURVES:
            values = _curve(rows, spec, method, control, what)
            axis.semilogy(np.arange(1, len(values) + 1), np.where(values > 0, values, np.nan), style, color=colour, label=label)
        seam = next(r["seam_px"] for r in rows if (r["kind"], r["forward"], r["side"], r["grid_px"]) == spec)
        axis.axhline(seam, color="0.5", lw=1)
        axis.text(36, 0.115, "grey line: seams (rms of the tie points)", ha="right", va="bottom", color="0.4", fontsize=8)
        axis.set_title("strip, 60 % overlap" if spec[0] == "strip" else "block 6 x 6, 80 / 60 % overlap", fontsize=10)
        axis.set_xlabel("photo")
    axes[0].set_ylabel("error on the mosaic [px]")
    axes[0].legend(fontsize=7.5, loc="upper left", framealpha=0.9)
    return save(fig, folder, "drift")


def _harm_figure(folder: Path, harm: list[dict[str, Any]]) -> list[Path]:
    fig, axes = figure(10, 4.2, ncols=2, sharey=True)
    free, held = COLOURS["orthogonal"], COLOURS["perspective"]
    styles = {"sequential": (COLOURS["printed"], "o"), "coefficients": (free, "s"), "exterior": (held, "^"),
              "coefficients gcp12": (free, "x"), "exterior gcp12": (held, "+")}
    labels = ["none", *(f"{r:g} m" for r, d in CASES if r), *(f"{d:g} px" for r, d in CASES if d)]
    for axis, kind in zip(axes, ("strip", "block"), strict=True):
        for name, (colour, mark) in styles.items():
            mine = [r for r in harm if r["kind"] == kind and r["method"] == name]
            axis.semilogy(range(len(mine)), [r["last_px"] for r in mine], mark, color=colour, label=f"{name}: actual")
            if name != "sequential":
                axis.semilogy(range(len(mine)), [r["predicted_px"] for r in mine], "-", color=colour, lw=0.8, alpha=0.7)
        axis.set_xticks(range(len(CASES)), labels, fontsize=8)
        axis.set_xlabel("relief (3 columns), distortion left in at the corners (3 columns)")
        axis.set_title(kind, fontsize=10)
    axes[0].set_ylabel("error of the last photo [px]")
    axes[1].plot([], [], "-", color="0.4", lw=0.8, label="predicted")
    axes[1].legend(fontsize=7, loc="upper left", framealpha=0.9)
    return save(fig, folder, "drift-systematic")


def _page(rows: list[dict[str, Any]], harm: list[dict[str, Any]], runs: int) -> str:
    def last(spec: tuple[Any, ...], method: str, control: str = "free", what: str = "predicted") -> float:
        return float(_curve(rows, spec, method, control, what)[-1])

    def worst(spec: tuple[Any, ...], method: str, control: str) -> float:
        return float(_curve(rows, spec, method, control, "predicted").max())

    strip, block = ("strip", 0.6, 0.3, 600.0), ("block", 0.8, 0.6, 600.0)
    seam = next(r["seam_px"] for r in rows if (r["kind"], r["forward"], r["side"], r["grid_px"]) == strip)
    header = ["network", "sequential", "8 coefficients", "+ 4 GCPs", "+ 12 GCPs", "exterior", "+ 4 GCPs", "+ 12 GCPs"]
    lines = []
    for spec in NETWORKS:
        mark = next(r["nearly_deficient"] for r in rows if (r["kind"], r["forward"], r["side"], r["grid_px"], r["method"]) ==
                    (*spec, "coefficients"))
        lines.append([layout(*spec).name + (" (weak)" if mark else ""), last(spec, "sequential", what="rms"),
                      *(last(spec, m, c) for m in METHODS for c in CONTROL)])
    bad = [[r["kind"], f"{r['relief_m']:g} m", f"{r['corner_px']:g} px", r["method"], r["last_px"],
            f"{number(r['last_p10_px'], 3)} to {number(r['last_p90_px'], 3)}", r["covariance_px"],
            r["predicted_px"], r["seam_px"], f"{r['came_to_rest']} of {r['runs']}"] for r in harm]
    harmed = ["network", "relief", "distortion", "method", "last photo", "middle 80 %", "covariance", "predicted", "seams",
              "came to rest"]
    return f"""# Drift: which registration to use, and why

Written by `collinea study drift --runs {runs}`; every number below comes from that run.

36 vertical photos of 6000 x 4000 px over a plane (c = 8935 px), tie points on a regular grid measured to {SIGMA_PX} px, as one
strip or a block of 6 x 6. The error of a photo is the rms, over 25 places in it, of the distance on the mosaic from where they
belong. Photo 1 is held; with GCPs ({SIGMA_PX} px) nothing is held. The sequential registration fits each photo to the mosaic of
those before it by eight plane coefficients; it was run {runs} times. The simultaneous ones are predicted by their covariance,
which the tests compare with runs.

{table(header, lines)}

Error of the last photo [px]. A median or rms of 150 runs of the sequential registration would itself scatter by some 15 %.
Where a control point's place lies halfway between two tie points (strip 80 %, grid 600) the choice between them moves the values
with 12 GCPs by up to 10 % (20 % with coefficients). "weak": the eight coefficients are nearly undetermined (more than
{WEAK_PX:.0f} px predicted, or singular: a single column or row of tie points in an overlap is a hinge); `collinea mosaic`
says so and names the photos.

![Drift along the photos](drift.png)

## What to take from it

- Use exterior orientations (`--model exterior` or the default), with the principal distance known and distortion removed. The
strip's last photo is then off by {number(last(strip, 'exterior'))} px instead of {number(last(strip, 'coefficients'))} px; in the
block by {number(last(block, 'exterior'), 2)} px instead of {number(last(block, 'coefficients'), 2)} px.

- Adjusting eight coefficients simultaneously hardly helps a single strip ({number(last(strip, 'sequential', what='rms'))} px
sequential, {number(last(strip, 'coefficients'))} px simultaneous): a strip has almost no redundancy. A block has.

- Seams do not measure drift. The tie points of the sequential strip agree within {number(seam, 2)} px while its end is off by
hundreds. A mosaic without visible seams can be wrong everywhere.

- Four GCPs at the corners hold every photo of the strip within {number(worst(strip, 'exterior', 'gcp4'), 2)} px with exterior
orientations (the worst in the middle; {number(worst(strip, 'coefficients', 'gcp4'), 2)} px with coefficients), twelve around the
border within {number(worst(strip, 'exterior', 'gcp12'), 2)} px ({number(worst(strip, 'coefficients', 'gcp12'), 2)} px).

## Relief and distortion

The covariance knows the noise of the tie points only: it is the lower bound of the drift. Relief off the plane and distortion
left in add to it. Their share is the adjustment's own response to them, in linear theory; where the drift is thousands of pixels,
theory is no more than an order of magnitude, and eight coefficients may not come to rest at all. Last photo: rms over runs, each
with heights of its own; "middle 80 %" says what a single one of them may show. With eight coefficients few combinations of the
heights make nearly all of the drift, so that one block may come out several times better, or worse, than another over the same
relief: one flight that fits is no proof.

{table(harmed, bad)}

![Drift under relief and distortion](drift-systematic.png)

Relief is the standard deviation of independent heights, seen from {METRES:.0f} m; distortion is what a cubic radial one leaves
at the photo's corners. Two pixels of distortion bend a strip of coefficients by thousands: remove it before you register.
"""
