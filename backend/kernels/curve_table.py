# SPDX-License-Identifier: GPL-3.0-or-later
"""A scalar function at very many points, by way of its values at few.

A smooth response curve of a million pixels costs a million exponentials per hidden unit when taken
literally. But a function of one number is known everywhere once it is known at a few thousand knots:
between knots we take the cubic through the four nearest (Lagrange). Its error is below
0.024 h⁴ max|f⁗| for a spacing h; with h = 1/128 and f = Σ w₂ softplus(w₁x + b₁), where |softplus⁗| ≤ 1/8,
that is 1.1e-11 Σ |w₂| w₁⁴: below float32's own rounding for every |w₁| ≤ 12 (``MAX_WEIGHT``; beyond it
``mlp`` takes the direct way).

With s ∈ [0, 1) the place between two knots, y = c₀ + c₁s + c₂s² + c₃s³, and the coefficients are linear in
the four values. Backward: ∂L/∂c_j = Σ sʲ ∂L/∂y over the points between the two knots, then by the
transpose of that map to the values, whose gradient the network's kernel takes to the weights. ∂L/∂x uses
the derivative's own table: differences of values would lose half of the digits.
"""

from typing import Any

import numpy as np
import torch

from ..simd import kernel, run_parallel, take_ticket

#: Knots per unit; a power of two, so that knots are exact in float32.
KNOTS_PER_UNIT = 128

#: Above this the curve may bend too fast for the knots.
MAX_WEIGHT = 12.0

#: Points of a job; how many more points than knots, and at least how many, make the table worth while.
CHUNK = 16384
WORTH_WHILE = 2
FEW = 1000

#: Rows: values at knots −1, 0, 1, 2 around the interval; columns: c₀ … c₃.
_CUBIC = np.array(
    [[0, -1 / 3, 1 / 2, -1 / 6], [1, -1 / 2, -1, 1 / 2], [0, 1, 1 / 2, -1 / 2], [0, -1 / 6, 0, 1 / 6]]
)


def knots_for(x: torch.Tensor) -> torch.Tensor | None:
    """Knots ``[K]`` that surround all of ``x``, or ``None`` if it has too few points for its range."""
    low, high = (float(v) for v in torch.aminmax(x.detach()))
    return knots_between(low, high, x.shape[-1])


def knots_between(low: float, high: float, points: int) -> torch.Tensor | None:
    """Knots ``[K]`` for ``points`` points between ``low`` and ``high``, or ``None`` if these are too few."""
    # Written so that NaN and infinity fail it, too.
    if not (high - low) * KNOTS_PER_UNIT * WORTH_WHILE + FEW < points:
        return None
    first, last = (int(np.floor(v * KNOTS_PER_UNIT)) for v in (low, high))
    return torch.arange(first - 1, last + 3, dtype=torch.float32) / KNOTS_PER_UNIT


def interpolate(
    x: torch.Tensor, knots: torch.Tensor, values: torch.Tensor, slopes: torch.Tensor
) -> torch.Tensor:
    """The curves of ``values`` ``[C, K]`` at ``x`` ``[C, P]``; ``slopes`` ``[C, K]``: their derivatives."""
    return _Interpolate.apply(x, values, slopes, float(knots[0]))


def coefficients_of(values: torch.Tensor) -> np.ndarray:
    """``[C, K]`` → ``[C, K, 4]``, for the interval to the right of every knot (zero at the ends)."""
    around = np.lib.stride_tricks.sliding_window_view(values.detach().numpy().astype(np.float64), 4, axis=1)
    result = np.zeros((*values.shape, 4), np.float32)
    result[:, 1:-2] = around @ _CUBIC
    return result


class _Interpolate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x, values, slopes, start: float) -> torch.Tensor:
        x = x.detach().contiguous()
        y = torch.empty_like(x)
        arrays = (x.numpy(), coefficients_of(values), np.float32(start), y.numpy())
        counter = np.zeros(1, np.int64)
        run_parallel(lambda _: _forward(counter, *arrays))
        ctx.saved = (x, slopes.detach(), start)
        return y

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (grad,) = grads
        x, slopes, start = ctx.saved
        chunks = -(-x.shape[1] // CHUNK)
        partials = np.zeros((x.shape[0], chunks, slopes.shape[1], 4), np.float32)
        grad_x = torch.empty_like(x)
        arrays = (x.numpy(), coefficients_of(slopes), np.float32(start), grad.contiguous().numpy())
        counter = np.zeros(1, np.int64)
        run_parallel(lambda _: _backward(counter, *arrays, grad_x.numpy(), partials))
        return grad_x, gradient_of_values(partials), None, None


def gradient_of_values(partials: np.ndarray) -> torch.Tensor:
    """∂L/∂values ``[C, K]`` from ∂L/∂c₀ … ∂L/∂c₃ of every interval ``[C, chunks, K, 4]``."""
    by_value = partials.sum(1, dtype=np.float64) @ _CUBIC.T
    channels, knots = by_value.shape[:2]
    result = np.zeros((channels, knots))
    for offset in range(4):
        # Interval k takes the values of knots k − 1 … k + 2.
        result[:, offset : offset + knots - 3] += by_value[:, 1:-2, offset]
    return torch.from_numpy(result.astype(np.float32))


@kernel
def _forward(counter, x, coefficients, start, y):
    """y of the chunks of points whose tickets are drawn from ``counter``."""
    channels, points = x.shape
    chunks = (points + CHUNK - 1) // CHUNK
    while True:
        ticket = take_ticket(counter)
        if ticket >= channels * chunks:
            break
        channel, begin = ticket // chunks, ticket % chunks * CHUNK
        table = coefficients[channel]
        for p in range(begin, min(begin + CHUNK, points)):
            place = (x[channel, p] - start) * np.float32(KNOTS_PER_UNIT)
            whole = np.floor(place)
            s, k = place - whole, np.int64(whole)
            y[channel, p] = table[k, 0] + s * (table[k, 1] + s * (table[k, 2] + s * table[k, 3]))


@kernel
def _backward(counter, x, slopes, start, grad, grad_x, partials):
    """``grad_x``, and ``partials[channel, chunk]``: ∂L/∂c₀ … ∂L/∂c₃ of every interval."""
    channels, points = x.shape
    chunks = (points + CHUNK - 1) // CHUNK
    while True:
        ticket = take_ticket(counter)
        if ticket >= channels * chunks:
            break
        channel, chunk = ticket // chunks, ticket % chunks
        table, sums = slopes[channel], partials[channel, chunk]
        for p in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, points)):
            place = (x[channel, p] - start) * np.float32(KNOTS_PER_UNIT)
            whole = np.floor(place)
            s, k, g = place - whole, np.int64(whole), grad[channel, p]
            grad_x[channel, p] = g * (table[k, 0] + s * (table[k, 1] + s * (table[k, 2] + s * table[k, 3])))
            gs = g * s
            gss = gs * s
            sums[k, 0] += g
            sums[k, 1] += gs
            sums[k, 2] += gss
            sums[k, 3] += gss * s
