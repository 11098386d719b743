"""Registration of a block's photos to one mosaic plane: by plane coefficients, exterior orientations or a bundle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from ..adjustment import Iteration, Trace
from ..block import Block, Image, Observations, Prior
from ..cameras import Interior
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, angle_derivatives
from .bending import bend_photos
from .bends import bent
from .bent_precision import bent_precision
from .checks import check_ties, discrepancies
from .data import Data, data_of
from .georeferencing import Placing, placing_of, plane_at
from .growing import Step, bounding_box, grow_groups
from .links import without_false_links
from .models import Coefficients, Exteriors, tangent, through
from .network import Network
from .onboard import held_by_positions, held_precision
from .precision import GRID, Response
from .problem import Registering, ShapePriors
from .registration import Level, Method, Registration
from .simultaneous import Found, homographies, oriented, run, spread, staged, tilted, trace_of, upright
from .words import weak_photos

MISFIT = 1.5
"""Residuals over what was expected from which on photos are bent, and a word is said."""
Model = Literal["auto", "plane", "exterior", "adapted", "bundle"]
BundleSolver = Callable[[Block, str], Any]
"""bundle(block, datum) adjusts a block whose images have complete priors to start from: the Adjusted of the orientation room."""


@dataclass(frozen=True)
class RegistrationRequest:
    """How to register. level None: the best that the data allow. model "auto": exterior orientations on the plane ("exterior"),
    then plane coefficients held to them within a few pixels, so that the photos meet on the plane ("adapted"); a bundle with
    free points for a controlled mosaic. "plane": coefficients alone, where the camera is not known. plane: height
    [m], "fitted" (tilted, through the points), None for a level plane at their median height. reference: the photo that gives
    the plane of an uncontrolled mosaic, None for the one of least tilt. loss: of the tie points, None for least squares."""

    level: Level | None = None
    method: Method = "simultaneous"
    model: Model = "auto"
    plane: float | Literal["fitted"] | None = None
    reference: str | None = None
    loss: str | None = "cauchy"


def register(block: Block, request: RegistrationRequest | None = None, bundle: BundleSolver | None = None) -> Registration:
    """The photos of a block on one mosaic plane. bundle: needed for the model "bundle" (see `BundleSolver`).

    Raises BadProject where the level asks for what the block does not have, DegenerateGeometry where photos do not hang
    together or nothing is determined.
    """
    request = request or RegistrationRequest()
    data = without_false_links(data_of(block, request.level, request.reference))
    out = _sequential(data, request) if request.method == "sequential" else _simultaneous(data, request, bundle)
    if isinstance(out, Registration):
        return out
    for name in out.wrong:  # once more without the control points that cannot be right
        block = block.with_role(name, "check")
    again = register(block, request, bundle)
    return replace(again, warnings=(*out.said, *again.warnings), rejected=(*out.wrong, *again.rejected))


# -- one after the other --------------------------------------------------------------------------------------------------


def _sequential(data: Data, request: RegistrationRequest) -> Registration | Placing:
    net = data.network(request.loss)
    steps, lost, _ = _grown(data, net, ("similarity", "affine", "projective"))
    order = [s.photo for s in steps]
    h = np.full((len(net.names), 3, 3), np.nan)
    for s in steps:
        h[s.photo] = s.h
    place = placing_of(data, h, None, request.plane)
    if place.wrong:
        return place
    data, h = place.data, place.homographies(h)
    rows, boxes, at, cost = [], [], np.full((len(net.names), 9), np.nan), 0.0
    for k, s in enumerate(steps):
        at[s.photo] = h[s.photo].ravel() / np.linalg.norm(h[s.photo])
        cost += s.trace.last.cost if s.trace else 0.0
        rows.append(Iteration(k, at.ravel().copy(), cost, s.trace.last.sigma0 if s.trace else np.nan, np.nan, np.nan, 0.0,
                              s.trace.iterations if s.trace else 0, "step" if k == len(steps) - 1 else None))
        boxes.append(bounding_box([h[p] for p in order[:k + 1]], [data.corners[p] for p in order[:k + 1]]).tolist())
    joined = [{"photo": net.names[s.photo], "points": s.points, "agreeing": s.agreeing, "stage": s.stage} for s in steps]
    trace = Trace(tuple(rows), {**data.manifest(request.method, "plane"), "joined": joined, "bounding_boxes": boxes})
    keep = sorted(order)
    r = _pixels_off(data, h)
    said = [*place.said, *place.accused(), "sequential registration: every photo inherits the errors of those before it; "
            "small residuals at the seams do not measure the drift, the simultaneous registration closes it"]
    weak = [f"'{net.names[s.photo]}' ({s.stage})" for s in steps if s.stage in ("similarity", "affine")]
    if weak:
        said.append(f"{len(weak)} photo{'s share' if len(weak) > 1 else ' shares'} points on a narrow part only and joined by "
                    "fewer coefficients: "
                    + ", ".join(weak[:6]) + (" ..." if len(weak) > 6 else ""))
    nothing = np.full((len(keep), 8, 8), np.nan)
    return _registration(data, request, "plane", keep, h, (), place, nothing, np.full(len(keep), np.nan), r, trace, said, lost)


def _grown(data: Data, net: Network, stages: tuple[str, ...]) -> tuple[list[Step], dict[str, str], np.ndarray]:
    """Steps from the reference photo, the photos that could not join with the reason, and the points' places."""
    lost, c = dict(data.unused), data.scale[data.reference]
    xy = np.full((len(net.known), 2), np.nan)
    steps, strangers = grow_groups(net, data.reference, np.diag([1 / c, 1 / c, 1.0]), stages, xy)
    for photo, why in strangers:
        lost.setdefault(net.names[photo], why)
    if len(steps) < 2:
        raise DegenerateGeometry(f"{data.block.name}: no photo overlaps '{net.names[data.reference]}' in enough common points; "
                                 "give photos that overlap, or find more tie points")
    return steps, lost, xy


