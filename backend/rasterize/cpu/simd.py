# SPDX-License-Identifier: GPL-3.0-or-later
"""Explicit SIMD inside Numba: a vector of ``LANES`` float32 as a value type, and its operations.

Numba's auto-vectoriser is unreliable, so the kernels say what they mean: ``Vector`` is LLVM's
``<LANES x float>``, ``Mask`` is ``<LANES x i1>``. ``+ - * /``, ``-v``, ``< <= > >=`` and ``& |`` work on
them (a scalar operand is splat); everything else is a function below. Functions that end in ``_each``
work on a tuple of vectors (one per channel) and are unrolled when compiled: their length comes from the
*type* of a tuple argument, so one kernel source serves every channel count and Numba's on-disk cache
keeps each compiled one.

Array arguments are one-dimensional contiguous float32 arrays, positions are element offsets, nothing is
bounds-checked.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import extending
from numba.core import cgutils, types
from numba.core.typing import templates
from numba.core.typing.templates import AbstractTemplate
from numba.extending import models, register_model

#: Floats in a vector: 8 fills an AVX2 register. Measured against 16 in docs/performance.md.
LANES = 8

# Numba's decorators have no types that a checker could follow.
intrinsic: Any = extending.intrinsic
lower_builtin: Any = extending.lower_builtin
infer_global: Any = templates.infer_global
signature: Any = templates.signature

_FLOAT = ir.FloatType()
_I32 = ir.IntType(32)
_I64 = ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, LANES)
_IVECTOR = ir.VectorType(_I32, LANES)
_MASK = ir.VectorType(ir.IntType(1), LANES)


class VectorType(types.Type):
    """``LANES`` float32."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector{LANES}")


class MaskType(types.Type):
    """``LANES`` booleans, the result of a comparison."""

    def __init__(self) -> None:
        super().__init__(name=f"Mask{LANES}")


vector = VectorType()
mask = MaskType()


@register_model(VectorType)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, fe_type) -> None:
        super().__init__(manager, fe_type, _VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, fe_type) -> None:
        super().__init__(manager, fe_type, _MASK)


# ---- helpers of the code generators --------------------------------------------------------------


def _constant(value: float) -> ir.Constant:
    return ir.Constant(_VECTOR, [value] * LANES)


def _splat(builder, scalar):
    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), scalar, ir.Constant(_I32, 0))
    return builder.shuffle_vector(
        first, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_IVECTOR, [0] * LANES)
    )


def _as_vector(context, builder, value, kind):
    """A value of Numba type ``kind`` (vector or number) as an LLVM vector."""
    if kind == vector:
        return value
    return _splat(builder, context.cast(builder, value, kind, types.float32))


def _call(builder, name: str, result, *args):
    """Call the LLVM intrinsic ``name`` (overloaded on the vector type)."""
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(result, [a.type for a in args]), name
    )
    return builder.call(function, args)


def _fma(builder, a, b, c):
    return _call(builder, f"llvm.fma.v{LANES}f32", _VECTOR, a, b, c)


