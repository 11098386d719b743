"""Compiled pieces of block-sparse normal equations: rows of six as the vectors of the machine that numba does not find itself."""

from typing import Any

import numba
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic as _intrinsic

intrinsic: Any = _intrinsic  # called with the values, written with the typing context: no checker follows that
njit: Any = numba.njit  # its type stubs do not know every option
_PARTS = ((0, 4), (4, 2))
"""A row of six doubles: a vector of four and one of two."""
_TEN = ((0, 4), (4, 4), (8, 2))
_FAST = ("contract",)


def _at(context: Any, builder: Any, kind: Any, array: Any, offset: Any) -> Any:
    """Pointer to the element `offset` of a contiguous array of doubles."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.gep(data, [offset])


def _place(builder: Any, pointer: Any, offset: int, wide: int) -> Any:
    """Pointer to a vector of doubles, `offset` doubles on."""
    at = builder.gep(pointer, [ir.Constant(ir.IntType(64), offset)])
    return builder.bitcast(at, ir.VectorType(ir.DoubleType(), wide).as_pointer())


def _load(builder: Any, pointer: Any, offset: int, wide: int) -> Any:
    return builder.load(_place(builder, pointer, offset, wide), align=8)


def _splat(builder: Any, value: Any, wide: int) -> Any:
    """A vector all of whose elements are one value."""
    vector = ir.VectorType(ir.DoubleType(), wide)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    nowhere = ir.Constant(ir.VectorType(ir.IntType(32), wide), [0] * wide)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), nowhere)


def _sum(builder: Any, start: Any, factors: Any, rows: Any, wide: int) -> Any:
    """start + sum of factor times row; from nothing where start is None."""
    for factor, row in zip(factors, rows, strict=True):
        product = builder.fmul(_splat(builder, factor, wide), row, flags=_FAST)
        start = product if start is None else builder.fadd(start, product, flags=_FAST)
    return start


def _whole(builder: Any, value: Any, kind: Any) -> Any:
    """An index as a machine word."""
    if value.type.width == 64:
        return value
    return (builder.sext if kind.signed else builder.zext)(value, ir.IntType(64))


def _product(count: int, stride: int, minus: bool) -> Any:
    """target[block] (6, 6) -= (or +=) left^T right of `count` rows of six each, `stride` apart, that begin at elements e, d."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        block, e, d = (_whole(builder, args[k], kinds[k]) for k in (1, 3, 4))
        s = _at(context, builder, kinds[0], args[0], builder.mul(block, ir.Constant(ir.IntType(64), 36)))
        left, right = (_at(context, builder, kinds[2], args[2], k) for k in (e, d))
        rows = {at: [_load(builder, right, stride * c + at, wide) for c in range(count)] for at, wide in _PARTS}
        for row in range(6):
            factors = [builder.load(builder.gep(left, [ir.Constant(ir.IntType(64), stride * c + row)])) for c in range(count)]
            factors = [builder.fneg(f) for f in factors] if minus else factors
            for at, wide in _PARTS:
                place = _place(builder, s, 6 * row + at, wide)
                builder.store(_sum(builder, builder.load(place, align=8), factors, rows[at], wide), place, align=8)
        return context.get_dummy_value()

    return generate


@intrinsic
def subtract_product(typing, target, block, z, e, d):
    """target[block] (6, 6) -= L^T R, the (3, 6) L and R at z.flat[e], z.flat[d]. Contiguous doubles, indices unchecked."""
    return types.void(target, block, z, e, d), _product(3, 6, True)


@intrinsic
def add_product(typing, target, block, z, e, d):
    """target[block] (6, 6) += L^T R, the first six of two rows of derivatives (2, 20) at z.flat[e], z.flat[d]."""
    return types.void(target, block, z, e, d), _product(2, 20, False)


