"""Compiled steps of one image: the engine's loop on a plain perspective resection, and many starts improved together.

A camera is a row of the ten parameters, pitch x, pitch y, middle column, middle row, squared radius of the fold, and the kind,
as in `bundle._kernels`. An orientation is a row X, Y, Z, m11 .. m33; its tangent is (centre, left rotation vector).
"""

from typing import Any

import numba
import numpy as np

from .._kernels import cholesky, copy_pose, normal, retract, solve
from ..bundle._kernels import bend, invert

njit: Any = numba.njit  # its type stubs do not know every option
_COMMON: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}
kernel = njit(no_cpython_wrapper=True, **_COMMON)
python_kernel = njit(nogil=True, **_COMMON)
STEP, GRADIENT, COST, MAX_ITERATIONS, DIVERGED = range(5)


@python_kernel
def linearised(points, pixels, p, k, x, N, g, J):
    """Half the weighted sum of squares at x, N (6, 6) = J' P J and g (6,) = J' P v; inf where a point cannot be seen.

    J (2, 6): room for the derivatives of one point."""
    N[:] = 0.0
    g[:] = 0.0
    cost = 0.0
    for i in range(len(points)):
        e0, e1, e2 = points[i, 0] - x[0], points[i, 1] - x[1], points[i, 2] - x[2]
        u = x[3] * e0 + x[4] * e1 + x[5] * e2
        v = x[6] * e0 + x[7] * e1 + x[8] * e2
        w = x[9] * e0 + x[10] * e1 + x[11] * e2
        if not w < 0.0:
            return np.inf
        s = -1.0 / w
        a, b = u * s * k[0], v * s * k[0]
        col, row = a, b
        b00 = b11 = 1.0
        b01 = b10 = 0.0
        if k[15] > 1.5:
            col, row, b00, b01, b10, b11 = bend(k, u * s, v * s)
        elif k[15] > 0.5:
            col = (pixels[i, 0] - k[12]) * k[10] - k[1]
            row = (k[13] - pixels[i, 1]) * k[11] - k[2]
            bad, col, row, b00, b01, b10, b11 = invert(k, a, b, col, row, False)
            if bad:
                return np.inf
        v0 = pixels[i, 0] - ((col + k[1]) / k[10] + k[12])
        v1 = pixels[i, 1] - ((row + k[2]) / -k[11] + k[13])
        q = k[0] * s
        for r in range(2):
            f0, f1 = (b00 / k[10], b01 / k[10]) if r == 0 else (-b10 / k[11], -b11 / k[11])
            a0, a1, a2 = f0 * q, f1 * q, (f0 * a + f1 * b) * s
            for j in range(3):
                J[r, j] = -(a0 * x[3 + j] + a1 * x[6 + j] + a2 * x[9 + j])
            J[r, 3], J[r, 4], J[r, 5] = v * a2 - w * a1, w * a0 - u * a2, u * a1 - v * a0
        p00, p01, p11 = p[i, 0, 0], 0.5 * (p[i, 0, 1] + p[i, 1, 0]), p[i, 1, 1]
        pv0, pv1 = p00 * v0 + p01 * v1, p01 * v0 + p11 * v1
        cost += 0.5 * (v0 * pv0 + v1 * pv1)
        for m in range(6):
            g[m] += J[0, m] * pv0 + J[1, m] * pv1
            j0, j1 = p00 * J[0, m] + p01 * J[1, m], p01 * J[0, m] + p11 * J[1, m]
            for n in range(m + 1):
                N[m, n] += j0 * J[0, n] + j1 * J[1, n]
    return cost


@kernel
def scale_of(N, scale):
    """Square roots of the diagonal, kept above round-off."""
    floor = 0.0
    for i in range(6):
        floor = max(floor, N[i, i])
    for i in range(6):
        scale[i] = np.sqrt(max(N[i, i], floor * 1e-24, 2.2250738585072014e-308))


@kernel
def step_of(N, g, scale, damping, B, dx):
    """dx of the damped normal equations with a unit diagonal, by elimination with row pivots; NaN where they are singular."""
    for i in range(6):
        B[i, 6] = g[i] / scale[i]
        for j in range(i + 1):
            B[i, j] = B[j, i] = N[i, j] / scale[i] / scale[j]
        B[i, i] += damping
    for c in range(6):
        top = c
        for i in range(c + 1, 6):
            if abs(B[i, c]) > abs(B[top, c]):
                top = i
        if not abs(B[top, c]) > 0.0:
            dx[:] = np.nan
            return
        for j in range(c, 7):
            B[c, j], B[top, j] = B[top, j], B[c, j]
        for i in range(c + 1, 6):
            f = B[i, c] / B[c, c]
            for j in range(c, 7):
                B[i, j] -= f * B[c, j]
    for i in range(5, -1, -1):
        dx[i] = B[i, 6]
        for j in range(i + 1, 6):
            dx[i] -= B[i, j] * dx[j]
        dx[i] /= B[i, i]
    for i in range(6):
        dx[i] /= scale[i]


