"""Compiled kernels of the bundle: every observation's residual and derivatives, and the elimination of the object points.

Observations are sorted by point; a kernel works on the points p0 .. p1 and writes only where its thread may, so that any
number of threads can work at once (they hold no lock of Python). Derivatives are made anew in every pass: cheaper than
keeping them. Poses are rows X, Y, Z, m11 .. m33; cameras are rows of the ten parameters followed by
(9 + 1..) 1/pitch x, 1/pitch y, middle column, middle row, squared radius of the fold, and the kind: 0 without distortion, 1 where
the coefficients correct what was measured, 2 where they distort what is ideal (`cameras.Forward`), 3 where such a camera
sees also what is behind it (`Unsided`).
"""

from typing import Any

import numba
import numpy as np

from ...adjustment._kernels import (
    add_left,
    add_one,
    add_outer,
    add_product,
    add_ten,
    add_three,
    add_two,
    dot_six,
    dot_ten,
    set_six,
    set_ten,
    set_two,
    subtract_product,
)

njit: Any = numba.njit  # its type stubs do not know every option
FAST = {"reassoc", "contract", "nsz", "arcp"}  # no nnan, no ninf: NaN checks stay alive
_COMMON: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": FAST, "no_cfunc_wrapper": True}
kernel = njit(**_COMMON)
plain = njit(**{**_COMMON, "fastmath": False})  # long and used once: quicker to compile
_PART: dict[str, Any] = {"no_cpython_wrapper": True, "_nrt": False, **_COMMON}  # allocates nothing: no references are counted
part = njit(**_PART)
inner = njit(forceinline=True, **_PART)  # a call would hand over some hundred numbers


@part
def invert(k, xi, yi, x, y, found):
    """The measured point (x, y) whose correction is (xi, yi), by Newton from a guess, then from (xi, yi), or
    the guess itself where it is `found` already; and the inverse of the derivative."""
    bad = True
    b00 = b01 = b10 = b11 = 0.0
    close = 1e-8 * (1.0 + abs(xi) + abs(yi))  # one step more would be of the order of its square
    for attempt in range(2):
        if attempt == 1:
            x = xi
            y = yi
        for _ in range(30):
            r2 = x * x + y * y
            radial = r2 * (k[3] + r2 * (k[4] + r2 * k[5]))
            slope = 2.0 * (k[3] + r2 * (2.0 * k[4] + r2 * 3.0 * k[5]))
            ex = xi - (x + x * radial + k[6] * (r2 + 2.0 * x * x) + 2.0 * k[7] * x * y + k[8] * x + k[9] * y)
            ey = yi - (y + y * radial + k[7] * (r2 + 2.0 * y * y) + 2.0 * k[6] * x * y)
            j00 = 1.0 + radial + slope * x * x + 6.0 * k[6] * x + 2.0 * k[7] * y + k[8]
            j01 = slope * x * y + 2.0 * k[6] * y + 2.0 * k[7] * x + k[9]
            j10 = slope * x * y + 2.0 * k[7] * x + 2.0 * k[6] * y
            j11 = 1.0 + radial + slope * y * y + 6.0 * k[7] * y + 2.0 * k[6] * x
            det = j00 * j11 - j01 * j10
            i = 1.0 / det
            b00 = j11 * i
            b01 = -j01 * i
            b10 = -j10 * i
            b11 = j00 * i
            if found:
                return False, x, y, b00, b01, b10, b11
            dx = b00 * ex + b01 * ey
            dy = b10 * ex + b11 * ey
            x += dx
            y += dy
            if not (abs(dx) + abs(dy) < 1e6):
                break
            if abs(dx) + abs(dy) < close:
                bad = not (det > 0.0 and x * x + y * y < k[14])
                break
        if not bad:
            break
    return bad, x, y, b00, b01, b10, b11


