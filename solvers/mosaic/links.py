"""Which photos truly see the same ground: the similarity that two photos' shared points agree with, and what contradicts it.

A false link, repeated texture say, fits well by itself; but the ground it claims is seen by the neighbours of both photos too,
and these share nothing. True links close in threes. Reference: Zach, Klopschitz & Pollefeys 2010 (loops tell false matches).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .data import Data
from .growing import CHANCE, COARSE, chance
from .network import Network

LEAST = 4
"""Shared points from which on two photos are linked."""
DRAWS, LOOKED = 100, 24
"""Similarities tried for a link, and shared points that judge them."""
CLOSED = 0.1
"""How far, over c, a chain of two links may end from the link it closes."""
FAR = 0.05
"""Distance over c of a mark from where its link sees it that is never wrong: what tilt and relief make."""
WORTH = 0.02
"""Share of marks left out from which on it is said."""


@dataclass(frozen=True)
class Links:
    """Pairs of photos a < b (k,) that agree on a similarity q_b = turn q_a + shift, complex, with `agreeing` of `points`.

    pairs: marks of one point, by photo pair: first, second (p,) observations and link (p,), -1 for photos that are not linked.
    shared (m, m): points that photos have in common. reach: half of a photo's larger side over c."""

    photos: int
    a: np.ndarray
    b: np.ndarray
    turn: np.ndarray
    shift: np.ndarray
    points: np.ndarray
    agreeing: np.ndarray
    first: np.ndarray
    second: np.ndarray
    link: np.ndarray
    shared: np.ndarray
    reach: float

    @cached_property
    def _at(self) -> list[dict[int, tuple[complex, complex]]]:
        """Of every photo k its links: other photo -> turn, shift from k to it."""
        out: list[dict[int, tuple[complex, complex]]] = [{} for _ in range(self.photos)]
        for a, b, t, s in zip(self.a.tolist(), self.b.tolist(), self.turn.tolist(), self.shift.tolist(), strict=True):
            out[a][b] = t, s
            out[b][a] = 1 / t, -s / t
        return out

    @cached_property
    def closed(self) -> np.ndarray:
        """(k,) whether a third photo says the same."""
        return np.array([any(self._open(a, b, k) < CLOSED for k in self._at[a].keys() & self._at[b].keys())
                         for a, b in zip(self.a.tolist(), self.b.tolist(), strict=True)], bool)

    def _open(self, a: int, b: int, k: int) -> float:
        """How far, over c, the way from a over k ends from where the link a, b does."""
        (t, s), (t1, s1), (t2, s2) = self._at[a][b], self._at[a][k], self._at[k][b]
        return max(abs(t2 * (t1 * q + s1) + s2 - t * q - s) for q in (0j, 0.5 * self.reach, 0.5j * self.reach))

    @cached_property
    def false(self) -> np.ndarray:
        """(k,) links that no third photo confirms, and whose photos' neighbours, which ought to see the same ground, do not or
        see it elsewhere."""
        sure = [set[int]() for _ in range(self.photos)]
        for a, b, ok in zip(self.a.tolist(), self.b.tolist(), self.closed.tolist(), strict=True):
            if ok:
                sure[a].add(b)
                sure[b].add(a)
        out = np.zeros(len(self.a), bool)
        for n in np.flatnonzero(~self.closed).tolist():
            a, b = int(self.a[n]), int(self.b[n])
            asked = [self._denies(k, x, y) for x, y in ((a, b), (b, a)) for k in sure[x] - {y} if self._meets(k, x, y)]
            out[n] = len(asked) >= 2 and sum(asked) > 0.7 * len(asked)
        return out

    def _denies(self, k: int, x: int, y: int) -> bool:
        """Whether photo k, linked to x, sees nothing of y, or y elsewhere than its link with x says."""
        return self.shared[k, y] <= 1 or (y in self._at[k] and self._open(x, y, k) > 3 * CLOSED)

    def _meets(self, k: int, x: int, y: int) -> bool:
        """Whether photo k, linked to x, should share half of a photo with y, if x and y are linked rightly."""
        t, s = self._at[k][x]
        u, v = self._at[x][y]
        return abs(u * s + v) < 0.5 * self.reach * max(1.0, abs(t * u))


