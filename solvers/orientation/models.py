"""The same control through four models: direct linear transformation, affine, orthogonal and perspective, in one table.

Every image by itself from its control; check points tell what each model is worth, in the image and, where two images
see them, in space. Reference: Ono & Hattori 2002; Abdel-Aziz & Karara 1971.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..adjustment import Linear, precision
from ..block import Block
from ..errors import DegenerateGeometry, PhotogrammetryError
from ..geometry import Exterior, LocalFrame
from .control import Control, control_of
from .linear_models import affine, direct_linear_transformation
from .result import Orientation
from .single import Request, orient

MODELS = ("dlt", "affine", "orthogonal", "perspective")
UNKNOWNS = {"dlt": 11, "affine": 8, "orthogonal": 6, "perspective": 6}
"""Of one image with known interior orientation; the first two find one of their own."""


@dataclass(frozen=True)
class ModelOfImage:
    """An image by a model. sigma0: None without redundancy; redundancy: least and mean number; condition of the scaled normal
    matrix; check_px: rms at `checks` check points, None without; matrix (3, 4): (x, y, -1) ~ P (X, Y, Z, 1) of photo coordinates
    [mm] in the local frame; refused: why there is none."""

    image: str
    model: str
    points: int
    dof: int = 0
    sigma0: float | None = None
    rms_px: float = float("nan")
    redundancy: tuple[float, float] = (float("nan"), float("nan"))
    condition: float = float("nan")
    checks: int = 0
    check_px: float | None = None
    matrix: np.ndarray | None = None
    refused: str = ""

    def to_json(self) -> dict[str, Any]:
        out: dict[str, Any] = {"image": self.image, "model": self.model, "points": self.points, "unknowns": UNKNOWNS[self.model]}
        if self.refused:
            return {**out, "refused": self.refused}
        return {**out, "dof": self.dof, "sigma0": self.sigma0, "rms_px": self.rms_px, "redundancy_least": self.redundancy[0],
                "redundancy_mean": self.redundancy[1], "condition": self.condition, "check_points": self.checks,
                "check_rms_px": self.check_px}


@dataclass(frozen=True)
class ModelInSpace:
    """Check points that a model's images intersect: how many, rms of X, Y, Z (3,) m, None where there are none."""

    model: str
    images: int
    points: int
    rms: np.ndarray | None

    def to_json(self) -> dict[str, Any]:
        return {"model": self.model, "images": self.images, "check_points": self.points,
                "check_rms_m": None if self.rms is None else self.rms.tolist()}


def compare_models(block: Block, images: tuple[str, ...] = ()) -> tuple[list[ModelOfImage], list[ModelInSpace]]:
    """All four models of every image (or of those named), and the check points that each model's images give in space.

    Raises BadProject for an image there is not.
    """
    frame = LocalFrame.around(block.points.xyz, block.crs, block.frame)
    names = images or tuple(i.name for i in block.images)
    found = [made for name in names for made in _images(block, name, frame)]
    return found, [_space(block, model, [f for f in found if f.model == model], frame) for model in MODELS]


def _images(block: Block, name: str, frame: LocalFrame) -> list[ModelOfImage]:
    """An image by all models, weighed alike: by its measurements and its control, as the perspective model sees it."""
    control = control_of(block, name, frame)
    done: dict[str, Orientation | str] = {}
    for model in ("perspective", "orthogonal"):
        try:
            done[model] = orient(block, Request(name, model))
        except PhotogrammetryError as error:
            done[model] = str(error)
    at = done["perspective"]
    out = []
    for model in MODELS:
        try:
            made = _linear(model, control, None if isinstance(at, str) else at.local) if model in ("dlt", "affine") else \
                _central(name, model, control, done[model])
            out.append(_checked(block, made, frame))
        except (PhotogrammetryError, np.linalg.LinAlgError) as error:
            out.append(ModelOfImage(name, model, len(control), refused=str(error)))
    return out


def _central(name: str, model: str, control: Control, o: Orientation | str) -> ModelOfImage:
    """By a model that takes the interior orientation as it is known."""
    if isinstance(o, str):
        raise DegenerateGeometry(o)
    r = o.redundancy[o.used]
    return ModelOfImage(name, model, int(o.used.sum()), o.dof, o.sigma0, o.rms_px, (float(r.min()), float(r.mean())), o.condition,
                        matrix=_matrix(o.local, control.interior.c))


