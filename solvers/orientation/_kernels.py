"""Compiled kernels of the batched resection: many small images, each on its own, no allocation per image.

Inside, the camera frame is x right, y DOWN, z forward (the photo frame turned by S = diag(1, -1, -1)), image coordinates are
ideal and divided by the principal distance, and an image is held as one array Y of rows

    Y[0:3]  X - mean(X), m      Y[3:5]  x/c, -y/c      Y[5]  square root of the weight

with the pose (R, t), P = R Y + t, t = R (mean(X) - X_C). The tangent is (e, d): t <- t + e, R <- exp([d]x) R, so the normal
matrix stays well conditioned at narrow fields and at any size of the ground coordinates. Costs are sums of squares over sigma.

Reference: collinearity and scaled orthography as in docs; P3P: Grunert 1841 after Haralick et al. 1994, eq. 9.
"""

from typing import Any

import numba
import numpy as np

njit: Any = numba.njit  # its type stubs do not know every option
FAST = {"reassoc", "contract", "nsz", "arcp"}  # no nnan, no ninf: NaN checks stay alive
# _nrt=False: nothing in here allocates, and counting references would cost more than the arithmetic
_SMALL: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
kernel = njit(no_cpython_wrapper=True, _nrt=False, **_SMALL)
fast_kernel = njit(no_cpython_wrapper=True, _nrt=False, fastmath=FAST, **_SMALL)
python_kernel = njit(_nrt=False, nogil=True, **_SMALL)
inlined = njit(no_cpython_wrapper=True, _nrt=False, inline="always", **_SMALL)
OK, AMBIGUOUS, TOO_FEW, COLLINEAR, DIVERGED, NOT_FINITE, BEHIND_CAMERA, OUTLIER, WEAK, SINGULAR = range(10)
MAX_MINIMA = 12
MAX_STARTS = 40
AMBIGUOUS_CHI2 = 36.0  # D = 6: docs/formulas.md, section 3.4
WEAK_ROTATION = 0.0873  # rad (5 degrees): beyond it the linear covariance says nothing
CURVED_ROTATION = 0.0035  # rad (0.2 degrees): beyond it the linear covariance is looked at before it is believed


@fast_kernel
def normal(Y, n, R, t, A, g):
    """Lower normal matrix A (6, 6) and right side g (6,) of the tangent (e, d); returns the cost, inf behind the camera."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = (
        R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2], R[2, 0], R[2, 1], R[2, 2],
    )  # fmt: skip
    t0, t1, t2 = t[0], t[1], t[2]
    X, Yy, Z, u, v, w = Y[0], Y[1], Y[2], Y[3], Y[4], Y[5]
    tiny = 1e-9 * abs(t2)
    behind = 0
    cost = s00 = s02 = s12 = s22 = 0.0
    s30 = s31 = s32 = s40 = s41 = s42 = s50 = s51 = s52 = 0.0
    s33 = s43 = s44 = s53 = s54 = s55 = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    for i in range(n):
        px, py, pz = X[i], Yy[i], Z[i]
        a = r00 * px + r01 * py + r02 * pz
        b = r10 * px + r11 * py + r12 * pz
        c = r20 * px + r21 * py + r22 * pz
        depth = c + t2
        behind += depth <= tiny
        iz = 1.0 / depth
        x = (a + t0) * iz
        y = (b + t1) * iz
        q = iz * w[i]
        ru = (u[i] - x) * w[i]
        rv = (v[i] - y) * w[i]
        a *= q
        b *= q
        c *= q
        j3 = -x * b  # row of x: (q, 0, -xq, j3, j4, -b); row of y: (0, q, -yq, k3, k4, a)
        j4 = c + x * a
        k3 = -c - y * b
        k4 = y * a
        xq = x * q
        yq = y * q
        cost += ru * ru + rv * rv
        s00 += q * q
        s02 -= q * xq
        s12 -= q * yq
        s22 += xq * xq + yq * yq
        s30 += q * j3
        s31 += q * k3
        s32 -= xq * j3 + yq * k3
        s40 += q * j4
        s41 += q * k4
        s42 -= xq * j4 + yq * k4
        s50 -= q * b
        s51 += q * a
        s52 += xq * b - yq * a
        s33 += j3 * j3 + k3 * k3
        s43 += j3 * j4 + k3 * k4
        s44 += j4 * j4 + k4 * k4
        s53 += k3 * a - j3 * b
        s54 += k4 * a - j4 * b
        s55 += a * a + b * b
        g0 += q * ru
        g1 += q * rv
        g2 -= xq * ru + yq * rv
        g3 += j3 * ru + k3 * rv
        g4 += j4 * ru + k4 * rv
        g5 += a * rv - b * ru
    A[0, 0] = s00
    A[1, 0] = 0.0
    A[1, 1] = s00
    A[2, 0] = s02
    A[2, 1] = s12
    A[2, 2] = s22
    A[3, 0] = s30
    A[3, 1] = s31
    A[3, 2] = s32
    A[3, 3] = s33
    A[4, 0] = s40
    A[4, 1] = s41
    A[4, 2] = s42
    A[4, 3] = s43
    A[4, 4] = s44
    A[5, 0] = s50
    A[5, 1] = s51
    A[5, 2] = s52
    A[5, 3] = s53
    A[5, 4] = s54
    A[5, 5] = s55
    g[0] = g0
    g[1] = g1
    g[2] = g2
    g[3] = g3
    g[4] = g4
    g[5] = g5
    return np.inf if behind > 0 else cost


@kernel
def cost_of(Y, n, R, t):
    """Sum of squared weighted residuals; inf when a point lies behind the camera."""
    s = 0.0
    for i in range(n):
        z = R[2, 0] * Y[0, i] + R[2, 1] * Y[1, i] + R[2, 2] * Y[2, i] + t[2]
        if not z > 0.0:
            return np.inf
        du = Y[3, i] - (R[0, 0] * Y[0, i] + R[0, 1] * Y[1, i] + R[0, 2] * Y[2, i] + t[0]) / z
        dv = Y[4, i] - (R[1, 0] * Y[0, i] + R[1, 1] * Y[1, i] + R[1, 2] * Y[2, i] + t[1]) / z
        s += (du * du + dv * dv) * Y[5, i] * Y[5, i]
    return s


@kernel
def cholesky(A, damping, L):
    """L with Marquardt damping of the diagonal, unrolled; its diagonal holds the reciprocals. False when not definite."""
    k = 1.0 + damping
    d0 = A[0, 0] * k
    i0 = 1.0 / np.sqrt(d0)
    l10 = A[1, 0] * i0
    l20 = A[2, 0] * i0
    l30 = A[3, 0] * i0
    l40 = A[4, 0] * i0
    l50 = A[5, 0] * i0
    d1 = A[1, 1] * k - l10 * l10
    i1 = 1.0 / np.sqrt(d1)
    l21 = (A[2, 1] - l20 * l10) * i1
    l31 = (A[3, 1] - l30 * l10) * i1
    l41 = (A[4, 1] - l40 * l10) * i1
    l51 = (A[5, 1] - l50 * l10) * i1
    d2 = A[2, 2] * k - l20 * l20 - l21 * l21
    i2 = 1.0 / np.sqrt(d2)
    l32 = (A[3, 2] - l30 * l20 - l31 * l21) * i2
    l42 = (A[4, 2] - l40 * l20 - l41 * l21) * i2
    l52 = (A[5, 2] - l50 * l20 - l51 * l21) * i2
    d3 = A[3, 3] * k - l30 * l30 - l31 * l31 - l32 * l32
    i3 = 1.0 / np.sqrt(d3)
    l43 = (A[4, 3] - l40 * l30 - l41 * l31 - l42 * l32) * i3
    l53 = (A[5, 3] - l50 * l30 - l51 * l31 - l52 * l32) * i3
    d4 = A[4, 4] * k - l40 * l40 - l41 * l41 - l42 * l42 - l43 * l43
    i4 = 1.0 / np.sqrt(d4)
    l54 = (A[5, 4] - l50 * l40 - l51 * l41 - l52 * l42 - l53 * l43) * i4
    d5 = A[5, 5] * k - l50 * l50 - l51 * l51 - l52 * l52 - l53 * l53 - l54 * l54
    i5 = 1.0 / np.sqrt(d5)
    L[0, 0] = i0
    L[1, 0] = l10
    L[2, 0] = l20
    L[3, 0] = l30
    L[4, 0] = l40
    L[5, 0] = l50
    L[1, 1] = i1
    L[2, 1] = l21
    L[3, 1] = l31
    L[4, 1] = l41
    L[5, 1] = l51
    L[2, 2] = i2
    L[3, 2] = l32
    L[4, 2] = l42
    L[5, 2] = l52
    L[3, 3] = i3
    L[4, 3] = l43
    L[5, 3] = l53
    L[4, 4] = i4
    L[5, 4] = l54
    L[5, 5] = i5
    return (
        d0 > 1e-14 * A[0, 0]
        and d1 > 1e-14 * A[1, 1]
        and d2 > 1e-14 * A[2, 2]
        and d3 > 1e-14 * A[3, 3]
        and d4 > 1e-14 * A[4, 4]
        and d5 > 1e-14 * A[5, 5]
    )


@kernel
def solve(L, g, x):
    """x with L L' x = g, unrolled; returns g . x, the fall of the cost that the linear model promises."""
    y0 = g[0] * L[0, 0]
    y1 = (g[1] - L[1, 0] * y0) * L[1, 1]
    y2 = (g[2] - L[2, 0] * y0 - L[2, 1] * y1) * L[2, 2]
    y3 = (g[3] - L[3, 0] * y0 - L[3, 1] * y1 - L[3, 2] * y2) * L[3, 3]
    y4 = (g[4] - L[4, 0] * y0 - L[4, 1] * y1 - L[4, 2] * y2 - L[4, 3] * y3) * L[4, 4]
    y5 = (g[5] - L[5, 0] * y0 - L[5, 1] * y1 - L[5, 2] * y2 - L[5, 3] * y3 - L[5, 4] * y4) * L[5, 5]
    x5 = y5 * L[5, 5]
    x4 = (y4 - L[5, 4] * x5) * L[4, 4]
    x3 = (y3 - L[4, 3] * x4 - L[5, 3] * x5) * L[3, 3]
    x2 = (y2 - L[3, 2] * x3 - L[4, 2] * x4 - L[5, 2] * x5) * L[2, 2]
    x1 = (y1 - L[2, 1] * x2 - L[3, 1] * x3 - L[4, 1] * x4 - L[5, 1] * x5) * L[1, 1]
    x0 = (y0 - L[1, 0] * x1 - L[2, 0] * x2 - L[3, 0] * x3 - L[4, 0] * x4 - L[5, 0] * x5) * L[0, 0]
    x[0], x[1], x[2], x[3], x[4], x[5] = x0, x1, x2, x3, x4, x5
    return y0 * y0 + y1 * y1 + y2 * y2 + y3 * y3 + y4 * y4 + y5 * y5


