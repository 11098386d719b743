"""The walk init: photos, and files of any tool beside them, become a project."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .block import Block, Image, Observations, Prior
from .cameras import Interior
from .errors import BadProject
from .geometry import Exterior, Onboard
from .io import Ask, ControlList, Exif, assemble, crs, read_control, read_exif, read_motion, read_onboard, read_project
from .io.exchange import control as lists
from .io.exchange import project as projects
from .io.exchange import registry
from .io.exchange.options import Reading
from .io.exchange.scene import Exchange, Shot
from .io.shutters import rolls, unstated_shutters
from .io.sniff import Tell
from .io.surface import find_geoid, read_surface
from .io.whereabouts import Mistake, mistaken
from .io.whereabouts import Reading as Place
from .workflows_new import must_be_free, write_new

VELOCITY_SIGMA = 1.0
"""Standard error [m/s] that a velocity written by an autopilot gets."""


class Initialised(NamedTuple):
    """A new project, and what a person should know of how its numbers were found."""

    block: Block
    folder: Path
    notes: list[str]

    def to_json(self) -> dict[str, Any]:
        block = self.block
        return {"project": str(self.folder), "crs": block.crs, "cameras": list(block.cameras),
                "images": [i.name for i in block.images],
                "points": len(block.points), "observations": len(block.observations), "notes": self.notes}


@dataclass(frozen=True)
class Given:
    """What a person said. control_format: of the list, as `convert` names it.
    project_crs: of the project. control_crs: of the list, over what it says itself; swap_xy, unit,
    height_unit: how its coordinates are meant. undulation: metres, "auto" or the file of a geoid grid."""

    mapping: str | None = None
    control_format: str | None = None
    project_crs: str | None = None
    control_crs: str | None = None
    swap_xy: bool = False
    unit: str | None = None
    height_unit: str | None = None
    pixel_origin: str | None = None
    pixel_um: float | None = None
    c_mm: float | None = None
    undulation: float | str | None = None
    angles: str | None = None
    angle_unit: str | None = None


class Beside(NamedTuple):
    """The files beside the photos, by what they are: control, a calibration, orientations or positions."""

    control: ControlList | None
    origin: str | None
    calibration: Exchange | None
    orientations: Exchange | None


def init_project(files: Sequence[Path | str], folder: Path | str, *, ask: Ask | None = None,
                 tell: Tell | None = None, **options: Any) -> Initialised:
    """Make a project folder from photos and, if there are some, a list of control points and files of other tools.

    options: as in `Given`. ask: puts a question to a person when something is unclear; without it unclear input is refused with
    the cure. tell: is shown the columns of tables before they are used.
    """
    folder, given = Path(folder), Given(**options)
    must_be_free(folder)
    photos, tables = assemble.sort_files([Path(f) for f in files])
    exifs = [read_exif(photo) for photo in photos]
    beside = _beside(tables, given, exifs, ask, tell)
    cameras, camera_of, notes = _cameras(photos, exifs, beside.calibration, given)
    control = beside.control
    chosen, xyz, said = _choose_crs(control, exifs, given, ask)
    origin, assumed = (beside.origin, []) if beside.origin else _choose_origin(control, given.pixel_origin, ask)
    names = assemble.image_names(photos)
    priors, told = _priors(photos, exifs, names, chosen, beside.orientations, xyz, given)
    readout, priors, shutter = _shutter(photos, camera_of, priors, chosen)
    shutter += _unstated(photos, exifs, camera_of, cameras, readout)
    paths = [_written_path(photo, folder) for photo in photos]
    images = tuple(Image(*values) for values in zip(names, camera_of, paths, priors, strict=True))
    observations, left = assemble.measurements(control, images, photos, cameras, origin) if control else (_none(), ())
    all_notes = [*notes, *(control.notes if control else ()), *said, *assumed, *left, *told, *shutter, *_photo_notes(exifs)]
    if ask is not None and control is not None:
        _confirm(all_notes, ask)
    block = Block(folder.resolve().name or "project", chosen, cameras, images, assemble.points_of(control, xyz), observations,
                  readout_ms=readout)
    write_new(block, folder, origin)
    return Initialised(read_project(folder), folder, all_notes)


# -- files beside the photos ------------------------------------------------------------------------------------------------


def _beside(tables: Sequence[Path], given: Given, exifs: Sequence[Exif], ask: Ask | None, tell: Tell | None) -> Beside:
    """Each file read as what it is; two of one kind are refused."""
    found: dict[str, tuple[Path, Any]] = {}
    origin = None
    size = (exifs[0].width, exifs[0].height) if exifs else None
    for table in tables:
        name = given.control_format if given.control_format and table == _list_of(tables) else registry.sniff(table)
        name = registry.of_mapping(name, given.mapping)
        options = Reading(given.control_crs or given.project_crs, given.angles, given.angle_unit, size, given.mapping,
                          given.pixel_origin, None, ask, tell)
        if name in ("gcp", "gcp-odm"):
            where = given.control_crs or given.project_crs or assemble.home_zone(exifs)
            kind, value = "control", read_control(table, given.mapping, ask, tell, where)
        else:
            if name == "geo" and options.crs is None:  # map coordinates without a word are those of the photos' zone
                options = replace(options, crs=assemble.home_zone(exifs))
            scene = registry.read(table, name, options)
            kind = "control" if len(scene.points) and not scene.oriented else \
                "calibration" if scene.cameras and not scene.shots else "orientations"
            value = scene
            if kind == "control":
                value, origin = control_of(scene), "center"
        if kind in found:
            raise BadProject(f"{table}: {found[kind][0]} is {_WORDS[kind]} already; give one of each kind")
        found[kind] = (table, value)
    control, calibration, orientations = (found[k][1] if k in found else None for k in _WORDS)
    return Beside(control, origin, calibration, orientations)


def _list_of(tables: Sequence[Path]) -> Path | None:
    """The file that is the list: the first that is nothing else."""
    kinds = {t: registry.sniff(t) for t in tables}
    return next((t for t, k in kinds.items() if k.startswith("gcp")), tables[0] if len(tables) == 1 else None)


_WORDS = {"control": "a list of control points", "calibration": "a calibration", "orientations": "a file of orientations or "
                                                                                                 "positions"}


def control_of(scene: Exchange) -> ControlList:
    """The points and marks of a file as a control list; pixels from the centre of the top-left pixel."""
    from .io.gcp import Mark

    p, of = scene.points, scene.observations
    labels = lists.labels_of(scene.shots)
    marks = tuple(Mark(p.names[j], labels[i], float(x), float(y), float(s), 0)
                  for i, j, (x, y), s in zip(of.image, of.point, of.pixel, of.sigma, strict=True))
    return ControlList(scene.path, p.names, p.xyz, p.sigma, p.role, marks, None if scene.crs == "local" else scene.crs,
                       scene.notes)


def _cameras(photos: Sequence[Path], exifs: Sequence[Exif], calibration: Exchange | None, given: Given,
             ) -> tuple[dict[str, Interior], tuple[str, ...], tuple[str, ...]]:
    """Cameras by EXIF, or the calibration for photos of its format."""
    if calibration is None:
        return assemble.cameras_of(photos, exifs, given.pixel_um, given.c_mm)
    from .cameras.foreign import to_interior

    [(name, camera), *more] = calibration.cameras.items()
    if more:
        raise BadProject(f"{calibration.path}: it holds {1 + len(more)} cameras; give a file with the one of these photos")
    pitch = exifs[0].pitch_mm if given.pixel_um is None else given.pixel_um * 1e-3
    if not isinstance(camera, Interior) and camera.pixel_mm is None and pitch is not None:
        camera = replace(camera, pixel_mm=(pitch, pitch))
    for photo, exif in zip(photos, exifs, strict=True):
        if (exif.width, exif.height) != (camera.width, camera.height):
            raise BadProject(f"{calibration.path}: the calibration is for photos of {camera.width} x {camera.height} pixels and "
                             f"{photo} has "
                             f"{exif.width} x {exif.height}; give the calibration of these photos")
    ours, fit = to_interior(camera)
    said = f"camera {name}: {calibration.kind}, {calibration.path.name}, c = {ours.c:.6g} mm"
    return {name: ours}, (name,) * len(photos), (said, *calibration.notes, *fit.told(name))


# -- coordinates ------------------------------------------------------------------------------------------------------------


def _choose_crs(control: ControlList | None, exifs: Sequence[Exif], given: Given, ask: Ask | None,
                ) -> tuple[str, np.ndarray, list[str]]:
    """The crs of the project, the control in it, and what to say about it."""
    zone = assemble.home_zone(exifs)
    project = crs.short_crs(given.project_crs) if given.project_crs else None
    if project and crs.is_geographic(project):
        raise BadProject(f"--crs {project}: a project needs coordinates in metres; give the UTM zone or the national grid")
    if control is None:
        source = "given" if project else "from the photos' GPS" if zone else "neither given nor in the photos"
        return project or zone or "local", np.empty((0, 3)), [_crs_said(project or zone or "local", source)]
    place, assumed = _place(control, project, given, zone, exifs, ask)
    place, doubts = _checked(control, place, exifs, ask)
    return _in_project(control, place, project, given, assumed, doubts)


def _place(control: ControlList, project: str | None, given: Given, zone: str | None, exifs: Sequence[Exif], ask: Ask | None,
           ) -> tuple[Place, str]:
    """How the list's coordinates are to be read, and whether that is assumed. Raises BadProject."""
    said = given.control_crs or control.crs or project
    if said:
        return Place(crs.short_crs(said, metric=False), given.swap_xy, given.unit), ""
    near = zone is not None and assemble.plausible(Place(zone, given.swap_xy, given.unit).metric(control.xyz), zone, exifs)
    if ask is not None:
        proposed = zone if near and zone else "local"
        answer = ask(f"Coordinate system of the control points, such as EPSG:32632, or local [{proposed}]: ").strip()
        return Place(crs.short_crs(answer or proposed, metric=False), given.swap_xy, given.unit), ""
    if near and zone:
        return Place(zone, given.swap_xy,
                     given.unit), " (assumed: the control lies near the photos' GPS in it; give --crs if it is another)"
    hint = ""
    if zone is not None:
        wrong = mistaken(control.xyz, Place(zone), _degrees(exifs))
        hint = f"; read in {zone}, the zone of the photos, perhaps {wrong.words}" if wrong and wrong.mended else ""
    raise BadProject(f"{control.path}: it does not say its coordinate system{hint}; give it with --crs EPSG:CODE, or --crs local")


