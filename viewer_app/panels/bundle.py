"""The Bundle tab: what to adjust, run and stop, the block in the scene, residuals, correlations, tables of what it is worth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solvers.cameras import PARAMETERS

from ..bundle_actions import FollowBundle, FreeParameter, HoldBundle, KeepBundle, OfEveryImage, RunBundle, SetBundle, StopBundle
from ..bundle_figures import camera_figures, camera_of, image_vectors
from ..bundle_rows import image_number
from ..bundle_scene import alone, click, judged, scene
from ..bundle_state import COLOURED, DATUMS, FACTORS, ROBUST, SHUTTERS, STARTS, TRANSFORMS, Bundle
from ..bundle_tasks import tasks
from ..bundle_values import Judged
from ..rerun_shown import Shown, bundle_shown
from ..state import MODELS, State
from ..tabs import Command, Desk, Tab
from .bundle_plots import correlation_svg, profile_svg, vectors_svg
from .bundle_tables import (
    components,
    images_table,
    interior_table,
    legend,
    marks,
    points_table,
    summary,
    suspects_table,
    two_runs,
)
from .rerun import Lay, RerunPanel
from .widgets import BOX, MUTED, QUIET, Html, bind, esc, prop, put

FIT = "fit"
EXTERIOR = ("X", "Y", "Z", "ω", "φ", "κ")
HINTS = {
    "c": "principal distance [mm]", "xp": "principal point to the right [mm]", "yp": "principal point upwards [mm]",
    "k1": "radial distortion [mm⁻²]", "k2": "radial distortion [mm⁻⁴]", "k3": "radial distortion [mm⁻⁶]",
    "p1": "decentring [mm⁻¹]", "p2": "decentring [mm⁻¹]", "b1": "affinity of the axes", "b2": "shear of the axes",
}
DRAWN = (
    ("alone", "Only the bundle", "Draw the bundle in place of the images oriented one by one, the Orientation tab's."),
    ("draw_points", "Bundle points", "Object points as adjusted, coloured as chosen."),
    ("draw_rays", "Bundle rays", "From the chosen image to its points."),
    ("draw_vectors", "Bundle vectors", "From given to adjusted place of control and check points, exaggerated [m]."),
    ("draw_ellipsoids", "Bundle ellipsoids", "95 % error ellipsoids of centres and points, a priori, exaggerated; last row."),
)


class BundlePanel:
    """Draws the bundle; emits what to adjust, how to draw it, run and stop."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._wire, self._emit = desk.wire, emit
        self._choices(desk)
        self._run = gui.add_button("Run bundle", hint="Adjust all images together; the scene follows row by row.")
        self._run.on_click(lambda _: emit(RunBundle()))
        self._stop = gui.add_button("Stop bundle", hint="Stop; the rows so far stay and can be stepped through.", color=QUIET)
        self._stop.on_click(lambda _: emit(StopBundle()))
        self._on = gui.add_button("Continue bundle", hint="Go on from the row shown; later rows are made anew.", color=QUIET)
        self._on.on_click(lambda _: emit(RunBundle(on=True)))
        follow = gui.add_button("Follow run", hint="Show the rows of the project's latest run, also of one that collinea adjust "
                                "is making now; go on from any of them.", color=QUIET)
        follow.on_click(lambda _: emit(FollowBundle()))
        self._text = Html(gui)
        self._hold = gui.add_button("Set bundle aside", hint="Keep it here while the next one runs, to see both beside each "
                                    "other.", color=QUIET)
        self._hold.on_click(lambda _: emit(HoldBundle()))
        self._away = gui.add_button("Put it away", hint="Forget the bundle that was set aside.", color=QUIET)
        self._away.on_click(lambda _: emit(HoldBundle(on=False)))
        self._beside = Html(gui)
        self._drawing(desk)
        self._legend = Html(gui)
        self._plots = Html(gui)
        self._tables = Html(gui)
        keep = gui.add_button("Keep bundle as a run", hint="Trace, result.json and recording in the project's folder runs/, as "
                              "collinea adjust leaves them.", color=QUIET)
        keep.on_click(lambda _: emit(KeepBundle()))
        show = gui.add_button("Bundle in rerun", hint="Keep it as a run and open its recording in rerun, beside the scene.",
                              color=QUIET)
        show.on_click(lambda _: emit(KeepBundle(open=True)))
        self._rerun = RerunPanel(desk.server, emit, desk.state, bundle_shown, "rerun of the bundle")
        self._opened = 0
        self._seen: tuple[Any, ...] = ()

    def _choices(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        room = desk.state().room(Bundle)
        with gui.add_folder("What to adjust"):
            made: dict[str, tuple[str, tuple[str, ...], str]] = {
                "model": ("Projection", MODELS, "Perspective, or Ono's orthogonal projection for long focal lengths."),
                "transform": ("Parallel rays", TRANSFORMS, "Orthogonal only: made parallel anew in every iteration, or kept as "
                              "the start makes them."),
                "datum": ("Datum from", DATUMS, "What gives place, attitude and scale: control; GPS/IMU priors; both; free: "
                          "inner constraints, least trace."),
                "start": ("Start values", STARTS, "Where the start comes from; auto takes whatever the project offers."),
                "shutter": ("Rolling shutter", SHUTTERS, "Images that move while they are read (readout_ms of the camera); auto: "
                            "where a gyroscope's record is there."),
                "loss": ("Robust loss", ROBUST, "Down-weights blunders; none: least squares. Danish is the strictest."),
            }
            self._chosen: dict[str, Any] = {}
            for name, (label, options, hint) in made.items():
                self._chosen[name] = gui.add_dropdown(label, options, initial_value=getattr(room, name), hint=hint)
                bind(self._chosen[name], emit, lambda value, name=name: SetBundle(name, value))
            self._images = gui.add_text("Images", room.images, hint="Names or patterns of the images that take part, such as "
                                        "DSC0023*, S1_*; empty: all.")
            bind(self._images, emit, lambda value: SetBundle("images", str(value)))
        with gui.add_folder("Free interior parameters", expand_by_default=False):
            every = gui.add_button_group("Free", ("all", "none"), hint="Adjust all ten parameters of every camera, or none.")

            @every.on_click
            async def _(event: Any) -> None:
                if every.value in ("all", "none"):
                    emit(FreeParameter(every.value))

            self._free = {p: gui.add_checkbox(f"Free {p}", p in room.free, hint=f"Adjust {HINTS[p]} of every camera.")
                          for p in PARAMETERS}
            for p, handle in self._free.items():
                bind(handle, emit, lambda value, p=p: FreeParameter(p, bool(value)))
            self._own = {p: gui.add_checkbox(f"Every image its own {p}", p in room.per_image,
                                             hint=f"Adjust {HINTS[p]} of every image by itself, not of the camera.")
                         for p in PARAMETERS}
            for p, handle in self._own.items():
                bind(handle, emit, lambda value, p=p: OfEveryImage(p, bool(value)))

    def _drawing(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        factors = (FIT, *(f"{v:g}" for v in FACTORS))
        with gui.add_folder("How to draw it", expand_by_default=False):
            self._colour = gui.add_dropdown("Bundle points by", COLOURED, hint="Colour of the object points [px] or [images].")
            bind(self._colour, emit, lambda value: SetBundle("colour", value))
            self._factors = {
                "vectors": gui.add_dropdown("Bundle vectors ×", factors, hint="Exaggeration of corrections and check errors "
                                            "[times]; a bar in the scene tells the scale."),
                "ellipsoid": gui.add_dropdown("Bundle ellipsoids ×", factors,
                                              hint="Exaggeration of the 95 % ellipsoids [times]; a bar tells the scale."),
            }
            for name, handle in self._factors.items():
                bind(handle, emit, lambda value, name=name: SetBundle(name, 0.0 if value == FIT else float(value)))
            self._shown = {name: gui.add_checkbox(label, True, hint=hint) for name, label, hint in DRAWN}
            for name, handle in self._shown.items():
                bind(handle, emit, lambda value, name=name: SetBundle(name, bool(value)))

    def draw(self, state: State) -> None:
        room = state.room(Bundle)
        for name, handle in self._chosen.items():
            put(handle, getattr(room, name))
        prop(self._chosen["transform"], "visible", room.model == "orthogonal")
        put(self._images, room.images)
        for p, handle in self._free.items():
            put(handle, p in room.free)
            put(self._own[p], p in room.per_image)
        prop(self._hold, "visible", room.result is not None and not room.task)
        prop(self._away, "visible", room.held is not None)
        prop(self._run, "disabled", bool(room.task))
        prop(self._stop, "visible", bool(room.task))
        prop(self._on, "visible", bool(room.rows) and not room.task and (room.result is None or state.row < room.steps))
        put(self._colour, room.colour)
        for name, handle in self._factors.items():
            put(handle, FIT if getattr(room, name) == 0 else f"{getattr(room, name):g}")
        for name, handle in self._shown.items():
            put(handle, getattr(room, name))
        seen = (room, state.row, state.image, state.point, state.block)
        if len(seen) != len(self._seen) or any(a is not b for a, b in zip(seen, self._seen, strict=True)):
            self._seen = seen
            self._text.set(f"<div {BOX}>{summary(state)}</div>")
            self._beside.set(_box(two_runs(state)))
            self._legend.set(_box(legend(state) + marks(state)))
            self._plots.set(_box(plots_html(state)))
            self._tables.set(_box(tables_html(state, self._wire)))
        if room.opened > self._opened and room.run:
            self._rerun.show(Path(room.run) / "recording.rrd", _lay(room))
        self._opened = room.opened
        self._rerun.follow(state)

    def close(self) -> None:
        self._rerun.close()


def _lay(room: Bundle) -> Lay:
    """How the recording of the bundle follows the scene."""
    block, layout, x, worst = room.block, room.layout, room.rows[-1].x, room.worst
    assert block is not None and layout is not None  # it was recorded

    def lay(now: Shown) -> bytes:
        from ..rerun_bundle import bundle_layout

        return bundle_layout(block, layout.manifest, x, worst, now)

    return lay


def _box(content: str) -> str:
    return f"<div {BOX}>{content}</div>" if content else ""


def plots_html(state: State) -> str:
    """Residuals of the chosen image and of its camera at the row shown; correlations at the last row."""
    room = state.room(Bundle)
    if not room.rows:
        return ""
    of, camera = image_vectors(state, state.image), camera_of(state, state.image)
    if of is None or camera is None or room.layout is None:
        inside = image_number(room, state.image) is not None
        why = "has residuals with the last row" if inside else "takes no part in the bundle"
        return f"<div {MUTED}>{esc(state.image)} {why}.</div>"
    rms = float(np.sqrt((of.v**2).sum(axis=1).mean())) if len(of.v) else 0.0
    parts = [_title(f"Residuals in {esc(state.image)}", f"{len(of.v)} points, rms {rms:.2f} px, observed − projected"),
             vectors_svg(of, state.point)]
    figures = camera_figures(state, camera)
    if figures is not None:
        name = esc(room.layout.cameras[camera])
        parts += [_title(f"Camera {name}: radial residual", "mean ± 2σ of rings, spread behind"), profile_svg(figures[0]),
                  _title(f"Camera {name}: mean residual field", "all images"), vectors_svg(figures[1])]
    result, k = judged(state), image_number(room, state.image)
    if result is not None and k is not None:
        parts += [_title(f"Correlations of {esc(state.image)}", "exterior orientation, percent"),
                  correlation_svg("Correlations of the exterior orientation", EXTERIOR, result.exterior[k])]
        own = room.layout.cameras[camera]
        mine = [i for i, (c, _) in enumerate(result.freed) if own == c or own.startswith(f"{c}@")]
        if mine:
            parts += [_title("Correlations of the interior", "percent"),
                      correlation_svg("Correlations of the interior orientation", tuple(result.freed[i][1] for i in mine),
                                      result.interior_covariance[np.ix_(mine, mine)])]
            names = tuple(result.freed[i][1] for i in mine)
            joint = together(result, state.image, k, mine)
            parts += [_title(f"Correlations of {esc(state.image)} with its camera", "percent"),
                      correlation_svg("Joint correlations of exterior and interior orientation", (*EXTERIOR, *names), joint)]
    return "".join(parts)


def together(result: Judged, image: str, k: int, mine: list[int]) -> np.ndarray:
    """(6 + f, 6 + f) covariance of an image's exterior orientation and the freed parameters of its camera together."""
    cross = result.joint.get(image, np.zeros((6, len(mine))))
    return np.block([[result.exterior[k], cross], [cross.T, result.interior_covariance[np.ix_(mine, mine)]]])


def _title(words: str, more: str) -> str:
    return f'<div style="margin-top:6px"><b>{words}</b> <span {MUTED}>{more}</span></div>'


def tables_html(state: State, wire: Any) -> str:
    """Tables of what the bundle is worth."""
    room = state.room(Bundle)
    if room.result is None or room.layout is None:
        return ""
    gap = '<div style="height:8px"></div>'
    return gap.join(part for part in (
        components(room.result), interior_table(room.result, room.layout), suspects_table(room.result, wire),
        images_table(state, room.result, room.layout, wire), points_table(state, room.result, room.layout, wire)) if part)


TAB = Tab(
    "Bundle",
    BundlePanel,
    order=30,
    tasks=tasks,
    scene=scene,
    alone=alone,
    click=click,
    commands=(
        Command("Run bundle", RunBundle(), "B", hint="Adjust all images together."),
        Command("Stop bundle", StopBundle(), hint="The rows so far stay."),
        Command("Continue bundle", RunBundle(on=True), hint="From the row shown."),
        Command("Follow run", FollowBundle(), hint="Rows of the latest run, also while it is made."),
        Command("Set bundle aside", HoldBundle(), hint="To see the next one beside it."),
        Command("Put the bundle set aside away", HoldBundle(on=False)),
        *(Command(f"Bundle rolling shutter: {s}", SetBundle("shutter", s)) for s in SHUTTERS),
        *(Command(f"Bundle by the {m} model", SetBundle("model", m)) for m in MODELS),
        *(Command(f"Bundle datum: {d}", SetBundle("datum", d)) for d in DATUMS),
        Command("Free all interior parameters", FreeParameter("all")),
        Command("Fix all interior parameters", FreeParameter("none")),
    ),
)
