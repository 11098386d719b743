"""Start values of a bundle without approximations: resection where control is, then from image to image over tie points;
priors, or a relative orientation of the best pair, where there is no control to begin with.

Reference: docs/formulas.md 4; Nistér 2004 (five points, by OpenCV).
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ...adjustment.fronts import alone
from ...errors import DegenerateGeometry
from ...geometry import Exterior, from_opencv
from ..initial import Candidate, candidates, three_points
from ..linear_models import affine, direct_linear_transformation
from .datum import similarity
from .given import Given
from .growing import straightened
from .level import Line, looking_down
from .meeting import FAR, behind, misses, points, without_wrong_rays

MANY = 60
"""Points used for a resection within the block; more add nothing to a start."""
LIKE = 2.0
"""Cost, over the best one's, up to which another resection of an image is tried as well."""
TOGETHER, MOST_OPEN = 64, 24
"""Combinations that are tried whole, and images with a choice up to which there is any trying."""
BETTER = 0.1
"""Share of the misfit [px^2] of the priors' orientations below which those of the network by itself are begun with."""
MISFIT, TRIPLES = 8.0, 60
"""Median residual, over the sigma of an observation, from which three points at a time are asked, and how often."""
MUCH = 0.4
"""Share of the median residual that is much better."""
ON_LINE = 0.1
"""Spread of positions across a line, over that along it, below which images are turned about it until they look down."""
STEADY, WIDER = 24, 1.5
"""Images from which a growing block is adjusted on the way, and growth until it is so again."""
NEAR = 20.0
"""Median residual [px], over the sigma of an observation, beyond which a start from tie points is not believed."""


def start(data: Given) -> tuple[dict[int, Exterior], np.ndarray, list[str]]:
    """Exterior orientations by image, points (n, 3) m (NaN where there are none), local, and what to know about them.

    Raises DegenerateGeometry when nothing can begin.
    """
    with alone():  # thousands of small matrices, for which no thread need be woken
        return _start(data)


def _start(data: Given) -> tuple[dict[int, Exterior], np.ndarray, list[str]]:
    how, known, said = data.request.start, data.approximate, []
    images = [int(i) for i in np.unique(data.image)]
    poses: dict[int, Exterior] = {}
    if how in ("auto", "resection", "dlt", "affine"):
        least = 4 if data.request.datum != "free" else 6
        if how in _LINEAR:
            poses = {i: e for i in images if (e := _LINEAR[how](data, i, known, least)) is not None}
        else:
            found = {i: several for i in images if (several := _resections(data, i, known, least))}
            poses = _agreed(data, found)
        if poses:
            _grow(data, poses, images, known)
    if how in ("prior", "given") or (how == "auto" and len(poses) < len(images)):
        at_once = not poses
        for i in images:
            if i not in poses and (e := _prior(data, i)) is not None:
                poses[i] = e
        if how in ("prior", "given") and len(poses) < len(images):
            raise DegenerateGeometry(f"{data.block.name}: {len(images) - len(poses)} image(s) have no complete prior to start "
                                     "from; take another start")
        if at_once and poses and how == "auto":
            poses = _by_network(data, images, poses)
            _grow(data, poses, images, known)
    if not poses and how in ("auto", "relative"):
        poses = _relative(data, images)
        _grow(data, poses, images, np.full_like(known, np.nan))
        said = _placed(data, poses)
    if not poses:
        raise DegenerateGeometry(f"{data.block.name}: no image has enough control to begin (four points that are not on a line), "
                                 "there is no prior, and no pair of images shares enough tie points")
    xyz = known.copy() if how == "given" else points(data, poses)
    if how != "given":
        without_wrong_rays(data, poses, xyz)
    missing = ~np.isfinite(xyz).all(axis=1)
    xyz[missing] = points(data, poses)[missing] if how == "given" else known[missing]
    behind(data, poses, xyz)
    return poses, xyz, said


def network_alone(data: Given) -> np.ndarray:
    """(n, 3) points of the network oriented by itself, in a frame of its own, NaN where there are none."""
    poses = _relative(data, [int(i) for i in np.unique(data.image)])
    if not poses:
        raise DegenerateGeometry(f"{data.block.name}: no pair of images shares enough tie points")
    _grow(data, poses, [int(i) for i in np.unique(data.image)], np.full_like(data.approximate, np.nan))
    return points(data, poses)


def _resected(data: Given, image: int, xyz: np.ndarray, least: int) -> Exterior | None:
    """Exterior orientation of an image from points xyz (n, 3) that are known, None where there are too few or it cannot be."""
    found = _resections(data, image, xyz, least)
    return found[0] if found else None