def _checked(control: ControlList, place: Place, exifs: Sequence[Exif], ask: Ask | None) -> tuple[Place, list[str]]:
    """The place, mended when a person says so; refused when it lies far from the photos. Raises BadProject."""
    wrong = mistaken(control.xyz, place, _degrees(exifs))
    if wrong is None:
        return place, []
    if ask is not None and wrong.mended is not None:
        answer = ask(f"{_far(control.path, place, wrong)}: perhaps {wrong.words}. Read them so? [yes] ").strip().lower()
        if answer in ("", "y", "yes"):
            return wrong.mended, [f"coordinates: {wrong.words}, as was answered"]
    raise BadProject(f"{_far(control.path, place, wrong)}{_cure(wrong, '--control-crs')}")


def _far(path: Path, place: Place, wrong: Mistake) -> str:
    how = f"{wrong.distance / 1e3:.0f} km from" if np.isfinite(wrong.distance) else "nowhere near"
    return f"{path}: its points lie {how} the photos' GPS positions when read in {place.crs}"


def _cure(wrong: Mistake, option: str) -> str:
    if wrong.mended is None:
        return f" {wrong.words}; correct the list, or name its coordinate system with {option}"
    return f", perhaps {wrong.words}; give {wrong.options.replace('--crs', option)}"


