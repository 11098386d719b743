"""The Photo tab: observed and projected points with exaggerated residuals; measure a point, plot one, frame a subset."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import viser

from ..actions import Action, Aim, Clicking, ForgetSpots, Place, Plot, Show, Unmark, UseBox
from ..bridge import Wire
from ..desktop import PHOTOS, Desktop, SizePhoto
from ..loading import crop
from ..next_point import NextPoint, expected
from ..photo_view import (
    Cut,
    DrawnPhoto,
    PanPhoto,
    PhotoView,
    ShowWhole,
    ZoomPhoto,
    ZoomToMark,
    cut,
    percent,
    picture,
    pyramid,
    tasks,
    window,
)
from ..scene import Sight, photo_scale, shown_on_photo
from ..spots import plotted
from ..state import Photo, State, Work
from ..tabs import Command, Desk, Tab
from ..theme import CHECK, CONTROL, INITIAL, RESIDUAL
from ..widths import picture_height
from .pair import in_view
from .widgets import BOX, MUTED, QUIET, Html, bind, css, decimals, esc, jpeg, prop, put, swatch, table

CLICKS = {"measures the point": "measure", "gives ground coordinates": "monoplot"}
ZOOMS = ("+", "−", "whole", "800 %")
NEXT = "choose the next point that is not measured in this photo. Key: N"
LARGEST = 4_500_000
"""Characters of a picture that is sent, at most: a page is never sent 5 MB at once."""
HALF = 24
"""Half side of the magnifier, pixels of the file."""


class PhotoPanel:
    """Draws the chosen photo; clicks on it and in the magnifier come back through the wire."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._wire = desk.wire
        self._click = gui.add_dropdown(
            "A click",
            tuple(CLICKS),
            hint="Measure the chosen point, or give ground coordinates on the DEM (without one, on a plane at the mean height of "
            "the GCPs). A dragged rectangle always uses only the control points within it.",
        )
        bind(self._click, emit, lambda value: Clicking(CLICKS.get(value, "")))
        buttons = gui.add_button_group(
            "Zoom",
            ZOOMS,
            hint="Closer, farther, the whole photo, or 800 % around the mark or the chosen point. Keys: Z, Shift+Z, 0, 8.",
        )
        zooms = dict(zip(ZOOMS, (ZoomPhoto(2.0), ZoomPhoto(0.5), ShowWhole(), ZoomToMark()), strict=True))

        @buttons.on_click
        async def _(event: viser.GuiEvent) -> None:
            if buttons.value in zooms:
                emit(zooms[buttons.value])

        self._size = gui.add_dropdown(
            "Photo size", PHOTOS, hint="How much of the page the photo takes; the panel's edge can be dragged as well. Key: V."
        )
        bind(self._size, emit, SizePhoto)
        self._picture = Html(gui)  # the picture itself, sent once per photo
        self._overlay = Html(gui)
        self._vectors = gui.add_slider(
            "Photo vectors ×", 1.0, 1000.0, 1.0, 50.0, hint="Exaggeration of the residual vectors on the photo."
        )
        bind(self._vectors, emit, lambda value: Show("photo_vectors", float(value)))
        self._place = gui.add_button(
            "Place mark", hint="The mark becomes the observation of its point; everything is solved again. Key: M."
        )
        self._place.on_click(lambda _: emit(Place()))
        self._unmark = gui.add_button("Drop mark", hint="Forget the mark.", color=QUIET)
        self._unmark.on_click(lambda _: emit(Unmark()))
        self._spots = Html(gui)
        self._forget = gui.add_button("Forget places", hint="Forget the places plotted on the ground.", color=QUIET)
        self._forget.on_click(lambda _: emit(ForgetSpots()))

    def draw(self, state: State) -> None:
        photo = state.assets.photos.get(state.image)
        put(self._vectors, state.view.photo_vectors)
        prop(self._vectors, "max", max(1000.0, state.view.photo_vectors))
        part = None if photo is None else cut(state, photo)
        coded = "" if photo is None else _encoded(photo) if part is None else _coded(part)
        self._picture.set("" if photo is None else f"<style>:root{{--collinea-photo:url({coded})}}</style>")
        self._overlay.set(photo_html(state, self._wire))
        put(self._size, state.room(Desktop).photo)
        for button in (self._place, self._unmark):  # always there: the photo must not move under the pointer that just marked it
            prop(button, "disabled", state.mark is None)
        put(self._click, next(words for words, what in CLICKS.items() if what == state.click))
        self._spots.set(spots_html(state))
        prop(self._forget, "visible", bool(state.spots))


