"""Seam lines: Voronoi by nadir distance, then graph cuts that lead them where overlapping photos agree.

Reference: Kwatra et al. 2003, "Graphcut textures"; Boykov & Kolmogorov 2004.
"""

from __future__ import annotations

import numpy as np

from .gain import overlap
from .labels import NOBODY, Labels, spread
from .survey import Look, Survey

REACH = 40
"""Cells that a seam may move from where Voronoi puts it."""
_EDGE = 0.02  # feather weight below which a photo is shown only if no other is


def voronoi(survey: Survey) -> Labels:
    """Every place shows the photo whose nadir is nearest among those that see it (away from their very edges)."""
    best = np.full(survey.grid.shape, -np.inf)
    number = np.full(survey.grid.shape, NOBODY, np.int16)
    for look in survey.looks:
        t = look.tile
        part = slice(t.top, t.top + t.height), slice(t.left, t.left + t.width)
        col, row = np.meshgrid(t.left + np.arange(t.width), t.top + np.arange(t.height))
        off = survey.grid.to_map(np.stack([col, row], -1)) - survey.feet[look.number]
        near = -(off**2).sum(-1)
        near = np.where(look.edge > _EDGE, near, near - 1e12)
        wins = look.seen & (near > best[part])
        best[part] = np.where(wins, near, best[part])
        number[part] = np.where(wins, look.number, number[part])
    return Labels(survey.grid, survey.factor, spread(number))


def graph_cut(survey: Survey, start: Labels) -> Labels:
    """Seams moved, pair after pair of neighbours, to where the two photos look most alike: around what moved between them and
    along the ground rather than over what rises from it."""
    number = start.number.copy()
    looks = {k.number: k for k in survey.looks}
    for a, b in _neighbours(number):
        if a in looks and b in looks:
            _cut(number, looks[a], looks[b])
    return Labels(start.grid, start.factor, number)


def _neighbours(number: np.ndarray) -> list[tuple[int, int]]:
    """Pairs of labels that touch, the longest common seam first."""
    pairs = [np.stack([x.ravel(), y.ravel()]) for x, y in ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:]))]
    both = np.sort(np.concatenate(pairs, axis=1), axis=0)
    both = both[:, (both[0] != both[1]) & (both[0] != NOBODY)]
    found, count = np.unique(both, axis=1, return_counts=True)
    return [(int(found[0, k]), int(found[1, k])) for k in np.argsort(-count, kind="stable")]


def _cut(number: np.ndarray, a: Look, b: Look) -> None:
    """The seam between two photos, in place."""
    import cv2

    both = overlap(a, b)
    if both is None:
        return
    in_a, in_b = both
    top, left = a.tile.top + in_a[0].start, a.tile.left + in_a[1].start
    shape = a.seen[in_a].shape
    here = number[top:top + shape[0], left:left + shape[1]]
    is_a, is_b = here == a.number, here == b.number
    common = a.seen[in_a] & b.seen[in_b] & (a.edge[in_a] > _EDGE) & (b.edge[in_b] > _EDGE)
    seam = (cv2.dilate(is_a.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & is_b & common
    if seam.sum() < 3:
        return
    near = cv2.distanceTransform((~seam).astype(np.uint8), cv2.DIST_L2, 3) <= REACH
    free = common & near & (is_a | is_b)
    may_a, may_b = is_a | free, is_b | free
    rows, columns = np.flatnonzero(free.any(1)), np.flatnonzero(free.any(0))
    if len(rows) < 3 or len(columns) < 3:
        return
    box = slice(max(rows[0] - 1, 0), rows[-1] + 2), slice(max(columns[0] - 1, 0), columns[-1] + 2)
    fa, fb = (c[box].astype(np.float32) for c in (a.colours[in_a], b.colours[in_b]))
    fb = fb * (fa[free[box]].mean(0) / np.maximum(fb[free[box]].mean(0), 1.0))  # exposure must not pull the seam
    masks = [np.ascontiguousarray(m[box]).astype(np.uint8) * 255 for m in (may_a, may_b)]
    pictures = [np.ascontiguousarray(f, np.float32) for f in (fa, fb)]
    finder = cv2.detail.GraphCutSeamFinder("COST_COLOR")
    done = finder.find(pictures, [(0, 0), (0, 0)], masks)  # pyright: ignore[reportCallIssue, reportArgumentType]
    to_a, to_b = (np.asarray(m.get() if hasattr(m, "get") else m) > 0 for m in done)
    free = free[box]
    part = here[box]
    part[free & to_a & ~to_b] = a.number
    part[free & to_b & ~to_a] = b.number
