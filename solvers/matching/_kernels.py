"""Compiled kernels of least squares matching and normalized cross-correlation (numba, imported at first use only).

Images come as cubic B-spline coefficients (float32), so that a value between pixels is exact for the spline.
Local coordinates keep float32 exact to 1e-5 px wherever the window lies in a large photo.
"""

import math
from typing import Any

import numpy as np
from numba import njit

F32 = np.float32
ONE, TWO, THREE, FOUR = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
ORIGIN = 96  # px, the local frame starts this far before the start pixel
RIVALS = 5  # other peaks kept for each correlation
FAST = {"contract", "reassoc", "arcp", "nsz"}  # NaN keeps its meaning: it marks pixels without data

OK, NO_TEXTURE, EDGE_ONLY, OUTSIDE, LEFT, DIVERGED, NOT_CONVERGED, LOW_SCORE, UNCERTAIN, NOT_UNIQUE, AT_BORDER = range(11)


_INNER: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
helper = njit(fastmath=FAST, **_INNER)


@helper
def _value_weights(t):
    """Cubic B-spline weights of the four nodes around a fraction t."""
    m = F32(1) - t
    t2 = t * t
    a = m * m * m * F32(1 / 6)
    d = t2 * t * F32(1 / 6)
    b = F32(2 / 3) - t2 + F32(3) * d
    return a, b, F32(1) - a - b - d, d


@helper
def _slope_weights(t):
    """Derivatives of the cubic B-spline weights."""
    m = F32(1) - t
    a = -m * m * F32(0.5)
    d = t * t * F32(0.5)
    b = t * (F32(1.5) * t - F32(2))
    return a, b, -a - b - d, d


@helper
def _template(image, col, row, half, value, slope_x, slope_y):
    """Values and slopes of the spline on the window around (col, row); separable, one fraction for all pixels."""
    side = 2 * half + 1
    ic, ir = math.floor(col), math.floor(row)
    a0, a1, a2, a3 = _value_weights(F32(col - ic))
    d0, d1, d2, d3 = _slope_weights(F32(col - ic))
    b0, b1, b2, b3 = _value_weights(F32(row - ir))
    e0, e1, e2, e3 = _slope_weights(F32(row - ir))
    smooth = np.empty((side + 3, side), np.float32)
    slope = np.empty((side + 3, side), np.float32)
    for j in range(side + 3):
        line = ir - half - 1 + j
        first = ic - half - 1
        for i in range(side):
            k = first + i
            p0, p1, p2, p3 = image[line, k], image[line, k + 1], image[line, k + 2], image[line, k + 3]
            smooth[j, i] = a0 * p0 + a1 * p1 + a2 * p2 + a3 * p3
            slope[j, i] = d0 * p0 + d1 * p1 + d2 * p2 + d3 * p3
    for j in range(side):
        for i in range(side):
            k = j * side + i
            s0, s1, s2, s3 = smooth[j, i], smooth[j + 1, i], smooth[j + 2, i], smooth[j + 3, i]
            value[k] = b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3
            slope_y[k] = e0 * s0 + e1 * s1 + e2 * s2 + e3 * s3
            slope_x[k] = b0 * slope[j, i] + b1 * slope[j + 1, i] + b2 * slope[j + 2, i] + b3 * slope[j + 3, i]


@helper
def _sample(flat, width, base, x0, y0, a11, a12, a21, a22, half, scratch, place, out):
    """Spline values on the warped window, its centre (x0, y0) counted from the pixel at flat[base + width + 1].

    Two passes a row: weights (vectorised), then the 16 nodes. Unsigned indices spare numba's wrap-around tests.
    """
    side = 2 * half + 1
    w = np.uint64(width)
    sx, sy = F32(a11), F32(a21)
    for j in range(side):
        xr = F32(x0 + a12 * (j - half) - a11 * half)
        yr = F32(y0 + a22 * (j - half) - a21 * half)
        for i in range(side):
            x = xr + sx * F32(i)
            y = yr + sy * F32(i)
            ix = np.int32(x)
            iy = np.int32(y)
            place[i] = base + np.int64(iy) * width + np.int64(ix)
            scratch[0, i], scratch[1, i], scratch[2, i], scratch[3, i] = _value_weights(x - F32(ix))
            scratch[4, i], scratch[5, i], scratch[6, i], scratch[7, i] = _value_weights(y - F32(iy))
        for i in range(side):
            k = np.uint64(place[i])
            k1 = k + w
            k2 = k1 + w
            k3 = k2 + w
            r0, r1, r2, r3 = scratch[4, i], scratch[5, i], scratch[6, i], scratch[7, i]
            t0 = r0 * flat[k] + r1 * flat[k1] + r2 * flat[k2] + r3 * flat[k3]
            t1 = r0 * flat[k + ONE] + r1 * flat[k1 + ONE] + r2 * flat[k2 + ONE] + r3 * flat[k3 + ONE]
            t2 = r0 * flat[k + TWO] + r1 * flat[k1 + TWO] + r2 * flat[k2 + TWO] + r3 * flat[k3 + TWO]
            t3 = r0 * flat[k + THREE] + r1 * flat[k1 + THREE] + r2 * flat[k2 + THREE] + r3 * flat[k3 + THREE]
            out[np.uint64(j * side + i)] = scratch[0, i] * t0 + scratch[1, i] * t1 + scratch[2, i] * t2 + scratch[3, i] * t3


