"""What a block offers a registration: photos that hang together, their observations in ideal coordinates, control, positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..block import Block, Observations, Prior
from ..cameras import Interior
from ..errors import BadProject, DegenerateGeometry
from ..geometry import Exterior, LocalFrame
from .network import Network, normalized
from .registration import Level

LEAST = 6
"""Observations of shared points that a photo needs."""


@dataclass(frozen=True)
class Data:
    """m photos and o observations of n points (all points of the block).

    names, interiors: of the photos. image, point (o,), pixels (o, 2), sigma (o,). xyz, sigma_xyz (n, 3): control, local, NaN for
    other points. gps, gps_sigma (m, 3): onboard positions, local, NaN without. frame: of xyz and gps. reference: the photo
    that lies on the plane. unused: photos without a place, why. said: what to know.
    """

    block: Block
    level: Level
    names: tuple[str, ...]
    interiors: tuple[Interior, ...]
    image: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    sigma: np.ndarray
    xyz: np.ndarray
    sigma_xyz: np.ndarray
    gps: np.ndarray
    gps_sigma: np.ndarray
    frame: LocalFrame
    reference: int
    unused: Mapping[str, str]
    said: tuple[str, ...]

    @property
    def points(self) -> tuple[str, ...]:
        return self.block.points.names

    @cached_property
    def q(self) -> np.ndarray:
        """(o, 2) ideal photo coordinates over c."""
        return normalized(self.interiors, self.image, self.pixels)[0]

    @cached_property
    def scale(self) -> np.ndarray:
        """(m,) principal distances [px]."""
        return np.array([i.c / float(i.pitch.mean()) for i in self.interiors])

    @cached_property
    def corners(self) -> np.ndarray:
        """(m, 4, 2) the photos' outer corners, ideal, over c."""
        return np.array([i.ideal(np.array([[0, 0], [i.width, 0], [i.width, i.height], [0, i.height]]) - 0.5) / i.c
                         for i in self.interiors])

    @cached_property
    def half(self) -> np.ndarray:
        """(m, 2) half formats over c."""
        return np.array([np.array([i.width, i.height]) / 2 * i.pitch / i.c for i in self.interiors])

    @cached_property
    def whole(self) -> dict[int, Prior]:
        """Priors of photos, by number, that are orientations with their whole covariance (image corners as control)."""
        priors = ((k, self.block.images[self.block.image_index(n)].prior) for k, n in enumerate(self.names))
        return {k: p for k, p in priors if p is not None and p.covariance is not None and p.angles is not None
                and p.centre is not None} if self.level != "uncontrolled" else {}

    @cached_property
    def sigma_px(self) -> float:
        return float(np.median(self.sigma))

    @cached_property
    def controls(self) -> np.ndarray:
        """Control points that are seen."""
        seen = np.bincount(self.point, minlength=len(self.xyz)) > 0
        return np.flatnonzero(seen & np.isfinite(self.xyz).all(axis=1))

    def network(self, loss: str | None, held: bool = False, control: bool = False, height: float = 0.0) -> Network:
        """held: the reference photo stays. control: control points join, weighted, at their heights over the plane."""
        known, sigma, lift = None, None, None
        if control and len(self.controls):
            known, sigma = self.xyz[:, :2].copy(), self.sigma_xyz[:, :2]
            lift = np.where(np.isfinite(self.xyz[:, 2]), self.xyz[:, 2] - height, 0.0)
        rays = np.bincount(self.point, minlength=len(self.xyz))
        keep = (rays >= 2) | ((rays >= 1) & (np.isfinite(self.xyz).all(axis=1) if control else False))
        rows = keep[self.point]
        net = Network.of(self.names, self.interiors, self.image[rows], self.point[rows], self.pixels[rows], self.sigma[rows],
                         known=np.full((len(self.xyz), 2), np.nan) if known is None else known,
                         sigma_xy=np.full((len(self.xyz), 2), 1.0) if sigma is None else sigma, lift=lift,
                         held=(self.reference,) if held else (), loss=loss)
        return net

    def keeping(self, photos: np.ndarray) -> Data:
        """The same with some of the photos; the reference photo must be among them."""
        renumber = np.full(len(self.names), -1)
        renumber[photos] = np.arange(len(photos))
        rows = renumber[self.image] >= 0
        return replace(self, names=tuple(self.names[k] for k in photos), interiors=tuple(self.interiors[k] for k in photos),
                       image=renumber[self.image[rows]], point=self.point[rows], pixels=self.pixels[rows], sigma=self.sigma[rows],
                       gps=self.gps[photos], gps_sigma=self.gps_sigma[photos], reference=int(renumber[self.reference]))

    def without(self, image: np.ndarray, point: np.ndarray, said: Sequence[str]) -> Data:
        """The same without some marks: of photos image (k,) of points (k,)."""
        gone, n = image * len(self.xyz) + point, len(self.xyz)
        rows = ~np.isin(self.image * n + self.point, gone)
        of, own = self.block.observations, {name: k for k, name in enumerate(self.names)}
        photo = np.array([own.get(i.name, -1) for i in self.block.images])[of.image]
        stay = (photo < 0) | ~np.isin(photo * n + of.point, gone)
        seen = Observations(of.image[stay], of.point[stay], of.pixel[stay], of.sigma[stay])
        return replace(self, block=replace(self.block, observations=seen), image=self.image[rows], point=self.point[rows],
                       pixels=self.pixels[rows], sigma=self.sigma[rows], said=(*self.said, *said))

    def with_interiors(self, cameras: Mapping[str, Interior]) -> Data:
        """The same with other cameras by name."""
        of = {i.name: i.camera for i in self.block.images}
        return replace(self, interiors=tuple(cameras.get(of[n], i) for n, i in zip(self.names, self.interiors, strict=True)))

    def manifest(self, method: str, model: str) -> dict[str, Any]:
        """JSON-able description of the trace."""
        return {"problem": "registration", "method": method, "model": model, "level": self.level, "images": list(self.names),
                "layout": {"photos": "h11 .. h33 of every image: mosaic plane X, Y, 1 -> ideal photo coordinates over c (x "
                                     "right, y up), of unit length; NaN while not registered"},
                "corners": self.corners.tolist(), "reference": self.names[self.reference], "crs": self.block.crs,
                "origin": [float(v) for v in self.frame.origin]}


