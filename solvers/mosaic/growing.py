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
COARSE = 0.02
"""Distance, over c, within which a point agrees with the similarity of a photo: what a little tilt makes."""
CHANCE = 0.01
"""How often a photo may join whose agreement is none."""
RIVALS, SURE = 3, 0.8
"""Photos of most shared points of which the one with most agreeing ones comes next, unless of the first that many agree."""
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
         xy: np.ndarray | None = None, begun: Sequence[Step] = ()) -> Iterator[Step | Lost]:
    """Steps from a reference photo at h (3, 3), and others that have begun: every photo that hangs together with it by points.

    net: observations with a loss; xy (n, 2), NaN where unknown, is filled in place where given. No stages: the similarity that
    most points agree with is enough (for a start). Of the photos that could come next that one does with which most points
    agree; a point that photos see at different places has all of them until they are told apart, so that one wrong mark does
    not spoil what follows. A photo of whose points no more agree than may do so by chance waits until more of the mosaic is
    there, and is lost in the end; so is one that agrees in less than a fifth (not fewer: where strips meet after a long way
    round, they disagree among themselves).
    """
    mosaic = _Growing(net, None if stages else COARSE)
    left = np.ones(len(net.names), bool)
    tried = np.zeros(len(net.names), int)
    fits: dict[int, tuple[int, Step]] = {}
    for step in (Step(reference, h, 0, 0, "reference", None), *begun):
        left[step.photo] = False
        mosaic.place(step.photo, step.h)
        yield step
    while left.any():
        ready = np.flatnonzero(left & (mosaic.shared >= LEAST["similarity"]) & (mosaic.offered > tried))
        best: Step | None = None
        for k, photo in enumerate(ready[np.argsort(-mosaic.shared[ready], kind="stable")].tolist()):
            if best is not None and best.agreeing > (SURE if k < RIVALS else 0.5) * best.points:
                break
            news, made = fits.get(photo, (-1, None))
            if news < mosaic.offered[photo]:
                made = fit(net, *mosaic.candidates(photo), ())
            if made is None:
                tried[photo] = mosaic.offered[photo]  # again when more points are there
                continue
            fits[photo] = int(mosaic.offered[photo]), made
            best = made._replace(photo=photo) if best is None or made.agreeing > best.agreeing else best
        if best is None:
            break
        if stages:
            best = (fit(net, *mosaic.candidates(best.photo), stages) or best)._replace(photo=best.photo)
        left[best.photo] = False
        mosaic.place(best.photo, best.h)
        yield best
    if xy is not None:
        xy[:] = mosaic.places()
    for photo in np.flatnonzero(left):
        n = int(mosaic.shared[photo])
        yield Lost(int(photo), f"its {n} points do not agree with the rest of the mosaic: it shows another scene or stage, or is "
                   "tilted so much that its horizon is near" if n >= LEAST["similarity"] else
                   f"it shares {n or 'no'} point{'s' * (n != 1)} with the rest of the mosaic")


class _Growing:
    """What is on the mosaic. A place of a point is kept at the observation that said it first: at (o, 2), with the number of
    photos that agree, count (o,). shared (m,): points of each photo that are there; offered (m,): how often that changed."""

    def __init__(self, net: Network, reach: float | None) -> None:
        self.net, self.reach = net, reach
        self.at, self.count = np.full((len(net.image), 2), np.nan), np.zeros(len(net.image))
        self.shared, self.offered = np.zeros(len(net.names), int), np.zeros(len(net.names), int)
        self.there = np.zeros(len(net.known), bool)
        order = np.argsort(net.image, kind="stable")
        self.rows = np.split(order, np.searchsorted(net.image[order], np.arange(1, len(net.names))))

    def _pairs(self, photo: int) -> tuple[np.ndarray, np.ndarray]:
        """Observations (k,) of a photo and places (k,) that their points have."""
        net, mine = self.net, self.rows[photo]
        first, rays = net.start[net.point[mine]], net.rays[net.point[mine]]
        own = np.repeat(mine, rays)
        place = np.repeat(first - np.concatenate([[0], np.cumsum(rays)[:-1]]), rays) + np.arange(len(own))
        ok = self.count[place] > 0
        return own[ok], place[ok]

    def candidates(self, photo: int) -> tuple[np.ndarray, np.ndarray]:
        """Observations (k,) of a photo, once for every place that its point has, and these (k, 2)."""
        own, place = self._pairs(photo)
        return own, self.at[place]

    def place(self, photo: int, h: np.ndarray) -> None:
        """A photo at h: its observations go to the mean of the place they agree with, or say another one."""
        net, mine = self.net, self.rows[photo]
        at = np.full((len(net.image), 2), np.nan)
        at[mine] = through(np.broadcast_to(np.linalg.inv(h), (len(mine), 3, 3)), net.q[mine])[0]
        own, place = self._pairs(photo)
        d = through(np.broadcast_to(h, (len(own), 3, 3)), self.at[place])[0] - net.q[own]
        off = np.linalg.norm(d * net.weight[own], axis=1) / 20 if self.reach is None else np.linalg.norm(d, axis=1) / self.reach
        order = np.lexsort((off, own))
        order = order[np.concatenate([[True], np.diff(own[order]) > 0])[:len(order)]]  # the nearest place of each
        order = order[(off[order] < 1) & np.isfinite(at[own[order], 0])]
        own, place = own[order], place[order]
        self.at[place] += (at[own] - self.at[place]) / (self.count[place] + 1)[:, None]
        self.count[place] += 1
        new = np.setdiff1d(mine[np.isfinite(at[mine, 0])], own)
        self.at[new], self.count[new] = at[new], 1
        changed = np.zeros(len(net.known), bool)
        changed[net.point[mine]] = True
        self.offered += np.bincount(net.image[changed[net.point]], minlength=len(self.offered))
        fresh = np.zeros(len(net.known), bool)
        fresh[net.point[new]] = True
        fresh &= ~self.there
        self.there |= fresh
        self.shared += np.bincount(net.image[fresh[net.point]], minlength=len(self.shared))

    def places(self) -> np.ndarray:
        """(n, 2) of each point the place that most photos agree with, NaN where there is none."""
        out = np.full((len(self.net.known), 2), np.nan)
        order = np.argsort(self.count, kind="stable")
        order = order[self.count[order] > 0]
        out[self.net.point[order]] = self.at[order]
        return out


