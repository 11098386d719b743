"""What a bundle is when it is done: orientations, interiors, points, and how far to trust each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ...adjustment import Trace
from ...adjustment.precision import BAARDA_DELTA0
from ...adjustment.reliability import ChiSquare, chi_square, correlation
from ...cameras import PARAMETERS, Interior
from ...geometry import Exterior
from ...geometry.rotation import angle_derivatives
from ..result import Orientation
from ..words import bad_fit, undetermined
from .given import Given, velocity_of
from .problem import Bundle
from .statistics import Statistics

ELLIPSOID_95 = 2.7954834829151074
"""Square root of the 95 % quantile of chi-square with 3 degrees of freedom."""
MOST = 5_000
"""Points up to which the JSON has the covariance of every one; of larger blocks they are in covariance.npz of the run."""
MANY = 20_000
"""Observations up to which the JSON of a run has every one; of larger blocks they are in observations.npz of the run."""
MATTERS = 0.5
"""Pixels that a camera moves on the ground while it reads a photo from which its rolling shutter is told."""
CONTRADICTED = 3.0
"""sigma0 of motions, and of GPS and IMU, from which they contradict the images."""
SUSPECT = 4.0
"""Standardized residual from which an observation is listed as suspect (chance of a good one: 6e-5)."""


@dataclass(frozen=True)
class AdjustedPoint:
    """An object point. xyz (3,): project coordinates [m]; covariance (3, 3) m^2 in local axes, a priori; off (3,): adjusted minus
    given, local axes, NaN where nothing is given; rays: images that see it; w (3,): standardized corrections of control;
    drawn: its covariance and ellipsoid go into the JSON (of tie points of very large blocks they do not)."""

    name: str
    role: str
    xyz: np.ndarray
    covariance: np.ndarray
    off: np.ndarray
    rays: int
    w: np.ndarray
    drawn: bool = True

    def to_json(self) -> dict[str, Any]:
        sigma = np.sqrt(np.diag(self.covariance))
        return {"name": self.name, **dict(zip("XYZ", map(float, self.xyz), strict=True)),
                **dict(zip(("sX", "sY", "sZ"), map(float, sigma), strict=True)), "role": self.role,
                **dict(zip(("dX", "dY", "dZ"), map(_finite, self.off), strict=True)), "rays": self.rays,
                "w": [_finite(v) for v in self.w],
                **({"covariance": self.covariance.tolist(), "ellipsoid": self.ellipsoid()} if self.drawn else {})}

    def ellipsoid(self) -> dict[str, Any]:
        """The 95 % error ellipsoid a priori, chi-square with 3 degrees of freedom: half axes [m], the longest first, and
        their directions (rows, local axes)."""
        values, vectors = np.linalg.eigh(self.covariance)
        return {"half_axes_m": (ELLIPSOID_95 * np.sqrt(np.maximum(values[::-1], 0.0))).tolist(),
                "directions": vectors.T[::-1].tolist(), "factor": ELLIPSOID_95}


@dataclass(frozen=True)
class Adjusted:
    """An adjusted block. interiors: by camera; interior_names and interior_covariance (f, f): of the freed parameters, camera
    after camera, under the camera's name alone what its images share; control_rms, check_rms (3,) m: None without such points;
    groups: sigma0 and redundancy of every kind of observation: image coordinates of tie points and of control points, control,
    GPS, IMU and others apart; suspects: observations with |w| > 4, the worst first; shifts: of the GPS positions of every
    strip (3,) m, local axes, with covariance (3, 3); motions: of every image while it was read (3 or 6,), m/s local
    axes and rad/s photo axes, with covariance; joint (6, f), by image: covariance of X, Y, Z, omega, phi, kappa with what
    was freed of its camera, in the order of `interior_rows`."""

    orientations: tuple[Orientation, ...]
    interiors: Mapping[str, Interior]
    interior_names: tuple[tuple[str, str], ...]
    interior_covariance: np.ndarray
    points: tuple[AdjustedPoint, ...]
    sigma0: float | None
    dof: int
    rms_px: float
    cost: float
    control_rms: np.ndarray | None
    check_rms: np.ndarray | None
    groups: Mapping[str, tuple[float | None, float]]
    suspects: tuple[dict[str, Any], ...]
    chi_square: ChiSquare | None
    trace: Trace
    warnings: tuple[str, ...]
    shifts: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    motions: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    joint: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def interior_sigma(self) -> dict[str, dict[str, float]]:
        """Standard errors, a priori, of the freed parameters by camera."""
        out: dict[str, dict[str, float]] = {name: {} for name in self.interiors}
        for k, (camera, parameter) in enumerate(self.interior_names):
            s = float(np.sqrt(self.interior_covariance[k, k]))
            for name in self.interiors if camera not in self.interiors else (camera,):
                if name == camera or name.startswith(f"{camera}@"):  # one camera for many images
                    out[name][parameter] = s
        return out

    def _with_interior(self, index: int, image: str) -> dict[str, Any]:
        if image not in self.joint:
            return {}
        camera = self.trace.manifest["cameras"][self.trace.manifest["camera_of"][index]]
        names = [_key(self.interior_names[k][1]) for k in self.interior_rows(camera)]
        return {"interior_covariance": {"parameters": names, "matrix": self.joint[image].tolist()}}

    def covariances(self) -> dict[str, np.ndarray]:
        """All covariances a priori as arrays: of the images' X, Y, Z, omega, phi, kappa (m, 6, 6), of the points (n, 3, 3), of
        the freed interior parameters (f, f) and of each image with those of its camera (m, 6, f), with their names."""
        out = {"image": np.array([o.image for o in self.orientations]), "point": np.array([p.name for p in self.points]),
               "exterior": np.array([o.covariance for o in self.orientations]),
               "points": np.array([p.covariance for p in self.points]), "interior": self.interior_covariance,
               "interior_parameter": np.array([f"{c}.{_key(p)}" for c, p in self.interior_names])}
        joint = [self.joint[o.image] for o in self.orientations if o.image in self.joint]
        if joint and len({j.shape for j in joint}) == 1:
            out["exterior_interior"] = np.array(joint)
        return out

    def interior_rows(self, camera: str) -> list[int]:
        """Places in `interior_names` of what was freed of one camera, shared with others or not."""
        return [k for k, (name, _) in enumerate(self.interior_names) if camera == name or camera.startswith(f"{name}@")]

    def observations(self) -> dict[str, np.ndarray]:
        """What is known of every observation as arrays: image and point (o,), places among the names; residuals, redundancy, w,
        detectable and effect (o, 2); used (o,)."""
        place = {p.name: k for k, p in enumerate(self.points)}
        arrays = {name: np.concatenate([getattr(o, name) for o in self.orientations])
                  for name in ("residuals", "redundancy", "w", "detectable", "effect", "used")}
        return {"images": np.array([o.image for o in self.orientations]), "points": np.array(list(place)),
                "image": np.repeat(np.arange(len(self.orientations), dtype=np.int32), [len(o.points) for o in self.orientations]),
                "point": np.array([place[name] for o in self.orientations for name in o.points], np.int32),
                **{name: a if name == "used" else a.astype(np.float32) for name, a in arrays.items()}}

    def to_json(self, residuals: bool = True) -> dict[str, Any]:
        """The JSON of the commands adjust and calibrate, with or without every observation's residuals."""
        sigma = self.interior_sigma
        return {
            "orientations": [{**o.to_json(residuals), **self._with_interior(k, o.image)}
                             for k, o in enumerate(self.orientations)],
            "interior": {name: {**{_key(p): float(getattr(camera, p)) for p in PARAMETERS},
                                "sigma": {_key(p): s for p, s in sigma[name].items()}} for name,
                         camera in self.interiors.items()},
            "interior_correlation": {"parameters": [f"{c}.{_key(p)}" for c, p in self.interior_names],
                                     "matrix": correlation(self.interior_covariance).tolist()},
            "points": [p.to_json() for p in self.points],
            "sigma0": self.sigma0, "dof": self.dof, "rms_px": self.rms_px, "rms_px_coordinate": self.rms_px / np.sqrt(2),
            "iterations": self.trace.iterations, "cost": self.cost, "converged": self.trace.converged,
            "stop": self.trace.last.stop,
            "control_rms_m": None if self.control_rms is None else self.control_rms.tolist(),
            "check_rms_m": None if self.check_rms is None else self.check_rms.tolist(),
            "reliability": {"groups": {k: {"sigma0": s, "redundancy": r} for k, (s, r) in self.groups.items()},
                            "suspects": list(self.suspects)},
            "chi_square": None if self.chi_square is None else asdict(self.chi_square), "warnings": list(self.warnings),
            **({"gps_shifts": {name: {"shift_m": v.tolist(), "sigma_m": np.sqrt(np.diag(q)).tolist()}
                               for name, (v, q) in self.shifts.items()}} if self.shifts else {}),
            **({"motions": {name: _motion_json(v, np.sqrt(np.diag(q))) for name, (v, q) in self.motions.items()}}
               if self.motions else {}),
        }


