# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tone mapper does to every pixel by itself, in one pass over the picture instead of four or five.

As single tensor operations these cost as much as the rasteriser: each reads and writes the whole picture,
forward and backward. Backward recomputes what it needs from the inputs; σ′ = σ (1 − σ).
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numba import njit

from ..simd import (
    LANES,
    absolute,
    exp_of_negative,
    fma,
    kernel,
    load,
    log2_of_positive,
    maximum,
    minimum,
    run_ranges,
    select,
    store,
)
from .plain import can_fuse

_LN2 = np.float32(np.log(2.0))


def log_of_exposure(exposure: torch.Tensor, epsilon: float) -> torch.Tensor:
    """ln(max(x, 0) + ε) of a tensor of any shape."""
    if not _fits(exposure):
        return (exposure.clamp_min(0.0) + epsilon).log()
    return _LogOfExposure.apply(exposure, epsilon)


def corrected(response: torch.Tensor, correction: torch.Tensor) -> torch.Tensor:
    """clip(y + σ(c) − ½, 0, 1): a global response y, corrected by local logits c of the same shape."""
    if not _fits(response, correction):
        return (response + correction.sigmoid() - 0.5).clamp(0.0, 1.0)
    return _Corrected.apply(response, correction)


def blend(a: torch.Tensor, b: torch.Tensor, logits: torch.Tensor) -> torch.Tensor:
    """σ(z) a + (1 − σ(z)) b; all three of the same shape."""
    if not _fits(a, b, logits):
        weight = logits.sigmoid()
        return weight * a + (1.0 - weight) * b
    return _Blend.apply(a, b, logits)


def _fits(*tensors: torch.Tensor) -> bool:
    return can_fuse(*tensors) and tensors[0].numel() >= LANES


def _run(function: Callable[..., object], tensors: list[torch.Tensor], *numbers: Any) -> None:
    """Call a kernel on the flat arrays of ``tensors``, which are contiguous and of one size."""
    run_ranges(function, tensors[0].numel(), *(t.numpy().reshape(-1) for t in tensors), *numbers)


class _LogOfExposure(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, exposure, epsilon: float) -> torch.Tensor:
        exposure = exposure.detach().contiguous()
        ctx.save_for_backward(exposure)
        ctx.epsilon = np.float32(epsilon)
        result = torch.empty_like(exposure)
        _run(_log_of_exposure, [exposure, result], ctx.epsilon)
        return result

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (exposure,) = ctx.saved_tensors
        result = torch.empty_like(exposure)
        _run(_log_of_exposure_backward, [exposure, grads[0].contiguous(), result], ctx.epsilon)
        return result, None


class _Corrected(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, response, correction) -> torch.Tensor:
        tensors = [response.detach().contiguous(), correction.detach().contiguous()]
        ctx.save_for_backward(*tensors)
        result = torch.empty_like(tensors[0])
        _run(_corrected, [*tensors, result])
        return result

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        results = [torch.empty_like(t) for t in ctx.saved_tensors]
        _run(_corrected_backward, [*ctx.saved_tensors, grads[0].contiguous(), *results])
        return tuple(results)


class _Blend(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, a, b, logits) -> torch.Tensor:
        tensors = [t.detach().contiguous() for t in (a, b, logits)]
        ctx.save_for_backward(*tensors)
        result = torch.empty_like(tensors[0])
        _run(_blend, [*tensors, result])
        return result

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        results = [torch.empty_like(t) for t in ctx.saved_tensors]
        _run(_blend_backward, [*ctx.saved_tensors, grads[0].contiguous(), *results])
        return tuple(results)


# In all kernels, the last vector of a range begins so that it ends with the range: what it has in common with
# the one before is computed twice, to the same numbers.


@njit
def _sigmoid(z):
    e = exp_of_negative(-absolute(z))
    inverse = 1.0 / (1.0 + e)
    # The exponential works on bits and would make a number of NaN, with which training would go on.
    return select(z >= z, select(z > 0.0, inverse, e * inverse), z)


@kernel
def _log_of_exposure(first, last, x, y, epsilon):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        value = load(x, at)
        # The logarithm works on bits and would make a number of NaN; 0 · NaN is NaN.
        store(fma(log2_of_positive(maximum(value, 0.0) + epsilon), _LN2, value * 0.0), y, at)


@kernel
def _log_of_exposure_backward(first, last, x, grad, grad_x, epsilon):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        value = load(x, at)
        store(select(value >= 0.0, load(grad, at) / (value + epsilon), 0.0), grad_x, at)


@kernel
def _corrected(first, last, response, correction, y):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        value = load(response, at) + _sigmoid(load(correction, at)) - 0.5
        store(minimum(1.0, maximum(value, 0.0)), y, at)  # in this order NaN stays NaN


@kernel
def _corrected_backward(first, last, response, correction, grad, grad_response, grad_correction):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        sigmoid = _sigmoid(load(correction, at))
        value = load(response, at) + sigmoid - 0.5
        g = select((value >= 0.0) & (value <= 1.0), load(grad, at), 0.0)
        store(g, grad_response, at)
        store(g * sigmoid * (1.0 - sigmoid), grad_correction, at)


@kernel
def _blend(first, last, a, b, logits, y):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        below = load(b, at)
        store(fma(_sigmoid(load(logits, at)), load(a, at) - below, below), y, at)


@kernel
def _blend_backward(first, last, a, b, logits, grad, grad_a, grad_b, grad_logits):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        weight, g = _sigmoid(load(logits, at)), load(grad, at)
        store(g * weight, grad_a, at)
        store(g * (1.0 - weight), grad_b, at)
        store(g * (load(a, at) - load(b, at)) * weight * (1.0 - weight), grad_logits, at)