@kernel
def moved(x, dx, y):
    """y: the orientation x moved by the tangent dx."""
    a, b, c = dx[3], dx[4], dx[5]
    t2 = a * a + b * b + c * c
    t = np.sqrt(t2)
    f, h = (1 - t2 / 6, 0.5 - t2 / 24) if t2 < 1e-10 else (np.sin(t) / t, (1 - np.cos(t)) / t2)
    for j in range(3):
        y[j] = x[j] + dx[j]
        v0, v1, v2 = x[3 + j], x[6 + j], x[9 + j]
        c0, c1, c2 = b * v2 - c * v1, c * v0 - a * v2, a * v1 - b * v0
        y[3 + j] = v0 + f * c0 + h * (b * c2 - c * c1)
        y[6 + j] = v1 + f * c1 + h * (c * c0 - a * c2)
        y[9 + j] = v2 + f * c2 + h * (a * c1 - b * c0)


@kernel
def cosine(g, scale, cost):
    """Largest cosine between the residuals and a column of the derivatives."""
    largest = 0.0
    for i in range(6):
        largest = max(largest, abs(g[i]) / scale[i])
    return largest / np.sqrt(2 * cost) if cost > 0.0 else 0.0


@python_kernel
def iterate(points, pixels, p, k, limits, most, trials, X, scalars, room):
    """The loop of `adjustment.engine.iterate` on a plain perspective resection, from the start X[0].

    limits: damping, tolerances of step, gradient and cost. X (most + 1, 12) and scalars (most + 1, 5), cost, step, gradient,
    damping, trials, receive the rows. Returns how many there are and why they end. room (2, 16, 7)."""
    N, M, B, J = room[0, :6, :6], room[1, :6, :6], room[0, 6:12], room[1, 6:8, :6]
    g, h, scale, dx = room[1, 8, :6], room[1, 9, :6], room[1, 10, :6], room[1, 11, :6]
    damping, growth = limits[0], 2.0
    cost = linearised(points, pixels, p, k, X[0], N, g, J)
    scalars[0, 0], scalars[0, 1], scalars[0, 2], scalars[0, 3], scalars[0, 4] = cost, np.nan, np.nan, damping, 0
    if not cost < np.inf:
        return 1, DIVERGED
    scale_of(N, scale)
    scalars[0, 2] = cosine(g, scale, cost)
    for index in range(1, most + 1):
        x, y = X[index - 1], X[index]
        fall, length, reach, used, trial, new = -np.inf, np.nan, np.nan, damping, 0, cost
        while trial < trials:
            trial += 1
            used = damping
            step_of(N, g, scale, damping, B, dx)
            length2 = expected = 0.0
            for i in range(6):
                length2 += (dx[i] * scale[i]) ** 2
                expected += dx[i] * g[i]
            length = np.sqrt(length2 / 6)
            if trial == 1:
                reach = length
            new = np.inf
            if length < np.inf:
                moved(x, dx, y)
                new = linearised(points, pixels, p, k, y, M, h, J)
            if new < np.inf:
                fall = cost - new
            if fall >= 0:
                expected = (expected + damping * length2) / 2
                ratio = min(fall / expected, 1.0) if expected > 0 else 1.0
                damping, growth = damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 2.0
                break
            damping, growth = max(damping, 1e-9) * growth, growth * 2
        out = scalars[index]
        out[3], out[4] = used, trial
        if not fall >= 0:
            for i in range(12):
                y[i] = x[i]
            out[0], out[1], out[2] = cost, 0.0, cosine(g, scale, cost)
            return index + 1, COST if out[2] < 1e-7 or reach < 1e-6 else DIVERGED
        relative = fall / cost if cost > 0 else 0.0
        cost = new
        for i in range(6):
            g[i] = h[i]
            for j in range(i + 1):
                N[i, j] = M[i, j]
        scale_of(N, scale)
        out[0], out[1], out[2] = cost, length, cosine(g, scale, cost)
        if length <= limits[1]:
            return index + 1, STEP
        if out[2] <= limits[2]:
            return index + 1, GRADIENT
        if relative <= limits[3] and used < 1e-2:
            return index + 1, COST
    return most + 1, MAX_ITERATIONS