def data_of(block: Block, level: Level | None, reference: str | None) -> Data:
    """Raises BadProject for a level that the block cannot have, DegenerateGeometry where no two photos share points."""
    of = block.observations
    roles = np.array(block.points.role, dtype=str)
    xyz = np.where((roles == "control")[:, None], block.points.xyz, np.nan)
    seen = np.isin(np.arange(len(roles)), of.point)
    control = np.flatnonzero(np.isfinite(xyz).all(axis=1) & seen)
    known = [None if i.prior is None else i.prior.centre for i in block.images]
    positions = np.array([np.full(3, np.nan) if p is None else p for p in known], float).reshape(-1, 3)
    level = _level(block, level, xyz[control], positions)
    if level == "uncontrolled":
        xyz, positions, control = np.full_like(xyz, np.nan), np.full_like(positions, np.nan), control[:0]
    frame = _frame(block, level, positions)
    rows = np.flatnonzero(np.isfinite(of.pixel).all(axis=1) & (roles[of.point] != "check"))
    keep, unused, said = _connected(block, rows, level)
    renumber = np.full(len(block.images), -1)
    renumber[keep] = np.arange(len(keep))
    rows = rows[renumber[of.image[rows]] >= 0]
    image, point = renumber[of.image[rows]], np.asarray(of.point)[rows].astype(int)
    ok = np.isfinite(xyz).all(axis=1)
    xyz[ok] = frame.to_local(xyz[ok])
    sigma = np.where(np.isfinite(block.points.sigma), block.points.sigma, block.control_m)
    gps = positions[keep]
    has = np.isfinite(gps).all(axis=1)
    if has.any():
        gps[has] = frame.to_local(gps[has])
    stated = (block.images[k].prior for k in keep)
    gps_sigma = np.array([_gps_sigma(p) for p in stated], float)
    names = tuple(block.images[k].name for k in keep)
    data = Data(block, level, names, tuple(block.cameras[block.images[k].camera] for k in keep), image, point, of.pixel[rows],
                np.where(np.isfinite(of.sigma[rows]), of.sigma[rows], block.image_px), xyz, np.maximum(sigma, 1e-4), gps,
                gps_sigma, frame, 0, unused, tuple(said))
    return replace(data, reference=_reference(data, reference))


def _gps_sigma(prior: Prior | None) -> np.ndarray:
    """(3,) m of an onboard position, 5 m and 10 m in height where nothing is stated."""
    if prior is not None and prior.covariance is not None:
        return np.sqrt(np.diag(prior.covariance)[:3])
    return np.array([5.0, 5.0, 10.0]) if prior is None or prior.sigma_m is None else np.asarray(prior.sigma_m, float)


