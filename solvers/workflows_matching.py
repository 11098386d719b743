"""The walks of matching: one point in two photos, the targets of a photo, the tie points of a block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .block import Block, Image, Observations, Points, Prior
from .cameras import Interior
from .errors import BadProject, DegenerateGeometry, PhotogrammetryError, Unsupported
from .execution import Progress
from .io import (
    ArrayFolder,
    assemble,
    crs,
    photo_path,
    photo_state,
    read_exif,
    read_photo,
    read_project,
    write_observation_table,
    write_tables,
)
from .matching import (
    LsmOptions,
    Status,
    Targets,
    TieOptions,
    TiePhoto,
    Ties,
    find_targets,
    match_lsm,
    match_ncc,
    number_targets,
    predict,
    tie_points,
)
from .matching.chessboard import board_points, find_chessboard

NEAR, FAR = 12, 40
"""px, how far a match is searched from a predicted place, and from the same pixel of the other photo."""


# -- one point --------------------------------------------------------------------------------------------------------------


def match_photos(first: Path | str, second: Path | str, at: tuple[float, float], *, start: tuple[float, float] | None = None,
                 window: int = 21, search: int | None = None, method: str = "lsm") -> dict[str, Any]:
    """The point of the second photo that shows what lies at col, row of the first: the JSON of the command match.

    start: col, row in the second photo, where it is known; without it the photos' features predict place and shape.
    Raises DegenerateGeometry with the reason when the point is not found.
    """
    a, b = read_photo(Path(first)), read_photo(Path(second))
    size = a.shape[1::-1]
    if not all(-0.5 <= v <= s - 0.5 for v, s in zip(at, size, strict=True)):
        raise Unsupported(f"{first}: col {at[0]:g}, row {at[1]:g} lies outside the photo of {size[0]} x {size[1]} pixels; give a "
                          "pixel inside it")
    place, shape, how = np.array(at if start is None else start, float), np.eye(2), "same pixel" if start is None else "given"
    guess = predict(a, b, np.array(at, float)) if start is None else None
    if guess is not None:
        place, shape, how = *guess, "features"
        if not ((place > -0.5) & (place < np.array(b.shape[::-1]) - 0.5)).all():
            raise DegenerateGeometry(f"{second}: it does not show the point of col {at[0]:g}, row {at[1]:g}, which by its "
                                     f"features would be at col {place[0]:.0f}, row {place[1]:.0f}; choose another point or "
                                     "photo")
    reach = search if search is not None else FAR if how == "same pixel" else NEAR
    known = {"method": method, "start": {"col": place[0], "row": place[1], "from": how}, "window": window, "search": reach}
    if method == "ncc":
        ncc = match_ncc(a, b, np.array([at]), place[None], window, reach, shape=shape)
        _must_be_found(ncc.status[0], at, second, place, reach)
        (col, row), affine = ncc.pixel[0], shape
        return {"col": col, "row": row, "score": ncc.score[0], "sigma_px": None, "iterations": 0,
                "affine": [col, *affine[0], row, *affine[1]], "radiometric": None, "uniqueness": ncc.uniqueness[0], **known}
    lsm = match_lsm(a, b, np.array([at]), place[None], window, search=reach, shape=shape, options=LsmOptions())
    _must_be_found(lsm.status[0], at, second, place, reach)
    (col, row), affine = lsm.pixel[0], lsm.shape[0]
    return {"col": col, "row": row, "score": lsm.score[0], "sigma_px": lsm.sigma[0], "iterations": lsm.iterations[0],
            "affine": [col, *affine[0], row, *affine[1]], "radiometric": lsm.radiometric[0], **known}


def _must_be_found(status: int, at: tuple[float, float], photo: Path | str, place: np.ndarray, search: int) -> None:
    if status != Status.OK:
        raise DegenerateGeometry(f"the point at col {at[0]:g}, row {at[1]:g} is not found in {photo} within {search} px of col "
                                 f"{place[0]:.1f}, row {place[1]:.1f}: {Status(status).reason}; choose another point, or give "
                                 "--start and --search")


# -- targets ------------------------------------------------------------------------------------------------------------------


def targets_of_photo(photo: Path | str, kind: str = "dot", out: Path | str | None = None,
                     board: tuple[int, int] | None = None) -> dict[str, Any]:
    """The targets of one photo, numbered where the sheet's coded corners are seen, written as observations where asked for.

    Raises DegenerateGeometry when there is none.
    """
    path = Path(photo)
    image = read_photo(path, grey=False)
    if kind == "chessboard":
        return _corners(path, image, board, out)
    targets = find_targets(image, kind)
    if not len(targets):
        other = "ring" if kind == "dot" else "dot"
        raise DegenerateGeometry(f"{path}: no target of kind {kind} is found; try --kind {other}, or a sharper photo")
    numbered = False
    if kind == "dot":
        try:
            targets, numbered = number_targets(image, targets), True
        except DegenerateGeometry:
            numbered = False  # not a sheet with coded corners: the targets keep running numbers
    names = [label or f"{kind}-{n}" for n, label in enumerate(targets.label, 1)]
    if out is not None:
        sigma = np.sqrt((targets.sigma**2).mean(1))
        write_observation_table(Path(out), [path.stem] * len(targets), names, targets.pixel, sigma)
    return {"image": path.stem, "kind": kind, "numbered": numbered, "targets": _target_rows(targets, names, _c_px(path))}


def _corners(path: Path, image: np.ndarray, board: tuple[int, int] | None, out: Path | str | None) -> dict[str, Any]:
    """The corners of a chessboard, in the same form."""
    if board is None:
        raise BadProject("how many inner corners has the chessboard? give --board COLUMNSxROWS, such as 9x6")
    pixel, names = find_chessboard(image, board), board_points(board, 1.0)[0]
    if out is not None:
        write_observation_table(Path(out), [path.stem] * len(names), names, pixel, np.full(len(names), np.nan))
    nan = float("nan")
    rows = [{"point": n, "col": at[0], "row": at[1], "sigma_px": [nan, nan], "centroid": at, "axes_px": [nan, nan],
             "angle_deg": nan, "contrast": nan, "eccentricity_px": nan} for n, at in zip(names, pixel, strict=True)]
    return {"image": path.stem, "kind": "chessboard", "numbered": True, "targets": rows}


def _target_rows(targets: Targets, names: Sequence[str], c_px: float | None) -> list[dict[str, Any]]:
    bias = np.full(len(targets), np.nan) if c_px is None else targets.eccentricity(c_px)
    return [{"point": names[n], "col": targets.pixel[n, 0], "row": targets.pixel[n, 1], "sigma_px": targets.sigma[n],
             "centroid": targets.centroid[n], "axes_px": targets.axes[n], "angle_deg": np.degrees(targets.angle[n]),
             "contrast": targets.contrast[n], "eccentricity_px": bias[n]} for n in range(len(targets))]


def _c_px(path: Path) -> float | None:
    exif = read_exif(path)
    return exif.focal_mm / exif.pitch_mm if exif.focal_mm and exif.pitch_mm else None


# -- tie points -----------------------------------------------------------------------------------------------------------------


class Tied(NamedTuple):
    """Tie points of a project or a folder of photos, and the file that holds them."""

    ties: Ties
    file: Path

    def to_json(self) -> dict[str, Any]:
        """The JSON of the command tiepoints."""
        ties = self.ties
        rays = np.bincount(ties.rays)
        images = [{"name": name, "points": int(n), "used": bool(n), "why": ties.failed.get(name, "" if n else "no common points")}
                  for name, n in zip(ties.photos, ties.per_photo, strict=True)]
        return {"observations_file": str(self.file), "points": len(ties.points), "observations": len(ties.observations),
                "rays": {str(n): int(rays[n]) for n in range(2, len(rays))}, "images": images,
                "pairs": [p._asdict() for p in ties.pairs], "groups": [list(g) for g in ties.groups]}


def find_ties(source: Path | str, out: Path | str | None = None, options: TieOptions | None = None, *, workers: int = 1,
              scheduler: str | None = None, report: Callable[[Progress], object] | None = None) -> Tied:
    """Tie points of a project (written into its tables, in place of earlier ones found so) or of a folder of photos (written as
    a table of observations: `out`, or tiepoints.csv in the folder; what is done is kept in a folder beside it until all is, to go
    on after an interruption).

    Raises PhotogrammetryError.
    """
    folder = Path(source)
    if (folder / "project.toml").exists():
        return _tie_project(folder, out, options, workers, scheduler, report)
    if not folder.is_dir():
        raise BadProject(f"{folder}: there is no such folder; give a project or a folder of photos")
    paths, _ = assemble.sort_files([folder])
    file = Path(out) if out is not None else folder / "tiepoints.csv"
    names = assemble.image_names(paths)
    photos = _photos_of_folder(paths, names)
    read = partial(read_by_name, paths=dict(zip(names, paths, strict=True)))
    store = ArrayFolder(file.with_name(f"{file.stem}-kept"))
    ties = tie_points(photos, read, options, workers=workers, scheduler=scheduler, store=store, report=report)
    _write_ties(file, ties, ties.observations.pixel)
    store.clear()
    return Tied(ties, file)


def read_by_name(name: str, paths: dict[str, Path]) -> np.ndarray:
    """Grey values of a photo; at the top of a module, so that worker processes find it."""
    return read_photo(paths[name])


def ties_of_block(block: Block, folder: Path, options: TieOptions | None = None, *, workers: int = 1,
                  scheduler: str | None = None, report: Callable[[Progress], object] | None = None) -> tuple[Block, Ties]:
    """The block of a project folder with tie points of its photos, in place of earlier ones found so; nothing is written.

    What is done is kept in the folder's runs, to go on after an interruption. Raises PhotogrammetryError.
    """
    images = [i for i in block.images if i.file is not None]
    if len(images) < 2:
        raise BadProject(f"{folder}: {len(images)} of its images have photos; tie points need two and more")
    paths = {i.name: photo_path(folder, block, i.name) for i in images}
    photos = [TiePhoto(i.name, block.camera_of(i.name), _position(i.prior), photo_state(paths[i.name])) for i in images]
    store = ArrayFolder(folder / "runs" / "tiepoints-kept")
    ties = tie_points(photos, partial(read_by_name, paths=paths), options, workers=workers, scheduler=scheduler, store=store,
                      report=report)
    return with_ties(block, ties, images, ties_in_format(ties, block)), ties


def _tie_project(folder: Path, out: Path | str | None, options: TieOptions | None, workers: int, scheduler: str | None,
                 report: Callable[[Progress], object] | None) -> Tied:
    block = read_project(folder)
    new, ties = ties_of_block(block, folder, options, workers=workers, scheduler=scheduler, report=report)
    if out is not None:
        _write_ties(Path(out), ties, ties_in_format(ties, block))
        return Tied(ties, Path(out))
    write_tables(new, folder)
    return Tied(ties, folder / "observations.csv")


def _position(prior: Prior | None) -> np.ndarray | None:
    return None if prior is None else prior.centre


def ties_in_format(ties: Ties, block: Block) -> np.ndarray:
    """(m, 2) pixels of the cameras' formats, which photos may show smaller."""
    formats = np.array([(block.camera_of(n).width, block.camera_of(n).height) for n in ties.photos], float)
    sizes = np.array(ties.sizes, float)
    scale = (formats / np.where(sizes > 0, sizes, formats))[ties.observations.image]
    return (ties.observations.pixel + 0.5) * scale - 0.5


