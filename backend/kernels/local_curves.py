# SPDX-License-Identifier: GPL-3.0-or-later
"""The local response curves: one network a colour channel, which sees an exposure and a context.

y = w₂ · relu(w₁ x + W_c c + b₁) + b₂, x being the channel's log exposure and c ``[F]`` the pixel's context.
Both branches of the method ask the same curves at the same pixels with the same context, and differ in x
alone. So W_c c + b₁ is taken once for both, and likewise its gradient: with δ_b = w₂ relu′(z_b) ∂L/∂y_b and
s = Σ_b δ_b over the branches b,

    ∂L/∂x_b = Σ_h w₁ δ_b     ∂L/∂c = Σ_h W_c s     ∂L/∂w₁ = Σ_b δ_b x_b     ∂L/∂W_c = s cᵀ     ∂L/∂b₁ = s

That is a third less arithmetic than the networks one by one, and half of the loads and stores. Sums over
points as in ``mlp``: lane by lane within a chunk of fixed size, chunks in their order in float64.
"""

from typing import Any

import numpy as np
import torch
from numba import njit

from ..simd import (
    LANES,
    dot_each,
    fma_each,
    kernel,
    load,
    load_each,
    peek,
    positive_each,
    repeat_each,
    run_parallel,
    splat,
    splat_each,
    store,
    store_each,
    take_ticket,
    total,
    where_positive_each,
    zero_each,
)
from .plain import can_fuse, card_takes

#: Points of a job.
CHUNK = 4096


def local_curves(
    x: torch.Tensor,
    context: torch.Tensor,
    w1: torch.Tensor,
    b1: torch.Tensor,
    w2: torch.Tensor,
    b2: torch.Tensor,
) -> torch.Tensor:
    """``x`` ``[C, B, P]`` log exposures of C channels in B branches, ``context`` ``[F, P]`` → ``[C, B, P]``.

    ``w1`` ``[C, H, 1 + F]`` (the exposure's weight first), ``b1``, ``w2`` ``[C, H]``, ``b2`` ``[C]``. Float32
    is fused, on the CPU and by Warp; anything else goes to ``local_curves_reference``.
    """
    if card_takes(x, w1):
        from .card.networks import local_curves as on_card

        return on_card(x, context, w1, b1, w2, b2)
    if not can_fuse(x, w1):
        return local_curves_reference(x, context, w1, b1, w2, b2)
    return _LocalCurves.apply(x, context, w1, b1, w2, b2)


def local_curves_reference(x, context, w1, b1, w2, b2) -> torch.Tensor:
    """The same in plain torch, for any dtype and device."""
    shared = torch.einsum("chf,fp->chp", w1[:, :, 1:], context) + b1[:, :, None]
    hidden = torch.relu(w1[:, None, :, :1] * x[:, :, None] + shared[:, None])
    return torch.einsum("ch,cbhp->cbp", w2, hidden) + b2[:, None, None]