def _degrees(exifs: Sequence[Exif]) -> np.ndarray:
    return np.array([(e.lon, e.lat) for e in exifs if e.lon is not None and e.lat is not None], float).reshape(-1, 2)


def _in_project(control: ControlList, place: Place, project: str | None, given: Given, assumed: str, doubts: list[str],
                ) -> tuple[str, np.ndarray, list[str]]:
    """Coordinates in the metres of the project's crs."""
    scene = Exchange("control", control.path, place.crs, points=assemble.points_of(control, control.xyz))
    done = projects.metric(scene, place, None if place.crs == "local" and project in (None, "local") else project,
                           given.height_unit)
    target = str(done.crs)
    source = crs.short_crs(place.crs, metric=False)
    told = crs.described(source) if source != "local" else None
    how = ", converted from degrees; heights are kept as they are" if told and told.geographic else \
        f", converted from {source} ({told.units})" if told and not told.metric else \
        f", converted from {source}" if source != target else ""
    unit = [f"unit of the list: {given.unit} for x and y"] if given.unit else []
    unit += [f"unit of the list's heights: {given.height_unit}"] if given.height_unit else []
    return target, done.points.xyz, [_crs_said(target, "") + how + assumed, *doubts, *unit]


def _crs_said(text: str, source: str) -> str:
    told = crs.described(text) if text != "local" else None
    vertical = f", heights: {told.vertical}" if told and told.vertical else ""
    return f"crs: {text}{f' ({source})' if source else ''}{vertical}"


