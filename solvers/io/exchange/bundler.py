"""Bundler's bundle.out (version 0.3), and problems of bundle adjustment in the large (BAL) to write.

P = R X + t with the camera looking along -z (x right, y up), p = -P / P.z, pixel = f (1 + k1 p^2 + k2 p^4) p from the middle of
the photo, y up. Neither file says the size of the photos or a crs. References: Snavely, Bundler User's Manual;
grail.cs.washington.edu/projects/bal
"""

from __future__ import annotations

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

import numpy as np

from ...cameras.brown import Brown
from ...cameras.foreign import to_brown
from ...errors import BadTable, PhotogrammetryError
from ...geometry import Exterior, log, rotation
from ..files import write_text
from . import exact
from .conventions import CameraAxes, Position, RotationDirection, exterior_from
from .options import NOTHING, Reading
from .scene import MANY, Camera, Exchange, Shot, labels_of, named, observations_from, points_from
from .structure import Line, lines_of

CONVENTION = (CameraAxes.PHOTO, RotationDirection.OBJECT_TO_CAMERA, Position.TRANSLATION)
TERMS = ("k1", "k2")


def looks_like(head: str) -> bool:
    """Whether a text begins as a bundle.out."""
    return head.lstrip().startswith("# Bundle file")


def looks_like_bal(lines: list[str]) -> bool:
    """Whether a text begins as a BAL problem: three whole numbers, then index, index, x, y."""
    cells = [line.split() for line in lines[:2]]
    return len(cells) == 2 and [len(c) for c in cells] == [3, 4] and all(v.isdigit() for v in (*cells[0], *cells[1][:2]))


class _Numbers:
    """The numbers of a text one after the other, with their lines."""

    def __init__(self, lines: list[Line], path: Path) -> None:
        self.lines, self.path, self.row, self.cell = lines, path, 0, 0

    def take(self, count: int) -> np.ndarray:
        return np.array([line.float(cell) for line, cell in self._next(count)])

    def decimals(self, count: int) -> list[Decimal]:
        return [line.decimals(cell, 1)[0] for line, cell in self._next(count)]

    def _next(self, count: int) -> list[tuple[Line, int]]:
        out = []
        for _ in range(count):
            while self.row < len(self.lines) and self.cell >= len(self.lines[self.row].cells):
                self.row, self.cell = self.row + 1, 0
            if self.row >= len(self.lines):
                last = self.lines[-1] if self.lines else Line(self.path, 1, ())
                raise last.error("the file ends here, in the middle of an entry")
            out.append((self.lines[self.row], self.cell))
            self.cell += 1
        return out

    def count(self, most: int = MANY) -> int:
        [value] = self.take(1)
        if value != round(value) or not 0 <= value <= most:
            raise self.lines[self.row].error(f"{value:g} is no number of entries")
        return int(value)

    def error(self, message: str) -> BadTable:
        return self.lines[min(self.row, len(self.lines) - 1)].error(message)


