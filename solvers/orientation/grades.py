"""What control of each grade is worth: errors at independent check points, for a simulated flight or a measured project."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..adjustment import Options
from ..block import Block, Image, Observations, Points
from ..cameras import Interior, project
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, exp
from .bundle import Adjusted, BundleRequest, adjust
from .bundle.given import Datum
from .corners import corner_control, corner_orientation, vertical_corners, with_corners
from .footprint import corner_pixels
from .intersection import ObjectPoint, intersect
from .oriented import Known, Oriented, frame_of, local
from .single import Request, orient

COARSE_M = (2.5, 2.5, 5.0)
"""Standard errors of control taken from a map or a satellite image [m]."""
PATIENT = Options(max_iterations=300, max_trials=20, step_tolerance=1e-6, cost_tolerance=1e-13, shift_tolerance=1e-3)
DOUBTFUL = 1.3
"""sigma0 from which an adjustment is begun in another way as well."""
LEAST_CHECKS = 3
"""Check points below which a project's control is checked by leaving each point out in turn."""


@dataclass(frozen=True)
class Flight:
    """A simulated flight with its truth. exteriors: one per image, local metres; control (n, 3), check (k, 3) m on the ground;
    z: mean height of the ground, relief: its departure from it [m]."""

    interior: Interior
    exteriors: tuple[Exterior, ...]
    control: np.ndarray
    check: np.ndarray
    z: float
    relief: float
    image_px: float = 0.5


@dataclass(frozen=True)
class Grade:
    """Errors at independent check points [m]: horizontal and vertical root mean square, the same as the covariances predict
    (None where a method states none), how many check points, and failed images."""

    method: str
    rms_horizontal: float
    rms_vertical: float
    predicted_horizontal: float | None
    predicted_vertical: float | None
    points: int
    images: int


def compare_control(flight: Flight, rng: np.random.Generator, *, gps_m: Sequence[float] = (3.0, 3.0, 5.0),
                    imu_deg: Sequence[float] = (1.0, 1.0, 3.0), coarse_m: Sequence[float] = COARSE_M,
                    surveyed_m: Sequence[float] = (0.02, 0.02, 0.03)) -> tuple[Grade, ...]:
    """Check points intersected from images oriented in five ways, one draw of all errors.

    Vertical corners (the printed formula), onboard GPS and IMU (whole rotation), the corners of it as correlated control
    (the same thing, as it must be), coarse control (map or satellite image grade) and surveyed control. The three onboard
    methods share one draw of GPS and IMU errors.
    """
    block, control_of = _simulated(flight, rng), len(flight.control)
    onboard = tuple(_disturbed(f"i{k}", e, np.array(gps_m), np.radians(imu_deg), rng) for k, e in enumerate(flight.exteriors))
    out = []
    vertical = [_from_corners(block, o.image,
                              vertical_corners(flight.interior, o.exterior.centre, float(o.exterior.angles[2]), flight.z))
                for o in onboard]
    out.append(_graded("vertical corners (printed formula)", block, vertical, flight))
    out.append(_graded("onboard GPS and IMU", block, onboard, flight))
    corners = [corner_control(block, o, flight.z, flight.relief) for o in onboard]
    out.append(_graded("onboard corners as correlated control", block, [corner_orientation(block, c) for c in corners], flight))
    for name, sigma in (("coarse control", coarse_m), ("surveyed control", surveyed_m)):
        moved = flight.control + np.array(sigma) * rng.standard_normal((control_of, 3))
        points = replace(block.points, xyz=np.vstack([moved, flight.check]),
                         sigma=np.vstack([np.broadcast_to(sigma, (control_of, 3)), np.full((len(flight.check), 3), np.nan)]))
        graded = replace(block, points=points)
        solved = [_resected(graded, i.name) for i in block.images]
        out.append(_graded(name, block, [o for o in solved if o is not None], flight))
    return tuple(out)


def _simulated(flight: Flight, rng: np.random.Generator) -> Block:
    """Measurements of everything each image sees; all points stated at their truth."""
    xyz, n = np.vstack([flight.control, flight.check]), len(flight.control)
    image, point, pixel = [], [], []
    for k, e in enumerate(flight.exteriors):
        at = project(flight.interior, e, xyz)
        seen = np.flatnonzero(np.isfinite(at).all(axis=1) & flight.interior.inside(at))
        image += [k] * len(seen)
        point += list(seen)
        pixel.append(at[seen] + flight.image_px * rng.standard_normal((len(seen), 2)))
    return Block("flight", "local", {"cam": flight.interior}, tuple(Image(f"i{k}", "cam") for k in range(len(flight.exteriors))),
                 Points(tuple(f"P{k}" for k in range(len(xyz))), xyz, np.full((len(xyz), 3), np.nan),
                        ("control",) * n + ("check",) * (len(xyz) - n)),
                 Observations(np.array(image, int), np.array(point, int), np.vstack(pixel), np.full(len(image), flight.image_px)))


