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

njit: Any = numba.njit  # its type stubs do not know every option
FAST = {"reassoc", "contract", "nsz", "arcp"}  # no nnan, no ninf: NaN checks stay alive
_COMMON: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": FAST, "no_cfunc_wrapper": True}
kernel = njit(**_COMMON)
plain = njit(**{**_COMMON, "fastmath": False})  # long and used once: quicker to compile
part = njit(no_cpython_wrapper=True, _nrt=False, **_COMMON)  # allocates nothing: no references are counted


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
def see(poses, i, cameras, c, points, p, pixel, o, scale, r, J, interior, photo, found):
    """Weighted residual r (2,), observed minus projected, and derivatives of the projection J (2, 19): centre, rotation, point
    and, where asked for, the ten interior parameters. False where the point cannot be seen. photo (o, 2): where the point is
    in the photo, reduced [mm], kept by the first pass and read by those after it (found)."""
    k = cameras[c]
    weight = scale[o]
    ex = points[p, 0] - poses[i, 0]
    ey = points[p, 1] - poses[i, 1]
    ez = points[p, 2] - poses[i, 2]
    u = poses[i, 3] * ex + poses[i, 4] * ey + poses[i, 5] * ez
    v = poses[i, 6] * ex + poses[i, 7] * ey + poses[i, 8] * ez
    w = poses[i, 9] * ex + poses[i, 10] * ey + poses[i, 11] * ez
    if not (w < 0.0 or (k[15] > 2.5 and w > 0.0)):
        return False
    s = -1.0 / w
    q = k[0] * s
    xi = u * q
    yi = v * q
    sx = k[10] * weight
    sy = -k[11] * weight
    forward = k[15] > 1.5
    if forward:
        x, y, b00, b01, b10, b11 = bend(k, u * s, v * s)
        b00 *= sx
        b01 *= sx
        b10 *= sy
        b11 *= sy
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
            return False
        b00 *= sx
        b01 *= sx
        b10 *= sy
        b11 *= sy
    else:
        x = xi
        y = yi
        b00 = sx
        b01 = 0.0
        b10 = 0.0
        b11 = sy
    r[0] = (pixel[o, 0] - k[12]) * weight - (x + k[1]) * sx
    r[1] = (pixel[o, 1] - k[13]) * weight - (y + k[2]) * sy
    for e in range(2):
        f0 = b00 if e == 0 else b10
        f1 = b01 if e == 0 else b11
        a0 = f0 * q
        a1 = f1 * q
        a2 = (f0 * xi + f1 * yi) * s
        for j in range(3):
            d = a0 * poses[i, 3 + j] + a1 * poses[i, 6 + j] + a2 * poses[i, 9 + j]
            J[e, j] = -d
            J[e, 6 + j] = d
        J[e, 3] = v * a2 - w * a1
        J[e, 4] = w * a0 - u * a2
        J[e, 5] = u * a1 - v * a0
        if interior and forward:
            d = sx if e == 0 else sy
            m = u * s
            n = v * s
            r2 = m * m + n * n
            J[e, 9] = d * (x if e == 0 else y) / k[0]
            J[e, 10] = sx if e == 0 else 0.0
            J[e, 11] = 0.0 if e == 0 else sy
            d *= k[0]
            J[e, 12] = d * (m if e == 0 else n) * r2
            J[e, 13] = J[e, 12] * r2
            J[e, 14] = J[e, 13] * r2
            J[e, 15] = d * ((r2 + 2.0 * m * m) if e == 0 else 2.0 * m * n)
            J[e, 16] = d * (2.0 * m * n if e == 0 else (r2 + 2.0 * n * n))
            J[e, 17] = d * m if e == 0 else 0.0
            J[e, 18] = d * n if e == 0 else 0.0
        elif interior:
            r2 = x * x + y * y
            g0 = x * r2
            g1 = y * r2
            J[e, 9] = (f0 * u + f1 * v) * s
            J[e, 10] = sx if e == 0 else 0.0
            J[e, 11] = 0.0 if e == 0 else sy
            J[e, 12] = -(f0 * g0 + f1 * g1)
            J[e, 13] = J[e, 12] * r2
            J[e, 14] = J[e, 13] * r2
            J[e, 15] = -(f0 * (r2 + 2.0 * x * x) + f1 * 2.0 * x * y)
            J[e, 16] = -(f0 * 2.0 * x * y + f1 * (r2 + 2.0 * y * y))
            J[e, 17] = -f0 * x
            J[e, 18] = -f0 * y
    return True


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


