"""A direct solver for block-sparse symmetric positive definite matrices: nested dissection, dense fronts, selected inverse.

The nodes of a graph (images) carry square blocks of one size. The graph is halved again and again by small sets of nodes that
separate it; every separator becomes one dense front, so all the arithmetic is LAPACK's and the bookkeeping is small.

Reference: George 1973, "Nested dissection of a regular finite element mesh"; Duff & Reid 1983, "The multifrontal solution";
Takahashi, Fagan & Chin 1973 (the entries of the inverse where the matrix is not zero).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

LEAF = 96
"""Nodes that are factored in one piece."""


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
    stored. fronts: in the order of elimination, children before parents."""

    count: int
    size: int
    row: np.ndarray
    column: np.ndarray
    fronts: tuple[Front, ...]

    @classmethod
    def of(cls, count: int, size: int, row: np.ndarray, column: np.ndarray, leaf: int = LEAF) -> Pattern:
        """Analyse the blocks (row, column) of a matrix of `count` nodes with blocks of size x size."""
        return cls(count, size, row, column, tuple(_fronts(count, row, column, leaf)))


class Factor:
    """Cholesky factor of a matrix given as blocks (b, size, size) of a pattern.

    Raises numpy.linalg.LinAlgError where the matrix is not positive definite.
    """

    def __init__(self, pattern: Pattern, blocks: np.ndarray) -> None:
        dpotrf, dtrsm, dsyrk, _ = _lapack()
        self.pattern = pattern
        self._lower: list[tuple[np.ndarray, np.ndarray]] = []  # L11 and L21 of every front, Fortran order
        waiting: dict[int, list[tuple[Front, np.ndarray]]] = {}
        for k, front in enumerate(pattern.fronts):
            a11, a12, a22 = _assembled(pattern, front, blocks, waiting.pop(k, []))
            l11, info = dpotrf(a11.T, lower=1, overwrite_a=1, clean=1)
            if info:
                raise np.linalg.LinAlgError(f"not positive definite at node {front.own[(info - 1) // pattern.size]}")
            l21 = a12.T
            if len(front.border):
                l21 = dtrsm(1.0, l11, l21, side=1, lower=1, trans_a=1, overwrite_b=1)
                update = dsyrk(-1.0, l21, beta=1.0, c=a22.T, lower=1, overwrite_c=1)
                waiting.setdefault(front.parent, []).append((front, update.T))
            self._lower.append((l11, l21))

    def solve(self, b: np.ndarray) -> np.ndarray:
        """(n, r) solution of A x = b for right sides (n, r)."""
        from scipy.linalg import solve_triangular

        s, x = self.pattern.size, np.array(b, float)
        x = x.reshape(self.pattern.count, s, -1)
        r = x.shape[2]
        for front, (l11, l21) in zip(self.pattern.fronts, self._lower, strict=True):
            y = solve_triangular(l11, x[front.own].reshape(-1, r), lower=True, check_finite=False)
            x[front.own] = y.reshape(-1, s, r)
            if len(front.border):
                x[front.border] -= (l21 @ y).reshape(-1, s, r)
        for front, (l11, l21) in zip(reversed(self.pattern.fronts), reversed(self._lower), strict=True):
            y = x[front.own].reshape(-1, r)
            if len(front.border):
                y = y - l21.T @ x[front.border].reshape(-1, r)
            x[front.own] = solve_triangular(l11, y, lower=True, trans=1, check_finite=False).reshape(-1, s, r)
        return x.reshape(np.shape(b))

    def selected_inverse(self) -> np.ndarray:
        """(b, size, size) blocks of the inverse at the places of the pattern's blocks; no other is ever formed for the whole."""
        _, dtrsm, _, dpotri = _lapack()
        p, s = self.pattern, self.pattern.size
        out = np.empty((len(p.row), s, s))
        kept: dict[int, np.ndarray] = {}
        children = np.bincount([f.parent for f in p.fronts if f.parent >= 0], minlength=len(p.fronts))
        for k in range(len(p.fronts) - 1, -1, -1):
            front, (l11, l21) = p.fronts[k], self._lower[k]
            n1, n2 = len(front.own) * s, len(front.border) * s
            z = np.empty((n1 + n2, n1 + n2))
            inverse, _ = dpotri(l11, lower=1)
            z[:n1, :n1] = np.tril(inverse) + np.tril(inverse, -1).T
            if n2:
                parent = kept[front.parent]
                index = _expand(front.place, s)
                z[n1:, n1:] = parent[np.ix_(index, index)]
                y = dtrsm(1.0, l11, l21, side=1, lower=1)  # L21 L11^-1
                z[n1:, :n1] = -z[n1:, n1:] @ y
                z[:n1, n1:] = z[n1:, :n1].T
                z[:n1, :n1] -= y.T @ z[n1:, :n1]
                children[front.parent] -= 1
                if not children[front.parent]:
                    del kept[front.parent]
            found = z.reshape(n1 // s + n2 // s, s, -1, s)[front.at[:, 0], :, front.at[:, 1], :]
            found[front.flip] = np.swapaxes(found[front.flip], 1, 2)
            out[front.blocks] = found
            if children[k]:
                kept[k] = z
        return out


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
    for child, update in children:
        head = int((child.place < n1).sum())
        here, there = _expand(child.place[:head], s), _expand(child.place[head:] - n1, s)
        h = head * s
        a11[here[:, None], here] += update[:h, :h]
        a12[here[:, None], there] += update[:h, h:]
        a22[there[:, None], there] += update[h:, h:]
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
    far = _distance(graph, 0)
    one = _distance(graph, int(np.argmax(far)))
    other = _distance(graph, int(np.argmax(one)))
    rank = (one - other).astype(float)
    rank += 1e-3 * one / max(one.max(), 1)
    order = np.argsort(rank, kind="stable")
    n, best, least = len(order), None, np.inf
    for share in (0.4, 0.45, 0.5, 0.55, 0.6):
        left = np.zeros(n, bool)
        left[order[:int(share * n)]] = True
        from_left = (graph @ (~left).astype(np.int32) > 0) & left  # nodes of the left that touch the right
        from_right = (graph @ left.astype(np.int32) > 0) & ~left
        between = from_left if from_left.sum() <= from_right.sum() else from_right
        a, b = int((left & ~between).sum()), int((~left & ~between).sum())
        if min(a, b) and (size := between.sum() * (1 + 0.5 * abs(a - b) / n)) < least:
            least, best = size, np.where(between, 1, np.where(left, 0, 2))
    return best if best is not None and (best == 1).sum() < 0.6 * n else None


def _distance(graph, start: int) -> np.ndarray:
    """(n,) steps from a node to every other of a connected graph."""
    from scipy.sparse.csgraph import dijkstra

    return dijkstra(graph, unweighted=True, indices=start)
