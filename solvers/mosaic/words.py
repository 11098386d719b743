"""What a registration says of its weak places."""

from __future__ import annotations

import numpy as np

from .data import Data
from .georeferencing import Placing
from .network import Network

BAD = 0.01
"""Predicted error of a photo's places, in diagonals of the photo, from which a registration is called nearly deficient."""


def single_lines(data: Data, net: Network, tolerance_px: float = 60.0) -> list[tuple[int, int]]:
    """Pairs of photos whose shared points lie on one line within a tolerance: a column of ties in a side overlap."""
    from scipy.sparse import csr_matrix

    m = len(net.names)
    seen = csr_matrix((np.ones(len(net.image)), (net.image, net.point)), shape=(m, len(net.known)))
    shared = (seen @ seen.T).tocoo()
    order = np.argsort(net.image, kind="stable")
    ends = np.searchsorted(net.image[order], np.arange(m + 1))
    out = []
    for i, j, n in zip(shared.row, shared.col, shared.data, strict=True):
        if i >= j or n < 3:
            continue
        a, b = order[ends[i]:ends[i + 1]], order[ends[j]:ends[j + 1]]
        q = net.q[a[np.isin(net.point[a], net.point[b])]]
        spread = np.linalg.svd(q - q.mean(axis=0), compute_uv=False) / np.sqrt(len(q))
        if spread[1] * data.scale[i] < tolerance_px and spread[0] > 4 * spread[1]:
            out.append((int(i), int(j)))
    return out


def weak_photos(data: Data, net: Network, noise: np.ndarray, place: Placing, relief: np.ndarray | None,
                model: str) -> list[str]:
    """Sentences on photos whose place the tie points hardly determine, and on the drift to expect."""
    out: list[str] = []
    px, pixel = noise / place.pixel, place.pixel
    worst = int(np.nanargmax(px)) if np.isfinite(px).any() else 0
    known = 3 * float(np.nanmedian(data.gps_sigma)) / pixel if place.by_gps else 0.0  # no better than the positions themselves
    bad = max(BAD * float(np.median([np.hypot(i.width, i.height) for i in data.interiors])), known)
    if px[worst] > bad:
        pairs = single_lines(data, net)
        named = ", ".join(f"'{net.names[i]}' and '{net.names[j]}'" for i, j in pairs[:4]) + (" ..." if len(pairs) > 4 else "")
        weak = int((px > bad).sum())
        out.append(f"nearly rank deficient: the tie points leave {weak} photo{'s' * (weak > 1)} uncertain by more than "
                   f"{bad:.0f} px (worst '{net.names[worst]}', {px[worst]:.0f} px)"
                   + (f"; the points shared by {named} lie on one line: add tie points beside it" if pairs else "")
                   + ("; take exterior orientations (the camera's principal distance), or give control points" if model == "plane"
                      else "; give control points or onboard positions"))
    if data.level == "uncontrolled" or model == "plane":
        more = "" if relief is None else f", {relief[int(np.nanargmax(relief))] / pixel:.1f} px if what does not fit is relief"
        out.append(f"predicted drift of the farthest photo '{net.names[worst]}': {px[worst]:.1f} px from the noise of the tie "
                   f"points alone{more}; residuals at the seams do not show it")
    return out