def _disturbed(image: str, true: Exterior, sigma_m: np.ndarray, sigma_rad: np.ndarray, rng: np.random.Generator) -> Known:
    """An orientation with GPS and IMU errors (tilt about north, about east, yaw) and the covariance that says so."""
    d = sigma_rad * rng.standard_normal(3)
    given = Exterior(true.m @ exp(d), true.centre + sigma_m * rng.standard_normal(3))
    cov = np.zeros((6, 6))
    cov[:3, :3], cov[3:, 3:] = np.diag(sigma_m**2), given.m @ np.diag(sigma_rad**2) @ given.m.T
    return Known(image, given, given.angle_covariance(cov))


def _from_corners(block: Block, image: str, xyz: np.ndarray) -> Known:
    """Orientation of an image by its four corners as control, each alike and free of error, as printed."""
    single = Block("corners", block.crs, block.cameras, (Image(image, block.images[block.image_index(image)].camera),),
                   Points(("F1", "F2", "F3", "F4"), xyz, np.full((4, 3), 1.0), ("control",) * 4),
                   Observations(np.zeros(4, int), np.arange(4), corner_pixels(block.camera_of(image)),
                                np.full(4, block.image_px)), frame=block.frame)
    return Known(image, orient(single, Request(image)).exterior)


def _resected(block: Block, image: str) -> Known | None:
    try:
        o = orient(block, Request(image))
    except DegenerateGeometry:
        return None
    return Known(image, o.exterior, o.covariance)


def _graded(method: str, block: Block, oriented: Sequence[Known], flight: Flight) -> Grade:
    """Errors of the check points that two or more images see."""
    names = block.points.names[len(flight.control):]
    try:
        points = [p for p in intersect(block, oriented).points if p.name in names]
    except DegenerateGeometry:
        points = []
    return _grade(method, points, all(o.covariance is not None for o in oriented), len(oriented))


def _grade(method: str, points: Sequence[ObjectPoint | _Checked], stated: bool, images: int) -> Grade:
    if not points:
        return Grade(method, float("nan"), float("nan"), None, None, 0, images)
    error = np.array([p.xyz - p.given for p in points])
    var = np.array([np.diag(p.covariance) for p in points]).mean(axis=0)
    rms = np.sqrt((error**2).mean(axis=0))
    return Grade(method, float(np.hypot(rms[0], rms[1])), float(rms[2]), float(np.sqrt(var[0] + var[1])) if stated else None,
                 float(np.sqrt(var[2])) if stated else None, len(points), images)


# -- a project's own points -------------------------------------------------------------------------------------------------


def compare_project(block: Block, onboard: Sequence[Oriented], z: float, relief: float, *, coarse_m: Sequence[float] = COARSE_M,
                    seed: int = 0) -> tuple[tuple[Grade, ...], tuple[str, ...]]:
    """The same comparison with a project's measurements. Returns the table and how it was checked, in words.

    Onboard orientations are used as they are; corners, coarse and surveyed control go through a bundle adjustment of everything
    that was measured. Coarse control is the project's with drawn errors of coarse_m: there is no other way to know better.
    Checked at the points of role check; with fewer than three of them, at every control point, left out in turn where control
    orients the images. Raises BadProject where the project has too few points seen twice.
    """
    seen = {o.image for o in onboard}
    block = _only(block, seen)
    twice = _seen_twice(block)
    checks = tuple(n for n in twice if block.points.role[block.point_index(n)] == "check")
    apart = len(checks) >= LEAST_CHECKS
    names = checks if apart else tuple(n for n in twice if block.points.role[block.point_index(n)] != "tie")
    if len(names) < LEAST_CHECKS:
        raise BadProject(f"{block.name}: a comparison needs {LEAST_CHECKS} points with known coordinates, each measured in two "
                         f"images, there are {len(names)}; measure more of them in observations.csv")
    frame = frame_of(block, {o.image: o for o in onboard})
    vertical = []
    for o in onboard:
        at = local(o, frame)
        level = float(frame.to_local(np.append(o.exterior.centre[:2], z))[2])
        corners = vertical_corners(block.camera_of(o.image), at.centre, float(at.angles[2]), level)
        vertical.append(_from_corners(block, o.image, frame.to_map(corners)))
    cornered = with_corners(_all_check(block), [corner_control(block, o, z, relief) for o in onboard])
    drawn = np.array(coarse_m) * np.random.default_rng(seed).standard_normal((len(block.points), 3))
    moved = replace(block, points=replace(block.points, xyz=block.points.xyz + drawn, sigma=np.tile(coarse_m, (len(drawn), 1))))
    said = [f"checked at {len(names)} check points" if apart else
            f"checked at {len(names)} control points, each left out of every adjustment by control in its turn"]
    undetermined = 0.25 * float(np.mean([abs(o.exterior.centre[2] - z) for o in onboard]))
    rows = [_direct("vertical corners (printed formula)", block, names, vertical),
            _direct("onboard GPS and IMU", block, names, onboard),
            _adjusted("onboard corners as correlated control", cornered, block, names, "prior", True, undetermined, said),
            _adjusted(f"coarse control ({coarse_m[0]:g} m, height {coarse_m[2]:g} m; drawn)", moved, block, names, "control",
                      apart, undetermined, said),
            _adjusted("surveyed control", block, block, names, "control", apart, undetermined, said)]
    return tuple(rows), tuple(said)


