"""The tabs Points and Images: sortable, editable tables that a keyboard can work; a row flies there."""

from __future__ import annotations

import base64
import io
import json
import math
from functools import lru_cache
from typing import Any

import numpy as np
import viser

from ..acting import Action
from ..actions import SwitchPoint
from ..actions_points import EditPoint, Refused, SwitchRole
from ..bridge import Wire
from ..flying import Fly
from ..lists import COLUMNS, MOST, Column, Row, ShowRows, SortBy, Tables, as_csv, rows_of
from ..state import Photo, State, by_role
from ..tabs import Command, Desk, Tab
from ..theme import CHECK, CONTROL, INITIAL, RESIDUAL
from .widgets import BOX, MUTED, QUIET, RIM, Html, bind, css, decimals, esc, more, put, swatch

THUMB = 44
"""Longer side of a thumbnail in the list, pixels of the page."""
NONE = (
    "No points yet: tie points come from the tab Matching; control points with a list that collinea init was given, or in the "
    "project's points.csv."
)
STATUS = {"solved": "✓", "one model": "½", "not converged": "!", "no solution": "✗", "not measured": "–", "waits": "…"}


class PointsPanel:
    """The control and check points."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        self._filter = gui.add_text("Names shown", "", hint="A part of the name, or a pattern such as G1*; empty shows all.")
        bind(self._filter, desk.emit, lambda value: ShowRows(str(value)))
        self._table = Html(gui)
        csv = gui.add_button("Points as CSV", hint="Download the table as shown, metres and pixels.", color=QUIET)
        csv.on_click(lambda event: download(desk, event.client, "points"))

    def draw(self, state: State) -> None:
        put(self._filter, state.room(Tables).shown)
        on, control = len(state.control()), len(by_role(state.block.points)["control"])
        head = f"<div><b>{on} of {control} control points on</b></div>"
        hint = (
            "click: ☑ on or off · name flies there · role changes it · headings sort · numbers are metres, "
            "Enter solves anew · keys ↑ ↓ Enter"
        )
        if not len(state.block.points):
            self._table.set(f"<div {BOX}><div {MUTED}>{NONE}</div></div>")
            return
        anew = f'data-refused="{state.room(Refused).count}"'
        self._table.set(f"<div {BOX} {anew}>{head}{table_html(state, 'points', self._desk.wire)}<div {MUTED}>{hint}</div></div>")


class ImagesPanel:
    """The images with their status, and every orientation."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui = desk, desk.gui
        self._thumbs = Html(gui)  # the pictures, sent once
        self._images = Html(gui)
        self._orientations = Html(gui)
        self._shows: tuple[Any, ...] | None = None
        for label, name in (("Images as CSV", "images"), ("Orientations as CSV", "orientations")):
            button = gui.add_button(label, hint="Download the table as shown; metres, degrees and pixels.", color=QUIET)
            button.on_click(lambda event, name=name: download(desk, event.client, name))

    def draw(self, state: State) -> None:
        self._thumbs.set(thumbnails_css(state))
        shows = state.work, state.held, state.image, state.room(Tables)
        if self._shows is not None and shows[0] is self._shows[0] and shows[1:] == self._shows[1:]:
            return  # hundreds of rows that would be the same
        self._shows = shows
        count = f"<div><b>{len(state.block.images)} images</b></div>"
        wire = self._desk.wire
        self._images.set(f"<div {BOX}>{count}{table_html(state, 'images', wire)}</div>")
        head = f"<b>Orientations</b> <span {MUTED}>perspective, at the end of the adjustment</span>"
        self._orientations.set(f"<div {BOX}><div>{head}</div>{table_html(state, 'orientations', wire)}</div>")


def download(desk: Desk, client: viser.ClientHandle | None, table: str) -> None:
    """Hand the table to the browser that asked."""
    if client is not None:
        text = as_csv(COLUMNS[table], rows_of(desk.state(), table)[0])
        client.send_file_download(f"{table}.csv", text.encode("utf-8"))


