"""The search for tie points: features, pairs, geometry, tracks, least squares matching, each spread over workers."""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from ..block import Observations, Points
from ..cameras import Interior
from ..errors import DegenerateGeometry, PhotogrammetryError, Unsupported
from ..execution import Progress, each, timed
from .features import Features, check_kind, find_features
from .lsm import LsmOptions
from .pairing import match_descriptors, pairs_by_position, pairs_by_vote, unit_descriptors, voters
from .refine import Reader, Reference, Refined, Target, refine, similarity
from .ties import SIGMA_PX, Store, TieOptions, TiePair, TiePhoto, Ties
from .tracks import Track, components, join, same_place, thin
from .verify import Verified, apply, derivative, verify

Pair = tuple[int, int]
_NEAR, _SEARCH = 6, (4, 16)  # matches that predict a place; picture px, least and largest search around it


class _Common(NamedTuple):
    """What two photos share: (M, 2) verified features, homography first -> second px, kind, and matches before verification."""

    features: np.ndarray
    homography: np.ndarray
    kind: str
    matches: int


@dataclass(frozen=True)
class _Measured:
    """Tracks as measured: photo -> (3,) col, row, sigma px; score of each track; photos that failed."""

    places: list[dict[int, np.ndarray]]
    score: np.ndarray
    failed: dict[str, str]


def tie_points(photos: Sequence[TiePhoto], read: Reader, options: TieOptions | None = None, *, workers: int = 1,
               scheduler: str | None = None, store: Store | None = None,
               report: Callable[[Progress], object] | None = None) -> Ties:
    """Points seen in two photos and more, measured by least squares matching from one photo in all the others.

    read(name) gives the grey or colour values of a photo; photos are read when they are needed, two at a time and worker. One
    that cannot be read is named in `failed`, the others go on. Pairs come from the positions of the photos, and from a vote
    of their features where positions are missing or leave groups apart. workers, scheduler: as in `execution.each` (read must be
    picklable); the result does not depend on them. store: keeps what is done, to go on after an interruption.

    Raises DegenerateGeometry when no two photos share points. Reference: Luhmann 2014, 5.5; Snavely et al. 2008 (tracks).
    """
    options = options or TieOptions()
    check_kind(options.feature)
    twice = [name for name, n in Counter(p.name for p in photos).items() if n > 1]
    if twice:
        raise Unsupported(f"photo '{twice[0]}' is given twice: give each photo once")
    search = _Search(tuple(photos), read, options, workers, scheduler, store, report)
    features, failed = search.features()
    common = search.compared(search.first_pairs(features), features)
    common |= search.compared(search.second_pairs(features, common), features)
    if not common:
        reasons = "".join(f"; {name}: {why}" for name, why in list(failed.items())[:2])
        raise DegenerateGeometry(f"no two of {len(photos)} photos share points: give photos that overlap by half{reasons}")
    tracks = search.tracks(features, common)
    measured = search.measured(tracks, features, common) if options.window else _as_found(tracks, features)
    return _result(search.photos, features, common, measured, {**failed, **measured.failed}, options)