@helper
def _inverse(normal, keep, out):
    """Inverse of the normal matrix of the kept parameters (others 0), by Gauss-Jordan; False when not positive definite."""
    for i in range(6):
        for j in range(6):
            out[i, j] = normal[i, j] if keep[i] and keep[j] else 0.0
    for p in range(6):
        if not keep[p]:
            continue
        pivot = out[p, p]
        if not pivot > 1e-9 * normal[p, p]:
            return False
        out[p, p] = 1.0
        for j in range(6):
            out[p, j] /= pivot
        for i in range(6):
            if i != p and keep[i]:
                factor = out[i, p]
                out[i, p] = 0.0
                for j in range(6):
                    out[i, j] -= factor * out[p, j]
    return True


@helper
def _design(value, slope_x, slope_y, half, rows):
    """Rows g_x, g_x u, g_x v, g_y, g_y u, g_y v made orthogonal to 1 and to the template (offset and gain eliminated).

    value becomes mean-free; returns its mean and its norm.
    """
    side = 2 * half + 1
    n = side * side
    for j in range(side):
        v = F32(j - half)
        for i in range(side):
            k = np.uint64(j * side + i)
            u = F32(i - half)
            gx, gy = slope_x[k], slope_y[k]
            rows[0, k] = gx
            rows[1, k] = gx * u
            rows[2, k] = gx * v
            rows[3, k] = gy
            rows[4, k] = gy * u
            rows[5, k] = gy * v
    mean = F32(0)
    for k in range(n):
        mean += value[k]
    mean /= n
    square = F32(0)
    for k in range(n):
        value[k] -= mean
        square += value[k] * value[k]
    for p in range(6):
        row = rows[p]
        offset = F32(0)
        along = F32(0)
        for k in range(n):
            offset += row[k]
            along += row[k] * value[k]
        offset /= n
        along = along / square if square > 0 else F32(0)
        for k in range(n):
            row[k] -= offset + along * value[k]
    return mean, math.sqrt(square)


@helper
def _normal(rows, normal):
    for p in range(6):
        a = rows[p]
        for q in range(p + 1):
            b = rows[q]
            s = F32(0)
            for k in range(a.size):
                s += a[k] * b[k]
            normal[p, q] = s
            normal[q, p] = s


@helper
def _laplacian_noise(value, side):
    """Mean square of the (1,-2,1)x(1,-2,1) filter: the template's noise, and some texture (Immerkaer 1996)."""
    s = F32(0)
    for j in range(1, side - 1):
        for i in range(1, side - 1):
            k = j * side + i
            d = (
                value[k - side - 1] + value[k - side + 1] + value[k + side - 1] + value[k + side + 1]
                - F32(2) * (value[k - side] + value[k + side] + value[k - 1] + value[k + 1])
                + F32(4) * value[k]
            )
            s += d * d
    return s / ((side - 2) * (side - 2))


@helper
def _influence(rows, cofactor, p, out):
    """Row p of cofactor @ rows: how each pixel's residual moves parameter p."""
    for k in range(out.size):
        s = F32(0)
        for q in range(6):
            s += F32(cofactor[p, q]) * rows[q, k]
        out[k] = s


@helper
def _spread(weights, side, taps, wide, out):
    """Correlation of a (side, side) image, zero outside, with a separable kernel: (side + taps - 1)^2 values in out.

    Rows are padded with zeros, so that both passes are single long loops.
    """
    m = taps.size
    full = side + m - 1
    size = side * full
    for k in range(size):
        wide[k] = F32(0)
    for k in range(out.size):
        out[k] = F32(0)
    for j in range(side):
        for i in range(side):
            out[np.uint64(j * full + i)] = weights[np.uint64(j * side + i)]
    for t in range(m):
        w = taps[t]
        for k in range(size - t):
            wide[np.uint64(k + t)] += w * out[np.uint64(k)]
    for k in range(size):
        out[k] = F32(0)
    for t in range(m):
        w = taps[t]
        for k in range(size):
            out[np.uint64(t * full + k)] += w * wide[np.uint64(k)]