def described(data: Given, problem: Bundle, trace: Trace, stats: Statistics, said: tuple[str, ...]) -> Adjusted:
    """The adjusted block of a trace and its statistics."""
    net, x = problem.network, trace.last.x
    v, interiors = problem.residuals(x), net.interiors_at(x)
    sigma0 = float(np.sqrt(2 * trace.last.cost / problem.dof)) if problem.dof > 0 else None
    points = _points(data, problem, x, stats)
    control, check = ([p.off for p in points if p.role == role and np.isfinite(p.off).all()] for role in ("control", "check"))
    warnings = [*said, *bad_fit(trace.last.cost, problem.dof)]
    if not trace.converged:
        warnings.insert(0, unfinished(trace))
    warnings += _shutter(data, problem, x)
    if stats.loose:
        shown = ", ".join(net.points[n] for n in stats.loose[:6]) + (" ..." if len(stats.loose) > 6 else "")
        warnings.append(f"the rays to {len(stats.loose)} point(s) are parallel and leave the depth open: {shown}; their standard "
                        "errors are lower bounds")
    names = net.labels
    warnings += _correlated(names, stats.interior)
    suspects = _suspects(problem, v, stats, points)
    if suspects:
        shown = ", ".join(s["text"] for s in suspects[:5]) + (" ..." if len(suspects) > 5 else "")
        warnings.append(f"{len(suspects)} suspect observation(s) with |w| > {SUSPECT:g}, the worst first: {shown}")
    groups = _groups(data, problem, x, stats, v)
    if (off := groups.get("motion", (None, 0.0))[0] or 0.0) > CONTRADICTED:
        warnings.append(f"rolling shutter: the motions differ from what is known of them by {off:.1f} times their standard "
                        "errors: they take up something else, perhaps the lens; calibrate it first")
    if (off := max((groups[k][0] or 0.0 for k in groups if k[:3] in ("GPS", "IMU")), default=0.0)) > CONTRADICTED:
        warnings.append(f"GPS or IMU differ from the block by {off:.1f} times their standard errors: do not believe its place, "
                        "scale and attitude; look for a lens that was never calibrated (--free c,xp,yp,k1,k2,k3, or Free "
                        "interior parameters in the tab Bundle), wrong headings (collinea georeference --check-headings) and "
                        "too small sigmas")
    return Adjusted(
        orientations=_orientations(data, problem, trace, stats, v, sigma0),
        interiors=dict(zip(net.cameras, interiors, strict=True)),
        interior_names=names, interior_covariance=stats.interior, points=points, sigma0=sigma0, dof=problem.dof,
        rms_px=float(np.sqrt((v**2).sum() / len(v))), cost=trace.last.cost, control_rms=_rms(control), check_rms=_rms(check),
        groups=groups, suspects=tuple(suspects), chi_square=chi_square(trace.last.cost, problem.dof),
        trace=trace, warnings=tuple(warnings), shifts=_shifts(problem, x, stats), motions=_motions(problem, x, stats),
        joint=_joint(problem, x, stats))


