"""Orientation of one image: prepare the problem, let the engine step it, conclude with everything that judges it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from ..adjustment import Iteration, Options, Trace, precision, solve
from ..adjustment.reliability import chi_square, external
from ..block import Block, Prior
from ..cameras import Interior, project
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, LocalFrame, angle_derivatives
from .control import Control, control_of, geometry_warnings, require
from .initial import Candidate, apart, candidates
from .one_pass import one_pass_covariance
from .oriented import to_vector
from .orthogonal import Form, Orthogonal
from .orthogonal_c import OrthogonalFreeC
from .resection import COLUMNS, UNITS, PriorOrientation, Resection
from .result import Orientation
from .robust import inliers
from .steps import run
from .words import bad_fit, correlations, curved, snooping, undetermined

AMBIGUOUS = 6.0
"""Discrimination D below which two solutions cannot be told apart (docs/formulas.md 3.4)."""
PERSPECTIVE = Options(damping=1e-6)  # the starts are near: nearly Gauss-Newton from the beginning
ORTHOGONAL = Options.gauss_newton(max_iterations=100)
AIMED = Options.gauss_newton(max_iterations=20)
SAME = 1e-5
"""Attitudes closer than this [rad] are one solution."""


@dataclass(frozen=True)
class Request:
    """What to orient and how. points: names, None for all control of the image. free: interior parameters to adjust.

    prior: "none"; "initial" starts there and nowhere else; "weighted" observes it with its sigmas.
    one_pass, form, recentre: orthogonal model only; one pass takes the image's prior as approximate orientation.
    """

    image: str
    model: Literal["perspective", "orthogonal"] = "perspective"
    points: tuple[str, ...] | None = None
    robust: bool = False
    loss: Literal["huber", "cauchy", "danish"] = "danish"
    prior: Literal["none", "initial", "weighted"] = "none"
    one_pass: bool = False
    form: Form = "depth"
    recentre: bool = True
    free: tuple[str, ...] = ()


@dataclass(frozen=True)
class Start:
    """A problem ready to iterate, and what is needed to conclude from its trace."""

    problem: Resection | Orthogonal | OrthogonalFreeC
    x0: np.ndarray
    options: Options
    manifest: dict[str, Any]
    request: Request
    frame: LocalFrame
    control: Control
    used: np.ndarray
    others: tuple[Candidate, ...]
    approximate: PriorOrientation | None
    trace: Trace  # finding the start has run the adjustment to its end already
    found: tuple[Candidate, ...] = ()


def orient(block: Block, request: Request) -> Orientation:
    """Orientation of one image. Raises BadProject, DegenerateGeometry."""
    start = prepare(block, request)
    return conclude(start, Trace(tuple(rows(start)), start.manifest))


def rows(start: Start) -> Iterator[Iteration]:
    """The rows of a prepared orientation, one by one; the same as `iterate(start.problem, start.x0, start.options)`."""
    yield from start.trace.rows


def resect(block: Block, image: str, **options: Any) -> Orientation:
    """Exterior orientation of an image by the perspective model; options as in `Request`."""
    return orient(block, Request(image, "perspective", **options))


def resect_orthogonal(block: Block, image: str, **options: Any) -> Orientation:
    """Exterior orientation of an image by the orthogonal projection model; options as in `Request`."""
    return orient(block, Request(image, "orthogonal", **options))


def prepare(block: Block, request: Request, like: Start | None = None) -> Start:
    """The problem of a request with its start, found without approximate values unless the request names a prior.

    like: a start of the same image and control (of the other model, say), whose candidates serve again.
    Raises BadProject (unknown names, missing prior) and DegenerateGeometry (too few, collinear, behind the camera).
    """
    frame = LocalFrame.around(block.points.xyz, block.crs, block.frame)
    everything = control_of(block, request.image, frame, request.points)
    prior = _prior(block, request, frame)
    weighted = prior if request.prior == "weighted" and request.model == "perspective" else None
    if weighted is None or weighted.count < 6:
        require(everything, request.model)
    used = inliers(everything, request.loss) if request.robust else np.ones(len(everything), bool)
    control = everything.take(used)
    mean = control.points.mean(axis=0) if len(control) else np.zeros(3)
    found = list(like.found) if like is not None and like.control.same(everything) and (like.used == used).all() else []
    if len(control) >= 3 and not found:
        ideal = control.interior.ideal(control.pixels)
        found = [_moved(k, mean) for k in candidates(control.points - mean, ideal, control.interior.c, control.noise)]
    if not found and prior is None:
        raise DegenerateGeometry(f"image '{request.image}': no camera position has all {len(control)} control points in front "
                                 "of it; look for swapped axes, a wrong principal distance or mixed-up point names")
    manifest = _manifest(block, request, frame, control)
    if request.model == "perspective":
        problem, options = _perspective(request, control, found, prior, weighted), PERSPECTIVE
        trace, others = _first_run(problem, request, found, prior)
    else:
        problem, trace, options = _orthogonal(request, control, found, prior)
        others = found
    x0 = trace.rows[0].x
    manifest["initial"] = [float(v) for v in x0[:12]]
    trace = replace(trace, manifest=manifest)
    return Start(problem, x0, options, manifest, request, frame, everything, used, tuple(others), prior, trace, tuple(found))


def conclude(start: Start, trace: Trace) -> Orientation:
    """The orientation at the end of a trace, with covariance, residuals of every point, ambiguity and warnings in words."""
    chosen = _describe(start, trace)
    control = start.control.take(start.used)
    near = min(start.others, key=lambda k: apart(k.exterior, chosen.local), default=None)
    if start.request.model == "perspective" or near is None or _false(control, chosen.local, near.exterior):
        near = None  # else the perspective minimum beside an orthogonal solution, which leads there again
    warnings = list(chosen.warnings)
    others = [_alternative(start, k, control, chosen.local, warnings) for k in start.others if k is not near]
    others = [o for o in others if o is not None]
    d = discrimination(start, chosen.local, control)
    if d is not None and d < AMBIGUOUS:
        probability = _normal_probability(d / 2)
        warnings.append(f"ambiguous: a second solution fits almost as well (D = {d:.1f}); the one with the smaller residuals "
                        f"was chosen, right in about {probability:.0%} of such cases; both are reported")
    elif d is not None and control.planar:
        warnings.append("control lies in one plane: of the two reversal solutions the one with the smaller residuals "
                        f"was chosen (D = {d:.1f})")
    return replace(chosen, warnings=tuple(warnings), alternatives=tuple(others[:4]), discrimination=d)


# -- the two models -----------------------------------------------------------------------------------------------------


def _perspective(request: Request, control: Control, found: list[Candidate], prior: PriorOrientation | None,
                 weighted: PriorOrientation | None) -> Resection:
    at = found[0].exterior if found else prior.exterior if prior else None
    problem = Resection(control.interior, control.points, control.pixels, control.weights(at), request.free, weighted)
    if problem.dof < 0:
        raise DegenerateGeometry(f"image '{request.image}': {len(control)} control points cannot determine "
                                 f"{6 + len(request.free)} unknowns; measure more control or free fewer interior parameters")
    return problem


def _first_run(problem: Resection, request: Request, found: list[Candidate],
               prior: PriorOrientation | None) -> tuple[Trace, list[Candidate]]:
    """The adjustment from the crudest start that leads to the best minimum, and the candidates left over."""
    given = [] if prior is None else [Candidate(prior.exterior, prior.exterior, "prior", 0.0)]
    if request.prior != "none" and given and not np.isfinite(problem.cost(problem.start(given[0].exterior))):
        raise DegenerateGeometry(f"image '{request.image}': control points lie behind the camera of the prior; check its angles")
    if request.prior == "initial" and given:
        return run(problem, problem.start(given[0].exterior), PERSPECTIVE), found
    chosen, near = found[0] if found else given[0], None
    if request.prior == "weighted" and given:
        ends = [(k, run(problem, problem.start(k.exterior), PERSPECTIVE)) for k in [*found, *given]]
        ends = [(k, t) for k, t in ends if np.isfinite(t.last.cost)]
        chosen, near = min(ends, key=lambda end: end[1].last.cost)
    crude = run(problem, problem.start(chosen.start), PERSPECTIVE)
    end = Exterior.from_vector(crude.last.x)
    there = all(apart(end, chosen.exterior) <= apart(end, k.exterior) for k in found)
    others = [k for k in found if k is not chosen]
    if there and crude.last.cost <= problem.cost(problem.start(chosen.exterior)) + 1e-9:
        return crude, others
    return near or run(problem, problem.start(chosen.exterior), PERSPECTIVE), others


def _orthogonal(request: Request, control: Control, found: list[Candidate],
                prior: PriorOrientation | None) -> tuple[Orthogonal | OrthogonalFreeC, Trace, Options]:
    if request.one_pass and prior is None:
        raise BadProject(f"image '{request.image}': one pass needs an approximate orientation; give "
                         f"[images.{request.image}.prior] with X, Y, Z, omega_deg, phi_deg, kappa_deg "
                         "in project.toml, or iterate")
    if request.free and (request.free != ("c",) or request.one_pass):
        raise BadProject("the orthogonal model can free only the principal distance, and only when iterated; "
                         "use --model perspective to free more")
    near = found[0].exterior if found else prior.exterior if prior else None
    sigma = np.linalg.inv(control.weights(near))
    frozen = prior.exterior if request.one_pass and prior else None
    problem = Orthogonal(control.interior, control.points, control.pixels, sigma, request.form, request.recentre, frozen)
    if request.free:
        unknown = OrthogonalFreeC(replace(problem, recentre=False))
        if unknown.dof < 0:
            raise DegenerateGeometry(f"image '{request.image}': {len(control)} control points cannot determine 7 unknowns; "
                                     "measure more control or keep the principal distance fixed")
        beginnings = [np.append(unknown.model.start(unknown.model.affine_of(k.exterior)), control.interior.c) for k in found]
        return unknown, _best_run(unknown, beginnings, control), ORTHOGONAL
    if request.one_pass or not found:
        return problem, _best_run(problem, problem.starts(), control), ORTHOGONAL
    best = found[0].exterior
    near_best = [problem.start(problem.affine_of(e)) for k in found for e in (k.start, k.exterior)]
    given = [problem.start(problem.affine_of(prior.exterior))] if request.prior == "initial" and prior else None
    plain, aimed = (problem, given or problem.starts() + near_best), (replace(problem, accelerated=True), given or near_best)
    # where plain repetition runs away from its fixed point, the steps are aimed at it
    runs = []
    for attempt, beginnings in [aimed] if problem.statistics(best).radius >= 1 else [plain, aimed]:
        options = AIMED if attempt.accelerated else ORTHOGONAL
        for x0 in beginnings:  # the first that ends beside the best perspective solution; the linear start leads
            trace = solve(attempt, x0, options)
            end = Exterior.from_vector(trace.last.x)
            if _sound(control, trace, best) and all(apart(end, best) < apart(end, k.exterior) for k in found[1:]):
                return attempt, trace, options
            runs.append((*_rank(control, trace), len(runs), attempt, trace, options))
    *_, attempt, trace, options = min(runs)  # none that the perspective residual confirms: the least bad, and it will be said
    return attempt, trace, options


def _best_run(problem: Orthogonal | OrthogonalFreeC, beginnings: list[np.ndarray], control: Control) -> Trace:
    """Of all runs the converged one with the smallest perspective residual."""
    return min((solve(problem, x0, ORTHOGONAL) for x0 in beginnings), key=lambda run: _rank(control, run))


def _rank(control: Control, trace: Trace) -> tuple[bool, float]:
    """Converged runs first, then by the perspective residual."""
    rms = _rms(control, Exterior.from_vector(trace.last.x))
    return not (trace.converged and np.isfinite(rms)), rms if np.isfinite(rms) else np.inf


def _sound(control: Control, trace: Trace, best: Exterior) -> bool:
    """Whether an orthogonal run ended in a fixed point that the perspective residual confirms."""
    return trace.converged and not _false(control, Exterior.from_vector(trace.last.x), best)


def _false(control: Control, fixed: Exterior, best: Exterior) -> bool:
    """Whether a fixed point's perspective residual is beyond what the control allows: three times the least possible."""
    return not _rms(control, fixed) <= 3 * max(_rms(control, best), float(control.sigma_px.mean()))


