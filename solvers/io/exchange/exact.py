"""The perspective centre of formats that store t = -R C, without loss at map coordinates.

In float64 a turn of 5,000 km costs 2e-8 m: 1e-16 of every element of R, times the length of C. Here R is the rotation of the
stored numbers in 40 decimal digits, the same for writer and reader, so that only the digits of t can lose anything: text files
get 24 of them and lose nothing; binary ones hold t to half a unit in its last place (5e-10 m up to 8,388 km), and of several
equal quaternions the one is written that loses least.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext

import numpy as np

from ...errors import BadTable

DIGITS = 40
Rows = list[list[Decimal]]
"""A rotation (3, 3), object axes into camera axes."""
Numbers = Sequence[float] | Sequence[Decimal] | np.ndarray


def of_quaternion(q: Numbers) -> Rows:
    """The rotation of a quaternion (w, x, y, z), Hamilton's, of any length. Raises BadTable for zero."""
    with localcontext(prec=DIGITS):
        w, x, y, z = decimals(q)
        square = w * w + x * x + y * y + z * z
        if square < Decimal("1e-18"):
            raise BadTable("its quaternion has no length; correct it")
        two = 2 / square
        return [[1 - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
                [two * (x * y + w * z), 1 - two * (x * x + z * z), two * (y * z - w * x)],
                [two * (x * z - w * y), two * (y * z + w * x), 1 - two * (x * x + y * y)]]


def of_vector(v: Numbers) -> Rows:
    """The rotation of a rotation vector [rad]: I + sin(a)/a [v] + (1 - cos(a))/a^2 [v]^2, by power series in a^2."""
    with localcontext(prec=DIGITS + 20):
        x, y, z = decimals(v)
        square = x * x + y * y + z * z
        if square > 400:
            raise BadTable("its rotation vector is longer than three turns; correct it")
        sine, cosine, term = Decimal(0), Decimal(0), Decimal(1)  # term = (-a^2)^n / (2n)!
        for n in range(200):
            sine += term / (2 * n + 1)
            cosine += term / ((2 * n + 1) * (2 * n + 2))
            if abs(term) < Decimal(10) ** -(DIGITS + 10):
                break
            term *= -square / ((2 * n + 1) * (2 * n + 2))
        skew = [[Decimal(0), -z, y], [z, Decimal(0), -x], [-y, x, Decimal(0)]]
        twice = _product(skew, skew)
        return [[(1 if i == j else 0) + sine * skew[i][j] + cosine * twice[i][j] for j in range(3)] for i in range(3)]


def of_matrix(m: np.ndarray) -> Rows:
    """The rotation closest to a matrix (3, 3) that is one within 1e-3: R (3 I - R' R) / 2, repeated (Bjorck & Bowie 1971)."""
    with localcontext(prec=DIGITS):
        r = [decimals(row) for row in m]
        for _ in range(8):
            gram = _product([list(c) for c in zip(*r, strict=True)], r)
            half = [[((3 if i == j else 0) - gram[i][j]) / 2 for j in range(3)] for i in range(3)]
            r = _product(r, half)
        return r


def floats(r: Rows) -> np.ndarray:
    """(3, 3) float64."""
    return np.array([[float(v) for v in row] for row in r])


def translation(r: Rows, centre: Numbers) -> list[Decimal]:
    """t = -R C."""
    with localcontext(prec=DIGITS):
        c = decimals(centre)
        return [-sum((a * b for a, b in zip(row, c, strict=True)), Decimal(0)) for row in r]


def centre(r: Rows, t: Numbers) -> np.ndarray:
    """C = -R' t, (3,) float64."""
    return np.array([float(v) for v in translation([list(c) for c in zip(*r, strict=True)], t)])


def kept_quaternion(q: np.ndarray, at: np.ndarray) -> np.ndarray:
    """This quaternion, or one stretched by some units in the last place (the same rotation), whose t in float64 gives the centre
    `at` (3,) back to 5e-10 m, or else best."""
    losses: list[tuple[float, int]] = []
    for k in range(24):
        losses.append((_loss(q * (1.0 + k * 2.0 ** -52), at), k))
        if losses[-1][0] < 5e-10:
            break
    return q * (1.0 + min(losses)[1] * 2.0 ** -52)


def _loss(q: np.ndarray, at: np.ndarray) -> float:
    r = of_quaternion(q)
    return float(np.abs(centre(r, [float(v) for v in translation(r, at)]) - at).max())


def text(v: Decimal) -> str:
    """24 significant digits, as every program reads them."""
    return f"{v:.24g}"


def _product(a: Rows, b: Rows) -> Rows:
    return [[sum((a[i][k] * b[k][j] for k in range(3)), Decimal(0)) for j in range(3)] for i in range(3)]


def decimals(values: Numbers) -> list[Decimal]:
    """The numbers with all their digits."""
    return [v if isinstance(v, Decimal) else Decimal(float(v)) for v in values]
