"""The walk convert: a file of another tool, or a project, into a project, or a file for another tool."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .block import Block
from .errors import BadProject, BadTable, PhotogrammetryError, Unsupported
from .geometry import Exterior
from .io import Ask, assemble, crs, read_exif, write_json
from .io.exchange import drawing, registry
from .io.exchange import project as projects
from .io.exchange.options import NOTHING, Reading
from .io.exchange.scene import Exchange
from .io.sniff import Tell
from .io.whereabouts import Reading as Place
from .io.whereabouts import mistaken
from .orientation import Known, footprint, footprints_geojson, monoplot
from .orientation.oriented import frame_of
from .workflows_new import must_be_free, write_new
from .workflows_orientation import adjusted_points, ground_of, known_orientations

GROUND = ("dxf", "footprints", "world")
"""Targets that need the ground beside the orientations."""
BY_NAME = {"transforms.json": "nerfstudio", "bundle.out": "bundler", "gcp_list.txt": "gcp-odm", "project.opf": "opf"}
BY_ENDING = {".opf": "opf", ".glb": "glb", ".ply": "ply", ".dxf": "dxf", ".points": "qgis", ".out": "bundler", ".bal": "bal",
             ".ori": "patb", ".yml": "cal-opencv", ".yaml": "cal-opencv",
             **dict.fromkeys((".tfw", ".jgw", ".pgw", ".wld", ".tifw", ".jpgw"), "world")}


@dataclass(frozen=True)
class Wanted:
    """What a person asked for. source, target: names of formats, None: found out. crs: of the input, over what it says; to_crs:
    of the output. swap_xy, unit, height_unit: how its coordinates are meant. reading: the rest of what it does not say. camera: a
    calibration for images without one. photos: folder of the photos. orientations: of a project, as in `known_orientations`.
    lines, dem, z: what is drawn and on which ground. image: the one image of a world file or a .points file."""

    source: str | None = None
    target: str | None = None
    crs: str | None = None
    to_crs: str | None = None
    swap_xy: bool = False
    unit: str | None = None
    height_unit: str | None = None
    reading: Reading = NOTHING
    camera: str | None = None
    photos: str | None = None
    orientations: str = "auto"
    lines: str | None = None
    dem: str | None = None
    z: float | None = None
    image: str | None = None


class Converted(NamedTuple):
    """What was read, what was written, and what a person should know."""

    source: str
    target: str
    out: Path
    summary: str
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command convert."""
        return {"from": self.source, "to": self.target, "out": str(self.out), "read": self.summary, "notes": list(self.notes)}


PLAIN = Wanted()
"""Nothing special."""


class Shown(NamedTuple):
    """How a file would be read: its format by name, and the columns of a table in words, None for a file that is none."""

    path: Path
    format: str
    columns: str | None

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {"file": str(self.path), "format": self.format, "columns": self.columns}


def show_mapping(source: Path | str, name: str | None = None, reading: Reading = NOTHING) -> Shown:
    """How a file would be read, nothing is written. Raises PhotogrammetryError where that is unclear."""
    source, told = Path(source), []
    found = name or registry.of_mapping(registry.sniff(source), reading.mapping)
    try:
        registry.read(source, found, replace(reading, tell=told.append))
    except PhotogrammetryError:
        if not told:
            raise
    return Shown(source, found, told[0].removeprefix(f"{source}: ") if told else None)


def convert(source: Path | str, out: Path | str, wanted: Wanted = PLAIN, ask: Ask | None = None, tell: Tell | None = None,
            ) -> Converted:
    """Read `source`, write `out`. Raises PhotogrammetryError; a file is written whole or not at all. tell: is shown the
    columns of a table before they are used."""
    source, out = Path(source), Path(out)
    target = wanted.target or target_of(out)
    if not out.resolve().parent.is_dir():
        raise BadProject(f"{out}: there is no such folder {out.parent}; make it first or correct the path")
    if target == "world" and source.suffix.lower() in (".tif", ".tiff") and wanted.image is None and source.is_file():
        return _world_of_raster(source, out)
    project = (source / "project.toml").is_file()
    scene, block, known = _of_project(source, wanted) if project else (_of_file(source, wanted, ask, tell), None, ())
    if project and wanted.crs and scene.crs == "local" and target not in GROUND:
        said = crs.short_crs(wanted.crs)
        scene = replace(scene, crs=said).with_notes(f"crs: the project's local coordinates are taken in {said}")
    scene = _with_camera(scene, wanted)
    if target == "project":
        return _to_project(scene, out, wanted)
    if project and wanted.to_crs and scene.crs is not None:
        scene = projects.metric(scene, Place(scene.crs), wanted.to_crs)
    if target in GROUND:
        notes = _drawn(target, scene, block, known, source, out, wanted)
    else:
        notes = _written(target, scene, out, wanted)
    return Converted(scene.kind, target, out, scene.summary(), (*scene.notes, *notes))


