"""Bundle adjustment of a block: prepare the problem, let the engine step it, conclude with everything that judges it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np

from ...adjustment import Iteration, Options, Trace, iterate, thin
from ...adjustment.losses import LOSSES
from ...block import Block
from ...cameras import PARAMETERS
from ...errors import BadProject, DegenerateGeometry
from ...geometry import Exterior, LocalFrame
from ..single import camera_manifest
from .carry import Carried
from .datum import Inner
from .given import BundleRequest, Given, given, network
from .level import levelled, line_of, said_of, turned
from .network import Network
from .orthogonal import OrthogonalBundle
from .orthogonal_start import BUNDLE, FITS, false_fixed_point, orthogonal_start, softened
from .orthogonal_statistics import orthogonal_statistics
from .parts import parts, told
from .problem import Bundle
from .remedy import BAD, heights_in_feet, remedied
from .rescue import control_in_feet, exchanged
from .result import Adjusted, described
from .start import start as begin
from .statistics import datum_defects, statistics

ROBUST = replace(BUNDLE, max_iterations=200, step_tolerance=1e-4, cost_tolerance=1e-10)
"""Reweighting converges in a straight line, not at once."""

SHIFT = 1e-3
"""Of its standard error: what the last step of a block placed by priors moves an unknown by, at most."""
COARSE = 10.0
"""Standard error of control, over that of an image point on the ground, from which control is coarse."""


class Watch(Protocol):
    """Who wants to see the rows while they are made."""

    def begin(self, manifest: Mapping[str, Any], x0: np.ndarray) -> None:
        """An adjustment begins, anew where the one before it failed."""
        ...

    def row(self, row: Iteration) -> None:
        """It has come so far."""
        ...


class Stopped(KeyboardInterrupt):
    """A person stopped the adjustment (Ctrl+C); trace: the rows so far."""

    def __init__(self, trace: Trace) -> None:
        super().__init__("stopped by Ctrl+C")
        self.trace = trace


@dataclass(frozen=True)
class Begun:
    """Where an earlier adjustment of the block is continued: its manifest, x of its first row and of the row to go on from."""

    manifest: Mapping[str, Any]
    first: np.ndarray
    x: np.ndarray


@dataclass(frozen=True)
class BundleStart:
    """A bundle ready to iterate, and what is needed to conclude from its trace."""

    problem: Bundle
    x0: np.ndarray
    options: Options
    manifest: dict[str, Any]
    data: Given
    warnings: tuple[str, ...]


def adjust(block: Block, request: BundleRequest | None = None, engine: Options | None = None, watch: Watch | None = None,
           begun: Begun | None = None, **options: Any) -> Adjusted:
    """Bundle adjustment of a block; options as in `BundleRequest`; engine: how to iterate, None for what suits it; watch: is
    shown every row as it is made; begun: an earlier adjustment to continue.

    Where it fails or fits badly, the network is oriented by its tie points alone to find what contradicts it; control that made
    it fail is left out, and said first. Raises BadProject, DegenerateGeometry, and Stopped where Ctrl+C ended it.
    """
    request = request or BundleRequest(**options)
    if request.model == "orthogonal" or begun is not None:
        return _adjusted(block, request, engine, watch, begun)

    def attempt(block: Block, request: BundleRequest) -> Adjusted:
        return _adjusted(block, request, engine)

    trouble: DegenerateGeometry | None = None
    result: Adjusted | None = None
    try:
        result = _adjusted(block, request, engine, watch)
    except DegenerateGeometry as error:
        trouble = error
    if result is not None and result.trace.converged and (result.sigma0 or 0.0) < BAD:
        if (result.sigma0 or 0.0) > FITS and (feet := heights_in_feet(block, request, attempt, result)):
            return replace(result, warnings=(feet, *result.warnings))
        return result
    return remedied(block, request, attempt, lambda b, r: _adjusted(b, r, engine, watch), result, trouble)


def _adjusted(block: Block, request: BundleRequest, engine: Options | None, watch: Watch | None = None,
              begun: Begun | None = None) -> Adjusted:
    start = prepare_bundle(block, request, begun)
    result = conclude_bundle(start, _run(start, engine or start.options, watch))
    centres = {o.image: o.exterior.centre for o in result.orientations}
    said = (*exchanged(block, centres), *control_in_feet(block, centres))
    return replace(result, warnings=(*said, *result.warnings)) if said else result


def _run(start: BundleStart, options: Options, watch: Watch | None) -> Trace:
    """The rows, those behind the last one thin. Raises Stopped."""
    rows: list[Iteration] = []
    if watch is not None:
        watch.begin(start.manifest, start.x0)
    try:
        for row in iterate(start.problem, start.x0, options):
            if rows:
                rows[-1] = thin(rows[-1])
            rows.append(row)
            if watch is not None:
                watch.row(row)
    except KeyboardInterrupt:
        if not rows:
            raise
        rows[-1] = replace(rows[-1], stop="stopped")
        raise Stopped(Trace(tuple(rows), start.manifest)) from None
    return Trace(tuple(rows), start.manifest)


def prepare_bundle(block: Block, request: BundleRequest, begun: Begun | None = None) -> BundleStart:
    """The problem of a request with its start, found without approximate values, or that of an earlier adjustment.

    Raises BadProject (unknown names, double measurements, missing priors) and DegenerateGeometry (no start, no datum, parts of
    the block that share nothing).
    """
    if request.loss is not None and request.loss not in LOSSES:
        raise BadProject(f"'{request.loss}' is not a robust loss; choose from {', '.join(LOSSES)}")
    data = given(block, request)
    poses, xyz, said = begin(data) if begun is None else _again(data, begun)
    net, x0, left = network(data, poses, xyz)
    first, x0 = (x0, x0) if begun is None else _further(data, net, x0, begun)
    inner = _inner(data, net, first) if request.datum == "free" else None
    kind = Carried if _weakly_placed(net, x0, request) else Bundle
    net, x0, rolled = _rolled(net, x0, request, begun, first)
    problem = kind.of(net, inner, None if request.compiled is None else not request.compiled)
    if inner:
        x0 = inner.restored(net, x0)
    elif named := datum_defects(problem, x0):
        raise DegenerateGeometry(f"{block.name}: {_loose(data, net) or f'control and priors leave free {_listed(named)}'}")
    left = [*rolled, *_connected(block, net, inner is None), *left]
    if problem.dof < 0:
        raise DegenerateGeometry(f"{block.name}: {net.observed} observations cannot determine {net.observed - problem.dof} "
                                 "unknowns; measure more points or free fewer interior parameters")
    if request.model == "orthogonal":
        if request.rolling_shutter not in ("none", "auto"):
            raise BadProject("the orthogonal model knows no rolling shutter; take --model perspective")
        twin, x0, how, told = orthogonal_start(problem, x0, data, ROBUST)
        return BundleStart(twin, x0, how, {**_manifest(data, net), "model": "orthogonal"}, data, (*left, *said, *told))
    x0 = x0 if begun else softened(problem, x0)
    options = ROBUST if request.loss else BUNDLE
    if isinstance(problem, Carried):
        x0, options = x0 if begun or rolled else problem.carried(x0), replace(options, shift_tolerance=SHIFT)
    return BundleStart(problem, x0, options, _manifest(data, net), data, (*left, *said))


def _weakly_placed(net: Network, x0: np.ndarray, request: BundleRequest) -> bool:
    """Whether priors, or control far coarser than what images show, and no fixed point say where a perspective network is."""
    if request.model != "perspective" or request.datum == "free" or net.unknown < len(net.points):
        return False
    if any(net.priors):
        return True
    weighted, (poses, _, points) = net.weight > 0, net.split(x0)
    if not weighted.any():
        return False
    ray = float(np.median(np.linalg.norm(poses[net.image, :3] - points[net.point], axis=1)))
    interior = net.interiors[int(net.camera[0])]
    seen = float(np.median(net.sigma)) * float(np.max(interior.pitch)) / interior.c * ray  # m on the ground
    return float(np.median(net.weight[weighted] ** -0.5)) > COARSE * seen


def _rolled(net: Network, x0: np.ndarray, request: BundleRequest, begun: Begun | None,
            first: np.ndarray) -> tuple[Network, np.ndarray, list[str]]:
    """The network and its start where positions on a line leave it free to roll: looking down, and that said."""
    line = line_of(net) if request.datum in ("prior", "both") else None
    if line is None:
        return net, x0, []
    if request.model != "perspective":
        return net, x0, [said_of(line, False)]
    if begun is None:
        x0 = Carried(net).carried(x0)
        first = turned(net, line, x0)
    held = levelled(net, line, first)
    x0 = first if held and begun is None else x0
    return held or net, x0, [said_of(line, held is not None)]


def _listed(named: list[str]) -> str:
    return f"{'; '.join(named)}; add control, or take --datum free"


def _loose(data: Given, net: Network) -> str:
    """What to do where there is no control at all, but priors that take no part; nothing elsewhere."""
    placed = data.block.placed
    if data.request.datum != "control" or not placed or (net.weight > 0).any() or net.unknown < len(net.points):
        return ""
    return (f"no control is measured, and the GPS positions of {placed} images take no part in the datum control; take --datum "
            "prior, or measure control points")


def _again(data: Given, begun: Begun) -> tuple[dict[int, Exterior], np.ndarray, list[str]]:
    """Poses and points of the first row of an earlier adjustment, as `start` gives them. Raises BadProject."""
    block, manifest = data.block, begun.manifest
    names = {image.name: k for k, image in enumerate(block.images)}
    points = {name: k for k, name in enumerate(block.points.names)}
    gone = [n for n in manifest["images"] if n not in names] + [n for n in manifest["points"] if n not in points]
    if gone:
        raise BadProject(f"{block.name}: '{gone[0]}' of the run is not in the project any more; adjust it anew")
    own = LocalFrame.around(np.asarray(manifest["origin"], float)[None], manifest["crs"], manifest["frame"])
    if np.abs(own.origin - data.frame.origin).max() > 1e-6:
        raise BadProject(f"{block.name}: its known coordinates have changed since the run; adjust it anew")
    m, k = len(manifest["images"]), len(manifest["cameras"])
    poses = {names[n]: Exterior.from_vector(row) for n, row in zip(manifest["images"], begun.first[:12 * m].reshape(m, 12),
                                                                   strict=True)}
    xyz = np.full((len(block.points), 3), np.nan)
    at = 12 * m + 10 * k
    xyz[[points[n] for n in manifest["points"]]] = begun.first[at:at + 3 * len(manifest["points"])].reshape(-1, 3)
    return poses, xyz, []


def _further(data: Given, net: Network, x0: np.ndarray, begun: Begun) -> tuple[np.ndarray, np.ndarray]:
    """x of the first row and of the row to go on from, its rotations made orthonormal. Raises BadProject where the
    project has changed."""
    said = begun.manifest
    if (list(net.images), list(net.points), list(net.cameras)) != (said["images"], said["points"], said["cameras"]) \
            or len(begun.x) != len(x0):
        raise BadProject(f"{data.block.name}: images, points or cameras that take part have changed since the run; adjust "
                         "it anew")
    x = np.array(begun.x, float)
    poses = x[:12 * len(net.images)].reshape(-1, 12)
    u, _, vt = np.linalg.svd(poses[:, 3:].reshape(-1, 3, 3))
    poses[:, 3:] = (u @ vt).reshape(-1, 9)
    return np.array(begun.first, float), x


def conclude_bundle(start: BundleStart, trace: Trace) -> Adjusted:
    """The adjusted block at the end of a trace, with covariances, redundancy, control and check points and warnings."""
    problem, x = start.problem, trace.last.x
    if isinstance(problem, OrthogonalBundle):
        said = (*start.warnings, *false_fixed_point(problem, x))
        return described(start.data, problem, trace, orthogonal_statistics(problem, x), said)
    return described(start.data, problem, trace, statistics(problem, x), start.warnings)


def _inner(data: Given, net: Network, x0: np.ndarray) -> Inner:
    """Inner constraints on the points whose coordinates are given, on all where fewer than three are or they lie on a line."""
    names = {name: j for j, name in enumerate(data.block.points.names)}
    reference = data.approximate[[names[n] for n in net.points]]
    rows = np.flatnonzero(np.isfinite(reference).all(axis=1))
    if len(rows) >= 3 and np.linalg.svd(reference[rows] - reference[rows].mean(axis=0), compute_uv=False)[1] > 1e-9:
        return Inner(rows, reference[rows], bool(len(net.extras.bars)))
    points = net.split(x0)[2]
    return Inner(np.arange(len(points)), points.copy(), bool(len(net.extras.bars)))


def _connected(block: Block, net: Network, held: bool) -> list[str]:
    """A sentence where parts of the block share no point but have a datum each. Refuses a free network in pieces, and pieces
    without a datum of their own."""
    free = net.point < net.unknown
    found = parts(net.image[free], net.point[free])
    if len(found) < 2:
        return []
    smallest = told([net.images[i] for i in found[-1]])
    known = np.asarray(np.isfinite(net.known).all(axis=1))
    for part in found:
        control = known[np.unique(net.point[np.isin(net.image, part)])].sum() >= 3
        if not held or not (control or any(net.priors[i] is not None for i in part)):
            raise DegenerateGeometry(f"{block.name}: the block falls into {len(found)} parts that share no point, one of them "
                                     f"image(s) {smallest}; measure tie points between them or give each part its own control")
    return [f"the block falls into {len(found)} parts that share no point, one of them image(s) {smallest}: each hangs on "
            "control and priors of its own, and nothing checks one against the other; measure tie points between them"]


def _manifest(data: Given, net: Network) -> dict[str, Any]:
    """JSON-able description of the trace: how to read x, and what was adjusted."""
    request = asdict(data.request)
    request["free"] = {c: list(f) for c, f in zip(net.cameras, net.free, strict=True)}
    return {
        "problem": "bundle", "model": "perspective", "images": list(net.images), "cameras": list(net.cameras),
        "camera_of": net.camera.tolist(),
        "interiors": [camera_manifest(i) for i in net.interiors], "points": list(net.points), "crs": data.block.crs,
        "frame": data.block.frame, "request": {k: v for k, v in asdict(data.request).items() if k != "compiled"},
        "origin": [float(v) for v in data.frame.origin], "options": request,
        "layout": {"images": "X, Y, Z, m11 .. m33 of every image", "cameras": ", ".join(PARAMETERS) + " of every camera",
                   "points": "X, Y, Z of every point"},
    }


def exteriors(trace: Trace, row: int = -1) -> Mapping[str, Exterior]:
    """Exterior orientations, in the local frame, of one row of a bundle's trace."""
    names, x = trace.manifest["images"], trace.rows[row].x
    return {name: Exterior.from_vector(x[12 * i:12 * i + 12]) for i, name in enumerate(names)}


__all__ = ["BUNDLE", "BundleRequest", "BundleStart", "adjust", "conclude_bundle", "exteriors", "prepare_bundle"]