def _resections(data: Given, image: int, xyz: np.ndarray, least: int) -> list[Exterior]:
    """Exterior orientations of an image from points xyz (n, 3) that are known, the best first; behind it those that fit hardly
    worse (both reversal solutions of a flat object); none where there are too few points or it cannot be."""
    rows = data.seen_in(image)
    rows = rows[np.isfinite(xyz[data.point[rows]]).all(axis=1)]
    if len(rows) < least:
        return []
    rows = rows[np.linspace(0, len(rows) - 1, min(MANY, len(rows))).astype(int)]
    interior, at = data.camera(image), xyz[data.point[rows]]
    mean = at.mean(axis=0)
    s = np.linalg.svd(at - mean, compute_uv=False)
    if s[1] <= 1e-4 * s[0]:
        return []
    ideal, sigma = data.ideal[rows], data.unit[rows]
    found = candidates(at - mean, ideal, interior.c)
    agree = _agreeing(found, at - mean, ideal, interior.c, sigma)
    if not agree.all():
        found = candidates((at - mean)[agree], ideal[agree], interior.c)
    return [f.exterior.shifted(-mean) for f in found[:3] if f.cost <= LIKE * found[0].cost]


def _agreeing(found: list[Candidate], points: np.ndarray, xy: np.ndarray, c: float, sigma: np.ndarray) -> np.ndarray:
    """(r,) which points to begin an image with: all, unless the orientation of three leaves half of them far closer than the best
    of all does, for a single point under a wrong name turns the image. sigma (r,), as xy. Reference: Rousseeuw 1984 (least
    median)."""
    n = len(points)
    best = np.median(_off(found[0].exterior, points, xy, c)) if found else np.inf
    if n < 7 or best < MISFIT * np.median(sigma):
        return np.ones(n, bool)
    rng, agree, least = np.random.default_rng(0), np.ones(n, bool), MUCH * best
    for _ in range(TRIPLES):
        rows = rng.choice(n, 3, replace=False)
        for exterior in three_points(points[rows], xy[rows], c):
            off = _off(exterior, points, xy, c)
            if np.median(off) < least:
                least, agree = float(np.median(off)), off <= FAR * max(np.median(off), np.median(sigma))
    return agree if agree.sum() >= 5 else np.ones(n, bool)


def _off(exterior: Exterior, points: np.ndarray, xy: np.ndarray, c: float) -> np.ndarray:
    """(r,) lengths of the residuals of points (r, 3), infinite behind the photo."""
    uvw = exterior.camera(points)
    return np.where(uvw[:, 2] < 0, np.hypot(*(xy + c * uvw[:, :2] / uvw[:, 2:]).T), np.inf)


def _agreed(data: Given, found: dict[int, list[Exterior]]) -> dict[int, Exterior]:
    """Of every image that orientation with which the rays of all meet best; those that leave a choice are tried together where
    they are few, in turn where they are many."""
    poses = {i: several[0] for i, several in found.items()}
    open_ = [i for i, several in found.items() if len(several) > 1]
    if not open_ or len(poses) < 2 or len(open_) > MOST_OPEN:
        return poses
    wanted = np.zeros(len(data.block.points), bool)
    wanted[data.point[np.isin(data.image, open_)]] = True
    choices = [found[i] for i in open_]
    if np.prod([len(c) for c in choices]) <= TOGETHER:
        trials = [{**poses, **dict(zip(open_, chosen, strict=True))} for chosen in product(*choices)]
        return min(trials, key=lambda p: _meeting(data, p, wanted))
    for _ in range(2):
        for i in open_:
            poses = min(({**poses, i: e} for e in found[i]), key=lambda p: _meeting(data, p, wanted))
    return poses


def _meeting(data: Given, poses: dict[int, Exterior], wanted: np.ndarray | None = None) -> float:
    """Mean square of what the rays of all images miss their common points by [px^2]; far more where points are behind. wanted
    (n,): only of these points."""
    off = misses(data, poses, points(data, poses, wanted))
    rows = np.flatnonzero(~np.isnan(off))
    width = np.array([data.camera(i).width for i in range(len(data.block.images))], float)[data.image[rows]]
    v = np.where(np.isfinite(off[rows]), off[rows] * data.sigma[rows], width)
    return float((v * v).sum()) / max(len(rows), 1)


