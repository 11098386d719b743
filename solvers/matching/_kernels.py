"""Compiled kernels of least squares matching and normalized cross-correlation (numba, imported at first use only).

Images come as cubic B-spline coefficients (float32), so that a value between pixels is exact for the spline.
Local coordinates keep float32 exact to 1e-5 px wherever the window lies in a large photo.
"""

import math

import numpy as np
from numba import njit

F32 = np.float32
ORIGIN = 96  # px, local frame: the start pixel lies at (ORIGIN, ORIGIN)

OK, NO_TEXTURE, EDGE_ONLY, OUTSIDE, LEFT, DIVERGED, NOT_CONVERGED, LOW_SCORE, UNCERTAIN, NOT_UNIQUE = range(10)


@njit(cache=True, fastmath=True)
def _value_weights(t):
    """Cubic B-spline weights of the four nodes around a fraction t."""
    m = F32(1) - t
    t2 = t * t
    a = m * m * m * F32(1 / 6)
    d = t2 * t * F32(1 / 6)
    b = F32(2 / 3) - t2 + F32(3) * d
    return a, b, F32(1) - a - b - d, d


@njit(cache=True, fastmath=True)
def _slope_weights(t):
    """Derivatives of the cubic B-spline weights."""
    m = F32(1) - t
    a = -m * m * F32(0.5)
    d = t * t * F32(0.5)
    b = t * (F32(1.5) * t - F32(2))
    return a, b, -a - b - d, d


@njit(cache=True, fastmath=True)
def _template(image, col, row, half, value, slope_x, slope_y):
    """Values and slopes of the spline on the window around (col, row); separable, one fraction for all pixels."""
    side = 2 * half + 1
    ic, ir = int(math.floor(col)), int(math.floor(row))
    a0, a1, a2, a3 = _value_weights(F32(col - ic))
    d0, d1, d2, d3 = _slope_weights(F32(col - ic))
    b0, b1, b2, b3 = _value_weights(F32(row - ir))
    e0, e1, e2, e3 = _slope_weights(F32(row - ir))
    smooth = np.empty((side + 3, side), np.float32)
    slope = np.empty((side + 3, side), np.float32)
    for j in range(side + 3):
        line = image[ir - half - 1 + j, ic - half - 1 : ic + half + 3]
        for i in range(side):
            smooth[j, i] = a0 * line[i] + a1 * line[i + 1] + a2 * line[i + 2] + a3 * line[i + 3]
            slope[j, i] = d0 * line[i] + d1 * line[i + 1] + d2 * line[i + 2] + d3 * line[i + 3]
    for j in range(side):
        for i in range(side):
            k = j * side + i
            s0, s1, s2, s3 = smooth[j, i], smooth[j + 1, i], smooth[j + 2, i], smooth[j + 3, i]
            value[k] = b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3
            slope_y[k] = e0 * s0 + e1 * s1 + e2 * s2 + e3 * s3
            slope_x[k] = b0 * slope[j, i] + b1 * slope[j + 1, i] + b2 * slope[j + 2, i] + b3 * slope[j + 3, i]


@njit(cache=True, fastmath=True)
def _sample(image, x0, y0, a11, a12, a21, a22, half, out):
    """Spline values on the warped window; image is the local view, (x0, y0) the window centre in it."""
    k = 0
    for j in range(-half, half + 1):
        xr = F32(x0 + a12 * j)
        yr = F32(y0 + a22 * j)
        sx = F32(a11)
        sy = F32(a21)
        for i in range(-half, half + 1):
            x = xr + sx * F32(i)
            y = yr + sy * F32(i)
            ix = np.int32(x)
            iy = np.int32(y)
            c0, c1, c2, c3 = _value_weights(x - F32(ix))
            r0, r1, r2, r3 = _value_weights(y - F32(iy))
            s0 = c0 * image[iy - 1, ix - 1] + c1 * image[iy - 1, ix] + c2 * image[iy - 1, ix + 1] + c3 * image[iy - 1, ix + 2]
            s1 = c0 * image[iy, ix - 1] + c1 * image[iy, ix] + c2 * image[iy, ix + 1] + c3 * image[iy, ix + 2]
            s2 = c0 * image[iy + 1, ix - 1] + c1 * image[iy + 1, ix] + c2 * image[iy + 1, ix + 1] + c3 * image[iy + 1, ix + 2]
            s3 = c0 * image[iy + 2, ix - 1] + c1 * image[iy + 2, ix] + c2 * image[iy + 2, ix + 1] + c3 * image[iy + 2, ix + 2]
            out[k] = r0 * s0 + r1 * s1 + r2 * s2 + r3 * s3
            k += 1