def _rms(control: Control, exterior: Exterior) -> float:
    """Length of the two-dimensional residual [px]; NaN where a point lies behind the camera."""
    v = control.pixels - project(control.interior, exterior, control.points)
    return float(np.sqrt((v**2).sum() / len(v)))


# -- statistics -----------------------------------------------------------------------------------------------------------


def _describe(start: Start, trace: Trace) -> Orientation:
    """Everything about the solution of a trace but its alternatives."""
    x, problem, control = trace.last.x, start.problem, start.control
    local = Exterior.from_vector(x)
    used = control.take(start.used)
    interior = control.interior if isinstance(problem, Orthogonal) else problem.interior_at(x)
    who = f"image '{control.image}'"
    linear = problem.linear(x)
    stats = precision(linear, f"{who}: the {start.request.model} orientation")
    effect = np.abs(external(linear, stats) / np.sqrt(np.diag(stats.covariance))).max(axis=2)
    warnings = geometry_warnings(used)
    interior_sigma: tuple[tuple[str, float], ...] = ()
    if isinstance(problem, Resection):
        covariance = stats.covariance[:6, :6]
        interior_sigma = tuple(zip(problem.free, map(float, np.sqrt(np.diag(stats.covariance)[6:])), strict=True))
    elif isinstance(problem, OrthogonalFreeC):
        whole = problem.covariance(x)
        covariance, interior_sigma = whole[:6, :6], (("c", float(np.sqrt(whole[6, 6]))),)
    else:
        covariance, said = _orthogonal_covariance(start, problem, trace, local)
        warnings += said
    if isinstance(problem, Resection) and not problem.free:
        warnings += curved(problem, x, covariance)
    exterior = Exterior(local.m, start.frame.to_map(local.centre))
    covariance = exterior.angle_covariance(covariance)
    n = len(used)
    sigma0 = None if problem.dof < 1 else float(np.sqrt(2 * linear.cost / problem.dof))
    if not trace.converged:
        warnings.append(f"did not converge: stopped by '{trace.last.stop}' after {trace.iterations} iterations; do not use")
    warnings += bad_fit(linear.cost, problem.dof)
    warnings += snooping(stats.w[:n], used.names)
    warnings += correlations(covariance, stats.covariance, problem)
    warnings += undetermined(covariance)
    rejected = tuple(name for name, ok in zip(control.names, start.used, strict=True) if not ok)
    if rejected:
        warnings.append(f"rejected as blunders: {', '.join(rejected)}; their residuals are listed with used = false")
    whole = isinstance(problem, Resection) and start.used.all()
    residuals = linear.v[:n] if whole else control.pixels - project(interior, local, control.points)
    return Orientation(
        image=control.image, model=start.request.model, exterior=exterior, local=local,
        initial=Exterior.from_vector(trace.rows[0].x), covariance=covariance, sigma0=sigma0, dof=problem.dof,
        points=control.names, residuals=residuals,
        redundancy=_spread(stats.redundancy[:n], start.used, 0.0), w=_spread(stats.w[:n], start.used, np.nan),
        detectable=_spread(stats.detectable[:n], start.used, np.inf), effect=_spread(effect[:n], start.used, np.inf),
        condition=stats.condition, chi_square=chi_square(linear.cost, problem.dof),
        used=start.used, trace=trace, warnings=tuple(warnings), rejected=rejected,
        interior=interior if interior_sigma else None, interior_sigma=interior_sigma,
    )


