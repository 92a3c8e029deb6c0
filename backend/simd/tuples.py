# SPDX-License-Identifier: GPL-3.0-or-later
"""Tuples of vectors, one vector a channel.

They are unrolled when compiled: a tuple's length comes from the *type* of an argument, so one kernel source
serves every number of channels, and Numba's cache on disk keeps each.
"""

from llvmlite import ir
from numba.core import types

from .vector import (
    I64,
    IVECTOR,
    LANES,
    VECTOR,
    address,
    broadcast,
    constant,
    fma_llvm,
    intrinsic,
    load_vector,
    store_vector,
    vector,
)


def tuple_of(count: int):
    return types.UniTuple(vector, count)


def unpack(builder, aggregate, count: int) -> list:
    return [builder.extract_value(aggregate, i) for i in range(count)]


def pack(builder, values: list):
    aggregate = ir.Constant(ir.ArrayType(VECTOR, len(values)), ir.Undefined)
    for i, value in enumerate(values):
        aggregate = builder.insert_value(aggregate, value, i)
    return aggregate


@intrinsic
def zero_each(typing, channels):
    """A tuple of as many zero vectors as ``channels`` is long."""
    result = tuple_of(len(channels))
    return result(channels), lambda context, builder, sig, args: pack(
        builder, [constant(0.0)] * len(channels)
    )


@intrinsic
def repeat_each(typing, channels, value):
    """A tuple of as many ``value`` as ``channels`` is long."""
    count = len(channels)
    return tuple_of(count)(channels, vector), lambda context, builder, sig, args: pack(
        builder, [args[1]] * count
    )


@intrinsic
def positive_each(typing, values):
    """max(values[k], 0) for every k; NaN stays NaN."""

    def generate(context, builder, sig, args):
        zero = constant(0.0)
        values = unpack(builder, args[0], sig.args[0].count)
        return pack(builder, [builder.select(builder.fcmp_ordered("<", v, zero), zero, v) for v in values])

    return values(values), generate


@intrinsic
def where_positive_each(typing, conditions, values):
    """``values[k]`` where ``conditions[k]`` is positive or NaN, else 0, for every k."""

    def generate(context, builder, sig, args):
        zero, count = constant(0.0), sig.args[0].count
        pairs = zip(unpack(builder, args[0], count), unpack(builder, args[1], count), strict=True)
        return pack(builder, [builder.select(builder.fcmp_ordered("<=", c, zero), zero, v) for c, v in pairs])

    return values(conditions, values), generate


@intrinsic
def load_each(typing, channels, array, index, stride):
    """The vectors at ``index + k * stride``, as many as ``channels`` is long."""
    count = len(channels)

    def generate(context, builder, sig, args):
        _, array, index, stride = args
        values = []
        for _ in range(count):
            values.append(load_vector(context, builder, sig.args[1], array, index))
            index = builder.add(index, stride)
        return pack(builder, values)

    return tuple_of(count)(channels, array, types.intp, types.intp), generate


@intrinsic
def splat_each(typing, channels, array, index):
    """``array[index + k]`` in every lane of vector k, as many as ``channels`` is long."""
    count = len(channels)

    def generate(context, builder, sig, args):
        _, array, index = args
        pointers = [
            address(context, builder, sig.args[1], array, builder.add(index, ir.Constant(I64, k)))
            for k in range(count)
        ]
        return pack(builder, [broadcast(builder, builder.load(p)) for p in pointers])

    return tuple_of(count)(channels, array, types.intp), generate


@intrinsic
def store_each(typing, values, array, index, stride):
    """Store vector k at ``index + k * stride``."""

    def generate(context, builder, sig, args):
        values, array, index, stride = args
        for value in unpack(builder, values, sig.args[0].count):
            store_vector(context, builder, value, sig.args[1], array, index)
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
        rows = unpack(builder, args[0], LANES)
        distance = LANES // 2
        while distance:
            upper = [j if not j & distance else LANES + j - distance for j in range(LANES)]
            lower = [j + distance if not j & distance else LANES + j for j in range(LANES)]
            for i in (i for i in range(LANES) if not i & distance):
                pair = rows[i], rows[i + distance]
                rows[i] = builder.shuffle_vector(*pair, ir.Constant(IVECTOR, upper))
                rows[i + distance] = builder.shuffle_vector(*pair, ir.Constant(IVECTOR, lower))
            distance //= 2
        at = args[2]
        for row in rows:
            store_vector(context, builder, row, sig.args[1], args[1], at)
            at = builder.add(at, args[3])
        return context.get_dummy_value()

    return types.void(values, array, types.intp, types.intp), generate


