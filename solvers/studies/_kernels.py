"""Compiled loops of the studies' estimators: every run on its own, in place. Loaded at the first use (numba, cached).

m (3, 3) turns object axes into photo axes, x (3,) is the perspective centre; tangents are (centre, left rotation vector).
"""

from typing import Any

import numpy as np
from numba import njit

_OPTIONS: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
_INNER: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True}
compiled = njit(**_INNER)
entry = njit(**_OPTIONS)


@compiled
def take(a, b):
    """a = b, of matrices (loops compile faster than slices)."""
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            a[i, j] = b[i, j]


@compiled
def put(a, b):
    """a = b, of vectors."""
    for i in range(a.shape[0]):
        a[i] = b[i]


@compiled
def clear(n, g):
    """n = 0, g = 0."""
    for i in range(len(g)):
        g[i] = 0.0
        for j in range(len(g)):
            n[i, j] = 0.0


@compiled
def dot(a, b):
    """Scalar product of two vectors of three."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def turned(d, m, out):
    """out = exp([d]x) m."""
    t2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    t = np.sqrt(t2)
    a = np.sin(t) / t if t > 1e-9 else 1.0
    b = (1 - np.cos(t)) / t2 if t > 1e-9 else 0.5
    for k in range(3):
        u, v, w = m[0, k], m[1, k], m[2, k]
        p, q, r = d[1] * w - d[2] * v, d[2] * u - d[0] * w, d[0] * v - d[1] * u
        out[0, k] = u + a * p + b * (d[1] * r - d[2] * q)
        out[1, k] = v + a * q + b * (d[2] * p - d[0] * r)
        out[2, k] = w + a * r + b * (d[0] * q - d[1] * p)


@compiled
def rotation_vector(a, b, out):
    """out = log(a b^T), for turns below pi."""
    out[0] = (dot(a[2], b[1]) - dot(a[1], b[2])) / 2
    out[1] = (dot(a[0], b[2]) - dot(a[2], b[0])) / 2
    out[2] = (dot(a[1], b[0]) - dot(a[0], b[1])) / 2
    sine = np.sqrt(dot(out, out))
    if sine > 1e-12:
        factor = np.arctan2(sine, (dot(a[0], b[0]) + dot(a[1], b[1]) + dot(a[2], b[2]) - 1) / 2) / sine
        for i in range(3):
            out[i] *= factor


@compiled
def damped_step(n, g, damping, dx):
    """dx of (n + damping diag(n)) dx = g by Cholesky; returns the length of the step in units of its scale."""
    k = len(g)
    d, low = np.empty(k), np.zeros((k, k))
    for i in range(k):
        d[i] = np.sqrt(max(n[i, i], 1e-300))
    for i in range(k):
        for j in range(i + 1):
            s = n[i, j] / (d[i] * d[j]) + (damping + 1e-14 if i == j else 0.0)
            for p in range(j):
                s -= low[i, p] * low[j, p]
            low[i, j] = np.sqrt(max(s, 1e-300)) if i == j else s / low[j, j]
    for i in range(k):
        s = g[i] / d[i]
        for p in range(i):
            s -= low[i, p] * dx[p]
        dx[i] = s / low[i, i]
    for i in range(k - 1, -1, -1):
        s = dx[i]
        for p in range(i + 1, k):
            s -= low[p, i] * dx[p]
        dx[i] = s / low[i, i]
    length = 0.0
    for i in range(k):
        length += dx[i] * dx[i]
        dx[i] /= d[i]
    return np.sqrt(length)


@compiled
def collinear(points, xy, c, sigma, m, x, prior_m, prior_x, weight, n, g):
    """Normal matrix n (6, 6) and right side g (6,) of the collinearity equations and the prior; returns the cost."""
    clear(n, g)
    cost = 0.0
    j = np.empty((2, 6))
    for i in range(len(points)):
        a, b, d = points[i, 0] - x[0], points[i, 1] - x[1], points[i, 2] - x[2]
        u = m[0, 0] * a + m[0, 1] * b + m[0, 2] * d
        v = m[1, 0] * a + m[1, 1] * b + m[1, 2] * d
        w = m[2, 0] * a + m[2, 1] * b + m[2, 2] * d
        if w >= 0:
            return np.inf
        p, q, s = u / w, v / w, -c / (w * sigma[i])
        r0, r1 = (xy[i, 0] + c * p) / sigma[i], (xy[i, 1] + c * q) / sigma[i]
        for k in range(3):
            j[0, k], j[1, k] = -s * (m[0, k] - p * m[2, k]), -s * (m[1, k] - q * m[2, k])
        j[0, 3], j[0, 4], j[0, 5] = -s * p * v, s * (w + p * u), -s * v
        j[1, 3], j[1, 4], j[1, 5] = -s * (w + q * v), s * q * u, s * u
        cost += r0 * r0 + r1 * r1
        for k in range(6):
            g[k] += j[0, k] * r0 + j[1, k] * r1
            for e in range(k + 1):
                n[k, e] += j[0, k] * j[0, e] + j[1, k] * j[1, e]
    if len(weight):
        gap = np.empty(6)
        rotation_vector(prior_m, m, gap[3:])
        for k in range(3):
            gap[k] = prior_x[k] - x[k]
        for k in range(6):
            cost += gap[k] * gap[k] * weight[k]
            g[k] += weight[k] * gap[k]
            n[k, k] += weight[k]
    return cost / 2


@entry
def perspective(points, xy, c, sigma, m, x, prior_m, prior_x, weight, steps, costs, rest):
    """Levenberg-Marquardt of every run from (m, x), in place; costs (B,) and whether it came to rest (B,)."""
    n, g, dx = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    tm, tx, tn, tg = np.zeros((3, 3)), np.zeros(3), np.zeros((6, 6)), np.zeros(6)
    for b in range(len(points)):
        damping = 1e-3
        cost = collinear(points[b], xy[b], c, sigma[b], m[b], x[b], prior_m[b], prior_x[b], weight, n, g)
        rest[b] = False
        for _ in range(steps):
            if not np.isfinite(cost):
                break
            length = damped_step(n, g, damping, dx)
            turned(dx[3:], m[b], tm)
            for k in range(3):
                tx[k] = x[b, k] + dx[k]
            trial = collinear(points[b], xy[b], c, sigma[b], tm, tx, prior_m[b], prior_x[b], weight, tn, tg)
            if trial <= cost:
                cost = trial
                take(m[b], tm)
                put(x[b], tx)
                take(n, tn)
                put(g, tg)
                damping *= 0.1
            else:
                damping = max(damping, 1e-9) * 10
            if length < 1e-9 * (1 + np.sqrt(2 * cost)):
                rest[b] = True
                break
        costs[b] = cost


@compiled
def scaled_rotation(reduced, xa, m, steps):
    """min |xa - s M12 X| over rotations and scales, damped, from m, in place; returns the scale (docs/formulas.md 3.3)."""
    n, g, dx, j = np.zeros((4, 4)), np.zeros(4), np.zeros(4), np.empty((2, 4))
    tm, tn, tg = np.zeros((3, 3)), np.zeros((4, 4)), np.zeros(4)
    top = bottom = 0.0
    for i in range(len(reduced)):
        for k in range(2):
            e = m[k, 0] * reduced[i, 0] + m[k, 1] * reduced[i, 1] + m[k, 2] * reduced[i, 2]
            top += e * xa[i, k]
            bottom += e * e
    s, damping, cost = top / bottom, 1e-6, np.inf
    take(tm, m)
    ts, length = s, 1.0
    for _ in range(steps):
        clear(tn, tg)
        trial = 0.0
        for i in range(len(reduced)):
            a, b, d = reduced[i, 0], reduced[i, 1], reduced[i, 2]
            u = tm[0, 0] * a + tm[0, 1] * b + tm[0, 2] * d
            v = tm[1, 0] * a + tm[1, 1] * b + tm[1, 2] * d
            w = tm[2, 0] * a + tm[2, 1] * b + tm[2, 2] * d
            r0, r1 = xa[i, 0] - ts * u, xa[i, 1] - ts * v
            j[0, 0], j[0, 1], j[0, 2], j[0, 3] = 0.0, ts * w, -ts * v, u
            j[1, 0], j[1, 1], j[1, 2], j[1, 3] = -ts * w, 0.0, ts * u, v
            trial += r0 * r0 + r1 * r1
            for k in range(4):
                tg[k] += j[0, k] * r0 + j[1, k] * r1
                for e in range(k + 1):
                    tn[k, e] += j[0, k] * j[0, e] + j[1, k] * j[1, e]
        if trial <= cost:
            s, cost = ts, trial
            take(m, tm)
            take(n, tn)
            put(g, tg)
            damping *= 0.1
            if length < 1e-11:
                break
        else:
            damping = max(damping, 1e-9) * 10
        damped_step(n, g, damping, dx)
        turned(dx[:3], m, tm)
        ts = s + dx[3]
        length = max(abs(dx[0]), abs(dx[1]), abs(dx[2]))
    return s


@compiled
def stretch(points, x, c, m, centre, mean, printed, xa):
    """Orthogonal coordinates xa (n, 2) by form (E), printed, or (D) of the transformation (docs/formulas.md 3.1)."""
    for i in range(len(points)):
        if printed:
            level = m[2, 2] * c
            f = (points[i, 2] - centre[2]) / (mean[2] - centre[2]) * level / (level - x[i, 0] * m[0, 2] - x[i, 1] * m[1, 2])
        else:
            f = (dot(m[2], points[i]) - dot(m[2], centre)) / (dot(m[2], mean) - dot(m[2], centre))
        xa[i, 0], xa[i, 1] = f * x[i, 0], f * x[i, 1]


@compiled
def back(m, s, t, c, mean, printed, centre):
    """Perspective centre of rotation, scale and the orthogonal image t of the centroid (docs/formulas.md 3.5)."""
    if not printed:
        for k in range(3):
            centre[k] = mean[k] - (m[0, k] * t[0] + m[1, k] * t[1] - m[2, k] * c) / s
        return
    centre[2] = mean[2] + m[2, 2] * c / s
    p = dot(m[0], mean) - t[0] / s - m[0, 2] * centre[2]
    q = dot(m[1], mean) - t[1] / s - m[1, 2] * centre[2]
    det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    centre[0], centre[1] = (p * m[1, 1] - q * m[0, 1]) / det, (m[0, 0] * q - m[1, 0] * p) / det


@compiled
def centred(a, mean, out):
    """out = a - mean(a), row by row; the means are left in mean."""
    for k in range(a.shape[1]):
        mean[k] = 0.0
        for i in range(a.shape[0]):
            mean[k] += a[i, k] / a.shape[0]
        for i in range(a.shape[0]):
            out[i, k] = a[i, k] - mean[k]


@entry
def orthogonal(points, x, c, m, centre, printed, rounds, inner, ok):
    """The orthogonal model of every run from (m, centre), in place, in a photo whose coordinates are x (B, n, 2).

    printed: form (E) of the transformation and (19), else (D). rounds: 1 for one pass, else at most so many; ok (B,) tells
    whether the run ended in an orientation, and at rest when iterated.
    """
    count = points.shape[1]
    xa, reduced, mean, t = np.empty((count, 2)), np.empty((count, 3)), np.empty(3), np.empty(2)
    before, change = np.empty((3, 3)), np.empty(3)
    for b in range(len(points)):
        centred(points[b], mean, reduced)
        ok[b] = False
        for _ in range(rounds):
            take(before, m[b])
            stretch(points[b], x[b], c, m[b], centre[b], mean, printed, xa)
            centred(xa, t, xa)
            s = scaled_rotation(reduced, xa, m[b], inner)
            back(m[b], s, t, c, mean, printed, centre[b])
            if not (s > 0 and np.isfinite(centre[b, 0] + centre[b, 1] + centre[b, 2] + m[b, 0, 0])):
                break
            rotation_vector(m[b], before, change)
            if rounds == 1 or dot(change, change) < 1e-18:
                ok[b] = True
                break