# -- priors -----------------------------------------------------------------------------------------------------------------


def _priors(photos: Sequence[Path], exifs: Sequence[Exif], names: Sequence[str], chosen: str, orientations: Exchange | None,
            xyz: np.ndarray, given: Given) -> tuple[tuple[Prior | None, ...], list[str]]:
    """Priors from the file of orientations where it has the image, else from EXIF, and what they rest on."""
    priors, notes = _gps(photos, exifs, chosen, given)
    if orientations is None:
        return priors, notes
    place = Place(crs.short_crs(orientations.crs, metric=False) if orientations.crs else chosen)
    wrong = mistaken(np.array([s.exterior.centre for s in orientations.shots if s.exterior is not None]).reshape(-1, 3), place,
                     _degrees(exifs))
    if wrong is not None:
        raise BadProject(f"{_far(orientations.path, place, wrong).replace('its points', 'its cameras')}{_cure(wrong, '--crs')}")
    moved = projects.metric(orientations, place, chosen, given.height_unit)
    known = xyz[np.isfinite(xyz).all(axis=1)] if len(xyz) else np.empty((0, 3))
    frame = projects.frame_of(replace(moved, points=replace(moved.points, names=("",) * len(known), xyz=known,
                                                            sigma=known * np.nan,
                                                            role=("control",) * len(known))))
    shots = {s.name.lower(): s for s in moved.shots}
    out, used, level = [], 0, 0
    for name, photo, prior in zip(names, photos, priors, strict=True):
        shot = next((shots[k] for k in (name.lower(), photo.stem.lower(), photo.name.lower()) if k in shots), None)
        if shot is not None and _lacks_height(shot) and prior is not None and prior.centre is not None:
            shot, level = _at_height(shot, prior.centre[2]), level + 1
        own = None if shot is None else projects.prior_of(shot, chosen, frame)
        used += own is not None
        out.append(own or prior)
    if not used:
        raise BadProject(f"{orientations.path}: none of its images ({', '.join(s.name for s in moved.shots[:5])}) is among the "
                         "photos, or they have no height there; name the photos it was made for")
    kept = [f"heights: {level} photos have none in {orientations.path.name}, that of their GPS is taken"] if level else []
    return tuple(out), [*notes, f"priors: {used} of {len(photos)} photos from {orientations.kind} ({orientations.path.name})",
                        *kept, *moved.notes]