def _pointer(context, builder, array_type, array, index):
    """The address of ``array[index]``."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


def _load(context, builder, array_type, array, index):
    pointer = builder.bitcast(_pointer(context, builder, array_type, array, index), _VECTOR.as_pointer())
    return builder.load(pointer, align=4)


def _store(context, builder, value, array_type, array, index) -> None:
    pointer = builder.bitcast(_pointer(context, builder, array_type, array, index), _VECTOR.as_pointer())
    builder.store(value, pointer, align=4)


def _is_vector_like(kind) -> bool:
    return kind == vector or isinstance(kind, (types.Float, types.Integer))


# ---- operators -----------------------------------------------------------------------------------


def _register_binary(op, generate, result) -> None:
    @infer_global(op)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and vector in args and all(map(_is_vector_like, args)):
                return signature(result, *args)
            return None

    def lower(context, builder, sig, args):
        a, b = (_as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
        return generate(builder, a, b)

    for pair in ((VectorType, VectorType), (VectorType, types.Number), (types.Number, VectorType)):
        lower_builtin(op, *pair)(lower)


for _op, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _register_binary(_op, lambda builder, a, b, name=_name: getattr(builder, name)(a, b), vector)
for _op, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _register_binary(_op, lambda builder, a, b, sign=_sign: builder.fcmp_ordered(sign, a, b), mask)


@infer_global(operator.neg)
class _Negate(AbstractTemplate):
    def generic(self, args, kws):
        return signature(vector, vector) if args == (vector,) else None


@lower_builtin(operator.neg, VectorType)
def _negate(context, builder, sig, args):
    return builder.fneg(args[0])


def _register_mask_operator(op, generate) -> None:
    @infer_global(op)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(mask, mask, mask) if args == (mask, mask) else None

    @lower_builtin(op, MaskType, MaskType)
    def lower(context, builder, sig, args):
        return generate(builder, *args)


_register_mask_operator(operator.and_, lambda builder, a, b: builder.and_(a, b))
_register_mask_operator(operator.or_, lambda builder, a, b: builder.or_(a, b))


# ---- making, loading, storing --------------------------------------------------------------------


@intrinsic
def splat(typing, value):
    """A vector with ``value`` in every lane."""
    return vector(value), lambda context, builder, sig, args: _as_vector(
        context, builder, args[0], sig.args[0]
    )


@intrinsic
def lane_numbers(typing):
    """The vector (0, 1, 2, …)."""
    return vector(), lambda *_: ir.Constant(_VECTOR, [float(i) for i in range(LANES)])


@intrinsic
def peek(typing, array, index):
    """``array[index]``, a number. Numba's own indexing spends three instructions on negative indices."""

    def generate(context, builder, sig, args):
        return builder.load(_pointer(context, builder, sig.args[0], *args))

    return array.dtype(array, types.intp), generate


@intrinsic
def load(typing, array, index):
    """``array[index : index + LANES]``, aligned or not."""

    def generate(context, builder, sig, args):
        return _load(context, builder, sig.args[0], *args)

    return vector(array, types.intp), generate


@intrinsic
def store(typing, value, array, index):
    """``array[index : index + LANES] = value``, aligned or not."""

    def generate(context, builder, sig, args):
        _store(context, builder, args[0], sig.args[1], args[1], args[2])
        return context.get_dummy_value()

    return types.void(vector, array, types.intp), generate


