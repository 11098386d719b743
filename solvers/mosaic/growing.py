"""Photo after photo onto the growing mosaic: the sequential registration, and the rough start of the simultaneous one.

The reference photo lies on the mosaic plane; the photo that shares most points with what is already there comes next, is fitted
to the points' places; a point lies at the mean of the photos that show it so far. What is placed stays: errors add up
(docs/formulas.md 6.4).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..adjustment import Options, Trace, solve
from .models import Coefficients, Model, through
from .network import Network
from .problem import Registering

LEAST = {"similarity": 3, "affine": 5, "projective": 6}
"""Points from which on a stage is tried for one photo: more than it needs."""
OBLIQUE = 20
"""Points from which on a photo that no similarity explains is tried as one that is tilted far."""
GENTLE = Options(max_iterations=30, step_tolerance=1e-4, cost_tolerance=1e-10)


class Step(NamedTuple):
    """One photo joined the mosaic: its index, its H (3, 3), points it was fitted to, how many of them agree, the last stage, and
    the adjustment that did it (None for the reference photo)."""

    photo: int
    h: np.ndarray
    points: int
    agreeing: int
    stage: str
    trace: Trace | None


class Lost(NamedTuple):
    """A photo that could not join, and why."""

    photo: int
    why: str


def grow(net: Network, reference: int, h: np.ndarray, stages: Sequence[str] = ("similarity", "affine", "projective"),
         xy: np.ndarray | None = None) -> Iterator[Step | Lost]:
    """Steps from a reference photo at h (3, 3): every photo that hangs together with it by points.

    net: observations with a loss; xy (n, 2), NaN where unknown, is filled in place where given. No stages: the similarity that
    most points agree with is enough (for a start). A photo that agrees with the mosaic in too few of its points is lost (a
    fifth: where strips meet after a long way round, they disagree among themselves).
    """
    xy = np.full((len(net.known), 2), np.nan) if xy is None else xy
    order = np.argsort(net.image, kind="stable")
    ends = np.searchsorted(net.image[order], np.arange(len(net.names) + 1))
    rows = [order[ends[k]:ends[k + 1]] for k in range(len(net.names))]
    shared = np.zeros(len(net.names), int)
    left = np.ones(len(net.names), bool)
    tried = np.zeros(len(net.names), int)

    seen = np.zeros(len(xy))

    def place(photo: int, at: np.ndarray) -> None:
        mine = rows[photo]
        points = net.point[mine]
        p, _ = through(np.broadcast_to(np.linalg.inv(at), (len(mine), 3, 3)), net.q[mine])
        with np.errstate(invalid="ignore"):
            back = through(np.broadcast_to(at, (len(mine), 3, 3)), xy[points])[0]
            close = np.linalg.norm((back - net.q[mine]) * net.weight[mine], axis=1) < 20
        new, ok = ~np.isfinite(xy[points, 0]), np.isfinite(p[:, 0])
        xy[points[new]], seen[points[new & ok]] = p[new], 1
        more = points[~new & close & ok]
        xy[more] += (p[~new & close & ok] - xy[more]) / (seen[more] + 1)[:, None]
        seen[more] += 1
        got = np.zeros(len(xy), bool)
        got[points[new]] = ok[new]
        shared[:] += np.bincount(net.image[got[net.point]], minlength=len(shared))

    left[reference] = False
    place(reference, h)
    yield Step(reference, h, 0, 0, "reference", None)
    while left.any():
        ready = np.flatnonzero(left & (shared >= LEAST["similarity"]) & (shared > tried))
        if not len(ready):
            break
        photo = int(ready[np.argmax(shared[ready])])
        mine = rows[photo]
        mine = mine[np.isfinite(xy[net.point[mine], 0])]
        fitted = fit(net, mine, xy[net.point[mine]], stages)
        if fitted is None:
            tried[photo] = shared[photo]  # again when more points are there
            continue
        left[photo] = False
        place(photo, fitted.h)
        yield fitted._replace(photo=photo)
    for photo in np.flatnonzero(left):
        n = int(shared[photo])
        yield Lost(int(photo), f"its {n} points do not agree with the rest of the mosaic: it shows another scene or stage, or is "
                   "tilted so much that its horizon is near" if n >= LEAST["similarity"] else
                   f"it shares {n or 'no'} point{'s' * (n != 1)} with the rest of the mosaic")


def fit(net: Network, rows: np.ndarray, xy: np.ndarray, stages: Sequence[str]) -> Step | None:
    """One photo onto known points xy (k, 2) by its observations `rows`; None where too few of them agree."""
    start, agree = consensus(xy, net.q[rows], 0.02)
    if agree.mean() < 0.6 and len(rows) >= OBLIQUE:
        start, agree = _oblique(xy, net.q[rows], start, agree)
    if agree.sum() < max(LEAST["similarity"], min(len(rows), max(6, len(rows) // 5))):
        return None
    one = Network(("photo",), np.zeros(len(rows), int), np.arange(len(rows)), net.q[rows], net.weight[rows], xy,
                  np.zeros((len(rows), 2)), np.zeros(len(rows)), np.zeros(1, bool), net.loss)
    use, h, trace, last = agree, start, None, "similarity"
    for stage in stages:
        if use.sum() < LEAST[stage] or not _spread(net.q[rows][use], stage):
            break
        problem = Registering(replace(one.keeping(use), point=np.arange(int(use.sum())), known=xy[use],
                                      weight_xy=np.zeros((int(use.sum()), 2)), lift=np.zeros(int(use.sum()))),
                              Coefficients(stage), fixed_points=True)
        found = solve(problem, problem.pack(h.ravel()[None], xy[use]), GENTLE)
        g = problem.split(found.last.x)[0][0].reshape(3, 3)
        p, w = through(np.broadcast_to(g, (len(xy), 3, 3)), xy)
        if not np.isfinite(found.last.cost) or not np.isfinite(w[use]).all():
            break
        h, trace, last = g, found, stage
        off = np.linalg.norm((net.q[rows] - p) * net.weight[rows], axis=1)
        use = np.nan_to_num(off, nan=np.inf) < max(6.0, 4 * float(np.median(off[use])))
    return Step(0, h, len(rows), int(use.sum()), last, trace)


def _oblique(xy: np.ndarray, q: np.ndarray, start: np.ndarray, agree: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The projective (3, 3) that many more points agree with than with the similarity `start`: a photo tilted far; else that."""
    import cv2

    middle, size = xy.mean(axis=0), max(float(xy.std()), 1e-12)
    h, inside = cv2.findHomography((xy - middle) / size, q, cv2.RANSAC, 0.004, maxIters=5000, confidence=0.9999)
    if h is None or inside.sum() < max(1.5 * agree.sum(), OBLIQUE):
        return start, agree
    h = h @ np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1.0]])
    at = np.column_stack([xy, np.ones(len(xy))]) @ h[2]
    ok = inside.ravel().astype(bool)
    h = h * np.sign(np.median(at[ok]))  # positive in front
    return (h, ok & (at * np.sign(np.median(at[ok])) > 0)) if np.linalg.det(h) > 0 else (start, agree)


