"""A direct solver for block-sparse symmetric positive definite matrices: nested dissection, dense fronts, selected inverse.

The nodes of a graph (images) carry square blocks of one size. The graph is halved again and again by small sets of nodes that
separate it; every separator becomes one dense front, so all the arithmetic is LAPACK's and the bookkeeping is small.

Reference: George 1973, "Nested dissection of a regular finite element mesh"; Duff & Reid 1983, "The multifrontal solution";
Takahashi, Fagan & Chin 1973 (the entries of the inverse where the matrix is not zero).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache, cached_property
from heapq import heappop, heappush
from typing import Any

import numpy as np

LEAF = 64
"""Nodes that are factored in one piece."""
LOOSELY: dict[str, Any] = {"tol": 1e-2}
"""How exactly the slowest wave over a graph need be known to cut it."""
SHARES = (0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65)
"""Of the nodes, those on one side of a cut that are tried."""
WIDE = 2400
"""Rows of a front from which LAPACK may use several threads; below, waking them costs more than they do."""


@dataclass(frozen=True)
class Front:
    """One dense piece of the elimination. own, border: nodes eliminated here, and those later ones that they touch.

    blocks: rows of the pattern whose first eliminated node is own; at (b, 2): their place in the front, (row, column), counted in
    nodes, own before border; flip (b,): taken transposed. parent: front that receives the border's update, -1 for none.
    place: where the border's nodes lie in the parent, counted in nodes of its own, then border.
    """

    own: np.ndarray
    border: np.ndarray
    blocks: np.ndarray
    at: np.ndarray
    flip: np.ndarray
    parent: int
    place: np.ndarray


@dataclass(frozen=True)
class Pattern:
    """Which blocks of a symmetric matrix are not zero. row <= column (b,): nodes of each stored block; every diagonal block is
    stored. fronts: in the order of elimination, children before parents; threads: how many may work at once."""

    count: int
    size: int
    row: np.ndarray
    column: np.ndarray
    fronts: tuple[Front, ...]
    threads: int = 1

    @classmethod
    def of(cls, count: int, size: int, row: np.ndarray, column: np.ndarray, leaf: int = LEAF, threads: int = 1) -> Pattern:
        """Analyse the blocks (row, column) of a matrix of `count` nodes with blocks of size x size; threads may work on it."""
        return cls(count, size, row, column, tuple(_fronts(count, row, column, leaf)), threads)

    @cached_property
    def children(self) -> tuple[int, ...]:
        """How many fronts each front is the parent of."""
        return tuple(np.bincount([f.parent for f in self.fronts if f.parent >= 0], minlength=len(self.fronts)).tolist())


class Factor:
    """Cholesky factor of a matrix given as blocks (b, size, size) of a pattern; fronts that do not touch work side by side.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite.
    """

    def __init__(self, pattern: Pattern, blocks: np.ndarray) -> None:
        self.pattern = pattern
        self._lower: list[tuple[np.ndarray, np.ndarray]] = [_NOTHING] * len(pattern.fronts)  # L11, L21 of every front
        waiting: dict[int, list[tuple[Front, np.ndarray]]] = {}

        def eliminate(k: int) -> None:
            front = pattern.fronts[k]
            children = sorted(waiting.pop(k, []), key=lambda c: c[0].own[0])  # one order of adding: the same digits every time
            self._lower[k], update = self._eliminated(pattern, front, blocks, children)
            if update is not None:
                waiting.setdefault(front.parent, []).append((front, update))

        _climb(pattern, eliminate)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """(n, r) solution of A x = b for right sides (n, r)."""
        with alone():
            return self._solved(np.array(b, float)).reshape(np.shape(b))

    def _solved(self, b: np.ndarray) -> np.ndarray:
        s, (_, dtrsm, _, _) = self.pattern.size, _lapack()
        x = b.reshape(self.pattern.count, s, -1)
        r = x.shape[2]
        for front, (l11, l21) in zip(self.pattern.fronts, self._lower, strict=True):
            y = dtrsm(1.0, l11, x[front.own].reshape(-1, r), lower=1)
            x[front.own] = y.reshape(-1, s, r)
            if len(front.border):
                x[front.border] -= (l21 @ y).reshape(-1, s, r)
        for front, (l11, l21) in zip(reversed(self.pattern.fronts), reversed(self._lower), strict=True):
            y = x[front.own].reshape(-1, r)
            if len(front.border):
                y = y - l21.T @ x[front.border].reshape(-1, r)
            x[front.own] = dtrsm(1.0, l11, y, lower=1, trans_a=1).reshape(-1, s, r)
        return x

    def selected_inverse(self) -> np.ndarray:
        """(b, size, size) blocks of the inverse at the places of the pattern's blocks; no other is ever formed for the whole."""
        p, s = self.pattern, self.pattern.size
        out = np.empty((len(p.row), s, s))
        kept: dict[int, np.ndarray] = {}

        def invert(k: int) -> None:
            front = p.fronts[k]
            z = self._inverted(front, *self._lower[k], kept.get(front.parent), s)
            found = z.reshape(len(z) // s, s, -1, s)[front.at[:, 0], :, front.at[:, 1], :]
            found[front.flip] = np.swapaxes(found[front.flip], 1, 2)
            out[front.blocks] = found
            if p.children[k]:
                kept[k] = z

        _descend(p, invert, lambda k: kept.pop(k, None))
        return out

    def _eliminated(self, pattern: Pattern, front: Front, blocks: np.ndarray, children: list[tuple[Front, np.ndarray]],
                    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray | None]:
        """L11 and L21 of a front in Fortran order, and what it passes on to its parent."""
        dpotrf, dtrsm, dsyrk, _ = _lapack()
        a11, a12, a22 = _assembled(pattern, front, blocks, children)
        l11, info = dpotrf(a11.T, lower=1, overwrite_a=1, clean=1)
        if info:
            raise np.linalg.LinAlgError(f"not positive definite at node {front.own[(info - 1) // pattern.size]}")
        if not len(front.border):
            return (l11, a12.T), None
        l21 = dtrsm(1.0, l11, a12.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        return (l11, l21), dsyrk(-1.0, l21, beta=1.0, c=a22.T, lower=1, overwrite_c=1).T

    def _inverted(self, front: Front, l11: np.ndarray, l21: np.ndarray, parent: np.ndarray | None, size: int) -> np.ndarray:
        """The inverse over a front's own nodes and its border, from that of its parent."""
        _, dtrsm, _, dpotri = _lapack()
        n1, n2 = len(front.own) * size, len(front.border) * size
        z = np.empty((n1 + n2, n1 + n2))
        inverse, _ = dpotri(l11, lower=1)
        z[:n1, :n1] = np.tril(inverse) + np.tril(inverse, -1).T
        if parent is not None and n2:
            index = _expand(front.place, size)
            z[n1:, n1:] = parent[np.ix_(index, index)]
            y = dtrsm(1.0, l11, l21, side=1, lower=1)  # L21 L11^-1
            z[n1:, :n1] = -z[n1:, n1:] @ y
            z[:n1, n1:] = z[n1:, :n1].T
            z[:n1, :n1] -= y.T @ z[n1:, :n1]
        return z


class Indefinite(Factor):
    """The same of a symmetric matrix that need not be positive: the own nodes of every front are inverted as one block, with
    pivots. `_lower` holds A11^-1 and A21 A11^-1. Raises numpy.linalg.LinAlgError where such a block is singular."""

    def _eliminated(self, pattern: Pattern, front: Front, blocks: np.ndarray, children: list[tuple[Front, np.ndarray]],
                    ) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray | None]:
        a11, a12, a22 = _assembled(pattern, front, blocks, children)
        inverse = np.linalg.inv(np.triu(a11) + np.triu(a11, 1).T)
        inverse = (inverse + inverse.T) / 2
        l21 = a12.T @ inverse
        return (inverse, l21), a22 - l21 @ a12 if len(front.border) else None

    def _solved(self, b: np.ndarray) -> np.ndarray:
        s = self.pattern.size
        x = b.reshape(self.pattern.count, s, -1)
        r = x.shape[2]
        for front, (_, l21) in zip(self.pattern.fronts, self._lower, strict=True):
            if len(front.border):
                x[front.border] -= (l21 @ x[front.own].reshape(-1, r)).reshape(-1, s, r)
        for front, (inverse, l21) in zip(reversed(self.pattern.fronts), reversed(self._lower), strict=True):
            y = inverse @ x[front.own].reshape(-1, r)
            if len(front.border):
                y -= l21.T @ x[front.border].reshape(-1, r)
            x[front.own] = y.reshape(-1, s, r)
        return x

    def _inverted(self, front: Front, l11: np.ndarray, l21: np.ndarray, parent: np.ndarray | None, size: int) -> np.ndarray:
        n1, n2 = len(front.own) * size, len(front.border) * size
        z = np.empty((n1 + n2, n1 + n2))
        z[:n1, :n1] = l11
        if parent is not None and n2:
            index = _expand(front.place, size)
            z[n1:, n1:] = parent[np.ix_(index, index)]
            z[n1:, :n1] = -z[n1:, n1:] @ l21
            z[:n1, n1:] = z[n1:, :n1].T
            z[:n1, :n1] -= l21.T @ z[n1:, :n1]
        return z


_NOTHING = (np.empty((0, 0)), np.empty((0, 0)))


def _climb(pattern: Pattern, work: Callable[[int], None]) -> None:
    """work(front) for every front, children before their parent, independent ones at once."""
    left = list(pattern.children)
    parents = [f.parent for f in pattern.fronts]

    def ready(k: int) -> list[int]:
        if (parent := parents[k]) < 0:
            return []
        left[parent] -= 1
        return [parent] if not left[parent] else []

    _together(pattern, work, [k for k, c in enumerate(left) if not c], ready, 1)


def _descend(pattern: Pattern, work: Callable[[int], None], release: Callable[[int], object]) -> None:
    """work(front) for every front, the parent before its children; release(front) when its last child is done."""
    left = list(pattern.children)
    below: dict[int, list[int]] = {}
    for k, front in enumerate(pattern.fronts):
        below.setdefault(front.parent, []).append(k)

    def ready(k: int) -> list[int]:
        if (parent := pattern.fronts[k].parent) >= 0:
            left[parent] -= 1
            if not left[parent]:
                release(parent)
        return below.get(k, [])

    _together(pattern, work, below.get(-1, []), ready, -1)


def _together(pattern: Pattern, work: Callable[[int], None], first: Sequence[int], ready: Callable[[int], list[int]],
              way: int) -> None:
    """Run work on fronts as they get ready: small ones side by side, wide ones one at a time with LAPACK's own threads.

    way: 1 for the lowest first, -1 for the highest.
    """
    size = [(len(f.own) + len(f.border)) * pattern.size for f in pattern.fronts]
    small: list[int] = []
    wide: list[int] = []

    def put(fronts: Sequence[int]) -> None:  # the tree's own order keeps the fewest fronts in memory
        for k in fronts:
            heappush(wide if size[k] >= WIDE and pattern.threads > 1 else small, k * way)

    put(first)
    many = pattern.threads > 1 and len(size) > 3
    with ThreadPoolExecutor(pattern.threads) if many else nullcontext() as pool:
        while small or wide:
            with alone():
                running: dict[Future[None], int] = {}
                while small or running:
                    while small and len(running) < pattern.threads:
                        k = abs(heappop(small))
                        if pool is None:
                            work(k)
                            put(ready(k))
                        else:
                            running[pool.submit(work, k)] = k
                    for future in wait(running, return_when=FIRST_COMPLETED).done if running else ():
                        future.result()
                        put(ready(running.pop(future)))
            if wide:
                k = abs(heappop(wide))
                work(k)
                put(ready(k))


def alone() -> Any:
    """A context in which LAPACK and BLAS use one thread: waking more for little work, they wait in a busy loop."""
    return _blas().limit(limits=1, user_api="blas")


@cache
def _blas() -> Any:
    import scipy.linalg  # noqa: F401  (brings a library of its own, which is to be found)
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@cache
def _lapack() -> tuple[Any, Any, Any, Any]:
    """dpotrf, dtrsm, dsyrk, dpotri of scipy."""
    from scipy.linalg import get_blas_funcs, get_lapack_funcs

    at = np.zeros((1, 1))
    (potrf, potri), (trsm, syrk) = get_lapack_funcs(("potrf", "potri"), (at,)), get_blas_funcs(("trsm", "syrk"), (at,))
    return potrf, trsm, syrk, potri


def _assembled(pattern: Pattern, front: Front, blocks: np.ndarray,
               children: list[tuple[Front, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A11, A12, A22 of a front, upper triangles, C order: its own blocks and what its children pass on."""
    s, n1, n2 = pattern.size, len(front.own), len(front.border)
    a11, a12, a22 = np.zeros((n1, s, n1, s)), np.zeros((n1, s, n2, s)), np.zeros((n2 * s, n2 * s))
    values = blocks[front.blocks]
    values[front.flip] = np.swapaxes(values[front.flip], 1, 2)
    inner = front.at[:, 1] < n1
    a11[front.at[inner, 0], :, front.at[inner, 1], :] = values[inner]
    a12[front.at[~inner, 0], :, front.at[~inner, 1] - n1, :] = values[~inner]
    a11, a12 = a11.reshape(n1 * s, n1 * s), a12.reshape(n1 * s, n2 * s)
    if children:
        from ._kernels import extend

        for child, update in children:
            extend(a11, a12, a22, child.place, update, s)
    return a11, a12, a22


def _expand(nodes: np.ndarray, size: int) -> np.ndarray:
    """Rows of nodes."""
    return (nodes[:, None] * size + np.arange(size)).ravel()


# -- analysis ---------------------------------------------------------------------------------------------------------------


def _fronts(count: int, row: np.ndarray, column: np.ndarray, leaf: int) -> Iterator[Front]:
    from scipy.sparse import csr_matrix

    off = row != column
    i, j = row[off], column[off]
    graph = csr_matrix((np.ones(2 * len(i), np.int8), (np.r_[i, j], np.r_[j, i])), shape=(count, count))
    tree: list[tuple[np.ndarray, int]] = []  # nodes and parent of every piece, parents after children
    _dissect(graph, np.arange(count), leaf, tree)
    parents = np.array([p for _, p in tree])
    piece, position = np.empty(count, int), np.empty(count, int)
    position[np.concatenate([own for own, _ in tree])] = np.arange(count)
    for k, (own, _) in enumerate(tree):
        piece[own] = k
    borders: list[np.ndarray] = []
    for k, (own, _) in enumerate(tree):
        touched = [graph[own].indices, *(borders[c] for c in np.flatnonzero(parents == k))]
        border = np.unique(np.concatenate(touched))
        border = border[piece[border] > k]
        borders.append(border[np.argsort(position[border])])
    swap = position[row] > position[column]
    first, last = np.where(swap, column, row), np.where(swap, row, column)
    order = np.argsort(piece[first], kind="stable")
    ends = np.searchsorted(piece[first][order], np.arange(len(tree) + 1))
    local = np.full(count, -1)
    for k, (own, parent) in enumerate(tree):
        blocks = order[ends[k]:ends[k + 1]]
        local[own], local[borders[k]] = np.arange(len(own)), len(own) + np.arange(len(borders[k]))
        at = np.stack([local[first[blocks]], local[last[blocks]]], axis=1)
        place = np.zeros(0, int)
        if parent >= 0:
            above = tree[parent][0]
            local[above], local[borders[parent]] = np.arange(len(above)), len(above) + np.arange(len(borders[parent]))
            place = local[borders[k]]
        yield Front(own, borders[k], blocks, at, swap[blocks], parent, place)


def _dissect(graph, nodes: np.ndarray, leaf: int, tree: list[tuple[np.ndarray, int]]) -> list[int]:
    """Append the pieces of `nodes` to the tree, children first; gives back the roots, whose parent is still to be set."""
    cut = None if len(nodes) <= leaf else _separator(graph[nodes][:, nodes])
    if cut is None:
        tree.append((nodes, -1))
        return [len(tree) - 1]
    roots = [r for side in (cut == 0, cut == 2) if side.any() for r in _dissect(graph, nodes[side], leaf, tree)]
    if not (cut == 1).any():
        return roots
    tree.append((nodes[cut == 1], -1))
    for r in roots:
        tree[r] = (tree[r][0], len(tree) - 1)
    return [len(tree) - 1]


def _separator(graph) -> np.ndarray | None:
    """(n,) 0 and 2 for two sides that do not touch, 1 for the nodes between; None where no useful cut exists."""
    from scipy.sparse.csgraph import connected_components

    parts, label = connected_components(graph, directed=False)
    if parts > 1:
        sizes = np.bincount(label)
        return np.where(label == np.argmax(sizes), 0, 2)
    n, best, least = graph.shape[0], None, np.inf
    for rank in _ranks(graph):
        order = np.argsort(rank, kind="stable")
        for share in SHARES:
            left = np.zeros(n, bool)
            left[order[:int(share * n)]] = True
            between = _cover(graph, left)
            a, b = int((left & ~between).sum()), int((~left & ~between).sum())
            if min(a, b) and (size := between.sum() * (1 + 0.5 * abs(a - b) / n)) < least:
                least, best = size, np.where(between, 1, np.where(left, 0, 2))
    return best if best is not None and (best == 1).sum() < 0.6 * n else None


def _ranks(graph) -> Iterator[np.ndarray]:
    """Orders (n,) of the nodes of a connected graph from one end to the other: by distance from two far nodes, and by
    the slowest wave (the second eigenvector of its Laplacian)."""
    far = _distance(graph, 0)
    one = _distance(graph, int(np.argmax(far)))
    other = _distance(graph, int(np.argmax(one)))
    yield (one - other) + 1e-3 * one / max(one.max(), 1)
    n = graph.shape[0]
    if n > 16:
        from scipy.sparse import diags
        from scipy.sparse.linalg import ArpackError, eigsh

        scale = 1 / np.sqrt(np.maximum(np.asarray(graph.sum(axis=1), float).ravel(), 1))
        try:
            begin = (one - other) / scale + 1e-3
            matrix = diags(scale) @ graph.astype(float) @ diags(scale)
            yield scale * eigsh(matrix, k=2, which="LA", v0=begin, maxiter=300, **LOOSELY)[1][:, 0]
        except ArpackError:  # the other order serves
            return


def _cover(graph, left: np.ndarray) -> np.ndarray:
    """(n,) the fewest nodes that touch every edge between the left side and the rest (König: from a largest matching)."""
    from scipy.sparse.csgraph import maximum_bipartite_matching

    rows, columns = np.flatnonzero(left), np.flatnonzero(~left)
    across = graph[rows][:, columns]
    rows = rows[touched := np.flatnonzero(np.diff(across.indptr))]
    across = across[touched]
    used = np.unique(across.indices)
    across, columns = across[:, used], columns[used]
    partner = maximum_bipartite_matching(across, perm_type="column")
    back = np.full(len(columns), -1)
    back[partner[partner >= 0]] = np.flatnonzero(partner >= 0)
    reached, met = partner < 0, np.zeros(len(columns), bool)
    front = np.flatnonzero(reached)
    while len(front):  # along edges without, then with a partner
        new = np.unique(across[front].indices)
        new = new[~met[new]]
        met[new] = True
        front = back[new][back[new] >= 0]
        front = front[~reached[front]]
        reached[front] = True
    out = np.zeros(len(left), bool)
    out[rows[~reached]] = True
    out[columns[met]] = True
    return out


def _distance(graph, start: int) -> np.ndarray:
    """(n,) steps from a node to every other of a connected graph."""
    from scipy.sparse.csgraph import dijkstra

    return dijkstra(graph, unweighted=True, indices=start)
