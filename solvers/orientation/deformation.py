"""Monitoring: which points of a network moved between epochs, by congruency of free networks.

Every epoch is a free network with the full covariance of its points. Two of them are laid on each other by the points that are
taken as stable; the quadratic form of what remains tests whether these are congruent. While they are not, the point that
contributes most leaves the datum. In the end all displacements refer to the points that stayed (S-transformation).

Reference: Pelzer 1971 and Niemeier 2008 (congruency test, localisation); Baarda 1973 (S-transformation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from ..errors import BadProject, DegenerateGeometry
from .bundle.datum import similarity

FEWEST = 4
"""Points a datum needs, at least."""
POWER = 0.80
"""Chance with which a movement of the detectable size is found."""


@dataclass(frozen=True)
class Epoch:
    """A free network. points: names; xyz (n, 3) m; covariance (3 n, 3 n) m^2, a priori; sigma0 a posteriori with dof."""

    name: str
    points: tuple[str, ...]
    xyz: np.ndarray
    covariance: np.ndarray
    sigma0: float
    dof: int

    def take(self, names: Sequence[str]) -> Epoch:
        """Some points, in the order of their names."""
        place = {p: k for k, p in enumerate(self.points)}
        rows = np.array([place[n] for n in names])
        index = (3 * rows[:, None] + np.arange(3)).ravel()
        return Epoch(self.name, tuple(names), self.xyz[rows], self.covariance[np.ix_(index, index)], self.sigma0, self.dof)


@dataclass(frozen=True)
class Test:
    """One congruency test. statistic against critical, F distributed with (h, f) degrees of freedom; p: chance of more without
    movement; largest: of single points, over its own critical value; worst: that point; congruent: neither is above."""

    statistic: float
    critical: float
    h: int
    f: int
    p: float
    largest: float
    worst: str
    congruent: bool
    __test__ = False


@dataclass(frozen=True)
class Displacement:
    """Movement of a point. d (3,) m; covariance (3, 3) m^2, a posteriori, both in the datum of the stable points; statistic:
    what
    it adds to the quadratic form of these, over its critical value, above 1 is significant; p: chance of more; datum: whether
    it holds the datum; moved; axes (3,) m and directions (3, 3) (rows): of the 95 % ellipsoid;
    detectable: movement [m] found with 80 % in the weakest direction."""

    point: str
    d: np.ndarray
    covariance: np.ndarray
    statistic: float
    p: float
    datum: bool
    moved: bool
    axes: np.ndarray
    directions: np.ndarray
    detectable: float

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.d))


@dataclass(frozen=True)
class Pair:
    """Two epochs. s0: pooled sigma0 with f degrees of freedom; tests: the steps of the localisation, the last one of the datum
    in
    the end; removed: points that left the datum, in this order; scale: of the second to the first; displacements: of all
    common points."""

    first: str
    second: str
    s0: float
    f: int
    tests: tuple[Test, ...]
    removed: tuple[str, ...]
    stable: tuple[str, ...]
    scale: float
    displacements: tuple[Displacement, ...]

    @property
    def moved(self) -> tuple[str, ...]:
        return tuple(d.point for d in self.displacements if d.moved)


@dataclass(frozen=True)
class Comparison:
    """Epochs compared with the first. level: chance that any point is said to have moved when none did, and, apart from that,
    that
    any congruency test fails; level_pair: the same of one pair; level_single: of one point; datum: points stable in all
    epochs."""

    epochs: tuple[str, ...]
    level: float
    level_pair: float
    level_single: float
    datum: tuple[str, ...]
    pairs: tuple[Pair, ...]
    warnings: tuple[str, ...] = field(default=())

    @property
    def moved(self) -> tuple[str, ...]:
        """Points that moved in any epoch."""
        return tuple(dict.fromkeys(name for pair in self.pairs for name in pair.moved))


def compare_epochs(epochs: Sequence[Epoch], stable: Sequence[str] | None = None, level: float = 0.05) -> Comparison:
    """Compare epochs of one network with the first of them.

    stable: points that may hold the datum; None lets all common points try. level: chance of one false alarm or more in all.
    Raises BadProject (fewer than two epochs, unknown points), DegenerateGeometry (too few common points).
    """
    if len(epochs) < 2:
        raise BadProject("comparing needs two epochs or more; give EPOCH_A EPOCH_B")
    if not 0 < level < 0.5:
        raise BadProject(f"a level of {level:g} is no chance of a false alarm; give one such as 0.05")
    per_pair = level / (len(epochs) - 1)
    couples = [_common(epochs[0], other) for other in epochs[1:]]
    located = [_located(a, b, _candidates(a, stable), per_pair) for a, b in couples]
    names = set.intersection(*(set(found.stable) for found in located))
    datum = tuple(n for n in couples[0][0].points if n in names)
    warnings = _variances(epochs)
    if len(datum) < FEWEST or _flat(couples[0][0].take(datum).xyz):
        warnings.append(f"only {len(datum)} point(s) are stable in all epochs: every pair keeps a datum of its own")
        pairs = tuple(located)
    else:
        pairs = tuple(_concluded(a, b, found, datum, per_pair) for (a, b), found in zip(couples, located, strict=True))
    warnings += [w for pair in pairs for w in _said(pair)]
    n = max(len(p.displacements) for p in pairs)
    return Comparison(tuple(e.name for e in epochs), level, per_pair, _single(per_pair, n), datum, pairs, tuple(warnings))


# -- one pair -----------------------------------------------------------------------------------------------------------------


def _common(a: Epoch, b: Epoch) -> tuple[Epoch, Epoch]:
    names = [n for n in a.points if n in set(b.points)]
    if len(names) < FEWEST:
        raise DegenerateGeometry(f"'{a.name}' and '{b.name}' share {len(names)} point(s); a comparison needs {FEWEST}: measure "
                                 "the same targets under the same names")
    a, b = a.take(names), b.take(names)
    if _flat(a.xyz):
        raise DegenerateGeometry(f"the points that '{a.name}' and '{b.name}' share lie on a line; measure others")
    return a, b


def _flat(xyz: np.ndarray) -> bool:
    """Whether points (n, 3) lie on a line, or are too few to be a datum."""
    if len(xyz) < 3:
        return True
    s = np.linalg.svd(xyz - xyz.mean(axis=0), compute_uv=False)
    return bool(s[1] < 1e-3 * s[0])


def _candidates(a: Epoch, stable: Sequence[str] | None) -> np.ndarray:
    """(n,) which points may hold the datum."""
    if stable is None:
        return np.ones(len(a.points), bool)
    for name in stable:
        if name not in a.points:
            raise BadProject(f"there is no point '{name}' in '{a.name}' and the epochs compared with it; choose others for "
                             "--stable")
    chosen = np.isin(a.points, list(stable))
    if chosen.sum() < FEWEST or _flat(a.xyz[chosen]):
        raise DegenerateGeometry(f"a datum needs {FEWEST} points that are not on a line; name more with --stable")
    return chosen


def _single(level: float, n: int) -> float:
    """Level of one of n points that share a pair's level (Šidák)."""
    return float(1 - (1 - level) ** (1 / n))