# -- all at once ------------------------------------------------------------------------------------------------------------


def _simultaneous(data: Data, request: RegistrationRequest, bundle: BundleSolver | None) -> Registration | Placing:
    net = data.network(request.loss)
    steps, lost, xy = _grown(data, net, ())
    h = np.zeros((len(net.names), 3, 3))
    for s in steps:
        h[s.photo] = s.h
    joined = np.array(sorted(s.photo for s in steps))
    data = data.keeping(joined)
    net, h = data.network(request.loss, held=True), h[joined]
    found = staged(net, h, np.nan_to_num(xy), ("similarity", "affine"))
    model = _model(data, request, bundle)
    if model == "plane":
        found = staged(net, found.warps, found.xy, ("projective",), found)
    else:
        starts = [upright(found.warps)]
        if len(net.names) <= 200:  # strongly tilted photos begin better from their homographies
            starts.append(tilted(staged(net, found.warps, found.xy, ("projective",)).warps, (0.0, 0.0, 0.0)))
        found = oriented(net, starts, found.xy, before=found)
    data, found, out = _without_strangers(data, found, request)
    lost |= out
    place = placing_of(data, found.warps, found, request.plane)
    if place.wrong:
        return place
    adjusted = None
    if place.controlled:
        place, found = _placed(data, place, found, request)
    elif data.level != "uncontrolled":
        found = held_by_positions(place.data, place.data.network(request.loss), _moved(place, found))
    sure, bends = found, None  # what judges the precision
    if model == "adapted":
        found, bends = _adapted(place.data, found, place.data.network(request.loss, control=place.controlled,
                                                                      height=place.height))
    if model == "bundle":
        assert bundle is not None
        adjusted, found, place = _bundled(data, place, found, request, bundle)
    out = _concluded(data, request, model, found, sure, place, lost, adjusted, bends)
    return out if bends is None else _with_bends(place.data, out, bends.values)


def _model(data: Data, request: RegistrationRequest, bundle: BundleSolver | None) -> str:
    if request.model != "auto":
        if request.model == "bundle" and bundle is None:
            raise BadProject("a bundle was asked for and no bundle solver was handed in")
        return request.model
    return "bundle" if data.level == "controlled" and bundle is not None else "adapted"


