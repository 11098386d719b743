"""What a recording shows when it is opened: the same as the scene. Everything is in it; what the scene hides begins hidden."""

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
    """As the tabs Scene and Bundle have it."""
    view, room = state.view, state.room(Bundle)
    hidden = {name for name in (*LAYERS, "rays", "labels", "residuals") if not getattr(view, name)}
    hidden |= {name for name in BUNDLE if not getattr(room, name)}
    return Shown(state.image, frozenset(hidden), view.dark)
