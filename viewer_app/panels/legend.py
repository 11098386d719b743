"""The Legend tab: what the colours and strokes of the scene mean, and by how much it exaggerates."""

from __future__ import annotations

from ..bundle_scene import alone
from ..scene import photo_scale, vector_scale
from ..state import State
from ..tabs import Desk, Tab
from ..theme import CHECK, CONTROL, ORTHOGONAL, PERSPECTIVE, Colour, foreground, legend
from .widgets import BOX, MUTED, Html, css, esc

MEANINGS = {
    "initial": "initial value: where the adjustment began",
    "perspective": "perspective (collinearity) solution, its rays and ellipsoid",
    "orthogonal": "orthogonal projection model, its parallel bundle and average plane",
    "georeferenced": "onboard GPS/IMU orientation",
    "truth": "truth of a simulated project",
    "control": "ground control point",
    "check": "check point: compared, not used",
    "residual": "residual vector, from the point to its observed ray",
}


class LegendPanel:
    """Draws the legend; nothing to operate."""

    def __init__(self, desk: Desk) -> None:
        self._text = Html(desk.gui)

    def draw(self, state: State) -> None:
        self._text.set(legend_html(state))


def legend_html(state: State) -> str:
    """Every colour with its meaning, the strokes, and the exaggerations in force."""
    dark = state.view.dark
    rows = [_row(_line(colour), MEANINGS[name]) for name, colour in legend(dark).items() if name not in ("control", "check")]
    rows += [_row(_symbol(CONTROL, "circle"), MEANINGS["control"]), _row(_symbol(CHECK, "triangle"), MEANINGS["check"])]
    rows.append(_row(_line(ORTHOGONAL, "7 2"), "long dashes: one orthogonal pass through the prior"))
    rows.append(_row(_line(ORTHOGONAL, "3 2"), "short dashes: the same in the papers' printed form"))
    rows.append(_row(_line(PERSPECTIVE, "7 2"), "dashed: perspective that observes the prior"))
    rows.append(_row(_line(foreground(dark)), "arrow between frustums: difference of the models, exaggeration beside it"))
    return f'<div {BOX} role="list" aria-label="Legend">{"".join(rows)}<div {MUTED}>{exaggerations(state)}</div></div>'


def exaggerations(state: State) -> str:
    """By how much what is drawn is larger than it is."""
    if alone(state):
        return "drawn: corrections and ellipsoids of the bundle as the bars in the scene say"
    return (
        f"drawn: residuals on the ground × {vector_scale(state):g} · residuals on the photo × {photo_scale(state):g} · "
        f"95 % ellipsoids × {max(state.view.ellipsoid, 1.0):g}"
    )


def _row(mark: str, words: str) -> str:
    return f'<div role="listitem" style="display:flex;gap:8px;align-items:center">{mark}<span>{esc(words)}</span></div>'


def _line(colour: Colour, dashes: str = "") -> str:
    dash = f' stroke-dasharray="{dashes}"' if dashes else ""
    stroke = f'stroke="{css(colour)}" stroke-width="3"{dash}'
    return f'<svg width="26" height="10" style="flex:none"><path d="M1 5H25" {stroke}/></svg>'


def _symbol(colour: Colour, kind: str) -> str:
    shape = '<circle cx="13" cy="7" r="5"/>' if kind == "circle" else '<path d="M13 2L18 11H8Z"/>'
    return (
        f'<svg width="26" height="14" style="flex:none"><g fill="none" stroke="{css(colour)}" stroke-width="1.6">{shape}'
        f'<path d="M13 1V13M7 7H19" stroke-width="1"/></g></svg>'
    )


TAB = Tab("Legend", LegendPanel, place="below", order=40)