@kernel
def retract(R, t, x, Rn, tn):
    """(Rn, tn) = (R, t) moved by the tangent x: Cayley rotation, orthonormal to round-off without trigonometry."""
    a, b, c = 0.5 * x[3], 0.5 * x[4], 0.5 * x[5]
    k = 2.0 / (1.0 + a * a + b * b + c * c)
    for j in range(3):
        v0, v1, v2 = R[0, j], R[1, j], R[2, j]
        c0, c1, c2 = b * v2 - c * v1, c * v0 - a * v2, a * v1 - b * v0
        Rn[0, j] = v0 + k * (c0 + b * c2 - c * c1)
        Rn[1, j] = v1 + k * (c1 + c * c0 - a * c2)
        Rn[2, j] = v2 + k * (c2 + a * c1 - b * c0)
        tn[j] = t[j] + x[j]


@kernel
def copy_pose(R, t, Rn, tn):
    """(R, t) = (Rn, tn)."""
    for i in range(3):
        t[i] = tn[i]
        for j in range(3):
            R[i, j] = Rn[i, j]


@kernel
def refine(Y, n, R, t, work, ceiling):
    """Levenberg-Marquardt from (R, t), in place. Returns (cost, how): 0 failed, 1 converged, 2 creeps along a flat valley.

    Gives up at once when the start is behind the camera (inf) or its first step does not promise to come below the ceiling.
    """
    A, B, L, g, h, x, Rn, tn = work
    copy_pose(Rn, tn, R, t)
    cost = np.inf
    damping = 0.0
    rejected = 0
    for step in range(50):
        trial = normal(Y, n, Rn, tn, B, h)
        if step == 0 and not trial < np.inf:
            return np.inf, 0
        if step == 0 or trial <= cost * (1.0 + 1e-12):
            if step > 15 and cost - trial < 1e-4 * (1.0 + 1e-3 * cost):
                copy_pose(R, t, Rn, tn)
                return trial, 2
            cost = trial
            A, B = B, A
            g, h = h, g
            copy_pose(R, t, Rn, tn)
            damping = 0.1 * damping if damping > 1e-6 else 0.0
            rejected = 0
        else:
            damping = max(10.0 * damping, 1e-4)
            rejected += 1
        while not cholesky(A, damping, L):
            damping = max(10.0 * damping, 1e-6)
            rejected += 1
            if not damping < 1e6:
                return cost, 0
        if rejected > 15:
            return cost, 0
        promised = solve(L, g, x)
        if step == 0 and cost - promised > ceiling:
            return cost, 0
        retract(R, t, x, Rn, tn)
        if promised < 1e-6 + 1e-13 * cost and damping < 1e-2:
            copy_pose(R, t, Rn, tn)
            return max(cost - promised, 0.0), 1
    return cost, 0


