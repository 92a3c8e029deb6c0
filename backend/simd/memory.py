# SPDX-License-Identifier: GPL-3.0-or-later
"""Between arrays and vectors. Positions are element offsets, nothing is bounds-checked."""

from llvmlite import ir
from numba.core import cgutils, types

from .vector import (
    FLOAT,
    I32,
    I64,
    IVECTOR,
    LANES,
    VECTOR,
    address,
    as_vector,
    intrinsic,
    load_vector,
    store_vector,
    vector,
)


@intrinsic
def splat(typing, value):
    """A vector with ``value`` in every lane."""
    return vector(value), lambda context, builder, sig, args: as_vector(
        context, builder, args[0], sig.args[0]
    )


@intrinsic
def lane_numbers(typing):
    """The vector (0, 1, 2, …)."""
    return vector(), lambda *_: ir.Constant(VECTOR, [float(i) for i in range(LANES)])


@intrinsic
def peek(typing, array, index):
    """``array[index]``, a number. Numba's own indexing spends three instructions on negative indices."""

    def generate(context, builder, sig, args):
        return builder.load(address(context, builder, sig.args[0], *args))

    return array.dtype(array, types.intp), generate


@intrinsic
def load(typing, array, index):
    """``array[index : index + LANES]``, aligned or not."""

    def generate(context, builder, sig, args):
        return load_vector(context, builder, sig.args[0], *args)

    return vector(array, types.intp), generate


@intrinsic
def store(typing, value, array, index):
    """``array[index : index + LANES] = value``, aligned or not."""

    def generate(context, builder, sig, args):
        store_vector(context, builder, args[0], sig.args[1], args[1], args[2])
        return context.get_dummy_value()

    return types.void(vector, array, types.intp), generate