@part
def bend(k, u, v):
    """Where a forward camera shows the normalised ideal point (u, v): x, y [mm], and their derivatives by the ideal point."""
    r2 = u * u + v * v
    radial = r2 * (k[3] + r2 * (k[4] + r2 * k[5]))
    slope = 2.0 * (k[3] + r2 * (2.0 * k[4] + r2 * 3.0 * k[5]))
    x = k[0] * (u + u * radial + k[6] * (r2 + 2.0 * u * u) + 2.0 * k[7] * u * v + k[8] * u + k[9] * v)
    y = k[0] * (v + v * radial + k[7] * (r2 + 2.0 * v * v) + 2.0 * k[6] * u * v)
    j00 = 1.0 + radial + slope * u * u + 6.0 * k[6] * u + 2.0 * k[7] * v + k[8]
    j01 = slope * u * v + 2.0 * k[6] * v + 2.0 * k[7] * u + k[9]
    j10 = slope * u * v + 2.0 * k[7] * u + 2.0 * k[6] * v
    j11 = 1.0 + radial + slope * v * v + 6.0 * k[7] * v + 2.0 * k[6] * u
    return x, y, j00, j01, j10, j11


@part
def loss(kind, t):
    """Cost and weight factor of a residual of length t standard deviations; kind 0 none, 1 Huber, 2 Cauchy, 3 Danish."""
    if kind == 1 and t > 1.5:
        return 1.5 * t - 1.125, 1.5 / t
    if kind == 2:
        z = t * t / 5.688225
        return 2.8441125 * np.log1p(z), 1.0 / (1.0 + z)
    if kind == 3 and t > 3.0:
        e = np.exp(1.0 - min(t * t / 9.0, 700.0))
        return 4.5 + 4.5 * (1.0 - e), e
    return 0.5 * t * t, 1.0


@inner
def derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, interior, found):
    """Weighted residual r (2,), observed minus projected, and derivatives of the projection J (2, 20): centre, rotation, point
    and, where asked for, the ten interior parameters, all with the weight of a robust loss taken in. Nothing where the
    point cannot be seen. photo (o, 2): where the point is in the photo, reduced [mm], kept by the first pass and read by those
    after it (found)."""
    k = cameras[camera[i]]
    ex = points[p, 0] - poses[i, 0]
    ey = points[p, 1] - poses[i, 1]
    ez = points[p, 2] - poses[i, 2]
    u = poses[i, 3] * ex + poses[i, 4] * ey + poses[i, 5] * ez
    v = poses[i, 6] * ex + poses[i, 7] * ey + poses[i, 8] * ez
    w = poses[i, 9] * ex + poses[i, 10] * ey + poses[i, 11] * ez
    if not (w < 0.0 or (k[15] > 2.5 and w > 0.0)):
        return
    s = -1.0 / w
    m = u * s
    n = v * s
    xi = m * k[0]
    yi = n * k[0]
    x = xi
    y = yi
    b00 = b11 = 1.0
    b01 = b10 = 0.0
    forward = k[15] > 1.5
    if forward:
        x, y, b00, b01, b10, b11 = bend(k, m, n)
    elif k[15] != 0.0:
        if found:
            x = photo[o, 0]
            y = photo[o, 1]
        else:
            x = (pixel[o, 0] - k[12]) / k[10] - k[1]
            y = -(pixel[o, 1] - k[13]) / k[11] - k[2]
        bad, x, y, b00, b01, b10, b11 = invert(k, xi, yi, x, y, found)
        photo[o, 0] = x
        photo[o, 1] = y
        if bad:
            return
    sx = k[10] * weight[o]
    sy = -k[11] * weight[o]
    r0 = (pixel[o, 0] - k[12]) * weight[o] - (x + k[1]) * sx
    r1 = (pixel[o, 1] - k[13]) * weight[o] - (y + k[2]) * sy
    if kind != 0:
        a = np.sqrt(loss(kind, np.sqrt(r0 * r0 + r1 * r1))[1])
        r0 *= a
        r1 *= a
        sx *= a
        sy *= a
    r[0] = r0
    r[1] = r1
    q = k[0] * s
    for e in range(2):
        f0 = b00 * sx if e == 0 else b10 * sy
        f1 = b01 * sx if e == 0 else b11 * sy
        a0 = f0 * q
        a1 = f1 * q
        a2 = (f0 * xi + f1 * yi) * s
        x0 = a0 * poses[i, 3] + a1 * poses[i, 6] + a2 * poses[i, 9]
        x1 = a0 * poses[i, 4] + a1 * poses[i, 7] + a2 * poses[i, 10]
        x2 = a0 * poses[i, 5] + a1 * poses[i, 8] + a2 * poses[i, 11]
        set_six(J, 20 * e, -x0, -x1, -x2, v * a2 - w * a1, w * a0 - u * a2, u * a1 - v * a0)
        J[e, 6] = x0
        J[e, 7] = x1
        J[e, 8] = x2
        if interior and forward:
            d = sx if e == 0 else sy
            g = d * k[0]
            r2 = m * m + n * n
            t = g * (m if e == 0 else n) * r2
            set_ten(J, 20 * e + 9, d * (x if e == 0 else y) / k[0], sx if e == 0 else 0.0, 0.0 if e == 0 else sy,
                    t, t * r2, t * r2 * r2, g * ((r2 + 2.0 * m * m) if e == 0 else 2.0 * m * n),
                    g * (2.0 * m * n if e == 0 else (r2 + 2.0 * n * n)), g * m if e == 0 else 0.0, g * n if e == 0 else 0.0)
        elif interior:
            r2 = x * x + y * y
            t = -(f0 * x + f1 * y) * r2
            set_ten(J, 20 * e + 9, f0 * m + f1 * n, sx if e == 0 else 0.0, 0.0 if e == 0 else sy,
                    t, t * r2, t * r2 * r2, -(f0 * (r2 + 2.0 * x * x) + f1 * 2.0 * x * y),
                    -(f0 * 2.0 * x * y + f1 * (r2 + 2.0 * y * y)), -f0 * x, -f0 * y)


