"""What a recording shows when it is opened: the same as the scene. Everything is in it; what the scene hides begins hidden, or,
where that is very much, is left out of the view."""

from __future__ import annotations

from dataclasses import dataclass

from .bundle_state import Bundle
from .state import State

LAYERS = ("perspective", "orthogonal", "initial", "georeferenced", "truth")
BUNDLE = {"draw_points": "/bundle/points", "draw_vectors": "/bundle/vectors", "draw_ellipsoids": "/bundle/ellipsoids"}
"""What the Bundle tab draws or not, and where it stands in a bundle's recording."""


@dataclass(frozen=True)
class Shown:
    """image: the chosen one, which comes first and has the rays; hidden: names of `LAYERS` and `BUNDLE`, "rays", "labels" and
    "residuals"; dark: the ground behind."""

    image: str = ""
    hidden: frozenset[str] = frozenset()
    dark: bool = False


EVERYTHING = Shown()


def shown(state: State) -> Shown:
    """What the recording of the images has of it: as the tab Scene has it, with the rays of the chosen image."""
    view = state.view
    hidden = {name for name in (*LAYERS, "rays", "labels", "residuals") if not getattr(view, name)}
    return Shown(state.image, frozenset(hidden), view.dark)


def bundle_shown(state: State) -> Shown:
    """What the recording of the bundle has of it: what the tabs Bundle and Scene both show."""
    room, view = state.room(Bundle), state.view
    both = {"draw_points": room.draw_points, "draw_vectors": room.draw_vectors and view.residuals,
            "draw_ellipsoids": room.draw_ellipsoids and view.ellipsoids, "labels": view.labels}
    return Shown("", frozenset(name for name, there in both.items() if not there), view.dark)