def unfinished(trace: Trace) -> str:
    """What to say of a trace that did not converge."""
    if trace.last.stop == "stopped":
        return f"stopped at row {trace.last.index} before it converged: standard errors hold only for the minimum; do not use"
    return f"did not converge: stopped by '{trace.last.stop}' after {trace.iterations} iterations; do not use"


def _joint(problem: Bundle, x: np.ndarray, stats: Statistics) -> dict[str, np.ndarray]:
    """Covariance of every image's exterior orientation with the freed interior parameters of its camera."""
    net = problem.network
    if not net.freed or len(stats.cross) != len(net.images):
        return {}
    poses, out = net.split(x)[0], {}
    for i, name in enumerate(net.images):
        first = net.first[net.camera[i]]
        own = net.tie[first:first + net.count[net.camera[i]]]
        to_angles = np.eye(6)
        to_angles[3:, 3:] = angle_derivatives(poses[i, 3:].reshape(3, 3))
        out[name] = to_angles @ stats.cross[i][:, np.sort(own)]
    return out


def _orientations(data: Given, problem: Bundle, trace: Trace, stats: Statistics, v: np.ndarray,
                  sigma0: float | None) -> tuple[Orientation, ...]:
    net = problem.network
    poses, first = (net.split(trace.rows[k].x)[0] for k in (-1, 0))
    chi = chi_square(trace.last.cost, problem.dof)
    out = []
    for i, name in enumerate(net.images):
        rows = net.seen_in(i)
        local = Exterior.from_vector(poses[i])
        covariance = local.angle_covariance(stats.poses[i])
        sd = np.sqrt(np.diag(stats.poses[i]))
        r = np.clip(stats.redundancy[rows], 1e-12, 1.0)
        effect = np.where(np.isfinite(stats.detectable[rows]), BAARDA_DELTA0 * np.sqrt((1 - r) / r), np.inf)
        out.append(Orientation(
            image=name, model=problem.model, exterior=Exterior(local.m, data.frame.to_map(local.centre)), local=local,
            initial=Exterior.from_vector(first[i]), covariance=covariance, sigma0=sigma0, dof=problem.dof,
            points=tuple(net.points[p] for p in net.point[rows]), residuals=v[rows], redundancy=stats.redundancy[rows],
            w=stats.w[rows],
            detectable=stats.detectable[rows], effect=effect, condition=float(np.linalg.cond(stats.poses[i] / np.outer(sd, sd))),
            chi_square=chi, used=stats.factor[rows] >= 0.5, trace=trace, warnings=tuple(undetermined(covariance)),
            rejected=tuple(net.points[p] for p in net.point[rows][stats.factor[rows] < 0.5])))
    return tuple(out)


