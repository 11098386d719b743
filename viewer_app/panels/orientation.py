"""The Orientation tab: choose image and control, solve, and read both solutions with their precision."""

from __future__ import annotations

from typing import Any

import viser

from ..actions import Action, Cancel, ChooseImage, ChoosePoint, Redo, Set, Solve, SwitchPoint, Undo, UsePoints
from ..actions_points import SwitchRole
from ..flying import Fly
from ..looking import looked_through
from ..state import FORMS, PRIORS, State, listed
from ..tabs import Command, Desk, Tab
from .tables import orientation_table, point_in_images, point_table, words
from .widgets import QUIET, Emit, Html, bind, prop, put

EVERY, SOME = "all", "own choice"
BUTTONS = ("Solve again", "Cancel", "Undo", "Redo")


class OrientationPanel:
    """Draws the chosen image's orientations; emits choices, switches and solving."""

    def __init__(self, desk: Desk) -> None:
        gui, emit, state = desk.gui, desk.emit, desk.state()
        self._wire, self._emit = desk.wire, emit
        self._image = gui.add_dropdown(
            "Image", _names(state), hint="The photo to be oriented; a click on its frustum chooses it too."
        )
        bind(self._image, emit, ChooseImage)
        self._group = gui.add_dropdown(
            "GCPs used",
            (EVERY, SOME),
            hint="All ground control points, one cluster (column group of points.csv), or your own choice by clicking points.",
        )
        bind(self._group, emit, lambda value: UsePoints("" if value == EVERY else value) if value != SOME else None)
        buttons = gui.add_button_group(
            "Solution", BUTTONS, hint="Every change solves at once; Ctrl+Z and Ctrl+Y (or Ctrl+Shift+Z) undo and redo changes."
        )
        actions = dict(zip(BUTTONS, (Solve(), Cancel(), Undo(), Redo()), strict=True))

        @buttons.on_click
        async def _(event: viser.GuiEvent) -> None:
            if buttons.value in actions:
                emit(actions[buttons.value])

        self._table = Html(gui)
        self._words = Html(gui)
        self._points = Html(gui)
        self._point = gui.add_dropdown("Point", ("none",), hint="Chosen point, ringed in the scene and on the photo.")
        bind(self._point, emit, lambda value: ChoosePoint(None if value == "none" else value))
        self._switch = gui.add_button(
            "Switch point on or off",
            hint="Take the chosen point into the solution or out of it; it is solved at once.",
            color=QUIET,
        )
        self._switch.on_click(self._switched)
        self._role = gui.add_button(
            "Make point control or check",
            color=QUIET,
            hint="Control points hold the solution, check points only judge it; it is solved at once. Key: R.",
        )
        self._role.on_click(lambda _: emit(SwitchRole(self._point.value)) if self._point.value != "none" else None)
        self._seen = Html(gui)
        self._settings(gui, emit)

    def _settings(self, gui: viser.GuiApi, emit: Emit) -> None:
        with gui.add_folder("How to solve", expand_by_default=False):
            self._robust = gui.add_checkbox("Robust", False, hint="Find and leave out blunders in the observations.")
            self._prior = gui.add_dropdown(
                "Prior", PRIORS, hint="Onboard GPS/IMU of the project: not used, used as the start, or as weighted observations."
            )
            self._one_pass = gui.add_checkbox(
                "Orthogonal: one pass",
                False,
                hint="Transform once with the approximate orientation instead of to the fixed point.",
            )
            self._form = gui.add_dropdown(
                "Orthogonal: form", FORMS, hint="Depth form, valid for any attitude, or the papers' printed form."
            )
            self._recentre = gui.add_checkbox(
                "Orthogonal: re-centre", True, hint="Turn the bundle so that its mean ray is the projecting direction."
            )
        for name, handle in self._controls().items():
            bind(handle, emit, lambda value, name=name: Set(name, value))

    def _controls(self) -> dict[str, viser.GuiInputHandle]:
        return {
            "robust": self._robust,
            "prior": self._prior,
            "one_pass": self._one_pass,
            "form": self._form,
            "recentre": self._recentre,
        }

    def _switched(self, event: viser.GuiEvent) -> None:
        if self._point.value != "none":
            self._emit(SwitchPoint(self._point.value))

    def draw(self, state: State) -> None:
        put(self._image, state.image)
        groups = sorted(set(state.block.points.group) - {""})
        options = (EVERY, *groups, SOME)
        prop(self._group, "options", options)
        put(self._group, chosen_group(state))
        prop(self._point, "options", ("none", *listed(state.block.points, state.point)))
        put(self._point, state.point or "none")
        for handle in (self._switch, self._role):
            prop(handle, "disabled", state.point is None)
        for name, handle in self._controls().items():
            put(handle, getattr(state.work.settings, name))
        self._table.set(orientation_table(state))
        self._words.set(words(state))
        self._points.set(point_table(state, self._wire))
        self._seen.set(point_in_images(state, self._wire))


def chosen_group(state: State) -> str:
    """Which choice of points is in force: all, a group's name, or one's own."""
    points, off = state.block.points, state.work.off
    if not off:
        return EVERY
    on = {g for n, g in zip(points.names, points.group, strict=True) if n not in off} if points.group else set()
    if len(on) == 1:
        group = on.pop()
        if group and off == {n for n, g in zip(points.names, points.group, strict=True) if g != group}:
            return group
    return SOME


def _names(state: State) -> tuple[str, ...]:
    return tuple(i.name for i in state.block.images) or ("no image",)


def _heard_point(state: State, value: Any) -> SwitchPoint | None:
    return SwitchPoint(value) if isinstance(value, str) else None


def _escape(state: State) -> Action:
    """Back from a photo looked through; else stop solving."""
    return Fly("back", "") if looked_through(state) else Cancel()


TAB = Tab(
    "Orientation",
    OrientationPanel,
    order=10,
    commands=(
        Command("Undo", Undo(), "Z", "cmd/ctrl", "Take back the last change."),
        Command("Redo", Redo(), "Y", "cmd/ctrl", "Bring back the change taken back last."),
        Command("Redo, other key", Redo(), "Z", "cmd/ctrl+shift", "The same as Redo."),
        Command("Solve again", Solve(), "enter", "cmd/ctrl", "Solve everything anew."),
        Command("Cancel solving", _escape, "escape", hint="Stop; the next change solves again. Looking through a photo: back."),
    ),
    heard={"point": _heard_point},
)
