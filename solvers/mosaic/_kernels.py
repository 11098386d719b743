"""Compiled kernels of resampling and occlusion (numba, imported at first use only).

A warp comes as a lattice: photo coordinates, weight and brightness at every `step`-th pixel of the tile, linear in between.
Positions are float64, so that a place in a large photo stays exact.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

F32 = np.float32
NEAREST, BILINEAR, BICUBIC = 0, 1, 2
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


def _join_four(typingctx, src, at, row, rows, columns, acc, to, weight, best):  # pyright: ignore[reportUnusedParameter]
    """acc[to:to + 4] gains (value, weight), or becomes it where best; value: the three bands of src (a flat array, the first of
    n x n pixels at `at`, rows of `row` values), joined with n factors down (rows) and n across (columns).

    Four values are loaded at a time, the fourth of which is the next pixel's: one more must be there. A vector of four is what
    every processor has; written out here because the compiler does not find it in a loop over bands.
    """
    n = rows.count

    def generate(context, builder, signature, args):
        single, lane, flag = ir.FloatType(), ir.IntType(32), ("contract",)
        source, target = (context.make_array(signature.args[k])(context, builder, args[k]).data for k in (0, 5))
        element = signature.args[0].dtype
        raw = ir.VectorType(context.get_value_type(element), 4)
        four = ir.VectorType(single, 4)

        def spread(value):
            v = builder.insert_element(ir.Constant(four, ir.Undefined), value, lane(0))
            return builder.shuffle_vector(v, v, ir.Constant(ir.VectorType(lane, 4), [0, 0, 0, 0]))

        def load(pointer, of, align):
            return builder.load(builder.bitcast(pointer, of.as_pointer()), align=align)

        down, across = (cgutils.unpack_tuple(builder, args[k], n) for k in (3, 4))
        across = [spread(w) for w in across]
        total = None
        for k in range(n):
            line, start = None, builder.add(args[1], builder.mul(args[2], args[2].type(k)))
            for m in range(n):
                place = builder.gep(source, [builder.add(start, args[1].type(3 * m))])
                value = load(place, raw, 1 if element == types.uint8 else 4)
                if element == types.uint8:
                    value = builder.sitofp(builder.zext(value, ir.VectorType(lane, 4)), four)
                value = builder.fmul(value, across[m], flags=flag)
                line = value if line is None else builder.fadd(line, value, flags=flag)
            line = builder.fmul(line, spread(down[k]), flags=flag)
            total = line if total is None else builder.fadd(total, line, flags=flag)
        total = builder.insert_element(total, args[7], lane(3))
        place = builder.gep(target, [args[6]])
        more = builder.fadd(load(place, four, 4), total, flags=flag)
        builder.store(builder.select(args[8], total, more), builder.bitcast(place, four.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(src, at, row, rows, columns, acc, to, weight, best), generate


_join: Any = intrinsic(_join_four)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp", "nsz"})
def warp(src, top, left, size, u, v, weight, bright, good, step, kind, best, first, acc):
    """Resamples a photo onto rows of a tile and joins it to what is there.

    src (h, w, 3): window of the photo from row `top` and column `left`; size: rows, columns of the whole photo, whose pixel
    EDGES end it. u, v, weight, bright (m, n): photo column and row, weight and brightness factor at the
    lattice nodes; good (m-1, n-1): cells that have all four nodes. acc (H, W, 4), rows of the tile from `first`, gains
    weight * (value, 1); best: it becomes (value, weight) where the weight is more than it has.
    """
    height, width = acc.shape[:2]
    rows, columns = src.shape[:2]
    high, wide = size[0] - 0.5, size[1] - 0.5
    reach = 2 if kind == BICUBIC else 1 if kind == BILINEAR else 0
    least = 1.0 if kind == BICUBIC else 0.0
    last_row, last_column = rows - reach - 0.001, columns - reach - 1.001  # the load of four values goes one further
    per, line, shift = 1.0 / step, 3 * columns, 0.5 if kind == NEAREST else 0.0
    pixels, out, one = src.reshape(-1), acc.reshape(-1), F32(1)
    for i in range(first // step, min(good.shape[0], (first + height - 1) // step + 1)):
        for j in range(good.shape[1]):
            if not good[i, j]:
                continue
            u0, u1, u2, u3 = u[i, j] - left, u[i, j + 1] - left, u[i + 1, j] - left, u[i + 1, j + 1] - left
            v0, v1, v2, v3 = v[i, j] - top, v[i, j + 1] - top, v[i + 1, j] - top, v[i + 1, j + 1] - top
            c0, c1 = j * step, min((j + 1) * step, width)
            for y in range(max(i * step, first), min((i + 1) * step, first + height)):
                f = (y - i * step) * per
                ua, va = u0 + f * (u2 - u0), v0 + f * (v2 - v0)
                du, dv = (u1 + f * (u3 - u1) - ua) * per, (v1 + f * (v3 - v1) - va) * per
                wa = weight[i, j] + f * (weight[i + 1, j] - weight[i, j])
                dw = (weight[i, j + 1] + f * (weight[i + 1, j + 1] - weight[i, j + 1]) - wa) * per
                ba = bright[i, j] + f * (bright[i + 1, j] - bright[i, j])
                db = (bright[i, j + 1] + f * (bright[i + 1, j + 1] - bright[i, j + 1]) - ba) * per
                to = 4 * ((y - first) * width + c0)
                ue, ve = ua + (c1 - c0 - 1) * du, va + (c1 - c0 - 1) * dv
                if (kind == BILINEAR and not best and min(ua, ue) >= 0 and max(ua, ue) < last_column and min(va, ve) >= 0
                        and max(va, ve) < last_row):
                    for k in range(c1 - c0):
                        uu, vv = ua + k * du, va + k * dv
                        r, q = int(vv), int(uu)
                        b, w = F32(uu - q), max(F32(wa + k * dw), LEAST)
                        g = w * F32(ba + k * db)
                        low = g * F32(vv - r)
                        _join(pixels, r * line + 3 * q, line, (g - low, low), (one - b, b), out, to + 4 * k, w, False)
                    continue
                for k in range(c1 - c0):
                    uu, vv, w, light = ua + k * du, va + k * dv, F32(wa + k * dw), F32(ba + k * db)
                    w, at = max(w, LEAST), to + 4 * k
                    if best and w <= out[at + 3]:
                        continue
                    if least <= uu < last_column and least <= vv < last_row:
                        r, q = int(vv + shift), int(uu + shift)
                        place = r * line + 3 * q
                        a, b = F32(vv - r), F32(uu - q)
                        g = light if best else light * w
                        if kind == BILINEAR:
                            _join(pixels, place, line, (g - g * a, g * a), (one - b, b), out, at, w, best)
                        elif kind == BICUBIC:
                            d0, d1, d2, d3 = _cubic(a)
                            _join(pixels, place - line - 3, line, (g * d0, g * d1, g * d2, g * d3), _cubic(b), out, at, w, best)
                        else:
                            _join(pixels, place, line, (g,), (one,), out, at, w, best)
                    elif -0.5 <= uu + left <= wide and -0.5 <= vv + top <= high:
                        for c in range(3):
                            value = light * _one(src, kind, uu, vv, c)
                            out[at + c] = value if best else out[at + c] + w * value
                        out[at + 3] = w if best else out[at + 3] + w


@njit(cache=True, nogil=True, error_model="numpy")
def values(src, size, u, v, kind, out):
    """Values out (n, bands) of an image (h, w, bands) at columns u and rows v, within its pixel edges."""
    for k in range(len(u)):
        if -0.5 <= u[k] <= size[1] - 0.5 and -0.5 <= v[k] <= size[0] - 0.5:
            for c in range(src.shape[2]):
                out[k, c] = _one(src, kind, u[k], v[k], c)


@njit(cache=True, nogil=True, error_model="numpy")
def finish(acc, out):
    """RGBA of sums and weights (h, w, 4): weighted means rounded to eight bits, alpha 255 where anything was seen."""
    height, width = acc.shape[:2]
    for y in range(height):
        for x in range(width):
            w = acc[y, x, 3]
            if w > 0:
                per = F32(1) / w
                for c in range(3):
                    out[y, x, c] = np.uint8(min(max(acc[y, x, c] * per + F32(0.5), F32(0)), F32(255)))
                out[y, x, 3] = 255
            else:
                for c in range(4):
                    out[y, x, c] = 0


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