@lru_cache(maxsize=24)
def _coded(part: Cut) -> str:
    """As good as its size allows."""
    pixels = picture(*part)
    for quality in (88, 70, 50):
        if len(coded := jpeg(pixels, quality)) <= LARGEST:
            return coded
    return jpeg(np.ascontiguousarray(pixels[::2, ::2]), 70)


@lru_cache(maxsize=4)
def _encoded(photo: Photo) -> str:
    return jpeg(photo.pane)


def photo_html(state: State, wire: Wire) -> str:
    """The photo pane: an SVG in pixels of the full photo over the picture, (0, 0) at the outer corner of the top-left pixel."""
    if not state.block.images:
        return f"<div {BOX}>This project has no images yet.</div>"
    camera, has = state.block.camera_of(state.image), state.image in state.assets.photos
    seen = shown_on_photo(state)
    shown = window(state)
    unit = shown.width / state.room(PhotoView).pane
    scale, wish = photo_scale(state), state.view.photo_vectors
    shapes = _observations(state.work, state.image, state.point, unit, (shown.left, shown.top, shown.width, shown.height))
    shapes += "" if seen is None else _residuals(seen, scale, unit)
    if state.mark is not None:
        x, y, r = state.mark.col + 0.5, state.mark.row + 0.5, 9 * unit
        shapes += (
            f'<path d="M{x - r} {y}h{2 * r}M{x} {y - r}v{2 * r}" stroke="#fff" stroke-width="{2.4 * unit}"/>'
            f'<path d="M{x - r} {y}h{2 * r}M{x} {y - r}v{2 * r}" stroke="#000" stroke-width="{unit}"/>'
        )
    shapes += _places(state, unit) + _expected(state, unit)
    background = "background:var(--collinea-photo) 0 0/100% 100%" if has else "background:rgba(128,128,128,.2)"
    size = state.room(Desktop).photo
    shape = f"width:min(100%,calc({picture_height(size)}*{camera.width / camera.height:.4f}))"
    grain = "image-rendering:pixelated;" if percent(state) >= 150 else ""
    surface = wire.surface("photo").replace(
        'style="cursor:crosshair"', f'style="cursor:crosshair;display:block;overflow:hidden;width:100%;{grain}{background}"'
    )
    following = f"<span {wire.attributes('next-point', '', NEXT)}>next point ▸</span>"
    target = f"click to mark <b>{esc(state.point)}</b>" if state.point else "choose a point (tab Points), then click it"
    target += f" · {following}"
    photo = state.assets.photos.get(state.image)
    magnifier = "" if photo is None or state.mark is None else magnifier_html(state, photo, wire)
    if not len(state.block.points):
        target = "no points yet: tie points come from the tab Matching"
    if state.click == "monoplot":
        target = "click for ground coordinates"
    less = "" if scale == wish else f", × {wish:g} would be too long for the photo"
    drawn = "" if seen is None else f"circle: observed · {swatch(RESIDUAL)}residual × {scale:g}{less} · "
    why = "No photo" if state.block.images[state.block.image_index(state.image)].file is None else "The photo is not read yet"
    missing = "" if has else f"<div {MUTED}>{why}: measurements only.</div>"
    return (
        f"<div {BOX}><div>{esc(state.image)} <span {MUTED}>{camera.width} × {camera.height} px ·</span> {target}</div>{missing}"
        f'<div style="position:relative;overflow:hidden;{shape}"><svg id="collinea-photo" role="img" '
        f'aria-label="Photo {esc(state.image)}" '
        f'viewBox="{shown.left:.6f} {shown.top:.6f} {shown.width:.6f} {shown.height:.6f}" '
        f"{surface}>{shapes}</svg>{'' if size == 'small' else magnifier}</div>{magnifier if size == 'small' else ''}"
        f"<div {MUTED}><span data-percent>{percent(state):.0f} %</span> · "
        f"{drawn}"
        f"wheel zooms, Shift+drag moves, drag uses only the GCPs within</div></div>"
    )