def _only(block: Block, images: set[str]) -> Block:
    """The observations of some images."""
    keep = np.array([i.name in images for i in block.images], bool)[block.observations.image]
    of = block.observations
    return replace(block, observations=Observations(of.image[keep], of.point[keep], of.pixel[keep], of.sigma[keep]))


def _seen_twice(block: Block) -> tuple[str, ...]:
    """Points with coordinates that two images see."""
    rays = np.bincount(block.observations.point, minlength=len(block.points))
    return tuple(n for n, k, x in zip(block.points.names, rays, block.points.xyz, strict=True) if k >= 2 and np.isfinite(x).all())


def _all_check(block: Block) -> Block:
    """No point is control."""
    return replace(block, points=replace(block.points, role=tuple("check" if r == "control" else r for r in block.points.role)))


def _direct(method: str, block: Block, names: Sequence[str], oriented: Sequence[Oriented]) -> Grade:
    """Check points intersected from orientations as they are."""
    points, stated = [], all(o.covariance is not None for o in oriented)
    for name in names:
        try:
            points += [_checked(block, name, p.xyz, p.covariance) for p in intersect(block, oriented, (name,)).points]
        except (BadProject, DegenerateGeometry):
            continue
    return _grade(method, points, stated, len(oriented))


def _adjusted(method: str, block: Block, true: Block, names: Sequence[str], datum: Datum, at_once: bool, undetermined: float,
              said: list[str]) -> Grade:
    """Check points of bundle adjustments that do not know them; true: the block with their surveyed coordinates; undetermined:
    predicted error [m] from which a point says nothing."""
    points: list[_Checked] = []
    why, lost = "", 0
    for group in [tuple(names)] if at_once else [(n,) for n in names]:
        known = block
        for name in group:
            known = known.with_role(name, "check")
        try:
            done = _settled(known, datum)
        except (BadProject, DegenerateGeometry) as error:
            why = str(error)
            continue
        if not done.trace.converged:
            lost += len(group)
            continue
        found = {p.name: p for p in done.points}
        points += [_checked(true, n, found[n].xyz, found[n].covariance) for n in group if n in found]
    if why:
        said.append(f"{method}: {'' if points else 'no result: '}{why}")
    if lost:
        said.append(f"{method}: {lost} point(s) left out whose adjustment did not converge")
    sure = [p for p in points if np.trace(p.covariance) < undetermined**2]
    if len(sure) < len(points):
        said.append(f"{method}: {len(points) - len(sure)} point(s) left out that are not determined (predicted error beyond "
                    f"{undetermined:.0f} m)")
    return _grade(method, sure, True, len(block.images))


def _settled(block: Block, datum: Datum) -> Adjusted:
    """The adjusted block; where it does not fit, the better one of two starts: control to metres and few common points leave
    false minima. Raises what `adjust` raises."""
    done = adjust(block, BundleRequest(datum=datum), PATIENT)
    if (done.trace.converged and (done.sigma0 or 0.0) < DOUBTFUL) or datum != "control":
        return done
    try:
        other = adjust(block, BundleRequest(datum=datum, start="affine"), PATIENT)
    except DegenerateGeometry:
        return done
    return other if other.trace.converged and (not done.trace.converged or other.cost < done.cost) else done


class _Checked(NamedTuple):
    """A check point: found and given coordinates (3,), covariance (3, 3) of their difference."""

    xyz: np.ndarray
    given: np.ndarray
    covariance: np.ndarray


def _checked(block: Block, name: str, xyz: np.ndarray, covariance: np.ndarray) -> _Checked:
    """A point found (3,) with its covariance, beside its surveyed coordinates, which have standard errors of their own."""
    j = block.point_index(name)
    sigma = np.where(np.isfinite(block.points.sigma[j]), block.points.sigma[j], block.control_m)
    return _Checked(xyz, block.points.xyz[j], covariance + np.diag(sigma**2))