def _points(data: Given, problem: Bundle, x: np.ndarray, stats: Statistics) -> tuple[AdjustedPoint, ...]:
    net, block = problem.network, data.block
    local = net.split(x)[2]
    xyz, rays = data.frame.to_map(local), np.diff(net.start)
    index = {name: j for j, name in enumerate(block.points.names)}
    given = block.points.xyz[[index[n] for n in net.points]]
    off = np.full_like(local, np.nan)
    ok = np.isfinite(given).all(axis=1)
    if ok.any():
        off[ok] = local[ok] - data.frame.to_local(given[ok])
    roles = [block.points.role[index[n]] for n in net.points]
    w = np.full_like(local, np.nan)
    n = net.unknown
    given_sigma = np.sqrt(1 / np.where(net.weight[:n] > 0, net.weight[:n], np.nan))
    for rows, root in net.extras.correlated:
        given_sigma[rows] = np.sqrt(np.diag(np.linalg.inv(root.T @ root))).reshape(-1, 3)
    free = given_sigma**2 - np.einsum("nii->ni", stats.points)  # variance of the correction
    w[:n] = -off[:n] / np.sqrt(np.where(free > 1e-9 * given_sigma**2, free, np.nan))
    covariance = np.zeros((len(local), 3, 3))
    covariance[:n] = stats.points
    few = len(net.points) <= MOST
    return tuple(AdjustedPoint(n, roles[k], xyz[k], covariance[k], off[k], int(rays[k]), w[k], few or roles[k] != "tie")
                 for k, n in enumerate(net.points))


