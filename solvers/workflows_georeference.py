"""The walk of direct georeferencing: photos, tables and logs -> exterior orientations, footprints, priors."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .block import Block, Image, Observations, Points
from .errors import BadProject, PhotogrammetryError
from .geometry import Exterior, LocalFrame, Onboard
from .io import (
    WrittenCorners,
    assemble,
    crs,
    find_geoid,
    new_run,
    photo_path,
    read_exif,
    read_flight_log,
    read_mrk,
    read_onboard,
    read_positions,
    read_project,
    read_surface,
    thumbnail,
    write_corners,
    write_json,
    write_priors,
)
from .io.photos import EXTENSIONS
from .orientation import (
    CornerControl,
    Footprint,
    Georeferenced,
    Grade,
    Heading,
    Plane,
    Rig,
    Vertical,
    check_headings,
    compare_project,
    corner_control,
    footprint,
    footprints_geojson,
    georeference,
    height_bias,
    match_log,
)
from .orientation.grades import COARSE_M
from .orientation.headings import Matches
from .orientation.monoplot import Ground
from .orientation.single import given_prior
from .workflows_orientation import ground_of

PHOTO_SIDE = 1600
"""Longer side [px] of the small photos whose content is compared."""
RELIEF = 0.02
"""How far the ground is taken to depart from a level where nothing is said, of the height above it."""
NEIGHBOURS = 4
"""Photos that each one is compared with."""


@dataclass(frozen=True)
class Flown:
    """Where the onboard data come from and how they are to be taken; None: as the photos say."""

    images: tuple[str, ...] = ()
    crs: str | None = None  # of a folder or table; None: the UTM zone
    positions: str | None = None  # table with a line per photo
    mrk: str | None = None
    log: str | None = None
    log_offset: float | None = None  # s, log time minus photo time
    heights: Literal["as given", "ellipsoidal", "levelled"] = "as given"  # the project's
    photo_heights: Literal["ellipsoidal", "levelled"] | None = None
    undulation: float | str | None = None  # m, or a geoid grid's file, or auto
    height_bias: float | Literal["control"] | None = None  # m
    take_off: float | None = None  # m
    flying_height: float | None = None  # m
    rig: Rig | None = None
    ground_z: float | None = None  # m
    dem: str | None = None
    check_headings: bool = False
    correct_headings: bool = False
    footprints: str | None = None
    write_priors: bool = False
    from_priors: bool = False  # the priors of the project in place of what the photos say
    corners: str | None = None  # file to write the image corners to, as control
    relief: float | None = None  # m, how far the ground departs from the level under the corners
    compare: bool = False
    coarse_m: tuple[float, float, float] = COARSE_M
    pixel_um: float | None = None
    c_mm: float | None = None


class Site(NamedTuple):
    """What is georeferenced. block: images (without cameras where no one needs them); photos: files by image; folder: of the
    project, None without one; table: positions given instead of photos."""

    block: Block
    photos: dict[str, Path]
    folder: Path | None
    table: Path | None
    notes: tuple[str, ...] = ()


Solved = tuple[Site, tuple[Georeferenced, ...], tuple[tuple[str, str], ...], tuple[str, ...]]
"""What is georeferenced, its orientations, the images without one and why, and what to say of it all."""


class Direct(NamedTuple):
    """Exterior orientations from onboard data and everything that was derived from them."""

    orientations: tuple[Georeferenced, ...]
    crs: str
    ground: str | None
    headings: tuple[Heading, ...]
    footprints: tuple[Footprint, ...]
    failed: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    run: Path | None
    corners: tuple[CornerControl, ...] = ()
    grades: tuple[Grade, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command georeference."""
        return {"orientations": [o.to_json() for o in self.orientations], "crs": self.crs, "ground": self.ground,
                "headings": [{"image": h.image, "correction_deg": h.correction_deg, "sigma_deg": h.sigma_deg, "pairs": h.pairs,
                              "height_ratio": h.height_ratio, "words": h.words} for h in self.headings],
                "footprints": [{"image": f.image, "area_m2": f.area, "corners": f.corners.tolist()} for f in self.footprints],
                "failed": [{"image": n, "why": w} for n, w in self.failed], "notes": list(self.notes),
                "corners": [{"image": c.image, "names": list(c.names), "xyz": c.xyz.tolist(), "sigma": c.sigma.tolist()}
                            for c in self.corners],
                "comparison": [asdict(g) for g in self.grades],
                "warnings": list(self.warnings), "run": None if self.run is None else str(self.run)}


