"""From matches of pairs to points seen in many photos, each photo once, evenly spread."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

Track = dict[int, int]
"""photo -> feature"""


def same_place(pixel: np.ndarray, grain: float) -> np.ndarray:
    """(N,) for each feature the first one at its place (within a cell of `grain` px): one spot may have several descriptors."""
    cell = np.round(pixel / grain).astype(np.int64)
    _, first, inverse = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    return first[inverse.ravel()]


def join(matches: Iterable[tuple[int, int, np.ndarray]]) -> list[Track]:
    """Tracks of matches (photo a, photo b, (M, 2) features), the most trusted pairs first.

    Union-find in which a match that would give a track two points in one photo is left out.
    """
    parent: dict[tuple[int, int], tuple[int, int]] = {}
    members: dict[tuple[int, int], Track] = {}

    def root(node: tuple[int, int]) -> tuple[int, int]:
        while parent[node] != node:
            parent[node] = parent[parent[node]]
            node = parent[node]
        return node

    for a, b, features in matches:
        for i, j in features.tolist():
            for node in ((a, i), (b, j)):
                if node not in parent:
                    parent[node] = node
                    members[node] = {node[0]: node[1]}
            r, s = root((a, i)), root((b, j))
            if r == s or not members[r].keys().isdisjoint(members[s]):
                continue
            if len(members[r]) < len(members[s]):
                r, s = s, r
            parent[s] = r
            members[r].update(members.pop(s))
    return [dict(sorted(m.items())) for m in members.values() if len(m) > 1]


def thin(places: Sequence[dict[int, np.ndarray]], quality: np.ndarray, sizes: Sequence[tuple[int, int]], per_photo: int,
         gap: float) -> list[int]:
    """Indices of tracks (photo -> (2,) px) that spread evenly over the photos: about `per_photo` in each, none nearer than
    `gap` px to another, the highest quality first; a track stays while one of its photos still wants points at its place."""
    side = max(1, round(np.sqrt(per_photo / 3)))  # about three points a cell
    wanted = max(1, round(per_photo / side**2))
    filled: dict[tuple[int, int, int], int] = {}
    taken: dict[tuple[int, int, int], list[np.ndarray]] = {}
    kept = []
    for t in np.argsort(-quality, kind="stable"):
        cells = [(p, *_cell(xy, sizes[p], side)) for p, xy in places[t].items()]
        spots = [(p, int(xy[0] // gap), int(xy[1] // gap)) for p, xy in places[t].items()]
        if all(filled.get(c, 0) >= wanted for c in cells) or any(
            _near(taken, spot, xy, gap) for spot, xy in zip(spots, places[t].values(), strict=True)
        ):
            continue
        kept.append(int(t))
        for cell, spot, xy in zip(cells, spots, places[t].values(), strict=True):
            filled[cell] = filled.get(cell, 0) + 1
            taken.setdefault(spot, []).append(xy)
    return sorted(kept)


def _cell(xy: np.ndarray, size: tuple[int, int], side: int) -> tuple[int, int]:
    return int(side * (xy[0] + 0.5) / size[0]), int(side * (xy[1] + 0.5) / size[1])


def _near(taken: dict[tuple[int, int, int], list[np.ndarray]], spot: tuple[int, int, int], xy: np.ndarray, gap: float) -> bool:
    photo, x, y = spot
    return any(np.hypot(*(other - xy)) < gap for i in (x - 1, x, x + 1) for j in (y - 1, y, y + 1)
               for other in taken.get((photo, i, j), ()))


def components(count: int, pairs: Iterable[tuple[int, int]]) -> np.ndarray:
    """(count,) number of the connected group of each photo, the groups counted by their first photo."""
    group = np.arange(count)
    for a, b in pairs:
        low, high = sorted((group[a], group[b]))
        group[group == high] = low
    return np.unique(group, return_inverse=True)[1]
