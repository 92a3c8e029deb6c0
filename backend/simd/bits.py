# SPDX-License-Identifier: GPL-3.0-or-later
"""Sets of blocks as bits, and a counter that threads share."""

from llvmlite import ir
from numba.core import types

from .vector import I64, IVECTOR, LANES, address, intrinsic, vector


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
        one = ir.Constant(IVECTOR, [1] * LANES)
        zero = ir.Constant(IVECTOR, [0] * LANES)
        below = [builder.shl(one, builder.fptosi(value, IVECTOR)) for value in args]
        bits = builder.sub(below[1], below[0])
        bits = builder.select(builder.icmp_signed(">", bits, zero), bits, zero)
        packed = builder.trunc(bits, ir.VectorType(ir.IntType(8), LANES))
        return (
            builder.trunc(builder.bitcast(packed, ir.IntType(8 * LANES)), I64)
            if LANES > 8
            else (builder.bitcast(packed, I64))
        )

    return types.uint64(vector, vector), generate


@intrinsic
def take_ticket(typing, counter):
    """``counter[0]``, which is raised by one atomically: threads share a queue of numbered jobs."""

    def generate(context, builder, sig, args):
        pointer = address(context, builder, sig.args[0], args[0], ir.Constant(I64, 0))
        return builder.atomic_rmw("add", pointer, ir.Constant(I64, 1), "monotonic")

    return types.int64(counter), generate