def georeference_flight(target: Path | str, flown: Flown) -> Direct:
    """Exterior orientations of the photos of a project, of a folder, or of a table of positions.

    Writes footprints and priors where asked; in a project it leaves a run with result.json. Raises PhotogrammetryError.
    """
    needs_camera = bool(flown.footprints or flown.corners) or flown.check_headings or flown.correct_headings or flown.compare
    for out in (flown.footprints, flown.corners):
        if out and not Path(out).resolve().parent.is_dir():
            raise BadProject(f"{out}: there is no such folder to write into; make it first or correct the path")
    site, solved, failed, how = _from_priors(Path(target), flown) if flown.from_priors else _recorded(Path(target), flown,
                                                                                                 needs_camera)
    known = np.isfinite(site.block.points.xyz).all(axis=1).any()
    around = site.block.points.xyz if known else np.array([g.exterior.centre for g in solved])
    frame = LocalFrame.around(around, site.block.crs, site.block.frame)
    ground, where, doubts = _ground(site, solved, flown) if needs_camera else (None, None, ())
    headings: tuple[Heading, ...] = ()
    if ground is not None and (flown.check_headings or flown.correct_headings):
        headings = check_headings(site.block, solved, _matches(site, solved), _level(ground, solved))
        doubts = (*doubts, *_headings_said(headings, solved, flown.correct_headings))
        how = (*how, f"headings: {len(headings)} of {len(solved)} photos compared with their neighbours, "
                     f"{sum(not _turn(h) for h in headings)} agree")
        solved = _corrected(solved, headings) if flown.correct_headings else solved
    elif flown.corners and site.photos and len(solved) > 1:
        how = (*how, "headings: as recorded; --check-headings compares them with what the photos show, --correct-headings turns "
                     "those that are wrong (a yaw wrong by 180 degrees is common where strips are flown to and fro)")
    outlines, missed = _outlines(site.block, solved, ground, frame) if flown.footprints and ground is not None else ((), ())
    notes = (*site.notes, *how, *((f"ground: {where}",) if where else ()))
    corners: tuple[CornerControl, ...] = ()
    grades: tuple[Grade, ...] = ()
    if ground is not None and (flown.corners or flown.compare):
        z = _level(ground, solved)
        above = abs(float(np.mean([g.exterior.centre[2] for g in solved])) - z)
        relief = flown.relief if flown.relief is not None else RELIEF * above
        notes = (*notes, f"corners: on level ground at {z:.1f} m, taken to be so within {relief:.2g} m (--relief)")
        corners, flat = _corners(site.block, solved, z, relief)
        missed = (*missed, *flat)
        if flown.compare:
            grades, checked = compare_project(site.block, solved, z, relief, coarse_m=flown.coarse_m)
            notes = (*notes, *(f"comparison: {c}" for c in checked))
    result = Direct(solved, site.block.crs, where, headings, outlines, (*failed, *missed), notes, doubts, None, corners, grades)
    return _written(result, site, flown)


def _recorded(target: Path, flown: Flown, needs_camera: bool) -> Solved:
    """Orientations from what photos, tables and logs say."""
    site = _site(target, flown, needs_camera)
    onboard, failed, said = _onboard(site, flown)
    site = _on_map(site, onboard)
    known = np.isfinite(site.block.points.xyz).all(axis=1).any()
    frame = LocalFrame.around(site.block.points.xyz, site.block.crs) if known else None
    vertical, how = _vertical(flown)
    solved = georeference(onboard, site.block.crs, frame=frame, vertical=vertical, rig=flown.rig)
    if flown.height_bias == "control":
        bias, sigma, count = height_bias(site.block, solved)
        vertical = replace(vertical, bias=bias, bias_sigma=sigma)
        solved = georeference(onboard, site.block.crs, frame=frame, vertical=vertical, rig=flown.rig)
        how = (*how, f"height bias: {bias:+.2f} m (sigma {sigma:.2f} m) from {count} measurements of control points")
    return site, solved, failed, (*said, *how)


