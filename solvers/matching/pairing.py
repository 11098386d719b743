"""Which photos to compare, and which of their features look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .features import Features

VOTERS = 400
"""Largest features of a photo that vote for its neighbours."""
_WORDS, _SHORTLIST = 32, 40  # visual words of the global descriptor; photos kept by it for the vote
_VOTES = 6  # least votes for a pair


def unit_descriptors(features: Features, root: bool = True) -> np.ndarray:
    """(N, d) float32 of length 1, whose products compare features. root: RootSIFT, square roots of L1-normalised numbers."""
    if features.binary:
        signs = np.unpackbits(features.descriptor, axis=1).astype(np.float32) * 2 - 1
        return signs / np.sqrt(np.float32(max(signs.shape[1], 1)))
    d = features.descriptor.astype(np.float32)
    if root:
        return np.sqrt(d / np.maximum(d.sum(1, keepdims=True), 1e-9))
    return d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)


def match_descriptors(a: np.ndarray, b: np.ndarray, ratio: float = 0.8, expected: np.ndarray | None = None,
                      pixel: np.ndarray | None = None, radius: float = np.inf, chunk: int = 1024) -> np.ndarray:
    """(M, 2) indices of descriptors (n, d), (m, d) of length 1 that are each other's nearest, nearer than `ratio` times the
    distance of the second nearest in b.

    expected (n, 2) px in b's photo, pixel (m, 2): where known, only features within `radius` px are compared.
    Reference: Lowe 2004, 7.1.
    """
    if len(a) < 2 or len(b) < 2:
        return np.empty((0, 2), int)
    best, first, second = np.empty(len(a), int), np.empty(len(a), np.float32), np.empty(len(a), np.float32)
    top = np.full(len(b), -1, np.float32)
    for i in range(0, len(a), chunk):
        score = a[i : i + chunk] @ b.T
        if expected is not None and pixel is not None:
            score[~_within(expected[i : i + chunk], pixel, radius)] = -1.0
        top = np.maximum(top, score.max(0))
        line, part = np.arange(len(score)), slice(i, i + chunk)
        best[part] = score.argmax(1)
        first[part] = score[line, best[part]]
        score[line, best[part]] = -1.0
        second[part] = score.max(1)
    mutual = (first > -1) & (first >= top[best])
    good = np.flatnonzero(mutual & (1 - first < ratio**2 * (1 - second)))  # |u - v|^2 = 2 (1 - u v)
    return np.stack([good, best[good]], 1)


def _within(a: np.ndarray, b: np.ndarray, radius: float) -> np.ndarray:
    """(n, m) whether places (n, 2), (m, 2) lie within a square of this half side."""
    a, b = a.astype(np.float32), b.astype(np.float32)
    return (np.abs(a[:, None, 0] - b[:, 0]) < radius) & (np.abs(a[:, None, 1] - b[:, 1]) < radius)


def pairs_by_position(position: np.ndarray, neighbours: int) -> set[tuple[int, int]]:
    """Each photo with its nearest ones on the map: position (N, 2 or more) m, NaN rows have none."""
    known = np.flatnonzero(np.isfinite(position[:, :2]).all(1))
    if len(known) < 2:
        return set()
    from scipy.spatial import KDTree

    count = min(neighbours + 1, len(known))
    near = np.asarray(KDTree(position[known, :2]).query(position[known, :2], count)[1])
    return {(int(known[min(i, j)]), int(known[max(i, j)])) for i in range(len(known)) for j in near[i].tolist() if j != i}


def voters(features: Features, root: bool = True) -> np.ndarray:
    """(VOTERS, d) float16 descriptors of the largest features: they are seen again from elsewhere most often."""
    order = np.argsort(-features.scale, kind="stable")[:VOTERS]
    return unit_descriptors(features, root)[order].astype(np.float16)


def pairs_by_vote(ballots: Sequence[np.ndarray], neighbours: int, group: np.ndarray | None = None,
                  only: np.ndarray | None = None) -> set[tuple[int, int]]:
    """Each photo with those that share most of its large features.

    A global descriptor (VLAD) makes a short list of every photo, its voters then match those of the listed ones. group (N,):
    only pairs between groups; only (N,): only pairs with one of these. Reference: Jegou et al. 2010; Wu 2013.
    """
    count = len(ballots)
    allowed = ~np.eye(count, dtype=bool)
    if group is not None:
        allowed &= group[:, None] != group
    if only is not None:
        allowed &= only[:, None] | only
    alike = np.where(allowed, _likeness(ballots) if count > _SHORTLIST + 1 else 1.0, -np.inf)
    listed = np.argsort(-alike, 1, kind="stable")[:, :_SHORTLIST]
    candidates = {(min(i, int(j)), max(i, int(j))) for i in range(count) for j in listed[i] if allowed[i, j]}
    votes = np.zeros((count, count))
    for i, j in sorted(candidates):
        votes[i, j] = votes[j, i] = len(match_descriptors(ballots[i].astype(np.float32), ballots[j].astype(np.float32), 0.85))
    chosen = np.argsort(-votes, 1, kind="stable")[:, :neighbours]
    return {(min(i, int(j)), max(i, int(j))) for i in range(count) for j in chosen[i] if votes[i, j] >= _VOTES}


def _likeness(ballots: Sequence[np.ndarray]) -> np.ndarray:
    """(N, N) products of the photos' VLAD descriptors."""
    import cv2

    sample = np.concatenate([b[:: max(1, len(b) * len(ballots) // 20000)] for b in ballots]).astype(np.float32)
    if len(sample) <= _WORDS:
        return np.ones((len(ballots), len(ballots)))
    cv2.setRNGSeed(0)
    criteria = (cv2.TERM_CRITERIA_MAX_ITER + cv2.TERM_CRITERIA_EPS, 12, 1e-3)
    _, _, words = cv2.kmeans(sample, _WORDS, np.empty(0, np.int32), criteria, 1, cv2.KMEANS_PP_CENTERS)
    rows = []
    for ballot in ballots:
        d = ballot.astype(np.float32)
        word = (d @ words.T - 0.5 * (words**2).sum(1)).argmax(1)
        total = np.zeros_like(words)
        np.add.at(total, word, d - words[word])
        total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)
        rows.append(total.ravel() / max(float(np.linalg.norm(total)), 1e-9))
    table = np.array(rows)
    return table @ table.T