@kernel
def eigen3(S, E, values):
    """Eigenvectors of a symmetric 3x3 as columns of E, right handed, eigenvalues falling (cyclic Jacobi); S is destroyed."""
    for i in range(3):
        for j in range(3):
            E[i, j] = 1.0 if i == j else 0.0
    for _ in range(12):
        off = abs(S[0, 1]) + abs(S[0, 2]) + abs(S[1, 2])
        if not off > 1e-15 * (abs(S[0, 0]) + abs(S[1, 1]) + abs(S[2, 2])):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if S[p, q] == 0.0:
                    continue
                theta = (S[q, q] - S[p, p]) / (2.0 * S[p, q])
                tau = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    tau = -tau
                c = 1.0 / np.sqrt(tau * tau + 1.0)
                s = tau * c
                for k in range(3):
                    f, h = S[k, p], S[k, q]
                    S[k, p], S[k, q] = c * f - s * h, s * f + c * h
                for k in range(3):
                    f, h = S[p, k], S[q, k]
                    S[p, k], S[q, k] = c * f - s * h, s * f + c * h
                for k in range(3):
                    f, h = E[k, p], E[k, q]
                    E[k, p], E[k, q] = c * f - s * h, s * f + c * h
    for i in range(3):
        values[i] = S[i, i]
    for i in range(2):
        for j in range(2 - i):
            if values[j] < values[j + 1]:
                values[j], values[j + 1] = values[j + 1], values[j]
                for k in range(3):
                    E[k, j], E[k, j + 1] = E[k, j + 1], E[k, j]
    E[0, 2] = E[1, 0] * E[2, 1] - E[2, 0] * E[1, 1]
    E[1, 2] = E[2, 0] * E[0, 1] - E[0, 0] * E[2, 1]
    E[2, 2] = E[0, 0] * E[1, 1] - E[1, 0] * E[0, 1]


@kernel
def nadir_start(Y, n, R, t):
    """Similarity of plan and photo: a vertical photo. Returns the share of the photo's spread that it explains."""
    mu = mv = sa = sb = sd = sp = 0.0
    for i in range(n):
        mu += Y[3, i]
        mv += Y[4, i]
    mu /= n
    mv /= n
    for i in range(n):
        x, y, u, v = Y[0, i], Y[1, i], Y[3, i] - mu, mv - Y[4, i]
        sa += x * u + y * v
        sb += x * v - y * u
        sd += x * x + y * y
        sp += u * u + v * v
    norm = sa * sa + sb * sb
    if not (norm > 0.0 and sd * sp > 0.0):
        return 0.0
    root = np.sqrt(norm)
    ca, sn, h = sa / root, sb / root, sd / root
    R[0, 0], R[0, 1], R[0, 2] = ca, -sn, 0.0
    R[1, 0], R[1, 1], R[1, 2] = -sn, -ca, 0.0
    R[2, 0], R[2, 1], R[2, 2] = 0.0, 0.0, -1.0
    t[0], t[1], t[2] = mu * h, mv * h, h
    return norm / (sd * sp)


@kernel
def turn_to_axis(m0, m1, m2, V):
    """Smallest rotation V that takes the unit vector m, m2 > -1, to the optical axis."""
    k = 1.0 / (1.0 + m2)
    V[0, 0], V[0, 1], V[0, 2] = 1.0 - m0 * m0 * k, -m0 * m1 * k, -m0
    V[1, 0], V[1, 1], V[1, 2] = -m0 * m1 * k, 1.0 - m1 * m1 * k, -m1
    V[2, 0], V[2, 1], V[2, 2] = m0, m1, m2


@kernel
def mean_ray(Y, n, V):
    """The rotation of the re-centred bundle."""
    m0 = m1 = m2 = 0.0
    for i in range(n):
        k = 1.0 / np.sqrt(1.0 + Y[3, i] * Y[3, i] + Y[4, i] * Y[4, i])
        m0 += Y[3, i] * k
        m1 += Y[4, i] * k
        m2 += k
    k = 1.0 / np.sqrt(m0 * m0 + m1 * m1 + m2 * m2)
    turn_to_axis(m0 * k, m1 * k, m2 * k, V)


@kernel
def orthographic_starts(Y, n, E, values, V, Rs, ts, b):
    """Both scaled-orthography poses of the re-centred bundle (plane solutions in the two widest axes); returns how many.

    Two updates of the depths (POSIT) take the perspective into account. E, values: principal axes of the ground points.
    """
    mean_ray(Y, n, V)
    count = 0
    for sign in range(2):
        R, t = Rs[count], ts[count]
        good = True
        for update in range(3):
            mu = mv = 0.0
            b[0, 0] = b[0, 1] = b[1, 0] = b[1, 1] = 0.0
            for i in range(n):
                x, y, z = Y[3, i], Y[4, i], 1.0
                w = V[2, 0] * x + V[2, 1] * y + V[2, 2] * z
                if not w > 0.02:
                    return 0
                p = (V[0, 0] * x + V[0, 1] * y + V[0, 2] * z) / w
                q = (V[1, 0] * x + V[1, 1] * y + V[1, 2] * z) / w
                if update > 0:
                    k = 1.0 + (R[2, 0] * Y[0, i] + R[2, 1] * Y[1, i] + R[2, 2] * Y[2, i]) / t[2]
                    if not k > 0.0:
                        good = False
                        k = 1.0
                    p *= k
                    q *= k
                mu += p
                mv += q
                for j in range(2):
                    e = E[0, j] * Y[0, i] + E[1, j] * Y[1, i] + E[2, j] * Y[2, i]
                    b[0, j] += p * e
                    b[1, j] += q * e
            for j in range(2):
                b[0, j] /= values[j]
                b[1, j] /= values[j]
            # (a0 + i a1)^2 = |g2|^2 - |g1|^2 - 2i g1.g2: third components of the two rows from orthogonality and equal length
            re = b[1, 0] ** 2 + b[1, 1] ** 2 - b[0, 0] ** 2 - b[0, 1] ** 2
            im = -2.0 * (b[0, 0] * b[1, 0] + b[0, 1] * b[1, 1])
            mod = np.sqrt(re * re + im * im)
            a0 = np.sqrt(max(0.5 * (mod + re), 0.0))
            a1 = np.sqrt(max(0.5 * (mod - re), 0.0))
            if im < 0.0:
                a1 = -a1
            if sign == 1:
                a0, a1 = -a0, -a1
            s = np.sqrt(b[0, 0] ** 2 + b[0, 1] ** 2 + a0 * a0)
            if not s > 0.0:
                good = False
                break
            for j in range(3):
                R[0, j] = (b[0, 0] * E[j, 0] + b[0, 1] * E[j, 1] + a0 * E[j, 2]) / s
                R[1, j] = (b[1, 0] * E[j, 0] + b[1, 1] * E[j, 1] + a1 * E[j, 2]) / s
            R[2, 0] = R[0, 1] * R[1, 2] - R[0, 2] * R[1, 1]
            R[2, 1] = R[0, 2] * R[1, 0] - R[0, 0] * R[1, 2]
            R[2, 2] = R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0]
            t[0], t[1], t[2] = mu / n / s, mv / n / s, 1.0 / s
            if not good:
                break
        if good:
            turn_back(V, R, t)
            count += 1
    return count


