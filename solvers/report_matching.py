"""Matching in words: a point, the targets of a photo, tie points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from .workflows_matching import Tied


def match_text(done: Mapping[str, Any]) -> str:
    """One line: where the point is, and how well it is known."""
    sigma = done["sigma_px"]
    known = "" if sigma is None else f", sigma {sigma[0]:.3f} {sigma[1]:.3f} px"
    return (f"col {done['col']:.3f}, row {done['row']:.3f}{known}, correlation {done['score']:.3f} "
            f"({done['method']}, start by {done['start']['from']})")


def targets_text(done: Mapping[str, Any], file: str | None) -> str:
    """How many targets there are and how well they are centred, then each of them."""
    rows = done["targets"]
    sigma = np.sqrt(np.mean([np.square(r["sigma_px"]).mean() for r in rows]))
    named = "numbered by the coded corners" if done["numbered"] else "with running numbers"
    named = "of a chessboard, column-row" if done["kind"] == "chessboard" else f"{named}, sigma {sigma:.3f} px"
    lines = [f"{done['image']}: {len(rows)} targets {named}"]
    bias = np.array([r["eccentricity_px"] for r in rows])
    if np.isfinite(bias).all():
        lines.append(f"a tilted circle's centre lies off the centre of its picture by {bias.max():.3f} px at most")
    lines += [f"  {r['point']:>8} {r['col']:10.3f} {r['row']:10.3f}" for r in rows]
    return "\n".join([*lines, *([f"written to {file}"] if file else [])])


def sheet_text(done: Mapping[str, Any]) -> str:
    """What was measured in the photos of a project, and in which nothing."""
    images = done["images"]
    seen = [i for i in images if i["targets"]]
    lines = [f"{done['project']}: {done['points']} targets, {done['observations']} observations in {len(seen)} of {len(images)} "
             "photos"]
    lines += [f"  {i['name']}: {i['why']}" for i in images if not i["targets"]]
    return "\n".join([*lines, f"next: collinea calibrate {done['project']}"])


def ties_text(done: Tied) -> str:
    """How many points there are, how often they are seen, what hangs together and what failed."""
    ties = done.ties
    rays = ties.rays
    lines = [f"{done.file}: {len(ties.points)} tie points, {len(ties.observations)} observations, "
             f"{100 * np.mean(rays >= 3):.0f} % in three photos and more",
             f"{len(ties.pairs)} pairs of photos share points, {ties.per_photo.min()} to {ties.per_photo.max()} points a photo"]
    lines += [f"failed: {why}" for why in ties.failed.values()]
    apart = [", ".join(g[:5]) + (" ..." if len(g) > 5 else "") for g in ties.groups[1:]]
    return "\n".join(lines + [f"does not hang together with the others: {names}" for names in apart])
