"""The Matching tab: two photos beside each other, a click matched step by step, proposals in other photos, tie points."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..acting import Action
from ..actions import Redo, Undo
from ..matching_actions import (
    Accept,
    ColourTies,
    MatchPoint,
    MatchRow,
    Pair,
    Propose,
    Reject,
    Sharper,
    Start,
    Tune,
    chosen,
    heard,
)
from ..matching_scene import RAYS, SCALE, largest, scene
from ..matching_state import COLOURS, Matching
from ..matching_tasks import tasks
from ..pyramid import Pyramid
from ..state import State, by_role, listed
from ..tabs import Command, Desk, Tab
from .pair import SCRIPT, Panes
from .patches import found_html, headline
from .widgets import BOX, MUTED, QUIET, Html, bind, css, esc, prop, put, swatch, table

NEW = "new tie point"
JUDGE = ("Accept", "Reject", "Undo", "Redo")


class MatchingPanel:
    """Draws the pair and the match in view; emits clicks, choices and verdicts."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._wire = desk.wire
        desk.wire.run(SCRIPT)
        self._pyramid = Pyramid(lambda: emit(Sharper()))
        names = tuple(i.name for i in desk.state().block.images) or ("no image",)
        self._left = gui.add_dropdown("Left photo", names, hint="The photo that gives the template: click a point in it.")
        self._right = gui.add_dropdown("Right photo", names, hint="The photo in which the point is looked for.")
        bind(self._left, emit, lambda name: Pair("left", name))
        bind(self._right, emit, lambda name: Pair("right", name))
        self._panes = Panes(desk.wire, gui, self._pyramid)
        self._words = Html(gui)
        judge = gui.add_button_group(
            "Verdict", JUDGE, hint="Accept makes the match an observation (key A), Reject forgets it (X)."
        )
        verdicts: dict[str, Action] = dict(zip(JUDGE, (Accept(), Reject(), Undo(), Redo()), strict=True))

        @judge.on_click
        async def _(event: Any) -> None:
            if judge.value in verdicts:
                emit(verdicts[judge.value])

        self._found = Html(gui)
        self._row = gui.add_slider(
            "LSM iteration", 0, 1, 1, 0, hint="Row of the least squares matching; row 0 is where correlation put it."
        )
        bind(self._row, emit, lambda value: MatchRow(round(value)))
        self._options(desk)
        self._proposals = Html(gui)
        self._ties(desk)

    def _options(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._point = gui.add_dropdown(
            "Point matched",
            (NEW,),
            hint="Measured in the left photo, it is looked for in the right one; "
            "as a new tie point, every click accepted makes one.",
        )
        bind(self._point, emit, lambda name: MatchPoint(None if name == NEW else name))
        propose = gui.add_button(
            "Propose in the other photos",
            color=QUIET,
            hint="Look for this point in every photo that may show it; nothing is taken over before it is accepted.",
        )
        propose.on_click(lambda _: emit(Propose()))
        self._all = gui.add_button("Accept all found", hint="All that was found becomes observations.")
        self._all.on_click(lambda _: emit(Accept(all=True)))
        with gui.add_folder("How to match", expand_by_default=False):
            self._window = gui.add_slider("Window px", 7, 61, 2, 21, hint="Side of the template, pixels of the photo's file.")
            self._search = gui.add_slider(
                "Search px", 0, 60, 1, 0, hint="How far around the prediction; 0: as far as it is uncertain."
            )
            self._threshold = gui.add_slider(
                "Least correlation",
                0.3,
                0.95,
                0.05,
                0.6,
                hint="Correlation below which nothing is believed; 0.5 to 0.7 is usual; no unit.",
            )
        for handle, name in ((self._window, "window"), (self._search, "search"), (self._threshold, "threshold")):
            bind(handle, emit, lambda value, name=name: Tune(name, float(value)))

    def _ties(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._colour = gui.add_dropdown(
            "Tie points by", COLOURS, hint="Their colour on the photos and, once placed, in the scene."
        )
        bind(self._colour, emit, ColourTies)
        self._legend = Html(gui)
        self._find = gui.add_button(
            "Find tie points",
            hint="Search all photos for points they share, in place of earlier ones "
            "found so. Takes seconds to minutes; undo takes it back.",
        )
        self._find.on_click(lambda _: emit(Start("ties")))
        self._adjust = gui.add_button(
            "Place tie points",
            color=QUIET,
            hint="Bundle adjustment of all that is measured: shows them in the "
            "scene and predicts matches. The project is not changed.",
        )
        self._adjust.on_click(lambda _: emit(Start("adjust")))
        self._stop = gui.add_button("Stop", hint="Stop the search or the bundle; what is done of a search is kept.", color=QUIET)
        self._stop.on_click(lambda _: emit(Start("")))

    def draw(self, state: State) -> None:
        m = chosen(state)
        put(self._left, m.first or self._left.options[0])
        put(self._right, m.second or self._right.options[0])
        self._panes.draw(state, m)
        self._words.set(words(m))
        self._found.set(found_html(m))
        prop(self._row, "visible", m.last_row > 0)
        prop(self._row, "max", max(m.last_row, 1))
        put(self._row, min(m.row, m.last_row))
        options = (NEW, *listed(state.block.points, m.point))
        prop(self._point, "options", options)
        put(self._point, m.point if m.point in options else NEW)
        for handle, value in (
            (self._window, m.window),
            (self._search, m.search),
            (self._threshold, m.threshold),
            (self._colour, m.colour),
        ):
            put(handle, value)
        prop(self._all, "visible", sum(f.ok for f in m.found) > 1)
        self._proposals.set(proposals_html(m, self._wire))
        self._legend.set(legend_html(state, m))
        for handle in (self._find, self._adjust):
            prop(handle, "disabled", bool(m.task))
        prop(self._stop, "visible", bool(m.task))

    def close(self) -> None:
        self._pyramid.close()


def words(m: Matching) -> str:
    """What came of it, what was said last, or what to do next."""
    said = f"<div>{esc(m.message)}</div>" if m.message else ""
    if m.current is not None:
        return f"<div {BOX}>{headline(m.current)}{said}</div>"
    if m.asked:
        return f"<div {BOX}>Matching {esc(m.asked[0].first)} with {esc(m.asked[0].second)} …</div>"
    if not said and m.second:
        keys = f"<span {MUTED}>Wheel: zoom · drag: pan · keys on a photo: arrows, +, −</span>"
        said = f"<div>Click a point in the left photo. {keys}</div>"
    return f"<div {BOX}>{said}</div>" if said else ""


def proposals_html(m: Matching, wire: Any) -> str:
    """All that was found of a point, one line a photo; a click shows it."""
    if len(m.found) + len(m.asked) < 2:
        return ""
    rows = []
    for n, f in enumerate(m.found):
        mark = "▸ " if n == m.shown else ""
        name = f"<span {wire.attributes('pair', f'found|{n}', f'show {f.ask.second}')}>{mark}{esc(f.ask.second)}</span>"
        if f.ok and f.pixel is not None and f.sigma is not None and f.stepped is not None and f.guess is not None:
            off = float(np.linalg.norm(f.pixel - f.guess.place))
            rows.append(("", (name, f"{f.stepped.lsm.score[0]:.3f}", f"{f.sigma.max():.3f}", f"{off:.1f}", "✓")))
        else:
            rows.append(("", (name, "–", "–", "–", f'<span title="{esc(f.why)}">✗ {esc(f.why[:28])}</span>')))
    rows += [("", (esc(a.second), "", "", "", "…")) for a in m.asked]
    head = ("photo", "score", "σ px", "off px", "")
    note = f"<div {MUTED}>off: from where it was predicted</div>"
    return f"<div {BOX}>{table(head, rows, 'Proposals', 180)}{note}</div>"


def legend_html(state: State, m: Matching) -> str:
    """What the colours of the tie points mean, and how the long work goes."""
    ties = len(by_role(state.block.points)["tie"])
    parts = [f"<div>{esc(m.progress)}</div>"] if m.progress else []
    if ties and m.colour == "number of rays":
        parts.append(
            "<div>seen in "
            + " &nbsp;".join(f"{swatch(c)}{n}{'+' if n == max(RAYS) else ''}" for n, c in RAYS.items())
            + f" photos <span {MUTED}>· {ties} tie points</span></div>"
        )
    elif ties and m.colour == "residual":
        bar = ",".join(css((int(r), int(g), int(b))) for r, g, b in SCALE)
        scale = f'<span style="display:inline-block;width:120px;height:.8em;background:linear-gradient(90deg,{bar})"></span>'
        text = "place the tie points first: their residuals come from the bundle"
        if m.network is not None:
            text = f"residual 0 {scale} {largest(m.network):.2f} px and more"
        parts.append(f"<div>{text}</div>")
    if m.network is not None and m.network.block is not state.block:
        parts.append(f"<div {MUTED}>Measurements have changed since the tie points were placed.</div>")
    return f"<div {BOX}>{''.join(parts)}</div>" if parts else ""


def _heard(state: State, value: Any) -> Action | None:
    return heard(value) if isinstance(value, str) else None


TAB = Tab(
    "Matching",
    MatchingPanel,
    order=20,
    tasks=tasks,
    scene=scene,
    heard={"pair": _heard},
    commands=(
        Command("Accept the match", Accept(), "A", hint="The match in view becomes an observation."),
        Command("Reject the match", Reject(), "X", hint="Forget the match in view."),
        Command("Propose in the other photos", Propose(), hint="Look for the point in every photo."),
    ),
)
