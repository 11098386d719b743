"""One page, to be opened from disk, that plays every row of the adjustment: viser's player, and around it a title, what each row
says, the legend, and keys. Nothing is fetched from anywhere."""

from __future__ import annotations

import html
import json

import numpy as np

from .actions import GoTo, update
from .bridge import dress_labels, open_server
from .home import home, home_alone
from .paint_viser import Painter
from .panels.legend import legend_html
from .panels.widgets import css, esc
from .state import State
from .tabs import whole_scene
from .theme import background, foreground
from .traces import row_words, traces

SECONDS = 0.5
"""How long each row is shown."""
MOST_ROWS = 200
FOV = np.radians(45)
PAGE = (1280, 680, 330)
"""Width and height of the scene that the first view is made for, and of its part under the words, pixels."""

STYLE = """<style>
#collinea{position:fixed;left:10px;top:10px;width:300px;max-height:calc(100vh - 80px);overflow:auto;z-index:5;border-radius:6px;
 font:12px/1.45 system-ui,sans-serif;color:FORE;background:BACK;padding:8px 0;box-shadow:0 1px 6px rgba(0,0,0,.25)}
#collinea h1{font-size:15px;margin:0 12px 2px}#collinea p{margin:0 12px 6px}#collinea summary{margin:4px 12px;cursor:pointer}
#collinea button{font:inherit;color:inherit;background:none;border:1px solid currentColor;border-radius:4px;min-width:34px;
 padding:2px 8px;margin:0 4px 0 0;cursor:pointer}#collinea .swatch{display:inline-block;width:.7em;height:.7em;margin-right:.35em}
</style>"""

SCRIPT = """<script>(() => {
const rows = ROWS, seconds = SECONDS, last = rows.length - 1;
const time = () => parseFloat(document.querySelector('[role=slider]')?.getAttribute('aria-valuenow'));
const row = () => Math.min(Math.max(Math.floor((time() || 0) / seconds + 1e-3), 0), last);
const box = () => document.querySelector('#root input:not([type=hidden])');
const go = k => {
  const input = box();
  if (!input) return;
  const text = (Math.min(Math.max(k, 0), last) * seconds).toFixed(1);
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(input, text);
  input.dispatchEvent(new Event('input', {bubbles: true}));
  requestAnimationFrame(() => input.blur());  // it takes the focus, and with it the next key
};
const moves = {ArrowLeft: () => row() - 1, ArrowRight: () => row() + 1, Home: () => 0, End: () => last};
window.collineaReplay = {row, go};
window.addEventListener('keydown', event => {
  const move = moves[event.key];
  if (!move || event.ctrlKey || event.altKey || event.metaKey || /^(INPUT|TEXTAREA)$/.test(event.target.tagName)) return;
  event.preventDefault();
  event.stopImmediatePropagation();
  go(move());
}, true);
let shown = -1;
setInterval(() => {
  const now = row(), place = document.getElementById('collinea-row');
  if (now !== shown && place && box()) place.innerHTML = rows[shown = now];
}, 40);
document.addEventListener('click', event => {
  const key = event.target.closest?.('#collinea button')?.dataset.key;
  if (key) { go(moves[key]()); event.target.blur(); }
});
})();</script>"""


def replay_html(state: State) -> str:
    """The page, with every row of the chosen image's traces or of the bundle that is drawn in their place."""
    server = open_server()
    try:
        server.scene.set_up_direction("+z")
        server.scene.world_axes.visible = False
        dress_labels(server)
        camera = server.initial_camera
        width, height, left = PAGE
        (camera.position, camera.look_at), camera.far = home_alone(state, width, height, FOV, left), home(state)[2]
        camera.near, camera.fov = camera.far / 20000, FOV
        painter = Painter(server)
        count = min(state.last_row, MOST_ROWS - 1) + 1
        painter.paint(whole_scene(update(state, GoTo(0))))
        recorder = server.get_scene_serializer()
        for row in range(count):
            painter.paint(whole_scene(update(state, GoTo(row))))
            if count > 1:
                recorder.insert_sleep(SECONDS if row != count - 1 else 3 * SECONDS)
        return with_words(recorder.as_html(dark_mode=state.view.dark), state, count)
    finally:
        server.stop()


def with_words(page: str, state: State, count: int) -> str:
    """viser's page with the title, the words of its rows, the legend and the keys."""
    dark, title = state.view.dark, f"{state.block.name} · {state.image}" if state.image else state.block.name
    style = STYLE.replace("FORE", css(foreground(dark))).replace("BACK", css(background(dark)) + "e6")
    rows = json.dumps([_row(state, k) for k in range(count)]).replace("<", "\\u003c")
    script = SCRIPT.replace("SECONDS", f"{SECONDS:g}", 1).replace("ROWS", rows, 1)  # rows last: they may say anything
    keys = (("Home", "|◀", "First row (Home)"), ("ArrowLeft", "◀", "Previous row (left arrow)"),
            ("ArrowRight", "▶", "Next row (right arrow)"), ("End", "▶|", "Last row (End)"))  # fmt: skip
    buttons = "".join(f'<button data-key="{k}" title="{t}" aria-label="{t}">{sign}</button>' for k, sign, t in keys)
    words = (
        f'<div id="collinea"><h1>{esc(title)}</h1><div id="collinea-row"></div><p>{buttons}</p>'
        "<p>Keys: left, right, Home, End; space plays and pauses.</p>"
        f"<details open><summary>Legend</summary>{legend_html(state)}</details></div>"
    )
    page = page.replace("<title>Viser<", f"<title>{html.escape(title)} – Collinea<", 1)
    head, body = page.index("</head>"), page.rindex("</body>")
    return f"{page[:head]}{style}{page[head:body]}{words}{script}{page[body:]}"


def _row(state: State, k: int) -> str:
    """What the traces say at a place of the transport, HTML."""
    lines = []
    for name, rows, colour in traces(state):
        words, stop = row_words(name, rows[min(k, len(rows) - 1)])
        end = f" · {stop}" if stop else ""
        lines.append(f'<p><span class="swatch" style="background:{css(colour)}"></span>{esc(words + end)}</p>')
    return "".join(lines) or "<p>Nothing has been adjusted yet: the scene stands still.</p>"
