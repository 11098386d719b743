"""Tie points on rendered photos of one plane: places, tracks, what fails, resuming, processes."""

import importlib.util
from functools import partial
from operator import getitem
from typing import Any, cast

import numpy as np
import pytest

from solvers.errors import BadProject, DegenerateGeometry, Unsupported
from solvers.execution import Progress, each
from solvers.matching import TieOptions, TiePhoto, Ties, tie_points
from solvers.matching.pairing import match_descriptors, pairs_by_position, pairs_by_vote
from solvers.matching.tracks import components, join, thin
from solvers.matching.verify import apply, verify

SIZE = (420, 320)  # cols, rows
OPTIONS = TieOptions(count=1200, per_photo=400)


def plane_to_photo(n: int) -> np.ndarray:
    """Photo n of a strip: turned, scaled, slightly tilted, 110 px further along."""
    angle, scale = np.radians([0, 7, -12, 20][n]), [1.0, 1.06, 0.95, 1.1][n]
    c, s = scale * np.cos(angle), scale * np.sin(angle)
    centre, along = np.array([210.0, 160.0]), np.array([210.0 + 70 * n, 160.0])
    turn = np.array([[c, -s], [s, c]])
    matrix = np.eye(3)
    matrix[:2, :2], matrix[:2, 2] = turn, centre - turn @ along
    tilt = np.eye(3)
    tilt[2, :2] = [3e-5 * n, -2e-5 * n]
    return tilt @ matrix


def texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bumps of several sizes on a 1000 x 700 plane, exact at any place."""
    rng = np.random.default_rng(5)
    grey = np.full(x.shape, 120.0, np.float32)
    for size, count in ((2.0, 2500), (4.0, 900), (9.0, 160)):
        centres = rng.uniform([-150, -150], [700, 500], (count, 2))
        heights = rng.uniform(25, 60, count) * rng.choice([-1, 1], count)
        for (cx, cy), h in zip(centres, heights, strict=True):
            near = _around(x, y, cx, cy, 4 * size)
            grey[near] += h * np.exp(-((x[near] - cx) ** 2 + (y[near] - cy) ** 2) / (2 * size**2))
    return grey


def _around(x: np.ndarray, y: np.ndarray, cx: float, cy: float, reach: float) -> tuple[slice, slice]:
    """The part of a photo where a spot of the plane can be: its box by the middle row's and column's affine approximation."""
    to = np.linalg.pinv(np.stack([[x[0, -1] - x[0, 0], x[-1, 0] - x[0, 0]], [y[0, -1] - y[0, 0], y[-1, 0] - y[0, 0]]]))
    u, v = to @ [cx - x[0, 0], cy - y[0, 0]]
    rows, cols = x.shape
    ru, rv = np.abs(to).sum(1) * reach * 1.2 + 0.02
    return (slice(max(int((v - rv) * rows), 0), max(int((v + rv) * rows) + 1, 0)),
            slice(max(int((u - ru) * cols), 0), max(int((u + ru) * cols) + 1, 0)))


def photograph(n: int, noise: float = 1.0) -> np.ndarray:
    cols, rows = SIZE
    row, col = np.mgrid[0:rows, 0:cols].astype(float)
    place = apply(np.linalg.inv(plane_to_photo(n)), np.stack([col.ravel(), row.ravel()], 1)).reshape(rows, cols, 2)
    grey = texture(place[..., 0], place[..., 1]) * [1, 0.9, 1.1, 0.95][n]
    return np.clip(np.round(grey + np.random.default_rng(n).normal(0, noise, (rows, cols))), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def photos() -> dict[str, np.ndarray]:
    return {f"p{n}": photograph(n) for n in range(4)}


def reader(name: str, photos: dict[str, np.ndarray]) -> np.ndarray:
    if name not in photos:
        raise BadProject(f"{name}: there is no such photo; correct the path")
    return photos[name]


def errors(ties: Ties) -> np.ndarray:
    """(k, 2) px of each point's further observations off the place of its first, carried through the true plane."""
    of, out = ties.observations, []
    for point in range(len(ties.points)):
        rows = np.flatnonzero(of.point == point)
        matrices = [plane_to_photo(int(ties.photos[of.image[r]][1:])) for r in rows]
        for r, matrix in zip(rows[1:], matrices[1:], strict=True):
            expected = apply(matrix @ np.linalg.inv(matrices[0]), of.pixel[rows[:1]])[0]
            out.append(of.pixel[r] - expected)
    return np.array(out)


@pytest.fixture(scope="module")
def ties(photos: dict[str, np.ndarray]) -> Ties:
    names = [TiePhoto(n) for n in photos] + [TiePhoto("p9")]
    return tie_points(names, partial(reader, photos=photos), OPTIONS)


def test_points_are_where_they_should_be(ties: Ties) -> None:
    error = errors(ties)
    assert len(error) > 300
    wrong = np.linalg.norm(error, axis=1) > 0.5
    assert wrong.mean() < 0.005
    assert np.sqrt((error[~wrong] ** 2).mean()) < 0.03  # two errors are in it, the first place's and the other's