@intrinsic
def load_halves(typing, array, first, second):
    """Half a vector from ``array[first:]``, the other half from ``array[second:]``."""

    def generate(context, builder, sig, args):
        half = ir.VectorType(_FLOAT, LANES // 2)
        parts = []
        for index in args[1:]:
            pointer = _pointer(context, builder, sig.args[0], args[0], index)
            parts.append(builder.load(builder.bitcast(pointer, half.as_pointer()), align=4))
        return builder.shuffle_vector(*parts, ir.Constant(_IVECTOR, list(range(LANES))))

    return vector(array, types.intp, types.intp), generate


@intrinsic
def store_halves(typing, value, array, first, second):
    """The first half of ``value`` to ``array[first:]``, the second to ``array[second:]``."""

    def generate(context, builder, sig, args):
        half = ir.VectorType(_FLOAT, LANES // 2)
        for part, index in enumerate(args[2:]):
            lanes = [part * LANES // 2 + i for i in range(LANES // 2)]
            indices = ir.Constant(ir.VectorType(_I32, LANES // 2), lanes)
            value = builder.shuffle_vector(args[0], ir.Constant(_VECTOR, ir.Undefined), indices)
            pointer = _pointer(context, builder, sig.args[1], args[1], index)
            builder.store(value, builder.bitcast(pointer, half.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(vector, array, types.intp, types.intp), generate


@intrinsic
def load_strided(typing, array, index, stride, count):
    """``array[index + stride * lane]`` for the first ``count ≥ 1`` lanes; the others repeat the last."""

    def generate(context, builder, sig, args):
        array, index, stride, count = args
        last = builder.sub(count, ir.Constant(_I64, 1))
        result = ir.Constant(_VECTOR, ir.Undefined)
        for number in range(LANES):
            lane = ir.Constant(_I64, number)
            lane = builder.select(builder.icmp_signed("<", lane, last), lane, last)
            at = builder.add(index, builder.mul(stride, lane))
            value = builder.load(_pointer(context, builder, sig.args[0], array, at))
            result = builder.insert_element(result, value, ir.Constant(_I32, number))
        return result

    return vector(array, types.intp, types.intp, types.intp), generate


@intrinsic
def store_strided(typing, value, array, index, stride, count):
    """``array[index + stride * lane] = value[lane]`` for the first ``count`` lanes."""

    def generate(context, builder, sig, args):
        value, array, index, stride, count = args
        for lane in range(LANES):
            with builder.if_then(builder.icmp_signed("<", ir.Constant(_I64, lane), count)):
                at = builder.add(index, builder.mul(stride, ir.Constant(_I64, lane)))
                element = builder.extract_element(value, ir.Constant(_I32, lane))
                builder.store(element, _pointer(context, builder, sig.args[1], array, at))
        return context.get_dummy_value()

    return types.void(vector, array, types.intp, types.intp, types.intp), generate


@intrinsic
def prefetch(typing, array, index):
    """Ask for the cache line of ``array[index]``; never faults."""

    def generate(context, builder, sig, args):
        byte_pointer = ir.IntType(8).as_pointer()
        pointer = builder.bitcast(_pointer(context, builder, sig.args[0], *args), byte_pointer)
        kind = ir.FunctionType(ir.VoidType(), [byte_pointer, _I32, _I32, _I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        read, keep, data = (ir.Constant(_I32, v) for v in (0, 3, 1))
        builder.call(function, [pointer, read, keep, data])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


# ---- arithmetic ----------------------------------------------------------------------------------


@intrinsic
def fma(typing, a, b, c):
    """``a * b + c``, rounded once."""

    def generate(context, builder, sig, args):
        return _fma(
            builder, *(_as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
        )

    return vector(a, b, c), generate


def _binary_intrinsic(name: str, doc: str):
    def typed(typing, a, b):
        def generate(context, builder, sig, args):
            a, b = (_as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
            less = builder.fcmp_ordered("<", a, b)
            return builder.select(less, a, b) if name == "minimum" else builder.select(less, b, a)

        return vector(a, b), generate

    typed.__doc__, typed.__name__ = doc, name
    return intrinsic(typed)


minimum = _binary_intrinsic("minimum", "The smaller of each lane (``b`` where one is NaN).")
maximum = _binary_intrinsic("maximum", "The larger of each lane (``a`` where one is NaN).")


def _unary_intrinsic(name: str, doc: str):
    def typed(typing, a):
        def generate(context, builder, sig, args):
            return _call(builder, f"llvm.{name}.v{LANES}f32", _VECTOR, args[0])

        return vector(vector), generate

    typed.__doc__, typed.__name__ = doc, name
    return intrinsic(typed)


square_root = _unary_intrinsic("sqrt", "The square root of each lane.")
floor = _unary_intrinsic("floor", "Each lane rounded down.")
ceil = _unary_intrinsic("ceil", "Each lane rounded up.")
absolute = _unary_intrinsic("fabs", "Each lane without its sign.")


@intrinsic
def select(typing, condition, a, b):
    """``a`` where the condition holds, else ``b``."""

    def generate(context, builder, sig, args):
        a, b = (_as_vector(context, builder, v, t) for v, t in zip(args[1:], sig.args[1:], strict=True))
        return builder.select(args[0], a, b)

    return vector(mask, a, b), generate


@intrinsic
def any_lane(typing, condition):
    """True if the condition holds in any lane."""

    def generate(context, builder, sig, args):
        bits = ir.IntType(LANES)
        return builder.icmp_unsigned("!=", builder.bitcast(args[0], bits), ir.Constant(bits, 0))

    return types.boolean(mask), generate


@intrinsic
def lane_bits(typing, condition):
    """The condition as an integer: bit i is lane i."""

    def generate(context, builder, sig, args):
        return builder.zext(builder.bitcast(args[0], ir.IntType(LANES)), _I64)

    return types.int64(mask), generate


@intrinsic
def total(typing, value):
    """The sum of the lanes (always in the same order)."""

    def generate(context, builder, sig, args):
        value, width = args[0], LANES
        while width > 1:
            width //= 2
            high = ir.Constant(_IVECTOR, [(i % width) + width for i in range(LANES)])
            value = builder.fadd(value, builder.shuffle_vector(value, value, high))
        return builder.extract_element(value, ir.Constant(_I32, 0))

    return types.float32(vector), generate


#: 2^t ≈ Σ c_k t^k for −1 ≤ t ≤ 0, relative error below 7.5e-8 (Lawson's iteration).
_EXP2 = (0.9999999251, 0.6931422526, 0.2401721893, 0.05527972267, 0.009188611779, 0.0009387883415)


@intrinsic
def exp2_of_8(typing, t):
    """``2 ** (8 t)`` for −1 ≤ t ≤ 0: a polynomial for ``2 ** t``, then squared three times.

    Shorter than splitting off the exponent, because alpha never leaves [2^−8, 1]. Outside the interval
    the value is meaningless, but never traps.
    """

    def generate(context, builder, sig, args):
        value = _polynomial(builder, _EXP2, args[0])
        for _ in range(3):
            value = builder.fmul(value, value)
        return value

    return vector(vector), generate


#: 2^f ≈ Σ c_k f^k for −½ ≤ f ≤ ½, relative error below 7.5e-8.
_EXP2_CENTRED = (1.000000072, 0.6931469671, 0.2402211972, 0.05550713274, 0.009675541385, 0.001327647205)

#: ln(1 + e) ≈ Σ c_k e^k, k = 1 …, for 0 ≤ e ≤ 1, relative error below 3.1e-8.
_LOG1P = (
    *(0.9999999699, -0.4999949314, 0.3331909684, -0.248429824, 0.191060073),
    *(-0.1366324666, 0.0782259597, -0.02950524237, 0.005232694905),
)


def _polynomial(builder, coefficients, x):
    value = _constant(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = _fma(builder, value, x, _constant(coefficient))
    return value


@intrinsic
def exp_of_negative(typing, x):
    """``e ** x`` for x ≤ 0; 0 is never reached, what would be below 2^−126 becomes that."""

    def generate(context, builder, sig, args):
        t = builder.fmul(args[0], _constant(1.4426950408889634))
        t = builder.select(builder.fcmp_ordered(">", t, _constant(-126.0)), t, _constant(-126.0))
        whole = _call(builder, f"llvm.rint.v{LANES}f32", _VECTOR, t)
        value = _polynomial(builder, _EXP2_CENTRED, builder.fsub(t, whole))
        shifted = builder.shl(builder.fptosi(whole, _IVECTOR), ir.Constant(_IVECTOR, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(value, _IVECTOR), shifted), _VECTOR)

    return vector(vector), generate


@intrinsic
def log1p_of_fraction(typing, e):
    """``ln(1 + e)`` for 0 ≤ e ≤ 1."""

    def generate(context, builder, sig, args):
        return builder.fmul(_polynomial(builder, _LOG1P, args[0]), args[0])

    return vector(vector), generate


#: log2(1 + x) / x ≈ Σ c_k x^k for √½ ≤ 1 + x ≤ √2, relative error below 2.7e-8.
_LOG2 = (
    *(1.442695005, -0.7213471993, 0.4809102799, -0.360716264, 0.2879390904),
    *(-0.2386756731, 0.2152122897, -0.2089338863, 0.1292642753),
)
_SQRT_HALF_BITS = 0x3F3504F3


@intrinsic
def log2_of_positive(typing, x):
    """``log2(x)`` for x ≥ 2^−126; meaningless below, but finite wherever x is."""

    def generate(context, builder, sig, args):
        bits = builder.bitcast(args[0], _IVECTOR)
        shift = ir.Constant(_IVECTOR, [23] * LANES)
        exponent = builder.ashr(builder.sub(bits, ir.Constant(_IVECTOR, [_SQRT_HALF_BITS] * LANES)), shift)
        mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, shift)), _VECTOR)
        fraction = builder.fsub(mantissa, _constant(1.0))
        logarithm = builder.fmul(_polynomial(builder, _LOG2, fraction), fraction)
        return builder.fadd(builder.sitofp(exponent, _VECTOR), logarithm)

    return vector(vector), generate


# ---- tuples of vectors ---------------------------------------------------------------------------


def _tuple_of(count: int):
    return types.UniTuple(vector, count)


def _unpack(builder, aggregate, count: int) -> list:
    return [builder.extract_value(aggregate, i) for i in range(count)]


def _pack(builder, values: list):
    aggregate = ir.Constant(ir.ArrayType(_VECTOR, len(values)), ir.Undefined)
    for i, value in enumerate(values):
        aggregate = builder.insert_value(aggregate, value, i)
    return aggregate


@intrinsic
def zero_each(typing, channels):
    """A tuple of as many zero vectors as ``channels`` is long."""
    result = _tuple_of(len(channels))
    return result(channels), lambda context, builder, sig, args: _pack(
        builder, [_constant(0.0)] * len(channels)
    )


@intrinsic
def load_each(typing, channels, array, index, stride):
    """The vectors at ``index + k * stride``, as many as ``channels`` is long."""
    count = len(channels)

    def generate(context, builder, sig, args):
        _, array, index, stride = args
        values = []
        for _ in range(count):
            values.append(_load(context, builder, sig.args[1], array, index))
            index = builder.add(index, stride)
        return _pack(builder, values)

    return _tuple_of(count)(channels, array, types.intp, types.intp), generate


@intrinsic
def splat_each(typing, channels, array, index):
    """``array[index + k]`` in every lane of vector k, as many as ``channels`` is long."""
    count = len(channels)

    def generate(context, builder, sig, args):
        _, array, index = args
        pointers = [
            _pointer(context, builder, sig.args[1], array, builder.add(index, ir.Constant(_I64, k)))
            for k in range(count)
        ]
        return _pack(builder, [_splat(builder, builder.load(p)) for p in pointers])

    return _tuple_of(count)(channels, array, types.intp), generate


@intrinsic
def store_each(typing, values, array, index, stride):
    """Store vector k at ``index + k * stride``."""

    def generate(context, builder, sig, args):
        values, array, index, stride = args
        for value in _unpack(builder, values, sig.args[0].count):
            _store(context, builder, value, sig.args[1], array, index)
            index = builder.add(index, stride)
        return context.get_dummy_value()

    return types.void(values, array, types.intp, types.intp), generate


@intrinsic
def store_transposed(typing, values, array, index, stride):
    """Lane k of all ``LANES`` vectors side by side at ``index + k * stride``.

    Halves of ever smaller blocks change places, as when a matrix of 2 × 2 blocks is transposed.
    """
    assert values.count == LANES

    def generate(context, builder, sig, args):
        rows = _unpack(builder, args[0], LANES)
        distance = LANES // 2
        while distance:
            upper = [j if not j & distance else LANES + j - distance for j in range(LANES)]
            lower = [j + distance if not j & distance else LANES + j for j in range(LANES)]
            for i in (i for i in range(LANES) if not i & distance):
                pair = rows[i], rows[i + distance]
                rows[i] = builder.shuffle_vector(*pair, ir.Constant(_IVECTOR, upper))
                rows[i + distance] = builder.shuffle_vector(*pair, ir.Constant(_IVECTOR, lower))
            distance //= 2
        at = args[2]
        for row in rows:
            _store(context, builder, row, sig.args[1], args[1], at)
            at = builder.add(at, args[3])
        return context.get_dummy_value()

    return types.void(values, array, types.intp, types.intp), generate


@intrinsic
def fma_each(typing, weight, values, sums):
    """``weight * values[k] + sums[k]`` for every k."""
    count = values.count

    def generate(context, builder, sig, args):
        pairs = zip(_unpack(builder, args[1], count), _unpack(builder, args[2], count), strict=True)
        return _pack(builder, [_fma(builder, args[0], value, added) for value, added in pairs])

    return sums(vector, values, sums), generate


@intrinsic
def dot_each(typing, a, b, start):
    """``start + Σ_k a[k] * b[k]``."""
    count = a.count

    def generate(context, builder, sig, args):
        result = args[2]
        for x, y in zip(_unpack(builder, args[0], count), _unpack(builder, args[1], count), strict=True):
            result = _fma(builder, x, y, result)
        return result

    return vector(a, b, vector), generate


def _halves_within_quads():
    """Masks for even and odd lanes of a and b, quad by quad: a₀ a₂ b₀ b₂ | a₄ a₆ b₄ b₆ …; one instruction."""
    even = [lane for quad in range(0, LANES, 4) for lane in (quad, quad + 2, LANES + quad, LANES + quad + 2)]
    return ir.Constant(_IVECTOR, even), ir.Constant(_IVECTOR, [lane + 1 for lane in even])


def _alternate_quads():
    """Masks for every other quad of a, then of b."""
    even = [quad + i for quad in range(0, 2 * LANES, 8) for i in range(4)]
    return ir.Constant(_IVECTOR, even), ir.Constant(_IVECTOR, [lane + 4 for lane in even])


@intrinsic
def store_totals(typing, values, array, index):
    """``array[index + k] = total(values[k])``; up to a multiple of ``LANES`` the rest becomes zero.

    Sums neighbours of two vectors into one, again and again: after log2(LANES) rounds lane k of a
    single vector is the total of vector k. A third of the work of summing them one by one.
    """
    count = values.count

    def generate(context, builder, sig, args):
        values = _unpack(builder, args[0], count)
        for first in range(0, count, LANES):
            group = values[first : first + LANES]
            group += [_constant(0.0)] * (LANES - len(group))
            width = 1
            while len(group) > 1:
                even, odd = _halves_within_quads() if width < 4 else _alternate_quads()
                group = [
                    builder.fadd(builder.shuffle_vector(a, b, even), builder.shuffle_vector(a, b, odd))
                    for a, b in zip(group[0::2], group[1::2], strict=True)
                ]
                width *= 2
            at = builder.add(args[2], ir.Constant(_I64, first))
            _store(context, builder, group[0], sig.args[1], args[1], at)
        return context.get_dummy_value()

    return types.void(values, array, types.intp), generate


# ---- bits and threads ----------------------------------------------------------------------------


@intrinsic
def lowest_bit(typing, bits):
    """The number of the lowest bit set, 64 if none is."""

    def generate(context, builder, sig, args):
        return builder.cttz(args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), generate


@intrinsic
def span_bits(typing, first, last):
    """Eight bytes as one uint64: byte g has the bits ``first[g] ≤ bit < last[g]`` set.

    ``first`` and ``last``: vectors of whole numbers in 0…8; only the first eight lanes are used.
    """

    def generate(context, builder, sig, args):
        one = ir.Constant(_IVECTOR, [1] * LANES)
        zero = ir.Constant(_IVECTOR, [0] * LANES)
        below = [builder.shl(one, builder.fptosi(value, _IVECTOR)) for value in args]
        bits = builder.sub(below[1], below[0])
        bits = builder.select(builder.icmp_signed(">", bits, zero), bits, zero)
        packed = builder.trunc(bits, ir.VectorType(ir.IntType(8), LANES))
        return (
            builder.trunc(builder.bitcast(packed, ir.IntType(8 * LANES)), _I64)
            if LANES > 8
            else (builder.bitcast(packed, _I64))
        )

    return types.uint64(vector, vector), generate


@intrinsic
def take_ticket(typing, counter):
    """``counter[0]``, which is raised by one atomically: threads share a queue of numbered jobs."""

    def generate(context, builder, sig, args):
        pointer = _pointer(context, builder, sig.args[0], args[0], ir.Constant(_I64, 0))
        return builder.atomic_rmw("add", pointer, ir.Constant(_I64, 1), "monotonic")

    return types.int64(counter), generate
