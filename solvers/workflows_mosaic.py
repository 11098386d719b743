"""The walk of a mosaic: photos -> tie points -> registration -> composition."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .adjustment import Iteration, Trace
from .block import Block, Image, Observations, Points
from .cameras import Interior
from .errors import BadProject, PhotogrammetryError
from .execution import Progress
from .geometry import Exterior, LocalFrame
from .io import (
    assemble,
    new_run,
    photo_path,
    photo_size,
    read_corners,
    read_exif,
    read_onboard,
    read_project,
    save_trace,
    to_preview,
    write_json,
)
from .io.crs import short_crs
from .io.runs import PREVIEW
from .matching import Ties
from .mosaic import Registration, RegistrationRequest, check_ties, fit_plane, rectification, register
from .mosaic.register import Model
from .mosaic.registration import Level, Method
from .orientation import BundleRequest, CornerControl, adjust, georeference, with_corners
from .workflows_compose import ComposeRequest, compose_photos
from .workflows_matching import find_ties, ties_in_format, with_ties
from .workflows_orientation import orientations_of

HELD_OUT = 10
"""Every tenth tie point judges the mosaic and takes no part in making it."""
TURNED = 20.0
"""Degrees from which a recorded yaw is called wrong."""


@dataclass(frozen=True)
class MosaicRequest:
    """How a mosaic is made. kind None: the best that the data allow; crs: of a folder of photos, None: their UTM zone.
    corners: file of image corners, written by direct georeferencing, as weighted control."""

    kind: Level | None = None
    register: Method = "simultaneous"
    model: Model = "auto"
    plane: float | Literal["fitted"] | None = None
    reference: str | None = None
    allow_partial: bool = False
    crs: str | None = None
    corners: str | None = None
    compose: ComposeRequest = field(default_factory=ComposeRequest)


class Site(NamedTuple):
    """What a mosaic is made of. block: tie points in it; held (o,): tie points kept apart, images by `names`; photos: files by
    image; onboard: exterior orientations as recorded, map coordinates; failed: photos that could not be read or matched."""

    block: Block
    held: Observations
    photos: dict[str, Path]
    onboard: Mapping[str, Exterior]
    failed: dict[str, str]
    notes: tuple[str, ...]
    calibrated: bool


class Registered(NamedTuple):
    """A registration and what judges it: residuals of tie points held out (k,) px, headings, check points' rms [m]."""

    registration: Registration
    site: Site
    check_px: np.ndarray
    check_rms_m: float | None
    headings: tuple[dict[str, Any], ...]