def _from_priors(folder: Path, flown: Flown) -> Solved:
    """Orientations as a project's priors state them. Raises BadProject where an image lacks one that is complete."""
    block = read_project(folder)
    wanted = [block.images[block.image_index(n)].name for n in flown.images] or [i.name for i in block.images]
    frame = LocalFrame.around(block.points.xyz, block.crs, block.frame)
    solved, failed = [], []
    for name in wanted:
        try:
            prior = given_prior(block, name, frame)
        except BadProject as error:
            failed.append((name, str(error)))
            continue
        if prior.count < 6:
            failed.append((name, f"the prior of image '{name}' needs sigma_m and sigma_deg in [images.{name}.prior]"))
            continue
        inverse = np.linalg.inv(prior.root)
        at = prior.exterior
        solved.append(Georeferenced(name, Exterior(at.m, frame.to_map(at.centre)), at.angle_covariance(inverse @ inverse.T),
                                    "as the project's priors have them", 0.0, None, ("from: [images.NAME.prior]",)))
    if not solved:
        raise BadProject(failed[0][1] if failed else f"{block.name}: there are no images; add them first")
    return Site(block, {}, folder, None), tuple(solved), tuple(failed), ("orientations: the priors of the project",)


def _written(result: Direct, site: Site, flown: Flown) -> Direct:
    """Footprints, priors and the run on disk."""
    if flown.footprints and result.footprints:
        heights = {g.image: {"heights": g.heights} for g in result.orientations}
        write_json(Path(flown.footprints), footprints_geojson(result.footprints, result.crs,
                                                              [heights[f.image] for f in result.footprints]))
        area = [f.area for f in result.footprints]
        said = f"footprints: {len(area)} in {flown.footprints}, {min(area):.0f} to {max(area):.0f} m^2 each"
        result = result._replace(notes=(*result.notes, said))
    if flown.corners and result.corners:
        write_corners(Path(flown.corners), result.crs, [WrittenCorners(c.image, c.names, c.xyz, c.covariance, c.pixels)
                                                        for c in result.corners])
        result = result._replace(notes=(*result.notes, f"corners: of {len(result.corners)} images in {flown.corners}, for "
                                                       f"collinea adjust --corners {flown.corners}"))
    if flown.write_priors:
        if site.folder is None:
            raise BadProject("priors are written into a project and none was given; make one with collinea init, then give it to "
                             "collinea georeference")
        was = write_priors(site.folder, {g.image: g.prior for g in result.orientations})
        said = f"priors: {len(result.orientations)} written to {site.folder / 'project.toml'}, {was} in place of older ones"
        result = result._replace(notes=(*result.notes, said))
    if site.folder is None:
        return result
    run = new_run(site.folder, "georeference")
    try:
        result = result._replace(run=run)
        write_json(run / "result.json", result.to_json())
    except BaseException:
        shutil.rmtree(run, ignore_errors=True)
        raise
    return result


# -- what is georeferenced ------------------------------------------------------------------------------------------------