def target_of(out: Path) -> str:
    """The format a name asks for. Raises BadTable when it is unclear."""
    found = BY_NAME.get(out.name.lower()) or BY_ENDING.get(out.suffix.lower())
    if found is None and out.name.lower().endswith("_calibrated_camera_parameters.txt"):
        found = "pix4d"
    if found is None and out.suffix == "":
        found = "project"
    if found is None:
        several = {".xml": "blocks or cal-metashape", ".csv": "gcp, gcp-pix4dmatic, metashape-csv, opk, opk-gon or pok",
                   ".txt": "opk-metashape, opk-pix4d, gcp, gcp-pix4dmatic, cal-australis or bal",
                   ".geojson": "gcp-geojson or footprints", ".json": "nerfstudio or gcp-geojson"}.get(out.suffix.lower())
        choice = several or ", ".join([*(k for k, f in registry.FORMATS.items() if f.write), *GROUND, "project"])
        raise BadTable(f"{out}: the name does not say which format is meant; name it with --to, {choice}")
    return found


# -- reading ----------------------------------------------------------------------------------------------------------------


def _of_project(folder: Path, wanted: Wanted) -> tuple[Exchange, Block, tuple[Known, ...]]:
    """A project with its best orientations (none where it has none yet)."""
    found = known_orientations(folder, wanted.orientations)
    frame = frame_of(found.block, {k.image: k for k in found.known})
    exteriors = {k.image: (k.exterior, k.covariance) for k in found.known}
    scene = projects.scene_of(found.block, folder, exteriors, frame, found.notes)
    ties = adjusted_points(folder) if wanted.orientations in ("auto", "adjust") else {}
    if ties:
        p = scene.points
        xyz = np.array([ties.get(n, x) for n, x in zip(p.names, p.xyz, strict=True)]).reshape(-1, 3)
        scene = replace(scene, points=replace(p, xyz=xyz))
    return scene, found.block, found.known


def _of_file(source: Path, wanted: Wanted, ask: Ask | None, tell: Tell | None) -> Exchange:
    """A file in metres, checked against the photos where there are some."""
    said = crs.short_crs(wanted.crs, metric=False) if wanted.crs else None
    scene = registry.read(source, wanted.source, replace(wanted.reading, crs=said, ask=ask, tell=tell))
    shown = [n for n in scene.notes if n.startswith("columns: ")]
    if ask is not None and shown and ask(f"{shown[0]}\nIs this right? [yes] ").strip().lower() not in ("", "y", "yes"):
        raise BadProject("nothing was written; say which columns they are with --map")
    own = said or scene.crs
    if said and scene.crs and scene.crs not in ("local", said) and scene.kind not in ("OpenSfM reconstruction", "BlocksExchange"):
        scene = scene.with_notes(f"crs: read in {said}, though the file says {scene.crs}")
    if own is None or not (len(scene.points) or any(s.exterior is not None for s in scene.shots)):
        if wanted.to_crs:
            raise BadProject(f"{source}: it does not say its coordinate system; give it with --crs EPSG:CODE")
        return scene
    if scene.crs == "local" and said and said != "local":
        scene = replace(scene, crs=said)
    place = Place(own if scene.crs != said and said is None else str(said or scene.crs), wanted.swap_xy, wanted.unit)
    place = _checked(scene, place, wanted, ask)
    return projects.metric(scene, place, wanted.to_crs, wanted.height_unit)


def _checked(scene: Exchange, place: Place, wanted: Wanted, ask: Ask | None) -> Place:
    """The place, or the one that mends a mistake when a person says so. Raises BadProject for coordinates far from the photos."""
    degrees = _photo_positions(scene, wanted)
    at = [scene.points.xyz, np.array([s.exterior.centre for s in scene.shots if s.exterior is not None]).reshape(-1, 3)]
    wrong = mistaken(np.vstack(at), place, degrees)
    if wrong is None:
        return place
    far = f"{wrong.distance / 1e3:.0f} km from" if np.isfinite(wrong.distance) else "nowhere near"
    told = f"{scene.path}: its coordinates lie {far} the photos' GPS positions when read in {place.crs}"
    if wrong.mended is None:
        raise BadProject(f"{told} {wrong.words}; correct the file, or name its coordinate system with --crs")
    if ask is not None and ask(f"{told}: perhaps {wrong.words}. Read them so? [yes] ").strip().lower() in ("", "y", "yes"):
        return wrong.mended
    raise BadProject(f"{told}, perhaps {wrong.words}; give {wrong.options}")