class Mosaicked(NamedTuple):
    """A mosaic on disk: its registration, what composing said, the run of a project, seconds until it was registered."""

    registered: Registered
    composed: dict[str, Any]
    run: Path | None
    seconds: float

    @property
    def complete(self) -> bool:
        """Whether every photo and every control point took part."""
        r = self.registered.registration
        return not (r.unused or r.rejected or self.registered.site.failed)

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command mosaic."""
        said = registered_json(self.registered)
        seam = {"seam_rms": said["check_ties"]["rms_px"] if said["check_ties"] else None}
        return {**seam, **self.composed, **said, "notes": [*said["notes"], *self.composed["notes"]],
                "seconds": {"register": self.seconds, **self.composed["seconds"]},
                "run": None if self.run is None else str(self.run)}


def registered_json(done: Registered) -> dict[str, Any]:
    """The JSON of a registration."""
    r, px = done.registration, done.check_px
    size = [float(np.median([_pixel(r, k) for k in range(len(r.names))]))]
    unused = {**done.site.failed, **r.unused}
    images = [{"name": n, "used": True, "why": "", "sigma": float(s), "sigma_px": float(s / size[0])}
              for n, s in zip(r.names, r.corner_sigma, strict=True)]
    images += [{"name": n, "used": False, "why": w} for n, w in unused.items()]
    held = None if not len(px) else {"count": len(px), "median_px": float(np.median(px)), "p90_px": float(np.percentile(px, 90)),
                                     "rms_px": float(np.sqrt(np.mean(px**2)))}
    return {"images": images, "kind": r.level, "register": r.method, "unit": r.unit, "crs": r.crs,
            "plane": {"z0": float(r.plane[0]), "zx": float(r.plane[1]), "zy": float(r.plane[2])}, "rms_px": r.rms_px,
            "check_rms_m": done.check_rms_m, "check_ties": held, "headings": list(done.headings), "rejected": list(r.rejected),
            "iterations": r.trace.iterations, "stop": r.trace.last.stop, "notes": list(done.site.notes),
            "warnings": list(r.warnings)}


def mosaic_of(source: Path | str, out: Path | str, request: MosaicRequest | None = None,
              report: Callable[[Progress], object] | None = None) -> Mosaicked:
    """Register the photos of a project or folder and compose them into one raster. Raises PhotogrammetryError."""
    request, start = request or MosaicRequest(), time.perf_counter()
    done = registered(Path(source), request, report)
    seconds = time.perf_counter() - start
    onto = replace(request.compose, crs=done.site.block.crs)
    composed = compose_photos(done.registration, done.site.photos, Path(out), onto, report)
    run = None
    if (Path(source) / "project.toml").is_file():
        run = new_run(Path(source), "mosaic")
        save_trace(done.registration.trace, run, "trace-registration")
        to_preview(Path(out), run / PREVIEW)
    made = Mosaicked(done, composed, run, seconds)
    if run is not None:
        write_json(run / "result.json", made.to_json())
    return made


def registered(source: Path, request: MosaicRequest, report: Callable[[Progress], object] | None = None) -> Registered:
    """The registration of the photos of a project or folder, with everything that judges it."""
    return registered_site(_site(source, request, report), request)


def registered_block(block: Block, folder: Path, request: MosaicRequest) -> Registered:
    """The registration of a project's photos by the measurements of `block`, edited or not; its tie points must be there.

    Raises PhotogrammetryError.
    """
    photos = {i.name: photo_path(folder, block, i.name) for i in block.images if i.file is not None}
    if len(photos) < 2:
        raise BadProject(f"{folder}: {len(photos)} of its images have photos; a mosaic needs two and more")
    return registered_site(_ready(block, photos, {}, (), True), request)


def registered_site(site: Site, request: MosaicRequest) -> Registered:
    """The registration of a site's photos, with everything that judges it."""
    how = RegistrationRequest(request.kind, request.register, _model(site, request), request.plane, request.reference)
    registration = register(site.block, how, _bundle)
    px = check_ties(registration, tuple(i.name for i in site.block.images), site.held)
    px = px[np.isfinite(px)]
    headings = _headings(registration, site)
    wrong = [h for h in headings if abs(h["correction_deg"]) > TURNED]
    said = []
    if wrong:
        back = sum(abs(h["correction_deg"]) > 180 - TURNED for h in wrong)
        names = ", ".join(f"'{h['image']}' ({h['correction_deg']:+.0f} deg)" for h in wrong[:8])
        names += " ..." if len(wrong) > 8 else ""
        said = [f"the recorded yaw of {len(wrong)} photo{'s' * (len(wrong) > 1)} is wrong"
                + (f", {back} of them reversed" if back else "")
                + f": {names}; the photos' content was used instead"]
    registration = replace(registration, warnings=(*registration.warnings, *said))
    return Registered(registration, site, px, _check_points(registration, site.block), headings)


def rectify_photo(project: Path | str, image: str, out: Path | str, plane: float | Literal["fitted"] | None = None,
                  compose: ComposeRequest | None = None) -> dict[str, Any]:
    """One photo on a plane, in true scale: the rectified and ratioed photo. Raises PhotogrammetryError."""
    folder = Path(project)
    block, oriented, how = _oriented(folder, image)
    known = np.isfinite(block.points.xyz).all(axis=1)
    frame = LocalFrame.around(block.points.xyz, block.crs, block.frame) if known.any() else LocalFrame.around(
        oriented.centre[None], block.crs, block.frame)
    local = Exterior(oriented.m, frame.to_local(oriented.centre))
    points = frame.to_local(block.points.xyz[known]) if known.any() else np.zeros((0, 3))
    at, where = _plane(block, points, plane, frame)
    interior = block.camera_of(image)
    seen = rectification(interior, local, at)
    registration = Registration("exterior", "controlled", "simultaneous", (image,), (interior,), None, (local,), at, frame, "m",
                                np.full((1, 6, 6), np.nan), np.full(1, np.nan), 0.0, _no_trace())
    done = compose_photos(registration, {image: photo_path(folder, block, image)}, Path(out), compose or ComposeRequest(
        blend="none"))
    return {**done, "image": image, "tilt_deg": float(np.degrees(seen.tilt)), "isocentre": seen.isocentre.tolist(),
            "nadir": _numbers(seen.nadir), "principal_point": _numbers(seen.principal), "height_m": seen.height,
            "isocentre_gsd_m": seen.gsd, "plane": {"z0": float(at[0]), "zx": float(at[1]), "zy": float(at[2])},
            "plane_from": where, "orientation_from": how, "horizon_in_photo": seen.horizon,
            "distortion_removed": bool(interior.coefficients.any())}