def _without_strangers(data: Data, found: Found, request: RegistrationRequest) -> tuple[Data, Found, dict[str, str]]:
    """Photos most of whose points disagree with all others' do not belong here: they leave, and the rest is adjusted again."""
    net = found.problem.network
    limit = max(20.0, 8 * spread(found.problem, found.x))
    t = np.linalg.norm(found.problem.residuals(found.x), axis=1)
    shared = net.rays[net.point] >= 2
    count = np.bincount(net.image[shared], minlength=len(net.names))
    bad = np.bincount(net.image[shared & (t > limit)], minlength=len(net.names))
    stranger = (bad > 0.6 * np.maximum(count, 1)) & (np.arange(len(net.names)) != data.reference)
    if not stranger.any():
        return data, found, {}
    out = {net.names[k]: f"{bad[k]} of its {count[k]} tie points disagree with the other photos"
           for k in np.flatnonzero(stranger)}
    stay = np.flatnonzero(~stranger)
    data = data.keeping(stay)
    net = data.network(request.loss, held=True)
    photos = found.photos[stay]
    if isinstance(found.problem.model, Exteriors):
        return data, oriented(net, [photos], found.xy, before=None), out
    return data, staged(net, photos.reshape(-1, 3, 3), found.xy, ("projective",)), out


def _placed(data: Data, place: Placing, found: Found,
            request: RegistrationRequest) -> tuple[Placing, Found]:
    """The adjustment once more in map units, with control points and onboard positions as weighted observations."""
    net = place.data.network(request.loss, control=True, height=place.height)
    factor = max(1.0, spread(found.problem, found.x))
    net = replace(net, weight=net.weight / factor)
    xy = place.points(found.xy)
    if isinstance(found.problem.model, Exteriors):
        made = oriented(net, [place.exteriors(found.photos)], xy, (place.height, 0.0, 0.0), place.priors(data), found)
        assert isinstance(made.problem.model, Exteriors)
        place, model, photos = place.settled(made.problem.model, made.photos)
        problem = replace(made.problem, model=model)
        return place, replace(made, problem=problem, x=problem.pack(photos, made.xy))
    problem = Registering(net, Coefficients())
    return place, run(problem, problem.pack(place.homographies(found.warps).reshape(-1, 9), xy), "control", found)


def _moved(place: Placing, found: Found) -> Found:
    """The same adjustment in map units."""
    problem = found.problem
    photos = place.homographies(found.warps).reshape(-1, 9)
    return replace(found, x=problem.pack(photos, place.points(found.xy)))


class Bends(NamedTuple):
    """Bends of the photos (m, 6), and their standard error [px] beforehand."""

    values: np.ndarray
    within: float


def _adapted(data: Data, found: Found, net: Network) -> tuple[Found, Bends | None]:
    """Plane coefficients that stay within a few pixels of the exterior orientations: what is not quite a plane, or not quite a
    central projection, is shared out so that photos meet, and nothing adds up along the block. Where the photos do not fit as
    well as their tie points were measured, they bend too."""
    h, was = found.warps, found.problem
    within = 3.0 * float(np.median(np.linalg.norm(was.residuals(found.x), axis=1) / was.network.weight.mean(axis=1)))
    q = GRID * np.abs(net.q).max(axis=0)
    j = tangent(q) / max(within, 1e-9)
    information = np.einsum("gea,geb->ab", j, j) * 8 / (2 * len(q))
    priors = ShapePriors(np.arange(len(h)), h, np.broadcast_to(information, (len(h), 8, 8)))
    problem = Registering(net, Coefficients(), priors)
    made = run(problem, problem.pack(h.reshape(-1, 9), found.xy), "adapted", found)
    if spread(problem, made.x) < MISFIT:
        return made, None
    most = within * float(np.median(data.scale))
    made, bends = bend_photos(made, data.interiors, np.array([_camera(i) for i in data.interiors]), most)
    return made, Bends(bends, most)