def _level(block: Block, level: Level | None, control: np.ndarray, positions: np.ndarray) -> Level:
    """The level asked for, or the best that the data allow."""
    places = int(np.isfinite(positions).all(axis=1).sum())
    wide = len(control) >= 3 and np.linalg.svd(control - control.mean(axis=0), compute_uv=False)[1] > 1e-3
    if level is None:
        return "controlled" if wide else "semicontrolled" if places >= 2 or len(control) >= 2 else "uncontrolled"
    if level == "controlled" and not wide:
        why = f"{len(control)} control points are seen in photos" if len(control) < 3 else "its control points lie on one line"
        raise BadProject(f"{block.name}: a controlled mosaic needs three control points that are not on one line, and "
                         f"{why}; measure more, or take --kind semicontrolled")
    if level == "semicontrolled" and places < 2 and len(control) < 2:
        raise BadProject(f"{block.name}: a semi-controlled mosaic needs the positions of two photos or two control points, "
                         f"and there are {places} and {len(control)}; give priors or control, or take --kind uncontrolled")
    return level


def _frame(block: Block, level: Level, positions: np.ndarray) -> LocalFrame:
    if level == "uncontrolled":
        return LocalFrame(np.zeros(3), "local")
    known = block.points.xyz
    if not np.isfinite(known).all(axis=1).any():
        known = positions
    return LocalFrame.around(known, block.crs, block.frame)


def _connected(block: Block, rows: np.ndarray, level: Level) -> tuple[np.ndarray, dict[str, str], list[str]]:
    """Photos of the largest group that hangs together by shared points, and why others are not used."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    of, m = block.observations, len(block.images)
    rays = np.bincount(of.point[rows], minlength=len(block.points))
    rows = rows[rays[of.point[rows]] >= 2]
    seen = csr_matrix((np.ones(len(rows)), (of.image[rows], of.point[rows])), shape=(m, len(block.points)))
    shared = (seen @ seen.T).toarray()
    np.fill_diagonal(shared, 0)
    count, label = connected_components(csr_matrix(shared >= LEAST), directed=False)
    while True:  # a photo may share a few points with each of several others
        row, column = np.unique(np.stack([label[of.image[rows]], of.point[rows]]), axis=1)
        of_group = csr_matrix((np.ones(len(row)), (row, column)), shape=(count, len(block.points)))
        common = (of_group @ of_group.T).toarray()
        np.fill_diagonal(common, 0)
        fewer, joined = connected_components(csr_matrix(common >= LEAST), directed=False)
        if fewer == count:
            break
        count, label = fewer, joined[label]
    groups = sorted((np.flatnonzero(label == k) for k in range(count)), key=lambda g: -len(g))
    if not groups or len(groups[0]) < 2:
        raise DegenerateGeometry(f"{block.name}: no two of its {m} photos share {LEAST} tie points; give photos that overlap, or "
                                 "find tie points first (collinea tiepoints)")
    unused: dict[str, str] = {}
    said: list[str] = []
    for g in groups[1:]:
        names = [block.images[k].name for k in g]
        if len(g) == 1:
            most = int(common[label[g[0]]].max(initial=0))
            unused[names[0]] = (f"it shares {most or 'no'} tie point{'s' * (most != 1)} with the others"
                                if most < LEAST else "it hangs on no other photo")
            continue
        listed = ", ".join(names[:4]) + (" ..." if len(names) > 4 else "")
        said.append(f"the photos fall into separate groups: {len(g)} photos ({listed}) share no tie points with the other "
                    f"{len(groups[0])}; mosaic them alone, or add photos between")
        unused |= dict.fromkeys(names, f"it belongs to a separate group of {len(g)} photos without tie points to the others")
    return groups[0], unused, said


def _reference(data: Data, name: str | None) -> int:
    """The photo asked for; the one of least tilt where all angles are known; else the one that shares most points."""
    if name is not None:
        if name not in data.names:
            data.block.image_index(name)
            raise BadProject(f"{data.block.name}: the reference photo '{name}' does not overlap the others; choose another")
        return data.names.index(name)
    priors = [data.block.images[data.block.image_index(n)].prior for n in data.names]
    angles = [p.angles for p in priors if p is not None and p.angles is not None]
    if len(angles) == len(priors) and data.level == "uncontrolled":
        return int(np.argmin([np.arccos(Exterior.from_angles(a[0], a[1], a[2], np.zeros(3)).m[2, 2]) for a in angles]))
    rays = np.bincount(data.point, minlength=len(data.xyz))
    return int(np.argmax(np.bincount(data.image[rays[data.point] >= 2], minlength=len(data.names))))