def _groups(data: Given, problem: Bundle, x: np.ndarray, stats: Statistics,
            v: np.ndarray) -> dict[str, tuple[float | None, float]]:
    """sigma0 and redundancy of each kind of observation (the simplest estimate of variance components: Förstner 1979)."""
    net = problem.network
    of_control = np.asarray(np.isfinite(net.known).any(axis=1))[net.point]
    square, r = (stats.factor[:, None] * v**2 / net.sigma[:, None] ** 2).sum(axis=1), stats.redundancy.sum(axis=1)
    sums = {name: (float(square[rows].sum()), float(r[rows].sum()))
            for name, rows in (("tie image", ~of_control), ("control image", of_control)) if rows.any()}
    weight = net.weight[:net.unknown]
    if (weight > 0).any():
        r = 1 - weight * np.einsum("nii->ni", stats.points)
        off = (net.known - net.split(x)[2])[:net.unknown]
        sums["control"] = (float(np.nansum(weight * off**2)), float(r[weight > 0].sum()))
    for name, rows in net.border_groups.items():
        v, d = (part[rows] for part in net.border_rows(x))
        before = sums.get(name, (0.0, 0.0))
        sums[name] = (before[0] + float((v**2).sum()), before[1] + len(v) - float(np.einsum("ri,ij,rj->", d, stats.border, d)))
    images, (misclosure, d) = net.prior_arrays[0], problem.prior_rows(x)
    if len(images):
        held = np.einsum("aij,ajk,aik->ai", d, stats.poses[images], d)
        for row, i in enumerate(images):
            if (at := net.shift_columns[i]) is not None:
                shift, cross = d[row, :, :3], stats.cross[i][:, at]
                held[row] += np.diag(2 * d[row] @ cross @ shift.T + shift @ stats.border[np.ix_(at, at)] @ shift.T)
        roots = net.prior_arrays[2]
        known = np.abs(roots).sum(axis=2) > 0
        apart = not roots[:, :3, 3:].any()  # else positions and angles are known together
        turns = "IMU" if any(p.root[3:].any() for p in data.priors.values()) else "level"  # assumed, not measured
        for name, rows in (("GPS", slice(0, 3)), (turns, slice(3, 6))) if apart else (("GPS/IMU", slice(0, 6)),):
            if known[:, rows].any():
                sums[name] = (float((misclosure[:, rows] ** 2).sum()), float((known - held)[:, rows].sum()))
    return {k: (float(np.sqrt(s / r)) if r > 0.5 else None, r) for k, (s, r) in sums.items()}


def _shifts(problem: Bundle, x: np.ndarray, stats: Statistics) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    net = problem.network
    first, values = net.freed + 3 * net.extras.held, net.shifts_at(x)
    rows = [slice(first + 3 * k, first + 3 * k + 3) for k in range(len(net.extras.shifts))]
    return {name: (values[k], stats.border[rows[k], rows[k]]) for k, name in enumerate(net.extras.shifts)}


def _motions(problem: Bundle, x: np.ndarray, stats: Statistics) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    net, k = problem.network, problem.network.extras.moving
    first = net.sizes[1] - net.extras.motions
    rows = [slice(first + k * i, first + k * i + k) for i in range(len(net.images))] if k else []
    return {net.images[i]: (net.motion_at(x)[i], stats.border[s, s]) for i, s in enumerate(rows)}


