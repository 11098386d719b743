"""What a registration adjusts, as parallel arrays: tie points and control points seen in photos of a plane.

Image coordinates are ideal photo coordinates over the principal distance (x right, y up, no unit): distortion and principal
point are removed once, before everything else. Weights bring them to standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..adjustment.schur import Pattern
from ..cameras import Interior


@dataclass(frozen=True)
class Network:
    """m photos, n points, o observations sorted by point.

    image, point (o,); q (o, 2): ideal photo coordinates over c; weight (o, 2): their inverse standard errors. known (n, 2):
    given X, Y, NaN where none; weight_xy (n, 2): inverse variances, 0 where free. lift (n,): height of a point above the
    mosaic plane. held (m,): photos that stay where they are. loss: of the image observations, None for least squares.
    """

    names: tuple[str, ...]
    image: np.ndarray
    point: np.ndarray
    q: np.ndarray
    weight: np.ndarray
    known: np.ndarray
    weight_xy: np.ndarray
    lift: np.ndarray
    held: np.ndarray
    loss: str | None = None

    @classmethod
    def of(cls, names: Sequence[str], interiors: Sequence[Interior], image: np.ndarray, point: np.ndarray, pixels: np.ndarray,
           sigma: np.ndarray, *, known: np.ndarray | None = None, sigma_xy: np.ndarray | None = None,
           lift: np.ndarray | None = None, held: Sequence[int] = (), loss: str | None = None) -> Network:
        """From measured pixels (o, 2), their sigma (o,) and, for control, known X, Y (n, 2) with sigma_xy (n, 2)."""
        order = np.lexsort((image, point))
        image, point = np.asarray(image, int)[order], np.asarray(point, int)[order]
        n = max(int(point.max(initial=-1)) + 1, 0 if known is None else len(known))
        q, scale = normalized(interiors, image, np.asarray(pixels, float)[order])
        known = np.full((n, 2), np.nan) if known is None else np.asarray(known, float)
        given = np.isfinite(known).all(axis=1)
        weight_xy = np.zeros((n, 2))
        if given.any():
            assert sigma_xy is not None
            weight_xy[given] = 1 / np.maximum(np.asarray(sigma_xy, float)[given], 1e-9) ** 2
        fixed = np.zeros(len(names), bool)
        fixed[list(held)] = True
        return cls(tuple(names), image, point, q, scale / np.asarray(sigma, float)[order][:, None], known, weight_xy,
                   np.zeros(n) if lift is None else np.asarray(lift, float), fixed, loss)

    @cached_property
    def start(self) -> np.ndarray:
        """(n + 1,) first observation of each point."""
        return np.searchsorted(self.point, np.arange(len(self.known) + 1)).astype(np.int64)

    @cached_property
    def rays(self) -> np.ndarray:
        """(n,) photos that see each point."""
        return np.diff(self.start)

    @cached_property
    def live(self) -> np.ndarray:
        """Photos that move."""
        return np.flatnonzero(~self.held)

    @cached_property
    def node(self) -> np.ndarray:
        """(m,) place of a photo among those that move, -1 for one that is held."""
        out = np.full(len(self.names), -1)
        out[self.live] = np.arange(len(self.live))
        return out

    @property
    def observed(self) -> int:
        """Scalar observations: image coordinates and weighted control coordinates."""
        return 2 * len(self.image) + int((self.weight_xy > 0).sum())

    def patterns(self, size: int) -> Pattern:
        """Which moving photos share points, in blocks of size x size."""
        row, column = self._pairs
        return Pattern.of(len(self.live), size, row, column)

    @cached_property
    def _pairs(self) -> tuple[np.ndarray, np.ndarray]:
        from scipy.sparse import csr_matrix

        m, node = len(self.live), self.node[self.image]
        ok = node >= 0
        seen = csr_matrix((np.ones(int(ok.sum()), np.int32), (node[ok], self.point[ok])), shape=(m, len(self.known)))
        shared = (seen @ seen.T + csr_matrix((np.ones(m, np.int32), (np.arange(m), np.arange(m))), shape=(m, m))).tocoo()
        upper = shared.row <= shared.col
        row, column = shared.row[upper].astype(np.int64), shared.col[upper].astype(np.int64)
        order = np.lexsort((column, row))
        return row[order], column[order]

    def keeping(self, rows: np.ndarray) -> Network:
        """The same with some of the observations (a mask or indices)."""
        rows = np.flatnonzero(rows) if rows.dtype == bool else np.sort(rows)
        return replace(self, image=self.image[rows], point=self.point[rows], q=self.q[rows], weight=self.weight[rows])

    def usable(self) -> Network:
        """Without observations of points that nothing else sees: seen once and not known."""
        enough = (self.rays >= 2) | ((self.rays >= 1) & (self.weight_xy > 0).any(axis=1))
        return self.keeping(enough[self.point])


def normalized(interiors: Sequence[Interior], image: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ideal photo coordinates over c (o, 2) of measured pixels, and c in pixels (o, 2) for x and y."""
    q, scale = np.empty_like(pixels), np.empty_like(pixels)
    different: dict[Interior, list[int]] = {}
    for k, interior in enumerate(interiors):
        different.setdefault(interior, []).append(k)
    for interior, photos in different.items():
        rows = np.isin(image, photos)
        q[rows] = interior.ideal(pixels[rows]) / interior.c
        scale[rows] = interior.c / interior.pitch
    return q, scale
