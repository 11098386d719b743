"""Compiled kernels of resampling and occlusion (numba, imported at first use only).

A warp comes as a lattice: photo coordinates, weight and brightness at every `step`-th pixel of the tile, linear in between.
Positions are float64, so that a place in a large photo stays exact.
"""

from __future__ import annotations

import numpy as np
from numba import njit

F32 = np.float32
NEAREST, BILINEAR, BICUBIC = 0, 1, 2
ADD, BEST = 0, 1
LEAST = F32(1e-6)  # weight of a photo's last pixels, where the lattice cuts a sloping weight below zero


@njit(cache=True, inline="always", error_model="numpy")
def _cubic(t):
    """Weights of the four nodes around a fraction t: cubic convolution, a = -1/2 (Keys 1981)."""
    t2 = t * t
    t3 = t2 * t
    half = F32(0.5)
    return (half * (-t3 + F32(2) * t2 - t), half * (F32(3) * t3 - F32(5) * t2 + F32(2)), half * (F32(-3) * t3 + F32(4) * t2 + t),
            half * (t3 - t2))


@njit(cache=True, inline="always", error_model="numpy")
def _clamped(i, n):
    return min(max(i, 0), n - 1)


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
def _one(src, kind, u, v, c):
    """Value of one band at (u, v) of the window, its edge pixels going on beyond it."""
    rows, columns = src.shape[:2]
    if kind == NEAREST:
        return F32(src[_clamped(int(np.floor(v + 0.5)), rows), _clamped(int(np.floor(u + 0.5)), columns), c])
    i, j = int(np.floor(v)), int(np.floor(u))
    a, b = F32(v - i), F32(u - j)
    if kind == BILINEAR:
        i0, i1, j0, j1 = _clamped(i, rows), _clamped(i + 1, rows), _clamped(j, columns), _clamped(j + 1, columns)
        top = F32(src[i0, j0, c]) + b * (F32(src[i0, j1, c]) - F32(src[i0, j0, c]))
        low = F32(src[i1, j0, c]) + b * (F32(src[i1, j1, c]) - F32(src[i1, j0, c]))
        return top + a * (low - top)
    wa, wb, total = _cubic(a), _cubic(b), F32(0)
    for k in range(4):
        y, line = _clamped(i + k - 1, rows), F32(0)
        for m in range(4):
            line += wb[m] * F32(src[y, _clamped(j + m - 1, columns), c])
        total += wa[k] * line
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
def warp(src, top, left, size, u, v, weight, bright, good, step, kind, mode, acc, total):
    """Resamples a photo onto a tile and joins it to what is there.

    src (h, w, 3): window of the photo from row `top` and column `left`; size: rows, columns of the whole photo, whose pixel
    EDGES end it. u, v, weight, bright (m, n): photo column and row, weight and brightness factor at the
    lattice nodes; good (m-1, n-1): cells that have all four nodes. mode ADD: acc (H, W, 3) gains weight * value and total (H, W)
    the weight; BEST: both are replaced where the weight exceeds total.
    """
    height, width = total.shape
    rows, columns = src.shape[:2]
    high, wide = size[0] - 0.5, size[1] - 0.5
    last_row, last_column = F32(rows - 2.001), F32(columns - 2.001)
    per = 1.0 / step
    for i in range(good.shape[0]):
        for j in range(good.shape[1]):
            if not good[i, j]:
                continue
            u0, u1, u2, u3 = u[i, j] - left, u[i, j + 1] - left, u[i + 1, j] - left, u[i + 1, j + 1] - left
            v0, v1, v2, v3 = v[i, j] - top, v[i, j + 1] - top, v[i + 1, j] - top, v[i + 1, j + 1] - top
            inner = (kind == BILINEAR and min(min(u0, u1), min(u2, u3)) >= 0 and min(min(v0, v1), min(v2, v3)) >= 0
                     and max(max(u0, u1), max(u2, u3)) <= last_column and max(max(v0, v1), max(v2, v3)) <= last_row)
            c0, c1 = j * step, min((j + 1) * step, width)
            for y in range(i * step, min((i + 1) * step, height)):
                f = (y - i * step) * per
                ua, va = u0 + f * (u2 - u0), v0 + f * (v2 - v0)
                du, dv = (u1 + f * (u3 - u1) - ua) * per, (v1 + f * (v3 - v1) - va) * per
                wa = weight[i, j] + f * (weight[i + 1, j] - weight[i, j])
                dw = (weight[i, j + 1] + f * (weight[i + 1, j + 1] - weight[i, j + 1]) - wa) * per
                ba = bright[i, j] + f * (bright[i + 1, j] - bright[i, j])
                db = (bright[i, j + 1] + f * (bright[i + 1, j + 1] - bright[i, j + 1]) - ba) * per
                for x in range(c0, c1):
                    k = x - c0
                    uu, vv, w, light = ua + k * du, va + k * dv, F32(wa + k * dw), F32(ba + k * db)
                    w = max(w, LEAST)
                    if mode == BEST and w <= total[y, x]:
                        continue
                    if inner:
                        r, q = int(vv), int(uu)
                        a, b = F32(vv - r), F32(uu - q)
                        w11 = a * b
                        w10, w01 = a - w11, b - w11
                        w00 = F32(1) - a - w01
                        gain = light if mode == BEST else light * w
                        for c in range(3):
                            value = gain * (w00 * F32(src[r, q, c]) + w01 * F32(src[r, q + 1, c]) + w10 * F32(src[r + 1, q, c])
                                            + w11 * F32(src[r + 1, q + 1, c]))
                            if mode == BEST:
                                acc[y, x, c] = value
                            else:
                                acc[y, x, c] += value
                    else:
                        if not (-0.5 <= uu + left <= wide and -0.5 <= vv + top <= high):
                            continue
                        gain = light if mode == BEST else light * w
                        for c in range(3):
                            value = gain * _one(src, kind, uu, vv, c)
                            if mode == BEST:
                                acc[y, x, c] = value
                            else:
                                acc[y, x, c] += value
                    if mode == BEST:
                        total[y, x] = w
                    else:
                        total[y, x] += w


