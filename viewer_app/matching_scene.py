"""Tie points to be seen: their colours by rays or residual, their places in the scene, the photos that only they orient."""

from __future__ import annotations

import numpy as np

from solvers import Block

from . import theme
from .ground import nice, symbol_size
from .kept import by_identity
from .matching_state import COLOURS, Matching, Network
from .scene import frustum_depth
from .sighting import prior
from .state import MODELS, State
from .theme import Colour
from .values import Frustum, Label, PointCloud, Scene

RAYS = {2: (230, 159, 0), 3: (86, 180, 233), 4: (0, 158, 115), 5: (240, 228, 66)}
"""Colours of points by how many photos see them, 5 and more alike (Okabe & Ito 2008)."""
SCALE = np.array([(86, 180, 233), (240, 228, 66), (213, 94, 0)], float)
"""Colours of residuals from none to the legend's largest: sky blue, yellow, vermilion, seen on photos and on either ground."""
UNKNOWN: Colour = theme.INITIAL


def tie_colours(state: State) -> dict[int, Colour]:
    """Colour of every tie point, by its index in the block's points."""
    return _colours(state.block, state.room(Matching).network, state.room(Matching).colour)


@by_identity(4)
def _colours(block: Block, network: Network | None, by: str) -> dict[int, Colour]:
    if by not in COLOURS or by == "none":
        return {}
    ties = np.flatnonzero(np.array([r == "tie" for r in block.points.role], bool))
    if by == "number of rays":
        rays = np.bincount(block.observations.point, minlength=len(block.points))
        return {int(j): RAYS.get(min(int(rays[j]), 5), UNKNOWN) for j in ties}
    rms = {} if network is None else dict(zip(network.names, network.rms, strict=True))
    most = largest(network)
    return {int(j): _scaled(rms.get(block.points.names[j], np.nan), most) for j in ties}


def largest(network: Network | None) -> float:
    """Residual [px] at the bright end of the scale: all but the worst twentieth of the points lie below it."""
    known = np.empty(0) if network is None else network.rms[np.isfinite(network.rms)]
    return max(float(np.percentile(known, 95)) if len(known) else 1.0, 0.1)


def _scaled(value: float, most: float) -> Colour:
    if not np.isfinite(value):
        return UNKNOWN
    t = min(value / most, 1.0) * (len(SCALE) - 1)
    k = min(int(t), len(SCALE) - 2)
    r, g, b = (round(float(c)) for c in SCALE[k] + (t - k) * (SCALE[k + 1] - SCALE[k]))
    return r, g, b


def scene(state: State) -> Scene:
    """Tie points where the bundle of the tab has placed them; frustums of photos that nothing else orients."""
    m, found = state.room(Matching), Scene()
    network = m.network
    if network is None:
        return found
    cloud = _cloud(state.block, network, m.colour)
    if cloud is not None:
        found["/ties/points"] = PointCloud(*cloud, 0.3 * symbol_size(state))
    depth = max(frustum_depth(state), _depth(network))
    for image in state.block.images:
        exterior = network.exteriors.get(image.name)
        others = prior(state, image.name) or any(state.exterior(model, image.name) for model in MODELS)
        if exterior is None or others:
            continue
        interior, photo = state.block.camera_of(image.name), state.assets.photos.get(image.name)
        px, py = interior.pitch
        lens = 2 * float(np.arctan(interior.height * py / 2 / interior.c)), interior.width * px / (interior.height * py)
        path = f"/ties/images/{image.name.replace('/', '_')}"
        thumbnail = photo.thumbnail if photo and state.view.photos else None
        thick = 3.0 if image.name in (m.first, m.second) else 1.5
        found[f"{path}/camera"] = Frustum(exterior, *lens, depth, theme.PERSPECTIVE, thick, thumbnail)
        if state.view.labels:
            found[f"{path}/label"] = Label(image.name, exterior.centre + np.array([0, 0, 0.35 * depth]), 0.9, "bottom-center")
    return found


@by_identity(2)
def _depth(network: Network) -> float:
    """Depth (m) at which image planes are drawn: a twelfth of the way to the tie points."""
    if not len(network.xyz) or not network.exteriors:
        return 0.0
    middle = np.median(network.xyz, axis=0)
    return nice(max(0.08 * float(np.median([np.linalg.norm(e.centre - middle) for e in network.exteriors.values()])), 1e-3))


@by_identity(4)
def _cloud(block: Block, network: Network, by: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions (n, 3) m and colours (n, 3) uint8 of the tie points placed, None where none is to be drawn."""
    colours = _colours(block, network, by)
    index = {block.points.names[j]: c for j, c in colours.items()}
    rows = [k for k, name in enumerate(network.names) if name in index]
    if not rows:
        return None
    return network.xyz[rows], np.array([index[network.names[k]] for k in rows], np.uint8)
