"""How many ground control points does a mosaic need, and where? 4 to 20 at the edge, in the centre, at random."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DegenerateGeometry
from .mosaics import METHODS, SIGMA_PX, C, Layout, layout
from .page import COLOURS, figure, flow, number, read_csv, save, table, write_csv

RUNS = 8
COUNTS = (4, 5, 6, 8, 10, 12, 16, 20)
PLACES = ("edge", "centre", "random")
NETWORKS = (("strip", 0.6, 0.3, 600.0), ("block", 0.8, 0.6, 600.0))
CHECKS = 60
"""Check points spread over the network, none of them control."""


def study(folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run the study into a folder: gcp.csv, a figure (PNG, SVG) and gcp.md."""
    runs = runs or RUNS
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for spec in NETWORKS:
        net = layout(*spec)
        for method in METHODS:
            progress(f"{net.name}, {METHODS[method]}")
            for place in PLACES:
                rows += [case(net, method, place, count, runs) for count in COUNTS]
    files = [write_csv(folder / "gcp.csv", rows), *figures(folder)]
    page = folder / "gcp.md"
    page.write_text(flow(_page(rows, runs)), encoding="utf-8")
    return [*files, page]


def figures(folder: Path) -> list[Path]:
    """The figure, drawn from the table in the folder."""
    return _figure(folder, read_csv(folder / "gcp.csv"))


def chosen(net: Layout, place: str, count: int, seed: int = 0) -> np.ndarray:
    """Indices of `count` tie points that serve as control: evenly along the border, in the middle (within a quarter of the extent
    from the centre), or anywhere."""
    if place == "edge":
        s = np.arange(count) / count * 4
        side, along = s.astype(int), 0.05 + 0.9 * (s - s.astype(int))
        corner = np.array([[0.05, 0.05], [0.95, 0.05], [0.95, 0.95], [0.05, 0.95]])
        direction = np.array([[1, 0], [0, 1], [-1, 0], [0, -1.0]])
        return np.unique(net.nearest(corner[side] + direction[side] * (along - 0.05)[:, None]))
    low, high = net.points.min(axis=0), net.points.max(axis=0)
    share = (net.points - low) / (high - low)
    inside = np.flatnonzero((np.abs(share - 0.5) < 0.25).all(axis=1)) if place == "centre" else np.arange(len(share))
    return np.sort(np.random.default_rng([seed, count]).choice(inside, count, replace=False))


def case(net: Layout, method: str, place: str, count: int, runs: int) -> dict[str, Any]:
    """Predicted and actual rms of check points [px]: prediction by linear theory; actual over runs with noise in the tie points
    and in the control. Random control is drawn anew in every run, the prediction is the rms over the same draws."""
    checks = _checks(net)
    predicted, actual, worst = [], [], 0.0
    fixed = None if place == "random" else chosen(net, place, count)
    known: dict[bytes, np.ndarray] = {}
    for run in range(runs):
        gcps = chosen(net, place, count, run) if fixed is None else fixed
        key = gcps.tobytes()
        if key not in known:
            known[key] = _predicted(net, method, gcps, checks)
        predicted.append(known[key])
        rng = np.random.default_rng([run, count, PLACES.index(place)])
        q = net.q + rng.normal(0, SIGMA_PX / C, net.q.shape)
        h, ok = net.adjusted(method, gcps, q, net.points[gcps] + rng.normal(0, SIGMA_PX, (len(gcps), 2)))
        off = _error(net, h, checks) if ok else np.full(len(checks), np.nan)
        actual.append(off)
        worst = max(worst, float(np.nanmax(off))) if np.isfinite(off).any() else worst
    rest = np.isfinite(actual).all(axis=1)
    sure = np.isfinite(predicted).all(axis=1)
    return {"kind": net.kind, "forward": net.forward, "side": net.side, "grid_px": net.grid, "method": method, "place": place,
            "gcps": count, "predicted_rms_px": _rms(np.array(predicted)[sure]), "actual_rms_px": _rms(np.array(actual)[rest]),
            "worst_px": worst, "runs": runs, "came_to_rest": int(rest.sum())}


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else float("nan")


def _checks(net: Layout) -> np.ndarray:
    """Rows of observations that serve as check points: places in photos, spread over the network."""
    return np.linspace(0, len(net.image) - 1, CHECKS).astype(int)


def _error(net: Layout, h: np.ndarray, checks: np.ndarray) -> np.ndarray:
    """(k,) distance [px] on the mosaic of true photo positions from where they belong."""
    p = np.einsum("oij,oj->oi", np.linalg.inv(h[net.image[checks]]), np.column_stack([net.q[checks], np.ones(len(checks))]))
    return np.linalg.norm(p[:, :2] / p[:, 2:] - net.points[net.point[checks]], axis=1)