@kernel
def cost(p0, p1, start, image, camera, pixel, weight, kind, poses, cameras, points):
    """Half the sum of squares (or the robust cost) of the observations of points p0 .. p1; inf where one cannot be seen."""
    total = 0.0
    for p in range(p0, p1):
        for o in range(start[p], start[p + 1]):
            i = image[o]
            k = cameras[camera[i]]
            a = points[p, 0] - poses[i, 0]
            b = points[p, 1] - poses[i, 1]
            c = points[p, 2] - poses[i, 2]
            u = poses[i, 3] * a + poses[i, 4] * b + poses[i, 5] * c
            v = poses[i, 6] * a + poses[i, 7] * b + poses[i, 8] * c
            w = poses[i, 9] * a + poses[i, 10] * b + poses[i, 11] * c
            if not (w < 0.0 or (k[15] > 2.5 and w > 0.0)):
                return np.inf
            q = -k[0] / w
            x = u * q
            y = v * q
            if k[15] > 1.5:
                x, y, _, _, _, _ = bend(k, -u / w, -v / w)
            elif k[15] != 0.0:
                xi = x
                yi = y
                x = (pixel[o, 0] - k[12]) / k[10] - k[1]
                y = -(pixel[o, 1] - k[13]) / k[11] - k[2]
                bad, x, y, _, _, _, _ = invert(k, xi, yi, x, y, False)
                if bad:
                    return np.inf
            r0 = (pixel[o, 0] - k[12] - (x + k[1]) * k[10]) * weight[o]
            r1 = (pixel[o, 1] - k[13] + (y + k[2]) * k[11]) * weight[o]
            if kind == 0:
                total += 0.5 * (r0 * r0 + r1 * r1)
            else:
                total += loss(kind, np.sqrt(r0 * r0 + r1 * r1))[0]
    return total