@njit(cache=True, nogil=True, error_model="numpy")
def values(src, size, u, v, kind, out):
    """Values out (n, bands) of an image (h, w, bands) at columns u and rows v, within its pixel edges."""
    for k in range(len(u)):
        if -0.5 <= u[k] <= size[1] - 0.5 and -0.5 <= v[k] <= size[0] - 0.5:
            for c in range(src.shape[2]):
                out[k, c] = _one(src, kind, u[k], v[k], c)


@njit(cache=True, nogil=True, error_model="numpy")
def finish(acc, total, gap, out):
    """The tile's RGBA: weighted means rounded to eight bits, alpha 255 where anything was seen; `gap` where nothing was."""
    height, width = total.shape
    for y in range(height):
        for x in range(width):
            w = total[y, x]
            if w > 0:
                for c in range(3):
                    out[y, x, c] = np.uint8(min(max(acc[y, x, c] / w + F32(0.5), F32(0)), F32(255)))
                out[y, x, 3] = 255
            else:
                for c in range(3):
                    out[y, x, c] = gap
                out[y, x, 3] = 0


@njit(cache=True, nogil=True, error_model="numpy")
def halve(src, out):
    """RGBA at half the resolution: means of 2 x 2 pixels weighted with their alpha; covered where at least two of them are."""
    height, width = out.shape[:2]
    for y in range(height):
        for x in range(width):
            n = 0
            r = g = b = 0
            for i in range(2 * y, 2 * y + 2):
                for j in range(2 * x, 2 * x + 2):
                    if src[i, j, 3] > 127:
                        n += 1
                        r += src[i, j, 0]
                        g += src[i, j, 1]
                        b += src[i, j, 2]
            if n >= 2:
                out[y, x, 0], out[y, x, 1], out[y, x, 2] = (r + n // 2) // n, (g + n // 2) // n, (b + n // 2) // n
                out[y, x, 3] = 255
            else:
                out[y, x, 0] = out[y, x, 1] = out[y, x, 2] = out[y, x, 3] = 0


@njit(cache=True, nogil=True, error_model="numpy")
def hidden(heights, col, row, z, camera_col, camera_row, camera_z, highest, tolerance, out):
    """Which points (col, row of the height grid, z [m]) the grid hides from the camera (its place likewise); bilinear heights
    at steps of half a cell along the line of sight, until it is higher than the grid's highest node."""
    rows, columns = heights.shape
    for k in range(len(z)):
        out[k] = False
        dc, dr, dz = camera_col - col[k], camera_row - row[k], camera_z - z[k]
        if not dz > 0:
            out[k] = dz <= 0
            continue
        along = np.sqrt(dc * dc + dr * dr)
        reach = min((highest - z[k]) / dz, 1.0)
        n = int(np.ceil(2 * along * reach))
        for m in range(1, n + 1):
            t = m / (2 * along)
            if t >= reach:
                break
            c, r = col[k] + t * dc, row[k] + t * dr
            i, j = int(np.floor(r)), int(np.floor(c))
            if i < 0 or j < 0 or i >= rows - 1 or j >= columns - 1:
                continue
            a, b = r - i, c - j
            h = ((1 - a) * ((1 - b) * heights[i, j] + b * heights[i, j + 1])
                 + a * ((1 - b) * heights[i + 1, j] + b * heights[i + 1, j + 1]))
            if h > z[k] + t * dz + tolerance:
                out[k] = True
                break