def with_ties(block: Block, ties: Ties, images: Sequence[Image], pixel: np.ndarray) -> Block:
    """The block with these tie points in place of those an earlier search has found."""
    old = np.array([name.startswith("tie") and name[3:].isdigit() and role == "tie"
                    for name, role in zip(block.points.names, block.points.role, strict=True)], bool)
    stay = np.flatnonzero(~old)
    number = np.full(len(old), -1)
    number[stay] = np.arange(len(stay))
    p, of, new = block.points, block.observations, ties.observations
    rows = np.flatnonzero(~old[of.point]) if len(of) else np.empty(0, int)
    group = (*(p.group[k] for k in stay), *("",) * len(ties.points)) if p.group else ()
    points = Points((*(p.names[k] for k in stay), *ties.points.names), np.vstack([p.xyz[stay], ties.points.xyz]),
                    np.vstack([p.sigma[stay], ties.points.sigma]), (*(p.role[k] for k in stay), *ties.points.role), group)
    where = np.array([block.image_index(i.name) for i in images])
    observations = Observations(np.concatenate([of.image[rows], where[new.image]]),
                                np.concatenate([number[of.point[rows]], len(stay) + new.point]),
                                np.vstack([of.pixel[rows], np.round(pixel, 4)]),
                                np.concatenate([of.sigma[rows], np.round(new.sigma, 4)]))
    return replace(block, points=points, observations=observations)


