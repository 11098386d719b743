"""Intersection: object points from two or more oriented images, with all that says how far to trust them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from ..adjustment import Trace, solve
from ..block import Block
from ..errors import BadProject, DegenerateGeometry
from ..geometry import LocalFrame
from .oriented import Oriented, by_image, frame_of, local, to_vector, vector_covariance
from .rays import Intersection

PARALLEL = 3.0
"""Angle between the outermost rays, in standard deviations of a ray's direction, below which they count as parallel."""
NARROW = np.radians(2.0)
"""Angle below which the depth of a point is warned of."""
CONSENSUS = 6.0
"""Residual length, in standard deviations, of a ray that agrees with the point of two others."""
REJECT = 5.0
"""Length of the standardized residual beyond which a ray is a blunder (chance of a good one: 4e-6)."""
PAIRS = 100
"""Most pairs of rays that are tried for the consensus of one point."""


@dataclass(frozen=True)
class ObjectPoint:
    """An intersected point. xyz (3,): project coordinates [m]; covariance (3, 3) m^2, local axes: image noise and the exterior
    orientations' covariance. angle: between the outermost rays [rad]. images: of its rays; residuals (k, 2) px, observed
    minus projected; redundancy, w (k, 2); used (k,)."""

    name: str
    role: str
    xyz: np.ndarray
    covariance: np.ndarray
    sigma0: float | None
    dof: int
    angle: float
    images: tuple[str, ...]
    residuals: np.ndarray
    redundancy: np.ndarray
    w: np.ndarray
    used: np.ndarray
    given: np.ndarray
    warnings: tuple[str, ...] = ()

    @property
    def rejected(self) -> tuple[str, ...]:
        """Images whose ray was left out."""
        return tuple(i for i, ok in zip(self.images, self.used, strict=True) if not ok)

    def to_json(self) -> dict[str, Any]:
        """One entry of "points" of the command intersect: keys as in adjust, and the rays."""
        sigma, off = np.sqrt(np.diag(self.covariance)), self.xyz - self.given
        w = [[float(x) if np.isfinite(x) else None for x in row] for row in self.w]
        return {"name": self.name, **dict(zip("XYZ", map(float, self.xyz), strict=True)),
                **dict(zip(("sX", "sY", "sZ"), map(float, sigma), strict=True)), "role": self.role,
                **{k: float(d) if np.isfinite(d) else None for k, d in zip(("dX", "dY", "dZ"), off, strict=True)},
                "covariance": self.covariance.tolist(), "sigma0": self.sigma0, "dof": self.dof,
                "angle_deg": float(np.degrees(self.angle)),
                "residuals": [{"image": i, "col": float(v[0]), "row": float(v[1]), "redundancy": [float(x) for x in r], "w": t,
                               "used": bool(u)} for i, v, r, t, u in
                              zip(self.images, self.residuals, self.redundancy, w, self.used, strict=True)],
                "rejected": list(self.rejected), "warnings": list(self.warnings)}