@kernel
def turn_back(V, R, t):
    """(V' R, V' t) in place."""
    for j in range(3):
        a, b, c = R[0, j], R[1, j], R[2, j]
        for i in range(3):
            R[i, j] = V[0, i] * a + V[1, i] * b + V[2, i] * c
    a, b, c = t[0], t[1], t[2]
    for i in range(3):
        t[i] = V[0, i] * a + V[1, i] * b + V[2, i] * c


@kernel
def reversed_pose(R, t, n0, n1, n2, Rm, tm):
    """The reversal twin of (R, t) for a plane with normal n: mirrored about the viewing ray, Rm = H_ray R H_n, tm = t."""
    norm = 2.0 / (n0 * n0 + n1 * n1 + n2 * n2)
    k = 1.0 / np.sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    s0, s1, s2 = t[0] * k, t[1] * k, t[2] * k
    for i in range(3):
        f = norm * (R[i, 0] * n0 + R[i, 1] * n1 + R[i, 2] * n2)
        tm[i] = t[i]
        Rm[i, 0], Rm[i, 1], Rm[i, 2] = R[i, 0] - f * n0, R[i, 1] - f * n1, R[i, 2] - f * n2
    for j in range(3):
        f = 2.0 * (s0 * Rm[0, j] + s1 * Rm[1, j] + s2 * Rm[2, j])
        Rm[0, j] -= f * s0
        Rm[1, j] -= f * s1
        Rm[2, j] -= f * s2


@kernel
def quartic(a, b, c, d, e, roots):
    """Real roots of a x^4 + .. + e, with the real part of complex pairs (noise splits double roots); returns how many."""
    b, c, d, e = b / a, c / a, d / a, e / a
    p = c - 0.375 * b * b
    q = d - 0.5 * b * c + 0.125 * b * b * b
    r = e - 0.25 * b * d + 0.0625 * b * b * c - 3.0 * b**4 / 256.0
    # largest real root z of z^3 + 2p z^2 + (p^2 - 4r) z - q^2, >= 0
    B, C, D = 2.0 * p, p * p - 4.0 * r, -q * q
    Q = (B * B - 3.0 * C) / 9.0
    W = (2.0 * B**3 - 9.0 * B * C + 27.0 * D) / 54.0
    if Q > 0.0 and W * W < Q**3:
        z = -2.0 * np.sqrt(Q) * np.cos((np.arccos(W / np.sqrt(Q**3)) + 2.0 * np.pi) / 3.0) - B / 3.0
        z = max(z, -2.0 * np.sqrt(Q) * np.cos(np.arccos(W / np.sqrt(Q**3)) / 3.0) - B / 3.0)
        z = max(z, -2.0 * np.sqrt(Q) * np.cos((np.arccos(W / np.sqrt(Q**3)) - 2.0 * np.pi) / 3.0) - B / 3.0)
    else:
        m = -np.sign(W) * (abs(W) + np.sqrt(max(W * W - Q**3, 0.0))) ** (1.0 / 3.0)
        z = m + (Q / m if m != 0.0 else 0.0) - B / 3.0
    s = np.sqrt(max(z, 0.0))
    k = 0
    for sign in (1.0, -1.0):
        if s > 1e-9 * (1.0 + abs(p)) ** 0.5:
            half = 0.5 * (p + z) - sign * q / (2.0 * s)
        else:
            half = 0.5 * (p + sign * np.sqrt(max(p * p - 4.0 * r, 0.0)))
        disc = z - 4.0 * half
        if disc > 0.0:
            roots[k] = 0.5 * (-sign * s + np.sqrt(disc)) - 0.25 * b
            roots[k + 1] = 0.5 * (-sign * s - np.sqrt(disc)) - 0.25 * b
            k += 2
        else:
            roots[k] = -0.5 * sign * s - 0.25 * b
            k += 1
    return k


@kernel
def triad(a0, a1, a2, b0, b1, b2, T):
    """Right-handed orthonormal frame T (columns) on two vectors."""
    k = 1.0 / np.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    T[0, 0], T[1, 0], T[2, 0] = a0 * k, a1 * k, a2 * k
    c0, c1, c2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    k = 1.0 / np.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
    T[0, 2], T[1, 2], T[2, 2] = c0 * k, c1 * k, c2 * k
    T[0, 1] = T[1, 2] * T[2, 0] - T[2, 2] * T[1, 0]
    T[1, 1] = T[2, 2] * T[0, 0] - T[0, 2] * T[2, 0]
    T[2, 1] = T[0, 2] * T[1, 0] - T[1, 2] * T[0, 0]


@kernel
def polish(s1, s2, s3, a2, b2, c2, ca, cb, cg):
    """Newton on the three distances; leaves them alone where the three spheres touch (double root)."""
    for _ in range(4):
        ea = a2 - s2 * s2 - s3 * s3 + 2.0 * s2 * s3 * ca
        eb = b2 - s1 * s1 - s3 * s3 + 2.0 * s1 * s3 * cb
        ec = c2 - s1 * s1 - s2 * s2 + 2.0 * s1 * s2 * cg
        m01, m02 = 2.0 * (s2 - s3 * ca), 2.0 * (s3 - s2 * ca)
        m10, m12 = 2.0 * (s1 - s3 * cb), 2.0 * (s3 - s1 * cb)
        m20, m21 = 2.0 * (s1 - s2 * cg), 2.0 * (s2 - s1 * cg)
        det = m01 * m12 * m20 + m02 * m10 * m21
        if not abs(det) > 1e-12 * s1 * s1 * s1:
            break
        d1 = (m12 * (m01 * ec - m21 * ea) + m02 * m21 * eb) / det
        d2 = (m02 * (m10 * ec - m20 * eb) + m12 * m20 * ea) / det
        d3 = (m01 * (m20 * eb - m10 * ec) + m10 * m21 * ea) / det
        if not abs(d1) + abs(d2) + abs(d3) < 0.2 * s1:
            break
        s1, s2, s3 = s1 + d1, s2 + d2, s3 + d3
    return s1, s2, s3