def _expected(state: State, unit: float) -> str:
    """A dashed ring where the chosen point should be seen, while it is not measured."""
    if (at := expected(state)) is None or state.click != "measure":
        return ""
    colour = css(CONTROL if state.block.points.role[state.block.point_index(state.point or "")] == "control" else CHECK)
    ring = f'cx="{at[0] + 0.5:.2f}" cy="{at[1] + 0.5:.2f}" r="{12 * unit:.2f}" fill="none"'
    return (
        f'<circle {ring} stroke="#000" stroke-opacity=".6" stroke-width="{3.4 * unit:.2f}"/>'
        f'<circle data-expected="{esc(state.point)}" {ring} stroke="{colour}" stroke-width="{1.8 * unit:.2f}" '
        f'stroke-dasharray="{5 * unit:.2f} {3 * unit:.2f}"><title>{esc(state.point)} should be here</title></circle>'
    )


def _places(state: State, unit: float) -> str:
    """Crosses with their numbers where ground coordinates were asked for."""
    shapes, r = [], 6 * unit
    for number, spot in enumerate(state.spots, 1):
        if spot.image == state.image:
            x, y = spot.col + 0.5, spot.row + 0.5
            line, text = f'd="M{x - r} {y}h{2 * r}M{x} {y - r}v{2 * r}"', f'x="{x + r}" y="{y - r / 2}" font-size="{13 * unit}"'
            shapes.append(
                f'<path {line} stroke="#fff" stroke-width="{3 * unit}"/><path {line} stroke="#000" stroke-width="{1.2 * unit}"/>'
                f'<text {text} stroke="#fff" stroke-width="{3 * unit}" paint-order="stroke" fill="#000">{number}</text>'
            )
    return "".join(shapes)


@lru_cache(maxsize=8)
def _observations(work: Work, image: str, point: str | None, unit: float, box: tuple[float, float, float, float]) -> str:
    """Control and check points in their colours, tie points smaller and grey, of very many some, as far as they are in view."""
    block, shapes = work.block, []
    for r in in_view(block, image, *box):
        j = block.observations.point[r]
        name, (col, row), role = block.points.names[j], block.observations.pixel[r], block.points.role[j]
        colour = css(INITIAL if name in work.off or role == "tie" else CONTROL if role == "control" else CHECK)
        size = (6.5 if name == point else 2.5 if role == "tie" else 3.5) * unit
        at = f'cx="{col + 0.5:.2f}" cy="{row + 0.5:.2f}" r="{size:.2f}" fill="none"'
        shapes.append(
            f'<circle {at} stroke="#000" stroke-opacity=".6" stroke-width="{3 * unit:.2f}"/>'  # seen on any ground
            f'<circle data-point="{esc(name)}" {at} stroke="{colour}" stroke-width="{1.4 * unit:.2f}">'
            f'<title>{esc(name)}</title></circle>'
        )
    return "".join(shapes)


def _residuals(seen: Sight, scale: float, unit: float) -> str:
    shapes = []
    for (col, row), (dx, dy) in zip(seen.projected, seen.residuals * scale, strict=True):
        if np.isfinite([col, row, dx, dy]).all():
            shapes.append(
                f'<line x1="{col + 0.5:.2f}" y1="{row + 0.5:.2f}" x2="{col + 0.5 + dx:.2f}" y2="{row + 0.5 + dy:.2f}" '
                f'stroke="{css(RESIDUAL)}" stroke-width="{1.4 * unit:.2f}"/>'
            )
    return "".join(shapes)


