"""Two photos beside each other as HTML: zoom with the wheel, pan by dragging, click to match; only what is shown is sent."""

from __future__ import annotations

import numpy as np

from solvers import Block

from .. import theme
from ..bridge import Wire
from ..kept import by_identity
from ..matching_actions import whole
from ..matching_scene import tie_colours
from ..matching_state import ASPECT, SIDES, Found, Look, Matching
from ..pyramid import Piece, Pyramid
from ..state import State
from ..theme import Colour
from .widgets import BOX, MUTED, Html, css, esc, jpeg

ACROSS = 640
"""Pixels of a pane that its picture is made for."""
AROUND = 0.25
"""What is sent beyond the pane's edges, in pane widths: dragging shows it before more comes."""
MOST = 500
"""Tie points drawn in one pane at most, evenly chosen."""


class Panes:
    """Both photos: their pictures are sent when what is looked at changes, what is drawn over them when anything else does."""

    def __init__(self, wire: Wire, gui: object, pyramid: Pyramid) -> None:
        self._wire, self._pyramid = wire, pyramid
        self._pictures = {side: Html(gui) for side in SIDES}  # type: ignore[arg-type]
        self._overlay = Html(gui)  # type: ignore[arg-type]

    def draw(self, state: State, m: Matching) -> None:
        panes = []
        for side in SIDES:
            image = m.image(side)
            if not image:
                self._pictures[side].set("")
                continue
            look = m.looks.get(side, whole(state, image))
            piece = self._piece(state, image, look)
            style = "" if piece is None else f"<style>:root{{--collinea-{side}:url({_encoded(piece)})}}</style>"
            self._pictures[side].set(style)
            panes.append(pane_html(state, m, side, look, piece, self._wire))
        self._overlay.set(
            f'<div {BOX}><div style="display:flex;gap:6px">{"".join(panes)}</div></div>'
            if panes
            else f"<div {BOX}>Matching needs a project with two photos or more.</div>"
        )

    def _piece(self, state: State, image: str, look: Look) -> Piece | None:
        photo, camera = state.assets.photos.get(image), state.block.camera_of(image)
        if photo is None:
            return None
        x, y, w, h = view_box(look, AROUND)
        box = (x / camera.width, y / camera.height, (x + w) / camera.width, (y + h) / camera.height)
        return self._pyramid.look(photo, box, round(ACROSS * (1 + 2 * AROUND)))


def view_box(look: Look, around: float = 0.0) -> tuple[float, float, float, float]:
    """Left, top, width, height of what is shown, from the outer corner of the photo's top-left pixel."""
    w, h = look.across * (1 + 2 * around), look.across * (ASPECT + 2 * around)
    return look.col + 0.5 - w / 2, look.row + 0.5 - h / 2, w, h


_last: dict[int, tuple[Piece, str]] = {}