def _linear(model: str, control: Control, at: Exterior | None) -> ModelOfImage:
    """By a model that finds its own interior orientation; photo coordinates are freed of what distortion is known."""
    photo = control.interior.ideal(control.pixels)
    pitch = float(control.interior.pitch.mean())
    sigma = np.sqrt(1 / np.einsum("naa->n", control.weights(at)) * 2) * pitch
    if model == "dlt":
        done = direct_linear_transformation(control.points, photo, sigma)
        stats, dof, p = done.precision, 2 * len(photo) - 11, done.matrix
        q = stats.covariance
        condition = float(np.linalg.cond(q / np.sqrt(np.outer(np.diag(q), np.diag(q)))))
        redundancy, sigma0 = stats.redundancy, stats.sigma0
    else:
        done = affine(control.points, photo, float(sigma.mean()))
        mean = control.points.mean(axis=0)
        j = np.column_stack([control.points - mean, np.ones(len(photo))])
        rows = np.stack([np.hstack([j, np.zeros_like(j)]), np.hstack([np.zeros_like(j), j])], axis=1)
        weights = np.broadcast_to(np.eye(2) / float(sigma.mean()) ** 2, (len(photo), 2, 2))
        stats = precision(Linear(done.residuals, rows, weights), "the affine model")
        q = stats.covariance
        condition = float(np.linalg.cond(q / np.sqrt(np.outer(np.diag(q), np.diag(q)))))
        redundancy, sigma0, dof = stats.redundancy, done.sigma0, 2 * len(photo) - 8
        p = np.vstack([np.column_stack([done.a[:, :3], done.a[:, 3] - done.a[:, :3] @ mean]), [0.0, 0.0, 0.0, -1.0]])
    v = (photo - _seen(p, control.points)) / pitch
    return ModelOfImage(control.image, model, len(photo), dof, sigma0, float(np.sqrt((v**2).sum() / len(v))),
                        (float(redundancy.min()), float(redundancy.mean())), condition, matrix=p)


def _matrix(at: Exterior, c: float) -> np.ndarray:
    """(3, 4) with (x, y, -1) ~ P (X, Y, Z, 1)."""
    return np.diag([c, c, 1.0]) @ np.column_stack([at.m, -at.m @ at.centre])


def _seen(p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n, 2) mm."""
    h = points @ p[:, :3].T + p[:, 3]
    return -h[:, :2] / h[:, 2:]


def _check_rows(block: Block, image: str) -> np.ndarray:
    """Observations of check points with coordinates in an image."""
    of, k = block.observations, block.image_index(image)
    known = np.isfinite(block.points.xyz).all(axis=1) & (np.array(block.points.role) == "check")
    return np.flatnonzero((of.image == k) & known[of.point] & np.isfinite(of.pixel).all(axis=1))


def _checked(block: Block, made: ModelOfImage, frame: LocalFrame) -> ModelOfImage:
    rows = _check_rows(block, made.image)
    if not len(rows) or made.matrix is None:
        return made
    interior = block.camera_of(made.image)
    xyz = frame.to_local(block.points.xyz[block.observations.point[rows]])
    v = (interior.ideal(block.observations.pixel[rows]) - _seen(made.matrix, xyz)) / float(interior.pitch.mean())
    return replace(made, checks=len(rows), check_px=float(np.sqrt((v**2).sum() / len(v))))


def _space(block: Block, model: str, found: list[ModelOfImage], frame: LocalFrame) -> ModelInSpace:
    """Check points met by the rays of two images and more."""
    rays: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    good = [f for f in found if f.matrix is not None]
    for f in good:
        interior = block.camera_of(f.image)
        for k in _check_rows(block, f.image):
            at = interior.ideal(block.observations.pixel[k:k + 1])[0]
            rays.setdefault(int(block.observations.point[k]), []).append((f.matrix, at))  # type: ignore[arg-type]
    off = []
    for j, seen in rays.items():
        if len(seen) > 1:
            try:
                off.append(_met(seen) - frame.to_local(block.points.xyz[j:j + 1])[0])
            except DegenerateGeometry:
                continue
    rms = np.sqrt(np.mean(np.square(off), axis=0)) if off else None
    return ModelInSpace(model, len(good), len(off), rms)


def _met(seen: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(3,) where the rays of all images meet best in their photos. Raises DegenerateGeometry where they are parallel."""
    x = np.zeros(3)
    weight = [1.0] * len(seen)
    for _ in range(4):
        rows, right = [], []
        for w, (p, at) in zip(weight, seen, strict=True):
            a = (p[:2] + at[:, None] * p[2]) * w
            rows.append(a[:, :3])
            right.append(-a[:, 3])
        a, b = np.concatenate(rows), np.concatenate(right)
        s = np.linalg.svd(a, compute_uv=False)
        if s[2] < 1e-9 * s[0]:
            raise DegenerateGeometry("the rays are parallel")
        x = np.linalg.lstsq(a, b, rcond=None)[0]
        weight = [1 / max(abs(float(p[2, :3] @ x + p[2, 3])), 1e-12) for p, _ in seen]
    return x


__all__ = ["MODELS", "ModelInSpace", "ModelOfImage", "compare_models"]