def magnifier_html(state: State, photo: Photo, wire: Wire) -> str:
    """File pixels around the mark, enlarged; a click moves the mark there, the arrows by a tenth of a file pixel. Below a small
    photo, in the corner of a large one that is farthest from the mark."""
    assert state.mark is not None
    camera = state.block.camera_of(state.image)
    pixels, x, y = crop(photo, (camera.width, camera.height), state.mark.col, state.mark.row, HALF, pyramid(state, photo))
    side, x, y = 2 * HALF + 1, x + 0.5, y + 0.5
    place, width = "display:flex;flex-direction:row-reverse;justify-content:flex-end;gap:8px;margin-top:4px", "168px;flex:none"
    if state.room(Desktop).photo != "small":
        width = "100%"
        u, v = window(state).place(state.mark.col, state.mark.row)
        place = (
            f"position:absolute;{'right' if u < 0.5 else 'left'}:6px;{'bottom' if v < 0.5 else 'top'}:6px;width:min(240px,38%);"
            "font-size:11px;padding:3px 5px 5px;border-radius:4px;"
            "background:var(--mantine-color-body);box-shadow:0 0 0 1px rgba(128,128,128,.6)"
        )
    surface = wire.surface("magnifier").replace(
        'style="cursor:crosshair"', f'style="cursor:crosshair;display:block;width:{width}"'
    )
    arrows = " ".join(
        f'<button type="button" {wire.attributes("nudge", d, f"move the mark {w} by a tenth of a pixel")}>{s}</button>'
        for d, s, w in (("left", "←", "left"), ("right", "→", "right"), ("up", "↑", "up"), ("down", "↓", "down"))
    )
    return (
        f'<div style="{place}"><div><b>{esc(state.mark.point)}</b> at col {state.mark.col:.2f}, row {state.mark.row:.2f} px '
        f"{arrows}</div>"
        f'<svg role="img" aria-label="Magnifier" viewBox="0 0 {side} {side}" {surface}>'
        f'<image href="{jpeg(pixels, 92)}" width="{side}" height="{side}" style="image-rendering:pixelated"/>'
        f'<path d="M0 {y:.3f}H{x - 1.5:.3f}M{x + 1.5:.3f} {y:.3f}H{side}M{x:.3f} 0V{y - 1.5:.3f}M{x:.3f} {y + 1.5:.3f}V{side}" '
        f'stroke="#f0f" stroke-width=".18"/><circle cx="{x:.3f}" cy="{y:.3f}" r=".25" fill="#f0f"/></svg></div>'
    )


def magnified(state: State, photo: Photo, u: float, v: float) -> tuple[float, float]:
    """Pixel of the full photo at (u, v), 0..1, of the magnifier."""
    assert state.mark is not None
    camera = state.block.camera_of(state.image)
    side, full = 2 * HALF + 1, np.array([camera.width, camera.height])
    factor = full / photo.size
    file = (np.array([state.mark.col, state.mark.row]) + 0.5) / factor - 0.5
    corner = np.round(file) - HALF
    col, row = (corner + np.array([u, v]) * side) * factor - 0.5
    return float(col), float(row)


def nudged(state: State, photo: Photo | None, way: str) -> tuple[float, float] | None:
    """The mark moved by a tenth of a file pixel."""
    steps = {"left": (-0.1, 0.0), "right": (0.1, 0.0), "up": (0.0, -0.1), "down": (0.0, 0.1)}
    if state.mark is None or way not in steps:
        return None
    factor = 1.0 if photo is None else state.block.camera_of(state.image).width / photo.size[0]
    return state.mark.col + steps[way][0] * factor, state.mark.row + steps[way][1] * factor