# -- what it is made of -----------------------------------------------------------------------------------------------------


def _site(source: Path, request: MosaicRequest, report: Callable[[Progress], object] | None) -> Site:
    if (source / "project.toml").is_file():
        if request.crs:
            raise BadProject(f"--crs {request.crs}: the project has its own crs; leave --crs out, it is for folders of photos")
        block = read_project(source)
        photos = {i.name: photo_path(source, block, i.name) for i in block.images if i.file is not None}
        if len(photos) < 2:
            raise BadProject(f"{source}: {len(photos)} of its images have photos; a mosaic needs two and more")
        notes, calibrated = (), True
    elif source.is_dir():
        block, photos, notes, calibrated = _folder(source, request.crs)
    else:
        raise BadProject(f"{source}: there is no such project or folder; give a project or a folder of photos")
    if request.corners is not None:
        given = read_corners(request.corners, block.crs)
        block = with_corners(block, [CornerControl(*c) for c in given])
        notes = (*notes, f"corners: those of {len(given)} images, weighted control with their covariance")
    failed: dict[str, str] = {}
    if not has_ties(block):
        with tempfile.TemporaryDirectory() as scratch:
            tied = find_ties(source, Path(scratch) / "ties.csv", workers=request.compose.workers,
                             scheduler=request.compose.scheduler, report=report)
        images = [block.images[block.image_index(n)] for n in tied.ties.photos]
        failed = dict(tied.ties.failed)
        block = with_ties(block, tied.ties, images, ties_in_format(tied.ties, block))
        notes = (*notes, _ties_said(tied.ties))
    return _ready(block, photos, failed, notes, calibrated)


def _ready(block: Block, photos: dict[str, Path], failed: dict[str, str], notes: tuple[str, ...], calibrated: bool) -> Site:
    """The site of a block that has its tie points."""
    onboard, said = _recorded(block, photos)
    block, held = _held_out(block)
    return Site(block, held, photos, onboard, failed, (*notes, *said), calibrated)


def _folder(source: Path, crs: str | None) -> tuple[Block, dict[str, Path], tuple[str, ...], bool]:
    """A block of the photos of a folder: cameras and positions as EXIF says, a plain camera where it says nothing."""
    files, _ = assemble.sort_files([source])
    if len(files) < 2:
        raise BadProject(f"{source}: there is one photo in it; a mosaic needs two and more that overlap")
    names, exifs = assemble.image_names(files), []
    for file in files:
        try:
            exifs.append(read_exif(file))
        except PhotogrammetryError:
            exifs.append(None)  # named as failed by the search for tie points
    good = [k for k, e in enumerate(exifs) if e is not None]
    if len(good) < 2:
        raise BadProject(f"{source}: fewer than two of its {len(files)} photos can be read; copy them again")
    calibrated = True
    try:
        cameras, of, notes = assemble.cameras_of([files[k] for k in good], [exifs[k] for k in good], None, None)
    except BadProject as error:
        calibrated, cameras, of = False, {}, []
        for k in good:
            width, height = photo_size(files[k])
            name = f"plain-{width}x{height}"
            cameras.setdefault(name, Interior(1.2 * max(width, height), pixel_mm=1.0, width=width, height=height))
            of.append(name)
        notes = (f"no camera is known ({error}): photos are joined by plane coefficients",)
    here = short_crs(crs) if crs else assemble.home_zone([exifs[k] for k in good]) or "local"
    priors = assemble.priors_of([exifs[k] for k in good], here)
    images = tuple(Image(names[k], c, str(files[k]), p) for k, c, p in zip(good, of, priors, strict=True))
    block = Block(source.resolve().name, here, cameras, images, Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
                  Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0)))
    if here == "local":
        notes = (*notes, "crs: none, no photo states where it was taken")
    return block, {names[k]: files[k] for k in good}, tuple(notes), calibrated


