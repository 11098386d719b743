"""Seam labels: which photo each place of the mosaic shows, on a grid coarser than the mosaic by a factor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry import Grid
from .lattice import Net, Tile

NOBODY = -1
_PAD = 6


@dataclass(frozen=True)
class Labels:
    """number (rows, columns) int16 of the photo that a place shows, NOBODY where none is, on a grid; factor: its cell in px."""

    grid: Grid
    factor: int
    number: np.ndarray

    def weight(self, number: int, net: Net) -> np.ndarray:
        """(m, n) share 0..1 of a photo at the nodes of a net: 1 where it alone is shown, falling over a seam within about two
        cells on either side; the shares of all photos add up to 1."""
        import cv2

        mine = (self.number == number).astype(np.float32)
        soft = cv2.GaussianBlur(mine, (7, 7), 1.0, borderType=cv2.BORDER_REPLICATE)
        p = self.grid.to_pixels(net.at).astype(np.float32)
        share = cv2.remap(soft, p[..., 0], p[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.where(share > 1e-4, share, 0.0).astype(float)

    def around(self, grid: Grid, tile: Tile) -> Labels:
        """The part that a tile of the mosaic's grid needs."""
        corners = grid.to_map(np.array([[tile.left, tile.top], [tile.left + tile.width, tile.top + tile.height]]) - 0.5)
        (c0, r0), (c1, r1) = np.floor(self.grid.to_pixels(corners)).astype(int)
        rows, columns = self.number.shape
        top, bottom = (int(np.clip(v, 0, rows)) for v in (r0 - _PAD, r1 + _PAD + 1))
        left, right = (int(np.clip(v, 0, columns)) for v in (c0 - _PAD, c1 + _PAD + 1))
        top, left = min(top, rows - 1), min(left, columns - 1)
        bottom, right = max(bottom, top + 1), max(right, left + 1)
        a, b, c, d, e, f = self.grid.affine
        moved = replace(self.grid, shape=(bottom - top, right - left),
                        affine=(a, b, c + a * left + b * top, d, e, f + d * left + e * top))
        return Labels(moved, self.factor, self.number[top:bottom, left:right])

    @property
    def here(self) -> set[int]:
        """Numbers of the photos that are shown."""
        return set(np.unique(self.number).tolist()) - {NOBODY}


def spread(number: np.ndarray) -> np.ndarray:
    """Labels in which places that nobody shows take the label of the nearest that someone does: seams leave no gap at edges."""
    import cv2

    nobody = number == NOBODY
    if not nobody.any() or nobody.all():
        return number
    _, nearest = cv2.distanceTransformWithLabels(nobody.astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    table = np.full(int(nearest.max()) + 1, NOBODY, number.dtype)
    table[nearest[~nobody]] = number[~nobody]
    return table[nearest]