@dataclass(frozen=True)
class _Search:
    """One search: its photos, how they are read, and where the work is done."""

    photos: tuple[TiePhoto, ...]
    read: Reader
    options: TieOptions
    workers: int
    scheduler: str | None
    store: Store | None
    report: Callable[[Progress], object] | None

    def features(self) -> tuple[dict[int, Features], dict[str, str]]:
        """Features by photo (their descriptors in the store, where there is one) and why others have none."""
        o = self.options
        job = partial(_extract, read=self.read, kind=o.feature, count=o.count, side=o.side, equalise=o.equalise)
        found: dict[int, Features] = {}
        failed: dict[str, str] = {}
        keys = [self.feature_key(i) for i in range(len(self.photos))]
        items = [(p.name, key) for p, key in zip(self.photos, keys, strict=True)]
        for i, result in self.spread("features", job, items, lambda r: r.arrays(), Features.from_arrays):
            if isinstance(result, str):
                failed[self.photos[i].name] = result
            else:
                found[i] = result if self.store is None else replace(result, descriptor=result.descriptor[:0])
        return dict(sorted(found.items())), failed

    def whole(self, i: int, features: dict[int, Features]) -> Features:
        """Features with their descriptors."""
        kept = None if self.store is None else self.store.load(self.feature_key(i))
        return features[i] if kept is None else Features.from_arrays(kept)

    def first_pairs(self, features: dict[int, Features]) -> list[Pair]:
        """All pairs of few photos; of many, near ones by position, and by vote those without a position."""
        if len(features) <= self.options.neighbours + 1:
            return list(combinations(features, 2))
        nowhere = np.full(2, np.nan)
        given = [self.photos[i].position for i in features]
        position = np.array([nowhere if p is None else p[:2] for p in given])
        pairs = pairs_by_position(position, self.options.neighbours)
        lost = ~np.isfinite(position).all(1)
        if np.any(lost):
            pairs |= pairs_by_vote(self.ballots(features), self.options.neighbours, only=np.asarray(lost))
        index = list(features)
        return sorted((index[a], index[b]) for a, b in pairs)

    def second_pairs(self, features: dict[int, Features], common: dict[Pair, _Common]) -> list[Pair]:
        """Pairs by vote between groups that do not hang together yet."""
        if len(features) <= self.options.neighbours + 1:
            return []
        index = list(features)
        group = components(len(self.photos), common)[index]
        if not group.any():
            return []
        pairs = pairs_by_vote(self.ballots(features), self.options.neighbours, group=group)
        return sorted((index[a], index[b]) for a, b in pairs)

    def ballots(self, features: dict[int, Features]) -> list[np.ndarray]:
        return [voters(self.whole(i, features), self.options.root) for i in features]

    def compared(self, pairs: list[Pair], features: dict[int, Features]) -> dict[Pair, _Common]:
        """What the pairs share, by pair; pairs that share nothing are left out."""
        o = self.options
        job = partial(_compare, options=o)

        def items() -> Iterator[tuple[Any, str]]:
            held: dict[int, Features] = {}
            for i, j in pairs:
                for k in (i, j):
                    held[k] = held.pop(k) if k in held else self.whole(k, features)
                while len(held) > self.options.neighbours + 1:
                    del held[next(iter(held))]
                yield (held[i], held[j], self.photos[i].interior, self.photos[j].interior), self.pair_key(i, j)

        results: dict[Pair, _Common] = {}
        for n, common in self.spread("pairs", job, items(), _pair_arrays, _pair_from, len(pairs)):
            if len(common.features):
                results[pairs[n]] = common
        return dict(sorted(results.items()))

    def tracks(self, features: dict[int, Features], common: dict[Pair, _Common]) -> list[Track]:
        """Tracks of the verified matches, pairs with the most of them first."""
        one = {i: same_place(f.pixel, 0.5 * f.reduction) for i, f in features.items()}
        order = sorted(common.items(), key=lambda item: (-len(item[1].features), item[0]))
        return join((i, j, np.stack([one[i][c.features[:, 0]], one[j][c.features[:, 1]]], 1)) for (i, j), c in order)

    def measured(self, tracks: list[Track], features: dict[int, Features], common: dict[Pair, _Common]) -> _Measured:
        """Tracks measured by least squares matching; rays that it refuses are left out."""
        partners: dict[int, set[int]] = defaultdict(set)
        for i, j in common:
            partners[i].add(j)
            partners[j].add(i)
        owned: dict[int, list[int]] = defaultdict(list)
        for t, track in enumerate(tracks):
            owned[_reference(track, features, partners)].append(t)
        references = sorted(owned)
        reach = 3.0 * max(f.reduction for f in features.values())
        job = partial(_refine, read=self.read, window=self.options.window, options=LsmOptions(max_move=reach))

        asked = [_request(i, owned[i], tracks, self.photos, features, common) for i in references]
        items = [(item, self.refine_key(i, item)) for i, item in zip(references, asked, strict=True)]

        places: list[dict[int, np.ndarray]] = [{} for _ in tracks]
        score = np.zeros(len(tracks))
        failed: dict[str, str] = {}
        index = {p.name: n for n, p in enumerate(self.photos)}
        for n, refined in self.spread("refinement", job, items, _refined_arrays, _refined_from):
            i = references[n]
            failed |= refined.why
            for target, pixel, sigma, fit in zip(asked[n].targets, refined.pixel, refined.sigma, refined.score, strict=True):
                for k in np.flatnonzero(np.isfinite(pixel[:, 0])):
                    t = owned[i][target.row[k]]
                    places[t][i] = np.array([*features[i].pixel[tracks[t][i]], SIGMA_PX])
                    places[t][index[target.name]] = np.array([*pixel[k], np.hypot(SIGMA_PX, sigma[k])])
                    score[t] += fit[k]
        rays = np.array([max(len(p) - 1, 1) for p in places])
        bad = {index[name] for name in failed}
        places = [{i: p for i, p in place.items() if i not in bad} for place in places]
        return _Measured(places, score / rays, failed)

    def spread(self, stage: str, job: Callable[[Any], Any], items: Iterable[tuple[Any, str]],
               to_arrays: Callable[[Any], dict[str, np.ndarray]], from_arrays: Callable[[dict[str, np.ndarray]], Any],
               total: int | None = None) -> Iterator[tuple[int, Any]]:
        """(index, result) of every (item, key), from the store where it was done before, else done now and kept."""
        if total is None:
            items = list(items)
            total = len(items)
        known: list[tuple[int, Any]] = []
        todo: list[tuple[int, str]] = []

        def new() -> Iterator[Any]:
            for n, (item, key) in enumerate(items):
                kept = None if self.store is None else self.store.load(key)
                if kept is None:
                    todo.append((n, key))
                    yield item
                else:
                    known.append((n, from_arrays(kept)))

        def results() -> Iterator[tuple[int, Any]]:
            for m, value in each(job, new(), self.workers, self.scheduler):
                yield from known
                known.clear()
                n, key = todo[m]
                if self.store is not None and not isinstance(value, str) and not getattr(value, "why", None):
                    self.store.save(key, to_arrays(value))
                yield n, value
            yield from known

        yield from timed(stage, results(), total, self.report)

    def feature_key(self, i: int) -> str:
        o, photo = self.options, self.photos[i]
        return "features-" + _digest(photo.name, photo.version, o.feature, o.count, o.side, o.equalise)

    def pair_key(self, i: int, j: int) -> str:
        o = self.options
        return "pair-" + _digest(self.feature_key(i), self.feature_key(j), o.root, o.ratio, o.threshold, o.least,
                                 self.photos[i].interior, self.photos[j].interior)

    def refine_key(self, i: int, reference: Reference) -> str:
        parts = [self.feature_key(i), self.options.window, reference.levels, reference.at.tobytes()]
        for t in reference.targets:
            parts += [t.name, t.row.tobytes(), t.start.tobytes(), t.shape.tobytes(), t.search]
        return "refined-" + _digest(*parts)


