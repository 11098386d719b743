"""The line over all tabs: what is going on and for how long still, what was said last."""

from __future__ import annotations

import time

from ..exaggerated import exaggerated
from ..state import State
from ..tabs import Desk
from .tables import status
from .widgets import MUTED, Html, esc


class StatusLine:
    """Draws the line; nothing to operate. It times the solving of many images, of which no state knows."""

    def __init__(self, desk: Desk) -> None:
        self._text = Html(desk.gui)
        self._begun: tuple[int, float, int] | None = None  # revision, when, and how many images were to be solved then

    def draw(self, state: State) -> None:
        larger = esc(" · ".join(exaggerated(state)))
        style = 'style="padding:0 12px 10px;font-size:12px"'
        line = f'<div {style} aria-label="Drawn larger"><span {MUTED}>drawn: {larger}</span></div>'
        line = line if larger else ""
        self._text.set(status(state, lambda todo: self._left(state.work.revision, todo), line))

    def _left(self, revision: int, todo: int) -> float | None:
        """Seconds until so many other images are solved, by the rate so far; None before there is one."""
        now = time.monotonic()
        if self._begun is None or self._begun[0] != revision or todo > self._begun[2]:
            self._begun = revision, now, todo
        _, began, first = self._begun
        return (now - began) / (first - todo) * todo if first > todo and now > began else None