@helper
def _rough_energy(error, side, taps, wide):
    """Mean square of the residuals after the separable three-tap filter, on the inner window."""
    inner = side - 2
    for j in range(side):
        for i in range(inner):
            k = j * side + i
            wide[k] = taps[0] * error[k] + taps[1] * error[k + 1] + taps[0] * error[k + 2]
    total = F32(0)
    for j in range(inner):
        for i in range(inner):
            k = j * side + i
            v = taps[0] * wide[k] + taps[1] * wide[k + side] + taps[0] * wide[k + 2 * side]
            total += v * v
    return total / (inner * inner)


@helper
def _dot(a, b):
    s = F32(0)
    for k in range(a.size):
        s += a[k] * b[k]
    return s


@helper
def _without_blur(error, value, side, bend):
    """The residuals without what one image is sharper than the other: their part along the template's second derivatives.

    Such a difference (focus, scale) is symmetric and moves no point, but would pass for noise.
    """
    n = side * side
    for j in range(side):
        y = min(max(j, 1), side - 2)
        for i in range(side):
            k = y * side + min(max(i, 1), side - 2)
            twice = F32(2) * value[k]
            bend[0, j * side + i] = value[k - 1] + value[k + 1] - twice
            bend[1, j * side + i] = value[k - side] + value[k + side] - twice
            bend[2, j * side + i] = value[k - side - 1] + value[k + side + 1] - value[k - side + 1] - value[k + side - 1]
    for p in range(3):
        a = bend[p]
        for q in range(p):
            b = bend[q]
            size = _dot(b, b)
            along = _dot(a, b) / size if size > 0 else F32(0)
            for k in range(n):
                a[k] -= along * b[k]
        size = _dot(a, a)
        along = _dot(a, error) / size if size > 0 else F32(0)
        for k in range(n):
            error[k] -= along * a[k]


@helper
def _debiased(normal, variance, slope_energy, half, out):
    """The normal matrix without what the noise of the slopes adds to its diagonal."""
    side = 2 * half + 1
    moment = side * (half * (half + 1) * side / 3.0)  # sum of u^2 over the window
    for p in range(6):
        for q in range(6):
            out[p, q] = normal[p, q]
        out[p, p] -= variance * slope_energy * (side * side if p % 3 == 0 else moment)


@helper
def _texture(normal, variance, slope_energy, count, gain, limit):
    """Reason why the 2-D shift of this template cannot be found within limit px (1 sigma), or OK."""
    bias = variance * slope_energy * count
    a, b, c = normal[0, 0] - bias, normal[0, 3], normal[3, 3] - bias
    mean, half_gap = 0.5 * (a + c), math.hypot(0.5 * (a - c), b)
    least, most = mean - half_gap, mean + half_gap
    need = 2.0 * variance * gain / (limit * limit)
    # Where noise has as much slope as texture, least squares follows the noise; small windows tell the two apart less surely.
    share = 1.5 + 0.1 * max(0.0, 21.0 - math.sqrt(count))
    if not most > max(need, 2.0 * share * bias) or not most > 1e-12 * count:
        return NO_TEXTURE
    need = max(need, share * bias)
    if not least > need or least < 1e-4 * most:
        return EDGE_ONLY
    return OK


@helper
def _count(keep):
    kept = 0
    for p in range(6):
        kept += keep[p]
    return kept


@helper
def _bits(keep):
    bits = 0
    for p in range(6):
        bits += keep[p] << p
    return bits


@helper
def _choose(normal, variance, gain, half, keep, cofactor):
    """Drop, worst first, the shaping parameters that would move the window's edge by more than 0.5 px (1 sigma)."""
    while True:
        solved = _inverse(normal, keep, cofactor)
        worst, most = -1, 0.25 / (half * half)
        for p in (1, 2, 4, 5):
            if keep[p]:
                v = 2.0 * variance * gain * cofactor[p, p] if solved else 1e30 / (1e-30 + normal[p, p])
                if v > most:
                    worst, most = p, v
        if worst < 0:
            return solved
        keep[worst] = False