def _encoded(piece: Piece) -> str:
    """The piece as an address, not larger than a pane can show."""
    key = hash((piece.box, piece.pixels.shape, piece.pixels[:: max(1, piece.pixels.shape[0] // 16)].tobytes()))
    if key not in _last:
        step = max(1, piece.pixels.shape[1] // 1400)
        if len(_last) > 8:
            _last.pop(next(iter(_last)))
        _last[key] = piece, jpeg(np.ascontiguousarray(piece.pixels[::step, ::step]), 85)
    return _last[key][1]


def pane_html(state: State, m: Matching, side: str, look: Look, piece: Piece | None, wire: Wire) -> str:
    """One photo: an SVG in pixels of the full photo, (0, 0) at the outer corner of the top-left pixel."""
    image = m.image(side)
    camera = state.block.camera_of(image)
    shown = " ".join(f"{v:.3f}" for v in view_box(look))
    unit = look.across / 400
    picture = f'<rect x="0" y="0" width="{camera.width}" height="{camera.height}" fill="#888" fill-opacity=".25"/>'
    if piece is not None:
        x0, y0, x1, y1 = (v * n for v, n in zip(piece.box, (camera.width, camera.height) * 2, strict=True))
        sharp = "pixelated" if look.across < 1.2 * ACROSS / 4 else "auto"
        # an SVG image cannot take its picture from a style; a block within it can
        picture += (
            f'<foreignObject x="{x0}" y="{y0}" width="{x1 - x0}" height="{y1 - y0}"><div style="width:100%;height:100%;'
            f'background:var(--collinea-{side}) 0 0/100% 100%;image-rendering:{sharp}"></div></foreignObject>'
        )
    shapes = points_svg(state, m, image, look) + (
        left_svg(m, unit, file_factor(state, image)) if side == "left" else right_svg(m, unit)
    )
    buttons = " ".join(
        f'<button type="button" {wire.attributes("pair", f"{side}|zoom|{f:g}", hint)}>{label}</button>'
        for label, f, hint in (
            ("+", 0.5, f"nearer to {image}"),
            ("−", 2.0, f"farther from {image}"),
            ("▢", 0.0, f"all of {image}"),
        )
    )
    handlers = (
        'onwheel="collineaPair.wheel(event)" onpointerdown="collineaPair.down(event)" onkeydown="collineaPair.key(event)"'
        if wire.works
        else ""
    )
    return (
        f'<div style="flex:1 1 0;min-width:0"><div style="display:flex;justify-content:space-between;align-items:baseline">'
        f'<b style="overflow:hidden;text-overflow:ellipsis;white-space:nowrap" title="{esc(image)}">{esc(image)}</b>'
        f'<span style="white-space:nowrap">{buttons}</span></div>'
        f'<svg id="collinea-{side}" role="img" aria-label="{side} photo {esc(image)}" tabindex="0" data-side="{side}" '
        f'data-focus="pair/{side}" data-w="{camera.width}" data-h="{camera.height}" data-box="{esc(image)} {shown}" '
        f'viewBox="{shown}" {handlers} '
        f'style="display:block;width:100%;aspect-ratio:1/{ASPECT};background:rgba(128,128,128,.18);cursor:crosshair;'
        f'touch-action:none;user-select:none">{picture}<g pointer-events="none">{shapes}</g></svg></div>'
    )


def points_svg(state: State, m: Matching, image: str, look: Look) -> str:
    """The points measured in a photo, as far as they are in view: ties by rays or residual, others in their colours."""
    block, colours = state.block, tie_colours(state)
    rows, unit = in_view(block, image, *view_box(look)), look.across / 400
    shapes = []
    for r in rows:
        j = int(block.observations.point[r])
        name, (col, row), role = block.points.names[j], block.observations.pixel[r], block.points.role[j]
        colour = theme.CONTROL if role == "control" else theme.CHECK if role == "check" else colours.get(j)
        if colour is None:
            continue
        chosen = name == m.point
        radius = (7 if chosen else 3.2 if role == "tie" else 4.5) * unit
        shapes.append(ring(col, row, radius, colour, unit * (2.2 if chosen else 1.5), name))
    return "".join(shapes)


def ring(col: float, row: float, radius: float, colour: Colour, width: float, name: str = "") -> str:
    title = f"<title>{esc(name)}</title>" if name else ""
    at = f'cx="{col + 0.5:.2f}" cy="{row + 0.5:.2f}" r="{radius:.2f}" fill="none"'
    return (
        f'<circle {at} stroke="#000" stroke-opacity=".6" stroke-width="{2.2 * width:.2f}"/>'
        f'<circle data-point="{esc(name)}" {at} stroke="{css(colour)}" stroke-width="{width:.2f}">{title}</circle>'
    )


@by_identity(8)
def in_view(block: Block, image: str, x: float, y: float, w: float, h: float) -> tuple[int, ...]:
    """Rows of the observations of a photo within a box; of very many tie points some, evenly chosen."""
    of = block.observations
    rows = np.flatnonzero(of.image == block.image_index(image))
    place = of.pixel[rows] + 0.5
    seen = rows[(place >= [x, y]).all(axis=1) & (place <= [x + w, y + h]).all(axis=1)]
    if len(seen) > MOST:
        role = np.array([block.points.role[j] == "tie" for j in of.point[seen]], bool)
        ties = seen[role]
        seen = np.concatenate([seen[~role], ties[np.linspace(0, len(ties) - 1, min(MOST, len(ties))).astype(int)]])
    return tuple(int(r) for r in seen)


def left_svg(m: Matching, unit: float, factor: float) -> str:
    """The template: its window with a cross in the middle. factor: full pixels per pixel of the file."""
    return "" if m.at is None else box(*m.at, m.window * factor, unit, "#ff0") + cross(*m.at, 5 * unit, unit, "#ff0")


def file_factor(state: State, image: str) -> float:
    """Pixels of the camera's format per pixel of the photo's file."""
    photo = state.assets.photos.get(image)
    return 1.0 if photo is None else state.block.camera_of(image).width / photo.size[0]


def right_svg(m: Matching, unit: float) -> str:
    """Where it was looked for (dashed), where the correlation had its peak, and the window as least squares matching left it."""
    now = m.current
    if now is None or now.guess is None:
        return "" if m.start is None else cross(*m.start, 6 * unit, unit, "#0ff")
    c, r = now.guess.place
    shapes = cross(c, r, 4 * unit, unit, "#0ff")
    if now.stepped is not None:
        reach = (now.stepped.surface.shape[0] - 1) * now.factor
        shapes += (
            f'<rect x="{c + 0.5 - reach[0] / 2:.2f}" y="{r + 0.5 - reach[1] / 2:.2f}" width="{reach[0]:.2f}" '
            f'height="{reach[1]:.2f}" fill="none" stroke="#0ff" stroke-width="{unit:.2f}" stroke-dasharray="{4 * unit:.2f}"/>'
        )
        shapes += warped_svg(now, m.row, unit)
    return shapes


def warped_svg(found: Found, row: int, unit: float) -> str:
    """The template's window as it lies in the second photo at an iteration."""
    stepped = found.stepped
    if stepped is None or stepped.problem is None or not stepped.rows:
        return ""
    x = stepped.rows[min(row, len(stepped.rows) - 1)].x
    half = stepped.problem.template.shape[0] / 2
    corners = np.array([(-half, -half), (half, -half), (half, half), (-half, half)]) - stepped.problem.rest
    place = found.full(x[[0, 3]] + corners @ np.array([[x[1], x[4]], [x[2], x[5]]])) + 0.5
    path = "M" + "L".join(f"{c:.2f} {r:.2f}" for c, r in place) + "Z"
    colour = "#ff0" if found.ok else css(theme.RESIDUAL)
    lines = "".join(
        f'<path d="{path}" fill="none" stroke="{c}" stroke-width="{w * unit:.2f}"/>' for c, w in (("#000", 2.6), (colour, 1.2))
    )
    middle = found.full(x[[0, 3]])
    return lines + cross(float(middle[0]), float(middle[1]), 5 * unit, unit, colour)


def box(col: float, row: float, side: float, unit: float, colour: str) -> str:
    place = f'x="{col + 0.5 - side / 2:.2f}" y="{row + 0.5 - side / 2:.2f}" width="{side}" height="{side}" fill="none"'
    return "".join(f'<rect {place} stroke="{c}" stroke-width="{w * unit:.2f}"/>' for c, w in (("#000", 2.6), (colour, 1.2)))


def cross(col: float, row: float, arm: float, unit: float, colour: str) -> str:
    x, y = col + 0.5, row + 0.5
    line = f'd="M{x - arm:.2f} {y:.2f}h{2 * arm:.2f}M{x:.2f} {y - arm:.2f}v{2 * arm:.2f}"'
    return "".join(f'<path {line} stroke="{c}" stroke-width="{w * unit:.2f}"/>' for c, w in (("#000", 2.2), (colour, 1.0)))


SCRIPT = """
window.collineaPair = (() => {
  const tell = text => collinea.press({stopPropagation() {}, currentTarget: {dataset: {kind: 'pair', value: text}}});
  const timers = {}, looks = {};  // looks: by pane, what it was drawn with and what is looked at here, until the answer comes
  const show = (e, b) => {
    e.setAttribute('viewBox', b.join(' '));
    looks[e.id] = [e.dataset.box, b.join(' ')];
  };
  new MutationObserver(records => {
    if (!records.some(r => r.addedNodes.length)) return;
    for (const [id, look] of Object.entries(looks)) {
      const e = document.getElementById(id);
      if (!e) continue;
      if (e.dataset.box !== look[0] && !timers[e.dataset.side]) { delete looks[id]; continue; }
      look[0] = e.dataset.box;
      if (e.getAttribute('viewBox') !== look[1]) e.setAttribute('viewBox', look[1]);
    }
  }).observe(document.body, {childList: true, subtree: true});
  const get = e => { const b = e.viewBox.baseVal; return [b.x, b.y, b.width, b.height]; };
  const told = (e, wait) => {
    const side = e.dataset.side;
    clearTimeout(timers[side]);
    timers[side] = setTimeout(() => {
      timers[side] = 0;
      const [x, y, w, h] = get(e);
      tell([side, 'look', x + w / 2 - 0.5, y + h / 2 - 0.5, w].join('|'));
    }, wait);
  };
  const place = (ev, e, b) => {
    const r = e.getBoundingClientRect();
    return [b[0] + (ev.clientX - r.left) / r.width * b[2], b[1] + (ev.clientY - r.top) / r.height * b[3]];
  };
  const zoom = (e, f, at) => {
    const b = get(e), most = 1.5 * Math.max(e.dataset.w, e.dataset.h);
    const w = Math.min(Math.max(b[2] * f, 42), most), g = w / b[2];
    show(e, [at[0] - (at[0] - b[0]) * g, at[1] - (at[1] - b[1]) * g, w, b[3] * g]);
  };
  const wheel = ev => {
    ev.preventDefault();
    const e = ev.currentTarget;
    zoom(e, Math.exp(ev.deltaY * (ev.deltaMode ? 0.05 : 0.0016)), place(ev, e, get(e)));
    told(e, 120);
  };
  const down = ev => {
    if (ev.button !== 0) return;
    ev.preventDefault();
    const e = ev.currentTarget, id = e.id, b = get(e), r = e.getBoundingClientRect();
    e.focus();
    let moved = false;
    const move = to => {
      if (!moved && Math.hypot(to.clientX - ev.clientX, to.clientY - ev.clientY) < 4) return;
      moved = true;
      const now = document.getElementById(id);
      if (now) show(now, [b[0] - (to.clientX - ev.clientX) / r.width * b[2], b[1] - (to.clientY - ev.clientY) / r.height * b[3],
                          b[2], b[3]]);
    };
    const up = to => {
      removeEventListener('pointermove', move, true);
      removeEventListener('pointerup', up, true);
      removeEventListener('pointercancel', up, true);
      const now = document.getElementById(id);
      if (!now || to.type !== 'pointerup') return;
      if (moved) return told(now, 0);
      const at = place(to, now, get(now));
      tell([now.dataset.side, 'click', at[0] - 0.5, at[1] - 0.5].join('|'));
    };
    addEventListener('pointermove', move, true);
    addEventListener('pointerup', up, true);
    addEventListener('pointercancel', up, true);
  };
  const key = ev => {
    const e = ev.currentTarget, b = get(e), step = 0.15, middle = [b[0] + b[2] / 2, b[1] + b[3] / 2];
    const ways = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
    if (ways[ev.key]) show(e, [b[0] + ways[ev.key][0] * step * b[2], b[1] + ways[ev.key][1] * step * b[3], b[2], b[3]]);
    else if (ev.key === '+' || ev.key === '=') zoom(e, 1 / 1.4, middle);
    else if (ev.key === '-') zoom(e, 1.4, middle);
    else if (ev.key === 'Enter') tell([e.dataset.side, 'click', middle[0] - 0.5, middle[1] - 0.5].join('|'));
    else return;
    ev.preventDefault();
    ev.stopPropagation();
    if (ev.key !== 'Enter') told(e, 150);
  };
  return {wheel, down, key};
})();
"""
__all__ = ["MUTED", "SCRIPT", "Panes", "pane_html", "view_box"]