def _orthogonal_covariance(start: Start, problem: Orthogonal, trace: Trace, local: Exterior) -> tuple[np.ndarray, list[str]]:
    if start.request.one_pass:
        prior, near = start.approximate, start.others[0].exterior if start.others else local
        leak = problem.statistics(near)  # where the pass ends, far off maybe, its own leak would mislead
        said = [f"one pass: {leak.radius:.2f} of an error of the approximate orientation comes through"]
        if prior is None or prior.count < 6:
            return leak.noise, [*said, "the approximate orientation has no sigmas: its own error is not in the standard errors"]
        covariance, words = one_pass_covariance(problem, near, prior)
        return covariance, [*said, words] if words else said
    said, leak = [], problem.statistics(local)
    used = start.control.take(start.used)
    if leak.radius >= 1:
        cure = "its fixed point was found by accelerated steps" if problem.accelerated else "prefer the perspective solution"
        said.append("plain repetition of the orthogonal transformation runs away here "
                    f"(spectral radius {leak.radius:.2f}); {cure}")
    if start.others and trace.converged and _false(used, local, start.others[0].exterior):
        said.append(f"false fixed point: the perspective residual is {_rms(used, local):.2f} px where "
                    f"{_rms(used, start.others[0].exterior):.2f} px is possible; do not use")
    elif start.others and trace.converged and np.diag(leak.iterated)[3:].max() > np.radians(0.1) ** 2:
        best = start.others[0].exterior
        rigorous = Resection(used.interior, used.points, used.pixels, used.weights(best))
        end = run(rigorous, rigorous.start(best), PERSPECTIVE).last
        excess = 2 * (rigorous.cost(rigorous.start(local)) - end.cost)
        if excess > 4:
            said.append(f"the fixed point fits worse than the perspective solution (chi-square larger by {excess:.0f}) where the "
                        "tilt is weak: the error region is not an ellipsoid, the standard errors are too small; prefer the "
                        "perspective solution")
        else:
            try:
                said += curved(rigorous, end.x, precision(rigorous.linear(end.x)).covariance)
            except DegenerateGeometry:
                said.append("the perspective solution of this control is singular: do not trust the tilt")
    return leak.iterated, said