@kernel
def gather(p0, p1, live, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count,
           which, U, B, C, g, h, V, q):
    """Normal equations before any elimination: U (m, 6, 6), B (m, k, 6), C (k, 10) (each freed parameter with the ten of its
    camera) with right sides g (m, 6) and h (cameras, 10) are summed, V (n, 6) (00, 10, 11, 20, 21, 22) and q (n, 3) of the
    points below `live` are written.

    first, count: where a camera's free parameters stand in the border, and how many; which (k,): which of the ten."""
    border = len(which)
    r = np.zeros(2)
    J = np.zeros((2, 20))
    for p in range(p0, p1):
        v00 = v10 = v11 = v20 = v21 = v22 = g0 = g1 = g2 = 0.0
        for o in range(start[p], start[p + 1]):
            i = image[o]
            derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, border > 0, False)
            r0 = r[0]
            r1 = r[1]
            if p < live:
                x0, x1, x2, y0, y1, y2 = J[0, 6], J[0, 7], J[0, 8], J[1, 6], J[1, 7], J[1, 8]
                v00 += x0 * x0 + y0 * y0
                v10 += x1 * x0 + y1 * y0
                v11 += x1 * x1 + y1 * y1
                v20 += x2 * x0 + y2 * y0
                v21 += x2 * x1 + y2 * y1
                v22 += x2 * x2 + y2 * y2
                g0 += x0 * r0 + y0 * r1
                g1 += x1 * r0 + y1 * r1
                g2 += x2 * r0 + y2 * r1
            add_two(g, 6 * i, J, 0, r0, r1)
            add_product(U, i, J, 0, 0)
            if border > 0:
                c = camera[i]
                f = first[c]
                for s in range(count[c]):
                    x0 = J[0, 9 + which[f + s]]
                    y0 = J[1, 9 + which[f + s]]
                    add_two(B, 6 * (border * i + f + s), J, 0, x0, y0)
                    add_ten(C, 10 * (f + s), J, 9, x0, y0)
                add_ten(h, 10 * c, J, 9, r0, r1)
        if p < live:
            V[p, 0], V[p, 1], V[p, 2], V[p, 3], V[p, 4], V[p, 5] = v00, v10, v11, v20, v21, v22
            q[p, 0], q[p, 1], q[p, 2] = g0, g1, g2


@inner
def root(V, p, damping, L):
    """L (6,): Cholesky factor of a point's block, its diagonal raised by the damping, with inverse diagonal; NaN if singular."""
    d = 1.0 + damping
    i0 = 1.0 / np.sqrt(V[p, 0] * d)
    l10 = V[p, 1] * i0
    l20 = V[p, 3] * i0
    i1 = 1.0 / np.sqrt(V[p, 2] * d - l10 * l10)
    l21 = (V[p, 4] - l20 * l10) * i1
    i2 = 1.0 / np.sqrt(V[p, 5] * d - l20 * l20 - l21 * l21)
    L[0], L[1], L[2], L[3], L[4], L[5] = i0, l10, i1, l20, l21, i2