@dataclass(frozen=True)
class _State:
    """Differences d (n, 3) with covariance q (3 n, 3 n) in the datum `held` (n,) (S-transformed); weight (n,): what each point
    adds
    to the quadratic form (3 degrees of freedom), own (n, 3, 3): covariance behind it; omega of the datum with rank h; scale."""

    held: np.ndarray
    d: np.ndarray
    q: np.ndarray
    weight: np.ndarray
    own: np.ndarray
    omega: float
    h: int
    scale: float


def _state(a: Epoch, b: Epoch, held: np.ndarray) -> _State:
    """Second epoch laid on the first by the points that hold the datum, and what remains."""
    s, r, t = similarity(b.xyz[held], a.xyz[held])
    n = len(held)
    turn = s * r
    half = (turn @ b.covariance.reshape(n, 3, 3 * n)).reshape(3 * n, n, 3)
    other = (half @ turn.T).reshape(3 * n, 3 * n)
    d = b.xyz @ turn.T + t - a.xyz
    g = _motions(a.xyz, held)
    e = np.repeat(held, 3)
    away = np.linalg.solve(g[e].T @ g[e], (g * e[:, None]).T)
    q = a.covariance + other
    q = q - g @ (away @ q)
    q = q - (q @ away.T) @ g.T
    own, weight, omega = _contributions(d.ravel(), q + float(np.trace(q)) / len(q) * (g @ g.T), g, held)
    return _State(held, d, q, weight, own, omega, 3 * int(held.sum()) - 7, s)