def _spread(q: np.ndarray, stage: str) -> bool:
    """Whether points (k, 2) of a photo are wide enough, both ways, for a stage."""
    if stage == "similarity":
        return True
    s = np.linalg.svd(q - q.mean(axis=0), compute_uv=False) / np.sqrt(len(q))
    return bool(s[1] > (0.02 if stage == "affine" else 0.04) * max(s[0], 0.1))


def consensus(xy: np.ndarray, q: np.ndarray, tolerance: float, trials: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """The similarity (3, 3) that most pairs (k, 2) of plane points and photo coordinates agree with within a tolerance (of the
    photo coordinates), and which ones (k,) do."""
    z, w = xy[:, 0] + 1j * xy[:, 1], q[:, 0] + 1j * q[:, 1]
    rng = np.random.default_rng(1960)
    i, j = rng.integers(0, len(z), (2, trials))
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (w[i] - w[j]) / (z[i] - z[j])
    a = np.where(np.isfinite(a) & (np.abs(a) > 0), a, 0)
    few = rng.choice(len(z), min(len(z), 120), replace=False)
    off = np.abs(w[few] - w[i][:, None] - a[:, None] * (z[few] - z[i][:, None]))
    best = int(np.argmin(np.minimum(off, tolerance).sum(axis=1)))
    agree = np.abs(w - w[i[best]] - a[best] * (z - z[i[best]])) < tolerance
    if agree.sum() >= 2:
        design = np.column_stack([z[agree], np.ones(int(agree.sum()))])
        scale, shift = np.linalg.lstsq(design, w[agree], rcond=None)[0]
        agree = np.abs(w - shift - scale * z) < tolerance
    else:
        scale, shift = a[best], w[i[best]] - a[best] * z[i[best]]
    return np.array([[scale.real, -scale.imag, shift.real], [scale.imag, scale.real, shift.imag], [0, 0, 1.0]]), agree


def bounding_box(steps: Sequence[np.ndarray], q: Sequence[np.ndarray]) -> np.ndarray:
    """(4,) xmin, ymin, xmax, ymax on the mosaic of photos at H (3, 3) with corners q (4, 2); corners beyond the horizon are left
    out (docs/formulas.md 6.5)."""
    at = np.concatenate([through(np.broadcast_to(np.linalg.inv(h), (len(c), 3, 3)), c)[0] for h, c in zip(steps, q, strict=True)])
    return np.concatenate([np.nanmin(at, axis=0), np.nanmax(at, axis=0)])


__all__ = ["Lost", "Model", "Step", "bounding_box", "consensus", "fit", "grow"]
