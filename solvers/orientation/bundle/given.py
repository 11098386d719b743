"""What a Block offers a bundle, in the local frame: observations, coordinates that may be used, priors."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from ...block import Block, ScaleBar, Together
from ...cameras import PARAMETERS, Interior
from ...errors import BadProject, DegenerateGeometry
from ...geometry import Exterior, LocalFrame
from ..resection import PriorOrientation
from ..single import given_prior
from .extras import Extras
from .network import Network
from .parts import parts, told

Datum = Literal["control", "prior", "both", "free"]
SPEED, SPEED_KNOWN, RATE, RATE_RECORDED = 20.0, 2.0, np.radians(15), np.radians(2)
"""Standard errors of a motion: of a velocity that is not known and of one that is [m/s], of a rate of rotation that is not known
and of what a gyroscope's record of it lacks (its zero, its axes, its clock) [rad/s]."""
Begin = Literal["auto", "resection", "dlt", "affine", "prior", "relative", "given"]


@dataclass(frozen=True)
class BundleRequest:
    """What to adjust and how.

    datum: "control" (weighted, fixed where all sigmas are 0), "prior" (onboard positions and angles, no control), "both", or
    "free" (inner constraints on the points whose coordinates are given, on all where fewer than three are).
    free: interior parameters adjusted, for every camera, or for each by name. loss: "huber", "cauchy" or "danish", None for
    least squares. start: how to begin: "auto" (resection, then over tie points, then priors, then a relative orientation),
    or only "resection", "dlt" or "affine" (the linear models over control), "prior" or "relative", or "given" (the images'
    priors and all coordinates of points as they are). compiled: None lets the size decide.
    per_image: free parameters of every image by itself, as "camera@image", instead of one set for each camera; or the names of
    those that are, while the other free ones stay one set (c invariant, xp and yp of every image).
    rolling_shutter: "translation" lets every image move while it is read, "rotation" turn as well (cameras with readout_ms), both
    with the turning that priors hold; "auto" is "rotation" where they hold one.
    model: "orthogonal" is Ono & Hattori's, for long focal lengths; its transform is "iterated" (rays made parallel anew in every
    iteration) or "frozen" (kept as the start values make them).
    """

    datum: Datum = "control"
    free: tuple[str, ...] | dict[str, tuple[str, ...]] = ()
    loss: str | None = None
    start: Begin = "auto"
    images: tuple[str, ...] | None = None
    compiled: bool | None = None
    per_image: bool | tuple[str, ...] = False
    model: Literal["perspective", "orthogonal"] = "perspective"
    transform: Literal["iterated", "frozen"] = "iterated"
    rolling_shutter: Literal["none", "translation", "rotation", "auto"] = "none"