def _with_bends(data: Data, registration: Registration, bends: np.ndarray) -> Registration:
    """The registration with its photos bent, its rms that of then."""
    made = replace(registration, bends=bends)
    off = check_ties(made, data.names, Observations(data.image, data.point, data.pixels, data.sigma))
    with np.errstate(invalid="ignore"):
        central = off[np.isfinite(off) & (off < 5 * max(float(np.nanmedian(off)), data.sigma_px))]
    ends = [float(np.linalg.norm(bent(b, i, c) - c, axis=1).max()) for b, i in zip(bends, made.interiors, strict=True)
            for c in [np.array([[0.0, 0], [i.width, 0], [i.width, i.height], [0, i.height]]) - 0.5]]
    said = (f"photos are bent by up to {max(ends):.1f} px at their corners to meet: ground off the plane, a rolling shutter or "
            "distortion; how far the mosaic lies from the truth does not show in it")
    return replace(made, rms_px=float(np.sqrt(np.mean(central**2))), warnings=(*made.warnings, said))


def _bundled(data: Data, place: Placing, found: Found, request: RegistrationRequest,
             bundle: BundleSolver) -> tuple[Any, Found, Placing]:
    """Free object points: the bundle, begun from the orientations found on the plane; the plane then comes from its points."""
    frame = place.frame
    exteriors = [Exterior.from_vector(row) for row in found.photos]
    images = []
    by = dict(zip(data.names, exteriors, strict=True))
    for image in data.block.images:
        e = by.get(image.name)
        if e is None:
            images.append(image)
            continue
        was = image.prior
        if was is not None and was.covariance is not None and place.by_gps:
            images.append(image)  # its orientation is observed as a whole
            continue
        onboard = was is not None and was.centre is not None and place.by_gps
        images.append(Image(image.name, image.camera, image.file, Prior(
            frame.to_map(e.centre) if not onboard else was.centre, e.angles,  # type: ignore[union-attr]
            was.sigma_m if onboard else None, None)))  # type: ignore[union-attr]
    of = data.block.observations
    rows = np.array([i.name in by for i in data.block.images], bool)[of.image]
    seen = Observations(of.image[rows], of.point[rows], of.pixel[rows], of.sigma[rows])
    adjusted = bundle(replace(data.block, images=tuple(images), observations=seen), place.datum)
    local = {o.image: o.local for o in adjusted.orientations}
    missing = [n for n in data.names if n not in local]
    if missing:
        raise DegenerateGeometry(f"{data.block.name}: the bundle could not orient '{missing[0]}'; take the model \"exterior\"")
    points = np.array([frame.to_local(p.xyz) for p in adjusted.points if p.role != "check"])
    plane = plane_at(points, request.plane)
    photos = np.array([local[n].vector for n in data.names])
    model = Exteriors((float(plane[0]), float(plane[1]), float(plane[2])))
    rows = list(found.rows)
    for row in adjusted.trace.rows:
        poses = row.x[:12 * len(adjusted.trace.manifest["images"])].reshape(-1, 12)
        order = [adjusted.trace.manifest["images"].index(n) for n in data.names]
        rows.append(("bundle", replace(row, x=homographies(model, poses[order]).ravel())))
    problem = Registering(place.data.network(request.loss), model)
    xy = np.zeros((len(problem.network.known), 2))
    return adjusted, Found(problem, problem.pack(photos, xy), tuple(rows)), replace(place, plane=plane)