def _by_dlt(data: Given, image: int, xyz: np.ndarray, least: int) -> Exterior | None:
    """The camera behind a direct linear transformation, None where it cannot be."""
    rows, at, mean = _chosen(data, image, xyz)
    if len(rows) < max(6, least):
        return None
    try:
        found = direct_linear_transformation(at - mean, data.camera(image).photo(data.pixels[rows])).exterior
    except (DegenerateGeometry, np.linalg.LinAlgError):
        return None
    return found.shifted(-mean) if (found.camera(at - mean)[:, 2] < 0).all() else None


def _by_affine(data: Given, image: int, xyz: np.ndarray, least: int) -> Exterior | None:
    """The orientation behind an affine model: parallel rays, at the distance its scale says (docs/formulas.md 3.5)."""
    rows, at, mean = _chosen(data, image, xyz)
    if len(rows) < max(4, least):
        return None
    interior = data.camera(image)
    try:
        found = affine(at - mean, data.ideal[rows])
    except DegenerateGeometry:
        return None
    u, s, vt = np.linalg.svd(found.a[:, :3], full_matrices=False)
    m, scale = u @ vt, float(s.mean())
    m = np.vstack([m, np.cross(m[0], m[1])])
    centre = found.mean - m.T @ np.array([*found.a[:, 3] / scale, -interior.c / scale])
    return Exterior(m, centre + mean)