def _written(parts: Any) -> Any:
    """target.flat[t:] = the other arguments."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        place = _at(context, builder, kinds[0], args[0], _whole(builder, args[1], kinds[1]))
        for at, wide in parts:
            vector = ir.Constant(ir.VectorType(ir.DoubleType(), wide), ir.Undefined)
            for k in range(wide):
                vector = builder.insert_element(vector, args[2 + at + k], ir.Constant(ir.IntType(32), k))
            builder.store(vector, _place(builder, place, at, wide), align=8)
        return context.get_dummy_value()

    return generate


@intrinsic
def set_six(typing, target, t, a, b, c, d, e, f):
    """target.flat[t:t+6] = a .. f, written as vectors: read as such at once after, they need not wait for memory."""
    return types.void(target, t, a, b, c, d, e, f), _written(_PARTS)


@intrinsic
def set_ten(typing, target, t, a, b, c, d, e, f, g, h, i, j):
    """target.flat[t:t+10] = a .. j, written as vectors."""
    return types.void(target, t, a, b, c, d, e, f, g, h, i, j), _written(_TEN)


def _row(count: int, stride: int, add: bool, parts: Any = _PARTS) -> Any:
    """target.flat[t:t+6] (+)= sum of `count` factors times rows that lie `stride` apart from source.flat[k] on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        t = _at(context, builder, kinds[0], args[0], _whole(builder, args[1], kinds[1]))
        source = _at(context, builder, kinds[2], args[2], _whole(builder, args[3], kinds[3]))
        for at, wide in parts:
            rows = [_load(builder, source, stride * c + at, wide) for c in range(count)]
            place = _place(builder, t, at, wide)
            start = builder.load(place, align=8) if add else None
            builder.store(_sum(builder, start, args[4:], rows, wide), place, align=8)
        return context.get_dummy_value()

    return generate


@intrinsic
def add_three(typing, target, t, source, k, x, y, z):
    """target.flat[t:t+6] += x source.flat[k:k+6] + y source.flat[k+6:k+12] + z source.flat[k+12:k+18]."""
    return types.void(target, t, source, k, x, y, z), _row(3, 6, True)


@intrinsic
def add_one(typing, target, t, source, k, x):
    """target.flat[t:t+6] += x source.flat[k:k+6]."""
    return types.void(target, t, source, k, x), _row(1, 6, True)


@intrinsic
def add_left(typing, target, t, left, k, blocks, block, factor):
    """The (3, 6) at target.flat[t] += factor times the (3, 6) at left.flat[k] times blocks[block] (6, 6)."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        to = _at(context, builder, kinds[0], args[0], _whole(builder, args[1], kinds[1]))
        by = _at(context, builder, kinds[2], args[2], _whole(builder, args[3], kinds[3]))
        at = builder.mul(_whole(builder, args[5], kinds[5]), ir.Constant(ir.IntType(64), 36))
        matrix = _at(context, builder, kinds[4], args[4], at)
        factors = [[builder.fmul(args[6], builder.load(builder.gep(by, [ir.Constant(ir.IntType(64), 6 * c + s)])))
                    for s in range(6)] for c in range(3)]
        for at, wide in _PARTS:
            rows = [_load(builder, matrix, 6 * s + at, wide) for s in range(6)]
            for c in range(3):
                place = _place(builder, to, 6 * c + at, wide)
                builder.store(_sum(builder, builder.load(place, align=8), factors[c], rows, wide), place, align=8)
        return context.get_dummy_value()

    return types.void(target, t, left, k, blocks, block, factor), generate


@intrinsic
def add_two(typing, target, t, source, k, x, y):
    """target.flat[t:t+6] += x times and y times the six that begin two rows of derivatives (2, 20)."""
    return types.void(target, t, source, k, x, y), _row(2, 20, True)


@intrinsic
def set_two(typing, target, t, source, k, x, y):
    """target.flat[t:t+6] = x times and y times the six that begin two rows of derivatives (2, 20)."""
    return types.void(target, t, source, k, x, y), _row(2, 20, False)


@intrinsic
def add_ten(typing, target, t, source, k, x, y):
    """target.flat[t:t+10] += x source.flat[k:k+10] + y source.flat[k+20:k+30]."""
    return types.void(target, t, source, k, x, y), _row(2, 20, True, _TEN)


def _dot(parts: Any) -> Any:
    """Scalar product of left.flat[k:] and right.flat[t:]."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        left = _at(context, builder, kinds[0], args[0], _whole(builder, args[1], kinds[1]))
        right = _at(context, builder, kinds[2], args[2], _whole(builder, args[3], kinds[3]))
        total = None
        for at, wide in parts:
            product = builder.fmul(_load(builder, left, at, wide), _load(builder, right, at, wide), flags=_FAST)
            for k in range(wide):
                value = builder.extract_element(product, ir.Constant(ir.IntType(32), k))
                total = value if total is None else builder.fadd(total, value, flags=("reassoc", "contract"))
        return total

    return generate