@part
def derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, interior, found):
    """`see`, with the weight of a robust loss taken in."""
    see(poses, i, cameras, camera[i], points, p, pixel, o, weight, r, J, interior, photo, found)
    if kind != 0:
        s = np.sqrt(loss(kind, np.sqrt(r[0] * r[0] + r[1] * r[1]))[1])
        for j in range(19 if interior else 9):
            J[0, j] *= s
            J[1, j] *= s
        r[0] *= s
        r[1] *= s


@kernel
def gather(p0, p1, live, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count,
           which, U, B, C, g, h, V, q):
    """Normal equations before any elimination: U (m, 6, 6) (lower), B (m, 6, k), C (k, k) with right sides g (m, 6) and h
    (k,) are
    summed, V (n, 6) (00, 10, 11, 20, 21, 22) and q (n, 3) of the points below `live` are written.

    first, count: where a camera's free parameters stand in the border, and how many; which (k,): which of the ten."""
    border = len(which)
    r = np.zeros(2)
    J = np.zeros((2, 19))
    F = np.zeros((2, border))
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
            for s in range(6):
                a = J[0, s]
                b = J[1, s]
                g[i, s] += a * r0 + b * r1
                for t in range(s + 1):
                    U[i, s, t] += a * J[0, t] + b * J[1, t]
            if border > 0:
                c = camera[i]
                f = first[c]
                n = count[c]
                for s in range(n):
                    F[0, s] = J[0, 9 + which[f + s]]
                    F[1, s] = J[1, 9 + which[f + s]]
                for s in range(6):
                    a = J[0, s]
                    b = J[1, s]
                    for t in range(n):
                        B[i, s, f + t] += a * F[0, t] + b * F[1, t]
                for s in range(n):
                    a = F[0, s]
                    b = F[1, s]
                    h[f + s] += a * r0 + b * r1
                    for t in range(n):
                        C[f + s, f + t] += a * F[0, t] + b * F[1, t]
        if p < live:
            V[p, 0], V[p, 1], V[p, 2], V[p, 3], V[p, 4], V[p, 5] = v00, v10, v11, v20, v21, v22
            q[p, 0], q[p, 1], q[p, 2] = g0, g1, g2


@part
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
    """Take the points p0 .. p1 out: subtract W V^-1 W^T from S (b, 6, 6), its border B (m, 6, k), C (k, k) and right sides."""
    border = len(which)
    r = np.zeros(2)
    J = np.zeros((2, 19))
    L = np.zeros(6)
    Z = np.zeros((longest, 3, 6))
    Y = np.zeros((3, border))
    for p in range(p0, p1):
        o0 = start[p]
        n = start[p + 1] - o0
        root(V, p, damping, L)
        i0, l10, i1, l20, l21, i2 = L[0], L[1], L[2], L[3], L[4], L[5]
        z0 = q[p, 0] * i0
        z1 = (q[p, 1] - l10 * z0) * i1
        z2 = (q[p, 2] - l20 * z0 - l21 * z1) * i2
        Y[:] = 0.0
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
            for s in range(6):
                a = J[0, s]
                b = J[1, s]
                Z[e, 0, s] = a * x0 + b * y0
                Z[e, 1, s] = a * x1 + b * y1
                Z[e, 2, s] = a * x2 + b * y2
                g[i, s] -= Z[e, 0, s] * z0 + Z[e, 1, s] * z1 + Z[e, 2, s] * z2
            if border > 0:
                f = first[camera[i]]
                for s in range(count[camera[i]]):
                    a = J[0, 9 + which[f + s]]
                    b = J[1, 9 + which[f + s]]
                    Y[0, f + s] += a * x0 + b * y0
                    Y[1, f + s] += a * x1 + b * y1
                    Y[2, f + s] += a * x2 + b * y2
        for s in range(border):
            h[s] -= Y[0, s] * z0 + Y[1, s] * z1 + Y[2, s] * z2
            for t in range(border):
                C[s, t] -= Y[0, s] * Y[0, t] + Y[1, s] * Y[1, t] + Y[2, s] * Y[2, t]
        for e in range(n):
            i = image[o0 + e]
            for s in range(6):
                a0 = Z[e, 0, s]
                a1 = Z[e, 1, s]
                a2 = Z[e, 2, s]
                for t in range(border):
                    B[i, s, t] -= a0 * Y[0, t] + a1 * Y[1, t] + a2 * Y[2, t]
            for d in range(e, n):
                block = lut[i, image[o0 + d]]
                for s in range(6):
                    a0 = Z[e, 0, s]
                    a1 = Z[e, 1, s]
                    a2 = Z[e, 2, s]
                    for t in range(6):
                        S[block, s, t] -= a0 * Z[d, 0, t] + a1 * Z[d, 1, t] + a2 * Z[d, 2, t]


