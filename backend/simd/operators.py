# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators on vectors and masks: ``+ - * /``, ``-v``, ``< <= > >=``, ``& |``; a scalar operand is splat."""

import operator
from typing import Any

from numba import extending
from numba.core import types
from numba.core.typing import templates
from numba.core.typing.templates import AbstractTemplate

from .vector import MaskType, VectorType, as_vector, mask, vector

# Numba's decorators have no types that a checker could follow.
lower_builtin: Any = extending.lower_builtin
infer_global: Any = templates.infer_global
signature: Any = templates.signature


def _is_vector_like(kind) -> bool:
    return kind == vector or isinstance(kind, (types.Float, types.Integer))


def _register_binary(op, generate, result) -> None:
    @infer_global(op)
    class _Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and vector in args and all(map(_is_vector_like, args)):
                return signature(result, *args)
            return None

    def lower(context, builder, sig, args):
        a, b = (as_vector(context, builder, v, t) for v, t in zip(args, sig.args, strict=True))
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
