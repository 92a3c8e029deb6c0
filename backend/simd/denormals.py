# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers below 2^−126 become zero, in the thread that asks for it.

Gradients of what is hardly seen underflow to such numbers, which carry nothing. But a processor may take a
hundred cycles for each: an untrained iteration of ``paper`` took 441 ms on an Intel machine, 350 of them in
the networks' backward pass (lab/performance.md). It is a setting of each thread, and a new thread has its
parent's on Linux only; so ``threads`` sets it in every thread that runs kernels, and the result is the same
whichever thread did the work. Nobody else's arithmetic is changed: SciPy's KDTree, for one, crashed on
points of which some coincide (it may split them at the next number above 0, which would then be 0); and
torch's OpenMP threads keep what the thread had that began them, so that they would flush or not by who came
first.

On x86-64 the bits are FTZ (results) and DAZ (inputs) of MXCSR, on ARM FZ (both) of FPCR. Elsewhere nothing is
set.
"""

import platform

from llvmlite import ir
from numba.core import cgutils, types

from .compiling import kernel
from .vector import I32, I64, intrinsic

_X86, _ARM = ("x86_64", "amd64"), ("aarch64", "arm64")
_MACHINE = platform.machine().lower()
_FTZ_AND_DAZ = 0x8040
_FZ = 1 << 24

#: The bits of the control word that flush; 0 where there are none to set.
FLUSHING = _FTZ_AND_DAZ if _MACHINE in _X86 else _FZ if _MACHINE in _ARM else 0


def _call(builder, name: str, result, *args):
    kind = ir.FunctionType(result, [a.type for a in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


@intrinsic
def _control_word(typing):
    """MXCSR or FPCR of this thread."""

    def generate(context, builder, sig, args):
        if _MACHINE in _X86:
            place = cgutils.alloca_once(builder, I32)
            _call(
                builder,
                "llvm.x86.sse.stmxcsr",
                ir.VoidType(),
                builder.bitcast(place, ir.IntType(8).as_pointer()),
            )
            return builder.zext(builder.load(place), I64)
        return _call(builder, "llvm.aarch64.get.fpcr", I64) if FLUSHING else ir.Constant(I64, 0)

    return types.int64(), generate


@intrinsic
def _set_control_word(typing, word):
    def generate(context, builder, sig, args):
        if _MACHINE in _X86:
            place = cgutils.alloca_once_value(builder, builder.trunc(args[0], I32))
            _call(
                builder,
                "llvm.x86.sse.ldmxcsr",
                ir.VoidType(),
                builder.bitcast(place, ir.IntType(8).as_pointer()),
            )
        elif FLUSHING:
            _call(builder, "llvm.aarch64.set.fpcr", ir.VoidType(), args[0])
        return context.get_dummy_value()

    return types.void(types.int64), generate


@kernel
def flush_denormals():
    """From now on in this thread; returns what ``restore_denormals`` takes."""
    before = _control_word()
    _set_control_word(before | FLUSHING)
    return before


@kernel
def restore_denormals(before):
    """As it was when ``flush_denormals`` returned ``before``, in this thread."""
    _set_control_word(before)
