"""How often does a comparison of epochs cry wolf, and how small a movement does it find?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..orientation.bundle import BundleRequest
from ..orientation.bundle.joint import free_epoch
from ..orientation.deformation import Comparison, Epoch, compare_epochs
from ..simulation import cliff_epochs
from ..simulation.monitoring import MOVED
from .page import COLOURS, figure, flow, number, read_csv, save, table, write_csv

RUNS = 2000
LEVELS = (0.01, 0.05, 0.2)
MOVEMENTS = (0.0005, 0.001, 0.0015, 0.002, 0.003)
"""Of four targets, from one epoch to the next [m]."""


def study(folder: Path, runs: int | None = None, progress: Callable[[str], None] = lambda _: None) -> list[Path]:
    """Run the study into a folder: monitoring.csv, a figure (PNG, SVG) and monitoring.md."""
    runs = runs or RUNS
    folder.mkdir(parents=True, exist_ok=True)
    epoch = _adjusted(0, 0.0, 1)[0]
    rows = []
    for level in LEVELS:
        progress(f"no movement, level {level:g}")
        rows.append(redrawn(epoch, 0.0, level, runs, seed=1))
    for movement in MOVEMENTS:
        progress(f"four targets move by {1000 * movement:g} mm")
        rows.append(redrawn(epoch, movement, 0.05, max(runs // 8, 1), seed=2))
    for movement in (0.0, 0.003):
        progress(f"from the image coordinates on, {1000 * movement:g} mm")
        rows.append(photographed(movement, 0.05, max(runs // 10, 1)))
    files = [write_csv(folder / "monitoring.csv", rows), *figures(folder)]
    page = folder / "monitoring.md"
    page.write_text(flow(_page(rows, epoch)), encoding="utf-8")
    return [*files, page]


def figures(folder: Path) -> list[Path]:
    """The figure, drawn from the table in the folder."""
    return _figure(folder, read_csv(folder / "monitoring.csv"))


def redrawn(epoch: Epoch, movement: float, level: float, runs: int, seed: int) -> dict[str, Any]:
    """Pairs of epochs drawn from the covariance and the redundancy of one: what was called moved of what did."""
    rng = np.random.default_rng([seed, round(1e6 * movement), round(1000 * level)])
    values, vectors = np.linalg.eigh(epoch.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    step = movement * np.array([MOVED.get(name, (0.0, 0.0, 0.0)) for name in epoch.points])

    def draw(name: str, shift: np.ndarray | float) -> Epoch:
        error = (root @ rng.standard_normal(len(root))).reshape(-1, 3)
        sigma0 = float(np.sqrt(rng.chisquare(epoch.dof) / epoch.dof))
        return replace(epoch, name=name, xyz=epoch.xyz + error + shift, sigma0=sigma0)

    pairs = (compare_epochs([draw("first", 0.0), draw("second", step)], level=level) for _ in range(runs))
    return _counted("redrawn", movement, level, pairs)


def photographed(movement: float, level: float, runs: int) -> dict[str, Any]:
    """The same, each epoch photographed and adjusted anew."""
    pairs = (compare_epochs(_adjusted(seed, movement, 2), level=level) for seed in range(runs))
    return _counted("photographed", movement, level, pairs)


def _adjusted(seed: int, movement: float, count: int) -> list[Epoch]:
    out, frame = [], None
    for k, sim in enumerate(cliff_epochs(seed, epochs=count, movement=movement)):
        epoch, frame, _ = free_epoch(sim.block, BundleRequest(), f"epoch{k + 1}", frame=frame)
        out.append(epoch)
    return out


def _counted(kind: str, movement: float, level: float, pairs: Any) -> dict[str, Any]:
    """Comparisons that called a still point moved, with the 95 % interval of their chance (Clopper and Pearson 1934), and the
    share of the four targets that was found."""
    from scipy.stats import beta

    alarms = found = n = 0
    got: Comparison
    for got in pairs:
        n += 1
        true = set(MOVED) if movement else set()
        alarms += bool(set(got.moved) - true)
        found += len(set(got.moved) & true)
    low = float(beta.ppf(0.025, alarms, n - alarms + 1)) if alarms else 0.0
    high = float(beta.ppf(0.975, alarms + 1, n - alarms)) if alarms < n else 1.0
    return {"epochs": kind, "movement_mm": 1000 * movement, "level": level, "pairs": n, "false_alarms": alarms,
            "share": alarms / n, "low": low, "high": high, "found": found / (n * len(MOVED)) if movement else float("nan")}


def _figure(folder: Path, rows: list[dict[str, Any]]) -> list[Path]:
    fig, (one, two) = figure(9.0, 3.8, ncols=2)
    for kind, colour, mark in (("redrawn", COLOURS["perspective"], "o"), ("photographed", COLOURS["orthogonal"], "s")):
        still = [r for r in rows if r["epochs"] == kind and not r["movement_mm"]]
        x, y = np.array([r["level"] for r in still]), np.array([r["share"] for r in still])
        apart = 1.06 if kind == "photographed" else 1.0  # side by side, not one on the other
        ends = np.array([[r["low"] for r in still], [r["high"] for r in still]])
        one.errorbar(100 * x * apart, 100 * y, yerr=100 * np.abs(ends - y), fmt=mark, color=colour, capsize=3,
                     label=f"epochs {kind}")
        moved = [r for r in rows if r["epochs"] == kind and r["movement_mm"]]
        two.plot([r["movement_mm"] for r in moved], [100 * r["found"] for r in moved], mark + "-", color=colour)
    ends = np.array([100 * min(LEVELS) / 1.5, 100 * max(LEVELS) * 1.5])
    one.plot(ends, ends, "--", color=COLOURS["truth"], lw=1, label="as stated")
    one.set(xscale="log", yscale="log", xlabel="stated level [%]", ylabel="comparisons with a false alarm [%]")
    one.set_xticks([100 * v for v in LEVELS], [f"{100 * v:g}" for v in LEVELS])
    one.set_yticks([100 * v for v in LEVELS], [f"{100 * v:g}" for v in LEVELS])
    one.minorticks_off()
    one.legend(fontsize=8)
    two.set(xlabel="movement [mm]", ylabel="moving targets found [%]", ylim=(0, 103), xlim=(0, None))
    return save(fig, folder, "monitoring")


def _page(rows: list[dict[str, Any]], epoch: Epoch) -> str:
    variances = np.diag(epoch.covariance).reshape(-1, 3)
    sigma = [number(1000 * float(np.sqrt(2 * v)), 2) for v in np.median(variances, axis=0)]
    lines = [(r["epochs"], f"{r['movement_mm']:g}", f"{100 * r['level']:g}", r["pairs"], r["false_alarms"],
              f"{100 * r['share']:.1f} ({100 * r['low']:.1f} to {100 * r['high']:.1f})",
              f"{100 * r['found']:.1f}" if r["movement_mm"] else "") for r in rows]
    still = next(r for r in rows if not r["movement_mm"] and r["level"] == 0.05)
    three = next(r for r in rows if r["movement_mm"] == 1000 * MOVEMENTS[-1])
    header = ("epochs", "movement [mm]", "level [%]", "pairs", "false alarms", "share [%] (95 % interval)", "movements found [%]")
    held = "holds the stated 5 %" if still["low"] <= 0.05 <= still["high"] else (
        "stays below the stated 5 %: points and pairs share the level as if each were independent, which they are not"
        if still["high"] < 0.05 else "is above the stated 5 %")
    return f"""# Epochs compared: false alarms and movements found

Written by `collinea study monitoring --runs {still['pairs']}`; every number below comes from that run.

The simulated wall of [monitoring](../monitoring.md): 40 targets, seven stations, 300 mm, 0.1 px, both epochs as free networks.
Displacements have standard errors of about {', '.join(sigma)} mm, the last towards the cameras. *Redrawn*: points of both epochs
drawn from the covariance of one, sigma0 from its redundancy. *Photographed*: both epochs simulated as photos and adjusted anew.
Moving: four targets, each in a direction of its own. A false alarm is a comparison that calls any still point moved.

{table(header, lines)}

![False alarms by level, movements found by size](monitoring.png)

## What to take from it

- Without movement {still['false_alarms']} of {still['pairs']} comparisons raise an alarm, {100 * still['share']:.1f} %
({100 * still['low']:.1f} to {100 * still['high']:.1f}): the rate {held}.

- Movements of {three['movement_mm']:g} mm are found in {100 * three['found']:.1f} % of all cases; beside them
{100 * three['share']:.1f} % ({100 * three['low']:.1f} to {100 * three['high']:.1f}) of the comparisons call another target moved.

- What is smaller than a few standard errors is not found, and nothing says that it was not there: the table of a comparison tells
for every point the movement that would have been found with 80 %.
"""
