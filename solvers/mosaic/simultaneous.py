"""All photos at once: staged from similarities over affinities to plane coefficients or exterior orientations, damped, robust.

Every stage is one run of the engine; its rows, as homographies, join one trace. Reference: docs/formulas.md 6.3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..adjustment import Iteration, Options, Trace, iterate
from ..cameras import Interior
from ..errors import DegenerateGeometry
from ..geometry import Exterior
from .models import Coefficients, Exteriors, Model, exterior_rows, through
from .network import Network
from .plane import orientation_of
from .problem import PhotoPriors, Registering
from .registration import plane_warp

STAGE = Options(max_iterations=30, max_trials=16, damping=1e-3, step_tolerance=1e-2, cost_tolerance=1e-4)
FINAL = Options(max_iterations=120, max_trials=20, damping=1e-4, step_tolerance=1e-4, cost_tolerance=1e-10)
ROBUST = Options(max_iterations=150, max_trials=20, damping=1e-4, step_tolerance=1e-2, cost_tolerance=1e-5)
"""Reweighting converges in a straight line, not at once."""
PATIENT = replace(ROBUST, max_iterations=800)
"""Plane coefficients alone hardly hold a large block: it goes down a long, curved valley (160 photos: 130 rows)."""
RAYLEIGH = 1.17741
"""Median length of a residual in two coordinates of unit standard deviation."""


@dataclass(frozen=True)
class Found:
    """What a stage left: its problem, the last x, and all rows so far as (stage, Iteration with x = homographies (9 m))."""

    problem: Registering
    x: np.ndarray
    rows: tuple[tuple[str, Iteration], ...]

    @property
    def photos(self) -> np.ndarray:
        return self.problem.split(self.x)[0]

    @property
    def xy(self) -> np.ndarray:
        return self.problem.split(self.x)[1]

    @property
    def warps(self) -> np.ndarray:
        """(m, 3, 3) plane X, Y, 1 -> ideal photo coordinates over c."""
        return homographies(self.problem.model, self.photos)


def homographies(model: Model, photos: np.ndarray) -> np.ndarray:
    """(m, 3, 3) plane -> ideal photo coordinates over c of photos as a model stores them, of unit length."""
    if isinstance(model, Exteriors):
        z0, zx, zy = model.plane
        onto = np.zeros((len(photos), 3, 3))
        onto[:, 0, 0] = onto[:, 1, 1] = 1.0
        onto[:, 2, 0], onto[:, 2, 1] = zx, zy
        onto[:, :, 2] = np.array([0, 0, z0]) - photos[:, :3]
        h = np.diag([1.0, 1.0, -1.0]) @ photos[:, 3:].reshape(-1, 3, 3) @ onto
    else:
        h = photos.reshape(-1, 3, 3)
    return h / np.linalg.norm(h, axis=(1, 2))[:, None, None]


def run(problem: Registering, x: np.ndarray, stage: str, before: Found | None = None, options: Options | None = None) -> Found:
    """One stage. Raises DegenerateGeometry where it cannot begin."""
    rows, last = list(before.rows) if before else [], None
    for last in iterate(problem, x, options or (ROBUST if problem.network.loss else FINAL)):
        rows.append((stage, replace(last, x=homographies(problem.model, problem.split(last.x)[0]).ravel())))
    assert last is not None
    if not np.isfinite(last.cost):
        raise DegenerateGeometry("the registration could not begin: a point lies behind a photo")
    return Found(problem, last.x, tuple(rows))


def spread(problem: Registering, x: np.ndarray) -> float:
    """Standard deviation of the image residuals over their sigmas, by the median: what a few wrong matches do not change."""
    net = problem.network
    used = 2 * len(net.image)
    share = max(problem.dof, 1) / used if used else 1.0
    return float(np.median(np.linalg.norm(problem.residuals(x), axis=1))) / RAYLEIGH / np.sqrt(min(max(share, 0.1), 1.0))


def staged(net: Network, h: np.ndarray, xy: np.ndarray, stages: Sequence[str], before: Found | None = None) -> Found:
    """From homographies h (m, 3, 3) and points xy (n, 2) through the stages, one photo or control holding the datum."""
    found, photos = before, h.reshape(len(h), 9)
    for stage in stages:
        problem = Registering(net, Coefficients(stage))
        x = problem.pack(photos, xy)
        if stage != "projective":  # as rough as the stage is: losses that forget far observations would keep what does not close
            rough = replace(net, weight=net.weight / max(1.0, spread(problem, x)), loss="huber" if net.loss else None)
            found = run(Registering(rough, Coefficients(stage)), x, stage, found, STAGE)
        else:
            found = run(problem, x, stage, found, PATIENT if net.loss else None)
        photos, xy = found.photos, found.xy
    assert found is not None
    return found


def upright(h: np.ndarray, plane: float = 0.0) -> np.ndarray:
    """(m, 12) vertical photos of the scale, place and azimuth of homographies h (m, 3, 3) at their middle."""
    out = []
    for g in h:
        centre = through(np.linalg.inv(g)[None], np.zeros((1, 2)))[0]
        centre = centre if np.isfinite(centre).all() else np.zeros((1, 2))
        p = g[:, :2] @ centre[0] + g[:, 2]
        j = (g[:2, :2] - (p[:2] / p[2])[:, None] * g[2, :2]) / p[2]
        scale = np.sqrt(abs(np.linalg.det(j)))
        kappa = np.arctan2(j[0, 1] - j[1, 0], j[0, 0] + j[1, 1])
        m = np.array([[np.cos(kappa), np.sin(kappa), 0], [-np.sin(kappa), np.cos(kappa), 0], [0, 0, 1]])
        out.append(Exterior(m, np.array([*centre[0], plane + 1 / scale])).vector)
    return np.array(out)


def tilted(h: np.ndarray, plane: tuple[float, float, float]) -> np.ndarray:
    """(m, 12) exterior orientations of homographies h (m, 3, 3), plane -> ideal photo coordinates over c."""
    unit = Interior(1.0, pixel_mm=1.0, width=1, height=1)
    turn = plane_warp(unit, Exterior(np.eye(3), np.zeros(3)), np.array([1.0, 0, 0]))  # over c, as its pixels
    return exterior_rows([orientation_of(turn @ g, unit, np.array(plane)).exterior for g in h])


def oriented(net: Network, starts: Sequence[np.ndarray], xy: np.ndarray, plane: tuple[float, float, float] = (0.0, 0.0, 0.0),
             priors: PhotoPriors | None = None, before: Found | None = None) -> Found:
    """Exterior orientations from the best of several starts (m, 12)."""
    best: Found | None = None
    for start in starts:
        problem = Registering(net, Exteriors(plane), priors or PhotoPriors.none())
        x = problem.pack(start, _on_plane(problem, start, xy))
        if not np.isfinite(problem.cost(x)):
            continue
        found = run(problem, x, "exterior", before)
        best = found if best is None or found.rows[-1][1].cost < 0.999 * best.rows[-1][1].cost else best
    if best is None:
        raise DegenerateGeometry("no exterior orientation could begin: points lie behind a photo")
    return best


def _on_plane(problem: Registering, photos: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(n, 2) mean places of the points by the photos themselves; `xy` where a photo cannot say."""
    net = problem.network
    h = np.linalg.inv(homographies(problem.model, photos))
    p, _ = through(h[net.image], net.q)
    ok = np.isfinite(p[:, 0])
    count = np.bincount(net.point[ok], minlength=len(xy))
    mean = np.stack([np.bincount(net.point[ok], p[ok, k], len(xy)) for k in (0, 1)], axis=1)
    known = net.weight_xy[:, :1] > 0
    return np.where(known, net.known, np.where(count[:, None] > 0, mean / np.maximum(count, 1)[:, None], xy))


def trace_of(found: Sequence[tuple[str, Iteration]], manifest: dict[str, Any]) -> Trace:
    """One trace of all rows, numbered through; the manifest says which rows belong to which stage."""
    stages: list[dict[str, Any]] = []
    rows = []
    for k, (stage, row) in enumerate(found):
        if not stages or stages[-1]["stage"] != stage:
            stages.append({"stage": stage, "first": k, "last": k})
        stages[-1]["last"] = k
        rows.append(replace(row, index=k, stop=row.stop if k == len(found) - 1 else None))
    return Trace(tuple(rows), {**manifest, "stages": stages})
