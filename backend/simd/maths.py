# SPDX-License-Identifier: GPL-3.0-or-later
"""Arithmetic lane by lane, and over the lanes."""

from llvmlite import ir
from numba.core import types

from .vector import I32, IVECTOR, LANES, VECTOR, as_vector, call_llvm, fma_llvm, intrinsic, mask, vector


@intrinsic
def fma(typing, a, b, c):
    """``a * b + c``, rounded once where the processor can."""

    def generate(context, builder, sig, args):
        return fma_llvm(
            builder, *(as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
        )

    return vector(a, b, c), generate


def _binary_intrinsic(name: str, doc: str):
    def typed(typing, a, b):
        def generate(context, builder, sig, args):
            a, b = (as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
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
            return call_llvm(builder, f"llvm.{name}.v{LANES}f32", VECTOR, args[0])

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
        a, b = (as_vector(context, builder, v, t) for v, t in zip(args[1:], sig.args[1:], strict=True))
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
def total(typing, value):
    """The sum of the lanes (always in the same order)."""

    def generate(context, builder, sig, args):
        value, width = args[0], LANES
        while width > 1:
            width //= 2
            high = ir.Constant(IVECTOR, [(i % width) + width for i in range(LANES)])
            value = builder.fadd(value, builder.shuffle_vector(value, value, high))
        return builder.extract_element(value, ir.Constant(I32, 0))

    return types.float32(vector), generate
