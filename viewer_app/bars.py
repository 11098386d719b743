"""What gives the scene its measure, pure: north, the scale bar, and below it one bar for each thing that is drawn exaggerated.

All of it stands south of what is drawn, beside everything and under nothing, where the first view, which looks from the
south-east, has it below the site.
"""

from __future__ import annotations

import numpy as np

from solvers.mosaic import Registration

from . import theme
from .bundle_rows import inner_extent
from .bundle_state import Bundle
from .ground import drawn_ground, ground_level, nice, site
from .kept import by_identity
from .mosaic_place import to_scene
from .mosaic_state import Made, Mosaic
from .state import MODELS, State
from .values import Label, Scene, Segments

LINE = 1.3
"""From one bar to the next, in cells of the ground's grid."""


SLANT = 0.5
"""East of the site's middle, per metre south of it, stands what the first view shows below it."""


def corner(state: State) -> tuple[np.ndarray, float, float]:
    """Where (3,) bars begin on the southern edge of ground, mosaics and bundle, on the ground; the greatest extent of all that;
    and a cell of the ground's grid, both m."""
    west, east, cell = drawn_ground(state)
    low, high = west, east
    for made in state.room(Mosaic).made.values():
        ring = rectangle(state, made)[:, :2]
        low, high = np.minimum(low, ring.min(axis=0)), np.maximum(high, ring.max(axis=0))
    room = state.room(Bundle)
    if room.rows and room.layout is not None and len(room.layout.points):
        spread = inner_extent(room.layout, room.rows[-1 if room.result else 0])
        low, high = np.minimum(low, spread[0][:2]), np.maximum(high, spread[1][:2])
    x, y = np.mean(site(state), axis=0)[:2]
    x = np.clip(x + SLANT * (y - low[1]) - 2 * cell, west[0], east[0] - 2 * cell)
    return np.array([x, low[1], ground_level(state)]), float((high - low).max()), cell


def rectangle(state: State, made: Made) -> np.ndarray:
    """Corners (4, 3) m of the rectangle around all photos of a mosaic."""
    (x0, y0), (x1, y1) = _box(made.registration)
    xy = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    return to_scene(state, made, np.column_stack([xy, made.registration.heights(xy)]))


@by_identity(4)
def _box(r: Registration) -> np.ndarray:
    ring = np.concatenate([r.footprint(k) for k in range(len(r.names))] or [np.zeros((1, 2))])
    ring = ring[np.isfinite(ring).all(axis=1)]
    return np.array([ring.min(axis=0), ring.max(axis=0)]) if len(ring) else np.zeros((2, 2))


def bar(state: State, path: str, line: int, length: float, words: str) -> Scene:
    """A bar of a length [m] in a line, counted from the ground's own, which is 0, and its words."""
    at, _, cell = corner(state)
    begin = at - np.array([0, (0.5 + LINE * line) * cell, 0])
    end, tick = begin + np.array([length, 0, 0]), np.array([0, 0.15 * cell, 0])
    lines = np.array([[begin, end], [begin - tick, begin + tick], [end - tick, end + tick]])
    found: Scene = {path: Segments(lines, theme.foreground(state.view.dark), 2.0 if line else 2.5)}
    if state.view.labels or line:
        found[f"{path}_label"] = Label(words, end + np.array([0.15 * cell, 0, 0]), 0.9 if line else 1.0, "center-left")
    return found


def furniture(state: State, vectors: float | None) -> Scene:
    """North and the scale bar. vectors: exaggeration of the residuals drawn, None where only the ground is."""
    at, _, cell = corner(state)
    ink, head = theme.foreground(state.view.dark), 0.25 * cell
    tip = at + np.array([-0.7 * cell, -0.1 * cell, 0])
    foot = tip - np.array([0, 1.6 * cell, 0])
    aside, back = np.array([head, 0, 0]), np.array([0, 1.6 * head, 0])
    arrow = np.array([[foot, tip], [tip, tip - aside - back], [tip, tip + aside - back], [foot - aside, foot + aside]])
    found: Scene = {"/ground/north": Segments(arrow, ink, 2.5)}
    if state.view.labels:
        found["/ground/north_label"] = Label("N", foot - np.array([0, 0.5 * cell, 0]), 1.3, "center-center")
    return found | bar(state, "/ground/scale", 0, cell, scales(state, cell, vectors))


def scales(state: State, cell: float, vectors: float | None) -> str:
    """The scale bar in words, with every exaggeration that is drawn on a line of its own."""
    return "\n".join([f"{cell:g} m", *([] if vectors is None else drawn_larger(state, vectors))])


def drawn_larger(state: State, vectors: float) -> list[str]:
    """What the solutions of single images draw exaggerated, vectors: by how much the residuals."""
    view, words = state.view, []
    if view.residuals and any((s := state.solution(m)) and s.rows for m in MODELS):
        words.append(f"residuals × {vectors:g}")
    if view.ellipsoids and view.ellipsoid > 0:
        words.append(f"95 % ellipsoids × {view.ellipsoid:g}")
    return words


def fitting(span: float, factor: float) -> float:
    """A round length [m] whose bar, exaggerated by a factor, is no longer than a sixth of an extent [m]."""
    return nice(max(span / 6 / factor, 1e-9))


def said(metres: float) -> str:
    """A length in words, in the unit that suits it."""
    return f"{metres:g} m" if metres >= 1 else f"{100 * metres:g} cm" if metres >= 0.01 else f"{1000 * metres:g} mm"