def has_ties(block: Block) -> bool:
    """Whether the block's points tie most of its photos already: six shared ones in each."""
    of = block.observations
    rays = np.bincount(of.point, minlength=len(block.points)) if len(of) else np.zeros(len(block.points), int)
    shared = np.bincount(of.image[rays[of.point] >= 2], minlength=len(block.images)) if len(of) else np.zeros(1)
    return bool((shared >= 12).mean() > 0.8)


def _held_out(block: Block) -> tuple[Block, Observations]:
    """The block without every tenth tie point, and these."""
    of, roles = block.observations, np.array(block.points.role, dtype=str)
    ties = np.flatnonzero((roles == "tie") & (np.bincount(of.point, minlength=len(roles)) >= 2))
    if len(ties) < 5 * HELD_OUT:
        return block, Observations(*(np.asarray(a)[:0] for a in (of.image, of.point, of.pixel, of.sigma)))
    out = np.isin(of.point, ties[HELD_OUT // 2::HELD_OUT])
    parts = [Observations(of.image[m], of.point[m], of.pixel[m], of.sigma[m]) for m in (~out, out)]
    return replace(block, observations=parts[0]), parts[1]


def _recorded(block: Block, photos: Mapping[str, Path]) -> tuple[dict[str, Exterior], tuple[str, ...]]:
    """Exterior orientations as recorded onboard, in map coordinates: of the project's priors, else of the photos themselves."""
    out = {i.name: Exterior.from_angles(*i.prior.angles, centre=i.prior.centre) for i in block.images
           if i.prior is not None and i.prior.angles is not None and i.prior.centre is not None}
    if out or block.crs == "local" or block.frame == "grid":
        return out, ()
    onboard = []
    for name, path in photos.items():
        try:
            o = read_onboard(path, name)
        except PhotogrammetryError:
            continue
        if o.lat is not None and o.lon is not None and o.attitude is not None:
            onboard.append(o if o.height is not None else replace(o, height=0.0))
    try:
        solved = georeference(onboard, block.crs)
    except PhotogrammetryError as error:
        return {}, (f"recorded angles were not used: {error}",)
    return {g.image: g.exterior for g in solved}, ()


def _model(site: Site, request: MosaicRequest) -> Model:
    if not site.calibrated:
        return "plane"
    if request.model == "auto" and request.compose.surface != "plane":
        return "bundle"
    return request.model


def _bundle(block: Block, datum: str) -> Any:
    return adjust(block, BundleRequest(datum=datum, start="prior", loss="cauchy"))  # type: ignore[arg-type]


# -- what judges it ---------------------------------------------------------------------------------------------------------


def _headings(r: Registration, site: Site) -> tuple[dict[str, Any], ...]:
    """How each photo lies against its recorded yaw, clockwise [degrees]; nothing for a mosaic that has no north."""
    if r.level == "uncontrolled":
        return ()
    out = []
    for k, name in enumerate(r.names):
        if name not in site.onboard:
            continue
        i = r.interiors[k]
        middle = np.array([i.width - 1, i.height - 1]) / 2
        step = np.diff(r.on_plane(k, middle + i.height / 20 * np.array([[0.0, 1], [0, -1]])), axis=0)[0]
        up = site.onboard[name].m[1]
        turn = np.degrees(np.arctan2(step[0], step[1]) - np.arctan2(up[0], up[1]))
        out.append({"image": name, "correction_deg": float((turn + 180) % 360 - 180)})
    return tuple(out)


class Offsets(NamedTuple):
    """Points with known coordinates on a mosaic. names, roles (k,); xyz (k, 3): where they are, local; off (k, 2): the mean place
    of the photos that show them minus that [unit]; photos (k,): how many."""

    names: tuple[str, ...]
    roles: tuple[str, ...]
    xyz: np.ndarray
    off: np.ndarray
    photos: np.ndarray


def point_offsets(r: Registration, block: Block, roles: tuple[str, ...] = ("control", "check")) -> Offsets:
    """Where a mosaic shows points of known coordinates, against where they are; heights are taken into account where photos
    allow it (exterior orientations). None on an uncontrolled mosaic, which has no map."""
    of, found = block.observations, []
    names = {n: k for k, n in enumerate(r.names)}
    wanted = np.isin(np.array(block.points.role, dtype=str), roles) & np.isfinite(block.points.xyz).all(axis=1)
    for p in np.flatnonzero(wanted) if r.level != "uncontrolled" else ():
        at, local = [], r.frame.to_local(block.points.xyz[p])
        level = replace(r, plane=np.array([local[2], 0.0, 0.0])) if r.kind == "exterior" else r
        for row in np.flatnonzero(of.point == p):
            k = names.get(block.images[of.image[row]].name)
            if k is not None:
                at.append(level.on_plane(k, of.pixel[row]))
        if at:
            found.append((block.points.names[p], block.points.role[p], local, np.mean(at, axis=0) - local[:2], len(at)))
    names_, roles_, xyz, off, photos = zip(*found, strict=True) if found else ((),) * 5
    return Offsets(names_, roles_, np.array(xyz).reshape(-1, 3), np.array(off).reshape(-1, 2), np.array(photos, int))


def _check_points(r: Registration, block: Block) -> float | None:
    """Rms distance [m] of check points on the mosaic from where they are."""
    off = point_offsets(r, block, ("check",)).off
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))) if len(off) else None


