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
