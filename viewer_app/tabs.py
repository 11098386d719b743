"""How a tab plugs in: a file in `panels/` that says TAB = Tab(...) is found and wired; nothing else has to be edited.

CONTRIBUTING.md walks through it. `panels/compare.py` is a small one to follow.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np
import viser

from .acting import Action
from .bridge import Wire
from .state import State
from .tasks import Task
from .values import Scene


class Panel(Protocol):
    """What a tab makes: it keeps its controls and shows a state in them; it holds no truth."""

    def draw(self, state: State) -> None: ...


@dataclass(frozen=True, eq=False)
class Desk:
    """What a panel is given to build itself: the page's controls, a way to say what was done, and the wire for clickable HTML.

    state(): the state now, for ways out.
    """

    gui: viser.GuiApi
    server: viser.ViserServer
    emit: Callable[[Action], None]
    wire: Wire
    state: Callable[[], State]


@dataclass(frozen=True, eq=False)
class Command:
    """A line of the command palette (Ctrl+K), with a key where there is one.

    act: an action, or a function of the state that gives one, or None where the command means nothing just now.
    key: as viser names it ("arrowleft", "space", "Z"); modifier: "cmd/ctrl", "shift" ...
    tab: over the scene, without which the command would show nothing: where it is not open yet, the command opens it instead.
    """

    label: str
    act: Action | Callable[[State], Action | None]
    key: str = ""
    modifier: str | None = None
    hint: str = ""
    tab: str = ""


Heard = Callable[[State, Any], Action | None]
Click = Callable[[State, np.ndarray, np.ndarray, float], Action | None]


@dataclass(frozen=True, eq=False)
class Tab:
    """One tab.

    place: "side" (the main panel) or "below" (the panel over the scene); order: from left to right.
    make: builds the panel inside its tab. commands: its lines of the palette and its keys.
    heard: what a message of the wire means, by its kind; value is text, or 2 or 4 numbers from 0 to 1, and anyone can send it.
    tasks: long work that is wanted now; done in another process, first things first. scene: what it adds to the scene.
    alone: whether that takes the place of the images oriented one by one.
    click: what a ray into the scene means, from (3,) along (3,), tolerance [rad]; asked before the core's own meaning.
    """

    name: str
    make: Callable[[Desk], Panel]
    place: Literal["side", "below"] = "side"
    order: int = 50
    commands: tuple[Command, ...] = ()
    heard: Mapping[str, Heard] = field(default_factory=dict)
    tasks: Callable[[State], tuple[Task, ...]] | None = None
    scene: Callable[[State], Scene] | None = None
    alone: Callable[[State], bool] | None = None
    click: Click | None = None


@lru_cache(maxsize=1)
def tabs() -> tuple[Tab, ...]:
    """Every tab there is, in the order shown."""
    from . import panels

    found: list[Tab] = []
    for name in sorted(m.name for m in pkgutil.iter_modules(panels.__path__)):
        said = getattr(importlib.import_module(f"{panels.__name__}.{name}"), "TAB", ())
        found += said if isinstance(said, tuple) else [said]
    return tuple(sorted(found, key=lambda tab: (tab.place != "side", tab.order, tab.name)))


def wanted_tasks(state: State) -> tuple[Task, ...]:
    """The long work of all tabs, the orientations first."""
    from .solving import solving_tasks

    return (*solving_tasks(state), *(task for tab in tabs() if tab.tasks for task in tab.tasks(state)))


def whole_scene(state: State) -> Scene:
    """All that is to be seen, the tabs' own included."""
    from .scene import scene

    found = dict(scene(state, images=not any(tab.alone and tab.alone(state) for tab in tabs())))
    for tab in tabs():
        if tab.scene is not None:
            found |= tab.scene(state)
    return found