class _LocalCurves(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x, context, w1, b1, w2, b2) -> torch.Tensor:
        tensors = [t.detach().contiguous() for t in (x, context, w1, b1, w2)]
        result = torch.empty(x.shape)
        markers = ((0,) * x.shape[1], (0,) * context.shape[0])
        arrays = [t.numpy() for t in (*tensors, b2.detach().contiguous(), result)]
        counter = np.zeros(1, np.int64)
        run_parallel(lambda _: _forward(counter, *markers, *arrays))
        ctx.save_for_backward(*tensors)
        return result

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (grad,) = grads
        x, context, w1, b1, w2 = ctx.saved_tensors
        channels, branches, points = x.shape
        features, units = context.shape[0], b1.shape[1]
        grad_x, grad_context = torch.empty_like(x), torch.zeros(features, points)
        partials = np.zeros((channels, -(-points // CHUNK), units, features + 3), np.float32)
        markers = ((0,) * branches, (0,) * features)
        arrays = [t.numpy() for t in (x, context, w1, b1, w2, grad.contiguous(), grad_x, grad_context)]
        counter = np.zeros(1, np.int64)
        run_parallel(lambda _: _backward(counter, *markers, *arrays, partials))
        sums = torch.from_numpy(partials.sum(axis=1, dtype=np.float64).astype(np.float32))
        grad_w1, grad_b1, grad_w2 = sums.split([1 + features, 1, 1], dim=2)
        return grad_x, grad_context, grad_w1, grad_b1[..., 0], grad_w2[..., 0], grad.sum((1, 2))


@njit
def _forward_vector(branches, features, x, context, at, stride, w1, b1, w2, b2, y):
    """One vector of points of one channel; rows of ``x``, ``context`` and ``y`` are ``stride`` apart."""
    own, shared = load_each(branches, x, at, stride), load_each(features, context, at, stride)
    result = repeat_each(branches, splat(b2))
    for h in range(b1.size):
        here = h * (1 + len(features))
        common = dot_each(splat_each(features, w1, here + 1), shared, splat(peek(b1, h)))
        z = fma_each(splat(peek(w1, here)), own, repeat_each(branches, common))
        result = fma_each(splat(peek(w2, h)), positive_each(z), result)
    store_each(result, y, at, stride)


@njit
def _backward_vector(
    branches, features, x, context, grad, at, stride, w1, b1, w2, sums, grad_x, grad_context
):
    """One vector of points: ∂x, what it adds to ∂context, and its part of ``sums``, unit by unit."""
    own, shared = load_each(branches, x, at, stride), load_each(features, context, at, stride)
    g = load_each(branches, grad, at, stride)
    ones = repeat_each(branches, splat(1.0))
    d_own, d_shared = zero_each(branches), zero_each(features)
    for h in range(b1.size):
        here = h * (1 + len(features))
        weights, weight = splat_each(features, w1, here + 1), splat(peek(w1, here))
        common = dot_each(weights, shared, splat(peek(b1, h)))
        z = fma_each(weight, own, repeat_each(branches, common))
        delta = where_positive_each(z, fma_each(splat(peek(w2, h)), g, zero_each(branches)))
        both = dot_each(delta, ones, splat(0.0))
        d_own, d_shared = fma_each(weight, delta, d_own), fma_each(both, weights, d_shared)
        here = h * (3 + len(features)) * LANES
        store(dot_each(delta, own, load(sums, here)), sums, here)
        here += LANES
        store_each(fma_each(both, shared, load_each(features, sums, here, LANES)), sums, here, LANES)
        here += len(features) * LANES
        store(load(sums, here) + both, sums, here)
        here += LANES
        store(dot_each(positive_each(z), g, load(sums, here)), sums, here)
    store_each(d_own, grad_x, at, stride)
    d_context = load_each(features, grad_context, at, stride)
    store_each(fma_each(splat(1.0), d_shared, d_context), grad_context, at, stride)


@kernel
def _forward(counter, branches, features, x, context, w1, b1, w2, b2, y):
    """y of the (channel, chunk) jobs whose tickets are drawn from ``counter``."""
    channels, _, points = x.shape
    chunks = (points + CHUNK - 1) // CHUNK
    flat_context = context.reshape(-1)
    tail_x, tail_y = np.zeros(len(branches) * LANES, np.float32), np.zeros(len(branches) * LANES, np.float32)
    tail_context = np.zeros(len(features) * LANES, np.float32)
    while True:
        ticket = take_ticket(counter)
        if ticket >= channels * chunks:
            break
        c, begin = ticket // chunks, ticket % chunks * CHUNK
        xc, yc, w1c, b1c, w2c = x[c].reshape(-1), y[c].reshape(-1), w1[c].reshape(-1), b1[c], w2[c]
        end = min(begin + CHUNK, points)
        left = (end - begin) % LANES
        if left:
            _copy_rows(xc, end - left, points, tail_x, 0, LANES, len(branches), left)
            _copy_rows(flat_context, end - left, points, tail_context, 0, LANES, len(features), left)
        # One call for both, as it is compiled into each: whole vectors, and the copy of what is left.
        for is_tail in range(2 if left else 1):
            own, shared, target, stride, first, last = xc, flat_context, yc, points, begin, end - left
            if is_tail:
                own, shared, target, stride, first, last = tail_x, tail_context, tail_y, LANES, 0, LANES
            for p in range(first, last, LANES):
                _forward_vector(branches, features, own, shared, p, stride, w1c, b1c, w2c, b2[c], target)
        if left:
            _copy_rows(tail_y, 0, LANES, yc, end - left, points, len(branches), left)


@kernel
def _backward(counter, branches, features, x, context, w1, b1, w2, grad, grad_x, grad_context, partials):
    """Gradients of points, and ``partials[channel, chunk, h]``: ∂w₁, ∂W_c, ∂b₁, ∂w₂. A job is a chunk.

    ``grad_context`` is zero before.
    """
    channels, _, points = x.shape
    chunks = (points + CHUNK - 1) // CHUNK
    units, size = b1.shape[1], 3 + len(features)
    flat_context, flat_grad_context = context.reshape(-1), grad_context.reshape(-1)
    sums = np.empty(units * size * LANES, np.float32)
    # Lanes without a point have no gradient and add nothing.
    tail_x, tail_dx = np.zeros(len(branches) * LANES, np.float32), np.zeros(len(branches) * LANES, np.float32)
    tail_grad, tail_context = np.zeros_like(tail_x), np.zeros(len(features) * LANES, np.float32)
    tail_dc = np.zeros_like(tail_context)
    while True:
        chunk = take_ticket(counter)
        if chunk >= chunks:
            break
        begin, end = chunk * CHUNK, min(chunk * CHUNK + CHUNK, points)
        left = (end - begin) % LANES
        for c in range(channels):
            xc, gc, dxc, w1c = x[c].reshape(-1), grad[c].reshape(-1), grad_x[c].reshape(-1), w1[c].reshape(-1)
            b1c, w2c = b1[c], w2[c]
            sums[:] = 0.0
            if left:
                _copy_rows(xc, end - left, points, tail_x, 0, LANES, len(branches), left)
                _copy_rows(gc, end - left, points, tail_grad, 0, LANES, len(branches), left)
                _copy_rows(flat_context, end - left, points, tail_context, 0, LANES, len(features), left)
                _copy_rows(flat_grad_context, end - left, points, tail_dc, 0, LANES, len(features), left)
            for is_tail in range(2 if left else 1):
                own, shared, g, stride, first, last = xc, flat_context, gc, points, begin, end - left
                dx, dc = dxc, flat_grad_context
                if is_tail:
                    own, shared, g, stride, first, last = tail_x, tail_context, tail_grad, LANES, 0, LANES
                    dx, dc = tail_dx, tail_dc
                for p in range(first, last, LANES):
                    _backward_vector(
                        branches, features, own, shared, g, p, stride, w1c, b1c, w2c, sums, dx, dc
                    )
            if left:
                _copy_rows(tail_dx, 0, LANES, dxc, end - left, points, len(branches), left)
                _copy_rows(tail_dc, 0, LANES, flat_grad_context, end - left, points, len(features), left)
            for h in range(units):
                for k in range(size):
                    partials[c, chunk, h, k] = total(load(sums, (h * size + k) * LANES))


@njit
def _copy_rows(source, at, stride, target, to, target_stride, rows, count):
    """``count`` numbers of each of ``rows`` rows that are so far apart."""
    for row in range(rows):
        for i in range(count):
            target[to + row * target_stride + i] = source[at + row * stride + i]
