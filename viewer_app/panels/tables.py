"""Tables and sentences of the Orientation tab as HTML, pure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..bridge import Wire
from ..scene import CHI_95, Sight, sight
from ..state import ADVICE, MODELS, State, by_role, fresh, measured, wanted
from ..theme import CHECK, CONTROL, INITIAL
from ..theme import MODELS as COLOURS
from .widgets import BOX, MUTED, decimals, esc, swatch, table

KEYS = (("X", "m"), ("Y", "m"), ("Z", "m"), ("ω", "°"), ("φ", "°"), ("κ", "°"))


def orientation_values(state: State, model: str) -> tuple[np.ndarray, np.ndarray | None] | None:
    """X, Y, Z in project coordinates [m], omega, phi, kappa [deg] at the row shown, with standard errors at the last row."""
    exterior, solution = state.exterior(model), state.solution(model)
    if exterior is None or solution is None:
        return None
    ended = solution.orientation is not None and state.row_of(solution) >= len(solution.rows) - 1
    if ended and solution.orientation:
        final = solution.orientation
        values = np.concatenate([final.exterior.centre, np.degrees(final.exterior.angles)])
        return values, np.concatenate([final.sigma[:3], np.degrees(final.sigma[3:])])
    return np.concatenate([state.assets.frame.to_map(exterior.centre), np.degrees(exterior.angles)]), None


def orientation_table(state: State) -> str:
    """Both models with their standard errors and their difference."""
    one, two = (orientation_values(state, model) for model in MODELS)
    rows = []
    for i, (name, unit) in enumerate(KEYS):
        sigmas = [v[1][i] for v in (one, two) if v is not None and v[1] is not None]
        places = max([decimals(s) for s in sigmas], default=3 if i < 3 else 5)
        cells = [f"{name} <span {MUTED}>{unit}</span>"]
        for v in (one, two):
            cells += ["–", ""] if v is None else [f"{v[0][i]:.{places}f}", "" if v[1] is None else f"±{v[1][i]:.{places}f}"]
        difference = None if one is None or two is None else float(two[0][i] - one[0][i])
        if difference is not None and i >= 3:
            difference = (difference + 180) % 360 - 180
        cells.append("" if difference is None else f"{difference:+.{places}f}")
        rows.append(("", cells))
    head = ("", f"{swatch(COLOURS['perspective'])}perspective", "1σ", f"{swatch(COLOURS['orthogonal'])}orthogonal", "1σ", "o − p")
    sigma0 = [_number(r.sigma0 if (s := state.solution(m)) and (r := s.row(state.row)) else None) for m in MODELS]
    rms = [_number(_rms(sight(state, m))) for m in MODELS]
    used = [f"{int(s.orientation.used.sum())}" if (s := state.solution(m)) and s.orientation else "–" for m in MODELS]
    rows += [
        ("", ("σ0", sigma0[0], "", sigma0[1], "", "")),
        ("", (f"rms <span {MUTED}>px</span>", rms[0], "", rms[1], "", "")),
        ("", ("GCPs", used[0], "", used[1], "", "")),
    ]
    return f"<div {BOX}>{table(head, rows, 'Orientation')}</div>"


MOST = 40
"""Images listed of a point, at most."""


def point_in_images(state: State, wire: Wire) -> str:
    """Residuals of the chosen point in every image that it was measured in, by both models; a click goes to the image."""
    if state.point is None or state.point not in state.block.points.names:
        return ""
    j, of = state.block.point_index(state.point), state.block.observations
    images = [state.block.images[i].name for i in np.unique(of.image[of.point == j])]
    rows = []
    for image in images[:MOST]:
        cells = [f"<b>{esc(image)}</b>" if image == state.image else esc(image)]
        for model in MODELS:
            seen = sight(state, model, image)
            at = None if seen is None or state.point not in seen.names else seen.residuals[seen.names.index(state.point)]
            cells += ["–", "–"] if at is None else [f"{v:+.2f}" if np.isfinite(v) else "–" for v in at]
        rows.append((wire.attributes("fly-image", image, f"go to {image}"), cells))
    swatches = [swatch(COLOURS[m]) for m in MODELS]
    head = ("image", *(f"{s}v {axis}" for s in swatches for axis in ("col", "row")))
    more = f"<div {MUTED}>and {len(images) - MOST} more images</div>" if len(images) > MOST else ""
    if not images:
        return f"<div {BOX}><b>{esc(state.point)}</b> is not measured in any image yet.</div>"
    title = f"<b>{esc(state.point)}</b> <span {MUTED}>in {len(images)} images · residuals in px, observed − projected</span>"
    return f"<div {BOX}><div>{title}</div>{table(head, rows, 'Residuals of the point', 180)}{more}</div>"


def _rms(seen: Sight | None) -> float | None:
    """Length of the two-dimensional residual [px] over the points used, at the row shown."""
    return None if seen is None or not seen.used.any() else float(np.sqrt((seen.residuals[seen.used] ** 2).sum(axis=1).mean()))


def _number(value: float | None) -> str:
    return "–" if value is None or not np.isfinite(value) else f"{value:.3f}"


LINE = 17
"""Height of a line over the tabs, pixels of the page. Two always have room: nothing below moves when something is said."""


def status(state: State, left: Callable[[int], float | None] = lambda todo: None, below: str = "") -> str:
    """What was said last and what is going on, over all tabs; else what is open. left: seconds that so many images take, where
    known. below: what stands under it at all times."""
    todo = {(j.image, j.model) for j in wanted(state)}
    busy = [m for m in (*MODELS, ADVICE) if (state.image, m) in todo]
    said = [f"<span>{esc(state.message)}</span>"] if state.message else []
    if busy:
        said.append(f"<span>Solving {esc(state.image)}: {' and '.join(busy)} …</span>")
    elif todo:
        count = waiting(state)
        seconds = left(count)
        long = "" if seconds is None else f", about {seconds:.0f} s left"
        said.append(f"<span {MUTED}>Solving the other images: {count} to do{long} …</span>")
    still = f"<span {MUTED}>{esc(' · '.join(filter(None, (state.block.name, state.image, state.point))))}</span>"
    style = f'style="padding:4px 12px 2px;font-size:12px;line-height:{LINE}px;min-height:{2 * LINE + 6}px;box-sizing:border-box"'
    return f'<div {style} role="status" aria-label="Status">{" ".join(said) or still}</div>{below}'


def words(state: State) -> str:
    """What went wrong and what to mind, in sentences."""
    lines, warned = [], {}  # what both models are warned of is said once
    for model in MODELS:
        solution = state.solution(model)
        for w in solution.orientation.warnings if solution and solution.orientation else ():
            warned[w] = warned.get(w, "") + swatch(COLOURS[model])
    for model in MODELS:
        solution = state.solution(model)
        if solution is None:
            continue
        if solution.error and "control" in state.block.points.role:
            lines.append(f"<div>{swatch(COLOURS[model])}<b>No {model} solution.</b> {esc(solution.error)}</div>")
        if solution.orientation:
            lines += [f"<div>{warned.pop(w)}{esc(w)}</div>" for w in solution.orientation.warnings if w in warned]
            if solution.orientation.rejected:
                lines.append(
                    f"<div>{swatch(COLOURS[model])}rejected as blunders: {esc(', '.join(solution.orientation.rejected))}</div>"
                )
    advised = state.solution(ADVICE)
    if advised and advised.advice:
        lines.append(f"<div><b>Advice: {esc(advised.advice.model)}.</b> {esc('; '.join(advised.advice.reasons))}.</div>")
    lines += _unsaid(state)
    degrees = next((s.orientation.dof for m in MODELS if (s := state.solution(m)) and s.orientation), None)
    if degrees is not None and state.view.ellipsoids:
        lines.append(
            f"<div {MUTED}>Ellipsoids of the centres: 95 %, factor {CHI_95:.3f} (√χ² with 3 degrees of freedom), a priori from "
            f"the given "
            f"standard errors, drawn × {state.view.ellipsoid:g}; redundancy of the adjustment {degrees}.</div>"
        )
    return f'<div {BOX}><div role="status" aria-label="Messages">{"".join(lines)}</div></div>'


def waiting(state: State) -> int:
    """Images that are not solved as things are now."""
    counts = measured(state.block)
    return sum(1 for image, n in counts.items() if n and not all(fresh(state.work, image, m) for m in MODELS))


def _unsaid(state: State) -> list[str]:
    """What is not drawn, and why."""
    block = state.block
    if not block.images:
        return [f"<div {MUTED}>This project has no images yet.</div>"]
    seen = measured(block)[state.image]
    said = []
    if not len(block.points):
        said.append(
            "This project has no points: find tie points in the tab Matching, then adjust them in the tab Bundle or make a "
            "mosaic; ground control comes with a list of points (collinea init)."
        )
    elif "control" not in block.points.role:
        said.append(
            "This project has no control points, which orient an image by itself: adjust its tie points in the tab Bundle or "
            "make a mosaic; ground control comes with a list of points (collinea init)."
        )
    elif not seen:
        said.append(
            "No point is measured in this image yet: in the tab Photo, N chooses a point, a click where you see it marks it, M "
            "places the mark."
        )
    if state.image not in state.assets.truth and state.assets.truth:
        said.append("The simulation knows no truth for this image.")
    found = state.work.solutions
    missing = sum(1 for i in block.images if not any((s := found.get((i.name, m))) and s.rows for m in MODELS))
    if missing and not wanted(state):
        placed = any(i.prior is not None and i.prior.centre is not None for i in block.images)
        words = "green frustums and crosses stand where GPS and IMU place them" if placed else "they are not drawn"
        said.append(f"{missing} of {len(block.images)} images have no solution: {words}.")
    return [f"<div {MUTED}>{esc(s)}</div>" for s in said]


def point_table(state: State, wire: Wire) -> str:
    """Every control and check point: on or off, its residuals in the chosen image by both models. A row switches its point."""
    seen = [_residuals(sight(state, model)) for model in MODELS]
    points, rows = state.block.points, []
    for j in by_role(points)["named"].tolist():
        name, role, group = points.names[j], points.role[j], points.group[j] if points.group else ""
        off = name in state.work.off
        mark = swatch(INITIAL if off else CONTROL if role == "control" else CHECK)
        weight = "font-weight:600;" if name == state.point else ""
        style = f'style="{weight}{"opacity:.5;" if off else ""}cursor:pointer"'
        attributes = wire.attributes("point", name, f"{name}: switch {'on' if off else 'off'}").replace(
            'style="cursor:pointer"', ""
        )
        cells = [f"{'☐' if off else '☑'} {mark}{esc(name)}", f"{esc(role)}{' · ' + esc(group) if group else ''}"]
        for s in seen:
            cells += s.get(name, ("", ""))
        rows.append((f'{attributes} {style} data-point="{esc(name)}"', cells))
    if not rows:
        return ""
    head = ("point", "role", *(f"{swatch(COLOURS[m])}v {axis}" for m in MODELS for axis in ("col", "row")))
    on = len(state.control())
    hint = "residuals in px, observed − projected · click a row to switch its point"
    title = f"<div><b>{on} control points on</b> <span {MUTED}>· {hint}</span></div>"
    return f"<div {BOX}>{title}{table(head, rows, 'Ground control points', 230)}</div>"


def _residuals(seen: Sight | None) -> dict[str, tuple[str, str]]:
    """Both residuals of every point seen, in words."""
    if seen is None:
        return {}
    words = (tuple(f"{v:+.2f}" if v == v else "behind" for v in pair) for pair in seen.residuals.tolist())
    return dict(zip(seen.names, words, strict=True))  # type: ignore[arg-type]
