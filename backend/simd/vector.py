# SPDX-License-Identifier: GPL-3.0-or-later
"""The types: a vector of ``LANES`` float32 and a mask of as many booleans, and how their code is made."""

from typing import Any

from llvmlite import ir
from numba import extending
from numba.core import cgutils, types
from numba.extending import models, register_model

#: Floats in a vector: 8 fills an AVX2 register. Measured against 16 in lab/performance.md.
LANES = 8

# Numba's decorators have no types that a checker could follow.
intrinsic: Any = extending.intrinsic

FLOAT = ir.FloatType()
I32 = ir.IntType(32)
I64 = ir.IntType(64)
VECTOR = ir.VectorType(FLOAT, LANES)
IVECTOR = ir.VectorType(I32, LANES)
MASK = ir.VectorType(ir.IntType(1), LANES)


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
        super().__init__(manager, fe_type, VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager, fe_type) -> None:
        super().__init__(manager, fe_type, MASK)


def constant(value: float) -> ir.Constant:
    return ir.Constant(VECTOR, [value] * LANES)


def broadcast(builder, scalar):
    first = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), scalar, ir.Constant(I32, 0))
    return builder.shuffle_vector(first, ir.Constant(VECTOR, ir.Undefined), ir.Constant(IVECTOR, [0] * LANES))


def as_vector(context, builder, value, kind):
    """A value of Numba type ``kind`` (vector or number) as an LLVM vector."""
    if kind == vector:
        return value
    return broadcast(builder, context.cast(builder, value, kind, types.float32))


def call_llvm(builder, name: str, result, *args):
    """Call the LLVM intrinsic ``name`` (overloaded on the vector type)."""
    function = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(result, [a.type for a in args]), name
    )
    return builder.call(function, args)


def fma_llvm(builder, a, b, c):
    # Not llvm.fma: a processor without the instruction would call a function of the C library for every lane.
    return call_llvm(builder, f"llvm.fmuladd.v{LANES}f32", VECTOR, a, b, c)


def address(context, builder, array_type, array, index):
    """The address of ``array[index]``."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


def load_vector(context, builder, array_type, array, index):
    pointer = builder.bitcast(address(context, builder, array_type, array, index), VECTOR.as_pointer())
    return builder.load(pointer, align=4)


def store_vector(context, builder, value, array_type, array, index) -> None:
    pointer = builder.bitcast(address(context, builder, array_type, array, index), VECTOR.as_pointer())
    builder.store(value, pointer, align=4)