def _photos(wanted: Wanted) -> dict[str, Path]:
    """The photos of --photos by small letters of their names, with and without the ending."""
    if wanted.photos is None:
        return {}
    files, _ = assemble.sort_files([Path(wanted.photos)])
    return {p.stem.lower(): p for p in files} | {p.name.lower(): p for p in files}


def _photo_positions(scene: Exchange, wanted: Wanted) -> np.ndarray:
    """Longitude, latitude (m, 2) of the photos that are found: of --photos, else those that the file names."""
    paths = list(dict.fromkeys(_photos(wanted).values()))
    if not paths:
        home = scene.path if scene.path.is_dir() else scene.path.parent
        named = [s.file for s in scene.shots if s.file is not None][:50]
        paths = [p for n in named if (p := home / Path(n.replace("\\", "/"))).is_file() or (p := home / p.name).is_file()]
    out = []
    for path in paths[:50]:
        try:
            exif = read_exif(path)
        except Unsupported:
            continue
        if exif.lon is not None and exif.lat is not None:
            out.append((exif.lon, exif.lat))
    return np.array(out, float).reshape(-1, 2)


def _with_camera(scene: Exchange, wanted: Wanted) -> Exchange:
    """Images without a camera get the calibration that was given."""
    if wanted.camera is None:
        return scene
    given = registry.read(Path(wanted.camera), None, wanted.reading)
    if len(given.cameras) != 1:
        raise BadProject(f"{wanted.camera}: it holds {len(given.cameras)} cameras; give the calibration of one")
    [(name, camera)] = given.cameras.items()
    shots = tuple(s if s.camera in scene.cameras else replace(s, camera=name) for s in scene.shots)
    return replace(scene, cameras={**scene.cameras, name: camera}, shots=shots, notes=(*scene.notes, *given.notes))


# -- writing ----------------------------------------------------------------------------------------------------------------


def _to_project(scene: Exchange, out: Path, wanted: Wanted) -> Converted:
    must_be_free(out)
    if not scene.shots and not len(scene.points):
        raise BadProject(f"{scene.path}: there is neither an image nor a point in it to make a project of; give it to collinea "
                         f"init beside "
                         "the photos")
    block, notes = projects.block_of(scene, out.resolve().name or "project", out, _photos(wanted))
    write_new(block, out, "center")
    priors = sum(i.prior is not None and i.prior.angles is not None for i in block.images)
    said = (f"orientations: {priors} images, as priors; use them with --from prior, or refine them with collinea adjust --start "
            f"prior",) \
        if priors else ()
    return Converted(scene.kind, "project", out, scene.summary(), (*scene.notes, *notes, *said))


def _written(target: str, scene: Exchange, out: Path, wanted: Wanted) -> tuple[str, ...]:
    form = registry.FORMATS.get(target)
    if form is None or form.write is None:
        raise BadTable(f"--to {target}: this format is not written; choose from "
                       f"{', '.join([*(k for k, f in registry.FORMATS.items() if f.write), *GROUND, 'project'])}")
    has = {"cameras": bool(scene.cameras), "orientations": bool(scene.oriented), "points": bool(len(scene.points))}
    needed = form.holds[:1] if target in ("glb", "ply") else [k for k in ("cameras", "orientations")
                                                              if k in form.holds] or ["points"]
    missing = [k for k in needed if not has[k]] if target != "opf" else []
    if target in ("glb", "ply") and missing and has["points"]:
        missing = []
    if missing:
        raise BadTable(f"{scene.path}: it has no {missing[0]}, which {form.title} is made of; {_CURES[missing[0]]}")
    loose = [s.name for s in scene.oriented if "cameras" in form.holds and s.camera not in scene.cameras]
    if loose:
        raise BadTable(f"{scene.path}: image '{loose[0]}' has no camera; give its calibration with --camera FILE")
    return form.write(_only(scene, wanted.image) if wanted.image and target == "qgis" else scene, out)


def _only(scene: Exchange, image: str) -> Exchange:
    """The scene with one image and its measurements."""
    n = next((n for n, s in enumerate(scene.shots) if s.name == image), None)
    if n is None:
        raise BadProject(f"{scene.path}: there is no image '{image}'; choose one of {', '.join(s.name for s in scene.shots[:8])}")
    of = scene.observations
    rows = of.image == n
    return replace(scene, shots=(scene.shots[n],), observations=replace(of, image=np.zeros(rows.sum(), int), point=of.point[rows],
                                                                         pixel=of.pixel[rows], sigma=of.sigma[rows]))


_CURES = {"cameras": "give a calibration with --camera FILE", "orientations": "orient the images first (collinea resect or "
                                                                              "adjust)",
          "points": "give a file with control points"}


