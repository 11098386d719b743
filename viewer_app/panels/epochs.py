"""The Epochs tab: a comparison of epochs, its displacements in the scene, a slider over the epochs."""

from __future__ import annotations

import numpy as np

from solvers.workflows_monitoring import Movements

from ..epochs import (
    EXAGGERATIONS,
    DrawEllipsoids,
    Epochs,
    Exaggerate,
    GoToEpoch,
    exaggeration,
    reopened,
    scene,
)
from ..flying import Fly
from ..state import State
from ..tabs import Command, Desk, Tab
from ..theme import CHECK, RESIDUAL
from .widgets import BOX, MUTED, Html, bind, esc, prop, put, swatch, table

FIT = "fit"
HOW = "Compare epochs on the command line: collinea compare EPOCH_A EPOCH_B; then open the last of them here."


class EpochsPanel:
    """Draws the epochs of a comparison; emits which one to show and how."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._read = gui.add_button("Show the latest comparison", hint="Reads the project's latest run of: collinea compare.")

        def show(client: int | None) -> None:
            emit(reopened(desk.state()))
            emit(Fly("points", "", client))

        self._read.on_click(lambda event: show(event.client_id))
        self._epoch = gui.add_slider("Epoch", 0, 1, 1, 0, hint="Epoch shown: 0 is the first, from which movements count.")
        bind(self._epoch, emit, lambda value: GoToEpoch(round(value)))
        self._factor = gui.add_dropdown("Exaggeration [times]", (FIT, *(f"{v:g}" for v in EXAGGERATIONS)),
                                        hint="Factor of displacement vectors and ellipsoids; a bar in the scene tells the scale.")
        bind(self._factor, emit, lambda value: Exaggerate(0.0 if value == FIT else float(value)))
        self._drawn = gui.add_checkbox("Ellipsoids (95 %)", True,
                                       hint="Error ellipsoids at the ends of the vectors, as exaggerated.")
        bind(self._drawn, emit, lambda value: DrawEllipsoids(bool(value)))
        self._text = Html(gui)

    def draw(self, state: State) -> None:
        room = state.room(Epochs)
        prop(self._epoch, "max", max(room.last, 1))
        for handle in (self._epoch, self._factor, self._drawn):
            prop(handle, "visible", room.compared is not None)
        put(self._epoch, room.epoch)
        put(self._factor, FIT if room.exaggeration == 0 else f"{room.exaggeration:g}")
        put(self._drawn, room.ellipsoids)
        self._text.set(f"<div {BOX}>{_words(state, room)}</div>")


def _words(state: State, room: Epochs) -> str:
    if room.compared is None:
        return f"<div>{esc(room.said)}</div><div {MUTED}>{esc(HOW)}</div>"
    shown = room.shown
    if shown is None:
        return f"<div>{esc(room.compared.first)}: the first epoch, {len(room.compared.places)} points.</div>"
    head = (f"<div><b>{esc(room.compared.first)} → {esc(shown.epoch)}</b>: {int(shown.moved.sum())} of {len(shown.names)} points "
            f"moved, {int(shown.datum.sum())} hold the datum; drawn {exaggeration(state):g} times.</div>"
            f"<div>{swatch(RESIDUAL)}moved {swatch(CHECK)}not significant "
            f"<span {MUTED}>(any false alarm: {room.compared.level:.0%})</span></div>")
    return head + displacements(shown)


def displacements(shown: Movements) -> str:
    """The points of an epoch as a table, the moved ones first, in millimetres."""
    order = np.lexsort((-np.linalg.norm(shown.d, axis=1), ~shown.moved))
    rows = []
    for i in order[:60]:
        d, axes = 1e3 * shown.d[i], 1e3 * shown.axes[i]
        cells = [f"{v:.2f}" for v in (*d, np.linalg.norm(d))] + [" ".join(f"{a:.1f}" for a in axes)]
        style = 'style="font-weight:600"' if shown.moved[i] else ""
        rows.append((style, [esc(shown.names[i]), *cells, "moved" if shown.moved[i] else ""]))
    return table(("point", "dX", "dY", "dZ", "length", "95 % axes", "[mm]"), rows, "Displacements", 320)


TAB = Tab(
    "Epochs",
    EpochsPanel,
    order=60,
    commands=(
        Command("Show the latest comparison of epochs", reopened),
        Command("Look at all points", Fly("points", "")),
        Command("Next epoch", GoToEpoch(1, relative=True)),
        Command("Previous epoch", GoToEpoch(-1, relative=True)),
    ),
    scene=scene,
)