@kernel
def eliminate(p0, p1, longest, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count,
              which, V, q, damping, lut, S, B, C, g, h):
    """Take the points p0 .. p1 out: subtract W V^-1 W^T from S (b, 6, 6), its border B (m, k, 6), C (k, k) and right sides."""
    border = len(which)
    r = np.zeros(2)
    J = np.zeros((2, 20))
    L = np.zeros(6)
    Z = np.zeros((longest, 3, 6))
    Y = np.zeros((max(border, 1), 4))
    columns = np.zeros(border, np.int64)  # of the border, those that this point touches
    row = np.zeros(len(count), np.int64)  # where a camera's begin among them
    since = np.full(len(count), -1)  # the point that they belong to
    for p in range(p0, p1):
        o0 = start[p]
        n = start[p + 1] - o0
        many = 0
        root(V, p, damping, L)
        i0, l10, i1, l20, l21, i2 = L[0], L[1], L[2], L[3], L[4], L[5]
        z0 = q[p, 0] * i0
        z1 = (q[p, 1] - l10 * z0) * i1
        z2 = (q[p, 2] - l20 * z0 - l21 * z1) * i2
        for e in range(n):
            o = o0 + e
            i = image[o]
            derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, border > 0, True)
            x0 = J[0, 6] * i0  # derivatives by the point, times L^-T: two rows of three
            x1 = (J[0, 7] - l10 * x0) * i1
            x2 = (J[0, 8] - l20 * x0 - l21 * x1) * i2
            y0 = J[1, 6] * i0
            y1 = (J[1, 7] - l10 * y0) * i1
            y2 = (J[1, 8] - l20 * y0 - l21 * y1) * i2
            set_two(Z, 18 * e, J, 0, x0, y0)
            set_two(Z, 18 * e + 6, J, 0, x1, y1)
            set_two(Z, 18 * e + 12, J, 0, x2, y2)
            add_three(g, 6 * i, Z, 18 * e, -z0, -z1, -z2)
            if border > 0:
                c = camera[i]
                f = first[c]
                if since[c] != p:
                    since[c] = p
                    row[c] = many
                    for s in range(count[c]):
                        columns[many] = f + s
                        Y[many] = 0.0
                        many += 1
                for s in range(count[c]):
                    add_outer(Y, 4 * (row[c] + s), J[0, 9 + which[f + s]], J[1, 9 + which[f + s]], x0, x1, x2, y0, y1, y2)
        for s in range(many):
            u = columns[s]
            h[u] -= Y[s, 0] * z0 + Y[s, 1] * z1 + Y[s, 2] * z2
            for t in range(many):
                C[u, columns[t]] -= Y[s, 0] * Y[t, 0] + Y[s, 1] * Y[t, 1] + Y[s, 2] * Y[t, 2]
        for e in range(n):
            i = image[o0 + e]
            for t in range(many):
                add_three(B, 6 * (border * i + columns[t]), Z, 18 * e, -Y[t, 0], -Y[t, 1], -Y[t, 2])
            for d in range(e, n):
                subtract_product(S, lut[i, image[o0 + d]], Z, 18 * e, 18 * d)


@kernel
def expand(p0, p1, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count, which, V, q, damping,
           images, shared, out):
    """Steps of the points, out (n, r, 3), that belong to steps of the images (m, r, 6) and of the ten of every camera (c, r, 10);
    q (n, r, 3)."""
    border = len(which)
    many = images.shape[1]
    r = np.zeros(2)
    J = np.zeros((2, 20))
    L = np.zeros(6)
    G = np.zeros((many, 3))
    for p in range(p0, p1):
        for c in range(many):
            G[c, 0], G[c, 1], G[c, 2] = q[p, c, 0], q[p, c, 1], q[p, c, 2]
        for o in range(start[p], start[p + 1]):
            i = image[o]
            derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, border > 0, True)
            for c in range(many):
                e0 = dot_six(J, 0, images, 6 * (many * i + c))
                e1 = dot_six(J, 20, images, 6 * (many * i + c))
                if border > 0:
                    e0 += dot_ten(J, 9, shared, 10 * (many * camera[i] + c))
                    e1 += dot_ten(J, 29, shared, 10 * (many * camera[i] + c))
                G[c, 0] -= J[0, 6] * e0 + J[1, 6] * e1
                G[c, 1] -= J[0, 7] * e0 + J[1, 7] * e1
                G[c, 2] -= J[0, 8] * e0 + J[1, 8] * e1
        root(V, p, damping, L)
        for c in range(many):
            z0 = G[c, 0] * L[0]
            z1 = (G[c, 1] - L[1] * z0) * L[2]
            z2 = (G[c, 2] - L[3] * z0 - L[4] * z1) * L[5]
            x2 = z2 * L[5]
            x1 = (z1 - L[4] * x2) * L[2]
            out[p, c, 2] = x2
            out[p, c, 1] = x1
            out[p, c, 0] = (z0 - L[1] * x1 - L[3] * x2) * L[0]