def read(path: Path, options: Reading = NOTHING) -> Exchange:
    """Cameras, orientations, points and measurements; cameras with f = 0 are images that were not oriented. Raises BadTable."""
    data = _Numbers(lines_of(path), path)
    cameras, points = data.count(1_000_000), data.count()
    table = []
    for _ in range(cameras):
        lens, r, t = data.take(3), data.take(9).reshape(3, 3), data.decimals(3)
        table.append((lens, r, t, data.lines[data.row].number))
    xyz, rows = [], []
    for j in range(points):
        xyz.append(data.take(3))
        data.take(3)
        for _ in range(data.count()):
            i, _, x, y = data.take(4)
            if i != round(i) or not 0 <= i < cameras:
                raise data.error(f"a point is seen in camera {i:g}, and there are {cameras}")
            rows.append((int(i), j, x, y, np.nan))
    size = options.size or _enough(np.array([r[2:4] for r in rows]).reshape(-1, 2))
    labels, files = _labels(path, cameras)
    shots, lenses = [], {}
    for n, (lens, r, t, line) in enumerate(table):
        if lens[0] == 0:
            shots.append(Shot(labels[n], None, None, files[n]))
            continue
        try:
            lenses[labels[n]] = _lens(lens, size)
            shots.append(Shot(labels[n], labels[n], exterior_from(r, t, *CONVENTION), files[n]))
        except PhotogrammetryError as error:
            raise BadTable(f"{path} line {line}: camera {n}: {error}") from None
    half = (np.array(size) - 1) / 2
    marks = observations_from([(i, j, half[0] + x, half[1] - y, s) for i, j, x, y, s in rows])
    notes = () if options.size else (f"size of the photos: {size[0]} x {size[1]} px, just enough for the measurements (assumed; "
                                     f"give "
                                     "--size WIDTH,HEIGHT)",)
    return Exchange("Bundler", path, options.crs or "local", _shared(lenses, shots), tuple(shots),
                    points_from(path, [str(j) for j in range(points)], xyz, role="tie"), marks, notes)


def _lens(lens: np.ndarray, size: tuple[int, int]) -> Camera:
    f, k1, k2 = lens
    return Brown(f, f, (size[0] - 1) / 2, (size[1] - 1) / 2, k1=k1, k2=k2, width=size[0], height=size[1])


def _enough(xy: np.ndarray) -> tuple[int, int]:
    """The smallest even size around measurements from the middle."""
    half = np.ceil(np.abs(xy).max(axis=0, initial=0.5)) + 1
    return int(2 * half[0]), int(2 * half[1])


def _labels(path: Path, count: int) -> tuple[list[str], list[str | None]]:
    """Image names of list.txt beside the file, where it has as many; else numbers."""
    lists = [path.parent / "list.txt", path.parent.parent / "list.txt"]
    for file in lists:
        if file.is_file():
            found = named([line.cells[0] for line in lines_of(file)])
            if len(found) == count:
                return [n for n, _ in found], [f for _, f in found]
    return [f"{n:04d}" for n in range(count)], [None] * count


def _shared(lenses: Mapping[str, Camera], shots: list[Shot]) -> dict[str, Camera]:
    """One camera for all images where they agree."""
    kinds = set(lenses.values())
    if len(kinds) != 1:
        return dict(lenses)
    from dataclasses import replace

    shots[:] = [replace(s, camera="camera") if s.camera is not None else s for s in shots]
    return {"camera": kinds.pop()}


def _lenses(scene: Exchange) -> tuple[dict[str, Brown], tuple[str, ...]]:
    """Cameras as f, k1, k2, the principal point in the middle; what that costs, in words."""
    out, notes = {}, []
    for name, camera in scene.cameras.items():
        b, fit = to_brown(camera, TERMS)
        off = np.hypot(b.cx - (b.width - 1) / 2, b.cy - (b.height - 1) / 2)
        if off > 1e-6:
            notes.append(f"camera {name}: this format has its principal point in the middle of the photo, {off:.4g} px from the "
                         f"true one; "
                         "the measurements are moved by that")
        out[name], notes = b, [*notes, *fit.told(name)]
    return out, tuple(notes)


def _middle(b: Brown, pixels: np.ndarray) -> np.ndarray:
    """Pixels (n, 2) from the principal point, y up."""
    return (pixels - [b.cx, b.cy]) * [1, -1]