def links(net: Network, seed: int = 1960) -> Links:
    """The links of a network's photos."""
    m = len(net.names)
    first, second = _pairs(net)
    key = net.image[first] * m + net.image[second]
    order = np.argsort(key, kind="stable")
    first, second, key = first[order], second[order], key[order]
    names, start, count = np.unique(key, return_index=True, return_counts=True)
    shared = np.zeros((m, m), np.int32)
    shared[names // m, names % m] = count
    shared += shared.T
    many = np.flatnonzero(count >= LEAST)
    q = net.q[:, 0] + 1j * net.q[:, 1]
    rng = np.random.default_rng(seed)
    turn, shift, agreeing = np.ones(len(many), complex), np.zeros(len(many), complex), np.zeros(len(many), int)
    for part in np.array_split(np.arange(len(many)), max(1, len(many) // 200)):
        begin, n = start[many[part]], count[many[part]]
        draw = (rng.random((3, len(part), max(DRAWS, LOOKED))) * n[:, None]).astype(int) + begin[:, None]
        i, j, some = draw[0, :, :DRAWS], draw[1, :, :DRAWS], draw[2, :, :LOOKED]
        few = n <= LOOKED
        some[few] = begin[few, None] + np.arange(LOOKED) % n[few, None]
        z, w = q[first], q[second]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (w[i] - w[j]) / (z[i] - z[j])
        t = np.where(np.isfinite(t) & (np.abs(t) > 0.2) & (np.abs(t) < 5), t, 0)
        off = np.abs(w[some][:, None] - w[i][:, :, None] - t[:, :, None] * (z[some][:, None] - z[i][:, :, None]))
        best = np.argmin(np.minimum(off, COARSE).sum(axis=2) + np.where(t == 0, np.inf, 0), axis=1)
        rows = np.arange(len(part))
        turn[part] = t[rows, best]
        shift[part] = w[i[rows, best]] - turn[part] * z[i[rows, best]]
    for k, (begin, n) in enumerate(zip(start[many].tolist(), count[many].tolist(), strict=True)):
        turn[k], shift[k], agreeing[k] = _settled(q[first[begin:begin + n]], q[second[begin:begin + n]], turn[k], shift[k])
    good = np.array([g >= LEAST and abs(t) > 0 and (g == n or chance(n, g) < CHANCE)
                     for g, n, t in zip(agreeing.tolist(), count[many].tolist(), turn.tolist(), strict=True)], bool)
    which = np.full(len(names), -1)
    which[many[good]] = np.arange(int(good.sum()))
    made = names[many[good]]
    return Links(m, made // m, made % m, turn[good], shift[good], count[many[good]], agreeing[good], first, second,
                 np.repeat(which, count), shared, float(np.abs(net.q).max(initial=0.0)))


def _settled(z: np.ndarray, w: np.ndarray, t: complex, s: complex) -> tuple[complex, complex, int]:
    """A similarity z -> w by least squares of those that agree, in turns, and how many do (Chum, Matas & Kittler 2003)."""
    agree = np.abs(t * z + s - w) < COARSE
    for _ in range(4):
        if agree.sum() < 2:
            break
        x, y = z[agree] - z[agree].mean(), w[agree] - w[agree].mean()
        if not np.abs(x).any():
            break
        t = complex(np.vdot(x, y) / np.vdot(x, x))
        s = complex(w[agree].mean() - t * z[agree].mean())
        was, agree = agree, np.abs(t * z + s - w) < COARSE
        if (was == agree).all():
            break
    return t, s, int(agree.sum())


def _pairs(net: Network) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of marks of one point (observations sorted by point, then photo)."""
    first, second = [], []
    for d in range(1, int(net.rays.max(initial=1))):
        k = np.flatnonzero(net.point[d:] == net.point[:-d])
        first.append(k)
        second.append(k + d)
    return (np.concatenate(first), np.concatenate(second)) if first else (np.zeros(0, int), np.zeros(0, int))


def agreeing_marks(net: Network, found: Links) -> np.ndarray:
    """(o,) observations that stay: of each point the largest group of marks that links do not tell apart. A mark that its links
    see far from where it is, and all that false links join, are told apart."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    q = net.q[:, 0] + 1j * net.q[:, 1]
    linked = found.link >= 0
    k, one, two = found.link[linked], found.first[linked], found.second[linked]
    off = np.abs(found.turn[k] * q[one] + found.shift[k] - q[two]) / np.maximum(1.0, np.abs(found.turn[k]))
    order = np.lexsort((off, k))
    ends = np.searchsorted(k[order], np.arange(len(found.a) + 1))
    middle = off[order][(ends[:-1] + ends[1:]) // 2] if len(k) else np.zeros(0)
    good = np.ones(len(found.link), bool)
    good[linked] = ~found.false[k] & (off < np.maximum(FAR, 4 * middle[k]))
    one, two = found.first[good], found.second[good]
    o = len(net.image)
    group = connected_components(csr_matrix((np.ones(len(one), np.int8), (one, two)), shape=(o, o)), directed=False)[1]
    size = np.bincount(group)[group]
    best = np.zeros(len(net.known), int)
    np.maximum.at(best, net.point, size)
    keep = (size == best[net.point]) & ((size > 1) | (net.rays[net.point] < 2))
    winner = np.full(len(net.known), -1)
    winner[net.point[keep]] = group[keep]  # of groups of one size, one
    return keep & (group == winner[net.point])


def without_false_links(data: Data) -> Data:
    """The same without marks that no other photo's agree with, and with a word on false links."""
    net = data.network("cauchy")
    found = links(net)
    gone = ~agreeing_marks(net, found)
    if not gone.any():
        return data
    said = []
    false = np.flatnonzero(found.false)
    if len(false):
        listed = ", ".join(f"'{data.names[found.a[k]]}' and '{data.names[found.b[k]]}' ({found.agreeing[k]} points)"
                           for k in false[:4].tolist()) + (" ..." if len(false) > 4 else "")
        pairs = f"{len(false)} pair{'s' * (len(false) > 1)}"
        said.append(f"tie points of {pairs} of photos agree with no other photo and were left out: {listed}; their "
                    "neighbours do not see the same ground")
    if (share := gone.mean()) > WORTH:
        said.append(f"{int(gone.sum())} of {len(gone)} marks ({share:.0%}) do not lie where their photos' other points say and "
                    "were left out: wrong matches")
    return data.without(net.image[gone], net.point[gone], said)


__all__ = ["Links", "agreeing_marks", "links", "without_false_links"]
