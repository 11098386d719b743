"""The Mosaic tab: choose, make, step through, compare, measure on it, lay a map under it, write it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from solvers import PhotogrammetryError

from ..acting import Action
from ..actions import Say, Undo
from ..desktop import TYPED, Type, typed
from ..flying import Fly
from ..matching_actions import Accept, Reject
from ..matching_state import Matching
from ..mosaic_actions import (
    CancelMosaic,
    Choose,
    ClickMosaic,
    ForgetPlaces,
    GoToRow,
    Look,
    MakeMosaic,
    OpenLayer,
    WriteMosaic,
)
from ..mosaic_layer import csv_of
from ..mosaic_scene import clicked, scene
from ..mosaic_state import BLENDS, CLICKS, EXAGGERATIONS, KINDS, METHODS, MODELS, PLANES, SHOWN, Mosaic
from ..mosaic_tasks import tasks
from ..state import State
from ..tabs import Command, Desk, Tab
from ..uploads import keep_map
from .mosaic_words import (
    drift_html,
    layer_html,
    measured_html,
    progress_html,
    residuals_html,
    step_html,
    summary_html,
    written_html,
)
from .widgets import QUIET, Html, bind, prop, put

FIT = "fit"


class MosaicPanel:
    """Draws what is asked and what came of it; emits choices, clicks and files."""

    def __init__(self, desk: Desk) -> None:
        self._desk, gui, emit = desk, desk.gui, desk.emit
        self._choices(desk)
        self._button(
            "Make mosaic",
            "Register all photos at once (simultaneous) and compose them.",
            lambda: MakeMosaic("simultaneous"),
            main=True,
        )
        self._button(
            "Make mosaic one by one",
            "Fit photo after photo to the growing mosaic: to be compared, its errors add up.",
            lambda: MakeMosaic("sequential"),
        )
        self._button(
            "Make both, to compare",
            "The simultaneous and the sequential mosaic, to see the drift and how it closes.",
            lambda: MakeMosaic("both"),
        )
        self._cancel = gui.add_button(
            "Cancel mosaic work", hint="Stops making, comparing and writing; what is finished stays.", color=QUIET
        )
        self._cancel.on_click(lambda _: emit(CancelMosaic()))
        self._progress = Html(gui)
        self._view(desk)
        self._clicks(desk)
        self._summary = Html(gui)
        self._files(desk)

    def _button(self, label: str, hint: str, act: Callable[[], Action], main: bool = False) -> Any:
        handle = self._desk.gui.add_button(label, hint=hint, color=None if main else QUIET)
        handle.on_click(lambda _: self._desk.emit(act()))
        return handle

    def _choices(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        with gui.add_folder("How it is made", expand_by_default=False):
            self._kind = gui.add_dropdown(
                "Kind",
                KINDS,
                hint="What places the mosaic: nothing (pixels of the most vertical photo), "
                "onboard positions or two points, three control points and more.",
            )
            self._model = gui.add_dropdown(
                "Model",
                MODELS,
                hint="Unknowns of each photo: its exterior orientation, plane coefficients "
                "held to it (adapted), eight free plane coefficients, or a bundle.",
            )
            self._plane = gui.add_dropdown(
                "Surface",
                PLANES,
                hint="What the photos are projected on: a level plane at the mean height, "
                "a tilted plane through the points, or the project's height grid.",
            )
            self._gsd = gui.add_number(
                "Ground pixel [m]",
                0.0,
                min=0.0,
                max=1e4,
                step=0.001,
                hint="Size of a pixel on the ground when it is "
                "written, metres (photo pixels of an uncontrolled mosaic); 0: of the photos.",
            )
            self._blend = gui.add_dropdown("Blend", BLENDS, hint="How photos that show the same place are joined.")
            self._seams = gui.add_checkbox(
                "Seam lines",
                False,
                hint="One photo a place, seams where the photos agree best: nothing that moved appears twice.",
            )
            self._gain = gui.add_checkbox("Even tones", False, hint="Even out exposure and vignetting of the photos.")
        for handle, name in (
            (self._kind, "kind"),
            (self._model, "model"),
            (self._plane, "plane"),
            (self._gsd, "gsd"),
            (self._blend, "blend"),
            (self._seams, "seams"),
            (self._gain, "gain"),
        ):
            bind(handle, emit, lambda value, name=name: Choose(name, value))

    def _view(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._shown = gui.add_dropdown(
            "Shown",
            SHOWN,
            hint="One registration, or both: swipe from west (sequential) to east (simultaneous), or fade one over the other.",
        )
        self._swipe = gui.add_slider(
            "Swipe or fade [share]",
            0.0,
            1.0,
            0.01,
            0.5,
            hint="Where the swipe's line lies from west to east, or how opaque the sequential mosaic is, 0 to 1, no unit.",
        )
        self._opacity = gui.add_slider("Mosaic opacity [share]", 0.0, 1.0, 0.1, 1.0, hint="0: invisible, 1: opaque; no unit.")
        for handle, name in ((self._shown, "shown"), (self._swipe, "swipe"), (self._opacity, "opacity")):
            bind(handle, emit, lambda value, name=name: Look(name, value))
        self._row = gui.add_slider(
            "Registration step",
            0,
            1,
            1,
            0,
            hint="Row of the registration's trace: a photo that joins "
            "(sequential) or an iteration (simultaneous); the last row shows the mosaic. Keys comma, period.",
        )
        bind(self._row, emit, lambda value: GoToRow(round(value)))
        self._step = Html(gui)
        with gui.add_folder("What is drawn", expand_by_default=False):
            self._switches = {
                "outlines": gui.add_checkbox("Outlines of photos", True, hint="Where the photos lie on the mosaic plane."),
                "thumbnails": gui.add_checkbox(
                    "Photos at every step", True, hint="Small photos as the step lays them, up to 40."
                ),
                "drift": gui.add_checkbox(
                    "Drift vectors",
                    True,
                    hint="From the simultaneous to the sequential place of every "
                    "photo's corners, exaggerated; the bar says the scale.",
                ),
                "residuals": gui.add_checkbox(
                    "Residuals at known points",
                    True,
                    hint="From each control and check point to where the mosaic shows it, exaggerated; the bar says the scale.",
                ),
                "layer_shown": gui.add_checkbox(
                    "Map layer", True, hint="The map or orthophoto under the mosaic, and its offsets."
                ),
            }
        for name, handle in self._switches.items():
            bind(handle, emit, lambda value, name=name: Look(name, bool(value)))
        self._factor = gui.add_dropdown(
            "Exaggeration of vectors [times]",
            (FIT, *(f"{v:g}" for v in EXAGGERATIONS)),
            hint="Factor of drift, residual and offset vectors; fit: each as long as can be seen well.",
        )
        bind(self._factor, emit, lambda value: Look("exaggeration", 0.0 if value == FIT else float(value)))

    def _clicks(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._click = gui.add_dropdown(
            "A click on the mosaic",
            CLICKS,
            hint="Nothing, a place to be measured, or a conjugate point: the photos that show the place are matched.",
        )
        bind(self._click, emit, lambda value: Look("click", value))
        hint = "Forget the last place measured on the mosaic."
        self._last = self._button("Forget last place", hint, lambda: ForgetPlaces(all=False))
        self._every = self._button("Forget all places", "Forget all places measured on the mosaic.", lambda: ForgetPlaces())
        self._measured = Html(gui)
        self._accept = self._button(
            "Accept conjugate point",
            "All matches found become observations of one tie point; the mosaic follows, tiles whose photos did not move stay.",
            lambda: Accept(all=True),
            main=True,
        )
        self._reject = self._button("Reject conjugate point", "Forget the match in view; the Matching tab shows it.", Reject)
        self._undo = self._button("Undo last measurement", "Take the last edit back; the mosaic follows.", Undo)

    def _files(self, desk: Desk) -> None:
        gui = desk.gui
        with gui.add_folder("Map under the mosaic", expand_by_default=False):
            self._path = gui.add_text(
                "Map file", "", hint="A map or orthophoto, GeoTIFF in the project's crs; path from the project's folder."
            )
            bind(self._path, desk.emit, lambda value: Type("Map file", str(value)))
            upload = gui.add_upload_button(
                "Hand over a map",
                mime_type=".tif,.tiff",
                hint="A GeoTIFF from this computer, 64 MB at most: it is kept in the project's folder maps and compared at once.",
            )
            upload.on_upload(lambda _: self._handed(upload.value.name, upload.value.content))
            self._button(
                "Compare with map",
                "Lay the map under the mosaic and measure how the two differ, metres.",
                lambda: (
                    OpenLayer(self._path.value.strip())
                    if self._path.value.strip()
                    else Say("Name the GeoTIFF of a map or orthophoto first.")
                ),
            )
            self._button("Remove map", "Take the map away.", lambda: OpenLayer(""))
            hint = "Download places and offsets (layer minus mosaic), metres."
            self._csv = gui.add_button("Offsets as CSV", hint=hint, color=QUIET)
            self._csv.on_click(lambda event: self._download(event.client))
        self._layer = Html(gui)
        with gui.add_folder("Write", expand_by_default=False):
            self._out = gui.add_text(
                "Mosaic file",
                TYPED["Mosaic file"],
                hint="Name within the project's folder: .tif (GeoTIFF with overviews), .png or .jpg (with a world file).",
            )
            bind(self._out, desk.emit, lambda value: Type("Mosaic file", str(value)))
            self._button(
                "Write mosaic",
                "Compose at full resolution and write the file, its world file and footprints.",
                lambda: (
                    WriteMosaic(self._out.value.strip())
                    if self._out.value.strip()
                    else Say("Name the file first, mosaic.tif for example.")
                ),
            )
            self._written = Html(gui)
            self._rrd = gui.add_button(
                "Mosaic as rerun recording",
                color=QUIET,
                hint="Download every step of both registrations, the picture and "
                "the vectors as .rrd, with the same entity paths as here.",
            )
            self._rrd.on_click(lambda event: self._recording(event.client))

    def _handed(self, name: str, content: bytes) -> None:
        folder = self._desk.state().assets.folder
        if folder is None:
            self._desk.emit(Say("These photos have no folder; open a project to keep a map in it."))
            return
        try:
            path = keep_map(folder, name, content)
        except (PhotogrammetryError, OSError) as error:
            self._desk.emit(Say(str(error)))
            return
        self._desk.emit(Type("Map file", path))
        self._desk.emit(OpenLayer(path))

    def _download(self, client: Any) -> None:
        layer = self._desk.state().room(Mosaic).layer
        if client is None or layer is None or not len(layer.off):
            self._desk.emit(Say("There are no offsets yet; compare the mosaic with a map first."))
            return
        client.send_file_download(f"{layer.name.rpartition('.')[0] or layer.name}.offsets.csv", csv_of(layer).encode())

    def _recording(self, client: Any) -> None:
        state = self._desk.state()
        if client is None or not state.room(Mosaic).made:
            self._desk.emit(Say("There is no mosaic yet; make one first."))
            return
        from ..rerun_mosaic import recorded

        client.send_file_download("mosaic.rrd", recorded(state))

    def draw(self, state: State) -> None:
        room = state.room(Mosaic)
        ask = room.ask
        for handle, value in (
            (self._kind, ask.kind),
            (self._model, ask.model),
            (self._plane, ask.plane),
            (self._gsd, ask.gsd),
            (self._blend, ask.blend),
            (self._seams, ask.seams),
            (self._gain, ask.gain),
            (self._shown, room.shown),
            (self._swipe, room.swipe),
            (self._opacity, room.opacity),
            (self._click, room.click),
            (self._factor, FIT if room.exaggeration == 0 else f"{room.exaggeration:g}"),
            (self._path, typed(state, "Map file")),
            (self._out, typed(state, "Mosaic file")),
        ):
            put(handle, value)
        for name, handle in self._switches.items():
            put(handle, getattr(room, name))
        there = room.current is not None
        for handle in (self._shown, self._opacity, self._factor, self._click):
            prop(handle, "visible", there)
        prop(self._swipe, "visible", room.shown not in METHODS and len(room.made) > 1)
        prop(self._row, "visible", room.last_row > 0)
        prop(self._row, "max", max(room.last_row, 1))
        put(self._row, room.shown_row)
        prop(self._cancel, "visible", working(state))
        for handle in (self._last, self._every):
            prop(handle, "visible", bool(room.places))
        matching = state.room(Matching)
        judging = there and room.click == CLICKS[2]
        prop(self._accept, "visible", judging and any(f.ok for f in matching.found))
        prop(self._reject, "visible", judging and bool(matching.found))
        prop(self._undo, "visible", judging and bool(state.past))
        self._progress.set(progress_html(room, matching, working(state)))
        self._step.set(step_html(room))
        self._summary.set(summary_html(room) + drift_html(room) + residuals_html(room))
        self._measured.set(measured_html(state, room))
        self._layer.set(layer_html(room))
        self._written.set(written_html(room))


def working(state: State) -> bool:
    """Whether the tab has work going on."""
    return bool(tasks(state))


def on_click(state: State, origin: np.ndarray, direction: np.ndarray, tolerance: float) -> Action | None:
    """A click in the scene that means the mosaic."""
    room = state.room(Mosaic)
    if room.click == CLICKS[0] or room.current is None:
        return None
    at = clicked(state, origin, direction)
    return None if at is None else ClickMosaic(*at)


def _next(by: int) -> Callable[[State], Action | None]:
    return lambda state: GoToRow(by, relative=True) if state.room(Mosaic).made else None


TAB = Tab(
    "Mosaic",
    MosaicPanel,
    order=40,
    tasks=tasks,
    scene=scene,
    click=on_click,
    commands=(
        Command("Make the mosaic", MakeMosaic("simultaneous"), hint="Register all photos at once and compose them."),
        Command("Make both mosaics", MakeMosaic("both"), hint="Sequential and simultaneous, to see the drift."),
        Command("Look at the mosaic", Fly("mosaic", ""), hint="From where you are, as near as all of it is seen."),
        Command("Next step of the registration", _next(1), "."),
        Command("Previous step of the registration", _next(-1), ","),
    ),
)