def _chosen(data: Given, image: int, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observations of known points in an image, the points, and their mean."""
    rows = data.seen_in(image)
    rows = rows[np.isfinite(xyz[data.point[rows]]).all(axis=1)]
    at = xyz[data.point[rows]]
    return rows, at, at.mean(axis=0) if len(at) else np.zeros(3)


_LINEAR = {"dlt": _by_dlt, "affine": _by_affine}


def _grow(data: Given, poses: dict[int, Exterior], images: list[int], known: np.ndarray) -> None:
    """Add images to the oriented ones, those that see most points first, until none can be added. Large blocks are adjusted on
    the way, for small errors grow from image to image."""
    placed, new, left = np.full_like(known, np.nan), list(poses), [i for i in images if i not in poses]
    straight = len(poses)
    while left:
        if len(poses) >= max(STEADY, WIDER * straight):
            straightened(data, poses, known)
            straight, new = len(poses), list(poses)
        touched = np.zeros(len(known), bool)
        touched[data.point[np.isin(data.image, new)]] = True
        placed[touched] = points(data, poses, touched)[touched]
        xyz = np.where(np.isfinite(known), known, placed)
        usable = np.asarray(np.isfinite(xyz).all(axis=1))
        counts = np.bincount(data.image[usable[data.point]], minlength=len(data.block.images))[left]
        if counts.max() < 6:
            return
        new = []
        for k in np.flatnonzero(counts >= max(6, counts.max() // 2)):
            e = _resected(data, left[k], xyz, 6)
            if e is not None and _believable(data, left[k], e, xyz):
                poses[left[k]] = e
                new.append(left[k])
        if not new:
            return
        left = [i for i in left if i not in poses]


def _believable(data: Given, image: int, e: Exterior, xyz: np.ndarray) -> bool:
    rows = data.seen_in(image)
    rows = rows[np.isfinite(xyz[data.point[rows]]).all(axis=1)]
    v = _off(e, xyz[data.point[rows]], data.ideal[rows], data.camera(image).c) / data.camera(image).pitch[0]
    good = np.isfinite(v)
    return bool(good.mean() > 0.5 and np.median(v[good]) < max(NEAR * data.sigma[rows].mean(), 0.02 * data.camera(image).width))


def _prior(data: Given, image: int) -> Exterior | None:
    prior = data.block.images[image].prior
    if prior is None or prior.centre is None or prior.angles is None:
        return None
    return Exterior.from_angles(*prior.angles, centre=data.frame.to_local(prior.centre))


def _relative(data: Given, images: list[int]) -> dict[int, Exterior]:
    """Two images oriented to each other, base 1: of the pairs with most common points the one whose rays cross best."""
    from scipy.sparse import csr_matrix, find, triu

    m, n = len(data.block.images), len(data.block.points)
    seen = csr_matrix((np.ones(len(data.image), np.int32), (data.image, data.point)), shape=(m, n))
    a, b, shared = find(triu(seen @ seen.T, 1))
    best: tuple[float, dict[int, Exterior]] = (0.0, {})
    for k in np.lexsort((b, a, np.negative(shared)))[:12]:
        if shared[k] < 8:
            break
        pair = _pair(data, int(a[k]), int(b[k]))
        if pair is not None and pair[0] * np.sqrt(shared[k]) > best[0]:
            best = float(pair[0] * np.sqrt(shared[k])), pair[1]
    return best[1]


def _pair(data: Given, a: int, b: int) -> tuple[float, dict[int, Exterior]] | None:
    """Median angle between the rays [rad] and the two orientations, from the essential matrix."""
    import cv2

    rows_a, rows_b = data.seen_in(a), data.seen_in(b)
    _, i, j = np.intersect1d(data.point[rows_a], data.point[rows_b], return_indices=True)
    rays = [data.ideal[rows] / data.camera(k).c * [1, -1] for k, rows in ((a, rows_a[i]), (b, rows_b[j]))]
    tolerance = 3 * float(data.sigma.mean()) * float(data.camera(a).pitch.max()) / data.camera(a).c
    essential, _ = cv2.findEssentialMat(rays[0], rays[1], np.eye(3), cv2.RANSAC, 0.9999, tolerance)
    if essential is None or essential.shape != (3, 3):
        return None
    good, r, t, _ = cv2.recoverPose(essential, rays[0], rays[1], np.eye(3))
    if good < 0.5 * len(i):
        return None
    poses = {a: from_opencv(np.eye(3), np.zeros(3)), b: from_opencv(r, (-r.T @ t)[:, 0])}
    one, two = (np.column_stack([ray, np.ones(len(ray))]) for ray in rays)
    two = two @ r
    cosine = (one * two).sum(axis=1) / np.linalg.norm(one, axis=1) / np.linalg.norm(two, axis=1)
    return float(np.median(np.arccos(np.clip(cosine, -1, 1)))), poses


def _by_network(data: Given, images: list[int], poses: dict[int, Exterior]) -> dict[int, Exterior]:
    """Orientations as priors state them or, of few images, those of the network by itself, brought to the priors as a whole,
    where its rays meet far better: images orient each other to far less than a degree, onboard angles do not."""
    if not 3 <= len(images) <= TOGETHER:
        return poses
    alone = _relative(data, images)
    _grow(data, alone, images, np.full_like(data.approximate, np.nan))
    if len(alone) < len(poses) or _placed(data, alone):
        return poses
    return alone if _meeting(data, alone) < BETTER * _meeting(data, poses) else poses


def _placed(data: Given, poses: dict[int, Exterior]) -> list[str]:
    """Bring a relative orientation to where known points, or the priors, say it is; gives back what to know."""
    xyz = points(data, poses)
    ok = np.isfinite(xyz).all(axis=1) & np.isfinite(data.approximate).all(axis=1)
    source, target, by_points = xyz[ok], data.approximate[ok], int(ok.sum()) >= 3
    if not by_points:
        source, target = _centres_and_axes(data, poses)
    spread = np.linalg.svd(target - target.mean(axis=0), compute_uv=False) if len(target) > 1 else np.zeros(2)
    on_line = not by_points and len(source) == len(poses) and spread[1] < ON_LINE * spread[0]
    enough = len(source) >= 3 and spread[1] >= 1e-6
    if not enough and not (on_line and data.priors and spread[0] > 1e-6):
        return ["place, attitude and scale are arbitrary: fewer than three points or image positions are known"]
    scale, r, t = similarity(source, target)
    for i, e in poses.items():
        poses[i] = Exterior(e.m @ r.T, scale * r @ e.centre + t)
    if on_line:
        poses.update(looking_down(Line.through(target), poses))
    return []


def _centres_and_axes(data: Given, poses: dict[int, Exterior]) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3) projection centres and those that priors state; behind them, where priors have angles, points a third of their
    extent along the photos' axes: centres in a row leave the turn about it open."""
    pairs = [(e, p, data.frame.to_local(p.centre)) for i, e in poses.items()
             if (p := data.block.images[i].prior) is not None and p.centre is not None]
    source, target = np.array([e.centre for e, _, _ in pairs]).reshape(-1, 3), np.array([c for *_, c in pairs]).reshape(-1, 3)
    turned = [(e, Exterior.from_angles(*p.angles, centre=c)) for e, p, c in pairs if p.angles is not None]
    if len(pairs) < 2 or not turned:
        return source, target
    extent = [float(np.linalg.norm(at - at.mean(axis=0), axis=1).max()) / 3 for at in (source, target)]
    return (np.vstack([source, *(e.centre + extent[0] * e.m for e, _ in turned)]),
            np.vstack([target, *(e.centre + extent[1] * e.m for _, e in turned)]))