@dataclass(frozen=True)
class Given:
    """A block's data for a bundle, by the block's own indices. known (n, 3) m: coordinates that may be used, NaN where none are;
    approximate (n, 3): those that may only begin; weight (n, 3) m^-2, inf where fixed, 0 where free. priors: by image."""

    block: Block
    request: BundleRequest
    frame: LocalFrame
    image: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    sigma: np.ndarray
    known: np.ndarray
    approximate: np.ndarray
    weight: np.ndarray
    priors: dict[int, PriorOrientation] = field(default_factory=dict)

    def camera(self, image: int) -> Interior:
        return self.block.cameras[self.block.images[image].camera]

    def seen_in(self, image: int) -> np.ndarray:
        """Rows of the observations of one image."""
        order, ends = self._by_image
        return order[ends[image]:ends[image + 1]]

    @cached_property
    def ideal(self) -> np.ndarray:
        """(o, 2) mm, ideal photo coordinates of the observations."""
        out, of = np.empty_like(self.pixels), np.array([i.camera for i in self.block.images], str)[self.image]
        for name, camera in self.block.cameras.items():
            rows = np.flatnonzero(of == name)
            out[rows] = camera.ideal(self.pixels[rows])
        return out

    @cached_property
    def principal(self) -> np.ndarray:
        """(m,) principal distances [mm] of the images."""
        return np.array([self.block.cameras[i.camera].c for i in self.block.images])

    @cached_property
    def unit(self) -> np.ndarray:
        """(o,) standard errors of the observations in the photo [mm]."""
        return self.sigma * np.array([self.block.cameras[i.camera].pitch[0] for i in self.block.images])[self.image]

    @cached_property
    def _by_image(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of the observations, image by image, and where each image's begin."""
        order = np.argsort(self.image, kind="stable")
        return order, np.searchsorted(self.image[order], np.arange(len(self.block.images) + 1))


def given(block: Block, request: BundleRequest) -> Given:
    """Raises BadProject for names that are unknown, points measured twice in one image and missing priors."""
    free = request.free if isinstance(request.free, dict) else {"": request.free}
    apart = () if isinstance(request.per_image, bool) else request.per_image
    for name in (n for names in (*free.values(), apart) for n in names):
        if name not in PARAMETERS:
            raise BadProject(f"'{name}' is not an interior orientation parameter; choose from {', '.join(PARAMETERS)}")
    if missing := [n for n in apart if not any(n in names for names in free.values())]:
        raise BadProject(f"{', '.join(missing)} of every image cannot be adjusted without being free; name it in --free too")
    frame = _frame(block)
    of, roles = block.observations, np.array(block.points.role, dtype=str)
    keep = np.isfinite(of.pixel).all(axis=1)
    if request.images is not None:
        keep &= np.isin(of.image, [block.image_index(name) for name in request.images])
    rows = np.flatnonzero(keep)
    image, point = np.asarray(of.image)[rows].astype(int), np.asarray(of.point)[rows].astype(int)
    _once(block, image, point)
    sigma = np.where(np.isfinite(of.sigma[rows]), of.sigma[rows], block.image_px)
    if not (sigma > 0).all():
        k = int(np.argmax(~(sigma > 0)))
        raise BadProject(f"observations.csv: the sigma of point '{block.points.names[point[k]]}' in image "
                         f"'{block.images[image[k]].name}' is {sigma[k]} px, expected a positive number")
    xyz = np.full((len(block.points), 3), np.nan)
    finite = np.isfinite(block.points.xyz).all(axis=1)
    if finite.any():
        xyz[finite] = frame.to_local(block.points.xyz[finite])
    control = (roles == "control") & finite if request.datum in ("control", "both") else np.zeros(len(roles), bool)
    sigma_m = np.where(np.isfinite(block.points.sigma), block.points.sigma, block.control_m)
    fixed = (sigma_m <= 0).all(axis=1)
    weight = np.where(control[:, None], 1 / np.maximum(sigma_m, 1e-6) ** 2, 0.0)
    weight[control & fixed] = np.inf
    used = roles != "check"
    priors: dict[int, PriorOrientation] = {}
    if request.datum in ("prior", "both"):
        for i in np.unique(image):
            whole = _prior(block, int(i), frame)
            if whole is not None and whole.count:
                priors[int(i)] = whole
        if not priors:
            raise BadProject(f"{block.name}: no image has a prior with sigma_m; give [images.NAME.prior] X, Y, Z, omega_deg, "
                             "phi_deg, kappa_deg and sigma_m in project.toml, or take another datum")
    return Given(block, request, frame, image, point, of.pixel[rows], sigma, np.where(control[:, None], xyz, np.nan),
                 np.where(used[:, None], xyz, np.nan), weight, priors)


def _prior(block: Block, image: int, frame: LocalFrame) -> PriorOrientation | None:
    """An image's weighted prior: position and angles, or a position alone."""
    prior = block.images[image].prior
    if prior is None or prior.centre is None:
        return None
    if prior.angles is not None:
        return given_prior(block, block.images[image].name, frame)
    sigma = np.full(3, np.inf) if prior.sigma_m is None else np.asarray(prior.sigma_m, float)
    return PriorOrientation.of(Exterior(np.eye(3), frame.to_local(prior.centre)), np.diag([*sigma**2, np.inf, np.inf, np.inf]))


def _frame(block: Block) -> LocalFrame:
    """The block's local frame: about its known points, or about its priors where no point is known."""
    xyz = block.points.xyz
    if not np.isfinite(xyz).all(axis=1).any():
        centres = [i.prior.centre for i in block.images if i.prior is not None and i.prior.centre is not None]
        xyz = np.array(centres, float).reshape(-1, 3)
    return LocalFrame.around(xyz, block.crs, block.frame)


def _once(block: Block, image: np.ndarray, point: np.ndarray) -> None:
    key = image * (len(block.points) + 1) + point
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if len(twice):
        k = order[twice[0]]
        raise BadProject(f"observations.csv: point '{block.points.names[point[k]]}' is measured twice in image "
                         f"'{block.images[image[k]].name}'; keep one of the two")


def network(data: Given, poses: dict[int, Exterior], xyz: np.ndarray) -> tuple[Network, np.ndarray, list[str]]:
    """The network of the oriented images and of the points with a start xyz (n, 3) that two of them see (one is enough for
    control); its x; and what was left out, in words.

    Images keep their order. Unknown points follow the first images that see them, then come those held in the border, fixed
    points come last.
    """
    block, request, warnings = data.block, data.request, []
    images = sorted(poses)
    ok = np.isin(data.image, images)
    rays = np.bincount(data.point[ok], minlength=len(block.points))
    known = np.isfinite(data.known).all(axis=1)
    use = ((rays >= 2) | ((rays >= 1) & known)) & np.isfinite(xyz).all(axis=1)
    warnings += _left_out(data, poses, rays, use)
    ok &= use[data.point]
    if not ok.any():
        raise DegenerateGeometry(f"{block.name}: no point is seen in two oriented images; measure points in observations.csv")
    fixed = np.asarray(np.isinf(data.weight).all(axis=1))
    renumber = np.full(len(block.images), -1)
    renumber[images] = np.arange(len(images))
    image, point = renumber[data.image[ok]], data.point[ok]
    held, bars, together, said = _held(data, use & (rays > 0))
    warnings += said
    fixed &= ~held
    points = _sorted(image, point, fixed * 2 + held, len(block.points))
    place = np.full(len(block.points), -1)
    place[points] = np.arange(len(points))
    order = np.lexsort((image, place[point]))
    lens = {i: block.images[i].camera + (f"@{block.images[i].name}" if request.per_image else "") for i in images}
    names = list(dict.fromkeys(lens.values()))
    of = {lens[i]: block.images[i].camera for i in images}
    free = {n: request.free.get(of[n], ()) if isinstance(request.free, dict) else request.free for n in names}
    own = PARAMETERS if isinstance(request.per_image, bool) else request.per_image
    live, unknown = int((~fixed & ~held)[points].sum()), int((~fixed[points]).sum())
    weight = np.minimum(data.weight[points], 1e12)
    weight[unknown:] = 0.0
    for t in together:
        weight[place[[block.point_index(n) for n in t.points]]] = 0.0
    net = Network(
        images=tuple(block.images[i].name for i in images), cameras=tuple(names),
        interiors=tuple(block.cameras[of[n]] for n in names),
        camera=np.array([names.index(lens[i]) for i in images]),
        points=tuple(block.points.names[j] for j in points),
        image=image[order], point=place[point][order], pixels=np.ascontiguousarray(data.pixels[ok][order]),
        sigma=data.sigma[ok][order],
        free=tuple(tuple(p for p in PARAMETERS if p in free.get(n, ())) for n in names), known=data.known[points], weight=weight,
        live=live, priors=tuple(data.priors.get(i) for i in images), loss=request.loss,
        extras=_extras(data, images, place, unknown - live, bars, together), base=tuple(of[n] for n in names), own=own)
    start = xyz[points].copy()
    start[unknown:] = data.known[points][unknown:]
    x = net.pack(np.array([poses[i].vector for i in images]), np.array([c.parameters for c in net.interiors]), start)
    return net, x, warnings


def _held(data: Given, use: np.ndarray) -> tuple[np.ndarray, list[ScaleBar], list[Together], list[str]]:
    """Points that scale bars and common covariances tie together (n,), the bars and covariances in use, and what is not.

    Raises BadProject for a bar or a covariance that names a point there is not.
    """
    block, held, said = data.block, np.zeros(len(data.block.points), bool), []
    bars, together = [], []
    for bar in block.scale_bars:
        ends = [block.point_index(bar.first), block.point_index(bar.second)]
        if use[ends].all():
            held[ends] = True
            bars.append(bar)
        else:
            said.append(f"the scale bar from '{bar.first}' to '{bar.second}' takes no part: an end is not measured in two images")
    for t in block.together:
        rows = [block.point_index(name) for name in t.points]
        known = np.isfinite(data.known[rows]).all(axis=1) & use[rows]
        if known.all():
            held[rows] = True
            together.append(t)
        elif known.any():
            said.append(f"the common covariance of '{t.points[0]}' ... takes no part: not all of its points are measured "
                        "control; their own sigmas are used")
    return held, bars, together, said


def _extras(data: Given, images: list[int], place: np.ndarray, held: int, bars: list[ScaleBar],
            together: list[Together]) -> Extras:
    """Bars, common covariances, shifts and lever arms by the network's own indices."""
    block, gps = data.block, data.block.gps
    ends = np.array([[place[block.point_index(b.first)], place[block.point_index(b.second)]] for b in bars], int).reshape(-1, 2)
    correlated = tuple((place[[block.point_index(n) for n in t.points]], np.linalg.cholesky(np.linalg.inv(t.covariance)).T)
                       for t in together)
    names, of, levers = (), None, None
    if data.priors and gps.shift != "none":
        strips = [block.images[i].strip if gps.shift == "strip" else "block" for i in images]
        names = tuple(dict.fromkeys(s for s, i in zip(strips, images, strict=True) if s and i in data.priors))
        of = np.array([names.index(s) if s in names and i in data.priors else -1 for s, i in zip(strips, images, strict=True)])
    if data.priors and any(gps.lever_arm):
        forward, right, down = gps.lever_arm
        levers = np.tile([-right, -forward, down], (len(images), 1))
    moving = moving_parameters(data, images)
    motion, sigma, readout = known_motion(data, images) if moving else (np.zeros((0, 6)), np.zeros((0, 6)), np.zeros(0))
    return Extras(held, ends, np.array([b.length for b in bars]), np.array([b.sigma for b in bars]), correlated, names, of,
                  gps.shift_sigma, levers, moving, motion, sigma, readout, known_turning(data, images))


def moving_parameters(data: Given, images: list[int]) -> int:
    """Unknowns of each image's motion while it is read: 0, 3 or 6."""
    asked = data.request.rolling_shutter
    if asked == "auto":
        turned = data.request.model == "perspective" and known_turning(data, images).any()
        asked = "rotation" if turned and any(data.block.images[i].camera in data.block.readout_ms for i in images) else "none"
    return {"none": 0, "translation": 3, "rotation": 6}[asked]


def known_motion(data: Given, images: list[int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What is known of the images' motion while they are read (m, 6), its standard errors (m, 6), and readout times (m,) s.

    Raises BadProject where no camera has a readout time.
    """
    block = data.block
    readout = np.array([block.readout_ms.get(block.images[i].camera, 0.0) for i in images]) * 1e-3
    if not readout.any():
        raise BadProject(f"{block.name}: no camera has a readout time; write readout_ms, from the first row to the last, into "
                         "[cameras.NAME] of project.toml, or leave out --rolling-shutter")
    motion, sigma = np.zeros((len(images), 6)), np.tile([SPEED] * 3 + [RATE] * 3, (len(images), 1))
    for row, i in enumerate(images):
        velocity, prior = velocity_of(data, i), block.images[i].prior
        if prior is not None and prior.turning is not None:
            sigma[row, 3:] = RATE_RECORDED
        if velocity is not None:
            stated = prior.sigma_velocity if prior is not None else None
            motion[row, :3], sigma[row, :3] = velocity, SPEED_KNOWN if stated is None else stated
    return motion, sigma, readout


def known_turning(data: Given, images: list[int]) -> np.ndarray:
    """(m, k, 3) rad what gyroscopes recorded while the images were read, 0 where they did not."""
    priors = enumerate(data.block.images[i].prior for i in images)
    known = {row: p.turning for row, p in priors if p is not None and p.turning is not None}
    count = max((len(v) for v in known.values()), default=2)
    out = np.zeros((len(images), count, 3))
    for row, v in known.items():
        at = np.linspace(0, len(v) - 1, count)
        out[row] = np.stack([np.interp(at, np.arange(len(v)), v[:, axis]) for axis in range(3)], 1)
    return out


def velocity_of(data: Given, image: int) -> np.ndarray | None:
    """(3,) m/s in local axes, None where it is not known."""
    prior = data.block.images[image].prior
    if prior is None or prior.velocity is None:
        return None
    base = prior.centre if prior.centre is not None else data.frame.origin
    ends = data.frame.to_local(np.array([base, base + prior.velocity]))
    return ends[1] - ends[0]


def _sorted(image: np.ndarray, point: np.ndarray, fixed: np.ndarray, n: int) -> np.ndarray:
    """Points that are seen, by the first and second image that see them, fixed ones last (by
    their kind `fixed`): neighbours in memory share images."""
    order = np.lexsort((image, point))
    begin = np.searchsorted(point[order], np.arange(n))
    count = np.bincount(point, minlength=n)
    seen = np.flatnonzero(count)
    first = image[order][begin[seen]]
    second = image[order][begin[seen] + (count[seen] > 1)]
    return seen[np.lexsort((seen, second, first, fixed[seen]))]


def _left_out(data: Given, poses: dict[int, Exterior], rays: np.ndarray, use: np.ndarray) -> list[str]:
    """What takes no part, in words."""
    block, out = data.block, []
    counts = np.bincount(data.image, minlength=len(block.images))
    wanted = data.request.images
    taken = [(k, i.name) for k, i in enumerate(block.images) if k not in poses and (wanted is None or i.name in wanted)]
    missing, empty = [n for k, n in taken if counts[k]], [n for k, n in taken if not counts[k]]
    if empty:
        out.append(f"{len(empty)} image(s) have no observations: {_few(empty)}")
    if missing:
        out += _apart(data, poses)
        out.append(f"{len(missing)} image(s) could not be oriented and take no part: "
                   + _few([f"{name} ({counts[block.image_index(name)]} observations)" for name in missing]))
    single = [block.points.names[j] for j in np.flatnonzero((rays == 1) & ~use)]
    if single:
        out.append(f"{len(single)} point(s) are seen in one oriented image only and take no part: {_few(single)}")
    lost = [block.points.names[j] for j in np.flatnonzero((rays >= 2) & ~use)]
    if lost:
        out.append(f"{len(lost)} point(s) could not be intersected and take no part: {_few(lost)}")
    return out


def _apart(data: Given, poses: dict[int, Exterior]) -> list[str]:
    """A sentence where a part of the block takes no part because it shares no point with the rest."""
    fixed = np.asarray(np.isinf(data.weight).all(axis=1))[data.point]
    found = parts(data.image[~fixed], data.point[~fixed])
    lost = [part for part in found if len(part) > 1 and not any(int(i) in poses for i in part)]
    if not lost:
        return []
    return [f"the block falls into {len(found)} parts that share no point; not adjusted is that of image(s) "
            f"{told([data.block.images[i].name for i in lost[0]])}: measure tie points to the others, or give it control"]


def _few(names: list[str]) -> str:
    return ", ".join(names[:6]) + (" ..." if len(names) > 6 else "")
