"""A run kept beside those that follow: its traces are stepped on the same slider, drawn thin and pale."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from solvers import Exterior

from . import theme
from .acting import Action, follow, handles
from .scene import frustum_depth, pale
from .state import MODELS, Solution, State
from .values import Frustum, Scene


@dataclass(frozen=True, eq=False)
class KeptRun:
    """The solutions of an image by model as they were when they were kept; none: nothing is kept."""

    image: str = ""
    solutions: Mapping[str, Solution] = field(default_factory=dict)

    def steps_of(self, image: str) -> int:
        """Last row of its traces where that image is shown, else 0."""
        return max((len(s.rows) - 1 for s in self.solutions.values()), default=0) if image == self.image else 0


@dataclass(frozen=True)
class KeepRun(Action):
    """Keep the chosen image's run as it is now, or forget the one kept."""

    on: bool = True


@handles(KeepRun)
def _keep(state: State, action: KeepRun) -> State:
    found = {m: s for m in MODELS if (s := state.solution(m)) and s.rows}
    if action.on is True and not found:
        return state
    return follow(state.with_room(KeptRun(state.image, found) if action.on is True else KeptRun()))


def kept_of(state: State) -> dict[str, Solution]:
    """The kept solutions of the chosen image, by model."""
    room = state.room(KeptRun)
    return dict(room.solutions) if room.image == state.image else {}


def scene(state: State) -> Scene:
    """Where the kept run has the chosen image at the row shown."""
    found: Scene = {}
    for model, solution in kept_of(state).items():
        if getattr(state.view, model):
            camera = state.block.camera_of(state.image)
            px, py = camera.pitch
            lens = 2 * float(np.arctan(camera.height * py / 2 / camera.c)), camera.width * px / (camera.height * py)
            exterior = Exterior.from_vector(solution.rows[state.row_of(solution)].x)
            size = frustum_depth(state) * (0.9 if model == "perspective" else 1.1)
            colour = pale(theme.MODELS[model], state.view.dark)
            found[f"/images/{state.image.replace('/', '_')}/{model}/kept"] = Frustum(exterior, *lens, size, colour, 1.0)
    return found