def spots_html(state: State) -> str:
    """Every place asked for, with its ground coordinates, 95 % ellipse and what to mind."""
    if not state.spots:
        return ""
    rows, said, on = [], [], ""
    for number, (spot, place) in enumerate(plotted(state), 1):
        pixel = f'<span title="{esc(spot.image)}">{spot.col:.0f}, {spot.row:.0f}</span>'
        if isinstance(place, str):
            rows.append(("", (f"{number}", pixel, "–", "–", "–", "–")))
            said.append(f"{number}: {place}")
            continue
        e = place.ellipse
        places = decimals(e.semi_major_m, 3)
        rows.append(
            (
                "",
                (
                    f"{number}",
                    pixel,
                    *(f"{v:.{places}f}" for v in place.ground),
                    f"{e.semi_major_m:.2g} × {e.semi_minor_m:.2g}, {e.azimuth_deg:.0f}°",
                ),
            )
        )
        said += [f"{number}: {w}" for w in place.warnings]
        on = f"<div {MUTED}>on {esc(place.surface)}; 95 % ellipse: semi-axes, azimuth of the longer one</div>"
    return (
        f"<div {BOX}>{table(('', 'pixel', 'X m', 'Y m', 'Z m', '95 % m'), rows, 'Ground coordinates', 160)}{on}"
        f"{''.join(f'<div {MUTED}>{esc(s)}</div>' for s in said)}</div>"
    )


def _heard_photo(state: State, value: Any) -> Action | None:
    """A click on the photo: measures, or asks for ground coordinates."""
    at = _pixels(state, value, 2)
    if at is None:
        return None
    return (Plot if state.click == "monoplot" else Aim)(at[0], at[1])


def _heard_box(state: State, value: Any) -> Action | None:
    box = _pixels(state, value, 4)
    return None if box is None else UseBox(*box)


def _pixels(state: State, value: Any, n: int) -> list[float] | None:
    """Pixels of the chosen photo from shares 0..1 of its sides."""
    if not (isinstance(value, tuple) and len(value) == n and state.block.images):
        return None
    shown = window(state)
    return [c for u, v in zip(value[::2], value[1::2], strict=True) for c in shown.pixel(u, v)]


def _heard_next(state: State, value: Any) -> NextPoint:
    return NextPoint()


def _heard_in(state: State, value: Any) -> Action | None:
    return ZoomPhoto(1.5, value[0], value[1], value[2] * 10_000) if isinstance(value, tuple) and len(value) == 3 else None


def _heard_out(state: State, value: Any) -> Action | None:
    return ZoomPhoto(1 / 1.5, value[0], value[1], value[2] * 10_000) if isinstance(value, tuple) and len(value) == 3 else None


def _heard_size(state: State, value: Any) -> Action | None:
    return DrawnPhoto(value[0] * 10_000, value[1] * 10) if isinstance(value, tuple) and len(value) == 2 else None


def _heard_pan(state: State, value: Any) -> Action | None:
    return PanPhoto(value[0] - value[2], value[1] - value[3]) if isinstance(value, tuple) and len(value) == 4 else None


def _heard_magnifier(state: State, value: Any) -> Action | None:
    photo = state.assets.photos.get(state.image)
    if not (isinstance(value, tuple) and len(value) == 2) or state.mark is None or photo is None:
        return None
    return Aim(*magnified(state, photo, *value))


def _heard_nudge(state: State, value: Any) -> Action | None:
    at = nudged(state, state.assets.photos.get(state.image), value) if isinstance(value, str) else None
    return None if at is None else Aim(*at)


TAB = Tab(
    "Photo",
    PhotoPanel,
    place="below",
    order=20,
    commands=(
        Command("Place mark", Place(), "M", hint="The mark becomes the observation of its point."),
        Command("Drop mark", Unmark()),
        Command("Next point to measure", NextPoint(), "N", hint="The next one that is not measured in the chosen photo."),
        Command("Forget places", ForgetSpots()),
        Command("Zoom photo in", ZoomPhoto(2.0), "Z"),
        Command("Zoom photo out", ZoomPhoto(0.5), "Z", "shift"),
        Command("Whole photo", ShowWhole(), "0"),
        Command("Photo size: next", SizePhoto(), "V", hint="Larger, the whole scene, small.", tab="Photo"),
        Command("Zoom photo to the mark or point", ZoomToMark(), "8", hint="One photo pixel as eight of the page."),
    ),
    tasks=tasks,
    heard={
        "next-point": _heard_next,
        "photo-in": _heard_in,
        "photo-out": _heard_out,
        "photo-size": _heard_size,
        "photo-pan": _heard_pan,
        "photo": _heard_photo,
        "photo-box": _heard_box,
        "magnifier": _heard_magnifier,
        "nudge": _heard_nudge,
    },
)
