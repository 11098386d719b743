"""Transport over the iterations: first, previous, play, next, last, a slider, keys; and the plots beside it."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from ..actions import GoTo, Play, Speed, Step
from ..figures import CORRELATION, ELEMENTS, FIGURES, RESIDUALS, ChooseFigure, Figure
from ..kept_run import KeepRun, kept_of, scene
from ..state import State, wanted
from ..tabs import Command, Desk, Tab
from ..traces import row_words, traces
from .figures import correlation_html, elements_html, residuals_html
from .plots import Curve, plot
from .widgets import BOX, MUTED, Html, bind, prop, put, swatch

BUTTONS = ("|◀", "◀", "▶❙❙", "▶", "▶|")
SOON = "The first iteration is on its way …"
NOTHING = "No iteration yet: the rows of an adjustment are stepped through here, of {}."
WITH, WITHOUT = "an image with three marked control points (tab Photo) or of a bundle (tab Bundle)", "a bundle (tab Bundle)"
"""What makes rows, in a project with control points and without."""
PLOTS = (("σ0", "sigma0"), ("cost", "cost"), ("step [σ]", "step"))


class TracePanel:
    """Draws the rows of the chosen image's traces."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._wire = desk.wire
        self._slider = gui.add_slider(
            "Iteration", 0, 1, 1, 0, hint="Row of both traces: 0 is the start. Keys: left, right, Home, End."
        )
        bind(self._slider, emit, lambda value: GoTo(round(value)))
        buttons = gui.add_button_group(
            "Go to", BUTTONS, hint="First, previous, play or pause, next, last row. Keys: Home, left, space, right, End."
        )
        actions = dict(zip(BUTTONS, (Step("first"), Step("previous"), Play(), Step("next"), Step("last")), strict=True))

        @buttons.on_click
        async def _(event: viser.GuiEvent) -> None:
            if buttons.value in actions:
                emit(actions[buttons.value])

        self._speed = gui.add_slider("Rows / second", 0.5, 20.0, 0.5, 2.0, hint="Speed of play, rows per second.")
        bind(self._speed, emit, lambda value: Speed(float(value)))
        self._figure = gui.add_dropdown(
            "Figure",
            FIGURES,
            hint="σ0, cost and step; every element minus its final value; correlations of the elements; residual vectors over "
            "the photo. Key: P.",
        )
        bind(self._figure, emit, ChooseFigure)
        self._keep = gui.add_checkbox(
            "Keep this run",
            False,
            hint="The traces of this image as they are now stay, thin and pale, and are stepped with those that you solve next "
            "with other points or settings.",
        )
        bind(self._keep, emit, lambda value: KeepRun(bool(value)))
        self._text = Html(gui)

    def draw(self, state: State) -> None:
        prop(self._slider, "max", max(state.last_row, 1))
        prop(self._slider, "disabled", state.last_row == 0)
        put(self._slider, state.shown_row)
        put(self._speed, state.speed)
        put(self._figure, state.room(Figure).name)
        put(self._keep, bool(kept_of(state)))
        self._text.set(f"<div {BOX}>{self._rows(state)}{self._drawn(state)}</div>")

    def _drawn(self, state: State) -> str:
        """The chosen figure."""
        name = state.room(Figure).name
        if name == CORRELATION:
            return correlation_html(state)
        if name == RESIDUALS:
            return residuals_html(state) if state.block.images else ""
        return elements_html(state, self._button) if name == ELEMENTS else self._plots(state)

    def _button(self, row: int, hint: str) -> str:
        return self._wire.attributes("row", str(row), hint)

    def _rows(self, state: State) -> str:
        lines = []
        for name, rows, colour in traces(state):
            words, stop = row_words(name, rows[min(state.row, len(rows) - 1)])
            end = f"<span {MUTED}> · {stop}</span>" if stop else ""
            lines.append(f"<div>{swatch(colour)}{words}{end}</div>")
        playing = "<div>playing ▶</div>" if state.playing else ""
        way = WITH if "control" in state.block.points.role else WITHOUT
        waits = any(job.image == state.image for job in wanted(state))
        return "".join(lines) + playing or f"<div {MUTED}>{SOON if waits else NOTHING.format(way)}</div>"

    def _plots(self, state: State) -> str:
        found = traces(state)
        if not found:
            return ""

        drawn = []
        for title, name in PLOTS:
            curves = [Curve(n, np.array([getattr(r, name) for r in rows], float), colour) for n, rows, colour in found]
            last = max(len(rows) for _, rows, _ in found) - 1
            drawn.append(plot(title, curves, min(state.shown_row, last), last, self._button))
        return f'<div style="margin-top:6px;display:flex">{"".join(drawn)}</div>'


def _heard_row(state: State, value: Any) -> GoTo | None:
    return GoTo(int(value)) if isinstance(value, str) and value.isdecimal() and len(value) < 7 else None


TAB = Tab(
    "Iterations",
    TracePanel,
    place="below",
    order=10,
    commands=(
        Command("First row", Step("first"), "home"),
        Command("Previous row", Step("previous"), "arrowleft"),
        Command("Next row", Step("next"), "arrowright"),
        Command("Last row", Step("last"), "end"),
        Command("Play or pause", Play(), "space"),
        Command("Next figure", ChooseFigure(), "P", hint="Convergence, elements, correlation or residuals."),
    ),
    heard={"row": _heard_row},
    scene=scene,
)