def _contributions(d: np.ndarray, q: np.ndarray, g: np.ndarray, held: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Quadratic form of differences d (3 n,) at the datum points, whatever the motions g (3 n, 7), covariance q regular by
    them; and
    what each point adds to it, a datum point against the others, another against them all: covariance (n, 3, 3) and square
    (n,)."""
    e, n = np.repeat(held, 3), len(held)
    w = np.linalg.inv(q[np.ix_(e, e)])
    wg = w @ g[e]
    inner = np.linalg.inv(g[e].T @ wg)
    p = w - wg @ inner @ wg.T
    pd = p @ d[e]
    own, square = np.empty((n, 3, 3)), np.empty(n)
    own[held] = np.linalg.inv(blocks_of(p))
    parts = pd.reshape(-1, 3)
    square[held] = np.einsum("na,nab,nb->n", parts, own[held], parts)
    if not held.all():
        carried = q[np.ix_(~e, e)]
        tilt = g[~e] - carried @ wg
        off = d[~e] - carried @ (w @ d[e]) - tilt @ (inner @ (wg.T @ d[e]))
        spread = q[np.ix_(~e, ~e)] - carried @ w @ carried.T + tilt @ inner @ tilt.T
        own[~held] = blocks_of(spread)
        square[~held] = _squared(off.reshape(-1, 3), own[~held])
    return own, square, float(d[e] @ pd)


def blocks_of(q: np.ndarray) -> np.ndarray:
    """(n, 3, 3) blocks on the diagonal of a matrix (3 n, 3 n)."""
    n = len(q) // 3
    return q.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n)]


def _squared(d: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(n,) d^T q^-1 d of vectors (n, 3) and covariances (n, 3, 3)."""
    return np.einsum("na,na->n", d, np.linalg.solve(q, d[:, :, None])[:, :, 0])


def _motions(xyz: np.ndarray, held: np.ndarray) -> np.ndarray:
    """(3 n, 7) shifts, rotations and scale about the middle of the datum points, columns of comparable size."""
    x = xyz - xyz[held].mean(axis=0)
    x = x / np.abs(x).max()
    g = np.zeros((len(x), 3, 7))
    g[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        g[:, :, 3 + k] = np.cross(axis, x)
    g[:, :, 6] = x
    return g.reshape(-1, 7)


def _pooled(a: Epoch, b: Epoch) -> tuple[float, int]:
    f = a.dof + b.dof
    if min(a.dof, b.dof) < 1:
        raise DegenerateGeometry(f"'{(a if a.dof < 1 else b).name}' has no redundancy: nothing judges its precision; measure "
                                 "more")
    return float(np.sqrt((a.dof * a.sigma0**2 + b.dof * b.sigma0**2) / f)), f


def _test(state: _State, a: Epoch, s0: float, f: int, level: float) -> Test:
    """Congruency of the datum points as a whole, and of the worst of them."""
    from scipy.stats import f as fisher

    statistic = state.omega / state.h / s0**2
    critical = float(fisher.ppf(1 - level, state.h, f))
    single = float(fisher.ppf(1 - _single(level, len(a.points)), 3, f))
    ratio = np.where(state.held, state.weight / 3 / s0**2 / single, -np.inf)
    worst = int(np.argmax(ratio))
    return Test(float(statistic), critical, state.h, f, float(fisher.sf(statistic, state.h, f)), float(ratio[worst]),
                a.points[worst], bool(statistic <= critical and ratio[worst] <= 1))


def _located(a: Epoch, b: Epoch, candidates: np.ndarray, level: float) -> Pair:
    """The largest congruent datum: of all candidates; else what remains of them when points leave one by one, or of those that
    lie close after a similarity of least absolute values, which a group that moves together does not bend."""
    s0, f = _pooled(a, b)
    whole = _left(a, b, candidates, candidates, s0, f, level)
    if not whole.removed:
        return whole
    close = _robust(a, b, candidates, s0, f, level)
    if close.sum() < FEWEST or _flat(a.xyz[close]):
        return whole
    other = _left(a, b, candidates, close, s0, f, level)
    better = (other.tests[-1].congruent, len(other.stable)) > (whole.tests[-1].congruent, len(whole.stable))
    return replace(other, tests=(whole.tests[0], *other.tests)) if better else whole


def _robust(a: Epoch, b: Epoch, candidates: np.ndarray, s0: float, f: int, level: float) -> np.ndarray:
    """(n,) candidates that agree after the similarity of least absolute values. Reference: Chen 1983 (iterated weights)."""
    from scipy.stats import f as fisher

    state = _state(a, b, candidates)
    blocks = np.linalg.inv(blocks_of(state.q)) / s0**2
    weight = candidates.astype(float)
    size = np.zeros(len(weight))
    for _ in range(50):
        scale, r, t = similarity(b.xyz, a.xyz, weight)
        d = scale * b.xyz @ r.T + t - a.xyz
        size = np.sqrt(np.einsum("na,nab,nb->n", d, blocks, d))
        weight = np.where(candidates, 1 / np.maximum(size, 0.1), 0.0)
    return candidates & (size**2 / 3 <= float(fisher.ppf(1 - _single(level, len(weight)), 3, f)))


def _left(a: Epoch, b: Epoch, candidates: np.ndarray, begin: np.ndarray, s0: float, f: int, level: float) -> Pair:
    """Points leave the datum one by one until the rest is congruent; candidates that fit it after all come back."""
    from scipy.stats import f as fisher

    single = float(fisher.ppf(1 - _single(level, len(a.points)), 3, f))
    held, tests = begin.copy(), []
    removed = [a.points[i] for i in np.flatnonzero(candidates & ~begin)]
    while True:
        state = _state(a, b, held)
        tests.append(_test(state, a, s0, f, level))
        if tests[-1].congruent or held.sum() <= FEWEST:
            break
        worst = a.points.index(tests[-1].worst)
        rest = held & (np.arange(len(held)) != worst)
        if _flat(a.xyz[rest]):
            break
        held = rest
        removed.append(a.points[worst])
    for name in sorted(removed, key=lambda n: state.weight[a.points.index(n)]):  # some were bent by those that left later
        i = a.points.index(name)
        if tests[-1].congruent and state.weight[i] / 3 / s0**2 <= single:
            wider = held | (np.arange(len(held)) == i)
            again = _state(a, b, wider)
            test = _test(again, a, s0, f, level)
            if test.congruent:
                held, state = wider, again
                tests.append(test)
                removed.remove(name)
    return _pair(a, b, state, tuple(tests), tuple(removed), s0, f, level)


def _concluded(a: Epoch, b: Epoch, found: Pair, datum: Sequence[str], level: float) -> Pair:
    """A pair in the datum that all epochs share."""
    held = np.isin(a.points, list(datum))
    state = _state(a, b, held)
    tests = found.tests if set(found.stable) == set(datum) else (*found.tests, _test(state, a, found.s0, found.f, level))
    return _pair(a, b, state, tests, found.removed, found.s0, found.f, level)


def _pair(a: Epoch, b: Epoch, state: _State, tests: tuple[Test, ...], removed: tuple[str, ...], s0: float, f: int,
          level: float) -> Pair:
    from scipy.stats import f as fisher

    one = _single(level, len(a.points))
    single = float(fisher.ppf(1 - one, 3, f))
    reach, need = np.sqrt(3 * float(fisher.ppf(0.95, 3, f))), noncentrality(one, f)
    q = blocks_of(state.q) * s0**2
    values, vectors = np.linalg.eigh((q + np.swapaxes(q, 1, 2)) / 2)
    root, ratio = np.sqrt(np.maximum(values[:, ::-1], 0)), state.weight / 3 / s0**2
    weakest = s0 * np.sqrt(need * np.linalg.eigvalsh(state.own)[:, -1])
    chance = fisher.sf(ratio, 3, f)
    out = [Displacement(
        name, state.d[i], q[i], float(ratio[i] / single), float(chance[i]), bool(state.held[i]),
        bool(not state.held[i] and ratio[i] > single), reach * root[i], vectors[i, :, ::-1].T, float(weakest[i]))
        for i, name in enumerate(a.points)]
    stable = tuple(n for n, h in zip(a.points, state.held, strict=True) if h)
    return Pair(a.name, b.name, s0, f, tests, removed, stable, state.scale, tuple(out))


@lru_cache(maxsize=64)
def noncentrality(level: float, f: int, power: float = POWER) -> float:
    """Noncentrality of a movement in three coordinates that a test at some level finds with some power."""
    from scipy.special import ncfdtrinc
    from scipy.stats import f as fisher

    return float(ncfdtrinc(3, f, 1 - power, fisher.ppf(1 - level, 3, f)))


# -- what to say --------------------------------------------------------------------------------------------------------------


def _variances(epochs: Sequence[Epoch]) -> list[str]:
    """Epochs whose sigma0 differ by more than chance (two-sided, 1 %) from that of the first."""
    from scipy.stats import f as fisher

    out, first = [], epochs[0]
    for e in epochs[1:]:
        ratio = (e.sigma0 / first.sigma0) ** 2
        p = 2 * min(fisher.sf(ratio, e.dof, first.dof), fisher.cdf(ratio, e.dof, first.dof))
        if p < 0.01:
            out.append(f"sigma0 of '{e.name}' ({e.sigma0:.2f}) and of '{first.name}' ({first.sigma0:.2f}) differ by more than "
                       "chance: give the observations sigmas that fit each epoch")
    return out


def _said(pair: Pair) -> list[str]:
    out = []
    if not pair.tests[-1].congruent:
        out.append(f"'{pair.first}' and '{pair.second}': no datum was found whose points are congruent; name stable points "
                   "with --stable, and look for blunders")
    share = len(pair.stable) / len(pair.displacements)
    if share < 0.5:
        out.append(f"'{pair.first}' and '{pair.second}': less than half of the points ({len(pair.stable)} of "
                   f"{len(pair.displacements)}) are stable; movements are relative to them, name those that cannot move with "
                   "--stable")
    return out


__all__ = ["Comparison", "Displacement", "Epoch", "Pair", "Test", "compare_epochs", "noncentrality"]