def _digest(*parts: object) -> str:
    return hashlib.sha256(b"|".join(p if isinstance(p, bytes) else repr(p).encode() for p in parts)).hexdigest()[:24]


# -- what the workers do ------------------------------------------------------------------------------------------------------


def _extract(item: str, read: Reader, kind: str, count: int, side: int, equalise: bool | None) -> Features | str:
    """Features of a photo, or the sentence that says why there are none."""
    try:
        return find_features(read(item), kind, count, side, equalise)
    except (PhotogrammetryError, OSError) as error:
        return str(error)


def _compare(item: tuple[Features, Features, Interior | None, Interior | None], options: TieOptions) -> _Common:
    a, b, first, second = item
    nothing = _Common(np.empty((0, 2), int), np.eye(3), "", 0)
    if not len(a) or not len(b):
        return nothing
    left, right = unit_descriptors(a, options.root), unit_descriptors(b, options.root)
    threshold = options.threshold * max(a.reduction, b.reduction)
    interiors = _of_size(first, a.size), _of_size(second, b.size)

    def verified(matches: np.ndarray) -> Verified | None:
        return verify(a.pixel[matches[:, 0]], b.pixel[matches[:, 1]], interiors, threshold, options.least)

    matches = match_descriptors(left, right, options.ratio)
    found = verified(matches)
    if found is None:
        return nothing
    # Where the geometry is known, fewer features rival: more matches stand out.
    seen = matches[found.inlier]
    expected = apply(found.homography, a.pixel)
    off = np.linalg.norm(expected[seen[:, 0]] - b.pixel[seen[:, 1]], axis=1)
    radius = 2 * threshold + 1.5 * float(np.percentile(off, 95))
    more = match_descriptors(left, right, options.ratio, expected, b.pixel, radius)
    again = verified(more)
    if again is not None and again.inlier.sum() > found.inlier.sum():
        matches, found = more, again
    return _Common(matches[found.inlier], found.homography, found.kind, len(matches))