def _write_ties(file: Path, ties: Ties, pixel: np.ndarray) -> None:
    of = ties.observations
    write_observation_table(file, [ties.photos[i] for i in of.image], [ties.points.names[j] for j in of.point],
                            np.round(pixel, 4), np.round(of.sigma, 4))


def _photos_of_folder(paths: Sequence[Path], names: Sequence[str]) -> list[TiePhoto]:
    """Photos with what their EXIF says of camera and position."""
    exifs = []
    for path in paths:
        try:
            exifs.append(read_exif(path))
        except PhotogrammetryError:
            exifs.append(None)  # the search itself names it as failed
    zone = assemble.home_zone([e for e in exifs if e is not None])
    photos = []
    for path, name, exif in zip(paths, names, exifs, strict=True):
        interior = position = None
        if exif is not None and exif.focal_mm and exif.pitch_mm:
            interior = Interior(exif.focal_mm, pixel_mm=exif.pitch_mm, width=exif.width, height=exif.height)
        if exif is not None and zone is not None and exif.lat is not None and exif.lon is not None:
            position = crs.transformed(np.array([[exif.lon, exif.lat, exif.alt or 0.0]]), "EPSG:4326", zone)[0]
        photos.append(TiePhoto(name, interior, position, photo_state(path)))
    return photos
