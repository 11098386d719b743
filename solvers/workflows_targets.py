"""The walk from photos of a sheet of targets or a chessboard to a project that can be calibrated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .block import Block, Observations, Points
from .errors import BadProject, DegenerateGeometry
from .io import photo_path, read_photo, read_project, write_tables
from .matching import find_targets, number_targets
from .matching.chessboard import board_points, find_chessboard

CHESS_SIGMA = 0.15
"""Standard error of a chessboard corner [px]: what calibrations of ordinary photos leave."""
CORNER = 0.01
"""Standard error of a sheet's four outermost targets, over the distance of its rows: they give the datum and bend nothing."""
LEAST_SIGMA = 0.1
"""Standard error [px] that no centre of a target is believed to be better than."""


def targets_of_project(folder: Path | str, kind: str = "dot", board: tuple[int, int] | None = None,
                       square: float = 1.0) -> dict[str, Any]:
    """Measure the targets in all photos of a project; its points and observations become those of the sheet.

    A chessboard's corners are fixed control, `square` apart [m]. Of a sheet whose coded corners number its dots, the four
    outermost are weak control, `square` from row to row and column to column; all others are unknown. Photos without targets are
    told. Raises BadProject where the project has observations already, DegenerateGeometry where no two photos show targets.
    """
    folder = Path(folder)
    block = read_project(folder)
    if len(block.observations):
        raise BadProject(f"{folder / 'observations.csv'}: the project has observations already; measure targets in a new project "
                         "(collinea init PHOTOS -o NEW)")
    found: dict[str, tuple[tuple[str, ...], np.ndarray, np.ndarray]] = {}
    failed: dict[str, str] = {}
    for image in block.images:
        try:
            photo = read_photo(photo_path(folder, block, image.name), grey=False)
            found[image.name] = _measured(photo, kind, board)
        except DegenerateGeometry as error:
            failed[image.name] = str(error)
    if len(found) < 2:
        why = next(iter(failed.values()), "the project has fewer than two photos")
        raise DegenerateGeometry(f"{folder}: targets are found in {len(found)} photo(s), a calibration needs several; {why}")
    made = _block(block, found, board, square)
    write_tables(made, folder)
    return {"project": str(folder), "kind": kind, "points": len(made.points), "observations": len(made.observations),
            "images": [{"name": i.name, "targets": len(found[i.name][0]) if i.name in found else 0, "why": failed.get(i.name, "")}
                       for i in block.images]}


def _measured(photo: np.ndarray, kind: str, board: tuple[int, int] | None) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names, pixels (n, 2) and sigma (n,) px of the targets of a photo that have names of their own."""
    if kind == "chessboard":
        if board is None:
            raise BadProject("how many inner corners has the chessboard? give --board COLUMNSxROWS, such as 9x6")
        pixel = find_chessboard(photo, board)
        return board_points(board, 1.0)[0], pixel, np.full(len(pixel), CHESS_SIGMA)
    if kind != "dot":
        raise BadProject("only dots of a sheet with coded corners, and chessboards, have names that photos share; take --kind "
                         "dot or chessboard")
    targets = number_targets(photo, find_targets(photo, "dot"))
    rows = np.flatnonzero(targets.label != "")
    sigma = np.maximum(np.sqrt((targets.sigma[rows] ** 2).mean(axis=1)), LEAST_SIGMA)
    return tuple(map(str, targets.label[rows])), targets.pixel[rows], sigma


def _block(block: Block, found: dict[str, tuple[tuple[str, ...], np.ndarray, np.ndarray]], board: tuple[int, int] | None,
           square: float) -> Block:
    names = tuple(dict.fromkeys(n for of, _, _ in found.values() for n in of))
    index = {n: j for j, n in enumerate(names)}
    xyz = np.full((len(names), 3), np.nan)
    if board is not None:
        known = dict(zip(*board_points(board, square), strict=True))
    else:
        cells = {n: tuple(map(int, n.split("-"))) for n in names}
        low, high = np.min(list(cells.values()), axis=0), np.max(list(cells.values()), axis=0)
        known = {n: np.array([c * square, -r * square, 0.0]) for n, (r, c) in cells.items()
                 if r in (low[0], high[0]) and c in (low[1], high[1])}
        if len(known) < 4:
            raise DegenerateGeometry("the four outermost targets of the sheet, which hold it, are not all seen; photograph "
                                     "all of it")
    for n, at in known.items():
        xyz[index[n]] = at
    role = tuple("control" if n in known else "tie" for n in names)
    sigma = np.where(np.isfinite(xyz), CORNER * square if board is None else 0.0, np.nan)
    rows = [(block.image_index(i), index[n], at, s) for i, (of, pixels, sigmas) in found.items()
            for n, at, s in zip(of, pixels, sigmas, strict=True)]
    observations = Observations(np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), np.array([r[2] for r in rows]),
                                np.array([r[3] for r in rows]))
    return replace(block, points=Points(names, xyz, sigma, role), observations=observations)


__all__ = ["targets_of_project"]