def _alternative(start: Start, candidate: Candidate, control: Control, chosen: Exterior, said: list[str]) -> Orientation | None:
    """Another solution of the same model, or None where it does not converge to one or has no covariance, which is said."""
    problem, options = start.problem, start.options
    if isinstance(problem, Resection):
        x0 = problem.start(candidate.exterior)
    elif isinstance(problem, OrthogonalFreeC):
        x0 = np.append(problem.model.start(problem.model.affine_of(candidate.exterior)), control.interior.c)
    else:
        x0 = problem.start(problem.affine_of(candidate.exterior))
    trace = run(problem, x0, options) if isinstance(problem, Resection) else solve(problem, x0, options)
    trace = replace(trace, manifest=start.manifest)
    end = Exterior.from_vector(trace.last.x)
    if not trace.converged or not apart(end, chosen) > SAME or not np.isfinite(_rms(control, end)):
        return None
    try:
        return _describe(start, trace)
    except DegenerateGeometry:
        x, y, z = start.frame.to_map(end.centre)
        said.append(f"another solution has the camera at {x:.2f}, {y:.2f}, {z:.2f} m (chi-square {2 * trace.last.cost:.2f}); its "
                    "normal matrix is singular (danger cylinder), so it has no standard errors and is not listed")
        return None