@python_kernel
def three_point(Y, i, j, k, Rs, ts, f, World, Cam, roots):
    """All poses of three points (Grunert 1841; Haralick et al. 1994), distances polished by Newton; returns how many."""
    idx = (i, j, k)
    for m in range(3):
        u, v = Y[3, idx[m]], Y[4, idx[m]]
        w = 1.0 / np.sqrt(1.0 + u * u + v * v)
        f[m, 0], f[m, 1], f[m, 2] = u * w, v * w, w
    a2 = b2 = c2 = ca = cb = cg = 0.0
    for m in range(3):
        a2 += (Y[m, j] - Y[m, k]) ** 2
        b2 += (Y[m, i] - Y[m, k]) ** 2
        c2 += (Y[m, i] - Y[m, j]) ** 2
        ca += f[1, m] * f[2, m]
        cb += f[0, m] * f[2, m]
        cg += f[0, m] * f[1, m]
    if not (a2 > 0.0 and b2 > 0.0 and c2 > 0.0):
        return 0
    p, q, h, gg = (a2 - c2) / b2, (a2 + c2) / b2, c2 / b2, a2 / b2
    A4 = (p - 1.0) ** 2 - 4.0 * h * ca * ca
    A3 = 4.0 * (p * (1.0 - p) * cb - (1.0 - q) * ca * cg + 2.0 * h * ca * ca * cb)
    A2 = p * p * (1.0 + 2.0 * cb * cb) - 1.0 + 2.0 * (1.0 - h) * ca * ca - 4.0 * q * ca * cb * cg + 2.0 * (1.0 - gg) * cg * cg
    A2 *= 2.0
    A1 = 4.0 * (-p * (1.0 + p) * cb + 2.0 * gg * cg * cg * cb - (1.0 - q) * ca * cg)
    A0 = (1.0 + p) ** 2 - 4.0 * gg * cg * cg
    if not abs(A4) > 1e-12 * (abs(A3) + abs(A2) + abs(A1) + abs(A0)):
        return 0
    found = quartic(A4, A3, A2, A1, A0, roots)
    triad(Y[0, j] - Y[0, i], Y[1, j] - Y[1, i], Y[2, j] - Y[2, i], Y[0, k] - Y[0, i], Y[1, k] - Y[1, i], Y[2, k] - Y[2, i], World)
    count = 0
    for m in range(found):
        v = roots[m]
        den = 2.0 * (cg - v * ca)
        base = 1.0 + v * v - 2.0 * v * cb
        if not (v > 0.0 and base > 0.0):
            continue
        s1 = np.sqrt(b2 / base)
        half = np.sqrt(max(cg * cg - 1.0 + h * base, 0.0))
        symmetric = abs(den) < 1e-7  # u from the quadratic of c then, both signs
        for sign in range(2 if symmetric else 1):
            if symmetric:
                u = cg + half if sign == 0 else cg - half
            else:
                u = ((p - 1.0) * v * v - 2.0 * p * cb * v + 1.0 + p) / den
            r1, r2, r3 = polish(s1, u * s1, v * s1, a2, b2, c2, ca, cb, cg)
            if not (r1 > 0.0 and r2 > 0.0 and r3 > 0.0) or count == len(Rs):
                continue
            triad(
                r2 * f[1, 0] - r1 * f[0, 0], r2 * f[1, 1] - r1 * f[0, 1], r2 * f[1, 2] - r1 * f[0, 2],
                r3 * f[2, 0] - r1 * f[0, 0], r3 * f[2, 1] - r1 * f[0, 1], r3 * f[2, 2] - r1 * f[0, 2], Cam,
            )  # fmt: skip
            R, t = Rs[count], ts[count]
            for r in range(3):
                for c in range(3):
                    R[r, c] = Cam[r, 0] * World[c, 0] + Cam[r, 1] * World[c, 1] + Cam[r, 2] * World[c, 2]
            for r in range(3):
                t[r] = r1 * f[0, r] - (R[r, 0] * Y[0, i] + R[r, 1] * Y[1, i] + R[r, 2] * Y[2, i])
            count += 1
    return count


@kernel
def keep(minima, count, R, t, cost):
    """Puts a minimum into its place by cost unless it is already there; returns the new count."""
    Rm, tm, cm = minima
    for k in range(count):
        turn = shift = size = 0.0
        for i in range(3):
            shift += (tm[k, i] - t[i]) ** 2
            size += t[i] * t[i]
            for j in range(3):
                turn += (Rm[k, i, j] - R[i, j]) ** 2
        if turn < 1e-7 and shift < 1e-7 * size:
            return count
    k = count if count < len(cm) else count - 1
    if k < count and cost >= cm[k]:
        return count
    while k > 0 and cm[k - 1] > cost:
        copy_pose(Rm[k], tm[k], Rm[k - 1], tm[k - 1])
        cm[k] = cm[k - 1]
        k -= 1
    copy_pose(Rm[k], tm[k], R, t)
    cm[k] = cost
    return min(count + 1, len(cm))