def _site(target: Path, flown: Flown, needs_camera: bool) -> Site:
    if (target / "project.toml").is_file():
        return _project(target, flown)
    if not target.exists():
        raise BadProject(f"{target}: there is no such file or folder; give a project, a folder of photos or a table of positions")
    if target.is_file() and target.suffix.lower() not in EXTENSIONS:
        if needs_camera:
            raise BadProject(f"{target}: footprints and headings need the photos; give their folder, and the table with "
                             "--positions")
        names = tuple(o.image for o in read_positions(target))
        return Site(_block(target.stem, names, flown), {}, None, target)
    files, _ = assemble.sort_files([target])
    named, notes = dict(zip(assemble.image_names(files), files, strict=True)), ()
    block = _block(target.resolve().name, tuple(named), flown)
    names = tuple(block.images[block.image_index(n)].name for n in flown.images) or tuple(named)
    files = tuple(named[n] for n in names)
    block = replace(block, images=tuple(Image(n, "") for n in names))
    if needs_camera:
        cameras, of, notes = assemble.cameras_of(files, [read_exif(f) for f in files], flown.pixel_um, flown.c_mm)
        block = replace(block, cameras=cameras, images=tuple(Image(n, c) for n, c in zip(names, of, strict=True)))
    return Site(block, dict(zip(names, files, strict=True)), None, None, notes)


def _project(folder: Path, flown: Flown) -> Site:
    block = read_project(folder)
    if block.crs == "local":
        raise BadProject(f"{folder / 'project.toml'} [project] crs: GPS positions have no place in crs \"local\"; write the crs "
                         "of its coordinates there (such as \"EPSG:32632\"), or georeference the folder of photos alone")
    if block.frame == "grid":
        raise BadProject(f"{folder / 'project.toml'} [project] frame: \"grid\" takes map coordinates as Cartesian, GPS positions "
                         "cannot; remove the line")
    if flown.crs and crs.short_crs(flown.crs) != block.crs:
        raise BadProject(f"--crs {flown.crs}: the project's crs is {block.crs}; leave --crs out, it is for folders of photos")
    photos = {i.name: photo_path(folder, block, i.name) for i in block.images if i.file is not None}
    return Site(block, photos, folder, None)


def _block(name: str, images: Sequence[str], flown: Flown) -> Block:
    if flown.crs and crs.is_geographic(flown.crs):
        raise BadProject(f"--crs {flown.crs}: coordinates in metres are needed; give the UTM zone or the national grid")
    return Block(name, crs.short_crs(flown.crs) if flown.crs else "", {}, tuple(Image(n, "") for n in images),
                 Points((), np.empty((0, 3)), np.empty((0, 3)), ()),
                 Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0)))


def _onboard(site: Site, flown: Flown) -> tuple[list[Onboard], tuple[tuple[str, str], ...], tuple[str, ...]]:
    """What was recorded for each image that has a position, the images that have none, and what to say of it."""
    wanted = [site.block.images[site.block.image_index(n)].name for n in flown.images] or [i.name for i in site.block.images]
    there = {n: read_onboard(site.photos[n], n) if n in site.photos else Onboard(n) for n in wanted}
    notes: list[str] = []
    tables = [(p, read_positions(p)) for p in (site.table, flown.positions) if p is not None]
    tables += [(flown.mrk, read_mrk(flown.mrk, wanted))] if flown.mrk else []
    for path, rows in tables:
        by = {o.image.lower(): o for o in rows}
        found = {n: by.get(n.lower()) or by.get(Path(site.photos.get(n, n)).stem.lower()) for n in wanted}
        if not any(found.values()):
            raise BadProject(f"{path}: none of its images ({', '.join(o.image for o in rows[:3])} ...) is among those here "
                             f"({', '.join(wanted[:3])} ...); name them alike")
        there = {n: _joined(there[n], found[n]) for n in wanted}
    if flown.log:
        matched, offset = match_log(read_flight_log(flown.log), list(there.values()), flown.log_offset)
        there = {o.image: o for o in matched}
        notes.append(f"log: its clock is {offset.seconds:+.2f} s from the photos' (sigma {offset.sigma:.2f} s), {offset.how}")
    placed = [o for o in there.values() if o.lat is not None and o.lon is not None]
    cure = "it has no GPS position; give --positions with a line for it, or a flight log, or leave it out with --image"
    failed = tuple((n, cure) for n, o in there.items() if o.lat is None or o.lon is None)
    if not placed:
        raise BadProject(f"image '{wanted[0]}' has no GPS position, nor has any other; give --positions TABLE (image, lat, lon, "
                         "height), --mrk or --log" if wanted else f"{site.block.name}: there are no images; add them first")
    low = next((o.image for o in placed if o.height is None), None)
    if low is not None and flown.flying_height is None and flown.take_off is None:
        raise BadProject(f"image '{low}' has no height; give the flying height in the project's heights with --flying-height")
    return placed, failed, tuple(notes)


