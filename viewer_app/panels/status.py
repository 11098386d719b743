"""The line over all tabs: what is going on, what was said last."""

from __future__ import annotations

from ..state import State
from ..tabs import Desk
from .tables import status
from .widgets import Html


class StatusLine:
    """Draws the line; nothing to operate."""

    def __init__(self, desk: Desk) -> None:
        self._text = Html(desk.gui)

    def draw(self, state: State) -> None:
        self._text.set(status(state))
