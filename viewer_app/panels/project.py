"""The Project tab: what is open, saved and told in rerun; and the Scene tab: what is shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from solvers import PhotogrammetryError
from solvers.io import write_project

from .. import theme
from ..actions import ChooseImage, Saved, Say, Show
from ..bridge import Wire
from ..desktop import PANELS, Desktop, SizePanel
from ..flying import Fly, asked_by, through
from ..looking import Looking, Opacity, looked_through
from ..overlay import overlay
from ..rerun_shown import shown
from ..state import MODELS, State, measured
from ..tabs import Command, Desk, Tab
from .rerun import RerunPanel
from .widgets import BOX, QUIET, Html, bind, esc, prop, put, swatch, table

SHOWN = (
    (
        "terrain",
        "Terrain",
        "The project's DEM, or a plane at the mean height of the GCPs; drawn half a symbol lower so that symbols stay visible.",
    ),
    ("labels", "Names", "Names of points and images."),
    ("photos", "Photos", "The photos in the image planes of the perspective solutions."),
    ("perspective", "Perspective", "Perspective solutions."),
    ("orthogonal", "Orthogonal", "Orthogonal solutions."),
    ("rays", "Rays", "From the chosen image's centre through its image points to the ground."),
    (
        "bundle",
        "Parallel bundle",
        "The orthogonal model: parallel rays to the average plane, then the plane seen in perspective.",
    ),
    ("residuals", "Residuals", "At each GCP, from the point to its observed ray, exaggerated."),
    ("ellipsoids", "Ellipsoids", "95 % error ellipsoids of the centres, a priori, exaggerated."),
    ("initial", "Initial value", "Where the adjustment of the chosen image began."),
    (
        "georeferenced",
        "Georeferenced",
        "Onboard GPS/IMU orientations, where the project has them: of the chosen image, and of images without a solution.",
    ),
    (
        "printed",
        "Printed form",
        "One orthogonal pass through the chosen image's prior in the papers' own printed form, dashed.",
    ),
    (
        "compared",
        "Compared",
        "The chosen image's other solutions with the prior, dashed, their ellipsoids and differences (tab Compare).",
    ),
    ("truth", "Truth", "The true orientations of a simulated project."),
)
Way = Callable[[viser.ClientHandle | None], None]


class ProjectPanel:
    """Draws the project in words; emits what to show."""

    def __init__(self, desk: Desk) -> None:
        gui, emit, self._desk, self._wire = desk.gui, desk.emit, desk, desk.wire
        self._rerun = RerunPanel(desk.server, emit, desk.state, shown, "rerun")
        self._text = Html(gui)
        self._drawn: tuple[object, ...] = ()
        for label, (hint, way) in self._ways().items():
            button = gui.add_button(label, hint=hint, color=None if label == "Save project" else QUIET)
            button.on_click(lambda event, way=way: way(event.client))
        self._dark = gui.add_checkbox("Dark", False, hint="Dark or light colours, for every browser of this viewer.")
        bind(self._dark, emit, lambda value: Show("dark", bool(value)))
        self._width = gui.add_dropdown(
            "Panel width", PANELS, hint="Of this panel, for tables and pairs of photos; its edge can be dragged as well. Key: T."
        )
        bind(self._width, emit, SizePanel)

    def _ways(self) -> dict[str, tuple[str, Way]]:
        """Buttons: label, hint and what is done for the browser that asked."""
        return {
            "Open in rerun": ("The run of every image with rerun's own timeline, in a panel beside the scene.", self._rerun.open),
            "Save project": ("Write points, observations and project.toml into the project folder.", self._save),
        }

    def _save(self, client: viser.ClientHandle | None) -> None:
        state = self._desk.state()
        if state.assets.folder is None:
            self._desk.emit(Say("This project has no folder; open one with collinea view PROJECT."))
            return
        try:
            write_project(state.block, state.assets.folder)
        except (PhotogrammetryError, OSError) as error:
            self._desk.emit(Say(f"The project was not saved: {error}"))
            return
        self._desk.emit(Saved(state.block, str(state.assets.folder)))

    def close(self) -> None:
        self._rerun.close()

    def draw(self, state: State) -> None:
        put(self._dark, state.view.dark)
        put(self._width, state.room(Desktop).panel)
        self._rerun.follow(state)
        seen = (state.work, state.assets, state.image, state.view.dark)
        if seen != self._drawn:
            self._drawn = seen
            self._text.set(project_html(state, self._wire))


class ScenePanel:
    """What the scene shows and how much it exaggerates."""

    def __init__(self, desk: Desk) -> None:
        gui, emit = desk.gui, desk.emit
        self._vectors = gui.add_slider(
            "Residuals ×", 1.0, 1000.0, 1.0, 200.0, hint="Exaggeration of the residual vectors at the GCPs, in object space."
        )
        self._ellipsoid = gui.add_slider(
            "Ellipsoids ×", 1.0, 1000.0, 1.0, 100.0, hint="Exaggeration of the 95 % error ellipsoids."
        )
        bind(self._vectors, emit, lambda value: Show("vectors", float(value)))
        bind(self._ellipsoid, emit, lambda value: Show("ellipsoid", float(value)))
        self._opacity = gui.add_slider(
            "Photo opacity", 0.0, 1.0, 0.05, 0.6, hint="Of the photo over the scene while you look through it: 0 to 1, no unit."
        )
        bind(self._opacity, emit, lambda value: Opacity(float(value)))
        self._through = gui.add_button(
            "Look through", hint="Your view goes into the chosen image's perspective centre, its photo over the scene. Key: L."
        )
        self._through.on_click(lambda event: emit(asked_by(through(desk.state()), event.client_id)))
        self._shown = {name: gui.add_checkbox(label, name != "compared", hint=hint) for name, label, hint in SHOWN}
        for name, handle in self._shown.items():
            bind(handle, emit, lambda value, name=name: Show(name, bool(value)))

    def draw(self, state: State) -> None:
        for handle, value in ((self._vectors, state.view.vectors), (self._ellipsoid, state.view.ellipsoid)):
            prop(handle, "max", max(1000.0, value))
            put(handle, max(value, 1.0))
        put(self._opacity, state.room(Looking).opacity)
        prop(self._through, "label", "Back to the scene" if looked_through(state) else "Look through")
        for name, handle in self._shown.items():
            put(handle, getattr(state.view, name))


def project_html(state: State, wire: Wire) -> str:
    """The project and its images with their state."""
    block, frame = state.block, state.assets.frame
    roles = [f"{block.points.role.count(r)} {r}" for r in ("control", "check", "tie") if r in block.points.role]
    origin = ", ".join(f"{v:.0f}" for v in frame.origin)
    facts = [
        f"<b>{esc(block.name)}</b>",
        f"{len(block.images)} images, {len(block.points)} points ({', '.join(roles) or 'none'}), "
        f"{len(block.observations)} observations",
        f"crs {esc(block.crs)}, metres; scene origin {origin}",
    ]
    for name, c in block.cameras.items():
        facts.append(f"camera {esc(name)}: c {c.c:g} mm, {c.width} × {c.height} px of {c.pitch[0] * 1000:.4g} µm")
    rows = []
    counts = measured(block)
    for image in block.images[:200]:
        seen = counts[image.name]
        good = [s.orientation.rms_px if (s := state.solution(m, image.name)) and s.orientation else None for m in MODELS]
        state_of = [f"{v:.2f}" if v is not None else "–" for v in good]
        weight = 'style="font-weight:600"' if image.name == state.image else ""
        rows.append(
            (f"{wire.attributes('image', image.name, 'choose ' + image.name)} {weight}", (esc(image.name), str(seen), *state_of))
        )
    head = ("image", "points", *(f"{swatch(theme.MODELS[m])}rms px" for m in MODELS))
    lines = "".join(f"<div>{f}</div>" for f in facts)
    return f'<div {BOX}>{lines}<div style="height:6px"></div>{table(head, rows, "Images", 200)}</div>'


def _heard_image(state: State, value: Any) -> ChooseImage | None:
    return ChooseImage(value) if isinstance(value, str) else None


TAB = (
    Tab(
        "Project",
        ProjectPanel,
        order=90,
        heard={"image": _heard_image},
        commands=(Command("Panel width: next", SizePanel(), "T", hint="Wider, very wide, as the page has it."),),
    ),
    Tab(
        "Scene",
        ScenePanel,
        place="below",
        order=30,
        scene=overlay,
        commands=(
            Command("Look at all there is", Fly("home", ""), "H", hint="The first view, beside the panels."),
            Command("Look through the image, or back", through, "L", hint="A click on a frustum does the same; Esc returns."),
        ),
    ),
)