@python_kernel
def together(Y, n, R, t, cost, steps, patience, far, L, A, B, g, h, Rn, tn, go, damping):
    """Levenberg-Marquardt of k poses (R, t) in place, step by step together; cost (k,) half the sum of squares, inf behind the
    camera. Y, R, t as in `orientation._kernels`. From step `patience` on a pose that costs more than `far` and than four times
    the least is given up. A (k, 6, 6), g (k, 6), go, damping (k,), L, B (6, 6), h (6,), Rn, tn: room."""
    count = len(R)
    for m in range(count):
        cost[m] = 0.5 * normal(Y, n, R[m], t[m], A[m], g[m])
        go[m] = cost[m] < np.inf
        damping[m] = 1e-4
    for step in range(steps):
        alive = 0
        for m in range(count):
            if not go[m]:
                continue
            alive += 1
            length = np.inf
            trial = np.inf
            if cholesky(A[m], damping[m], L):
                solve(L, g[m], h)
                length = 0.0
                for i in range(6):
                    length += h[i] * h[i] * A[m, i, i]
                retract(R[m], t[m], h, Rn, tn)
                trial = 0.5 * normal(Y, n, Rn, tn, B, h)
            if trial <= cost[m]:
                copy_pose(R[m], t[m], Rn, tn)
                cost[m] = trial
                for i in range(6):
                    g[m, i] = h[i]
                    for j in range(6):
                        A[m, i, j] = B[i, j]
                damping[m] *= 0.1
            else:
                damping[m] = max(damping[m], 1e-9) * 10
            go[m] = np.sqrt(length) >= 1e-7 * np.sqrt(cost[m]) + 1e-10 * Y[5, 0]
        if alive == 0:
            break
        if step >= patience:
            least = np.inf
            for m in range(count):
                least = min(least, cost[m])
            for m in range(count):
                go[m] = go[m] and cost[m] <= max(far, 4 * least)


@python_kernel
def parallel(X, xy, c, along, axes, sign, updates, M, shift, depth):
    """Orientation by parallel projection, improved by `updates` POSIT steps: points see M X + shift. False where it fails.

    X (n, 3) reduced to their mean. axes (3, 3): their principal axes, right-handed rows; along (n, 3): principal coordinates over
    squared extents. sign: 0 the affine solution, 1 and -1 the reversal solutions of the plane of the first two axes."""
    n = len(X)
    for i in range(n):
        depth[i] = 1.0
    for update in range(updates + 1):
        mean = t0 = t1 = 0.0
        for i in range(n):
            mean += depth[i] / n
        for i in range(n):
            t0 += xy[i, 0] * depth[i] / mean / n
            t1 += xy[i, 1] * depth[i] / mean / n
        a0 = a1 = a2 = b0 = b1 = b2 = 0.0
        for i in range(n):
            u, v = xy[i, 0] * depth[i] / mean - t0, xy[i, 1] * depth[i] / mean - t1
            a0 += u * along[i, 0]
            a1 += u * along[i, 1]
            a2 += u * along[i, 2]
            b0 += v * along[i, 0]
            b1 += v * along[i, 1]
            b2 += v * along[i, 2]
        if sign != 0.0:  # (a2 + i b2)^2 = |g2|^2 - |g1|^2 - 2i g1.g2
            re, im = b0 * b0 + b1 * b1 - a0 * a0 - a1 * a1, -2.0 * (a0 * b0 + a1 * b1)
            root = np.sqrt(0.5 * (np.sqrt(re * re + im * im) + abs(re)))
            other = 0.5 * abs(im) / root if root > 0.0 else 0.0
            a2, b2 = (root, other) if re >= 0.0 else (other, root)
            a2 *= sign
            b2 *= sign if im >= 0.0 else -sign
        aa, ab, bb = a0 * a0 + a1 * a1 + a2 * a2, a0 * b0 + a1 * b1 + a2 * b2, b0 * b0 + b1 * b1 + b2 * b2
        area = np.sqrt(aa * bb - ab * ab)  # product of the singular values; their sum is 2 s
        both = np.sqrt(aa + bb + 2.0 * area)
        if not (area > 0.0 and both < np.inf):
            return False
        f, g, h = (bb + area) / (area * both), -ab / (area * both), (aa + area) / (area * both)  # (B B')^(-1/2)
        x0, x1, x2 = f * a0 + g * b0, f * a1 + g * b1, f * a2 + g * b2
        y0, y1, y2 = g * a0 + h * b0, g * a1 + h * b1, g * a2 + h * b2
        for j in range(3):
            M[0, j] = x0 * axes[0, j] + x1 * axes[1, j] + x2 * axes[2, j]
            M[1, j] = y0 * axes[0, j] + y1 * axes[1, j] + y2 * axes[2, j]
        M[2, 0] = M[0, 1] * M[1, 2] - M[0, 2] * M[1, 1]
        M[2, 1] = M[0, 2] * M[1, 0] - M[0, 0] * M[1, 2]
        M[2, 2] = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
        shift[0], shift[1], shift[2] = 2.0 * t0 / both, 2.0 * t1 / both, -2.0 * c / both
        for i in range(n):
            depth[i] = -(M[2, 0] * X[i, 0] + M[2, 1] * X[i, 1] + M[2, 2] * X[i, 2]) - shift[2]
            if update < updates and not depth[i] > 0.0:
                return False
    return True