@dataclass(frozen=True)
class Intersected:
    """All points that could be intersected, and of the others the sentence that says why not. trace: of the adjustment."""

    points: tuple[ObjectPoint, ...]
    failed: tuple[tuple[str, str], ...]
    trace: Trace

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command intersect."""
        failed = {"failed": [{"point": n, "why": w} for n, w in self.failed]} if self.failed else {}
        return {"points": [p.to_json() for p in self.points], "iterations": self.trace.iterations,
                "converged": self.trace.converged,
                "stop": self.trace.last.stop, **failed}


def intersect(block: Block, orientations: Iterable[Oriented] | Mapping[str, Oriented], points: Sequence[str] = (), *,
              robust: bool = False, joint: np.ndarray | None = None) -> Intersected:
    """Object points from the images that are oriented; points: names, empty for all that two or more of them see.

    robust: rays that the others refute are left out and named (from three rays on). joint (6 i, 6 i): covariance of all
    exterior orientations together (X, Y, Z, omega, phi, kappa of each, in their order) where they are correlated, as a
    bundle leaves them; without it they are independent. An orientation without covariance is taken as free of error.
    Raises BadProject (unknown names, nothing oriented) and DegenerateGeometry when no point at all can be intersected.
    """
    oriented = by_image(orientations)
    if not oriented:
        raise BadProject(f"{block.name}: no image is oriented; run resect or georeference first")
    frame = frame_of(block, oriented)
    covariances = tuple(vector_covariance(o) for o in oriented.values())
    problem, names, failed = _prepare(block, oriented, frame, points)
    used = np.ones(len(problem.point), bool)
    if problem.count:
        problem = problem.weighted(problem.start(), covariances)
        if robust:
            used = _consistent(problem)
    why = _hopeless(problem.take(used), tuple(oriented), covariances)
    failed += [(names[p], f"point '{names[p]}': {text}") for p, text in sorted(why.items())]
    good = np.array([p not in why for p in range(problem.count)], bool)
    if not good.any():
        raise DegenerateGeometry(failed[0][1] if failed else f"{block.name}: no point is seen in two oriented images; measure "
                                                             "points "
                                 "in observations.csv")
    used = used[good[problem.point]]
    problem = problem.only(good)
    trace = solve(problem.take(used), problem.take(used).start(), manifest={"problem": "intersection", "images": list(oriented)})
    names = [n for n, ok in zip(names, good, strict=True) if ok]
    return Intersected(_describe(block, problem, used, trace, names, tuple(oriented), frame, _joint(oriented, joint)),
                       tuple(failed), trace)


def _prepare(block: Block, oriented: Mapping[str, Oriented], frame: LocalFrame,
             points: Sequence[str]) -> tuple[Intersection, list[str], list[tuple[str, str]]]:
    """The problem of all points with two rays or more, weighted by image noise, and the named points that have fewer."""
    of, order = block.observations, {block.image_index(name): k for k, name in enumerate(oriented)}
    seen = [r for r in range(len(of)) if int(of.image[r]) in order]
    wanted = [block.point_index(p) for p in dict.fromkeys(points)]
    rows: dict[int, list[int]] = {j: [] for j in wanted}
    for r in seen:
        if not points or int(of.point[r]) in rows:
            rows.setdefault(int(of.point[r]), []).append(r)
    images = {j: sorted({block.images[of.image[r]].name for r in rs}) for j, rs in rows.items()}
    failed = [(block.points.names[j], f"point '{block.points.names[j]}': {'no' if not i else 'one'} ray only"
               f"{f' (image {i[0]})' if i else ''}; measure it in another oriented image") for j,
               i in images.items() if j in wanted and len(i) < 2]
    chosen = [j for j, i in images.items() if len(i) >= 2]
    flat = np.array([r for j in chosen for r in rows[j]], int)
    sigma = np.where(np.isfinite(of.sigma[flat]), of.sigma[flat], block.image_px)
    problem = Intersection(
        cameras=tuple((block.camera_of(name), local(o, frame)) for name, o in oriented.items()),
        image=np.array([order[int(i)] for i in of.image[flat]], int),
        point=np.repeat(np.arange(len(chosen)), [len(rows[j]) for j in chosen]),
        pixels=of.pixel[flat], sigma=sigma, weights=np.eye(2) / sigma[:, None, None]**2, count=len(chosen))
    return problem, [block.points.names[j] for j in chosen], failed


def _hopeless(problem: Intersection, images: tuple[str, ...], covariances: tuple[np.ndarray | None, ...]) -> dict[int, str]:
    """Points whose rays cannot be intersected, and why."""
    why: dict[int, str] = {}
    _, unit = problem.rays()
    x = problem.start().reshape(-1, 3)
    for p in range(problem.count):
        rows = np.flatnonzero(problem.point == p)
        names = ", ".join(f"'{images[k]}'" for k in problem.image[rows])
        if len(rows) < 2:
            why[p] = f"one ray only (image {names}) is left; measure it again in another oriented image"
            continue
        angle, noise = _spread(unit[rows]), _direction_noise(problem, rows, covariances)
        if not np.isfinite(x[p]).all() or angle < PARALLEL * noise:
            why[p] = (f"its rays (images {names}) are parallel within their noise: {np.degrees(angle):.4f} degrees apart, "
                      f"{np.degrees(noise):.4f} degrees uncertain; use images farther apart")
            continue
        for r in rows:
            if problem.cameras[problem.image[r]][1].camera(x[p])[2] >= 0:
                why[p] = (f"its rays (images {names}) meet behind image '{images[problem.image[r]]}'; check the point's "
                          "measurements "
                          "and that image's orientation")
    return why


def _spread(unit: np.ndarray) -> float:
    """Largest angle [rad] between unit directions (k, 3)."""
    chord = np.linalg.norm(unit[:, None] - unit[None], axis=2).max()
    return float(2 * np.arcsin(min(chord / 2, 1.0)))


def _direction_noise(problem: Intersection, rows: np.ndarray, covariances: tuple[np.ndarray | None, ...]) -> float:
    """Standard error [rad] of the direction of a typical ray among rows: image noise and attitude."""
    total = 0.0
    for r in rows:
        interior, c = problem.cameras[problem.image[r]][0], covariances[problem.image[r]]
        turn = 0.0 if c is None else float(np.trace(c[3:, 3:])) / 3
        total += (problem.sigma[r] * float(interior.pitch.max()) / interior.c) ** 2 + turn
    return float(np.sqrt(total / len(rows)))


def _consistent(problem: Intersection) -> np.ndarray:
    """(o,) which rays agree: per point of three rays or more the pair that most others confirm, then data snooping."""
    used = np.ones(len(problem.point), bool)
    for p in range(problem.count):
        rows = np.flatnonzero(problem.point == p)
        if len(rows) >= 3:
            one = replace(problem.take(problem.point == p), point=np.zeros(len(rows), int), count=1)
            used[rows] = _snoop(one, _consensus(one))
    return used


def _consensus(one: Intersection) -> np.ndarray:
    """(k,) rays within CONSENSUS of the point of the best pair (truncated squares); a pair may be noisy, so twice as wide."""
    k = len(one.point)
    best, score = np.ones(k, bool), np.inf
    for pair in list(combinations(range(k), 2))[:PAIRS]:
        d = _length(one, one.take(np.array(pair)).start())
        this = float(np.minimum(d**2, CONSENSUS**2).sum())
        if this < score:
            best, score = d < 2 * CONSENSUS, this
    return best if best.sum() >= 2 else np.ones(k, bool)


def _length(one: Intersection, x: np.ndarray) -> np.ndarray:
    """(k,) residual lengths in standard deviations; very large behind the camera."""
    v = one.pixels - one.derivatives(x).pixels if np.isfinite(x).all() else np.full((len(one.point), 2), np.nan)
    v = np.where(np.isfinite(v), v, 1e9)
    return np.sqrt(np.einsum("oa,oab,ob->o", v, one.weights, v))


def _snoop(one: Intersection, used: np.ndarray) -> np.ndarray:
    """Leave out the worst refuted ray, take in every confirmed one, until nothing changes (at least two stay)."""
    seen: set[bytes] = set()
    while used.tobytes() not in seen:
        seen.add(used.tobytes())
        some = one.take(used)
        trace = solve(some, some.start())
        if not trace.converged:
            return used
        test = _tests(one, used, trace.last.x)
        refused = used & (test > REJECT)
        if refused.any() and used.sum() > 2:
            used = used & (np.arange(len(used)) != np.argmax(np.where(refused, test, -np.inf)))
            continue
        joined = used | (test < REJECT)
        if (joined == used).all():
            break
        used = joined
    return used


def _tests(one: Intersection, used: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(k,) residual lengths over their own standard errors: of the residual where used, of the prediction where not."""
    at, q = one.derivatives(x), one.take(used).normal(x).covariance()[0]
    computed, sigma = at.point @ q @ np.swapaxes(at.point, 1, 2), np.linalg.inv(one.weights)
    cov = np.where(used[:, None, None], sigma - computed, sigma + computed)
    v = np.where(np.isfinite(at.pixels), one.pixels - at.pixels, 1e9)
    values, vectors = np.linalg.eigh(cov)
    checked = values > 1e-6 * sigma.max(axis=(1, 2))[:, None]
    along = np.einsum("kab,ka->kb", vectors, v)
    return np.sqrt(np.where(checked, along**2 / np.where(checked, values, 1.0), 0.0).sum(axis=1))