@intrinsic
def dot_six(typing, left, k, right, t):
    """Scalar product of left.flat[k:k+6] and right.flat[t:t+6]."""
    return types.float64(left, k, right, t), _dot(_PARTS)


@intrinsic
def dot_ten(typing, left, k, right, t):
    """Scalar product of left.flat[k:k+10] and right.flat[t:t+10]."""
    return types.float64(left, k, right, t), _dot(_TEN)


@intrinsic
def add_outer(typing, target, t, x, y, a, b, c, d, e, f):
    """target.flat[t:t+3] += x (a, b, c) + y (d, e, f), in a row of four."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        place = _place(builder, _at(context, builder, kinds[0], args[0], _whole(builder, args[1], kinds[1])), 0, 4)
        rows = []
        for first in (4, 7):
            row = ir.Constant(ir.VectorType(ir.DoubleType(), 4), [0.0] * 4)
            for k in range(3):
                row = builder.insert_element(row, args[first + k], ir.Constant(ir.IntType(32), k))
            rows.append(row)
        builder.store(_sum(builder, builder.load(place, align=8), args[2:4], rows, 4), place, align=8)
        return context.get_dummy_value()

    return types.void(target, t, x, y, a, b, c, d, e, f), generate


__all__ = ["add_left", "add_one", "add_outer", "add_product", "add_ten", "add_three", "add_two", "dot_six", "dot_ten", "set_six",
           "set_ten", "set_two", "subtract_product"]


@njit(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
def extend(a11, a12, a22, place, update, size):
    """Add the upper triangle of what a child passes on (n, n) to its parent's front; place: of its nodes there, rising."""
    n1 = len(a11)
    n = len(place)
    head = 0
    while head < n and place[head] * size < n1:
        head += 1
    for i in range(n):
        for r in range(size):
            row = i * size + r
            if i < head:
                at = place[i] * size + r
                for j in range(i, head):
                    to = place[j] * size
                    for c in range(size):
                        a11[at, to + c] += update[row, j * size + c]
                for j in range(head, n):
                    to = place[j] * size - n1
                    for c in range(size):
                        a12[at, to + c] += update[row, j * size + c]
            else:
                at = place[i] * size + r - n1
                for j in range(i, n):
                    to = place[j] * size - n1
                    for c in range(size):
                        a22[at, to + c] += update[row, j * size + c]


plainly = njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"}, no_cfunc_wrapper=True)


@plainly
def eliminate(start, image, e, t, lut, blocks):
    """blocks[lut[i, j]] -= T_i E_j^T of all images i <= j that see a point; start (n + 1,): its observations; E, T (o, s, q)."""
    _, s, q = e.shape
    for p in range(len(start) - 1):
        for a in range(start[p], start[p + 1]):
            for b in range(start[p], start[p + 1]):
                if image[a] > image[b]:
                    continue
                to = blocks[lut[image[a], image[b]]]
                for c in range(q):
                    for i in range(s):
                        factor = t[a, i, c]
                        if factor != 0.0:
                            for j in range(s):
                                to[i, j] -= factor * e[b, j, c]


@plainly
def spread(start, image, lut, z, t, out):
    """out[a] = sum of Z[i_a, i_b] T_b over the observations b of the same point; Z (b, s, s) of i <= j; T, out (o, s, q)."""
    _, s, q = t.shape
    for p in range(len(start) - 1):
        for a in range(start[p], start[p + 1]):
            to = out[a]
            for b in range(start[p], start[p + 1]):
                swap = image[a] > image[b]
                block = z[lut[image[b], image[a]] if swap else lut[image[a], image[b]]]
                for i in range(s):
                    for j in range(s):
                        factor = block[j, i] if swap else block[i, j]
                        for c in range(q):
                            to[i, c] += factor * t[b, j, c]
