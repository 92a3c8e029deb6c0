# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks with one hidden layer, evaluated at many points at once, and their gradients.

y = W₂ a(W₁ x + b₁) + b₂ with x ``[I, P]``, planar, as images are. As tensor operations, every step writes
and reads ``[H, P]``; here the hidden layer never leaves the registers.

Forward: for a pair of vectors of points, run over the hidden units h: z = ⟨W₁ₕ, x⟩ + b₁ₕ, y += W₂ₕ a(z).

Backward, hidden units recomputed: δₕ = a′(z) ⟨W₂ₕ, ∂L/∂y⟩, and

    ∂L/∂x += δₕ W₁ₕ     ∂L/∂W₁ₕ += δₕ xᵀ     ∂L/∂b₁ₕ += δₕ     ∂L/∂W₂ₕ += a(z) (∂L/∂y)ᵀ

The last three are sums over points: each lane sums its own (the sums of one chunk of points are
``LANES · H (I + O + 1)`` floats and stay in the cache), lanes are added at the end of a chunk, chunks in
their order in float64. A chunk has a fixed size, so the sums do not depend on the number of threads.
"""

from typing import Any, Literal

import numpy as np
import torch
from numba import njit

from ..simd import (
    LANES,
    absolute,
    dot_each,
    exp_of_negative,
    fma,
    fma_each,
    kernel,
    load,
    load_each,
    log1p_of_fraction,
    maximum,
    run_parallel,
    select,
    splat,
    splat_each,
    store,
    store_each,
    take_ticket,
    total,
    zero_each,
)
from .curve_table import MAX_WEIGHT, interpolate, knots_for
from .plain import can_fuse, card_takes

Activation = Literal["relu", "softplus", "silu"]

#: Points of a chunk: enough to hide the summing of its lanes, few enough to share out evenly.
CHUNK = 4096

_TORCH = {"relu": torch.relu, "softplus": torch.nn.functional.softplus, "silu": torch.nn.functional.silu}
# An activation and a size reach the kernels as the length of a tuple: a type, so known when compiled.
_KIND = {"relu": (0,), "softplus": (0, 0), "silu": (0, 0, 0)}


def curve_mlp(
    x: torch.Tensor,
    w1: torch.Tensor,
    b1: torch.Tensor,
    w2: torch.Tensor,
    b2: torch.Tensor,
    activation: Activation,
) -> torch.Tensor:
    """A network 1 → H → 1 per channel → ``[C, P]``.

    ``x`` ``[C, P]``; ``w1``, ``b1``, ``w2`` ``[C, H]``; ``b2`` ``[C]``.
    """
    if card_takes(x, w1):
        from .card.networks import curve_mlp as on_card

        return on_card(x, w1, b1, w2, b2, activation)
    if not can_fuse(x, w1):
        return curve_mlp_reference(x, w1, b1, w2, b2, activation)
    knots = curve_knots(x, w1, activation)
    if knots is None:
        return _curves(x, w1, b1, w2, b2, activation)
    at_knots = knots.expand(x.shape[0], -1).contiguous()
    values = _curves(at_knots, w1, b1, w2, b2, activation)
    return interpolate(x, knots, values, curve_slopes(at_knots, w1, b1, w2, activation))


def curve_knots(x: torch.Tensor, w1: torch.Tensor, activation: Activation) -> torch.Tensor | None:
    """Knots for a table of ``curve_mlp`` at ``x``; ``None`` where every point is better done for itself."""
    if not can_fuse(x) or not x.numel() or not can_tabulate(w1, activation):
        return None
    return knots_for(x)


def can_tabulate(w1: torch.Tensor, activation: Activation) -> bool:
    """Whether a curve with these weights is smooth enough for ``curve_table``, and our kernels compute it."""
    return can_fuse(w1) and activation != "relu" and bool(w1.detach().abs().max() <= MAX_WEIGHT)


def _curves(x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
    """``curve_mlp``, every point for itself."""
    return _Networks.apply(x[:, None], w1[:, :, None], b1, w2[:, None, :], b2[:, None], activation)[:, 0]


def curve_slopes(x, w1, b1, w2, activation: Activation) -> torch.Tensor:
    """∂y/∂x of ``curve_mlp`` ``[C, P]``, not differentiable: what backward makes of a gradient of ones."""
    weights = [t.detach().contiguous() for t in (w1, b1, w2)]
    grad_x, _ = _run_backward(
        x[:, None],
        weights[0][..., None],
        weights[1],
        weights[2][..., None],
        torch.ones_like(x)[:, None],
        activation,
    )
    return grad_x[:, 0]


def small_mlp(
    x: torch.Tensor,
    w1: torch.Tensor,
    b1: torch.Tensor,
    w2: torch.Tensor,
    b2: torch.Tensor,
    activation: Activation,
) -> torch.Tensor:
    """``x`` ``[I, P]``, ``w1`` ``[H, I]``, ``b1`` ``[H]``, ``w2`` ``[O, H]``, ``b2`` ``[O]`` → ``[O, P]``."""
    if card_takes(x, w1):
        from .card.networks import small_mlp as on_card

        return on_card(x, w1, b1, w2, b2, activation)
    if not can_fuse(x, w1):
        return small_mlp_reference(x, w1, b1, w2, b2, activation)
    return _Networks.apply(x[None], w1[None], b1[None], w2[None], b2[None], activation)[0]


def curve_mlp_reference(x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
    """``curve_mlp`` in plain torch, for any dtype and device."""
    hidden = _TORCH[activation](w1[:, :, None] * x[:, None, :] + b1[:, :, None])
    return (w2[:, :, None] * hidden).sum(1) + b2[:, None]


def small_mlp_reference(x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
    """``small_mlp`` in plain torch, for any dtype and device."""
    return w2 @ _TORCH[activation](w1 @ x + b1[:, None]) + b2[:, None]


class _Networks(torch.autograd.Function):
    """G networks side by side.

    x ``[G, I, P]``, w1 ``[G, H, I]``, b1 ``[G, H]``, w2 ``[G, O, H]``, b2 ``[G, O]`` → ``[G, O, P]``.
    """

    @staticmethod
    def forward(ctx: Any, x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
        x, w1, b1, b2 = (t.detach().contiguous() for t in (x, w1, b1, b2))
        w2 = w2.detach().transpose(1, 2).contiguous()  # [G, H, O]: a unit's weights side by side
        result = torch.empty(x.shape[0], w2.shape[2], x.shape[2])
        if x.shape[2]:
            arrays = [t.numpy() for t in (x, w1, b1, w2, b2, result)]
            markers = ((0,) * x.shape[1], (0,) * w2.shape[2], _KIND[activation])
            counter = np.zeros(1, np.int64)
            run_parallel(lambda _: _forward(counter, *markers, *arrays))
        ctx.save_for_backward(x, w1, b1, w2)
        ctx.activation = activation
        return result

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (grad,) = grads
        x, w1, b1, w2 = ctx.saved_tensors
        inputs, outputs = x.shape[1], w2.shape[2]
        grad_x, sums = _run_backward(x, w1, b1, w2, grad.contiguous(), ctx.activation)
        grad_w1, grad_b1, grad_w2 = sums.split([inputs, 1, outputs], dim=2)
        return grad_x, grad_w1, grad_b1[..., 0], grad_w2.transpose(1, 2), grad.sum(2), None


def _run_backward(x, w1, b1, w2, grad, activation: Activation) -> tuple[torch.Tensor, torch.Tensor]:
    """∂L/∂x, and ``[G, H, I + 1 + O]``: ∂L/∂W₁, ∂L/∂b₁, ∂L/∂W₂ of every unit; ``w2`` ``[G, H, O]``."""
    groups, inputs, points = x.shape
    hidden, outputs = w2.shape[1:]
    grad_x = torch.empty_like(x)
    chunks = -(-points // CHUNK)
    partials = np.zeros((groups, chunks, hidden, inputs + 1 + outputs), np.float32)
    if points:
        arrays = [t.numpy() for t in (x, w1, b1, w2, grad, grad_x)]
        markers = ((0,) * inputs, (0,) * outputs, (0,) * (inputs + 1 + outputs), _KIND[activation])
        counter = np.zeros(1, np.int64)
        run_parallel(lambda _: _backward(counter, *markers, *arrays, partials))
    return grad_x, torch.from_numpy(partials.sum(axis=1, dtype=np.float64).astype(np.float32))


@njit
def _activate(z, kind):
    """a(z) and a′(z)."""
    if len(kind) == 1:
        return maximum(z, 0.0), select(z > 0.0, splat(1.0), 0.0)
    # σ(z) from e = exp(−|z|) ≤ 1: 1/(1 + e) for z > 0, e/(1 + e) otherwise.
    e = exp_of_negative(-absolute(z))
    inverse = 1.0 / (1.0 + e)
    sigmoid = select(z > 0.0, inverse, e * inverse)
    if len(kind) == 2:
        return maximum(z, 0.0) + log1p_of_fraction(e), sigmoid
    value = z * sigmoid
    return value, fma(value, 1.0 - sigmoid, sigmoid)


@njit
def _forward_pair(inputs, outputs, kind, x, at, x_stride, w1, b1, w2, b2, y, to, y_stride):
    """Two vectors of points; ``w1`` … ``b2`` flat, of one network."""
    x0 = load_each(inputs, x, at, x_stride)
    x1 = load_each(inputs, x, at + LANES, x_stride)
    y0 = splat_each(outputs, b2, 0)
    y1 = y0
    for h in range(b1.size):
        weights = splat_each(inputs, w1, h * len(inputs))
        bias = splat(b1[h])
        a0, _ = _activate(dot_each(weights, x0, bias), kind)
        a1, _ = _activate(dot_each(weights, x1, bias), kind)
        out = splat_each(outputs, w2, h * len(outputs))
        y0, y1 = fma_each(a0, out, y0), fma_each(a1, out, y1)
    store_each(y0, y, to, y_stride)
    store_each(y1, y, to + LANES, y_stride)


@kernel
def _forward(counter, inputs, outputs, kind, x, w1, b1, w2, b2, y):
    """y of the chunks of points whose tickets are drawn from ``counter``."""
    groups, _, points = x.shape
    chunks = (points + CHUNK - 1) // CHUNK
    pair = 2 * LANES
    tail_x, tail_y = np.zeros(len(inputs) * pair, np.float32), np.zeros(len(outputs) * pair, np.float32)
    while True:
        ticket = take_ticket(counter)
        if ticket >= groups * chunks:
            break
        g, begin = ticket // chunks, ticket % chunks * CHUNK
        xg, yg = x[g].reshape(-1), y[g].reshape(-1)
        w1g, b1g, w2g, b2g = w1[g].reshape(-1), b1[g], w2[g].reshape(-1), b2[g]
        end = min(begin + CHUNK, points)
        left = (end - begin) % pair
        if left:
            for i in range(len(inputs)):
                tail_x[i * pair : i * pair + left] = x[g, i, end - left : end]
        # One call for both, as it is compiled into each: whole pairs, and the copy of what is left.
        for is_tail in range(2 if left else 1):
            source, target, stride, first, last = xg, yg, points, begin, end - left
            if is_tail:
                source, target, stride, first, last = tail_x, tail_y, pair, 0, pair
            for p in range(first, last, pair):
                _forward_pair(inputs, outputs, kind, source, p, stride, w1g, b1g, w2g, b2g, target, p, stride)
        if left:
            for o in range(len(outputs)):
                y[g, o, end - left : end] = tail_y[o * pair : o * pair + left]


@njit
def _backward_pair(inputs, outputs, kind, x, grad, at, stride, w1, b1, w2, sums, grad_x):
    """Two vectors of points: ``grad_x``, and their part of ``sums``: per unit ∂W₁ₕ, ∂b₁ₕ, ∂W₂ₕ, by lanes."""
    x0, x1 = load_each(inputs, x, at, stride), load_each(inputs, x, at + LANES, stride)
    g0, g1 = load_each(outputs, grad, at, stride), load_each(outputs, grad, at + LANES, stride)
    dx0, dx1 = zero_each(inputs), zero_each(inputs)
    unit_size = (len(inputs) + 1 + len(outputs)) * LANES
    for h in range(b1.size):
        weights = splat_each(inputs, w1, h * len(inputs))
        bias = splat(b1[h])
        a0, slope0 = _activate(dot_each(weights, x0, bias), kind)
        a1, slope1 = _activate(dot_each(weights, x1, bias), kind)
        out = splat_each(outputs, w2, h * len(outputs))
        d0, d1 = dot_each(out, g0, splat(0.0)) * slope0, dot_each(out, g1, splat(0.0)) * slope1
        dx0, dx1 = fma_each(d0, weights, dx0), fma_each(d1, weights, dx1)
        here = h * unit_size
        store_each(
            fma_each(d1, x1, fma_each(d0, x0, load_each(inputs, sums, here, LANES))), sums, here, LANES
        )
        here += len(inputs) * LANES
        store(load(sums, here) + (d0 + d1), sums, here)
        here += LANES
        store_each(
            fma_each(a1, g1, fma_each(a0, g0, load_each(outputs, sums, here, LANES))), sums, here, LANES
        )
    store_each(dx0, grad_x, at, stride)
    store_each(dx1, grad_x, at + LANES, stride)


@kernel
def _backward(counter, inputs, outputs, weights, kind, x, w1, b1, w2, grad, grad_x, partials):
    """``grad_x`` and ``partials[group, chunk, h]`` of the chunks whose tickets are drawn from ``counter``."""
    groups, _, points = x.shape
    chunks = (points + CHUNK - 1) // CHUNK
    hidden, pair = b1.shape[1], 2 * LANES
    sums = np.empty(hidden * len(weights) * LANES, np.float32)
    tail_x, tail_dx = np.zeros(len(inputs) * pair, np.float32), np.zeros(len(inputs) * pair, np.float32)
    tail_grad = np.zeros(len(outputs) * pair, np.float32)
    while True:
        ticket = take_ticket(counter)
        if ticket >= groups * chunks:
            break
        g, chunk = ticket // chunks, ticket % chunks
        xg, gg, dxg = x[g].reshape(-1), grad[g].reshape(-1), grad_x[g].reshape(-1)
        w1g, b1g, w2g = w1[g].reshape(-1), b1[g], w2[g].reshape(-1)
        begin, end = chunk * CHUNK, min(chunk * CHUNK + CHUNK, points)
        sums[:] = 0.0
        left = (end - begin) % pair
        if left:
            # Lanes without a point have no gradient and add nothing.
            tail_grad[:] = 0.0
            for i in range(len(inputs)):
                tail_x[i * pair : i * pair + left] = x[g, i, end - left : end]
            for o in range(len(outputs)):
                tail_grad[o * pair : o * pair + left] = grad[g, o, end - left : end]
        for is_tail in range(2 if left else 1):
            source, slope, target, stride, first, last = xg, gg, dxg, points, begin, end - left
            if is_tail:
                source, slope, target, stride, first, last = tail_x, tail_grad, tail_dx, pair, 0, pair
            for p in range(first, last, pair):
                _backward_pair(inputs, outputs, kind, source, slope, p, stride, w1g, b1g, w2g, sums, target)
        if left:
            for i in range(len(inputs)):
                grad_x[g, i, end - left : end] = tail_dx[i * pair : i * pair + left]
        for h in range(hidden):
            for k in range(len(weights)):
                partials[g, chunk, h, k] = total(load(sums, (h * len(weights) + k) * LANES))