@plain
def carry(p0, p1, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count, which, V, q, g, h):
    """Right sides (n, r, 3) of the points, eliminated: subtracts W V^-1 q from g (m, r, 6) and h (cameras, r, 10)."""
    border = len(which)
    many = q.shape[1]
    r = np.zeros(2)
    J = np.zeros((2, 20))
    L = np.zeros(6)
    x = np.zeros((many, 3))
    for p in range(p0, p1):
        root(V, p, 0.0, L)
        for c in range(many):
            z0 = q[p, c, 0] * L[0]
            z1 = (q[p, c, 1] - L[1] * z0) * L[2]
            z2 = (q[p, c, 2] - L[3] * z0 - L[4] * z1) * L[5]
            x[c, 2] = z2 * L[5]
            x[c, 1] = (z1 - L[4] * x[c, 2]) * L[2]
            x[c, 0] = (z0 - L[1] * x[c, 1] - L[3] * x[c, 2]) * L[0]
        for o in range(start[p], start[p + 1]):
            i = image[o]
            derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, border > 0, True)
            for c in range(many):
                e0 = J[0, 6] * x[c, 0] + J[0, 7] * x[c, 1] + J[0, 8] * x[c, 2]
                e1 = J[1, 6] * x[c, 0] + J[1, 7] * x[c, 1] + J[1, 8] * x[c, 2]
                add_two(g, 6 * (many * i + c), J, 0, -e0, -e1)
                if border > 0:
                    add_ten(h, 10 * (many * camera[i] + c), J, 9, -e0, -e1)


