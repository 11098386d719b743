"""Numbering the dots of a calibration sheet from its four coded corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import DegenerateGeometry
from .patches import gray
from .targets import Targets

CORNERS = {4: (1, 1), 3: (1, 8), 2: (8, 1), 1: (8, 8)}
"""Sectors of the code ring -> row, column of the coded dot in the sheet's 10 x 10 grid."""

_RING = np.linspace(3.1, 3.9, 9)  # dot radii, the middle of the code ring


def number_targets(image: np.ndarray, targets: Targets) -> Targets:
    """The targets with labels "row-column" of the grid ("0-0" top left; coded dots too); "" for dots off the grid.

    Raises DegenerateGeometry unless each of the four codes is seen once.
    """
    sectors = code_sectors(image, targets)
    found = {n: np.flatnonzero(sectors == n) for n in CORNERS}
    wrong = [f"{n} sectors: {len(i)}" for n, i in found.items() if len(i) != 1]
    if wrong:
        raise DegenerateGeometry(f"the dots cannot be numbered, coded corners seen ({', '.join(wrong)}): each must be seen once")
    corner = [int(i[0]) for i in found.values()]
    cells = np.zeros((len(targets), 2))
    known, place = np.array(corner), np.array(list(CORNERS.values()), float)
    for _ in range(3):
        matrix = _homography(targets.pixel[known], place)
        homogeneous = np.column_stack([targets.pixel, np.ones(len(targets))]) @ matrix.T
        cells = homogeneous[:, :2] / homogeneous[:, 2:]
        known = np.flatnonzero(np.abs(cells - np.round(cells)).max(1) < 0.25)
        place = np.round(cells[known])
    label = np.array([""] * len(targets), dtype="<U16")
    for i in known:
        row, col = np.round(cells[i]).astype(int)
        label[i] = f"{row}-{col}" if 0 <= row < 10 and 0 <= col < 10 else ""
    names, counts = np.unique(label[label != ""], return_counts=True)
    label[np.isin(label, names[counts > 1])] = ""
    return replace(targets, label=label)


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
