# SPDX-License-Identifier: GPL-3.0-or-later
"""Powers and logarithms lane by lane: polynomials, of just the range and precision that the kernels need.

The coefficients are minimax to within a few percent (Lawson's iteration on a dense grid).
"""

from llvmlite import ir

from .vector import IVECTOR, LANES, VECTOR, call_llvm, constant, fma_llvm, intrinsic, vector

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
    value = constant(coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = fma_llvm(builder, value, x, constant(coefficient))
    return value


@intrinsic
def exp_of_negative(typing, x):
    """``e ** x`` for x ≤ 0; 0 is never reached, what would be below 2^−126 becomes that."""

    def generate(context, builder, sig, args):
        t = builder.fmul(args[0], constant(1.4426950408889634))
        t = builder.select(builder.fcmp_ordered(">", t, constant(-126.0)), t, constant(-126.0))
        whole = call_llvm(builder, f"llvm.rint.v{LANES}f32", VECTOR, t)
        value = _polynomial(builder, _EXP2_CENTRED, builder.fsub(t, whole))
        shifted = builder.shl(builder.fptosi(whole, IVECTOR), ir.Constant(IVECTOR, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(value, IVECTOR), shifted), VECTOR)

    return vector(vector), generate


#: ln 2 in two parts, of which the first has ten bits: its product with an exponent is exact.
_LN2_HIGH, _LN2_LOW = 0.693359375, -2.1219444005e-4
#: Beyond these e ** x would be no normal number.
_EXP_RANGE = (-87.0, 88.0)


@intrinsic
def exp(typing, x):
    """``e ** x``, relative error below 3e-7; of what is beyond −87 and 88, and of NaN, a bound's."""

    def generate(context, builder, sig, args):
        low, high = (constant(bound) for bound in _EXP_RANGE)
        x = builder.select(builder.fcmp_ordered(">", args[0], low), args[0], low)
        x = builder.select(builder.fcmp_ordered("<", x, high), x, high)
        whole = call_llvm(
            builder, f"llvm.rint.v{LANES}f32", VECTOR, builder.fmul(x, constant(1.4426950408889634))
        )
        rest = fma_llvm(builder, whole, constant(-_LN2_HIGH), x)
        rest = fma_llvm(builder, whole, constant(-_LN2_LOW), rest)
        value = _polynomial(builder, _EXP2_CENTRED, builder.fmul(rest, constant(1.4426950408889634)))
        shifted = builder.shl(builder.fptosi(whole, IVECTOR), ir.Constant(IVECTOR, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(value, IVECTOR), shifted), VECTOR)

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
        bits = builder.bitcast(args[0], IVECTOR)
        shift = ir.Constant(IVECTOR, [23] * LANES)
        exponent = builder.ashr(builder.sub(bits, ir.Constant(IVECTOR, [_SQRT_HALF_BITS] * LANES)), shift)
        mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, shift)), VECTOR)
        fraction = builder.fsub(mantissa, constant(1.0))
        logarithm = builder.fmul(_polynomial(builder, _LOG2, fraction), fraction)
        return builder.fadd(builder.sitofp(exponent, VECTOR), logarithm)

    return vector(vector), generate