@kernel
def expand(p0, p1, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count, which, V, q, damping,
           images, shared, out):
    """Steps of the points, out (n, r, 3), that belong to steps of the images (m, 6, r) and of the border (k, r); q (n, r, 3)."""
    border = len(which)
    many = images.shape[2]
    r = np.zeros(2)
    J = np.zeros((2, 19))
    L = np.zeros(6)
    G = np.zeros((many, 3))
    for p in range(p0, p1):
        for c in range(many):
            G[c, 0], G[c, 1], G[c, 2] = q[p, c, 0], q[p, c, 1], q[p, c, 2]
        for o in range(start[p], start[p + 1]):
            i = image[o]
            derive(o, i, p, camera, pixel, weight, kind, poses, cameras, points, photo, r, J, border > 0, True)
            f = first[camera[i]]
            for c in range(many):
                e0 = 0.0
                e1 = 0.0
                for s in range(6):
                    e0 += J[0, s] * images[i, s, c]
                    e1 += J[1, s] * images[i, s, c]
                if border > 0:
                    for s in range(count[camera[i]]):
                        e0 += J[0, 9 + which[f + s]] * shared[f + s, c]
                        e1 += J[1, 9 + which[f + s]] * shared[f + s, c]
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
    """Right sides (n, r, 3) of the points, eliminated: subtracts W V^-1 q from g (m, 6, r) and h (k, r)."""
    border = len(which)
    many = q.shape[1]
    r = np.zeros(2)
    J = np.zeros((2, 19))
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
            f = first[camera[i]]
            for c in range(many):
                e0 = J[0, 6] * x[c, 0] + J[0, 7] * x[c, 1] + J[0, 8] * x[c, 2]
                e1 = J[1, 6] * x[c, 0] + J[1, 7] * x[c, 1] + J[1, 8] * x[c, 2]
                for s in range(6):
                    g[i, s, c] -= J[0, s] * e0 + J[1, s] * e1
                if border > 0:
                    for s in range(count[camera[i]]):
                        h[f + s, c] -= J[0, 9 + which[f + s]] * e0 + J[1, 9 + which[f + s]] * e1