@kernel
def widest_triple(Y, n, seed):
    """Indices of a wide triple that contains the seed point: the farthest from it, then the largest triangle."""
    j = k = seed
    far = -1.0
    for i in range(n):
        d = (Y[0, i] - Y[0, seed]) ** 2 + (Y[1, i] - Y[1, seed]) ** 2 + (Y[2, i] - Y[2, seed]) ** 2
        if d > far:
            far, j = d, i
    far = -1.0
    ax, ay, az = Y[0, j] - Y[0, seed], Y[1, j] - Y[1, seed], Y[2, j] - Y[2, seed]
    for i in range(n):
        bx, by, bz = Y[0, i] - Y[0, seed], Y[1, i] - Y[1, seed], Y[2, i] - Y[2, seed]
        d = (ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2
        if d > far:
            far, k = d, i
    return j, k


@kernel
def several(Y, n, trace, seen):
    """True when the ground points lie at six places or more (5 % of the rms extent apart)."""
    near = 0.0025 * trace / n
    count = 0
    for i in range(n):
        new = True
        for k in range(count):
            j = seen[k]
            if (Y[0, i] - Y[0, j]) ** 2 + (Y[1, i] - Y[1, j]) ** 2 + (Y[2, i] - Y[2, j]) ** 2 < near:
                new = False
                break
        if new:
            seen[count] = i
            count += 1
            if count == 6:
                return True
    return False


@kernel
def bad_fit(dof):
    """Sum of squares that chance exceeds in 3 of a million images (Wilson and Hilferty 1931)."""
    if dof <= 0:
        return np.inf
    k = 2.0 / (9.0 * dof)
    return dof * (1.0 - k + 4.5 * np.sqrt(k)) ** 3


@inlined
def general_starts(Y, n, stage, ws):
    """Fills the starts: the likelier of both scaled orthographies (stage 1), or both and three-point poses (stage 2)."""
    _, E, values, V, Rs, ts, small, roots, _, _ = ws
    starts = orthographic_starts(Y, n, E, values, V, Rs, ts, small[0])
    if stage == 1:
        if starts == 2 and cost_of(Y, n, Rs[1], ts[1]) < cost_of(Y, n, Rs[0], ts[0]):
            copy_pose(Rs[0], ts[0], Rs[1], ts[1])
        return min(starts, 1)
    for corner in range(4 if n > 3 else 1):
        seed = corner * n // 4
        j, k = widest_triple(Y, n, seed)
        starts += three_point(Y, seed, j, k, Rs[starts:], ts[starts:], small[1], small[2], small[3], roots)
    return starts


@python_kernel
def orient(Y, n, stage, ws):
    """Orients one image from any attitude; returns (status, number of minima), the minima in ws[-1] in order of cost.

    stage 0: vertical start, then 1: scaled orthography, then 2: all starts. A stage is believed when its best perspective
    residuals are at noise level; the reversal twin of the best is always tried.
    """
    work, E, values, S, Rs, ts, _, _, seen, minima = ws
    Rm, tm, cm = minima
    xx = xy = xz = yy = yz = zz = 0.0
    for i in range(n):
        x, y, z = Y[0, i], Y[1, i], Y[2, i]
        xx += x * x
        xy += x * y
        xz += x * z
        yy += y * y
        yz += y * z
        zz += z * z
    trace = xx + yy + zz
    plan = xx * yy - xy * xy
    if not plan + xx * zz - xz * xz + yy * zz - yz * yz > 1e-8 * trace * trace:
        return COLLINEAR, 0
    dof = 2 * n - 6
    limit = bad_fit(dof)
    if stage < 2 and not several(Y, n, trace, seen):
        stage = 2
    if stage == 0 and not plan > 1e-3 * trace * trace:
        stage = 1
    count = 0
    front = 0
    eigen = False
    slow = np.inf
    while stage < 3:
        if stage == 0:
            starts = 1 if nadir_start(Y, n, Rs[0], ts[0]) > 0.9 else 0
            n0, n1, n2 = (xy * yz - yy * xz) / plan, (xy * xz - xx * yz) / plan, 1.0
        else:
            if not eigen:
                S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2] = xx, xy, xz, yy, yz, zz
                S[1, 0], S[2, 0], S[2, 1] = xy, xz, yz
                eigen3(S, E, values)
                eigen = True
            starts = general_starts(Y, n, stage, ws)
            n0, n1, n2 = E[0, 2], E[1, 2], E[2, 2]
        first = starts
        ceiling = np.inf
        m = 0
        while m < starts:
            cost, how = refine(Y, n, Rs[m], ts[m], work, ceiling)
            front += cost < np.inf
            if how == 1:
                count = keep(minima, count, Rs[m], ts[m], cost)
            elif how == 2 and cost < slow:
                slow = cost
                copy_pose(Rs[MAX_STARTS - 1], ts[MAX_STARTS - 1], Rs[m], ts[m])
            m += 1
            if m == first and count > 0 and (stage == 2 or cm[0] < limit):
                for k in range(1 if stage < 2 else min(count, 2)):
                    reversed_pose(Rm[k], tm[k], n0, n1, n2, Rs[starts], ts[starts])
                    starts += 1
                if stage < 2:
                    ceiling = cm[0] + 25.0 * AMBIGUOUS_CHI2 * max(1.0, cm[0] / dof)
        stage = 3 if count > 0 and cm[0] < limit else stage + 1
    weak = slow < np.inf and (count == 0 or slow < cm[0] - 0.1)  # a flat valley lies deeper than every minimum
    if weak:
        count = keep(minima, count, Rs[MAX_STARTS - 1], ts[MAX_STARTS - 1], slow)
    if count == 0:
        return (DIVERGED if front > 0 else BEHIND_CAMERA), 0
    if cm[0] > limit:
        return OUTLIER, count
    if weak:
        return WEAK, count
    other = cm[1] - cm[0] if count > 1 else np.inf
    return (AMBIGUOUS if other < AMBIGUOUS_CHI2 * max(1.0, cm[0] / max(dof, 1)) else OK), count


@kernel
def covariance(Y, n, R, t, work, cov):
    """Covariance (6, 6) of (X_C, left rotation vector) in the photo frame; False when the pose is not determined."""
    A, J, L, g = work[0], work[1], work[2], work[3]
    if not normal(Y, n, R, t, A, g) < np.inf or not cholesky(A, 0.0, L):
        return False
    # dX_C = -R' e - R' [t]x d ; photo frame: d -> S d.  J holds the columns, whitened by L: cov = J' J
    for i in range(3):
        for j in range(3):
            J[j, i] = -R[j, i]
            J[j, 3 + i] = 0.0
            J[3 + j, 3 + i] = 0.0
        J[3, i] = R[2, i] * t[1] - R[1, i] * t[2]
        J[4, i] = R[0, i] * t[2] - R[2, i] * t[0]
        J[5, i] = R[1, i] * t[0] - R[0, i] * t[1]
    J[3, 3], J[4, 4], J[5, 5] = 1.0, -1.0, -1.0
    for i in range(6):
        for k in range(i):
            for r in range(6):
                J[i, r] -= L[i, k] * J[k, r]
        for r in range(6):
            J[i, r] *= L[i, i]
    for r in range(6):
        for c in range(6):
            cov[r, c] = 0.0
    for k in range(6):
        for r in range(6):
            for c in range(6):
                cov[r, c] += J[k, r] * J[k, c]
    return True


def workspace():
    """Everything one thread needs to orient images one after another (made by the caller); the last item holds the minima."""
    work = (
        *(np.empty((6, 6)) for _ in range(3)),
        *(np.empty(6) for _ in range(3)),
        np.empty((3, 3)),
        np.empty(3),
    )
    minima = (np.empty((MAX_MINIMA, 3, 3)), np.empty((MAX_MINIMA, 3)), np.empty(MAX_MINIMA))
    starts = (np.empty((MAX_STARTS, 3, 3)), np.empty((MAX_STARTS, 3)))
    small = (np.empty((4, 3, 3)), np.empty(4), np.empty(6, np.int64))
    return work, np.empty((3, 3)), np.empty(3), np.empty((3, 3)), *starts, *small, minima


@kernel
def gather(X, pixel, valid, sigma, camera, Y, index, mean):
    """Fills Y with the valid points of one image, ideal and reduced; returns their number, -1 when one is not finite.

    camera: c, xp, yp, k1, k2, k3, p1, p2, b1, b2, pitch x, pitch y (mm), centre col, centre row (pixels).
    """
    xp, yp, k1, k2, k3 = camera[1], camera[2], camera[3], camera[4], camera[5]
    p1, p2, b1, b2, px, py = camera[6], camera[7], camera[8], camera[9], camera[10], camera[11]
    inv = 1.0 / camera[0]
    pitch = inv * np.sqrt(px * py)
    n = 0
    m0 = m1 = m2 = total = 0.0
    for i in range(len(X)):
        if not valid[i]:
            continue
        x = (pixel[i, 0] - camera[12]) * px - xp
        y = (camera[13] - pixel[i, 1]) * py - yp
        r2 = x * x + y * y
        radial = r2 * (k1 + r2 * (k2 + r2 * k3))
        Y[3, n] = (x + x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y + b1 * x + b2 * y) * inv
        Y[4, n] = -(y + y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y) * inv
        Y[5, n] = 1.0 / (pitch * sigma[i])
        Y[0, n], Y[1, n], Y[2, n] = X[i, 0], X[i, 1], X[i, 2]
        m0 += X[i, 0]
        m1 += X[i, 1]
        m2 += X[i, 2]
        total += Y[3, n] + Y[4, n] + Y[5, n]
        index[n] = i
        n += 1
    if n == 0:
        return 0
    m0, m1, m2 = m0 / n, m1 / n, m2 / n
    if not np.isfinite(m0 + m1 + m2 + total):
        return -1
    for i in range(n):
        Y[0, i] -= m0
        Y[1, i] -= m1
        Y[2, i] -= m2
    mean[0], mean[1], mean[2] = m0, m1, m2
    return n