@intrinsic
def load_triples(typing, array, index):
    """Three channels that lie side by side: ``array[index + 3 * lane + c]`` is lane of vector c."""
    count = 3

    def generate(context, builder, sig, args):
        flat = []
        for part in range(count):
            at = builder.add(args[1], ir.Constant(I64, part * LANES))
            flat.append(load_vector(context, builder, sig.args[0], args[0], at))
        values = []
        for channel in range(count):
            places = [count * lane + channel for lane in range(LANES)]
            early = [place if place < 2 * LANES else 0 for place in places]
            late = [lane if p < 2 * LANES else p - LANES for lane, p in enumerate(places)]
            value = builder.shuffle_vector(flat[0], flat[1], ir.Constant(IVECTOR, early))
            values.append(builder.shuffle_vector(value, flat[2], ir.Constant(IVECTOR, late)))
        return pack(builder, values)

    return tuple_of(count)(array, types.intp), generate


@intrinsic
def store_triples(typing, values, array, index):
    """As ``load_triples`` reads them."""
    count = values.count
    assert count == 3

    def generate(context, builder, sig, args):
        planes = unpack(builder, args[0], count)
        for part in range(count):
            places = [divmod(part * LANES + lane, count) for lane in range(LANES)]  # lane, channel
            early = [lane + channel * LANES if channel < 2 else 0 for lane, channel in places]
            late = [i if channel < 2 else LANES + lane for i, (lane, channel) in enumerate(places)]
            value = builder.shuffle_vector(planes[0], planes[1], ir.Constant(IVECTOR, early))
            value = builder.shuffle_vector(value, planes[2], ir.Constant(IVECTOR, late))
            at = builder.add(args[2], ir.Constant(I64, part * LANES))
            store_vector(context, builder, value, sig.args[1], args[1], at)
        return context.get_dummy_value()

    return types.void(values, array, types.intp), generate


@intrinsic
def fma_each(typing, weight, values, sums):
    """``weight * values[k] + sums[k]`` for every k."""
    count = values.count

    def generate(context, builder, sig, args):
        pairs = zip(unpack(builder, args[1], count), unpack(builder, args[2], count), strict=True)
        return pack(builder, [fma_llvm(builder, args[0], value, added) for value, added in pairs])

    return sums(vector, values, sums), generate


@intrinsic
def dot_each(typing, a, b, start):
    """``start + Σ_k a[k] * b[k]``."""
    count = a.count

    def generate(context, builder, sig, args):
        result = args[2]
        for x, y in zip(unpack(builder, args[0], count), unpack(builder, args[1], count), strict=True):
            result = fma_llvm(builder, x, y, result)
        return result

    return vector(a, b, vector), generate


def _halves_within_quads():
    """Masks for even and odd lanes of a and b, quad by quad: a₀ a₂ b₀ b₂ | a₄ a₆ b₄ b₆ …; one instruction."""
    even = [lane for quad in range(0, LANES, 4) for lane in (quad, quad + 2, LANES + quad, LANES + quad + 2)]
    return ir.Constant(IVECTOR, even), ir.Constant(IVECTOR, [lane + 1 for lane in even])


def _alternate_quads():
    """Masks for every other quad of a, then of b."""
    even = [quad + i for quad in range(0, 2 * LANES, 8) for i in range(4)]
    return ir.Constant(IVECTOR, even), ir.Constant(IVECTOR, [lane + 4 for lane in even])


@intrinsic
def store_totals(typing, values, array, index):
    """``array[index + k] = total(values[k])``; up to a multiple of ``LANES`` the rest becomes zero.

    Sums neighbours of two vectors into one, again and again: after log2(LANES) rounds lane k of a
    single vector is the total of vector k. A third of the work of summing them one by one.
    """
    count = values.count

    def generate(context, builder, sig, args):
        values = unpack(builder, args[0], count)
        for first in range(0, count, LANES):
            group = values[first : first + LANES]
            group += [constant(0.0)] * (LANES - len(group))
            width = 1
            while len(group) > 1:
                even, odd = _halves_within_quads() if width < 4 else _alternate_quads()
                group = [
                    builder.fadd(builder.shuffle_vector(a, b, even), builder.shuffle_vector(a, b, odd))
                    for a, b in zip(group[0::2], group[1::2], strict=True)
                ]
                width *= 2
            at = builder.add(args[2], ir.Constant(I64, first))
            store_vector(context, builder, group[0], sig.args[1], args[1], at)
        return context.get_dummy_value()

    return types.void(values, array, types.intp), generate
