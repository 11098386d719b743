"""The Mosaic tab in words and tables; pure, HTML that holds nothing but what is escaped."""

from __future__ import annotations

import numpy as np

from ..matching_state import Matching
from ..mosaic_scene import COLOURS, drift, measured
from ..mosaic_state import METHODS, Made, Mosaic
from ..state import State
from .widgets import BOX, MUTED, decimals, esc, swatch, table


def progress_html(room: Mosaic, matching: Matching, working: bool) -> str:
    """What is being done, and what was said last."""
    parts = []
    if working:
        words = room.progress or "starting"
        made = next((room.made[m] for m in METHODS if m in room.made and m in room.wanted and not room.made[m].done), None)
        if made is not None and made.total:
            share = min(len(made.tiles) / made.total, 1.0)
            parts.append(f'<progress value="{share:.2f}" max="1" style="width:100%" aria-label="mosaic"></progress>')
        parts.append(f"<div>{esc(words)}…</div>")
    if room.message:
        parts.append(f"<div>{esc(room.message)}</div>")
    if room.conjugate is not None and (matching.asked or matching.found):
        good = [f for f in matching.found if f.ok]
        parts.append(
            f"<div>Conjugate point: found in {len(good)} of {len(matching.found)} photos"
            + (f", {len(matching.asked)} to come" if matching.asked else "")
            + "; the Matching tab shows each match.</div>"
        )
    elif room.conjugate is not None and matching.message:
        parts.append(f"<div>{esc(matching.message)}</div>")
    return f"<div {BOX}>{''.join(parts)}</div>" if parts else ""


def written_html(room: Mosaic) -> str:
    """How far the writing of a file is, and what came of it."""
    if any(b.startswith("write|") for b in room.busy):
        return f"<div {BOX}>{esc(room.progress or 'starting')}…</div>"
    return f"<div {BOX}>{esc(room.wrote)}</div>" if room.wrote else ""


def step_html(room: Mosaic) -> str:
    """What the step shown is."""
    made = room.current
    if made is None:
        return ""
    manifest, row = made.registration.trace.manifest, room.shown_row
    if made.registration.method == "sequential":
        joined = manifest["joined"][row] if row < len(manifest.get("joined", ())) else None
        if joined is None:
            return ""
        points = f", {joined['agreeing']} of {joined['points']} points agree" if joined["points"] else " (the reference photo)"
        return f"<div {BOX}>step {row + 1} of {room.last_row + 1}: {esc(joined['photo'])} joins{points}</div>"
    stage = next((s["stage"] for s in manifest.get("stages", ()) if s["first"] <= row <= s["last"]), "")
    sigma = made.registration.trace.rows[row].sigma0
    said = f", sigma0 {sigma:.3g}" if np.isfinite(sigma) else ""
    return f"<div {BOX}>row {row} of {room.last_row}: {esc(stage)}{said}</div>"


def summary_html(room: Mosaic) -> str:
    """Both mosaics in a table, and their warnings."""
    if not room.made:
        return f"<div {BOX}><span {MUTED}>Photos become one picture with coordinates. Begin with Make mosaic.</span></div>"
    rows = []
    for method in METHODS:
        made = room.made.get(method)
        if made is not None:
            said, held = made.said, made.said.get("check_ties")
            sigma = [i["sigma"] for i in said["images"] if i["used"]]
            sigma = [s for s in sigma if np.isfinite(s)]
            rows.append(
                (
                    "",
                    (
                        f"{swatch(COLOURS[method])}{method}",
                        f"{len(made.registration.names)}",
                        f"{said['rms_px']:.2f}",
                        "–" if held is None else f"{held['median_px']:.2f}",
                        "–" if not sigma else f"{max(sigma):.3g}",
                        "–" if said["check_rms_m"] is None else f"{said['check_rms_m']:.3g}",
                    ),
                )
            )
    unit = next(iter(room.made.values())).registration.unit
    head = ("", "photos", "ties px", "held px", f"σ {unit}", "check m")
    made = room.current
    notes = "" if made is None else _notes(made)
    return f"<div {BOX}>{table(head, rows, 'Mosaics')}{notes}</div>"


def _notes(made: Made) -> str:
    tiles = f"{made.said['kind']}; {len(made.tiles)} tiles of {made.gsd:.3g} {made.registration.unit} a pixel"
    if made.done and made.renewed < made.total:
        tiles += f", {made.renewed} made anew by the last change"
    lost = [f"<div>{esc(i['name'])} is not in it: {esc(i['why'])}</div>" for i in made.said["images"] if not i["used"]]
    warned = [f"<div>⚠ {esc(w)}</div>" for w in made.registration.warnings[:4]]
    return f"<div {MUTED}>{tiles}; σ: predicted, a lower bound</div>{''.join(lost[:6])}{''.join(warned)}"