def _motion_json(v: np.ndarray, sigma: np.ndarray) -> dict[str, Any]:
    turn = {"rate_deg_s": np.degrees(v[3:]).tolist(), "sigma_rate_deg_s": np.degrees(sigma[3:]).tolist()} if len(v) > 3 else {}
    return {"velocity_m_s": v[:3].tolist(), "sigma_velocity_m_s": sigma[:3].tolist(), **turn}


def _shutter(data: Given, problem: Bundle, x: np.ndarray) -> list[str]:
    """How far the camera moves while it reads a photo, where that is known, matters and is not modelled."""
    net, block = problem.network, data.block
    if net.extras.moving or not block.readout_ms:
        return []
    poses, _, points = net.split(x)
    way = []
    for i, name in enumerate(net.images):
        k = block.image_index(name)
        ms, velocity = block.readout_ms.get(block.images[k].camera), velocity_of(data, k)
        rows = net.seen_in(i)
        if ms is None or velocity is None or not len(rows):
            continue
        depth = np.median(np.abs(Exterior.from_vector(poses[i]).camera(points[net.point[rows]])[:, 2]))
        interior, speed = block.cameras[block.images[k].camera], float(np.linalg.norm(velocity))
        way.append((speed * ms * 1e-3 * interior.c / depth / float(np.mean(interior.pitch)), speed, ms))
    if not way or (middle := sorted(way)[len(way) // 2])[0] <= MATTERS:
        return []
    return [f"rolling shutter: the camera moves by {middle[0]:.1f} px on the ground while it reads a photo ({middle[1]:.1f} m/s "
            f"for {middle[2]:.0f} ms): free it (--rolling-shutter, or Rolling shutter in the tab Bundle)"]


def _suspects(problem: Bundle, v: np.ndarray, stats: Statistics, points: tuple[AdjustedPoint, ...]) -> list[dict[str, Any]]:
    net = problem.network
    with np.errstate(invalid="ignore"):
        worst = np.nanmax(np.where(np.isfinite(stats.w), np.abs(stats.w), 0.0), axis=1, initial=0.0)
    out = [{"kind": "image", "image": net.images[net.image[o]], "point": net.points[net.point[o]], "w": float(worst[o]),
            "residual_px": v[o].tolist(),
            "text": f"point '{net.points[net.point[o]]}' in image '{net.images[net.image[o]]}' (w = {worst[o]:.1f})"}
           for o in np.flatnonzero(worst > SUSPECT)]
    for p in points:
        largest = float(np.abs(p.w[np.isfinite(p.w)]).max(initial=0.0))
        if largest > SUSPECT:
            out.append({"kind": "control", "point": p.name, "w": largest, "off_m": p.off.tolist(),
                        "text": f"coordinates of control point '{p.name}' (w = {largest:.1f})"})
    return sorted(out, key=lambda s: -s["w"])[:50]


def _correlated(names: tuple[tuple[str, str], ...], covariance: np.ndarray) -> list[str]:
    """Interior parameters that the network hardly separates (K1 K2 K3 are always so and are not told)."""
    out = []
    r = correlation(covariance) if len(names) else covariance
    for i, (camera, a) in enumerate(names):
        for j in range(i):
            b = names[j][1]
            if abs(r[i, j]) > 0.95 and not (a.startswith("k") and b.startswith("k")):
                out.append(f"camera '{camera}': {b} and {a} are correlated by {r[i, j]:.3f}: the network hardly separates "
                           "them")
    return out


def _rms(off: list[np.ndarray]) -> np.ndarray | None:
    return np.sqrt(np.mean(np.square(off), axis=0)) if off else None


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _key(name: str) -> str:
    return f"{name}_mm" if name in ("c", "xp", "yp") else name