@intrinsic
def load_halves(typing, array, first, second):
    """Half a vector from ``array[first:]``, the other half from ``array[second:]``."""

    def generate(context, builder, sig, args):
        half = ir.VectorType(FLOAT, LANES // 2)
        parts = []
        for index in args[1:]:
            pointer = address(context, builder, sig.args[0], args[0], index)
            parts.append(builder.load(builder.bitcast(pointer, half.as_pointer()), align=4))
        return builder.shuffle_vector(*parts, ir.Constant(IVECTOR, list(range(LANES))))

    return vector(array, types.intp, types.intp), generate


@intrinsic
def store_halves(typing, value, array, first, second):
    """The first half of ``value`` to ``array[first:]``, the second to ``array[second:]``."""

    def generate(context, builder, sig, args):
        half = ir.VectorType(FLOAT, LANES // 2)
        for part, index in enumerate(args[2:]):
            lanes = [part * LANES // 2 + i for i in range(LANES // 2)]
            indices = ir.Constant(ir.VectorType(I32, LANES // 2), lanes)
            value = builder.shuffle_vector(args[0], ir.Constant(VECTOR, ir.Undefined), indices)
            pointer = address(context, builder, sig.args[1], args[1], index)
            builder.store(value, builder.bitcast(pointer, half.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(vector, array, types.intp, types.intp), generate


@intrinsic
def load_strided(typing, array, index, stride, count):
    """``array[index + stride * lane]`` for the first ``count ≥ 1`` lanes; the others repeat the last."""

    def generate(context, builder, sig, args):
        array, index, stride, count = args
        last = builder.sub(count, ir.Constant(I64, 1))
        result = ir.Constant(VECTOR, ir.Undefined)
        for number in range(LANES):
            lane = ir.Constant(I64, number)
            lane = builder.select(builder.icmp_signed("<", lane, last), lane, last)
            at = builder.add(index, builder.mul(stride, lane))
            value = builder.load(address(context, builder, sig.args[0], array, at))
            result = builder.insert_element(result, value, ir.Constant(I32, number))
        return result

    return vector(array, types.intp, types.intp, types.intp), generate


@intrinsic
def store_strided(typing, value, array, index, stride, count):
    """``array[index + stride * lane] = value[lane]`` for the first ``count`` lanes."""

    def generate(context, builder, sig, args):
        value, array, index, stride, count = args
        for lane in range(LANES):
            with builder.if_then(builder.icmp_signed("<", ir.Constant(I64, lane), count)):
                at = builder.add(index, builder.mul(stride, ir.Constant(I64, lane)))
                element = builder.extract_element(value, ir.Constant(I32, lane))
                builder.store(element, address(context, builder, sig.args[1], array, at))
        return context.get_dummy_value()

    return types.void(vector, array, types.intp, types.intp, types.intp), generate


@intrinsic
def load_quads(typing, array, base, places):
    """Four vectors: lane of vector c is ``array[base + 4 * places[lane] + c]``; ``places`` are whole numbers.

    One load of four floats a lane, then every quad of lanes is transposed in its registers: a gather would
    load them one by one.
    """
    four = ir.VectorType(FLOAT, 4)

    def generate(context, builder, sig, args):
        array, base, places = args
        numbers = builder.fptosi(places, IVECTOR)
        lanes = []
        for lane in range(LANES):
            number = builder.sext(builder.extract_element(numbers, ir.Constant(I32, lane)), I64)
            at = builder.add(base, builder.shl(number, ir.Constant(I64, 2)))
            pointer = address(context, builder, sig.args[0], array, at)
            lanes.append(builder.load(builder.bitcast(pointer, four.as_pointer()), align=4))
        # Vector j: the floats of lanes j, j + 4, j + 8 …
        rows = []
        for j in range(4):
            parts, width = lanes[j::4], 4
            while len(parts) > 1:
                width *= 2
                whole = ir.Constant(ir.VectorType(I32, width), list(range(width)))
                parts = [
                    builder.shuffle_vector(a, b, whole) for a, b in zip(parts[::2], parts[1::2], strict=True)
                ]
            rows.append(parts[0])

        def within_quads(a, b, mask):
            indices = [q + (i if i < 4 else LANES + i - 4) for q in range(0, LANES, 4) for i in mask]
            return builder.shuffle_vector(a, b, ir.Constant(IVECTOR, indices))

        low, high = (0, 4, 1, 5), (2, 6, 3, 7)
        vectors = []
        for mask in (low, high):
            a, b = (within_quads(rows[k], rows[k + 1], mask) for k in (0, 2))
            vectors += [within_quads(a, b, half) for half in ((0, 1, 4, 5), (2, 3, 6, 7))]
        aggregate = ir.Constant(ir.ArrayType(VECTOR, 4), ir.Undefined)
        for k, value in enumerate(vectors):
            aggregate = builder.insert_value(aggregate, value, k)
        return aggregate

    return types.UniTuple(vector, 4)(array, types.intp, vector), generate


@intrinsic
def add_powers(typing, array, index, weight, x):
    """``array[index + j] += weight * x ** j`` for j = 0 … 3, all of them at once."""
    four = ir.VectorType(FLOAT, 4)

    def generate(context, builder, sig, args):
        pointer = address(context, builder, sig.args[0], args[0], args[1])
        pointer = builder.bitcast(pointer, four.as_pointer())
        added, value = ir.Constant(four, ir.Undefined), args[2]
        for j in range(4):
            added = builder.insert_element(added, value, ir.Constant(I32, j))
            value = builder.fmul(value, args[3])
        builder.store(builder.fadd(builder.load(pointer, align=4), added), pointer, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, types.float32, types.float32), generate


@intrinsic
def prefetch(typing, array, index):
    """Ask for the cache line of ``array[index]``; never faults."""

    def generate(context, builder, sig, args):
        byte_pointer = ir.IntType(8).as_pointer()
        pointer = builder.bitcast(address(context, builder, sig.args[0], *args), byte_pointer)
        kind = ir.FunctionType(ir.VoidType(), [byte_pointer, I32, I32, I32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        read, keep, data = (ir.Constant(I32, v) for v in (0, 3, 1))
        builder.call(function, [pointer, read, keep, data])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate
