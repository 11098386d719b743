"""Where photos stand and what they see, by the best that is known: solutions, the bundle of the tie points, complete priors."""

from __future__ import annotations

import numpy as np

from solvers import Exterior
from solvers.cameras import project
from solvers.workflows_conjugate import View

from .matching_state import Matching
from .state import MODELS, State


def prior(state: State, image: str) -> Exterior | None:
    """The project's own approximate orientation of an image, where it is complete."""
    given = state.block.images[state.block.image_index(image)].prior
    if given is None or given.centre is None or given.angles is None:
        return None
    return Exterior.from_angles(*given.angles, centre=state.assets.frame.to_local(given.centre))


def position(state: State, name: str) -> np.ndarray | None:
    """Where the project's prior says that an image was taken (3,), in the local frame."""
    given = state.block.images[state.block.image_index(name)].prior
    return None if given is None or given.centre is None else state.assets.frame.to_local(given.centre)


def adjusted(state: State, image: str) -> Exterior | None:
    """The exterior orientation of an image in the local frame as solved, alone or in the bundle of the tie points."""
    solution = state.solution(MODELS[0], image)
    if solution is not None and solution.orientation is not None:
        return Exterior.from_vector(solution.rows[-1].x)
    network = state.room(Matching).network
    return None if network is None else network.exteriors.get(image)


def exterior_of(state: State, image: str) -> Exterior | None:
    """The exterior orientation of an image in the local frame, None where nothing tells it. A simulation's truth is not asked."""
    found = adjusted(state, image)
    return prior(state, image) if found is None else found


def view_of(state: State, image: str) -> View | None:
    """The image with both its orientations, and how well the exterior one is known where it is the project's approximate one."""
    exterior, solution = exterior_of(state, image), state.solution(MODELS[0], image)
    interior = state.block.camera_of(image)
    if solution is not None and solution.orientation is not None and solution.orientation.interior is not None:
        interior = solution.orientation.interior
    if exterior is None:
        return None
    given = state.block.images[state.block.image_index(image)].prior
    if adjusted(state, image) is not None or given is None:
        return View(image, interior, exterior)
    sigmas = [0.0 if s is None else float(np.max(s)) for s in (given.sigma_m, given.sigma_rad)]
    return View(image, interior, exterior, *sigmas)


def sees(state: State, image: str, point: str) -> tuple[float, float] | None:
    """Where a point is measured in an image, col, row."""
    block, of = state.block, state.block.observations
    at = np.flatnonzero((of.image == block.image_index(image)) & (of.point == block.point_index(point)))
    return (float(of.pixel[at[0], 0]), float(of.pixel[at[0], 1])) if len(at) else None


def where(state: State, image: str, point: str) -> tuple[float, float] | None:
    """Where an image should show a point of known coordinates, None where it does not or nobody knows."""
    view, xyz = view_of(state, image), state.block.points.xyz[state.block.point_index(point)]
    if view is None or not np.isfinite(xyz).all():
        return None
    pixel = project(view.interior, view.exterior, state.assets.frame.to_local(xyz)[None])[0]
    return (float(pixel[0]), float(pixel[1])) if np.isfinite(pixel).all() and view.interior.inside(pixel) else None