def drift_html(room: Mosaic) -> str:
    """How far the sequential mosaic is from the simultaneous one, photo by photo."""
    found, made = drift(room), room.made.get("simultaneous")
    if found is None or made is None:
        return ""
    unit, lengths = made.registration.unit, found.lengths
    order = np.argsort(-lengths)
    rows = [
        ("", (esc(found.names[k]), *(f"{v:+.3f}" for v in found.off[k].mean(axis=0)), f"{lengths[k]:.3f}")) for k in order[:40]
    ]
    head = ("sequential minus simultaneous", f"dX {unit}", f"dY {unit}", "corners rms")
    note = f"<div {MUTED}>all corners: rms {np.sqrt((lengths**2).mean()):.3f}, largest {lengths.max():.3f} {unit}</div>"
    return f"<div {BOX}>{table(head, rows, 'Drift', 130)}{note}</div>"


def residuals_html(room: Mosaic) -> str:
    """Where the mosaic shows points of known coordinates."""
    made = room.current
    if made is None or not len(made.points.off):
        return ""
    p = made.points
    length = np.linalg.norm(p.off, axis=1)
    rows = [
        ("", (esc(p.names[k]), p.roles[k], f"{p.photos[k]}", *(f"{v:+.3f}" for v in p.off[k]), f"{length[k]:.3f}"))
        for k in np.argsort(-length)[:60]
    ]
    sums = []
    for role in ("control", "check"):
        mine = length[[r == role for r in p.roles]]
        if len(mine):
            sums.append(f"{len(mine)} {role} points rms {np.sqrt((mine**2).mean()):.3f} m")
    head = ("mosaic minus point", "role", "photos", "dX m", "dY m", "length")
    note = f"<div {MUTED}>{', '.join(sums)}</div>"
    return f"<div {BOX}>{table(head, rows, 'Residuals of known points', 130)}{note}</div>"


def measured_html(state: State, room: Mosaic) -> str:
    """Coordinates, distance and area of the places, each with its standard error."""
    made, found = room.current, measured(room)
    if made is None or found is None:
        return ""
    r = made.registration
    at = found.xy if r.unit == "px" else r.frame.to_map(np.c_[found.xy, r.heights(found.xy)])
    places = decimals(float(np.nanmax(found.sigma)) if np.isfinite(found.sigma).any() else None, 4)
    rows = [
        (
            "",
            (
                f"{n + 1}",
                *(f"{v:.{places}f}" for v in p),
                *(_or_dash(s, places) for s in found.sigma[n]),
                esc(found.photos[n] or "outside"),
            ),
        )
        for n, p in enumerate(at)
    ]
    head = ("place", *(f"{v} {r.unit}" for v in "XYZ"[: at.shape[1]]), "σX", "σY", "judged by")
    words = []
    if found.length is not None:
        words.append(f"length {_with_sigma(found.length, r.unit)}")
    if found.area is not None:
        words.append(f"area {_with_sigma(found.area, f'{r.unit}²')}")
    note = "σ of the registration, pointing not included; photos that differ are taken as independent"
    if not np.isfinite(found.sigma).any():
        note = "a sequential registration knows no standard errors; show the simultaneous one"
    return f"<div {BOX}>{table(head, rows, 'Places measured', 160)}<div>{', '.join(words)}</div><div {MUTED}>{note}</div></div>"


def _or_dash(value: float, places: int) -> str:
    return f"{value:.{places}f}" if np.isfinite(value) else "–"


def _with_sigma(value: tuple[float, float], unit: str) -> str:
    places = decimals(value[1], 4)
    return f"{value[0]:.{places}f} ± {_or_dash(value[1], places)} {unit}"


def layer_html(room: Mosaic) -> str:
    """What the comparison with a map found."""
    layer = room.layer
    if layer is None:
        return ""
    if not len(layer.off):
        return f"<div {BOX}>{esc(layer.words or layer.name)}</div>"
    length = np.linalg.norm(layer.off, axis=1)
    rows = [
        ("", (f"{x:.2f}", f"{y:.2f}", f"{dx:+.3f}", f"{dy:+.3f}", f"{s:.2f}"))
        for (x, y), (dx, dy), s in zip(
            layer.at[np.argsort(-length)[:40]],
            layer.off[np.argsort(-length)[:40]],
            layer.score[np.argsort(-length)[:40]],
            strict=True,
        )
    ]
    return f"<div {BOX}><div>{esc(layer.words)}</div>{table(('X m', 'Y m', 'dX m', 'dY m', 'score'), rows, 'Offsets', 130)}</div>"