@kernel
def to_photo(R, t, mean, M, C):
    """Photo-frame rotation M and perspective centre C of (R, t)."""
    for j in range(3):
        M[0, j], M[1, j], M[2, j] = R[0, j], -R[1, j], -R[2, j]
        C[j] = mean[j] - (R[0, j] * t[0] + R[1, j] * t[1] + R[2, j] * t[2])


@kernel
def curved(Y, n, R, t, cov, ws):
    """Whether the error region is no ellipsoid: 3 sigma along its two longest rotations the cost ought to rise by 9."""
    work, E, values, S = ws[0], ws[1], ws[2], ws[3]
    x, Rn, tn = work[5], work[6], work[7]
    for i in range(3):
        for j in range(3):
            S[i, j] = cov[3 + i, 3 + j]
    eigen3(S, E, values)
    least = cost_of(Y, n, R, t)
    for axis in range(2):
        for sign in (3.0, -3.0):
            k = sign / np.sqrt(values[axis])
            for i in range(6):
                x[i] = k * (cov[i, 3] * E[0, axis] + cov[i, 4] * E[1, axis] + cov[i, 5] * E[2, axis])
            c0, c1, c2 = x[0], x[1], x[2]
            x[4], x[5] = -x[4], -x[5]  # photo frame -> camera frame
            retract(R, t, x, Rn, tn)
            for i in range(3):  # t = R (mean - X_C)
                tn[i] = 0.0
                for j in range(3):
                    arm = R[0, j] * t[0] + R[1, j] * t[1] + R[2, j] * t[2]
                    tn[i] += Rn[i, j] * (arm - (c0 if j == 0 else c1 if j == 1 else c2))
            rise = (cost_of(Y, n, Rn, tn) - least) / 9.0
            if not 0.4 < rise < 2.5:
                return True
    return False


@kernel
def weak(Y, n, R, t, cov, ws):
    """Whether the geometry leaves a rotation so uncertain that the linear covariance does not describe the error."""
    largest = max(cov[3, 3], cov[4, 4], cov[5, 5])
    if not largest < WEAK_ROTATION**2:
        return True
    return largest > CURVED_ROTATION**2 and curved(Y, n, R, t, cov, ws)


@kernel
def worst_point(Y, n, R, t):
    """Position of the point with the largest residual."""
    worst, at = -1.0, 0
    for i in range(n):
        z = R[2, 0] * Y[0, i] + R[2, 1] * Y[1, i] + R[2, 2] * Y[2, i] + t[2]
        du = Y[3, i] - (R[0, 0] * Y[0, i] + R[0, 1] * Y[1, i] + R[0, 2] * Y[2, i] + t[0]) / z
        dv = Y[4, i] - (R[1, 0] * Y[0, i] + R[1, 1] * Y[1, i] + R[1, 2] * Y[2, i] + t[1]) / z
        r = (du * du + dv * dv) * Y[5, i] * Y[5, i]
        if r > worst:
            worst, at = r, i
    return at


@kernel
def invert(A, B):
    """B = inverse of the 6x6 A, which is destroyed (Gauss-Jordan with row pivots); False when singular."""
    for i in range(6):
        for j in range(6):
            B[i, j] = 1.0 if i == j else 0.0
    for k in range(6):
        p = k
        for i in range(k + 1, 6):
            if abs(A[i, k]) > abs(A[p, k]):
                p = i
        if not abs(A[p, k]) > 0.0:
            return False
        scale = 1.0 / A[p, k]
        for j in range(6):
            A[p, j], A[k, j] = A[k, j], A[p, j] * scale
            B[p, j], B[k, j] = B[k, j], B[p, j] * scale
        for i in range(6):
            if i != k:
                f = A[i, k]
                for j in range(6):
                    A[i, j] -= f * A[k, j]
                    B[i, j] -= f * B[k, j]
    return True


@kernel
def orthogonal_normal(Y, n, R, t, V, N, S, g):
    """N = Jg' T Jp, S = Jg' T Sigma T Jg, g = Jg' T r of the re-centred bundle (rotation V); False behind the camera."""
    for c in range(6):
        g[c] = 0.0
        for e in range(6):
            N[c, e] = 0.0
            S[c, e] = 0.0
    iz = 1.0 / t[2]
    for i in range(n):
        w = V[2, 0] * Y[3, i] + V[2, 1] * Y[4, i] + V[2, 2]
        p = (V[0, 0] * Y[3, i] + V[0, 1] * Y[4, i] + V[0, 2]) / w
        q = (V[1, 0] * Y[3, i] + V[1, 1] * Y[4, i] + V[1, 2]) / w
        a0 = R[0, 0] * Y[0, i] + R[0, 1] * Y[1, i] + R[0, 2] * Y[2, i]
        a1 = R[1, 0] * Y[0, i] + R[1, 1] * Y[1, i] + R[1, 2] * Y[2, i]
        a2 = R[2, 0] * Y[0, i] + R[2, 1] * Y[1, i] + R[2, 2] * Y[2, i]
        depth = a2 + t[2]
        if not (w > 0.0 and depth > 0.0):
            return False
        T = depth * iz
        gx, gy = (a0 + t[0]) * iz, (a1 + t[1]) * iz
        u, v = gx / T, gy / T
        # rows of the orthogonal (G) and the perspective model (P), without 1 / t_z and 1 / depth
        G0, G1 = (1.0, 0.0, -gx, 0.0, a2, -a1), (0.0, 1.0, -gy, -a2, 0.0, a0)
        P0, P1 = (1.0, 0.0, -u, -u * a1, a2 + u * a0, -a1), (0.0, 1.0, -v, -a2 - v * a1, v * a0, a0)
        d00, d01 = (V[0, 0] - p * V[2, 0]) / w, (V[0, 1] - p * V[2, 1]) / w  # of the re-centring: noise of (p, q)
        d10, d11 = (V[1, 0] - q * V[2, 0]) / w, (V[1, 1] - q * V[2, 1]) / w
        k = Y[5, i] * Y[5, i] * T * iz
        for c in range(6):
            g[c] += k * (G0[c] * (p - u) + G1[c] * (q - v))
            h0 = k * T * iz * (G0[c] * d00 + G1[c] * d10)
            h1 = k * T * iz * (G0[c] * d01 + G1[c] * d11)
            for e in range(6):
                N[c, e] += k / depth * (G0[c] * P0[e] + G1[c] * P1[e])
                S[c, e] += h0 * (G0[e] * d00 + G1[e] * d10) + h1 * (G0[e] * d01 + G1[e] * d11)
    return True