def grow_groups(net: Network, reference: int, h: np.ndarray, stages: Sequence[str],
                xy: np.ndarray) -> tuple[list[Step], list[Lost]]:
    """As `grow`; where it ends, what is left grows by itself and joins as a whole: each of its photos may share too little with
    the mosaic, all of them together enough. xy (n, 2) is filled in place."""
    begun: list[Step] = []
    while True:
        made = list(grow(net, reference, h, stages, xy, begun))
        steps, lost = [s for s in made if isinstance(s, Step)], [s for s in made if isinstance(s, Lost)]
        group = _group(net, [s.photo for s in lost], stages, xy) if len(steps) > 1 else []
        if not group:
            return steps, lost
        begun = [*steps[1:], *group]


def _group(net: Network, photos: Sequence[int], stages: Sequence[str], xy: np.ndarray) -> list[Step]:
    """The first group of photos, of two and more, that together agree with the points' places xy (n, 2) on the mosaic."""
    left, h = set(photos), np.eye(3)
    while len(left) > 1:
        some = net.keeping(np.isin(net.image, list(left)))
        shared = np.bincount(some.image[some.rays[some.point] >= 2], minlength=len(net.names))
        start, own = int(np.argmax(shared)), np.full_like(xy, np.nan)
        if not shared[start]:
            break
        steps = [s for s in grow(some, start, h, stages, own) if isinstance(s, Step)]
        common = np.flatnonzero(np.isfinite(own[:, 0]) & np.isfinite(xy[:, 0]))
        if len(steps) > 1 and len(common) >= LEAST["similarity"] + 1:
            onto, agree = consensus(xy[common], own[common], 2 * COARSE)
            many = int(agree.sum())
            if many > LEAST["similarity"] and (many == len(common) or chance(len(common), many, _share(own[common])) < CHANCE):
                return [s._replace(h=s.h @ onto, points=len(common), agreeing=many) if s.photo == start else
                        s._replace(h=s.h @ onto) for s in steps]
        left -= {s.photo for s in steps}
    return []


def _share(q: np.ndarray) -> float:
    """What part of the ground of points q (k, 2), over c, a place is within which points agree; twice that, to be safe."""
    return min(0.05, 2 * np.pi * COARSE**2 / max(float(np.prod(np.ptp(q, axis=0))), 1e-12))


def chance(points: int, agreeing: int, share: float = 0.01) -> float:
    """How often so many of some points agree with a similarity through two of them by chance, were all of them wrong and spread
    over a ground of which a place takes `share`.

    Reference: Moisan, Moulon & Monasse 2012 (a contrario RANSAC).
    """
    from scipy.stats import binom

    return points * (points - 1) / 2 * float(binom.sf(agreeing - 3, points - 2, share))


def fit(net: Network, rows: np.ndarray, xy: np.ndarray, stages: Sequence[str]) -> Step | None:
    """One photo onto known points xy (k, 2) by its observations `rows`; None where too few of them agree."""
    start, agree = consensus(xy, net.q[rows], COARSE)
    points = len(np.unique(rows))
    if agree.sum() < 0.6 * points and points >= OBLIQUE:
        start, agree = _oblique(xy, net.q[rows], start, agree)
    many = len(np.unique(rows[agree]))
    if many < max(LEAST["similarity"], points // 5) or (many < points and chance(points, many, _share(net.q)) > CHANCE):
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
    return Step(0, h, points, len(np.unique(rows[use])), last, trace)


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


__all__ = ["Lost", "Model", "Step", "bounding_box", "chance", "consensus", "fit", "grow", "grow_groups"]
