"""Compiled kernel of registration: the elimination of points on the plane (2 by 2 blocks) from a block of photos."""

from typing import Any

import numba
import numpy as np

njit: Any = numba.njit  # its type stubs do not know every option
kernel = njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)


@kernel
def eliminate(start, node, by_photo, by_point, v, q, lut, blocks, right):
    """Subtract from blocks (b, s, s) and right (m, s) what the points take: W V^-1 W^T and W V^-1 q.

    start (n + 1,): observations of each point; node (o,): moving photo of each observation, -1 for none; by_photo (o, 2, s),
    by_point (o, 2, 2) weighted derivatives; v (n, 2, 2) inverse blocks of the points; q (n, 2) their right side; lut (m, m):
    block of each pair of photos (first <= second).
    """
    s = by_photo.shape[2]
    longest = 0
    for p in range(len(start) - 1):
        longest = max(longest, start[p + 1] - start[p])
    w, y = np.empty((longest, s, 2)), np.empty((longest, s, 2))
    for p in range(len(start) - 1):
        first, last = start[p], start[p + 1]
        for o in range(first, last):
            if node[o] < 0:
                continue
            k = o - first
            for a in range(s):
                for b in range(2):
                    w[k, a, b] = by_photo[o, 0, a] * by_point[o, 0, b] + by_photo[o, 1, a] * by_point[o, 1, b]
                for b in range(2):
                    y[k, a, b] = w[k, a, 0] * v[p, 0, b] + w[k, a, 1] * v[p, 1, b]
                right[node[o], a] -= y[k, a, 0] * q[p, 0] + y[k, a, 1] * q[p, 1]
        for o in range(first, last):
            i = node[o]
            if i < 0:
                continue
            for r in range(first, last):
                j = node[r]
                if j < i:
                    continue
                block = blocks[lut[i, j]]
                for a in range(s):
                    ya, yb = y[o - first, a, 0], y[o - first, a, 1]
                    for b in range(s):
                        block[a, b] -= ya * w[r - first, b, 0] + yb * w[r - first, b, 1]