def table_html(state: State, table: str, wire: Wire) -> str:
    """The whole table; its scroll position and the cell in work survive being drawn anew."""
    columns, (rows, count) = COLUMNS[table], rows_of(state, table)
    sorting = state.room(Tables).sorting.get(table)
    head = "".join(_head(table, c, sorting, wire) for c in columns)
    draw = {"points": _point_cells, "images": _image_cells, "orientations": _orientation_cells}[table]
    body = "".join(
        f'<tr data-row="{esc(row.name)}" style="{"font-weight:600;background:rgba(128,128,128,.18);" if row.chosen else ""}">'
        f"{draw(row, columns, wire)}</tr>"
        for row in rows
    )
    rest = f"<div {MUTED}>{count - MOST} more: narrow the names shown</div>" if count > MOST else ""
    name = {"points": "Points", "images": "Image list", "orientations": "All orientations"}[table]
    return (
        f'<div data-keep="{table}" data-wide style="max-height:46vh;overflow:auto;scroll-padding-left:90px;{RIM}">'
        f'<table aria-label="{name}" style="border-collapse:collapse;font-size:11px;font-variant-numeric:tabular-nums">'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        f"</div>{more()}{rest}"
    )


def _head(table: str, column: Column, sorting: tuple[str, bool] | None, wire: Wire) -> str:
    on = sorting is not None and sorting[0] == column.key
    arrow = (" ▼" if sorting[1] else " ▲") if sorting and on else ""
    said = ("descending" if sorting[1] else "ascending") if sorting and on else "none"
    unit = f" <span {MUTED}>{esc(column.unit)}</span>" if column.unit else ""
    hint, focus = f"{column.hint} Click to sort.", f"{table}/head/{column.key}"
    button = wire.attributes("sort", json.dumps([table, column.key]), hint, focus)
    stays = "left:0;z-index:2" if column.key == "name" else "z-index:1"
    style = f"{CELL};position:sticky;top:0;{stays};background:var(--mantine-color-body)"
    words = f"<span {button}>{esc(column.title)}{unit}{arrow}</span>"
    return f'<th scope="col" aria-sort="{said}" style="{style}">{words}</th>'


CELL = "padding:1px 4px;white-space:nowrap;text-align:right"


STAYS = "position:sticky;left:0;background:linear-gradient({0},{0}),var(--mantine-color-body)"
"""A cell that stays in sight when the others are scrolled away; {0}: its row's colour."""


def _td(content: str, left: bool = False) -> str:
    return f'<td style="{CELL}{";text-align:left" if left else ""}">{content}</td>'


def _name(row: Row, content: str) -> str:
    colour = "rgba(128,128,128,.18)" if row.chosen else "transparent"
    return f'<td style="{CELL};text-align:left;{STAYS.format(colour)}">{content}</td>'


def _button(wire: Wire, kind: str, value: str, hint: str, focus: str, content: str) -> str:
    return f"<span {wire.attributes(kind, value, hint, focus)}>{content}</span>"


def _point_cells(row: Row, columns: tuple[Column, ...], wire: Wire) -> str:
    name, v = row.name, row.values
    colour = INITIAL if not v["on"] else CONTROL if v["role"] == "control" else CHECK
    switch, other = "off" if v["on"] else "on", "check" if v["role"] == "control" else "control"
    box, words, w = "☑" if v["on"] else "☐", f"{swatch(colour)}{esc(name)}", _number(v["w"], 1)
    cells = [
        _td(_button(wire, "on", name, f"switch {name} {switch}", f"points/on/{name}", box)),
        _name(row, _button(wire, "fly-point", name, f"choose {name} and fly there", f"points/name/{name}", words)),
        _td(_button(wire, "role", name, f"make {name} {other}", f"points/role/{name}", esc(v["role"])), True),
        _td(_number(v["v"], 2)),
        _td(f'<span style="color:{css(RESIDUAL)}">{w}</span>' if v["w"] > 3 else w),
    ]
    for column in columns[5:11]:
        value, sigma = v[column.key], column.key.startswith("s")
        text = "" if math.isnan(value) else f"{value:.6g}" if sigma else f"{value:.3f}"
        focus, width = f"points/{column.key}/{name}", max(len(text) + 1, 5)
        cells.append(_td(wire.field("edit", [name, column.key], text, f"{name} {column.key} in metres", focus, width)))
    return "".join(cells) + _td(esc(v["group"]), True)


