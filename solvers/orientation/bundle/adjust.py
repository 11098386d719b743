"""Bundle adjustment of a block: prepare the problem, let the engine step it, conclude with everything that judges it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from typing import Any, Protocol

import numpy as np

from ...adjustment import Iteration, Options, Trace, iterate, solve, thin
from ...adjustment.losses import LOSSES
from ...block import Block
from ...cameras import PARAMETERS
from ...errors import BadProject, DegenerateGeometry
from ...geometry import Exterior, LocalFrame
from ..single import camera_manifest
from .datum import Inner
from .given import BundleRequest, Given, given, network
from .network import Network
from .orthogonal import OrthogonalBundle, orthogonal
from .orthogonal_statistics import orthogonal_statistics
from .problem import DENSE, Bundle
from .rescue import FEET, Screened, exchanged, screen, unit_of
from .result import Adjusted, described
from .start import start as begin
from .statistics import datum_defects, statistics

BUNDLE = Options(max_iterations=60, max_trials=20, step_tolerance=1e-6, cost_tolerance=1e-13)

ROBUST = replace(BUNDLE, max_iterations=200, step_tolerance=1e-4, cost_tolerance=1e-10)
"""Reweighting converges in a straight line, not at once."""

FIXED_POINT = Options.gauss_newton(max_iterations=150, step_tolerance=1e-7)
AIMED = Options.gauss_newton(max_iterations=30, step_tolerance=1e-7)
FITS = 1.3
"""sigma0 below which a fixed point is not suspected to be a false one."""
MOST_LOST = 0.05
"""Share of the marks that may contradict the others and be left out."""
MOST_WRONG = 3
"""Control points that are left out one after the other, at most, to find those that are wrong."""
CLEAR = 20.0
"""Fall of the cost that chance does not make."""
BAD = 5.0
"""sigma0 from which the control is screened for points that contradict the network."""
LARGEST = 10 * DENSE
"""Elements of a design matrix beyond which the orthogonal model, which keeps it whole, refuses."""


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
    trouble: DegenerateGeometry | None = None
    result: Adjusted | None = None
    try:
        result = _adjusted(block, request, engine, watch)
    except DegenerateGeometry as error:
        trouble = error
    if result is not None and result.trace.converged and (result.sigma0 or 0.0) < BAD:
        if (result.sigma0 or 0.0) > FITS and (feet := _heights_in_feet(block, request, engine, result)):
            return replace(result, warnings=(feet, *result.warnings))
        return result
    return _rescued(block, request, engine, result, trouble, watch)


def _adjusted(block: Block, request: BundleRequest, engine: Options | None, watch: Watch | None = None,
              begun: Begun | None = None) -> Adjusted:
    start = prepare_bundle(block, request, begun)
    result = conclude_bundle(start, _run(start, engine or start.options, watch))
    swapped = exchanged(block, {o.image: o.exterior.centre for o in result.orientations})
    return replace(result, warnings=(*swapped, *result.warnings)) if swapped else result


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


def _rescued(block: Block, request: BundleRequest, engine: Options | None, result: Adjusted | None,
             trouble: DegenerateGeometry | None, watch: Watch | None = None) -> Adjusted:
    """The better of what there is and of a new beginning from the network alone, with what is wrong said first.

    Raises the first error where that is all there is.
    """
    if feet := _heights_in_feet(block, request, engine, result):
        if result is None:
            raise DegenerateGeometry(f"{trouble}; {feet}")
        return replace(result, warnings=(feet, *result.warnings))
    if result is not None and (said := _exchanged_marks(block, request, engine, result, _suspected(result))):
        return replace(result, warnings=(said, *result.warnings))
    wrong = screen(block, request) if request.datum in ("control", "both") else Screened((), ())
    if not wrong.names and result is not None and request.datum in ("control", "both"):
        wrong = _dropped(block, request, engine, result)
    failed = result is None or not result.trace.converged
    again: Adjusted | None = None
    if request.start == "auto" and (failed or wrong.names):
        clean = block
        for name in wrong.names:
            clean = clean.with_role(name, "check")
        for start in ("auto", "relative"):
            try:
                tried = _adjusted(clean, replace(request, start=start), engine, watch)  # type: ignore[arg-type]
            except DegenerateGeometry:
                continue
            if again is None or not again.trace.converged or tried.cost < again.cost:
                again = tried
            if again.trace.converged and (again.sigma0 or 0.0) < BAD:
                break
    if again is not None and again.trace.converged and (failed or (result is not None and again.cost < 0.5 * result.cost)):
        at = {p.name: p.xyz for p in again.points}
        said = [s + unit_of(block, n, at[n]) if n in at else s for n, s in zip(wrong.names, wrong.said, strict=False)]
        left = [f"left out of the control: {', '.join(wrong.names)}; correct points.csv"] if wrong.names else []
        return replace(again, warnings=(*said, *left, *again.warnings))
    if not wrong.names and request.loss is None:
        clean, said = _marks(block, request, engine, result)
        if clean is not None:
            return replace(clean, warnings=(said, *clean.warnings))
        if said and result is None:
            raise DegenerateGeometry(f"{trouble}; {said}")
        if said and result is not None:
            return replace(result, warnings=(said, *result.warnings))
    if result is None:
        assert trouble is not None
        raise DegenerateGeometry(f"{trouble}{'; ' if wrong.said else ''}{'; '.join(wrong.said)}")
    return replace(result, warnings=(*wrong.said, *result.warnings))


def _exchanged_marks(block: Block, request: BundleRequest, engine: Options | None, result: Adjusted | None,
                     pairs: list[tuple[str, str, str]]) -> str:
    """A sentence where two points of one image fit once their names are exchanged there, else nothing. pairs: image, points."""
    of = block.observations
    for name, a, b in pairs:
        image, j, k = block.image_index(name), block.point_index(a), block.point_index(b)
        here = of.image == image
        point = np.where(here & (of.point == j), k, np.where(here & (of.point == k), j, of.point))
        try:
            tried = _adjusted(replace(block, observations=replace(of, point=point)), request, engine)
        except (DegenerateGeometry, BadProject):
            continue
        better = result is None or (tried.cost < 0.1 * result.cost and tried.dof >= result.dof)
        if better and tried.trace.converged and (tried.sigma0 or 0.0) < BAD:
            before = f" instead of {result.sigma0:.3g}" if result is not None and result.sigma0 else ""
            return (f"points '{a}' and '{b}' look exchanged in image '{name}': with their names exchanged there, sigma0 is "
                    f"{tried.sigma0 or 0:.3g}{before}; correct observations.csv")
    return ""


def _suspected(result: Adjusted) -> list[tuple[str, str, str]]:
    """Image and points of the two worst pairs of suspects in the image of the worst one."""
    worst = list(result.suspects)
    if not result.trace.converged or not worst or worst[0]["kind"] != "image":
        return []
    return [(worst[0]["image"], worst[0]["point"], s["point"]) for s in worst[1:] if s.get("image") == worst[0]["image"]][:2]


def _marks(block: Block, request: BundleRequest, engine: Options | None,
           result: Adjusted | None) -> tuple[Adjusted | None, str]:
    """What a robust loss finds where least squares failed: marks that are exchanged (in words), or marks that contradict the
    rest, with the bundle without them."""
    try:
        robust = _adjusted(block, replace(request, loss="cauchy"), engine)
    except DegenerateGeometry:
        return None, ""
    lost = [(o.image, point) for o in robust.orientations for point in o.rejected]
    if not robust.trace.converged or not lost or len(lost) > MOST_LOST * len(block.observations):
        return None, ""
    pairs = [(o.image, *pair) for o in robust.orientations for pair in combinations(o.rejected[:4], 2)]
    if said := _exchanged_marks(block, request, engine, result, pairs[:6]):
        return None, said
    of, names = block.observations, block.points.names
    keep = np.array([(block.images[i].name, names[j]) not in set(lost) for i, j in zip(of.image, of.point, strict=True)])
    part = replace(of, image=of.image[keep], point=of.point[keep], pixel=of.pixel[keep], sigma=of.sigma[keep])
    try:
        clean = _adjusted(replace(block, observations=part), request, engine)
    except DegenerateGeometry:
        return None, ""
    if not clean.trace.converged or (clean.sigma0 or 0.0) > BAD:
        return None, ""
    shown = ", ".join(f"'{p}' in '{i}'" for i, p in lost[:6]) + (" ..." if len(lost) > 6 else "")
    return clean, f"left out, because they contradict all others: the marks of {shown}; correct observations.csv"


def _dropped(block: Block, request: BundleRequest, engine: Options | None, result: Adjusted) -> Screened:
    """Where the network alone cannot judge: the control point that heads the suspects, and the next, left out until it fits."""
    names: list[str] = []
    now, left = result, block
    for _ in range(MOST_WRONG):
        worst = next((s["point"] for s in now.suspects if s["kind"] == "control" and s["point"] not in names), None)
        if worst is None:
            break
        names.append(worst)
        left = left.with_role(worst, "check")
        try:
            now = _adjusted(left, request, engine)
        except DegenerateGeometry:
            break
        if now.trace.converged and (now.sigma0 or 0.0) < BAD and now.cost < 0.1 * result.cost:
            off = {p.name: float(np.linalg.norm(p.off)) for p in now.points}
            wrong = [n for n in names if off.get(n, 0.0) > 0]
            return Screened(tuple(wrong), tuple(f"control point '{n}' does not fit the others by {off[n]:.3g} m" for n in wrong))
    return Screened((), ())


def _heights_in_feet(block: Block, request: BundleRequest, engine: Options | None, result: Adjusted | None) -> str:
    """A sentence where the bundle fits once the heights of all control points are taken as feet, else nothing."""
    control = np.array(block.points.role) == "control"
    if request.datum not in ("control", "both") or request.model != "perspective" or not control.any():
        return ""
    xyz = block.points.xyz.copy()
    xyz[control, 2] *= FEET
    try:
        tried = _adjusted(replace(block, points=replace(block.points, xyz=xyz)), request, engine)
    except DegenerateGeometry:
        return ""
    better = tried.trace.converged and (tried.sigma0 or 0.0) < BAD and (result is None or tried.dof >= result.dof)
    if not better or (result is not None and result.trace.converged
                      and (tried.cost > 0.5 * result.cost or result.cost - tried.cost < CLEAR)):
        return ""
    before = f" instead of {result.sigma0:.3g}" if result is not None and result.sigma0 else ""
    return (f"the heights of all control points look given in feet: taken as feet, sigma0 is {tried.sigma0 or 0:.3g}{before}; "
            "correct Z in points.csv")


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
    problem = Bundle.of(net, inner, None if request.compiled is None else not request.compiled)
    if inner:
        x0 = inner.restored(net, x0)
    elif named := datum_defects(problem, x0):
        raise DegenerateGeometry(f"{block.name}: control and priors leave free {'; '.join(named)}; add control, or take "
                                 "--datum free")
    _connected(block, net, inner is None)
    if problem.dof < 0:
        raise DegenerateGeometry(f"{block.name}: {net.observed} observations cannot determine {net.observed - problem.dof} "
                                 "unknowns; measure more points or free fewer interior parameters")
    if request.model == "orthogonal":
        if request.rolling_shutter not in ("none", "auto"):
            raise BadProject("the orthogonal model knows no rolling shutter; take --model perspective")
        return _orthogonal(problem, x0, data, (*left, *said))
    x0 = x0 if begun else _softened(problem, x0)
    return BundleStart(problem, x0, ROBUST if request.loss else BUNDLE, _manifest(data, net), data, (*left, *said))


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


def _orthogonal(perspective: Bundle, x0: np.ndarray, data: Given, said: tuple[str, ...]) -> BundleStart:
    """The orthogonal twin of a bundle, its transformation iterated or frozen, and what to know of it.

    Raises BadProject where other interior parameters than c are free, DegenerateGeometry where the network is too large.
    """
    net, request = perspective.network, data.request
    others = [p for free in net.free for p in free if p != "c"]
    if others:
        raise BadProject(f"the orthogonal model can free the principal distance c only, not {', '.join(dict.fromkeys(others))}; "
                         "take --model perspective for them")
    m, f, live = net.sizes
    if 2 * len(net.image) * (6 * m + f + 3 * live) > LARGEST:
        raise DegenerateGeometry(f"{data.block.name}: {len(net.image)} observations of {live} points are too many for the "
                                 "orthogonal model, which is for small networks of long focal length; take --model perspective")
    x0 = _softened(perspective, x0)
    problem = orthogonal(net, perspective, x0, request.transform == "frozen")
    warnings = list(said)
    if problem.extra:
        warnings.append(f"beyond the seven of the datum, {problem.extra} combination(s) of unknowns stay free in the orthogonal "
                        "network (a stereo pair does not determine the angle between its rays: depths may be deformed); held as "
                        "the start values have them. Take a third image, control or --model perspective")
    manifest = {**_manifest(data, net), "model": "orthogonal"}
    if problem.frozen:
        return BundleStart(problem, x0, ROBUST if request.loss else BUNDLE, manifest, data, tuple(warnings))
    options = FIXED_POINT if request.loss is None else replace(FIXED_POINT, step_tolerance=1e-4)
    last = solve(problem, x0, options).last
    if last.stop == "step" and (problem.extra or not _far_off(last.cost, problem, perspective, last.x)):
        return BundleStart(problem, x0, options, manifest, data, tuple(warnings))
    why = "does not settle" if last.stop != "step" else "settles at a false fixed point"
    better = solve(perspective, x0, BUNDLE).last.x
    for other, how in ((problem, options), (replace(problem, aimed=True), AIMED)):
        end = solve(other, better, how).last
        if end.stop == "step" and not _far_off(end.cost, problem, perspective, end.x):
            aimed = " and every step was aimed at the fixed point" if other is not problem else ""
            warnings.append(f"repeating the transformation {why} from these start values: it was begun at the perspective "
                            f"solution{aimed}")
            return BundleStart(other, better, how, manifest, data, tuple(warnings))
    warnings.append(f"repeating the transformation {why}: the orthogonal model is for narrow fields of view and objects with "
                    "relief; take --model perspective")
    return BundleStart(problem, x0, options, manifest, data, tuple(warnings))


def _far_off(cost: float, problem: OrthogonalBundle, perspective: Bundle, x: np.ndarray) -> bool:
    """Whether the perspective model, from a fixed point x, falls to a far lower cost: then it is a false one."""
    if problem.dof < 1 or 2 * cost / problem.dof < FITS**2:
        return False
    best = solve(perspective, x, replace(BUNDLE, max_iterations=15)).last.cost
    return cost > 2 * best + 5 * np.sqrt(2 * problem.dof)


def _false_fixed_point(problem: OrthogonalBundle, x: np.ndarray) -> list[str]:
    """What to say of a solution that is a false fixed point."""
    plain = Bundle(problem.network, problem.inner)
    if problem.frozen or problem.extra or not _far_off(plain.cost(x), problem, plain, x):
        return []
    return ["false fixed point: the perspective model, from the same values, has far smaller residuals; do not use, take --model "
            "perspective"]


def _softened(problem: Bundle, x0: np.ndarray) -> np.ndarray:
    """Where a loss begins: losses that forget far observations would forget all at a crude start, so Huber's goes first."""
    if problem.network.loss in (None, "huber"):
        return x0
    gentle = Bundle.of(replace(problem.network, loss="huber"), problem.inner, problem.compiled is None)
    last = solve(gentle, x0, replace(BUNDLE, step_tolerance=0.01)).last
    return last.x if np.isfinite(last.cost) else x0