def _concluded(data: Data, request: RegistrationRequest, model: str, found: Found, sure: Found, place: Placing,
               lost: dict[str, str], adjusted: Any, bends: Bends | None = None) -> Registration:
    data = place.data
    net, said = found.problem.network, list(place.said)
    keep = list(range(len(data.names)))
    h = found.warps
    trace = trace_of(found.rows, data.manifest(request.method, model))
    if adjusted is not None:
        covariance, noise = _bundle_precision(data, adjusted, place)
        said += [w for w in adjusted.warnings]
        rms = adjusted.rms_px
    else:
        response = Response(sure.problem, sure.x, data.half)
        factor = max(1.0, spread(sure.problem, sure.x))
        try:
            covariance, noise = response.covariance * factor**2, response.noise() * factor
            if isinstance(sure.problem.priors, ShapePriors):  # coefficients held by positions: their weights have the factor
                factor = float(np.median(data.network(request.loss).weight / sure.problem.network.weight))
                held = held_precision(response, factor, data.scale)
                covariance, noise = held.covariance, held.noise
                said.append(held.said(place.unit))
            elif model == "adapted":
                near = Response(found.problem, found.x, data.half)
                if bends is None:
                    covariance = _as_coefficients(response, covariance) + near.covariance
                else:
                    covariance, noise, more = _bent(response, near, bends, data.interiors)
                    said.append("if all photos are bent alike, as a camera's own error bends them, up to "
                                f"{more / place.pixel:.0f} px of drift are not in the standard errors")
            said += weak_photos(data, net, noise, place, _relief_share(response, factor), model)
        except DegenerateGeometry as error:
            covariance = np.full((len(keep), *2 * (found.problem.model.size,)), np.nan)
            noise = np.full(len(keep), np.nan)
            said.append(f"nearly rank deficient: {error}")
        if factor > MISFIT:
            said.append(f"the tie points fit to {factor * data.sigma_px:.2f} px where {data.sigma_px:.2f} px were expected: "
                        "relief off the plane or distortion left in the photos; covariances are scaled by it")
        rms = float(np.sqrt(np.mean((_pixels_off(data, h) ** 2)[_central(data, h)])))
    above = [k for k, (g, c) in enumerate(zip(h, data.corners, strict=True))
             if np.isnan(through(np.linalg.inv(np.broadcast_to(g, (4, 3, 3))), c)[0]).any()]
    said += place.accused(above)
    if above:
        said.append(f"huge tilt: the horizon of the mosaic plane lies inside photo{'s' * (len(above) > 1)} "
                    f"{', '.join(repr(data.names[k]) for k in above[:6])}; only the ground well below it can be used")
    if found.rows[-1][1].stop not in ("step", "gradient", "cost"):
        said.insert(0, f"the registration did not come to rest in {len(found.rows)} rows (stopped by "
                       f"'{found.rows[-1][1].stop}')")
    exteriors = ()
    flat = model in ("plane", "adapted")
    if not flat:
        exteriors = tuple(Exterior.from_vector(p) for p in found.photos)
        if adjusted is not None:
            data = data.with_interiors(adjusted.interiors)
    return _registration(data, request, "plane" if flat else "exterior", keep, h, exteriors, place, covariance, noise,
                         np.array([rms]), trace, said, lost)


def _bent(sure: Response, near: Response, bends: Bends, interiors: tuple[Interior, ...]) -> tuple[np.ndarray, np.ndarray, float]:
    """Covariance (m, 14, 14) of coefficients and bends, standard error (m,) of places, and the drift of the worst photo if all
    were bent alike."""
    scale = max(1.0, spread(near.problem, near.x))
    made = bent_precision(sure, near, near.problem.network.weight / scale, interiors, bends.values, bends.within)
    covariance = np.zeros((len(interiors), 14, 14))
    covariance[:, :8, :8] = _as_coefficients(sure, made.covariance) + scale**2 * near.covariance
    covariance[:, 8:, 8:] = made.bends
    return covariance, np.hypot(made.noise, scale * near.noise()), float(np.nanmax(made.alike))


def _as_coefficients(response: Response, covariance: np.ndarray) -> np.ndarray:
    """(m, 8, 8) of D from (m, 6, 6) of exterior orientations."""
    problem = response.problem
    out = np.zeros((len(covariance), 8, 8))
    for k, half in enumerate(response.half):
        q = GRID * half
        h = homographies(problem.model, problem.split(response.x)[0][[k]])
        xy = through(np.linalg.inv(np.broadcast_to(h, (len(q), 3, 3))), q)[0]
        ok = np.isfinite(xy).all(axis=1)
        seen = problem.model.see(problem.split(response.x)[0][[k]], np.zeros(int(ok.sum()), int), xy[ok], np.zeros(int(ok.sum())))
        t = np.linalg.lstsq(tangent(q[ok]).reshape(-1, 8), seen.by_photo.reshape(-1, covariance.shape[1]), rcond=None)[0]
        out[k] = t @ covariance[k] @ t.T
    return out


