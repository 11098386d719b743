"""A picture of the scene made complete: the theme's ground behind it, title, the row shown, legend and exaggerations on it."""

from __future__ import annotations

import io
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from .bundle_state import Bundle
from .panels.legend import MEANINGS, exaggerations
from .state import State
from .tabs import whole_scene
from .theme import CHECK, CONTROL, background, foreground, legend
from .traces import row_words, traces

LINES = 46
"""Lines of text that would fill a picture's height."""


def finished(pixels: np.ndarray, state: State) -> bytes:
    """The scene's picture (h, w, 4) uint8 with words, as PNG."""
    from PIL import Image, ImageDraw

    out, drawn = io.BytesIO(), Image.fromarray(pixels).convert("RGBA")
    dark = state.view.dark
    picture = Image.new("RGBA", drawn.size, (*background(dark), 255))
    picture = Image.alpha_composite(picture, drawn).convert("RGB")
    _Words(ImageDraw.Draw(picture), picture.height / LINES, dark).write(state)
    picture.save(out, "PNG")
    return out.getvalue()


class _Words:
    """Lines of text from the top left corner down. size: px from line to line."""

    def __init__(self, draw: Any, size: float, dark: bool) -> None:
        self.draw, self.size, self.dark = draw, size, dark
        self.at = size

    def write(self, state: State) -> None:
        leading = [name for name, _, _ in traces(state)] == ["bundle"]
        self.line(state.block.name if leading or not state.image else f"{state.block.name} · {state.image}", 1.3)
        for name, rows, colour in traces(state):
            words, stop = row_words(name, rows[min(state.row, len(rows) - 1)])
            self.line(f"{words} · {stop}" if stop else words, mark=colour)
        self.at += 0.5 * self.size
        drawn = whole_scene(state)
        parts = {part for path in drawn for part in path.split("/")}
        if leading:  # drawn in the colour of its model
            parts.add(state.room(Bundle).asked[0])
        for name, colour in legend(self.dark).items():
            if name in parts or f"{name}s" in parts:
                shape = {"control": "circle", "check": "triangle"}.get(name, "line")
                self.line(MEANINGS[name], 0.9, {"control": CONTROL, "check": CHECK}.get(name, colour), shape)
        if parts & {"residuals", "ellipsoid", "ellipsoids"}:
            self.line(exaggerations(state), 0.9)

    def line(self, text: str, scale: float = 1.0, mark: tuple[int, int, int] | None = None, shape: str = "square") -> None:
        left, middle, font = self.size, self.at + 0.5 * scale * self.size, _font(max(round(0.72 * scale * self.size), 8))
        if mark is not None:
            self.mark(left, middle, 0.3 * self.size, mark, shape)
            left += 2.2 * self.size
        self.draw.text((left, middle), text, fill=foreground(self.dark), font=font, anchor="lm")
        self.at += scale * self.size

    def mark(self, left: float, middle: float, half: float, colour: tuple[int, int, int], shape: str) -> None:
        x, thick = left + 0.75 * self.size, max(round(self.size / 9), 1)
        if shape == "circle":
            self.draw.ellipse((x - half, middle - half, x + half, middle + half), outline=colour, width=thick)
        elif shape == "triangle":
            corners = [(x, middle - half), (x + half, middle + half), (x - half, middle + half)]
            self.draw.polygon(corners, outline=colour, width=thick)
        elif shape == "square":
            self.draw.rectangle((x - half, middle - half, x + half, middle + half), fill=colour)
        else:
            self.draw.line((left, middle, left + 1.5 * self.size, middle), fill=colour, width=2 * thick)


@lru_cache(maxsize=8)
def _font(size: int) -> Any:
    """A font with Greek letters: the one that comes with the plots of the reports; else the picture library's own."""
    from PIL import ImageFont

    home = find_spec("matplotlib")
    for folder in () if home is None else home.submodule_search_locations or ():
        file = Path(folder) / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"
        if file.is_file():
            return ImageFont.truetype(str(file), size)
    return ImageFont.load_default(size)