def _predicted(net: Layout, method: str, gcps: np.ndarray, checks: np.ndarray) -> np.ndarray:
    """(k,) predicted rms error of the check points; NaN where the network is singular."""
    response = net.response(method, gcps)
    try:
        covariance = response.covariance[net.image[checks]]
    except DegenerateGeometry:
        return np.full(len(checks), np.nan)
    seen = response.problem.model.see(net.photos(method), net.image[checks], net.points[net.point[checks]], np.zeros(len(checks)))
    j = np.linalg.solve(seen.by_point, seen.by_photo)
    return np.sqrt(np.einsum("oea,oab,oeb->o", j, covariance, j))


def _figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, axes = figure(10, 4.4, ncols=2, sharey=True)
    colours = {"edge": COLOURS["perspective"], "centre": COLOURS["printed"], "random": COLOURS["prior"]}
    for axis, (kind, *_) in zip(axes, NETWORKS, strict=True):
        for method, style, mark in (("coefficients", "--", "s"), ("exterior", "-", "o")):
            for place in PLACES:
                mine = [r for r in rows if (r["kind"], r["method"], r["place"]) == (kind, method, place)]
                axis.semilogy([r["gcps"] for r in mine], [r["predicted_rms_px"] for r in mine], style, color=colours[place],
                              label=f"{place}, {METHODS[method]}")
                axis.semilogy([r["gcps"] for r in mine], [r["actual_rms_px"] for r in mine], mark, color=colours[place], ms=4)
        axis.set_title("strip, 60 % overlap" if kind == "strip" else "block 6 x 6, 80 / 60 % overlap", fontsize=10)
        axis.set_xlabel("ground control points")
    axes[0].set_ylabel("rms of check points [px]: lines predicted, marks actual", fontsize=9)
    axes[1].legend(fontsize=7.5)
    return save(fig, folder, "gcp")


def _page(rows: list[dict[str, Any]], runs: int) -> str:
    def of(kind: str, method: str, place: str, count: int) -> dict[str, Any]:
        return next(r for r in rows if (r["kind"], r["method"], r["place"], r["gcps"]) == (kind, method, place, count))

    header = ["network", "method", "GCPs", *(f"{p}: predicted (actual)" for p in PLACES)]
    lines = [[kind, METHODS[m], str(n), *(f"{number(of(kind, m, p, n)['predicted_rms_px'])} "
                                         f"({number(of(kind, m, p, n)['actual_rms_px'])})" for p in PLACES)]
             for kind, *_ in NETWORKS for m in METHODS for n in COUNTS]
    say = {k: of(*k) for k in ((a, b, c, d) for a in ("strip", "block") for b in METHODS for c in PLACES for d in (4, 8, 12, 20))}

    def px(*key: Any) -> str:
        return number(say[key]["predicted_rms_px"], 2)

    return f"""# How many ground control points, and where?

Written by `collinea study gcp --runs {runs}`; every number below comes from that run.

The same 36 photos as in the study of drift, GCPs known and marked to {SIGMA_PX} px. {CHECKS} check points spread over the network
judge the mosaic. Edge: evenly along the border. Centre: in the middle quarter. Random: anywhere, drawn anew in every run.

{table(header, lines)}

Rms of the check points [px].

![Check points by number and place of the control](gcp.png)

## What to take from it

- Where matters as much as how many. In the block with exterior orientations four GCPs along the edge leave
{px('block', 'exterior', 'edge', 4)} px, four in the centre {px('block', 'exterior', 'centre', 4)} px; twenty leave
{px('block', 'exterior', 'edge', 20)} and {px('block', 'exterior', 'centre', 20)} px. Control in the middle lets borders swing.

- In a strip control must reach both ends: four at the edge leave {px('strip', 'exterior', 'edge', 4)} px, twenty in the centre
{px('strip', 'exterior', 'centre', 20)} px.

- After the corners, a point every few photos along the border is enough: from 8 to 20 at the edge the block goes from
{px('block', 'exterior', 'edge', 8)} to {px('block', 'exterior', 'edge', 20)} px, the strip from
{px('strip', 'exterior', 'edge', 8)} to {px('strip', 'exterior', 'edge', 20)} px.

- Eight coefficients per photo need two to three times as many points as exterior orientations for the same error: the strip's
twelve at the edge leave {px('strip', 'coefficients', 'edge', 12)} px instead of {px('strip', 'exterior', 'edge', 12)} px.

- The prediction holds: it comes from the covariance before anything is flown, and the runs meet it. Relief and distortion add
to it (see the study of drift), so keep a few points out as check points.
"""
