"""Numbering the dots of a calibration sheet from its four coded corners."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from ..errors import DegenerateGeometry
from .patches import gray
from .targets import Targets

CORNERS = {4: (1, 1), 3: (1, 8), 2: (8, 1), 1: (8, 8)}
"""Sectors of the code ring -> row, column of the coded dot in the sheet's 10 x 10 grid."""

_RING = np.linspace(3.1, 3.9, 9)  # dot radii, the middle of the code ring


def number_targets(image: np.ndarray, targets: Targets) -> Targets:
    """The targets with labels "row-column" of the grid ("0-0" top left; coded dots too); "" for dots off the grid.

    A code that is seen more than once (a shadow can look like one) is where most dots then come to lie on the grid.
    Raises DegenerateGeometry where one of the four codes is not seen, or none of the choices puts the dots on a grid.
    """
    sectors = code_sectors(image, targets)
    found = {n: np.flatnonzero(sectors == n)[:6] for n in CORNERS}
    missing = [f"{n} sectors" for n, i in found.items() if not len(i)]
    if missing:
        raise DegenerateGeometry(f"the dots cannot be numbered, coded corners not seen: {', '.join(missing)}; take a photo that "
                                 "shows all four")
    choices = [c for c in product(*(map(int, i) for i in found.values())) if len(set(c)) == len(c)]
    cells = max((_cells(targets, list(corner)) for corner in choices), key=_on_grid, default=None)
    if cells is None or _on_grid(cells) < max(8, 0.5 * len(targets)):
        raise DegenerateGeometry("the dots cannot be numbered: the coded corners do not put them on a grid; take a sharper photo")
    known = np.flatnonzero(np.abs(cells - np.round(cells)).max(1) < 0.25)
    label = np.array([""] * len(targets), dtype="<U16")
    for i in known:
        row, col = np.round(cells[i]).astype(int)
        label[i] = f"{row}-{col}" if 0 <= row < 10 and 0 <= col < 10 else ""
    names, counts = np.unique(label[label != ""], return_counts=True)
    label[np.isin(label, names[counts > 1])] = ""
    return replace(targets, label=label)


def _cells(targets: Targets, corner: list[int]) -> np.ndarray:
    """(N, 2) row, column of the targets when these are the coded corners, in the order of `CORNERS`; NaN where they cannot be."""
    known, place = np.array(corner), np.array(list(CORNERS.values()), float)
    cells = np.full((len(targets), 2), np.nan)
    for _ in range(3):
        try:
            matrix = _homography(targets.pixel[known], place)
        except DegenerateGeometry:
            return np.full((len(targets), 2), np.nan)
        homogeneous = np.column_stack([targets.pixel, np.ones(len(targets))]) @ matrix.T
        cells = homogeneous[:, :2] / homogeneous[:, 2:]
        known = np.flatnonzero(np.abs(cells - np.round(cells)).max(1) < 0.25)
        if len(known) < 4:
            break
        place = np.round(cells[known])
    return cells


def _on_grid(cells: np.ndarray) -> int:
    """How many cells of the grid one target alone lies on."""
    near = cells[np.abs(cells - np.round(cells)).max(1) < 0.25]
    near = np.round(near[((near > -0.5) & (near < 9.5)).all(1)]).astype(int)
    _, counts = np.unique(near, axis=0, return_counts=True)
    return int((counts == 1).sum())


def code_sectors(image: np.ndarray, targets: Targets, rays: int = 360) -> np.ndarray:
    """(N,) dark sectors of the code ring around each dot, 0 where there is no code."""
    import cv2

    grey = gray(image)
    turn = 2 * np.pi * np.arange(rays) / rays
    counts = np.zeros(len(targets), int)
    for i, (centre, axes, angle, contrast) in enumerate(
        zip(targets.pixel, targets.axes, targets.angle, targets.contrast, strict=True)
    ):
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        unit = axes[0] * np.cos(turn)[:, None] * along + axes[1] * np.sin(turn)[:, None] * across
        at = (centre + _RING[:, None, None] * unit).astype(np.float32)
        ring = cv2.remap(grey, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).mean(0)
        level = np.percentile(ring, 98) if contrast < 0 else np.percentile(ring, 2)
        coded = (ring - level) / contrast > 0.5
        edges = np.flatnonzero(coded & ~np.roll(coded, 1))
        if len(edges) and 0.1 < coded.mean() < 0.9:
            lengths = [int(np.argmin(np.roll(coded, -e))) for e in edges]
            counts[i] = sum(n >= rays // 24 for n in lengths) if min(lengths) >= rays // 60 else 0
    return counts


def _homography(pixel: np.ndarray, cell: np.ndarray) -> np.ndarray:
    """(3, 3) pixels -> grid cells by normalised DLT."""
    import cv2

    matrix, _ = cv2.findHomography(pixel, cell)
    if matrix is None:
        raise DegenerateGeometry("the coded corners lie on one line: the dots cannot be numbered")
    return matrix