def test_tracks_have_each_photo_once_and_no_twins(ties: Ties) -> None:
    of = ties.observations
    assert len(np.unique(of.image * 100000 + of.point)) == len(of)
    assert (ties.rays >= 2).all() and (ties.rays >= 3).mean() > 0.3
    for n in range(4):
        seen = of.pixel[of.image == n]
        apart = np.linalg.norm(seen[:, None] - seen, axis=2) + 99 * np.eye(len(seen))
        assert apart.min() >= 2.0


def test_one_photo_has_more_pairs_than_neighbours(photos: dict[str, np.ndarray]) -> None:
    where = {"p0": (0.0, 0.0), "p1": (1.0, 0.0), "p2": (0.0, 1.1), "p3": (-1.2, 0.0)}  # p0 is the nearest of all others
    names = [TiePhoto(n, None, np.array(xy)) for n, xy in where.items()]
    found = tie_points(names, partial(reader, photos=photos), TieOptions(count=300, window=0, neighbours=1))
    assert {("p0", "p1"), ("p0", "p2")} <= {(p.first, p.second) for p in found.pairs}


def test_points_are_spread(ties: Ties) -> None:
    seen = ties.observations.pixel[ties.observations.image == 1]
    cells = np.unique((seen // [105, 80]).astype(int), axis=0)
    assert len(cells) >= 14  # of 16


def test_a_photo_that_fails_is_named_and_the_rest_goes_on(ties: Ties) -> None:
    assert ties.failed == {"p9": "p9: there is no such photo; correct the path"}
    assert ties.groups == (("p0", "p1", "p2", "p3"), ("p9",))
    assert ties.sizes[0] == SIZE and ties.sizes[4] == (0, 0)


class Shelf:
    """A store in memory that counts."""

    def __init__(self) -> None:
        self.kept: dict[str, dict[str, np.ndarray]] = {}

    def load(self, key: str) -> dict[str, np.ndarray] | None:
        return self.kept.get(key)

    def save(self, key: str, arrays: dict[str, np.ndarray]) -> None:
        self.kept[key] = arrays


def same(a: Ties, b: Ties) -> None:
    assert a.pairs == b.pairs
    np.testing.assert_array_equal(a.observations.pixel, b.observations.pixel)
    np.testing.assert_array_equal(a.observations.point, b.observations.point)
    np.testing.assert_array_equal(a.observations.image, b.observations.image)


def test_what_was_done_is_not_done_again(photos: dict[str, np.ndarray], ties: Ties) -> None:
    names, shelf, read = [TiePhoto(n) for n in photos], Shelf(), []

    def counting(name: str) -> np.ndarray:
        read.append(name)
        if len(read) > 6:
            raise KeyboardInterrupt
        return photos[name]

    with pytest.raises(KeyboardInterrupt):
        tie_points(names, counting, OPTIONS, store=shelf)
    assert sum(k.startswith("features") for k in shelf.kept) == 4 and sum(k.startswith("pair") for k in shelf.kept) == 6
    said: list[Progress] = []
    done = tie_points(names, partial(reader, photos=photos), OPTIONS, store=shelf, report=said.append)
    same(done, tie_points(names, partial(reader, photos={}), OPTIONS, store=shelf))  # nothing is read any more
    same(done, ties)
    assert [p.stage for p in said if p.done == p.total] == ["features", "pairs", "refinement"]
    assert all(p.left >= 0 and p.seconds >= 0 for p in said)


def test_processes_give_the_same(photos: dict[str, np.ndarray]) -> None:
    two, options = {n: photos[n] for n in ("p0", "p1")}, TieOptions(count=300, window=0)
    names, read = [TiePhoto(n) for n in two], partial(getitem, two)
    same(tie_points(names, read, options, workers=2), tie_points(names, read, options))


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask.distributed is not installed")
def test_a_cluster_gives_the_same(photos: dict[str, np.ndarray]) -> None:
    from distributed import LocalCluster

    two, options = {n: photos[n] for n in ("p0", "p1")}, TieOptions(count=300, per_photo=100)
    names, read, local = [TiePhoto(n) for n in two], partial(getitem, two), cast(Any, LocalCluster)
    with local(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        same(tie_points(names, read, options, scheduler=cluster.scheduler_address), tie_points(names, read, options))


def test_execution_takes_items_as_needed_and_keeps_their_numbers() -> None:
    taken: list[int] = []

    def items():
        for n in range(5):
            taken.append(n)
            yield n

    results = each(abs, items())
    assert next(results) == (0, 0) and taken == [0]
    assert dict(results) == {1: 1, 2: 2, 3: 3, 4: 4}
    with pytest.raises(Unsupported, match="dask"):
        list(each(abs, [1], scheduler="tcp://127.0.0.1:1"))


def test_nothing_in_common_is_refused() -> None:
    rng = np.random.default_rng(0)
    noise = {n: rng.integers(0, 255, (200, 240), dtype=np.uint8) for n in "ab"}
    with pytest.raises(DegenerateGeometry, match="no two of 2 photos share points"):
        tie_points([TiePhoto(n) for n in noise], partial(reader, photos=noise), OPTIONS)
    with pytest.raises(Unsupported, match="'a' is given twice"):
        tie_points([TiePhoto("a"), TiePhoto("a")], partial(reader, photos=noise))
    with pytest.raises(Unsupported, match="'surf' are not known here; choose one of sift, orb"):
        tie_points([TiePhoto("a"), TiePhoto("b")], partial(reader, photos=noise), TieOptions(feature="surf"))


def test_low_texture_is_equalised(photos: dict[str, np.ndarray]) -> None:
    flat = {n: np.round(120 + (p.astype(float) - 120) * 0.12).astype(np.uint8) for n, p in photos.items() if n in ("p0", "p1")}
    names, read = [TiePhoto(n) for n in flat], partial(reader, photos=flat)
    found = tie_points(names, read, TieOptions(window=0, count=1200, per_photo=400))
    with pytest.raises(DegenerateGeometry):
        tie_points(names, read, TieOptions(window=0, count=1200, per_photo=400, equalise=False))
    error = np.linalg.norm(errors(found), axis=1)
    assert len(error) > 60 and np.median(error) < 1


# -- parts -----------------------------------------------------------------------------------------------------------------------


def test_a_match_that_would_double_a_photo_is_left_out() -> None:
    tracks = join([(0, 1, np.array([[0, 0], [1, 1]])), (1, 2, np.array([[0, 5], [1, 6]])), (0, 2, np.array([[1, 5]]))])
    assert sorted(map(sorted, (t.items() for t in tracks))) == [[(0, 0), (1, 0), (2, 5)], [(0, 1), (1, 1), (2, 6)]]


def test_thinning_prefers_quality_and_keeps_apart() -> None:
    places = [{0: np.array([10.0, 10.0])}, {0: np.array([10.5, 10.0])}, {0: np.array([90.0, 90.0])}]
    assert thin(places, np.array([2.0, 3.0, 1.0]), [(100, 100)], 100, 2.0) == [1, 2]


def test_groups() -> None:
    assert components(5, [(3, 4), (0, 2), (2, 3)]).tolist() == [0, 1, 0, 0, 0]


def test_matching_asks_for_the_nearest_from_both_sides() -> None:
    rng = np.random.default_rng(1)
    a = rng.normal(size=(50, 32)).astype(np.float32)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    order = rng.permutation(50)
    found = match_descriptors(a, a[order], chunk=7)
    assert (order[found[:, 1]] == found[:, 0]).all() and len(found) == 50
    far = np.where(np.arange(50)[:, None] % 2 == 0, 0.0, 1000.0) * np.ones((50, 2))
    near = match_descriptors(a, a[order], expected=far, pixel=np.zeros((50, 2)), radius=5.0)
    assert (near[:, 0] % 2 == 0).all() and len(near) == 25


def test_pairs_by_position_and_by_vote() -> None:
    line = np.array([[0.0, 0], [10, 0], [20, 0], [np.nan, np.nan], [300, 0]])
    assert pairs_by_position(line, 1) == {(0, 1), (1, 2), (2, 4)}
    rng = np.random.default_rng(2)
    words = rng.normal(size=(60, 20, 128))  # photos n and n + 1 share half of their features
    ballots = []
    for n in range(60):
        b = np.concatenate([words[n], words[(n + 1) % 60]])
        ballots.append((b / np.linalg.norm(b, axis=1, keepdims=True)).astype(np.float16))
    pairs = pairs_by_vote(ballots, 4)
    assert pairs == {(n, n + 1) for n in range(59)} | {(0, 59)}
    assert pairs_by_vote(ballots[:6], 4, group=np.array([0, 0, 0, 1, 1, 1])) == {(2, 3)}


def test_a_plane_is_not_taken_for_a_fundamental_matrix() -> None:
    """All right matches lie on one plane; wrong ones must not join it along epipolar lines that the plane leaves arbitrary."""
    rng = np.random.default_rng(3)
    matrix = plane_to_photo(2) @ np.linalg.inv(plane_to_photo(0))
    a = rng.uniform([0, 0], SIZE, (200, 2))
    b = apply(matrix, a) + rng.normal(0, 0.5, a.shape)
    b[120:] = rng.uniform([0, 0], SIZE, (80, 2))
    found = verify(a, b, (None, None), 3.0)
    assert found is not None and found.kind == "homography"
    assert found.inlier[:120].mean() > 0.98 and found.inlier[120:].sum() <= 1
    assert verify(a[120:], b[120:], (None, None), 3.0) is None


def test_a_pair_whose_geometry_opencv_gives_up_is_a_pair_without_geometry(monkeypatch: pytest.MonkeyPatch) -> None:
    """USAC asserts, seldom, that wrong matches have a model; the other pairs go on."""
    import cv2

    def fails(*_: object) -> None:
        raise cv2.error("(-215:Assertion failed) !model.empty() in function 'setModelParameters'")

    monkeypatch.setattr(cv2, "findFundamentalMat", fails)
    rng = np.random.default_rng(8)
    assert verify(rng.uniform(0, 900, (20, 2)), rng.uniform(0, 900, (20, 2)), (None, None), 2.0) is None
