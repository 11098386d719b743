"""What the panels share: controls that draw a state and emit actions, and HTML that is sent only when it changed."""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from solvers.legend import css

from ..actions import Action
from ..bridge import given
from ..theme import Colour

Emit = Callable[[Action], None]


def bind(handle: Any, emit: Emit, action: Callable[[Any], Action | None]) -> None:
    """A person's change of a control becomes an action; changes made by `put` do not."""

    @handle.on_update
    async def _(event: Any) -> None:
        if event.client_id is not None and (made := action(handle.value)) is not None:
            emit(made)


def put(handle: Any, value: Any) -> None:
    """Show a value in a control without a word on the wire where it is shown already, nor over one that was just given."""
    if handle.value != value and not given(handle):
        handle.value = value


def prop(handle: Any, name: str, value: Any) -> None:
    """Set a property of a control where it differs."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


class Html:
    """A piece of HTML, sent when it changed."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._handle = gui.add_html("")

    def set(self, content: str) -> None:
        prop(self._handle, "content", content)


def esc(text: Any) -> str:
    return html.escape(str(text))


def swatch(colour: Colour) -> str:
    return (
        f'<span style="display:inline-block;width:.7em;height:.7em;border-radius:2px;background:{css(colour)};'
        'margin-right:.35em"></span>'
    )


QUIET = (84, 92, 100)
"""Colour of a button that is not what one mostly comes to its tab for; that one, and what takes over a result that waits, have
the page's own. Steps that belong together are a group, outlined."""
BOX = 'style="padding:2px 12px 8px;font-size:12px;line-height:1.45"'
MORE = "More columns to the right: scroll, or widen the panel (key T)."
"""Stands below a table as long as that is wider than its panel."""
RIM = (
    "background:linear-gradient(to left,var(--mantine-color-body) 40%,transparent) right/28px 100% no-repeat local,"
    "linear-gradient(to left,rgba(128,128,128,.6),transparent) right/10px 100% no-repeat scroll;"
)
"""A shadow along the right edge of what can be scrolled farther that way."""
MUTED = 'style="color:color-mix(in srgb,currentColor 65%,transparent)"'


def table(head: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]], caption: str, height: int | None = None,
          size: int = 11) -> str:
    """An HTML table; each row is (attributes of its <tr>, cells), the first cell is the row's heading. Cells are HTML already."""
    cell = "padding:1px 3px;white-space:nowrap;text-align:"
    first = "".join(
        f'<th scope="col" style="{cell}{"left" if i == 0 else "right"};font-weight:600;position:sticky;top:0;'
        f'background:var(--mantine-color-body)">{h}</th>'
        for i, h in enumerate(head)
    )
    body = "".join(
        f"<tr {attributes}>"
        + "".join(f'<td style="{cell}{"left" if i == 0 else "right"}">{c}</td>' for i, c in enumerate(cells))
        + "</tr>"
        for attributes, cells in rows
    )
    limit = f"max-height:{height}px;overflow:auto;" if height else "overflow-x:auto;"
    return (
        f'<div data-wide style="{limit}{RIM}"><table aria-label="{esc(caption)}" '
        f'style="border-collapse:collapse;width:100%;font-size:{size}px;'
        f'font-variant-numeric:tabular-nums"><thead><tr>{first}</tr></thead><tbody>{body}</tbody></table></div>{more()}'
    )


def more() -> str:
    """The line below a table that says that it is wider than its panel; the page shows it where that is so."""
    return f"<div data-more hidden {MUTED}>{MORE}</div>"


def decimals(sigma: float | None, most: int = 6) -> int:
    """Decimal places that show a standard error with two digits."""
    if sigma is None or not np.isfinite(sigma) or sigma <= 0:
        return 3
    return int(np.clip(1 - np.floor(np.log10(sigma)), 0, most))


def jpeg(pixels: np.ndarray, quality: int = 82) -> str:
    """A data: address of a picture (h, w, 3) uint8."""
    import base64
    import io

    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "JPEG", quality=quality)
    return "data:image/jpeg;base64," + base64.b64encode(out.getvalue()).decode()


def png(pixels: np.ndarray) -> str:
    """A data: address of a small picture (h, w, 3) uint8, every pixel as it is."""
    import base64
    import io

    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG", compress_level=4)
    return "data:image/png;base64," + base64.b64encode(out.getvalue()).decode()
