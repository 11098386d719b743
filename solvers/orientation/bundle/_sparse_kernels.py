"""Compiled sums over the points of a block-sparse system whose blocks have any size."""

from typing import Any

import numba

njit: Any = numba.njit  # its type stubs do not know every option
kernel = njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"}, no_cfunc_wrapper=True)


@kernel
def eliminate(start, image, e, t, lut, blocks):
    """blocks[lut[i, j]] -= T_i E_j^T of all images i <= j that see a point; start (n + 1,): its observations; E, T (o, s, q)."""
    _, s, q = e.shape
    for p in range(len(start) - 1):
        for a in range(start[p], start[p + 1]):
            for b in range(start[p], start[p + 1]):
                if image[a] > image[b]:
                    continue
                to = blocks[lut[image[a], image[b]]]
                for c in range(q):
                    for i in range(s):
                        factor = t[a, i, c]
                        if factor != 0.0:
                            for j in range(s):
                                to[i, j] -= factor * e[b, j, c]


@kernel
def spread(start, image, lut, z, t, out):
    """out[a] = sum of Z[i_a, i_b] T_b over the observations b of the same point; Z (b, s, s) of i <= j; T, out (o, s, q)."""
    _, s, q = t.shape
    for p in range(len(start) - 1):
        for a in range(start[p], start[p + 1]):
            to = out[a]
            for b in range(start[p], start[p + 1]):
                swap = image[a] > image[b]
                block = z[lut[image[b], image[a]] if swap else lut[image[a], image[b]]]
                for i in range(s):
                    for j in range(s):
                        factor = block[j, i] if swap else block[i, j]
                        for c in range(q):
                            to[i, c] += factor * t[b, j, c]