def discrimination(start: Start, chosen: Exterior, control: Control) -> float | None:
    """D: root of the chi-square that the nearest other minimum has on noise-free observations of the chosen solution."""
    suspicious = len(start.others) > (start.request.model == "orthogonal") or len(control) < 5
    flat = len(control) >= 3 and control.extent[2] < 0.05 * control.extent[0]
    if len(control) < 3 or not (suspicious or flat):
        return None
    pixels = project(control.interior, chosen, control.points)
    if not np.isfinite(pixels).all():
        return None
    mean = control.points.mean(axis=0)
    perfect = Resection(control.interior, control.points, pixels, control.weights(chosen))
    found = []
    for k in candidates(control.points - mean, control.interior.ideal(pixels), control.interior.c, control.noise):
        trace = run(perfect, perfect.start(_moved(k, mean).exterior), PERSPECTIVE)
        if trace.converged and apart(Exterior.from_vector(trace.last.x), chosen) > SAME:
            found.append(float(np.sqrt(2 * trace.last.cost)))
    return min(found, default=None)


def _normal_probability(z: float) -> float:
    from math import erf, sqrt

    return 0.5 * (1 + erf(z / sqrt(2)))


# -- small parts ----------------------------------------------------------------------------------------------------------


def _moved(candidate: Candidate, by: np.ndarray) -> Candidate:
    return replace(candidate, exterior=candidate.exterior.shifted(-by), start=candidate.start.shifted(-by))


