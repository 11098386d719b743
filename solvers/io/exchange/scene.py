"""What a file of another tool says, as one neutral value: cameras, oriented images, points and their measurements."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

import numpy as np

from ...block import Observations, Points
from ...cameras import Interior
from ...cameras.brown import Brown
from ...errors import BadTable
from ...geometry import Exterior
from ..photos import EXTENSIONS

Camera = Interior | Brown
MANY = 20_000_000
"""Most points, marks or images that one file may announce."""


@dataclass(frozen=True)
class Shot:
    """One image: its name, the name of its camera (None: not said), its orientation in the crs of the file, its photo.

    exterior refers to the grid axes of the crs at the camera (east, north, up); of a position alone, m is NaN.
    sigma_m, sigma_rad (3,): standard errors of X, Y, Z and omega, phi, kappa, where stated.
    """

    name: str
    camera: str | None = None
    exterior: Exterior | None = None
    file: str | None = None
    sigma_m: np.ndarray | None = None
    sigma_rad: np.ndarray | None = None

    @property
    def oriented(self) -> bool:
        """Whether position and angles are known."""
        return self.exterior is not None and bool(np.isfinite(self.exterior.m).all())


@dataclass(frozen=True)
class Exchange:
    """Content of a file. kind: the format's name. crs: None where the file does not say, "local" for Cartesian.

    x is east and y north in every crs, whatever order the file had. Pixels count from the centre of the top-left pixel.
    heights: what the file says of their datum. notes: what a person should know.
    """

    kind: str
    path: Path
    crs: str | None = None
    cameras: Mapping[str, Camera] = field(default_factory=dict)
    shots: tuple[Shot, ...] = ()
    points: Points = field(default_factory=lambda: no_points())
    observations: Observations = field(default_factory=lambda: no_observations())
    notes: tuple[str, ...] = ()
    heights: str = "unknown"

    def with_notes(self, *notes: str) -> Exchange:
        """The same with more notes."""
        return replace(self, notes=(*self.notes, *notes))

    @property
    def oriented(self) -> tuple[Shot, ...]:
        """The shots with position and angles."""
        return tuple(s for s in self.shots if s.oriented)

    def summary(self) -> str:
        """One line of what there is."""
        marks = len(self.observations)
        parts = [f"{len(self.cameras)} cameras" if self.cameras else "",
                 f"{len(self.shots)} images ({len(self.oriented)} oriented)" if self.shots else "",
                 f"{len(self.points)} points" if len(self.points) else "", f"{marks} measurements" if marks else ""]
        return ", ".join(p for p in parts if p) or "nothing"


def no_points() -> Points:
    """No points."""
    return Points((), np.empty((0, 3)), np.empty((0, 3)), ())


def no_observations() -> Observations:
    """No measurements."""
    return Observations(np.empty(0, int), np.empty(0, int), np.empty((0, 2)), np.empty(0))


def points_from(path: Path, names: Sequence[str], xyz: Iterable[Any], sigma: Iterable[Any] | None = None,
                role: Sequence[str] | str = "control") -> Points:
    """Points of rows; a role for all or one each. Raises BadTable for a name that is there twice."""
    twice = [n for n, k in Counter(names).items() if k > 1]
    if twice:
        raise BadTable(f"{path}: point '{twice[0]}' is there twice; remove or rename one of them")
    n = len(names)
    at = np.array(list(xyz), float).reshape(n, 3)
    sd = np.full((n, 3), np.nan) if sigma is None else np.array(list(sigma), float).reshape(n, 3)
    return Points(tuple(names), at, np.where(sd > 0, sd, np.nan), (role,) * n if isinstance(role, str) else tuple(role))


def observations_from(rows: Sequence[tuple[int, int, float, float, float]]) -> Observations:
    """Observations of rows: image index, point index, col, row, sigma (NaN: not said); of two of one point in one image the first
    stays."""
    first = {(r[0], r[1]): r for r in reversed(rows)}
    table = np.array(sorted(first.values()), float).reshape(-1, 5)
    return Observations(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2:4].copy(), table[:, 4].copy())


def named(labels: Sequence[str]) -> list[tuple[str, str | None]]:
    """Image name and file of labels that may be file names or paths: without the ending where that is unique."""
    def parts(label: str) -> tuple[str, str, str]:
        pure = PureWindowsPath(label) if "\\" in label else PurePosixPath(label)
        photo = pure.suffix.lower() in EXTENSIONS or pure.suffix.lower() in (".dng", ".arw", ".cr2", ".nef", ".jp2", ".webp")
        return (pure.stem if photo else pure.name), pure.name, "_".join(p for p in pure.parts
                                                                        if p not in ("/", "\\", pure.anchor))

    found = [parts(label.strip()) for label in labels]
    files = [label if f[0] != f[1] or "/" in label or "\\" in label else None for f, label in zip(found, labels, strict=True)]
    for level in range(3):
        names = [f[level] for f in found]
        if len(set(names)) == len(names):
            return list(zip(names, files, strict=True))
    return [(f"{n + 1}_{f[1]}", file) for n, (f, file) in enumerate(zip(found, files, strict=True))]


def label_of(shot: Shot) -> str:
    """How an image is named in another tool's file: its photo's file name where known."""
    if shot.file is None:
        return shot.name
    return (PureWindowsPath(shot.file) if "\\" in shot.file else PurePosixPath(shot.file)).name


def labels_of(shots: Sequence[Shot]) -> list[str]:
    """`label_of` each, the image names where those would not be unique."""
    labels = [label_of(s) for s in shots]
    return labels if len(set(labels)) == len(labels) else [s.name for s in shots]