def _joined(photo: Onboard, row: Onboard | None) -> Onboard:
    """A photo's own record with the position, and where it has one the attitude, of a table's row."""
    if row is None:
        return photo
    kept = tuple(s for s in photo.stated if not s.startswith(("position", "height")))
    own = {"attitude": photo.attitude, "mount": photo.mount, "body": photo.body, "sigma_deg": photo.sigma_deg}
    high = {} if row.height is not None else {"height": photo.height, "datum": photo.datum}
    return replace(row, image=photo.image, relative=photo.relative, time=row.time if row.time is not None else photo.time,
                   stated=(*row.stated, *kept), **high, **(own if row.attitude is None else {}))


def _on_map(site: Site, onboard: Sequence[Onboard]) -> Site:
    """The site with a crs: the UTM zone of its photos where none is given."""
    if site.block.crs:
        return site
    lat, lon = np.median(np.array([[o.lat, o.lon] for o in onboard], float), axis=0)
    zone = crs.utm_zone(float(lat), float(lon))
    return site._replace(block=replace(site.block, crs=zone),
                         notes=(*site.notes, f"crs: {zone}, the UTM zone of the photos (give --crs for another)"))


def _vertical(flown: Flown) -> tuple[Vertical, tuple[str, ...]]:
    """How heights are converted, and what to say of it."""
    undulation, target, notes = flown.undulation, flown.heights, []
    if undulation is not None and target == "as given":
        target = "levelled"
        notes.append("heights: the project's are taken as levelled, because an undulation is given (else give --heights)")
    if isinstance(undulation, str):
        path = find_geoid() if undulation == "auto" else Path(undulation)
        if path is None:
            raise BadProject("--undulation auto: no geoid grid is installed on this machine; give a grid's file or metres")
        undulation = read_surface(path)
    bias = 0.0 if flown.height_bias in (None, "control") else float(flown.height_bias)
    return Vertical(target, flown.photo_heights, undulation, bias=bias, take_off=flown.take_off,
                    entered=flown.flying_height), tuple(notes)


# -- what is derived --------------------------------------------------------------------------------------------------------


def _ground(site: Site, solved: Sequence[Georeferenced], flown: Flown) -> tuple[Ground, str, tuple[str, ...]]:
    """The ground under the photos, where its height comes from, and a doubt about it."""
    unsure = next((g.heights for g in solved if g.heights.endswith(("(barometric)", "(unknown)"))), None)
    doubts = () if unsure is None else (f"heights are {unsure}: above this ground the cameras may be too high or too low, and "
                                        "what they see too large or too small; compare with --height-bias control or --take-off",)
    given = ground_of(site.folder or Path(), site.block, flown.dem, flown.ground_z)
    if given is not None:
        said = "given" if flown.dem or flown.ground_z is not None else "[surface] of the project"
        return given, f"{given.name} ({said})", doubts
    above = [g.exterior.centre[2] - g.relative for g in solved if g.relative is not None]
    if above:
        z = float(np.mean(above))
        return Plane(z), f"plane z = {z:.1f} m, the level of the take-off point by the photos' heights above it", ()
    known = site.block.points.xyz[np.isfinite(site.block.points.xyz).all(axis=1)]
    if len(known):
        z = float(known[:, 2].mean())
        return Plane(z), f"plane z = {z:.1f} m, the mean of {len(known)} points of the project", doubts
    raise BadProject(f"{site.block.name}: the height of the ground is not known, the photos state no height above the take-off "
                     "point; give it with --ground-z Z or --dem DEM.tif")