@helper
def _held(normal, cofactor, keep, variance, doubt, start, result):
    """Add to the covariance what the shaping parameters that are held would move the point, were they off as the others were.

    That is `doubt`, a variance, or how far those have come from their start, in the template's axes and beyond their own noise.
    """
    det = start[0, 0] * start[1, 1] - start[0, 1] * start[1, 0]
    i11, i12, i21, i22 = start[1, 1] / det, -start[0, 1] / det, -start[1, 0] / det, start[0, 0] / det
    a11, a12, a21, a22 = result[2], result[3], result[4], result[5]
    moved = (i11 * a11 + i12 * a21 - 1, i11 * a12 + i12 * a22, i21 * a11 + i22 * a21, i21 * a12 + i22 * a22 - 1)
    total, count = doubt, 1
    for k in range(4):
        p = k + 1 + k // 2
        if keep[p]:
            total += max(moved[k] * moved[k] - variance * cofactor[p, p], 0.0)
            count += 1
    if count == 5:
        return
    # Those that came no distance prove nothing: of a dot that turns about itself they may be held by the one that is held.
    expected = max(doubt, total / count)
    for k in range(4):
        p = k + 1 + k // 2
        if not keep[p]:
            x, y = 0.0, 0.0
            for q in range(6):
                if keep[q]:
                    x += cofactor[0, q] * normal[q, p]
                    y += cofactor[3, q] * normal[q, p]
            dx, dy = a11 * x + a12 * y, a21 * x + a22 * y
            result[9] += expected * dx * dx
            result[10] += expected * dx * dy
            result[11] += expected * dy * dy


@helper
def _slow(dx, dy, before, result):
    """Enlarge the covariance along the last step where steps became shorter by less than half.

    Steps that shrink by q find the residuals' curvature there to be 1 - q of the normal matrix, and are not at their end: a dot
    turns about itself, half held by noise. What noise adds to the normal matrix of usual windows makes q a third at most.
    """
    last = math.hypot(dx, dy)
    if not last > 0.5 * before or not last > 0:
        return
    rate = min(last / before, 0.98) if before > 0 else 0.5
    x, y = dx / last, dy / last
    along = x * x * result[9] + 2 * x * y * result[10] + y * y * result[11]
    left = last * rate / (1 - rate)
    more = along * ((0.5 / (1 - rate)) ** 2 - 1) + left * left
    result[9] += more * x * x
    result[10] += more * x * y
    result[11] += more * y * y