def _of_size(interior: Interior | None, size: tuple[int, int]) -> Interior | None:
    """The interior orientation for a photo that was read smaller or larger than the camera's format."""
    if interior is None or (interior.width, interior.height) == size:
        return interior
    pitch = interior.pitch * [interior.width / size[0], interior.height / size[1]]
    return replace(interior, pixel_mm=(float(pitch[0]), float(pitch[1])), width=size[0], height=size[1])


def _refine(item: Reference, read: Reader, window: int, options: LsmOptions) -> Refined:
    return refine(item, read, window, options)


def predict(first: np.ndarray, second: np.ndarray, at: np.ndarray, options: TieOptions | None = None,
            ) -> tuple[np.ndarray, np.ndarray] | None:
    """Where a point (2,) px of one photo should be in another, by their features, and how offsets around it map there (2, 2);
    None where the photos share too little."""
    common = shared(first, second, options)
    return None if common is None else common.predict(at)[:2]


class Shared(NamedTuple):
    """What two photos share: features (M, 2) px of the first and of the second, and the homography first -> second near them."""

    first: np.ndarray
    second: np.ndarray
    homography: np.ndarray

    def predict(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Place (2,) px in the second photo of a point (2,) of the first, how offsets around it map there (2, 2), and how far
        around the place one should search [px]."""
        place, reach = _predicted(self.homography, at[None], self.first, self.second, 1.0)
        return place[0], derivative(self.homography, at[None])[0], float(reach)


def shared(first: np.ndarray, second: np.ndarray, options: TieOptions | None = None) -> Shared | None:
    """What two photos share by their features, verified by their geometry; None where that is too little."""
    o = options or TieOptions()
    a, b = (find_features(image, o.feature, o.count, o.side, o.equalise) for image in (first, second))
    common = _compare((a, b, None, None), o)
    if not len(common.features):
        return None
    return Shared(a.pixel[common.features[:, 0]], b.pixel[common.features[:, 1]], common.homography)


# -- tracks to references and back --------------------------------------------------------------------------------------------


def _reference(track: Track, features: dict[int, Features], partners: dict[int, set[int]]) -> int:
    """The photo of a track that is compared with most of its others, of several the one that sees it nearest to its centre."""

    def merit(i: int) -> tuple[int, float]:
        offset = features[i].pixel[track[i]] / features[i].size - 0.5
        return len(partners[i] & track.keys()), -float(np.hypot(*offset))

    return max(track, key=merit)


def _request(i: int, owned: list[int], tracks: list[Track], photos: Sequence[TiePhoto], features: dict[int, Features],
             common: dict[Pair, _Common]) -> Reference:
    """The templates of one photo, the features matched to them in others, and where else they should be seen."""
    a = features[i]
    own = np.array([tracks[t][i] for t in owned])
    at = a.pixel[own]
    targets = []
    for j, b in features.items():
        pair = common.get((min(i, j), max(i, j)))
        rows = np.array([r for r, t in enumerate(owned) if j in tracks[t]], int)
        if j == i or (pair is None and not len(rows)):
            continue
        other = np.array([tracks[owned[r]][j] for r in rows], int)
        if pair is None:
            shape = similarity(b.scale[other] / a.scale[own[rows]], b.angle[other] - a.angle[own[rows]])
            targets.append(Target(photos[j].name, rows, b.pixel[other], shape))
            continue
        matrix = pair.homography if i < j else np.linalg.inv(pair.homography)
        shape = derivative(matrix, at)
        targets.append(Target(photos[j].name, rows, b.pixel[other], shape[rows]))
        known = pair.features if i < j else pair.features[:, ::-1]
        place, search = _predicted(matrix, at, a.pixel[known[:, 0]], b.pixel[known[:, 1]], max(a.reduction, b.reduction))
        inside = np.flatnonzero(((place > 0) & (place < np.array(b.size) - 1)).all(1))
        rest = np.setdiff1d(inside, rows)
        targets.append(Target(photos[j].name, rest, place[rest], shape[rest], search))
    levels = tuple(n for n in (1, 2, 4, 8) if n <= 1.5 * a.reduction)  # down to about the picture of the features
    return Reference(photos[i].name, at, tuple(t for t in targets if len(t.row)), levels)


def _predicted(matrix: np.ndarray, at: np.ndarray, a: np.ndarray, b: np.ndarray, reduction: float) -> tuple[np.ndarray, int]:
    """(N, 2) px where points `at` should be in the other photo, and how far from there to search: the homography, and the median
    parallax of the nearest matches a, b (M, 2)."""
    from scipy.spatial import KDTree

    parallax, tree, count = b - apply(matrix, a), KDTree(a), min(_NEAR, len(a) - 1)
    near, around = np.asarray(tree.query(at, count)[1]), np.asarray(tree.query(a, count + 1)[1])
    left = parallax - np.median(parallax[around[:, 1:]], axis=1)
    reach = 1.5 * float(np.percentile(np.linalg.norm(left, axis=1), 80))
    least, most = (reduction * s for s in _SEARCH)
    return apply(matrix, at) + np.median(parallax[near], axis=1), int(min(max(reach, least), most))


def _as_found(tracks: list[Track], features: dict[int, Features]) -> _Measured:
    """Tracks at the places of their features, whose errors grow with the reduction of the picture."""
    places = [{i: np.array([*features[i].pixel[k], 0.3 * features[i].reduction]) for i, k in track.items()} for track in tracks]
    return _Measured(places, np.zeros(len(tracks)), {})


def _result(photos: Sequence[TiePhoto], features: dict[int, Features], common: dict[Pair, _Common], measured: _Measured,
            failed: dict[str, str], options: TieOptions) -> Ties:
    some = [t for t, place in enumerate(measured.places) if len(place) > 1]
    places = [measured.places[t] for t in some]
    quality = measured.score[some] + [len(p) for p in places]
    sizes = tuple(features[i].size if i in features else (0, 0) for i in range(len(photos)))
    gap = 2.0 * max((f.reduction for f in features.values()), default=1.0)
    kept = thin([{i: v[:2] for i, v in p.items()} for p in places], quality, sizes, options.per_photo, gap)
    rows = np.array([(i, n, *value) for n, t in enumerate(kept) for i, value in sorted(places[t].items())]).reshape(-1, 5)
    if not len(rows):
        raise DegenerateGeometry(f"no point of {len(photos)} photos is confirmed by least squares matching: give sharper photos, "
                                 "or photos taken nearer to each other")
    observations = Observations(rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2:4], rows[:, 4])
    unknown = np.full((len(kept), 3), np.nan)
    width = max(5, len(str(len(kept))))
    points = Points(tuple(f"tie{n:0{width}d}" for n in range(1, len(kept) + 1)), unknown, unknown.copy(), ("tie",) * len(kept))
    pairs = tuple(TiePair(photos[i].name, photos[j].name, c.matches, len(c.features), c.kind) for (i, j), c in common.items())
    links = {(a, b) for t in kept for a, b in combinations(sorted(places[t]), 2)}
    group = components(len(photos), links)
    members = [tuple(p.name for p, g in zip(photos, group, strict=True) if g == k) for k in range(group.max() + 1)]
    members.sort(key=len, reverse=True)
    return Ties(tuple(p.name for p in photos), sizes, observations, points, pairs, failed, tuple(members))


# -- results as arrays, to be stored --------------------------------------------------------------------------------------------


def _pair_arrays(common: _Common) -> dict[str, np.ndarray]:
    return {"features": common.features, "homography": common.homography, "kind": np.array(common.kind),
            "matches": np.array(common.matches)}


def _pair_from(arrays: dict[str, np.ndarray]) -> _Common:
    return _Common(arrays["features"], arrays["homography"], str(arrays["kind"]), int(arrays["matches"]))


def _refined_arrays(refined: Refined) -> dict[str, np.ndarray]:
    return {f"{name}{n}": value for name in ("pixel", "sigma", "score") for n, value in enumerate(getattr(refined, name))}


def _refined_from(arrays: dict[str, np.ndarray]) -> Refined:
    pixel, sigma, score = (tuple(arrays[f"{name}{n}"] for n in range(len(arrays) // 3)) for name in ("pixel", "sigma", "score"))
    return Refined(pixel, sigma, score, {})