def _level(ground: Ground, solved: Sequence[Georeferenced]) -> float:
    """One height for the ground below the cameras."""
    if isinstance(ground, Plane):
        return ground.z
    below = ground.sample(np.array([g.exterior.centre[:2] for g in solved]))
    if not np.isfinite(below).any():
        raise BadProject(f"{ground.name}: it has no heights below the photos; take a DEM of the site or give --ground-z")
    return float(np.nanmean(below))


def _matches(site: Site, solved: Sequence[Georeferenced]) -> Matches:
    """Pixels of the same objects in neighbouring photos: features in small pictures, verified by their common geometry."""
    from .matching.features import find_features
    from .matching.pairing import match_descriptors, pairs_by_position, unit_descriptors
    from .matching.verify import verify

    shown = [g for g in solved if g.image in site.photos]
    pixels, words, step = [], [], []
    for g in shown:
        small = thumbnail(site.photos[g.image], PHOTO_SIDE).pixels
        found = find_features(small, count=2000, side=PHOTO_SIDE)
        scale = small.shape[1] / site.block.camera_of(g.image).width
        pixels.append((found.pixel + 0.5) / scale - 0.5)
        words.append(unit_descriptors(found))
        step.append(1 / scale)
    out: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]] = {}
    for a, b in sorted(pairs_by_position(np.array([g.exterior.centre for g in shown]).reshape(-1, 3), NEIGHBOURS)):
        rows = match_descriptors(words[a], words[b])
        pa, pb = pixels[a][rows[:, 0]], pixels[b][rows[:, 1]]
        interiors = (site.block.camera_of(shown[a].image), site.block.camera_of(shown[b].image))
        good = verify(pa, pb, interiors, 3.0 * step[a])
        if good is not None:
            some = np.flatnonzero(good.inlier)
            some = some[::max(len(some) // 30, 1)]
            out[shown[a].image, shown[b].image] = (pa[some], pb[some])
    return out


def _headings_said(headings: Sequence[Heading], solved: Sequence[Georeferenced], correct: bool) -> tuple[str, ...]:
    """Which yaw angles are wrong or could not be checked."""
    wrong = [h for h in headings if _turn(h)]
    said = [h.words + (": corrected" if correct else "") for h in wrong]
    said += ["yaw angles disagree with the photos' content: --correct-headings turns them"] if wrong and not correct else []
    unseen = [g.image for g in solved if g.image not in {h.image for h in headings}]
    return (*said, *([f"yaw of {', '.join(unseen)} was not checked: no neighbour shows the same ground"] if unseen else []))


def _turn(heading: Heading) -> float:
    """By how many degrees a yaw is to be corrected: half a turn where reversed, 0 where it agrees."""
    if "reversed" in heading.words:
        return 180.0
    return heading.correction_deg if "is wrong" in heading.words else 0.0


def _corrected(solved: Sequence[Georeferenced], headings: Sequence[Heading]) -> tuple[Georeferenced, ...]:
    turn = {h.image: _turn(h) for h in headings}
    return tuple(g.turned(turn[g.image]) if turn.get(g.image) else g for g in solved)


def _corners(block: Block, solved: Sequence[Georeferenced], z: float,
             relief: float) -> tuple[tuple[CornerControl, ...], tuple[tuple[str, str], ...]]:
    """Corners as control, and of the images that have none the reason."""
    found, missed = [], []
    for g in solved:
        try:
            found.append(corner_control(block, g, z, relief))
        except PhotogrammetryError as error:
            missed.append((g.image, f"no corners as control: {error}"))
    return tuple(found), tuple(missed)


def _outlines(block: Block, solved: Sequence[Georeferenced], ground: Ground,
              frame: LocalFrame) -> tuple[tuple[Footprint, ...], tuple[tuple[str, str], ...]]:
    """Footprints, and of the images that have none the reason."""
    outlines, missed = [], []
    for g in solved:
        try:
            outlines.append(footprint(block, g, ground, frame))
        except PhotogrammetryError as error:
            missed.append((g.image, f"no footprint: {error}"))
    return tuple(outlines), tuple(missed)