def _joint(oriented: Mapping[str, Oriented], joint: np.ndarray | None) -> np.ndarray | None:
    """(6 i, 6 i) joint covariance of (centre, left rotation vector) of all images. Raises BadProject for a wrong shape."""
    if joint is None:
        return None
    n = 6 * len(oriented)
    if joint.shape != (n, n):
        raise BadProject(f"the joint covariance is {joint.shape[0]} x {joint.shape[1]}, expected {n} x {n} for {len(oriented)} "
                         "images")
    j = np.zeros((n, n))
    for k, o in enumerate(oriented.values()):
        j[6 * k:6 * k + 6, 6 * k:6 * k + 6] = to_vector(o.exterior)
    return j @ joint @ j.T


def _describe(block: Block, problem: Intersection, used: np.ndarray, trace: Trace, names: list[str], images: tuple[str, ...],
              frame: LocalFrame, joint: np.ndarray | None) -> tuple[ObjectPoint, ...]:
    """Every point with its statistics."""
    x = trace.last.x
    at, q = problem.derivatives(x), problem.take(used).normal(x).covariance()
    xyz, (_, unit) = frame.to_map(x.reshape(-1, 3)), problem.rays()
    v, j = problem.pixels - at.pixels, at.point
    r = np.eye(2) - j @ q[problem.point] @ np.swapaxes(j, 1, 2) @ problem.weights
    pqp = np.einsum("oaa->oa", problem.weights @ r)
    checked = (pqp > 1e-9 * np.einsum("oaa->oa", problem.weights)) & used[:, None]
    w = np.where(checked, (problem.weights @ v[..., None])[..., 0] / np.sqrt(np.where(checked, pqp, 1.0)), np.nan)
    redundancy = np.where(used[:, None], np.einsum("oaa->oa", r), 0.0)
    cost = np.einsum("oa,oab,ob->o", v, problem.weights, v)
    out = []
    for p, name in enumerate(names):
        rows = np.flatnonzero(problem.point == p)
        ok = used[rows]
        dof, k = 2 * int(ok.sum()) - 3, block.point_index(name)
        cov = q[p] if joint is None else _propagated(problem, rows[ok], x, q[p], joint)
        angle = _spread(unit[rows[ok]])
        point = ObjectPoint(
            name=name, role=block.points.role[k], xyz=xyz[p], covariance=cov,
            sigma0=float(np.sqrt(cost[rows[ok]].sum() / dof)) if dof > 0 else None, dof=dof, angle=angle,
            images=tuple(images[i] for i in problem.image[rows]), residuals=v[rows], redundancy=redundancy[rows], w=w[rows],
            used=ok,
            given=block.points.xyz[k])
        out.append(replace(point, warnings=_words(point, trace, float(cost[rows[ok]].sum()))))
    return tuple(out)


