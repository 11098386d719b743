"""Transport over the iterations: first, previous, play, next, last, a slider, keys; and the plots beside it."""

from __future__ import annotations

import viser

from ..actions import STEPS, GoTo, Play, Speed, Step
from ..bridge import Wire
from ..state import MODELS, State
from ..theme import MODELS as COLOURS
from .plots import Curve, plot
from .widgets import BOX, MUTED, Emit, Html, bind, prop, put, swatch

BUTTONS = ("|◀", "◀", "▶❙❙", "▶", "▶|")
PLOTS = (("σ0", "sigma0"), ("cost", "cost"), ("step [σ]", "step"))


class TracePanel:
    """Draws the rows of the chosen image's traces."""

    def __init__(self, gui: viser.GuiApi, emit: Emit, wire: Wire) -> None:
        self._wire = wire
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

        self._speed = gui.add_slider("Rows per second", 0.5, 20.0, 0.5, 2.0, hint="Speed of play, rows per second.")
        bind(self._speed, emit, lambda value: Speed(float(value)))
        self._text = Html(gui)
        keys: tuple[tuple[str, str, str], ...] = (
            ("First row", "home", "first"),
            ("Previous row", "arrowleft", "previous"),
            ("Next row", "arrowright", "next"),
            ("Last row", "end", "last"),
        )
        assert {k[2] for k in keys} == set(STEPS)
        for label, key, to in keys:
            gui.add_command(label, hotkey=key).on_trigger(lambda _, to=to: emit(Step(to)))  # type: ignore[arg-type]
        gui.add_command("Play or pause", hotkey="space").on_trigger(lambda _: emit(Play()))

    def draw(self, state: State) -> None:
        prop(self._slider, "max", max(state.last_row, 1))
        prop(self._slider, "disabled", state.last_row == 0)
        put(self._slider, state.row)
        put(self._speed, state.speed)
        self._text.set(f"<div {BOX}>{self._rows(state)}{self._plots(state)}</div>")

    def _rows(self, state: State) -> str:
        lines = []
        for model in MODELS:
            solution = state.solution(model)
            row = solution.row(state.row) if solution else None
            if solution is None or row is None:
                continue
            end = f" · {_stop(row.stop)}" if row.stop else ""
            sigma0 = f"{row.sigma0:.4g}" if row.sigma0 == row.sigma0 else "–"
            lines.append(
                f"<div>{swatch(COLOURS[model])}{model} row {row.index}: σ0 {sigma0}, cost {row.cost:.5g}"
                f"<span {MUTED}>{end}</span></div>"
            )
        playing = "<div>playing ▶</div>" if state.playing else ""
        return "".join(lines) + playing or f"<div {MUTED}>No iteration yet.</div>"

    def _plots(self, state: State) -> str:
        solutions = [(m, s) for m in MODELS if (s := state.solution(m)) and s.rows]
        if not solutions:
            return ""

        def button(row: int, hint: str) -> str:
            return self._wire.attributes("row", str(row), hint)

        import numpy as np

        drawn = []
        for title, name in PLOTS:
            curves = [Curve(m, np.array([getattr(r, name) for r in s.rows], float), COLOURS[m]) for m, s in solutions]
            drawn.append(plot(title, curves, state.row, state.last_row, button))
        return f'<div style="margin-top:6px;display:flex">{"".join(drawn)}</div>'


def _stop(reason: str) -> str:
    return {
        "step": "converged (step)",
        "gradient": "converged (gradient)",
        "cost": "converged (cost)",
        "max_iterations": "stopped: too many iterations",
        "diverged": "diverged",
    }.get(reason, reason)