@njit(cache=True, fastmath=FAST, error_model="numpy", nogil=True)
def match_batch(template, target, at, start, shape, half, taps, extra, noise, limits, out):
    """Inverse compositional least squares matching of many points.

    template, target: spline coefficients; at, start (N, 2) col, row; shape (N, 2, 2) template -> target offsets.
    taps: the node values' smoothing kernel; noise: energies of white noise
    (value, slope, laplacian, value after extra, smoothed slope) and the floor of its variance.
    limits: iterations, step px, largest sigma px, least score, largest move px, variance of shaping parameters that are held.
    out (N, 16): col, row, a11, a12, a21, a22, r0, r1, score, vxx, vxy, vyy, noise, iterations, kept (bits),
    status.
    """
    side = 2 * half + 1
    n = side * side
    value = np.empty(n, np.float32)
    slope_x = np.empty(n, np.float32)
    slope_y = np.empty(n, np.float32)
    rows = np.empty((6, n), np.float32)
    other = np.empty(n, np.float32)
    full = side + taps.size - 1
    wide = np.empty(side * full, np.float32)
    wide_x = np.empty(full * full, np.float32)
    wide_y = np.empty(full * full, np.float32)
    scratch = np.empty((8, side), np.float32)
    place = np.empty(side, np.int64)
    flat = target.ravel()
    normal = np.empty((6, 6))
    clean = np.empty((6, 6))
    cofactor = np.empty((6, 6))
    inverse = np.empty((6, 6))
    step = np.empty(6)
    bend = np.empty((3, n), np.float32)
    keep = np.empty(6, np.bool_)
    height, width = template.shape
    tall, broad = target.shape
    value_energy, slope_energy, laplace_energy, rough_energy, spread_energy, floor_variance = noise
    for index in range(at.shape[0]):
        result = out[index]
        for k in range(16):
            result[k] = np.nan
        result[13] = 0
        result[14] = 0
        col, row = at[index, 0], at[index, 1]
        x, y = start[index, 0], start[index, 1]
        a11, a12, a21, a22 = shape[index, 0, 0], shape[index, 0, 1], shape[index, 1, 0], shape[index, 1, 1]
        det0 = a11 * a22 - a12 * a21
        if not (col - half - 1 >= 0 and row - half - 1 >= 0 and col + half + 3 <= width and row + half + 3 <= height):
            result[15] = OUTSIDE
            continue
        _template(template, col, row, half, value, slope_x, slope_y)
        mean, norm = _design(value, slope_x, slope_y, half, rows)
        if not math.isfinite(norm):
            result[15] = OUTSIDE
            continue
        _normal(rows, normal)
        rough = max(_laplacian_noise(value, side) / laplace_energy, floor_variance)
        reason = _texture(normal, rough, slope_energy, n, value_energy, limits[2])
        for p in range(6):
            keep[p] = True
        least = _texture(normal, floor_variance, slope_energy, n, value_energy, limits[2])
        if least == NO_TEXTURE or not _choose(normal, floor_variance, value_energy, half, keep, cofactor):
            result[15] = max(least, EDGE_ONLY) if least != NO_TEXTURE else NO_TEXTURE
            continue
        ox, oy = max(0, int(x) - ORIGIN), max(0, int(y) - ORIGIN)
        base = (oy - 1) * broad + ox - 1
        status = NOT_CONVERGED
        score, ratio, mean_other, variance = 0.0, 1.0, 0.0, 0.0
        dx, dy, before = 0.0, 0.0, 0.0
        iteration = 0
        while iteration < limits[0]:
            reach_x = (abs(a11) + abs(a12)) * half
            reach_y = (abs(a21) + abs(a22)) * half
            if not (x - reach_x >= 1 and y - reach_y >= 1 and x + reach_x < broad - 2 and y + reach_y < tall - 2):
                status = LEFT
                break
            if math.hypot(x - start[index, 0], y - start[index, 1]) > limits[4]:
                status = DIVERGED
                break
            iteration += 1
            _sample(flat, broad, base, x - ox, y - oy, a11, a12, a21, a22, half, scratch, place, other)
            total = F32(0)
            for k in range(n):
                total += other[k]
            mean_other = total / n
            square, cross = F32(0), F32(0)
            shift = F32(mean_other)
            for k in range(n):
                other[k] -= shift
                square += other[k] * other[k]
                cross += other[k] * value[k]
            if not (square > 0 and math.isfinite(square)):
                status = NO_TEXTURE if square == 0 else LEFT
                break
            score = cross / (norm * math.sqrt(square))
            ratio = norm / math.sqrt(square)
            scale = F32(ratio)
            for k in range(n):
                other[k] = scale * other[k] - value[k]
            for p in range(6):
                step[p] = _dot(rows[p], other)
            d0, d1, d2, d3, d4, d5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for q in range(6):
                d0 += cofactor[0, q] * step[q]
                d1 += cofactor[1, q] * step[q]
                d2 += cofactor[2, q] * step[q]
                d3 += cofactor[3, q] * step[q]
                d4 += cofactor[4, q] * step[q]
                d5 += cofactor[5, q] * step[q]
            # W(p) <- W(p) o W(d)^-1
            det = (1 + d1) * (1 + d5) - d2 * d4
            if not det > 0.2:
                status = DIVERGED
                break
            i11, i12, i21, i22 = (1 + d5) / det, -d2 / det, -d4 / det, (1 + d1) / det
            before = math.hypot(dx, dy)
            tx, ty = -(i11 * d0 + i12 * d3), -(i21 * d0 + i22 * d3)
            dx, dy = a11 * tx + a12 * ty, a21 * tx + a22 * ty
            x, y = x + dx, y + dy
            a11, a12, a21, a22 = a11 * i11 + a12 * i21, a11 * i12 + a12 * i22, a21 * i11 + a22 * i21, a21 * i12 + a22 * i22
            change = (a11 * a22 - a12 * a21) / det0
            if not 0.4 < change < 2.5:
                status = DIVERGED
                break
            if not (abs(dx) < limits[1] and abs(dy) < limits[1]):
                continue
            _influence(rows, cofactor, 0, slope_x)
            _spread(slope_x, side, taps, wide, wide_x)
            gain = _dot(wide_x, wide_x) / _dot(slope_x, slope_x)
            kept = _count(keep)
            inner = (side - 2) * (side - 2)
            _without_blur(other, value, side, bend)
            passed = _rough_energy(slope_x, side, extra, wide) * inner / _dot(slope_x, slope_x)
            freedom = inner * rough_energy - kept * gain * passed - 2.0 * inner / n
            for p in range(3):
                own = _dot(bend[p], bend[p])
                if own > 0:
                    blurred = _rough_energy(bend[p], side, extra, wide) * inner / own
                    freedom -= blurred * blurred * n / inner
            variance = _rough_energy(other, side, extra, wide) * inner / max(freedom, 1.0)
            result[12] = math.sqrt(variance)
            variance = max(variance, 2 * floor_variance)
            status = _texture(normal, 0.5 * variance, slope_energy, n, value_energy, limits[2])
            if status != OK:
                break
            _debiased(normal, 0.5 * variance, slope_energy, half, clean)
            if not _choose(clean, 0.5 * variance, value_energy, half, keep, inverse):
                status = UNCERTAIN
                break
            if _count(keep) == kept:
                break
            # Noise alone carried a shaping parameter: once more without it.
            status = NOT_CONVERGED
            dx, dy = 0.0, 0.0
            a11, a12, a21, a22 = shape[index, 0, 0], shape[index, 0, 1], shape[index, 1, 0], shape[index, 1, 1]
            if not _inverse(normal, keep, cofactor):
                status = UNCERTAIN
                break
        result[13] = iteration
        result[0], result[1], result[2], result[3], result[4], result[5] = x, y, a11, a12, a21, a22
        result[6], result[7], result[8] = mean - ratio * mean_other, ratio, score
        result[14] = _bits(keep)
        if status == OK and score < limits[3]:
            status = LOW_SCORE
        if status != OK:
            result[15] = reason if reason != OK else status
            continue
        _influence(rows, inverse, 0, slope_x)
        _influence(rows, inverse, 3, slope_y)
        _spread(slope_x, side, taps, wide, wide_x)
        _spread(slope_y, side, taps, wide, wide_y)
        q_xx, q_xy, q_yy = _dot(wide_x, wide_x), _dot(wide_x, wide_y), _dot(wide_y, wide_y)
        # Noise of the slopes times the template's own noise, the same noise, sums up to nothing but its rim.
        for p in range(6):
            own = 0.25 * variance * spread_energy * (n if p % 3 == 0 else n * half * (half + 1) / 3.0)
            q_xx -= own * inverse[0, p] * inverse[0, p]
            q_xy -= own * inverse[0, p] * inverse[3, p]
            q_yy -= own * inverse[3, p] * inverse[3, p]
        # Seen through a smaller image noise is coarser: the target's share grows with the template's area over its own. Half of
        # that (by its logarithm, at the usual presmoothing) is in the filtered residuals already.
        area = abs(a11 * a22 - a12 * a21)
        variance *= (1 + ratio * ratio / area) / (1 + ratio * ratio / math.sqrt(area))
        result[9] = variance * (a11 * a11 * q_xx + 2 * a11 * a12 * q_xy + a12 * a12 * q_yy)
        result[10] = variance * (a11 * a21 * q_xx + (a11 * a22 + a12 * a21) * q_xy + a12 * a22 * q_yy)
        result[11] = variance * (a21 * a21 * q_xx + 2 * a21 * a22 * q_xy + a22 * a22 * q_yy)
        _held(clean, inverse, keep, variance, limits[5], shape[index], result)
        _slow(dx, dy, before, result)
        middle, gap = 0.5 * (result[9] + result[11]), math.hypot(0.5 * (result[9] - result[11]), result[10])
        # Where noise has nearly the slope of the texture, what is taken off for it leaves no covariance at all.
        result[15] = OK if middle - gap > 0 and middle + gap < limits[2] * limits[2] else UNCERTAIN