def _pixel(r: Registration, k: int) -> float:
    """Mosaic unit of a pixel in the middle of a photo."""
    i = r.interiors[k]
    middle = np.array([i.width - 1, i.height - 1]) / 2
    j = np.diff(r.on_plane(k, middle + np.array([[0.0, 0], [1, 0], [0, 0], [0, 1]])), axis=0)[[0, 2]]
    return float(np.sqrt(abs(np.linalg.det(j))))


def _ties_said(ties: Ties) -> str:
    return f"tie points: {len(ties.points)} in {len(ties.photos)} photos, found now"


def _oriented(folder: Path, image: str) -> tuple[Block, Exterior, str]:
    """The project, the exterior orientation of one of its images (map coordinates), and where that comes from."""
    block = read_project(folder)
    prior = block.images[block.image_index(image)].prior
    try:
        found = orientations_of(folder, (image,))
        return found.block, found.known[0].exterior, "; ".join(found.notes)
    except PhotogrammetryError as error:
        if prior is None or prior.centre is None or prior.angles is None:
            raise
        return block, Exterior.from_angles(*prior.angles, centre=prior.centre), f"the image's prior ({error})"


def _plane(block: Block, points: np.ndarray, wish: float | str | None, frame: LocalFrame) -> tuple[np.ndarray, str]:
    """(3,) z0, zx, zy, local, and where it comes from."""
    if isinstance(wish, (int, float)):
        return np.array([float(wish) - float(frame.origin[2]), 0.0, 0.0]), "given"
    if wish == "fitted":
        if len(points) < 3:
            raise BadProject(f"{block.name}: --plane fitted needs three points with known coordinates, there are {len(points)}; "
                             "give the height of the plane")
        fitted = fit_plane(points)
        return np.array([fitted.z, fitted.slope_x, fitted.slope_y]), f"fitted to {len(points)} points"
    if "z" in block.surface:
        return np.array([float(block.surface["z"]) - float(frame.origin[2]), 0.0, 0.0]), "the project's surface"
    if not len(points):
        raise BadProject(f"{block.name}: no point has known coordinates; give the height of the plane with --plane Z")
    return np.array([float(points[:, 2].mean()), 0.0, 0.0]), f"mean height of {len(points)} points"


def _no_trace() -> Trace:
    return Trace((Iteration(0, np.zeros(0), 0.0, float("nan"), float("nan"), float("nan"), 0.0, 0, "step"),), {})


def _numbers(values: np.ndarray) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]


__all__ = ["MosaicRequest", "Mosaicked", "Offsets", "Registered", "Site", "has_ties", "mosaic_of", "point_offsets",
           "rectify_photo", "registered", "registered_block", "registered_json"]
