"""Compared epochs as text for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .report import _notes, _rendered
from .report_orientation import _run, _table

if TYPE_CHECKING:
    from .orientation.deformation import Pair
    from .workflows_monitoring import ComparedEpochs

SHOWN = 12
"""Lines for points that did not move before the rest is left to the JSON."""


def compared_text(done: ComparedEpochs) -> str:
    """The test of every pair, the points that moved, and how sure it is."""
    c = done.comparison
    lines = [f"{len(c.epochs)} epochs, compared with {c.epochs[0]}; chance that any point is falsely said to have moved: "
             f"{c.level:.3g} ({c.level_pair:.3g} for a pair, {c.level_single:.2g} for one point); that a congruent pair fails: "
             f"{c.level_pair:.3g}"]
    for pair in c.pairs:
        lines += _pair(pair)
    moved = ", ".join(c.moved) if c.moved else "none"
    lines.append(f"moved: {moved}")
    return "\n".join([*lines, *_notes("note", list(done.notes)), *_notes("warning", list(c.warnings)), *_run(done.run)])


def _pair(pair: Pair) -> list[str]:
    first, last = pair.tests[0], pair.tests[-1]
    n = len(pair.displacements)
    verdict = "congruent" if first.congruent else "not congruent"
    lines = [f"{pair.first} -> {pair.second}: {verdict} as a whole (F = {first.statistic:.2f}, critical {first.critical:.2f} "
             f"with {first.h} and {first.f}; largest single point {first.largest:.2f} of its critical value)"]
    if not first.congruent:
        lines.append(f"  datum: {len(pair.stable)} of {n} points (F = {last.statistic:.2f}, critical {last.critical:.2f})")
    detectable = np.median([d.detectable for d in pair.displacements])
    scale = (pair.scale - 1) * 1e6
    lines.append(f"  sigma0 {pair.s0:.3f} (redundancy {pair.f}), scale {scale:+.0f} ppm, movements of {1e3 * detectable:.1f} mm "
                 "are found (median, 80 % chance, weakest direction)")
    table = _table("point", "dX [mm]", "dY [mm]", "dZ [mm]", "length", "sX", "sY", "sZ", "95 % axes [mm]", "T / critical", "")
    ordered = sorted(pair.displacements, key=lambda d: -d.statistic)
    shown = SHOWN + len(pair.moved)
    for d in ordered[:shown]:
        sigma = np.sqrt(np.diag(d.covariance))
        said = "moved" if d.moved else "" if d.datum else "not in the datum"
        table.add_row(d.point, *(f"{1e3 * v:.2f}" for v in d.d), f"{1e3 * d.length:.2f}", *(f"{1e3 * s:.2f}" for s in sigma),
                      " ".join(f"{1e3 * a:.2f}" for a in d.axes), f"{d.statistic:.2f}", said)
    more = len(ordered) - shown
    return [*lines, _rendered(table), *([f"  ... and {more} more points: see result.json"] if more > 0 else [])]