def conclude_bundle(start: BundleStart, trace: Trace) -> Adjusted:
    """The adjusted block at the end of a trace, with covariances, redundancy, control and check points and warnings."""
    problem, x = start.problem, trace.last.x
    if isinstance(problem, OrthogonalBundle):
        said = (*start.warnings, *_false_fixed_point(problem, x))
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


def _connected(block: Block, net: Network, held: bool) -> None:
    """Refuse a free network in pieces, and pieces that share no point and have no datum of their own."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    m, n = len(net.images), len(net.points)
    free = net.point < net.unknown
    graph = csr_matrix((np.ones(int(free.sum())), (net.image[free], m + net.point[free])), shape=(m + n, m + n))
    count, label = connected_components(graph, directed=False)
    parts = [np.flatnonzero(label[:m] == k) for k in range(count) if (label[:m] == k).any()]
    if len(parts) < 2:
        return
    for part in parts:
        control = np.asarray(np.isfinite(net.known).all(axis=1))
        seen = np.unique(net.point[np.isin(net.image, part)])
        if held and (control[seen].sum() >= 3 or any(net.priors[i] is not None for i in part)):
            continue
        smallest = min(parts, key=len)
        names = ", ".join(f"'{net.images[i]}'" for i in smallest[:6]) + (" ..." if len(smallest) > 6 else "")
        raise DegenerateGeometry(f"{block.name}: the block falls into {len(parts)} parts that share no point, one of them "
                                 f"image(s) {names}; measure tie points between them or give each part its own control")


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