@plain
def judge(p0, p1, live, longest, start, image, camera, pixel, weight, kind, poses, cameras, points, photo, first, count, which, V,
          lut, Q, QB, QC, covariance, computed, residual):
    """From the inverse where it is stored (Q (b, 6, 6), QB (m, 6, k), QC (k, k)): covariance (n, 3, 3) of the points and, where
    `computed` (o, 2, 2) has room, the covariance of every computed observation over its own variance, with the standardized
    residual (o, 2)."""
    border = len(which)
    whole = len(computed) > 0
    r = np.zeros(2)
    J = np.zeros((longest, 2, 19))
    E = np.zeros((longest, 3, 6))
    P = np.zeros((longest, 6, 3))
    EB = np.zeros((3, border))
    PB = np.zeros((border, 3))
    L = np.zeros(6)
    I3 = np.zeros((3, 3))
    T = np.zeros((2, 6))
    TB = np.zeros((2, border))
    K = np.zeros((2, 3))
    for p in range(p0, p1):
        o0 = start[p]
        n = start[p + 1] - o0
        EB[:] = 0.0
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
                k0 = I3[c, 0] * J[e, 0, 6] + I3[c, 1] * J[e, 0, 7] + I3[c, 2] * J[e, 0, 8]
                k1 = I3[c, 0] * J[e, 1, 6] + I3[c, 1] * J[e, 1, 7] + I3[c, 2] * J[e, 1, 8]
                for s in range(6):
                    E[e, c, s] = k0 * J[e, 0, s] + k1 * J[e, 1, s]
                f = first[camera[i]]
                for s in range(count[camera[i]]):
                    EB[c, f + s] += k0 * J[e, 0, 9 + which[f + s]] + k1 * J[e, 1, 9 + which[f + s]]
        for e in range(n):  # P = Q E^T, row of the block that belongs to this image
            i = image[o0 + e]
            for s in range(6):
                for c in range(3):
                    t = 0.0
                    for k in range(border):
                        t += QB[i, s, k] * EB[c, k]
                    P[e, s, c] = t
        for k in range(border):
            for c in range(3):
                t = 0.0
                for s in range(border):
                    t += QC[k, s] * EB[c, s]
                PB[k, c] = t
        for e in range(n):
            i = image[o0 + e]
            for s in range(6):
                for c in range(3):
                    for k in range(border):
                        PB[k, c] += QB[i, s, k] * E[e, c, s]
            for d in range(e, n):
                block = lut[i, image[o0 + d]]
                for s in range(6):
                    for c in range(3):
                        t = 0.0
                        for k in range(6):
                            t += Q[block, s, k] * E[d, c, k]
                        P[e, s, c] += t
                if d != e:
                    for k in range(6):
                        for c in range(3):
                            t = 0.0
                            for s in range(6):
                                t += Q[block, s, k] * E[e, c, s]
                            P[d, k, c] += t
        if p < live:
            for b in range(3):
                for c in range(3):
                    t = I3[b, c]
                    for e in range(n):
                        for s in range(6):
                            t += E[e, b, s] * P[e, s, c]
                    for k in range(border):
                        t += EB[b, k] * PB[k, c]
                    covariance[p, b, c] = t
        if whole:
            for e in range(n):
                o = o0 + e
                i = image[o]
                f = first[camera[i]]
                m = count[camera[i]]
                block = lut[i, i]
                for b in range(2):
                    for t in range(6):
                        x = 0.0
                        for s in range(6):
                            x += J[e, b, s] * Q[block, s, t]
                        for k in range(m):
                            x += J[e, b, 9 + which[f + k]] * QB[i, t, f + k]
                        T[b, t] = x
                    for t in range(m):
                        x = 0.0
                        for s in range(6):
                            x += J[e, b, s] * QB[i, s, f + t]
                        for k in range(m):
                            x += J[e, b, 9 + which[f + k]] * QC[f + k, f + t]
                        TB[b, t] = x
                    for c in range(3):
                        x = 0.0
                        for s in range(6):
                            x += J[e, b, s] * P[e, s, c]
                        for k in range(m):
                            x += J[e, b, 9 + which[f + k]] * PB[f + k, c]
                        K[b, c] = x
                for b in range(2):
                    for d in range(2):
                        x = 0.0
                        for s in range(6):
                            x += T[b, s] * J[e, d, s]
                        for k in range(m):
                            x += TB[b, k] * J[e, d, 9 + which[f + k]]
                        if p < live:
                            for c in range(3):
                                x -= K[b, c] * J[e, d, 6 + c] + J[e, b, 6 + c] * K[d, c]
                                for k in range(3):
                                    x += J[e, b, 6 + c] * covariance[p, c, k] * J[e, d, 6 + k]
                        computed[o, b, d] = x