@plain
def judge(p0, p1, live, longest, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count, which, V,
          lut, Q, QB, QC, covariance, computed, residual):
    """From the inverse where it is stored (Q (b, 6, 6), QB (m, k, 6), QC (k, k)): covariance (n, 3, 3) of the points and, where
    `computed` (o, 2, 2) has room, the covariance of every computed observation over its own variance, with the standardized
    residual (o, 2)."""
    border = len(which)
    whole = len(computed) > 0
    r = np.zeros(2)
    J = np.zeros((longest, 2, 20))
    E = np.zeros((longest, 3, 6))
    T = np.zeros((longest, 3, 6))  # E Q, first half of it, the column of the block that belongs to an image
    EB = np.zeros((max(border, 1), 4))
    PB = np.zeros((max(border, 1), 4))
    columns = np.zeros(border, np.int64)
    row = np.zeros(len(count), np.int64)
    since = np.full(len(count), -1)
    L = np.zeros(6)
    I3 = np.zeros((3, 3))
    A = np.zeros((3, 3))
    H = np.zeros((2, 6))
    HB = np.zeros((2, 10))
    K = np.zeros((2, 3))
    for p in range(p0, p1):
        o0 = start[p]
        n = start[p + 1] - o0
        many = 0
        I3[:] = 0.0
        if p < live:
            root(V, p, 0.0, L)
            for c in range(3):  # columns of V^-1
                z0 = L[0] if c == 0 else 0.0
                z1 = ((1.0 if c == 1 else 0.0) - L[1] * z0) * L[2]
                z2 = ((1.0 if c == 2 else 0.0) - L[3] * z0 - L[4] * z1) * L[5]
                x2 = z2 * L[5]
                x1 = (z1 - L[4] * x2) * L[2]
                I3[2, c] = x2
                I3[1, c] = x1
                I3[0, c] = (z0 - L[1] * x1 - L[3] * x2) * L[0]
        for e in range(n):
            o = o0 + e
            i = image[o]
            derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J[e], border > 0, True)
            if whole:
                residual[o, 0] = r[0]
                residual[o, 1] = r[1]
            for c in range(3):
                K[0, c] = I3[c, 0] * J[e, 0, 6] + I3[c, 1] * J[e, 0, 7] + I3[c, 2] * J[e, 0, 8]
                K[1, c] = I3[c, 0] * J[e, 1, 6] + I3[c, 1] * J[e, 1, 7] + I3[c, 2] * J[e, 1, 8]
                set_two(E, 18 * e + 6 * c, J, 40 * e, K[0, c], K[1, c])
            k = camera[i]
            f = first[k]
            if border > 0 and since[k] != p:
                since[k] = p
                row[k] = many
                for s in range(count[k]):
                    columns[many] = f + s
                    EB[many] = 0.0
                    many += 1
            for s in range(count[k]):
                w = 9 + which[f + s]
                add_outer(EB, 4 * (row[k] + s), J[e, 0, w], J[e, 1, w], K[0, 0], K[0, 1], K[0, 2], K[1, 0], K[1, 1], K[1, 2])
        A[:] = 0.0
        for s in range(many):
            PB[s] = 0.0
            for t in range(many):
                for c in range(3):
                    PB[s, c] += QC[columns[s], columns[t]] * EB[t, c]
            for b in range(3):
                for c in range(3):
                    A[b, c] += 0.5 * EB[s, b] * PB[s, c]
        for e in range(n):
            i = image[o0 + e]
            T[e] = 0.0
            for t in range(many):
                for c in range(3):
                    add_one(T, 18 * e + 6 * c, QB, 6 * (border * i + columns[t]), EB[t, c])
        for e in range(n):
            i = image[o0 + e]
            add_left(T, 18 * e, E, 18 * e, Q, lut[i, i], 0.5)
            for d in range(e + 1, n):
                add_left(T, 18 * d, E, 18 * e, Q, lut[i, image[o0 + d]], 1.0)
        if p < live:
            for e in range(n):
                for b in range(3):
                    for c in range(3):
                        A[b, c] += dot_six(T, 18 * e + 6 * b, E, 18 * e + 6 * c)
            for b in range(3):
                for c in range(3):
                    covariance[p, b, c] = I3[b, c] + A[b, c] + A[c, b]
        if whole:
            for e in range(n):  # the other half
                i = image[o0 + e]
                add_left(T, 18 * e, E, 18 * e, Q, lut[i, i], 0.5)
                for c in range(3):
                    for t in range(many):
                        PB[t, c] += dot_six(QB, 6 * (border * i + columns[t]), E, 18 * e + 6 * c)
                    for d in range(e + 1, n):
                        block = lut[i, image[o0 + d]]
                        for s in range(6):
                            T[e, c, s] += dot_six(Q, 36 * block + 6 * s, E, 18 * d + 6 * c)
            for e in range(n):
                o = o0 + e
                i = image[o]
                k = camera[i]
                f = first[k]
                m = count[k]
                block = lut[i, i]
                for b in range(2):
                    for t in range(6):
                        x = dot_six(J, 40 * e + 20 * b, Q, 36 * block + 6 * t)
                        for s in range(m):
                            x += J[e, b, 9 + which[f + s]] * QB[i, f + s, t]
                        H[b, t] = x
                    for t in range(m):
                        x = dot_six(J, 40 * e + 20 * b, QB, 6 * (border * i + f + t))
                        for s in range(m):
                            x += J[e, b, 9 + which[f + s]] * QC[f + s, f + t]
                        HB[b, t] = x
                    for c in range(3):
                        x = dot_six(J, 40 * e + 20 * b, T, 18 * e + 6 * c)
                        for s in range(m):
                            x += J[e, b, 9 + which[f + s]] * PB[row[k] + s, c]
                        K[b, c] = x
                for b in range(2):
                    for d in range(2):
                        x = dot_six(H, 6 * b, J, 40 * e + 20 * d)
                        for s in range(m):
                            x += HB[b, s] * J[e, d, 9 + which[f + s]]
                        if p < live:
                            for c in range(3):
                                x -= K[b, c] * J[e, d, 6 + c] + J[e, b, 6 + c] * K[d, c]
                                for s in range(3):
                                    x += J[e, b, 6 + c] * covariance[p, c, s] * J[e, d, 6 + s]
                        computed[o, b, d] = x