@helper
def _nodes(image, left, top, size, wide, out):
    """Spline values at size x size pixels from (left, top), 0 outside the image; False where a pixel has no data."""
    height, width = image.shape
    c, e = F32(4 / 6), F32(1 / 6)
    for j in range(size + 2):
        row = top - 1 + j
        for i in range(size):
            col = left + i
            inside = 0 <= row < height and 1 <= col < width - 1
            wide[j, i] = e * (image[row, col - 1] + image[row, col + 1]) + c * image[row, col] if inside else F32(0)
    total = F32(0)
    for j in range(size):
        for i in range(size):
            out[j, i] = e * (wide[j, i] + wide[j + 2, i]) + c * wide[j + 1, i]
            total += out[j, i]
    return math.isfinite(total)


@helper
def _correlate(template, patch, side, span, out):
    """Cross-correlation of a mean-free template (side rows, padded with zeros to a multiple of 8) with every place of the patch.

    Rows of out are padded to a multiple of 8 too; eight taps a pass keep the vector units busy.
    """
    broad, padded, width = patch.shape[1], template.shape[1], out.shape[1]
    source, taps, flat = patch.ravel(), template.ravel(), out.ravel()
    for k in range(flat.size):
        flat[k] = F32(0)
    for dy in range(span):
        line = np.uint64(dy * width)
        for j in range(side):
            for i in range(0, padded, 8):
                m = np.uint64(j * padded + i)
                t0, t1, t2, t3 = taps[m], taps[m + ONE], taps[m + TWO], taps[m + THREE]
                n = m + FOUR
                t4, t5, t6, t7 = taps[n], taps[n + ONE], taps[n + TWO], taps[n + THREE]
                first = np.uint64((dy + j) * broad + i)
                for dx in range(width):
                    k = first + np.uint64(dx)
                    q = k + FOUR
                    flat[line + np.uint64(dx)] += (
                        t0 * source[k] + t1 * source[k + ONE] + t2 * source[k + TWO] + t3 * source[k + THREE]
                        + t4 * source[q] + t5 * source[q + ONE] + t6 * source[q + TWO] + t7 * source[q + THREE]
                    )