def _lacks_height(shot: Shot) -> bool:
    at = shot.exterior
    return at is not None and bool(np.isfinite(at.centre[:2]).all()) and not np.isfinite(at.centre[2])


def _at_height(shot: Shot, z: float) -> Shot:
    """A shot whose position has no height, at a height [m]."""
    assert shot.exterior is not None
    return replace(shot, exterior=Exterior(shot.exterior.m, np.array([*shot.exterior.centre[:2], z])))


def _gps(photos: Sequence[Path], exifs: Sequence[Exif], chosen: str, given: Given) -> tuple[tuple[Prior | None, ...], list[str]]:
    """Position priors from EXIF; heights above the ellipsoid are brought to the project's levelled ones by the undulation."""
    priors = assemble.priors_of(exifs, chosen)
    count = sum(p is not None for p in priors)
    if not count:
        return priors, []
    onboard = [read_onboard(p) for p in photos]
    priors = tuple(p if p is None or o.sigma_m is None else _stated(o, p, chosen) for o, p in zip(onboard, priors, strict=True))
    stated = sum(p is not None and o.sigma_m is not None for o, p in zip(onboard, priors, strict=True))
    datums = {o.datum for o, p in zip(onboard, priors, strict=True) if p is not None}
    datum = next(iter(datums)) if len(datums) == 1 else "unknown"
    levelled = crs.described(chosen).heights == "levelled"
    sigma = "sigma by their XMP" if stated == count else \
        f"sigma by the XMP of {stated}, else 5, 5, 10 m" if stated else "sigma 5, 5, 10 m"
    if given.undulation is None:
        apart = levelled and datum == "ellipsoidal"
        doubt = "; the project's are levelled: give --undulation to bring them together" if apart else ""
        word = {"unknown": "of unknown datum"}.get(datum, datum)
        return priors, [f"priors: GPS positions of {count} photos, their heights {word}, {sigma}{doubt}"]
    if datum not in ("ellipsoidal", "unknown"):
        raise BadProject(f"--undulation: the photos' heights are {datum}, not above the ellipsoid; leave it out")
    n, source = _undulation(given.undulation, exifs)
    moved = tuple(p if p is None or p.centre is None else replace(p, centre=np.round(p.centre - [0, 0, n], 3)) for p in priors)
    return moved, [f"priors: GPS positions of {count} photos, {sigma}; heights: ellipsoidal "
                   f"({'assumed' if datum == 'unknown' else 'stated'}"
                   f"), minus the undulation {n:.2f} m ({source})"]


def _stated(o: Onboard, prior: Prior, chosen: str) -> Prior:
    """The position of a photo's XMP with the standard errors it states (RTK), which EXIF has no room for."""
    if o.lat is None or o.lon is None or o.height is None:
        return replace(prior, sigma_m=np.array(o.sigma_m))
    centre = crs.transformed(np.array([[o.lon, o.lat, o.height]]), "EPSG:4326", chosen)[0]
    return Prior(centre=np.round(centre, 4), sigma_m=np.array(o.sigma_m))


def _undulation(said: float | str, exifs: Sequence[Exif]) -> tuple[float, str]:
    """The geoid's height [m] at the photos, and where it comes from. Raises BadProject."""
    if not isinstance(said, str):
        return float(said), "entered"
    path = find_geoid() if said == "auto" else Path(said)
    if path is None:
        raise BadProject("--undulation auto: no geoid grid is installed on this machine; give a grid's file or metres")
    lon, lat = np.median(_degrees(exifs), axis=0)
    grid = read_surface(path, (lon - 0.5, lat - 0.5, lon + 0.5, lat + 0.5))
    value = float(np.ravel(grid.sample(np.array([[lon, lat]])))[0])
    if not np.isfinite(value):
        raise BadProject(f"{path}: it has no undulation at {lat:.4f}, {lon:.4f}; give a grid of the site or metres")
    return value, path.name


