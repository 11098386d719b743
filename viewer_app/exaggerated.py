"""What the scene draws larger than it is, in words for the line that is always in view; pure."""

from __future__ import annotations

from .bars import drawn_larger
from .bundle_scene import alone
from .bundle_scene import bars as bundle_bars
from .mosaic_scene import bars as mosaic_bars
from .scene import vector_scale
from .state import State
from .values import Label


def exaggerated(state: State) -> tuple[str, ...]:
    """Everything that is drawn exaggerated just now, and by how much: "residuals × 500"."""
    words = [] if alone(state) else drawn_larger(state, vector_scale(state))
    beside = {**bundle_bars(state), **mosaic_bars(state)}
    return (*words, *(v.text.partition(": ")[2] for v in beside.values() if isinstance(v, Label)))