@kernel
def orthogonal_fixed_point(Y, n, R, t, ws, cov):
    """The fixed point of the iterated orthogonal model (depth form, re-centred) next to (R, t), in place; whether found.

    Re-transforming until nothing changes solves Jg' T r = 0 (Jg of the orthogonal, Jp of the perspective model, T = depth over
    reference depth, r = perspective residual); Newton with N = Jg' T Jp does it in a few steps and also where the plain
    iteration runs away (spectral radius of K above 1). cov = N^-1 (Jg' T Sigma T Jg) N^-T, the sandwich C_it.
    """
    N, S, B, g, x, _, Rn, tn = ws[0]
    V, Rv, tv = ws[3], ws[4][0], ws[5][0]
    mean_ray(Y, n, V)
    for i in range(3):
        tv[i] = V[i, 0] * t[0] + V[i, 1] * t[1] + V[i, 2] * t[2]
        for j in range(3):
            Rv[i, j] = V[i, 0] * R[0, j] + V[i, 1] * R[1, j] + V[i, 2] * R[2, j]
    size = 1.0
    for _ in range(30):
        if not (orthogonal_normal(Y, n, Rv, tv, V, N, S, g) and invert(N, B)):
            return False
        for c in range(6):
            x[c] = 0.0
            for e in range(6):
                x[c] += B[c, e] * g[e]
        retract(Rv, tv, x, Rn, tn)
        copy_pose(Rv, tv, Rn, tn)
        size = (abs(x[0]) + abs(x[1]) + abs(x[2])) / abs(tv[2]) + abs(x[3]) + abs(x[4]) + abs(x[5])
        if not (size < 1.0 and tv[2] > 0.0):
            return False
        if size < 1e-11:
            break
    if not size < 1e-9:
        return False
    # (e, d) of the turned camera -> (X_C, d of the photo frame): dX_C = -R'(e + t x d), d = S V' d
    for k in range(6):
        for i in range(6):
            N[i, k] = B[i, k]
        h0 = B[0, k] + tv[1] * B[5, k] - tv[2] * B[4, k]
        h1 = B[1, k] + tv[2] * B[3, k] - tv[0] * B[5, k]
        h2 = B[2, k] + tv[0] * B[4, k] - tv[1] * B[3, k]
        for i in range(3):
            N[i, k] = -(Rv[0, i] * h0 + Rv[1, i] * h1 + Rv[2, i] * h2)
            d = V[0, i] * B[3, k] + V[1, i] * B[4, k] + V[2, i] * B[5, k]
            N[3 + i, k] = d if i == 0 else -d
    for r in range(6):
        for c in range(6):
            B[r, c] = 0.0
            for e in range(6):
                B[r, c] += N[r, e] * S[e, c]
    for r in range(6):
        for c in range(6):
            cov[r, c] = 0.0
            for e in range(6):
                cov[r, c] += B[r, e] * N[c, e]
    turn_back(V, Rv, tv)
    copy_pose(R, t, Rv, tv)
    return True


@kernel
def no_pose(M, C, cov):
    """NaN everywhere."""
    for i in range(6):
        C[i % 3] = np.nan
        for j in range(6):
            cov[i, j] = np.nan
            M[i % 3, j % 3] = np.nan


@python_kernel
def resect_images(
    ws, Y, index, mean, X, pixel, valid, sigma, camera, start, stop, M, C, cov, sigma0, chi, status, worst
):  # fmt: skip
    """Orients images start .. stop - 1; pose and covariance are NaN where the status gives none.

    chi: square root of how much worse the runner-up fits; worst: the point with the largest residual where an outlier is likely.
    """
    R, t, cost = ws[9][0][0], ws[9][1][0], ws[9][2]
    for b in range(start, stop):
        n = gather(X[b], pixel[b], valid[b], sigma[b], camera, Y, index, mean)
        code, count = (NOT_FINITE if n < 0 else TOO_FEW), 0
        if n >= 3:
            code, count = orient(Y, n, 0, ws)
        if count > 0 and not covariance(Y, n, R, t, ws[0], cov[b]):
            code, count = SINGULAR, 0
        worst[b] = -1
        sigma0[b] = np.sqrt(cost[0] / (2 * n - 6)) if n > 3 and count > 0 else np.nan
        chi[b] = np.sqrt(cost[1] - cost[0]) if count > 1 else np.inf
        if count == 0:
            no_pose(M[b], C[b], cov[b])
        else:
            to_photo(R, t, mean, M[b], C[b])
            if code == OUTLIER:
                worst[b] = index[worst_point(Y, n, R, t)]
            elif code == OK and weak(Y, n, R, t, cov[b], ws):
                code = WEAK
        status[b] = code


@python_kernel
def orthogonal_images(
    ws, Y, index, mean, X, pixel, valid, sigma, camera, start, stop, M, C, cov, sigma0, chi, status, worst
):  # fmt: skip
    """Turns the perspective poses of resect_range into orthogonal ones, in place."""
    R, t = ws[9][0][0], ws[9][1][0]
    for b in range(start, stop):
        if not np.isfinite(C[b, 0]):
            continue
        n = gather(X[b], pixel[b], valid[b], sigma[b], camera, Y, index, mean)
        for j in range(3):
            R[0, j], R[1, j], R[2, j] = M[b, 0, j], -M[b, 1, j], -M[b, 2, j]
        for i in range(3):
            t[i] = R[i, 0] * (mean[0] - C[b, 0]) + R[i, 1] * (mean[1] - C[b, 1]) + R[i, 2] * (mean[2] - C[b, 2])
        dof = 2 * n - 6
        best = sigma0[b] * sigma0[b] * dof if dof > 0 else 0.0
        # a fixed point that fits much worse than the perspective minimum is a false one
        found = orthogonal_fixed_point(Y, n, R, t, ws, cov[b])
        excess = (cost_of(Y, n, R, t) - best) / max(1.0, best / max(dof, 1)) if found else np.inf
        if excess < 100.0:
            to_photo(R, t, mean, M[b], C[b])
            sigma0[b] = np.sqrt(cost_of(Y, n, R, t) / dof) if dof > 0 else np.nan
            largest = max(cov[b, 3, 3], cov[b, 4, 4], cov[b, 5, 5])
            # one that fits worse by 2.5 sigma is a long way off where rotations are uncertain: its linear covariance is too small
            if status[b] == OK and not largest < (0.5 * CURVED_ROTATION if excess > 6.0 else WEAK_ROTATION) ** 2:
                status[b] = WEAK
        else:
            no_pose(M[b], C[b], cov[b])
            sigma0[b] = np.nan
            status[b] = DIVERGED
