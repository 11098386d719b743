"""How wide the panels are in each browser: what was chosen, made to fit its page. All but `Widths` is pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from .desktop import FITS, Desktop
from .state import State

NARROW, FULL, WIDEST = 410, 760, 1200
"""Widths of the main panel, pixels of the page: on a laptop, where every column of every table has room, and of two photos."""
SHARE = 0.32
"""Of the page's width, for the main panel that fits the page."""
SCENE = 300
"""What the main panel leaves of the page, pixels."""
OVER = 430
"""Width of the panel over the scene, pixels of the page."""
EDGE = 24
"""Beside and around the picture in the panel, and the same between the panel and the scene's edges, pixels of the page."""
TALL, CHROME = 0.92, 284
"""What a panel over the scene may take of the page's height before it has to be scrolled; and, pixels, what stands there above
and below the photo."""
LARGE = 0.85
"""Sides of the photo that is large, of those of one that takes the whole scene."""
PHOTO = "Photo"
"""Name of the tab whose panel grows."""
Size = tuple[float, float]
"""Width and height, pixels of the page."""


def panel_width(choice: str, page: float) -> int:
    """Width of the main panel on a page so many pixels wide."""
    fits = min(max(SHARE * page, NARROW), FULL)
    wish = {FITS: fits, "narrow": NARROW, "wide": max(FULL, 1.4 * fits), "very wide": max(WIDEST, 1.9 * fits)}[choice]
    return round(max(min(wish, page - SCENE), NARROW))


def photo_width(choice: str, canvas: Size, aspect: float) -> int:
    """Width of the panel with the photo. canvas: what the main panel leaves of the page; aspect: the photo's, width to height."""
    if choice == "small":
        return OVER
    most = min(canvas[0] - 2 * EDGE, (TALL * canvas[1] - CHROME) * aspect)
    return round(max((LARGE if choice == "large" else 1.0) * most + EDGE, min(OVER, canvas[0] - EDGE)))


def picture_height(choice: str) -> str:
    """The most the photo may be high, as CSS, however wide its panel is drawn: all of that stays in sight."""
    return "62vh" if choice == "small" else f"max({100 * TALL:g}vh - {CHROME}px,40vh)"


class Widths:
    """Tells every browser how wide its panels are, when that changes; what people drag stays until then.

    send(client, panel, width): panel "side" or "below". All calls come from one thread.
    """

    def __init__(self, send: Callable[[int, str, int], None]) -> None:
        self._send = send
        self._pages: dict[int, float] = {}
        self._canvases: dict[int, Size] = {}
        self._open: dict[int, str] = {}
        self._sent: dict[tuple[int, str], int] = {}

    def sized(self, client: int, canvas: Size, page: float) -> None:
        """A browser says how wide its page is, and what the main panel leaves of it to the scene."""
        self._pages[client], self._canvases[client] = page, canvas

    def opened(self, client: int, tab: str) -> None:
        """A browser says which tab was opened over its scene."""
        self._open[client] = tab

    def left(self, client: int) -> None:
        for known in (self._pages, self._canvases, self._open):
            known.pop(client, None)
        self._sent = {key: width for key, width in self._sent.items() if key[0] != client}

    def shows(self, client: int, state: State) -> str:
        """The tab open over a browser's scene, "" for the first."""
        return self._open.get(client, state.room(Desktop).below)

    def fit(self, state: State) -> None:
        """Send what is not as wide as it should be."""
        room = state.room(Desktop)
        for client, page in list(self._pages.items()):
            self._set(client, "side", panel_width(room.panel, page))
            photo = self.shows(client, state) == PHOTO and bool(state.block.images)
            self._set(client, "below", photo_width(room.photo, self._canvases[client], _aspect(state)) if photo else OVER)

    def _set(self, client: int, panel: str, width: int) -> None:
        if self._sent.get((client, panel)) != width:
            self._sent[client, panel] = width
            self._send(client, panel, width)


def _aspect(state: State) -> float:
    camera: Any = state.block.camera_of(state.image)
    return camera.width / camera.height
