# SPDX-License-Identifier: GPL-3.0-or-later
"""The colours of Gaussians under given lights, and their gradients, in one pass over the Gaussians.

Those of a product composer after an additive modulator (``model.radiance``). With Δ = Σ_k s_k (l_k − 1), not
below ``DARKEST`` − 1, and x = ln L_a + ln H_r + ln(1 + Δ), held within bounds, ĉ = exp(x).
As single tensor operations this is twenty to thirty of them, each a pass over the memory. Backward
recomputes x; where x or Δ is held at its bound, no gradient passes:

    ∂L/∂x = ĉ ∂L/∂ĉ,   ∂L/∂s_k = ∂L/∂x (l_k − 1) / (1 + Δ)

Where every level is 1, Δ is 0 whatever the shares are: these are not read, and their gradient is 0.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numba import njit

from ..simd import (
    LANES,
    absolute,
    exp,
    fma,
    kernel,
    load,
    load_strided,
    load_triples,
    log2_of_positive,
    maximum,
    minimum,
    run_ranges,
    select,
    splat,
    store,
    store_strided,
    store_triples,
)
from .plain import can_fuse

#: Bounds of ln radiance, 6e-6 … 8e3: they keep exp() and its gradient finite, and what is white in every
#: picture from growing for ever. Of pictures that show more they are wider (``train.views``).
LOG_RADIANCE_RANGE = (-12.0, 9.0)

#: The least that modulation leaves of an illumination.
DARKEST = 1e-6

_LEAST_CHANGE = np.float32(DARKEST - 1.0)
_LN2 = np.float32(np.log(2.0))
_THIRD = np.float32(1.0 / 3.0)


def lit_colours(
    log_reflectance: torch.Tensor,
    log_illumination: torch.Tensor,
    light_share: torch.Tensor | None,
    levels: Sequence[float],
    bounds: tuple[float, float] = LOG_RADIANCE_RANGE,
) -> tuple[torch.Tensor, torch.Tensor]:
    """ĉ ``[N, 3]``, and |L_a − L̂_a| ``[N]``, which has no gradient.

    ln H_r ``[N, 3]``, ln L_a ``[N, 1 or 3]``, s ``[N, C, 3]`` and C ``levels``; without shares there is no
    level to obey. ``bounds``: of ln ĉ. Float32 on the CPU is fused; anything else goes to
    ``lit_colours_reference``.
    """
    tensors = [log_reflectance, log_illumination, *([] if light_share is None else [light_share])]
    arguments = log_reflectance, log_illumination, light_share, tuple(levels), bounds
    if not can_fuse(*tensors) or log_reflectance.shape[0] < LANES:
        return lit_colours_reference(*arguments)
    return _LitColours.apply(*arguments)


def modulated_illumination(
    log_illumination: torch.Tensor, levels: Sequence[float], light_share: torch.Tensor
) -> torch.Tensor:
    """ln L̂_a ``[N, 3]`` = ln L_a + ln(1 + Δ) in plain torch; the rest as ``lit_colours``."""
    # Numbers, light by light: a tensor of the levels would have to be copied to a card, which waits.
    shares = light_share.unbind(1) if len(levels) > 1 else (light_share.squeeze(1),)
    change = shares[0] * (levels[0] - 1.0)
    for share, level in zip(shares[1:], levels[1:], strict=True):
        change = change + share * (level - 1.0)
    # At l = 0 and s = 1 nothing is left, and its logarithm would have no gradient.
    return log_illumination + torch.log1p(change.clamp_min(DARKEST - 1.0))


def radiance_of_logarithm(log_radiance: torch.Tensor, bounds: tuple[float, float]) -> torch.Tensor:
    """exp of what is held within ``bounds``, in plain torch."""
    return log_radiance.clamp(*bounds).exp()


def lit_colours_reference(
    log_reflectance: torch.Tensor,
    log_illumination: torch.Tensor,
    light_share: torch.Tensor | None,
    levels: Sequence[float],
    bounds: tuple[float, float] = LOG_RADIANCE_RANGE,
) -> tuple[torch.Tensor, torch.Tensor]:
    """``lit_colours`` in plain torch, for any dtype and device."""
    relit = log_illumination
    if light_share is not None:
        relit = modulated_illumination(log_illumination, levels, light_share)
    with torch.no_grad():
        deviation = illumination_deviation(log_illumination, relit)
    return radiance_of_logarithm(relit + log_reflectance, bounds), deviation


def illumination_deviation(before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
    """|L_a − L̂_a| ``[N]``, a mean over the channels, from ln L_a and ln L̂_a ``[N, 1 or 3]``."""
    return (before.exp() - after.exp()).abs().mean(dim=1)


class _LitColours(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, log_reflectance, log_illumination, light_share, levels, bounds):
        share, offsets = torch.empty(0), np.array([level - 1.0 for level in levels], np.float32)
        if light_share is not None and offsets.any():
            share = light_share.detach().contiguous()
        else:
            offsets = offsets[:0]
        inputs = [log_reflectance.detach().contiguous(), log_illumination.detach().contiguous(), share]
        ctx.shares, ctx.offsets = None if light_share is None else light_share.shape, offsets
        ctx.bounds = tuple(np.float32(bound) for bound in bounds)
        count = log_reflectance.shape[0]
        colours = torch.empty(count, 3)
        deviation = torch.empty(count) if offsets.size else torch.zeros(count)
        run_ranges(
            *(_colours, count, log_illumination.shape[1], *(_flat(t) for t in inputs), offsets),
            *(*ctx.bounds, _flat(colours), deviation.numpy()),
        )
        ctx.save_for_backward(*inputs, colours)
        ctx.mark_non_differentiable(deviation)
        ctx.set_materialize_grads(False)
        return colours, deviation

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        grad = grads[0]
        if grad is None:
            return (None,) * 5
        *inputs, colours = ctx.saved_tensors
        reflectance, illumination, share = inputs
        grad_reflectance, grad_illumination = torch.empty_like(reflectance), torch.empty_like(illumination)
        grad_share = torch.empty_like(share)
        run_ranges(
            *(_colours_backward, colours.shape[0], illumination.shape[1], *(_flat(t) for t in inputs)),
            *(ctx.offsets, *ctx.bounds, _flat(colours), _flat(grad.contiguous())),
            *(_flat(t) for t in (grad_reflectance, grad_illumination, grad_share)),
        )
        if ctx.shares is not None and not ctx.offsets.size:
            grad_share = torch.zeros(ctx.shares)  # not None: Adam goes on by its moments
        return grad_reflectance, grad_illumination, None if ctx.shares is None else grad_share, None, None


def _flat(tensor: torch.Tensor) -> np.ndarray:
    return tensor.numpy().reshape(-1)


# In both kernels, the last vector of a range begins so that it ends with the range: what it has in common
# with the one before is computed twice, to the same numbers.


@njit
def _illumination(illumination, at, channels):
    """ln L_a of ``LANES`` Gaussians from ``at`` on, in each colour, of 1 or 3 ``channels``."""
    if channels == 1:
        l0 = load(illumination, at)
        return l0, l0, l0
    return load_triples(illumination, 3 * at)


@njit
def _change(share, offsets, at, channel):
    """Δ of ``LANES`` Gaussians from ``at`` on, in one channel, without its bound."""
    lights = offsets.size
    result = splat(0.0)
    for k in range(lights):
        place = 3 * (at * lights + k) + channel
        result = fma(load_strided(share, place, 3 * lights, LANES), offsets[k], result)
    return result


@njit
def _logarithm(x):
    """ln x of x ≥ 2^−126; NaN stays NaN."""
    return select(x >= x, log2_of_positive(x) * _LN2, x)


@kernel
def _colours(
    first,
    last,
    channels,
    reflectance,
    illumination,
    share,
    offsets,
    low,
    high,
    colours,
    deviation,
):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        h0, h1, h2 = load_triples(reflectance, 3 * at)
        l0, l1, l2 = _illumination(illumination, at, channels)
        if offsets.size:
            f0 = _logarithm(1.0 + maximum(_change(share, offsets, at, 0), _LEAST_CHANGE))
            f1 = _logarithm(1.0 + maximum(_change(share, offsets, at, 1), _LEAST_CHANGE))
            f2 = _logarithm(1.0 + maximum(_change(share, offsets, at, 2), _LEAST_CHANGE))
            moved = (
                absolute(exp(l0) - exp(l0 + f0))
                + absolute(exp(l1) - exp(l1 + f1))
                + absolute(exp(l2) - exp(l2 + f2))
            )
            store(moved * _THIRD, deviation, at)
            l0, l1, l2 = l0 + f0, l1 + f1, l2 + f2
        r0, r1, r2 = (
            _radiance(l0 + h0, low, high),
            _radiance(l1 + h1, low, high),
            _radiance(l2 + h2, low, high),
        )
        store_triples((r0, r1, r2), colours, 3 * at)


@njit
def _radiance(x, low, high):
    # NaN stays NaN, which the rasteriser refuses.
    return select(x >= x, exp(minimum(maximum(x, low), high)), x)


@njit
def _passed(x, low, high, colour, grad):
    """∂L/∂x."""
    return select((x >= low) & (x <= high), grad * colour, 0.0)


@njit
def _share_gradient(g, change, offsets, at, channel, grad_share):
    """∂L/∂s of every light in one channel."""
    lights = offsets.size
    through = select(change >= _LEAST_CHANGE, g / (1.0 + change), 0.0)
    for k in range(lights):
        store_strided(through * offsets[k], grad_share, 3 * (at * lights + k) + channel, 3 * lights, LANES)


@kernel
def _colours_backward(
    first,
    last,
    channels,
    reflectance,
    illumination,
    share,
    offsets,
    low,
    high,
    colours,
    grad,
    grad_reflectance,
    grad_illumination,
    grad_share,
):
    for i in range(first, last, LANES):
        at = min(i, last - LANES)
        x0, x1, x2 = load_triples(reflectance, 3 * at)
        l0, l1, l2 = _illumination(illumination, at, channels)
        x0, x1, x2 = x0 + l0, x1 + l1, x2 + l2
        d0, d1, d2 = splat(0.0), splat(0.0), splat(0.0)
        if offsets.size:
            d0 = _change(share, offsets, at, 0)
            d1 = _change(share, offsets, at, 1)
            d2 = _change(share, offsets, at, 2)
            x0 = x0 + _logarithm(1.0 + maximum(d0, _LEAST_CHANGE))
            x1 = x1 + _logarithm(1.0 + maximum(d1, _LEAST_CHANGE))
            x2 = x2 + _logarithm(1.0 + maximum(d2, _LEAST_CHANGE))
        c0, c1, c2 = load_triples(colours, 3 * at)
        g0, g1, g2 = load_triples(grad, 3 * at)
        g0, g1 = _passed(x0, low, high, c0, g0), _passed(x1, low, high, c1, g1)
        g2 = _passed(x2, low, high, c2, g2)
        store_triples((g0, g1, g2), grad_reflectance, 3 * at)
        if channels == 1:
            store(g0 + g1 + g2, grad_illumination, at)
        else:
            store_triples((g0, g1, g2), grad_illumination, 3 * at)
        if offsets.size:
            _share_gradient(g0, d0, offsets, at, 0, grad_share)
            _share_gradient(g1, d1, offsets, at, 1, grad_share)
            _share_gradient(g2, d2, offsets, at, 2, grad_share)