def _spread(values: np.ndarray, used: np.ndarray, missing: float) -> np.ndarray:
    """Values of the used points at their place among all points."""
    out = np.full((len(used), 2), missing)
    out[used] = values
    return out


def _prior(block: Block, request: Request, frame: LocalFrame) -> PriorOrientation | None:
    """The image's prior in the local frame, where the request asks for it."""
    if request.prior == "none" and not request.one_pass:
        return None
    prior = given_prior(block, request.image, frame)
    if request.prior == "weighted" and prior.count == 0:
        raise BadProject(f"image '{request.image}': a weighted prior needs sigma_m or sigma_deg in "
                         f"[images.{request.image}.prior]")
    return prior


def given_prior(block: Block, name: str, frame: LocalFrame) -> PriorOrientation:
    """The prior of an image in the local frame. Raises BadProject where position or angles are missing."""
    prior: Prior | None = block.images[block.image_index(name)].prior
    if prior is None or prior.centre is None or prior.angles is None:
        raise BadProject(f"image '{name}' has no complete prior; give [images.{name}.prior] with X, Y, Z, omega_deg, phi_deg, "
                         "kappa_deg in project.toml")
    exterior = Exterior.from_angles(*prior.angles, centre=frame.to_local(prior.centre))
    if prior.covariance is not None:
        j = to_vector(exterior)
        return PriorOrientation.of(exterior, j @ prior.covariance @ j.T)
    unknown = np.full(3, np.inf)
    sigma_m = unknown if prior.sigma_m is None else np.asarray(prior.sigma_m, float)
    sigma_rad = unknown if prior.sigma_rad is None else np.asarray(prior.sigma_rad, float)
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag(sigma_m**2)
    if np.isfinite(sigma_rad).all():
        back = np.linalg.inv(angle_derivatives(exterior.m))
        covariance[3:, 3:] = back @ np.diag(sigma_rad**2) @ back.T
    else:
        covariance[3:, 3:] = np.diag(unknown)
    return PriorOrientation.of(exterior, covariance)


def camera_manifest(interior: Interior) -> dict[str, Any]:
    """JSON-able values of an interior orientation, enough to make it again: Interior(**values)."""
    return {**{f.name: getattr(interior, f.name) for f in fields(interior)}, "pixel_mm": [float(p) for p in interior.pitch]}


def _manifest(block: Block, request: Request, frame: LocalFrame, control: Control) -> dict[str, Any]:
    return {
        "problem": "resection", "model": request.model, "image": request.image, "camera": camera_manifest(control.interior),
        "crs": block.crs, "frame": block.frame, "origin": [float(v) for v in frame.origin], "points": list(control.names),
        "xyz": control.points.tolist(), "pixels": control.pixels.tolist(), "sigma": control.sigma_px.tolist(),
        "sigma_m": control.sigma_m.tolist(),
        "columns": [*COLUMNS, *(tuple(f"A{i}" for i in range(1, 9)) if request.model == "orthogonal" else ()), *request.free],
        "units": [*UNITS, *(("mm/m", "mm/m", "mm/m", "mm") * 2 if request.model == "orthogonal" else ()),
                  *("mm" for _ in request.free)],
        "options": {k: v for k, v in vars(request).items() if k not in ("image", "model")},
    }