def _shutter(photos: Sequence[Path], camera_of: Sequence[str], priors: Sequence[Prior | None], chosen: str,
             ) -> tuple[dict[str, float], tuple[Prior | None, ...], list[str]]:
    """Readout times of the cameras, priors with velocities where photos state both, and from which ground on it matters."""
    motions = [read_motion(p) for p in photos]
    readout = {c: m.readout_ms for c, m in zip(camera_of, motions, strict=True) if m.readout_ms is not None}
    if not readout:
        return {}, tuple(priors), []
    out, way, turns = [], [], []
    for camera, motion, prior in zip(camera_of, motions, priors, strict=True):
        if motion.velocity is not None and prior is not None and camera in readout and chosen != "local":
            prior = replace(prior, velocity=motion.velocity, sigma_velocity=np.full(3, VELOCITY_SIGMA))
            way.append((float(np.linalg.norm(motion.velocity)), readout[camera]))
        if motion.turning is not None and prior is not None and camera in readout:
            prior = replace(prior, turning=motion.turning)
            turns.append(float(np.degrees(np.abs(motion.turning[-1] - motion.turning[0]).max())))
        out.append(prior)
    said = [f"rolling shutter: camera {c} reads a photo in {ms:.0f} ms (XMP)" for c, ms in readout.items()]
    if way:
        speed, ms = sorted(way)[len(way) // 2]
        moved = speed * ms * 1e-3
        said[-1] += (f" and flies {speed:.1f} m/s: it moves by {moved:.2f} m, more than half a pixel where a pixel on the ground "
                     f"is smaller than {2 * moved:.2f} m; adjust with --rolling-shutter")
    if turns:
        said.append(f"gyroscope: {len(turns)} photos record how they turned while they were read, by {np.median(turns):.1f} "
                    "degrees (median); adjust takes it in (--rolling-shutter)")
    return readout, tuple(out), said


def _unstated(photos: Sequence[Path], exifs: Sequence[Exif], camera_of: Sequence[str], cameras: Mapping[str, Interior],
              readout: Mapping[str, float]) -> list[str]:
    """What to say of cameras that move while they read, at a pace that no photo states."""
    records: dict[str, list[Onboard]] = {}
    for photo, exif, camera in zip(photos, exifs, camera_of, strict=True):
        if camera not in readout and rolls(exif.model):
            records.setdefault(camera, []).append(read_onboard(photo))
    return unstated_shutters(cameras, records)


# -- questions --------------------------------------------------------------------------------------------------------------


def _choose_origin(control: ControlList | None, given: str | None, ask: Ask | None) -> tuple[str, list[str]]:
    if given or control is None or not control.marks:
        return given or "center", []
    if ask is not None:
        answer = ask("Pixel (0, 0) of the measurements is the center of the top-left pixel, or its corner [center]: ")
        answer = answer.strip().lower()
        if answer in ("", "center", "centre", "corner"):
            return "corner" if answer == "corner" else "center", []
        raise BadProject(f"pixel origin '{answer}' is not known; answer center or corner")
    return "center", ["pixel origin: center of the top-left pixel (assumed; give --pixel-origin corner if (0, 0) is its corner)"]


def _confirm(notes: Sequence[str], ask: Ask) -> None:
    if ask("\n".join(notes) + "\nIs this right? [yes] ").strip().lower() not in ("", "y", "yes"):
        raise BadProject("nothing was written; say it with --map, --crs, --pixel-origin, --pixel-um and --c-mm")


def _photo_notes(exifs: Sequence[Exif]) -> list[str]:
    turned = sum(e.orientation != 1 for e in exifs)
    said = f"{turned} photos ask to be shown turned (EXIF orientation); pixels refer to the photo as it is stored"
    return [said] if turned else []


def _written_path(photo: Path, folder: Path) -> str:
    """Relative inside the project folder, absolute elsewhere."""
    at, home = photo.resolve(), folder.resolve()
    return at.relative_to(home).as_posix() if at.is_relative_to(home) else str(at)


def _none() -> Observations:
    return Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))
