"""The traces the transport steps through, and what one of their rows says in words; pure."""

from __future__ import annotations

from collections.abc import Sequence

from solvers.adjustment import Iteration

from .bundle_scene import alone, ink
from .bundle_state import Bundle
from .kept_run import kept_of
from .scene import pale
from .state import MODELS, State
from .theme import MODELS as COLOURS
from .theme import Colour

STOPS = {
    "step": "converged (step)",
    "gradient": "converged (gradient)",
    "cost": "converged (cost)",
    "max_iterations": "stopped: too many iterations",
    "diverged": "diverged",
}


def traces(state: State) -> list[tuple[str, Sequence[Iteration], Colour]]:
    """Name, rows and colour of the chosen image's traces, and of the bundle or, where it is drawn alone, only of that."""
    room = state.room(Bundle)
    bundle = [("bundle", room.rows, ink(state))] if room.rows else []
    if alone(state):
        return list(bundle)
    kept = [(f"{m} kept", s.rows, pale(COLOURS[m], state.view.dark)) for m, s in kept_of(state).items()]
    return [*((m, s.rows, COLOURS[m]) for m in MODELS if (s := state.solution(m)) and s.rows), *kept, *bundle]


def row_words(name: str, row: Iteration) -> tuple[str, str]:
    """What a row is worth, and why the adjustment ended with it: "" where it went on."""
    sigma0 = f"{row.sigma0:.4g}" if row.sigma0 == row.sigma0 else "–"
    return f"{name} row {row.index}: σ0 {sigma0}, cost {row.cost:.5g}", STOPS.get(row.stop, row.stop) if row.stop else ""
