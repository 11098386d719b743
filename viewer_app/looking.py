"""Looking through an image: whose photo lies over the scene, and how opaque it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from .acting import Action, handles
from .state import State


@dataclass(frozen=True)
class Looking:
    """image: the one looked through, "" for none. opacity: of its photo over the scene, 0 to 1."""

    image: str = ""
    opacity: float = 0.6


@dataclass(frozen=True)
class Opacity(Action):
    """Of the photo over the scene, 0 to 1."""

    value: float


@handles(Opacity)
def _opacity(state: State, action: Opacity) -> State:
    value: Any = action.value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return state
    return state.with_room(replace(state.room(Looking), opacity=float(min(max(value, 0.0), 1.0))))


def look_through(state: State, image: str) -> State:
    """With an image's photo over the scene; "" for none. What is said tells the way back."""
    said = f"Looking through {image}; Esc returns." if image else ""
    return replace(state.with_room(replace(state.room(Looking), image=image)), message=said)


def looked_through(state: State) -> str:
    """The image looked through, "" for none: choosing another one ends it."""
    image = state.room(Looking).image
    return image if image == state.image else ""