def write(scene: Exchange, path: Path) -> tuple[str, ...]:
    """bundle.out, and list.txt beside it; returns notes."""
    lenses, notes = _lenses(scene)
    known = [j for j in range(len(scene.points)) if np.isfinite(scene.points.xyz[j]).all()]
    out = ["# Bundle file v0.3", f"{len(scene.shots)} {len(known)}"]
    for shot in scene.shots:
        if not shot.oriented or shot.exterior is None or shot.camera is None:
            out += ["0 0 0"] * 5
            continue
        b = lenses[shot.camera]
        r = shot.exterior.m
        out += [" ".join(repr(float(v)) for v in row) for row in ((b.fy, b.k1, b.k2), *r)]
        out.append(" ".join(map(exact.text, exact.translation(exact.of_matrix(r), shot.exterior.centre))))
    of = scene.observations
    seen: dict[int, list[int]] = {}
    for r, j in enumerate(of.point):
        seen.setdefault(int(j), []).append(r)
    for j in known:
        marks = [r for r in seen.get(j, ()) if scene.shots[of.image[r]].camera is not None]
        cells = [str(len(marks))]
        for r in marks:
            x, y = _middle(lenses[str(scene.shots[of.image[r]].camera)], of.pixel[r])
            cells += [str(of.image[r]), str(r), repr(float(x)), repr(float(y))]
        out += [" ".join(repr(float(v)) for v in scene.points.xyz[j]), "128 128 128", " ".join(cells)]
    write_text(path, "\n".join(out) + "\n")
    write_text(path.parent / "list.txt", "\n".join(labels_of(scene.shots)) + "\n")
    return notes


def write_bal(scene: Exchange, path: Path) -> tuple[str, ...]:
    """A BAL problem: oriented images with their cameras, points with coordinates, and the measurements that join them."""
    lenses, notes = _lenses(scene)
    images = [i for i, s in enumerate(scene.shots) if s.oriented and s.camera is not None]
    of, p = scene.observations, scene.points
    number = {i: n for n, i in enumerate(images)}
    rows = [r for r in range(len(of)) if int(of.image[r]) in number and np.isfinite(p.xyz[of.point[r]]).all()]
    points = sorted({int(of.point[r]) for r in rows})
    place = {j: n for n, j in enumerate(points)}
    if not rows:
        raise BadTable(f"{path}: a BAL problem is made of measurements of points with coordinates in oriented images, and there "
                       f"are none; "
                       "give a project with observations and orientations")
    out = [f"{len(images)} {len(points)} {len(rows)}"]
    for r in rows:
        shot = scene.shots[of.image[r]]
        x, y = _middle(lenses[str(shot.camera)], of.pixel[r])
        out.append(f"{number[int(of.image[r])]} {place[int(of.point[r])]} {float(x)!r} {float(y)!r}")
    for i in images:
        shot = scene.shots[i]
        assert shot.exterior is not None and shot.camera is not None
        vector, b = log(shot.exterior.m), lenses[shot.camera]
        t = exact.translation(exact.of_vector(vector), shot.exterior.centre)
        out += [*(repr(float(v)) for v in vector), *map(exact.text, t), *(repr(float(v)) for v in (b.fy, b.k1, b.k2))]
    out += [repr(float(v)) for j in points for v in p.xyz[j]]
    write_text(path, "\n".join(out) + "\n")
    left = len(scene.shots) - len(images)
    return (*notes, *((f"{left} images without an orientation are left out",) if left else ()))

def read_bal_problem(path: Path, options: Reading = NOTHING) -> Exchange:
    """A BAL problem, a camera an image unless all are alike. Raises BadTable."""
    from ..bal import read_bal

    block = read_bal(path)
    lenses: dict[str, Camera] = {name: to_brown(camera, TERMS)[0] for name, camera in block.cameras.items()}
    shots = [Shot(i.name, i.camera, Exterior(rotation(*i.prior.angles), i.prior.centre)) for i in block.images
             if i.prior is not None and i.prior.angles is not None and i.prior.centre is not None]
    first = block.cameras[block.images[0].camera]
    return Exchange("BAL", path, "local", _shared(lenses, shots), tuple(shots), block.points, block.observations,
                    (f"size of the photos: {first.width} x {first.height} px, just enough for the measurements (assumed)",))