def _relief_share(response: Response, factor: float) -> np.ndarray | None:
    """(m,) drift that misfits beyond the noise would cause if they were relief."""
    if factor < 1.5:
        return None
    by_height = np.linalg.norm(response.by_height(), axis=1)
    sigma = np.sqrt(factor**2 - 1) * np.sqrt(2) / max(float(np.median(by_height)), 1e-12)
    return response.relief(sigma, draws=8)


def _bundle_precision(data: Data, adjusted: Any, place: Placing) -> tuple[np.ndarray, np.ndarray]:
    by = {o.image: o for o in adjusted.orientations}
    covariance = []
    for n in data.names:
        j = np.eye(6)
        j[3:, 3:] = np.linalg.inv(angle_derivatives(by[n].local.m))
        covariance.append(j @ by[n].covariance @ j.T)
    covariance = np.array(covariance)
    net = Network(data.names, np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2)),
                  np.zeros((0, 2)), np.zeros(0), np.zeros(len(data.names), bool))
    z = (float(place.plane[0]), float(place.plane[1]), float(place.plane[2]))
    problem = Registering(net, Exteriors(z))
    j = Response(problem, problem.pack(np.array([by[n].local.vector for n in data.names]), np.zeros((0, 2))), data.half).onto
    return covariance, np.sqrt(np.nanmean(np.einsum("mgea,mab,mgeb->mg", j, covariance, j), axis=1))


def _central(data: Data, h: np.ndarray) -> np.ndarray:
    """(o,) observations that are not blunders: within five medians."""
    off = _pixels_off(data, h)
    with np.errstate(invalid="ignore"):
        return np.isfinite(off) & (off < 5 * max(float(np.nanmedian(off)), data.sigma_px))


def _pixels_off(data: Data, h: np.ndarray) -> np.ndarray:
    """(o,) px from each observation to where the mean place of its point on the mosaic appears; NaN for lost photos."""
    return discrepancies(h, data.scale, data.image, data.point, data.q, len(data.points))


def _registration(data: Data, request: RegistrationRequest, kind: Any, keep: list[int], h: np.ndarray,
                  exteriors: tuple[Exterior, ...], place: Placing, covariance: np.ndarray, noise: np.ndarray, rms: np.ndarray,
                  trace: Trace, said: list[str], lost: dict[str, str]) -> Registration:
    interiors = tuple(data.interiors[k] for k in keep)
    pixels = None
    if kind == "plane":
        pixels = np.array([_camera(i) @ h[k] for i, k in zip(interiors, keep, strict=True)])
    with np.errstate(invalid="ignore"):
        ok = np.isfinite(rms)
        value = float(np.sqrt(np.mean(rms[ok] ** 2))) if ok.any() else float("nan")
    return Registration(
        kind=kind, level=data.level, method=request.method, names=tuple(data.names[k] for k in keep), interiors=interiors,
        homographies=pixels, exteriors=exteriors, plane=place.plane, frame=place.frame, unit=place.unit, covariance=covariance,
        corner_sigma=noise, rms_px=value, trace=trace, warnings=tuple(dict.fromkeys([*data.said, *said])), unused=lost)


def _camera(interior: Interior) -> np.ndarray:
    """(3, 3) ideal photo coordinates over c -> undistorted pixels."""
    (px, py), (xp, yp), c = interior.pitch, interior.principal_point, interior.c
    return np.array([[c / px, 0, (interior.width - 1) / 2 + xp / px], [0, -c / py, (interior.height - 1) / 2 - yp / py],
                     [0, 0, 1.0]])


__all__ = ["BundleSolver", "RegistrationRequest", "register"]