def _drawn(target: str, scene: Exchange, block: Block | None, known: tuple[Known, ...], source: Path, out: Path,
           wanted: Wanted) -> tuple[str, ...]:
    """DXF, footprints or a world file: what needs rays to the ground."""
    if block is None:
        block, _ = projects.block_of(scene, source.stem, source.parent)
        frame = projects.frame_of(scene)
        known = tuple(Known(s.name, Exterior(s.exterior.m @ projects.turn(block.crs, frame, s.exterior.centre),
                                             s.exterior.centre))
                      for s in scene.oriented if s.exterior is not None)
    elif wanted.to_crs:
        raise BadProject("--to-crs: drawings of a project are in its own crs; convert the project first")
    makers: Mapping[str, Callable[..., tuple[str, ...]]] = {"dxf": _dxf, "footprints": _footprints, "world": _world}
    return makers[target](block, {k.image: k for k in known}, source, out, wanted)


def _ground(block: Block, source: Path, wanted: Wanted) -> Any:
    ground = ground_of(source, block, wanted.dem, wanted.z)
    if ground is None:
        raise BadProject(f"{source}: the height of the ground is not known; give --dem DEM.tif or --z H, or add [surface] to "
                         f"project.toml")
    return ground


def _dxf(block: Block, known: Mapping[str, Known], source: Path, out: Path, wanted: Wanted) -> tuple[str, ...]:
    """Lines drawn in photos, monoplotted vertex by vertex; control and check points."""
    lines: list[tuple[str, np.ndarray, bool]] = []
    steep = 0
    if wanted.lines is not None:
        ground = _ground(block, source, wanted)
        for name, (image, pixels) in drawing.read_lines(Path(wanted.lines)).items():
            at = known.get(block.images[block.image_index(image)].name)
            if at is None:
                raise BadProject(f"{wanted.lines}: line '{name}' is in image '{image}', which is not oriented; orient it first")
            closed = len(pixels) > 3 and bool((pixels[0] == pixels[-1]).all())
            hits = [monoplot(block, at, (p[0], p[1]), ground) for p in (pixels[:-1] if closed else pixels)]
            steep += sum(bool(h.warnings) for h in hits)
            lines.append((name, np.array([h.ground for h in hits]), closed))
    points: dict[str, list[tuple[str, np.ndarray]]] = {}
    for name, xyz, role in zip(block.points.names, block.points.xyz, block.points.role, strict=True):
        if role != "tie" and np.isfinite(xyz).all():
            points.setdefault(role, []).append((name, xyz))
    drawing.write_dxf(out, {"lines": lines} if lines else {}, points)
    warned = (f"{steep} vertices meet the ground at a grazing angle or with warnings",) if steep else ()
    return (f"drawn: {len(lines)} lines, {sum(map(len, points.values()))} points in {block.crs}", *warned)


def _footprints(block: Block, known: Mapping[str, Known], source: Path, out: Path, wanted: Wanted) -> tuple[str, ...]:
    ground, outlines, missed = _ground(block, source, wanted), [], []
    for at in known.values():
        try:
            outlines.append(footprint(block, at, ground))
        except PhotogrammetryError as error:
            missed.append(f"no footprint: {error}")
    if not outlines:
        raise BadProject(missed[0].removeprefix("no footprint: ") if missed else f"{source}: no image is oriented; orient the "
                                                                                 f"images first")
    write_json(out, footprints_geojson(outlines, block.crs))
    return (f"footprints: {len(outlines)}, on {outlines[0].surface}", *missed)


def _world(block: Block, known: Mapping[str, Known], source: Path, out: Path, wanted: Wanted) -> tuple[str, ...]:
    """A world file of one photo: the affine that fits its rays to the ground best."""
    name = wanted.image or (next(iter(known)) if len(known) == 1 else None)
    if name is None:
        raise BadProject(f"{source}: a world file is of one photo; name it with --image, one of {', '.join(list(known)[:8])}")
    at = known.get(block.images[block.image_index(name)].name)
    if at is None:
        raise BadProject(f"{source}: image '{name}' is not oriented; orient it first")
    camera, ground = block.camera_of(name), _ground(block, source, wanted)
    col, row = np.meshgrid(np.linspace(0, camera.width - 1, 7), np.linspace(0, camera.height - 1, 7))
    pixels = np.column_stack([col.ravel(), row.ravel()])
    hits = np.array([monoplot(block, at, (p[0], p[1]), ground).ground for p in pixels])
    affine, off = drawing.fitted_affine(pixels, hits[:, :2])
    drawing.write_world(out, affine)
    return (f"world file of {name}: an affine can only approximate a photo, it is off by at most {off:.3g} m here; use collinea "
            f"rectify for "
            "a picture that fits",)


def _world_of_raster(source: Path, out: Path) -> Converted:
    from .io.geotiff import raster_affine

    affine, name = raster_affine(source)
    drawing.write_world(out, affine)
    return Converted("GeoTIFF", "world", out, f"raster in {name}", ("a world file does not say the crs: it is " + name,))