@helper
def _lowered(patch, size):
    """Take the grey value in the middle off the patch: what is left of a mean in single precision must not pass for texture."""
    middle = patch[size // 2, size // 2]
    for j in range(size):
        for i in range(size):
            patch[j, i] -= middle
    return middle


@helper
def _normalize(patch, middle, side, span, norm, flat, out):
    """Divide by the norms of template and window, from running sums; NaN where the window is flat (undefined).

    middle: the grey value that was taken off the patch; flat: variance of a window that holds rounding only.
    """
    size = side + span - 1
    n = side * side
    sums = np.zeros(size)
    squares = np.zeros(size)
    for dy in range(span):
        for i in range(size):
            if dy == 0:
                for j in range(side):
                    v = float(patch[j, i])
                    sums[i] += v
                    squares[i] += v * v
            else:
                new, old = float(patch[dy + side - 1, i]), float(patch[dy - 1, i])
                sums[i] += new - old
                squares[i] += new * new - old * old
        s, q = 0.0, 0.0
        for dx in range(span):
            if dx == 0:
                for i in range(side):
                    s += sums[i]
                    q += squares[i]
            else:
                s += sums[dx + side - 1] - sums[dx - 1]
                q += squares[dx + side - 1] - squares[dx - 1]
            spread, least = q - s * s / n, max(1e-7 * (q + n * middle * middle), n * flat)
            out[dy, dx] = out[dy, dx] / (norm * math.sqrt(spread)) if spread > least else np.nan


@helper
def _vertex(scores, y, x):
    """Offset (dx, dy) of the top of the 2-D quadratic through 3x3 scores, within half a pixel, and its least curvature."""
    gx, gy, hxx, hyy = 0.0, 0.0, 0.0, 0.0
    for j in range(-1, 2):
        for i in range(-1, 2):
            s = scores[y + j, x + i]
            gx += i * s / 6
            gy += j * s / 6
            hxx += (3 * i * i - 2) * s / 3
            hyy += (3 * j * j - 2) * s / 3
    hxy = (scores[y + 1, x + 1] + scores[y - 1, x - 1] - scores[y + 1, x - 1] - scores[y - 1, x + 1]) / 4
    det = hxx * hyy - hxy * hxy
    if not (det > 0 and hxx < 0):
        return 0.0, 0.0, 0.0
    least = -0.5 * (hxx + hyy) - math.hypot(0.5 * (hxx - hyy), hxy)
    dx, dy = -(hyy * gx - hxy * gy) / det, -(hxx * gy - hxy * gx) / det
    return min(max(dx, -0.5), 0.5), min(max(dy, -0.5), 0.5), least


@helper
def _best(scores, span):
    """Row and column of the highest score, (-1, -1) where none is defined."""
    y, x, top = -1, -1, F32(-2)
    for j in range(span):
        for i in range(span):
            if scores[j, i] > top:
                y, x, top = j, i, scores[j, i]
    return y, x


@helper
def _rivals(scores, span, y, x, least, found):
    """Other local maxima (a border value counts) above `least`, best first, into found (RIVALS, 2); how many there are."""
    count = 0
    for j in range(span):
        for i in range(span):
            s = scores[j, i]
            if not s > least or (abs(j - y) <= 2 and abs(i - x) <= 2):
                continue
            highest = True
            for b in range(max(0, j - 1), min(span, j + 2)):
                for a in range(max(0, i - 1), min(span, i + 2)):
                    if scores[b, a] > s or (scores[b, a] == s and (b < j or (b == j and a < i))):
                        highest = False
            if not highest:
                continue
            k = min(count, RIVALS - 1)
            if count < RIVALS or s > scores[found[k, 0], found[k, 1]]:
                while k > 0 and s > scores[found[k - 1, 0], found[k - 1, 1]]:
                    found[k, 0], found[k, 1] = found[k - 1, 0], found[k - 1, 1]
                    k -= 1
                found[k, 0], found[k, 1] = j, i
            count += 1
    return count


@njit(cache=True, fastmath=FAST, error_model="numpy", nogil=True)
def correlate_batch(template, target, at, start, shape, half, search, threshold, fraction, gap, flat_variance, out):
    """Normalized cross-correlation of many warped templates around their starts.

    Rivals are the other peaks above this fraction of the best, or within this gap of it in Fisher's z. Windows of no more than
    flat_variance have no texture: black and white parts of a photo hold the tails of what lies beside them, and nothing else.
    out (N, 6 + 3 RIVALS): col, row, score, status, number of rivals, then col, row, score of the best of them; the least
    curvature of the peak, per px^2.
    """
    side = 2 * half + 1
    span = 2 * search + 1
    size = side + span - 1
    padded = (side + 7) // 8 * 8
    spread = (span + 7) // 8 * 8
    values = np.empty(side * side, np.float32)
    weights = np.zeros((side, padded), np.float32)
    patch = np.zeros((size + 1, spread + padded), np.float32)
    wide = np.empty((size + 2, size), np.float32)
    scores = np.empty((span, spread), np.float32)
    scratch = np.empty((8, side), np.float32)
    place = np.empty(side, np.int64)
    found = np.zeros((RIVALS, 2), np.int64)
    flat = template.ravel()
    height, width = template.shape
    tall, broad = target.shape
    for index in range(at.shape[0]):
        result = out[index]
        for k in range(result.size):
            result[k] = np.nan
        result[4] = 0
        col, row = at[index, 0], at[index, 1]
        det = shape[index, 0, 0] * shape[index, 1, 1] - shape[index, 0, 1] * shape[index, 1, 0]
        a11, a12 = shape[index, 1, 1] / det, -shape[index, 0, 1] / det
        a21, a22 = -shape[index, 1, 0] / det, shape[index, 0, 0] / det
        reach_x = (abs(a11) + abs(a12)) * half
        reach_y = (abs(a21) + abs(a22)) * half
        if not (col - reach_x >= 1 and row - reach_y >= 1 and col + reach_x < width - 2 and row + reach_y < height - 2):
            result[3] = OUTSIDE
            continue
        ox, oy = max(1, int(col) - ORIGIN), max(1, int(row) - ORIGIN)
        _sample(flat, width, (oy - 1) * width + ox - 1, col - ox, row - oy, a11, a12, a21, a22, half, scratch, place, values)
        mean, square = F32(0), F32(0)
        for k in range(side * side):
            mean += values[k]
        mean /= side * side
        rest = F32(0)
        for k in range(side * side):
            values[k] -= mean
            rest += values[k]
        rest /= side * side
        for j in range(side):
            for i in range(side):
                weights[j, i] = values[j * side + i] - rest
                square += weights[j, i] * weights[j, i]
        if not math.isfinite(square):
            result[3] = OUTSIDE
            continue
        if square <= side * side * max(1e-7 * mean * mean, flat_variance):
            result[3] = NO_TEXTURE
            continue
        left = math.floor(start[index, 0] + 0.5) - half - search
        top = math.floor(start[index, 1] + 0.5) - half - search
        if not _nodes(target, left, top, size, wide, patch):
            result[3] = LEFT
            continue
        middle = _lowered(patch, size)
        _correlate(weights, patch, side, span, scores)
        _normalize(patch, middle, side, span, math.sqrt(square), flat_variance, scores)
        inside = False
        for j in range(span):
            for i in range(span):
                if left + i >= 1 and left + i + side < broad and top + j >= 1 and top + j + side < tall:
                    inside = True
                else:
                    scores[j, i] = np.nan
        y, x = _best(scores, span)
        if y < 0:
            result[3] = NO_TEXTURE if inside else LEFT
            continue
        result[2] = scores[y, x]
        top_score = min(float(scores[y, x]), 1 - 1e-7)
        least = min(fraction * top_score, math.tanh(math.atanh(top_score) - gap))
        result[4] = _rivals(scores, span, y, x, least, found)
        for k in range(min(int(result[4]), RIVALS)):
            result[5 + 3 * k], result[6 + 3 * k] = left + half + found[k, 1], top + half + found[k, 0]
            result[7 + 3 * k] = scores[found[k, 0], found[k, 1]]
        dx, dy = 0.0, 0.0
        result[3] = LOW_SCORE if scores[y, x] < threshold else AT_BORDER
        if 0 < y < span - 1 and 0 < x < span - 1:
            ring = scores[y - 1, x - 1] + scores[y - 1, x] + scores[y - 1, x + 1] + scores[y, x - 1]
            ring += scores[y, x + 1] + scores[y + 1, x - 1] + scores[y + 1, x] + scores[y + 1, x + 1]
            if math.isfinite(ring):
                dx, dy, result[5 + 3 * RIVALS] = _vertex(scores, y, x)
                if scores[y, x] >= threshold:
                    result[3] = OK
        result[0], result[1] = left + half + x + dx, top + half + y + dy