def _image_cells(row: Row, columns: tuple[Column, ...], wire: Wire) -> str:
    name, v = row.name, row.values
    picture = f'<span class="{thumb_class(name)}" style="display:inline-block;vertical-align:middle;margin-right:5px"></span>'
    button = _button(wire, "fly-image", name, f"choose {name} and fly there", f"images/name/{name}", f"{picture}{esc(name)}")
    return "".join(
        (
            _name(row, button),
            _td(f"{STATUS.get(v['status'], '')} {esc(v['status'])}", True),
            _td(str(v["n"])),
            _td(_number(v["rms_p"], 2)),
            _td(_number(v["rms_o"], 2)),
        )
    )


def _orientation_cells(row: Row, columns: tuple[Column, ...], wire: Wire) -> str:
    name, v = row.name, row.values
    cells = [_name(row, _button(wire, "fly-image", name, f"choose {name} and fly there", f"orientations/name/{name}", esc(name)))]
    for column in columns[1:7]:
        value, sigma = v.get(column.key), v.get(f"s{column.key}")
        if value is None or sigma is None:
            cells.append(_td("–"))
            continue
        places = decimals(sigma, 5)
        cells.append(_td(f"{value:.{places}f}<br><span {MUTED}>±{sigma:.{places}f}</span>"))
    return "".join(cells) + _td(_number(v.get("sigma0", math.nan), 2))


def _number(value: float, places: int) -> str:
    return "" if math.isnan(value) else f"{value:.{places}f}"


def thumb_class(name: str) -> str:
    """A name of a style class for any name of an image."""
    return "collinea-t" + name.encode("utf-8").hex()


def thumbnails_css(state: State) -> str:
    """The thumbnails of all images as style classes."""
    return "<style>" + "".join(_thumb(name, photo) for name, photo in list(state.assets.photos.items())[:MOST]) + "</style>"


@lru_cache(maxsize=2000)
def _thumb(name: str, photo: Photo) -> str:
    from PIL import Image

    step = max(1, max(photo.thumbnail.shape[:2]) // (2 * THUMB))
    small = Image.fromarray(np.ascontiguousarray(photo.thumbnail[::step, ::step]))
    out = io.BytesIO()
    small.save(out, "JPEG", quality=60)
    w, h = (round(THUMB * side / max(small.size)) for side in small.size)
    data = base64.b64encode(out.getvalue()).decode()
    return f".{thumb_class(name)}{{width:{w}px;height:{h}px;background:url(data:image/jpeg;base64,{data}) 0 0/100% 100%}}"


# -- what comes back


def _heard_on(state: State, value: Any) -> Action | None:
    return SwitchPoint(value) if isinstance(value, str) else None


def _heard_role(state: State, value: Any) -> Action | None:
    return SwitchRole(value) if isinstance(value, str) else None


def _heard_fly_point(state: State, value: Any) -> Action | None:
    return Fly("point", value) if isinstance(value, str) else None


def _heard_fly_image(state: State, value: Any) -> Action | None:
    return Fly("image", value) if isinstance(value, str) else None


def _words(value: Any, n: int) -> list[str] | None:
    """n texts out of a message."""
    try:
        said = json.loads(value) if isinstance(value, str) else None
    except (ValueError, RecursionError):
        return None
    return said if isinstance(said, list) and len(said) == n and all(isinstance(s, str) for s in said) else None


def _heard_edit(state: State, value: Any) -> Action | None:
    said = _words(value, 3)
    return None if said is None else EditPoint(*said)


def _heard_sort(state: State, value: Any) -> Action | None:
    said = _words(value, 2)
    return None if said is None else SortBy(*said)


def _fly(what: str) -> Any:
    def act(state: State) -> Action | None:
        name = state.point if what == "point" else state.image
        return Fly(what, name) if name else None

    return act


def _switch(state: State) -> Action | None:
    return SwitchPoint(state.point) if state.point else None


def _role(state: State) -> Action | None:
    return SwitchRole(state.point) if state.point else None


TAB = (
    Tab(
        "Points",
        PointsPanel,
        order=12,
        commands=(
            Command("Fly to the chosen point", _fly("point"), "F"),
            Command("Switch the chosen point on or off", _switch, "O"),
            Command("Make the chosen point control or check", _role, "R"),
        ),
        heard={"on": _heard_on, "role": _heard_role, "edit": _heard_edit, "sort": _heard_sort, "fly-point": _heard_fly_point},
    ),
    Tab(
        "Images",
        ImagesPanel,
        order=14,
        commands=(Command("Fly to the chosen image", _fly("image"), "I"),),
        heard={"fly-image": _heard_fly_image},
    ),
)