def _propagated(problem: Intersection, rows: np.ndarray, x: np.ndarray, q: np.ndarray, joint: np.ndarray) -> np.ndarray:
    """(3, 3) covariance of one point by the joint covariance of the orientations: linear propagation through its estimator."""
    some = problem.take(rows)
    gain = q @ np.swapaxes(some.derivatives(x).point, 1, 2) @ some.weights  # (k, 3, 2) d point / d pixels
    noise = np.einsum("kab,k,kcb->ac", gain, some.sigma**2, gain)
    by_image = np.zeros((3, len(joint)))
    for g, j, i in zip(gain, some.by_orientation(x), some.image, strict=True):
        by_image[:, 6 * i:6 * i + 6] -= g @ j
    cov = noise + by_image @ joint @ by_image.T
    return (cov + cov.T) / 2


def _words(point: ObjectPoint, trace: Trace, chi2: float) -> tuple[str, ...]:
    """What a person should know before believing a point."""
    out = [] if trace.converged else [f"did not converge: stopped by '{trace.last.stop}'; do not use"]
    if point.angle < NARROW:
        out.append(f"weak geometry: its rays are only {np.degrees(point.angle):.2f} degrees apart; its depth is uncertain by "
                   f"{np.sqrt(np.linalg.eigvalsh(point.covariance)[-1]):.2f} m")
    if point.rejected:
        out.append(f"rejected: the rays of {', '.join(point.rejected)}; their residuals are listed with used = false")
    if point.dof > 0:
        from scipy.special import gammaincc

        if gammaincc(point.dof / 2, chi2 / 2) < 0.001:
            out.append(f"bad fit: sigma0 = {point.sigma0:.1f}, its rays do not meet within their given errors (chi-square test, "
                       "0.1 %); "
                       "look for a wrong mark or a wrong orientation")
    return tuple(out)
