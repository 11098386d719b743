"""The Compare tab: a subset of the control, every solution it gives beside the others, and which to believe."""

from __future__ import annotations

import numpy as np

from ..actions import Show, UseOnly, UsePoints
from ..desktop import Type, typed
from ..scene import COLOURS, sight
from ..state import ADVICE, COMPARED, ONE_PASS, WITH_PRIOR, State, by_role, measured
from ..tabs import Desk, Tab
from .tables import KEYS, orientation_values
from .widgets import BOX, MUTED, Html, bind, decimals, esc, prop, put, swatch, table

EVERY, SOME = "all", "own choice"
ADVISED = {"perspective": "perspective", "orthogonal": "orthogonal iterated", ONE_PASS: "orthogonal one pass",
           WITH_PRIOR: "perspective with prior"}
"""The advisor's name of each solution; it does not speak of the printed form."""


class ComparePanel:
    """Draws every solution of the chosen image; emits which control to use."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._cluster = gui.add_dropdown(
            "Cluster", (EVERY, SOME), hint="Use all control points or one cluster (column group of points.csv)."
        )
        bind(self._cluster, emit, lambda value: UsePoints("" if value == EVERY else value) if value != SOME else None)
        self._names = gui.add_text(
            "Names of GCPs", "", hint="Control points to use, such as: G01, G07, G1*. Or drag a rectangle in the tab Photo."
        )
        bind(self._names, emit, lambda value: Type("Names of GCPs", str(value)))
        self._use = gui.add_button("Use these points", hint="Only the control points named; everything is solved at once.")
        self._use.on_click(lambda _: emit(UseOnly(tuple(self._names.value.replace(",", " ").split()))))
        self._shown = gui.add_checkbox(
            "Draw all", False, hint="Every solution with its ellipsoid and its difference from the perspective one."
        )
        bind(self._shown, emit, lambda value: Show("compared", bool(value)))
        self._table = Html(gui)

    def draw(self, state: State) -> None:
        points = state.block.points
        named = by_role(points)["named"].tolist() if points.group else ()
        groups = tuple(dict.fromkeys(points.group[j] for j in named if points.group[j]))
        prop(self._cluster, "options", (EVERY, SOME, *groups))
        put(self._cluster, chosen_cluster(state))
        put(self._names, typed(state, "Names of GCPs"))
        put(self._shown, state.view.compared)
        self._table.set(f"<div {BOX}>{advice_html(state)}{solutions_table(state)}{errors_table(state)}</div>")


def chosen_cluster(state: State) -> str:
    """What the points that are on amount to: all, one group by name, or an own choice."""
    points, on = state.block.points, set(state.control())
    control = [(points.names[j], points.group[j] if points.group else "") for j in by_role(points)["control"].tolist()]
    if len(on) == len(control):
        return EVERY
    groups = {g for n, g in control if n in on}
    whole = len(groups) == 1 and on == {n for n, g in control if g in groups}
    return next(iter(groups)) if whole and "" not in groups else SOME


def solved(state: State) -> tuple[str, ...]:
    """The solutions there are of the chosen image."""
    return tuple(m for m in COMPARED if state.exterior(m) is not None)


def advice_html(state: State) -> str:
    """The advice with its reasons, in words."""
    found = state.solution(ADVICE)
    if found is None or found.advice is None:
        return f"<div {MUTED}>{esc(found.error) if found else ''}</div>"
    reasons = "".join(f"<li>{esc(r)}</li>" for r in found.advice.reasons)
    return f'<div role="note" aria-label="Advice"><b>Advice: {esc(found.advice.model)}</b>' \
           f'<ul style="margin:2px 0 6px;padding-left:18px">{reasons}</ul></div>'


def solutions_table(state: State) -> str:
    """Exterior orientations at the row shown, one solution beside the other, with their standard errors at the end."""
    models = solved(state)
    if not models:
        return f"<div {MUTED}>{_none_yet(state)}</div>"
    values = {m: orientation_values(state, m) for m in models}
    rows = []
    for i, (name, unit) in enumerate(KEYS):
        cells = [f"{name} <span {MUTED}>{unit}</span>"]
        for m in models:
            at, sigma = values[m] or (np.full(6, np.nan), None)
            places = min(decimals(_final_sigma(state, m)[i], 5), 5 if sigma is not None else 2 if i < 3 else 3)
            error = "&nbsp;" if sigma is None else f"±{sigma[i]:.{places}f}"
            own, first = f"{at[i]:.{places}f}<br><span {MUTED}>{error}</span>", values.get("perspective")
            cells.append(own if first is None else f"{own}<br>{_from_first(m, at[i], first[0][i], places, i >= 3)}")
        rows.append(("", cells))
    rms = []
    for m in models:
        seen = sight(state, m)
        v = seen.residuals[seen.used] if seen is not None else np.zeros((0, 2))
        rms.append(f"{np.sqrt((v**2).sum(axis=1).mean()):.2f}" if len(v) else "–")
    rows.append(("", (f"rms <span {MUTED}>px</span>", *rms)))
    shown = table(("", *(f"{swatch(COLOURS[m])}<br>{esc(m)}" for m in models)), rows, "Solutions compared", size=10)
    return f"{shown}<div {MUTED}>Δ: difference from the perspective solution, at the row shown</div>"


def _from_first(model: str, value: float, first: float, places: int, angle: bool) -> str:
    """How much an element differs from that of the perspective solution, which is `first`."""
    if model == "perspective":
        return "&nbsp;"
    difference = value - first
    return f"Δ {(difference + 180) % 360 - 180 if angle else difference:+.{places}f}"


def _none_yet(state: State) -> str:
    """Why there is nothing to compare, and what to do."""
    if measured(state.block).get(state.image):
        return f"No solution of {esc(state.image)} yet."
    if "control" not in state.block.points.role:
        return "Models are compared by control points, and this project has none; they come with a list (collinea init)."
    return "Both models are compared here once an image is oriented: mark at least three control points on its photo (tab Photo)."


def _final_sigma(state: State, model: str) -> np.ndarray:
    """(6,) standard errors at the last row [m, degrees]: they say how many places any row is worth."""
    solution = state.solution(model)
    sigma = solution.orientation.sigma if solution and solution.orientation else np.full(6, np.nan)
    return np.concatenate([sigma[:3], np.degrees(sigma[3:])])


def _head(model: str) -> str:
    return f'{swatch(COLOURS[model])}{esc(model)}'


def errors_table(state: State) -> str:
    """Predicted against actual error of each solution; without a truth, its difference from the perspective one."""
    truth = state.assets.truth.get(state.image)
    reference = truth or state.exterior("perspective")
    if reference is None:
        return ""
    rows = []
    for m in solved(state):
        at, covariance = state.exterior(m), predicted(state, m)
        if at is None or (truth is None and m == "perspective"):
            continue
        error = np.append(at.centre - reference.centre, (at.angles - reference.angles + np.pi) % (2 * np.pi) - np.pi)
        cells = [_head(m), *(["–", "–"] if covariance is None else [
            _metres(np.sqrt(np.trace(covariance[:3, :3]))), _degrees(np.sqrt(covariance[3, 3] + covariance[4, 4]))])]
        cells += [_metres(float(np.linalg.norm(error[:3]))), _degrees(np.hypot(*error[3:5]))]
        if truth is not None:
            cells.append("–" if covariance is None else _ratio(error, covariance))
        rows.append(("", cells))
    if not rows:
        return ""
    actual = "actual" if truth is not None else "from perspective"
    head = ("", "predicted <br>position m", "<br>tilt °", f"{actual} <br>position m", "<br>tilt °")
    explained = (
        "predicted: standard errors from the geometry alone; actual: against the truth of the simulation, at the row shown; "
        "error/σ: all six unknowns together, about 1 where the prediction holds; drawn dashed: solutions with the prior"
        if truth is not None else
        "this project knows no truth; the differences from the perspective solution, at the row shown"
    )
    curved = [m for m in solved(state) if (s := state.solution(m)) and s.orientation
              and any("simulated passes" in w for w in s.orientation.warnings)]
    if curved:
        explained += f"; {' and '.join(curved)}: predicted by simulated passes, the prior is too uncertain for linear theory"
    shown = table((*head, "error/σ") if truth is not None else head, rows, "Predicted and actual error")
    return f'<div style="height:8px"></div>{shown}<div {MUTED}>{explained}</div>'


def predicted(state: State, model: str) -> np.ndarray | None:
    """Covariance (6, 6) foreseen for a solution: the advisor's where it speaks of it, else the solution's own, a priori."""
    found, solution = state.solution(ADVICE), state.solution(model)
    said = found.advice.predicted.get(ADVISED.get(model, "")) if found and found.advice else None
    if said is not None and np.isfinite(said.covariance).all():
        return said.covariance
    return solution.orientation.covariance if solution and solution.orientation else None


def _ratio(error: np.ndarray, covariance: np.ndarray) -> str:
    """Length of an error in its standard errors, all six unknowns together: sqrt(e^T C^-1 e / 6)."""
    scale = np.sqrt(np.diag(covariance))
    unit = error / scale
    return f"{np.sqrt(max(float(unit @ np.linalg.solve(covariance / np.outer(scale, scale), unit)), 0.0) / 6):.1f}"


def _metres(value: float) -> str:
    return f"{value:.3f}" if value < 100 else f"{value:.0f}"


def _degrees(value: float) -> str:
    return f"{np.degrees(value):.4f}" if np.degrees(value) < 10 else f"{np.degrees(value):.1f}"


TAB = Tab("Compare", ComparePanel, order=40)
