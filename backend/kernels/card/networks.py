# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""Networks with one hidden layer, and their gradients, in Warp: the hidden layer never leaves the registers.

As tensor operations a response curve of 64 units writes and reads ``[3, 64, P]`` several times, 123 MB each
for a picture of 400×400. The mathematics stand in ``kernels.mlp``.

Backward, a block of 256 threads has 1024 points, four a thread. Of every hidden unit the block's sum over its
points goes to a row of its own; rows are added by torch, so the result is the same from run to run.
"""

from functools import cache
from typing import Any, Literal

import torch

from ...rasterize.warp.arrays import BLOCK, Array, launch, wp

# In kernels float(0.0) is a variable and 0.0 a constant, which no loop may change.
# ruff: noqa: UP018

Activation = Literal["relu", "softplus", "silu"]

_KIND = {"relu": 0, "softplus": 1, "silu": 2}
#: Points of a thread in the backward pass: a sum over the block costs what 60 points' share does.
POINTS = 4


def curve_mlp(x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
    """As ``kernels.curve_mlp``: float32, all on one device."""
    return _Networks.apply(x[:, None], w1[:, :, None], b1, w2[:, None, :], b2[:, None], activation)[:, 0]


def small_mlp(x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
    """As ``kernels.small_mlp``: float32, all on one device."""
    return _Networks.apply(x[None], w1[None], b1[None], w2[None], b2[None], activation)[0]


def local_curves(x, context, w1, b1, w2, b2) -> torch.Tensor:
    """As ``kernels.local_curves``: a network for every colour channel in every branch, whose inputs are an
    exposure and the context; torch adds up what the branches share."""
    channels, branches, points = x.shape
    inputs = torch.cat([x[:, :, None], context.expand(channels, branches, -1, -1)], dim=2)

    def of_branches(weights: torch.Tensor) -> torch.Tensor:
        return weights[:, None].expand(-1, branches, *weights.shape[1:]).flatten(0, 1)

    weights = [of_branches(w) for w in (w1, b1, w2[:, None], b2[:, None])]
    return _Networks.apply(inputs.flatten(0, 1), *weights, "relu").view(channels, branches, points)


class _Networks(torch.autograd.Function):
    """G networks side by side.

    x ``[G, I, P]``, w1 ``[G, H, I]``, b1 ``[G, H]``, w2 ``[G, O, H]``, b2 ``[G, O]`` → ``[G, O, P]``.
    """

    @staticmethod
    def forward(ctx: Any, x, w1, b1, w2, b2, activation: Activation) -> torch.Tensor:
        x, w1, b1, w2, b2 = (t.detach().contiguous() for t in (x, w1, b1, w2, b2))
        groups, inputs, points = x.shape
        outputs = w2.shape[1]
        y = x.new_empty(groups, outputs, points)
        forward, _ = _kernels(inputs, outputs, _KIND[activation])
        arguments = [Array(t, wp.float32) for t in (x, w1, b1, w2, b2, y)]
        launch(forward, (groups, points), arguments, x.device)
        ctx.activation = activation
        ctx.save_for_backward(x, w1, b1, w2)
        return y

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        x, w1, b1, w2 = ctx.saved_tensors
        grad = grads[0].contiguous()
        groups, inputs, points = x.shape
        outputs, units = w2.shape[1:]
        blocks = -(-points // (POINTS * BLOCK))
        grad_x = torch.empty_like(x)
        # A row for each unit of each block: δ x, δ, a ∂L/∂y.
        rows = x.new_zeros(groups * blocks * units, inputs + 1 + outputs)
        _, backward = _kernels(inputs, outputs, _KIND[ctx.activation])
        launch(
            backward,
            groups * blocks * BLOCK,
            [
                *(Array(t, wp.float32) for t in (x, w1, b1, w2, grad)),
                *(blocks, Array(grad_x, wp.float32), Array(rows, _row(inputs, outputs))),
            ],
            x.device,
        )
        sums = rows.view(groups, blocks, units, inputs + 1 + outputs).sum(1)
        grad_w1, grad_b1, grad_w2 = sums.split([inputs, 1, outputs], dim=2)
        return grad_x, grad_w1, grad_b1[..., 0], grad_w2.transpose(1, 2), grad.sum(2), None


@wp.func
def activated(z: float, kind: int):
    """The activation and its slope at ``z``."""
    if kind == 0:
        if z <= 0.0:
            return wp.vec2(0.0, 0.0)
        return wp.vec2(z, 1.0)  # NaN, too, as torch has it
    e = wp.exp(-wp.abs(z))
    sigmoid = 1.0 / (1.0 + e)
    if z < 0.0:
        sigmoid = e * sigmoid
    if kind == 1:
        return wp.vec2(wp.max(z, 0.0) + log1p_of(e), sigmoid)
    return wp.vec2(z * sigmoid, sigmoid * (1.0 + z * (1.0 - sigmoid)))


@wp.func
def log1p_of(e: float):
    """ln(1 + e) for e in [0, 1]: what the sum rounds away is divided back in."""
    whole = 1.0 + e
    if whole == 1.0:
        return e
    return wp.log(whole) * (e / (whole - 1.0))


def _row(inputs: int, outputs: int) -> Any:
    return wp.types.vector(inputs + 1 + outputs, wp.float32)


@cache
def _kernels(inputs: int, outputs: int, kind: int) -> tuple[Any, Any]:
    """Forward and backward for networks of that shape; the number of hidden units may be any."""
    X = wp.types.vector(inputs, wp.float32)
    Y = wp.types.vector(outputs, wp.float32)
    Xs = wp.types.matrix((POINTS, inputs), wp.float32)
    Ys = wp.types.matrix((POINTS, outputs), wp.float32)
    Row = _row(inputs, outputs)
    I, O, KIND, K = inputs, outputs, kind, POINTS  # noqa: E741 (the letters of the shapes above)
    SPAN = POINTS * BLOCK
    module = f"physhdr_networks_{inputs}_{outputs}_{kind}"

    @wp.kernel(enable_backward=False, module=module)
    def forward(
        x: wp.array3d[float],
        w1: wp.array3d[float],
        b1: wp.array2d[float],
        w2: wp.array3d[float],
        b2: wp.array2d[float],
        y: wp.array3d[float],
    ):
        g, p = wp.tid()
        point = X()
        for i in range(I):
            point[i] = x[g, i, p]
        result = Y()
        for o in range(O):
            result[o] = b2[g, o]
        for h in range(b1.shape[1]):
            z = b1[g, h]
            for i in range(I):
                z += w1[g, h, i] * point[i]
            a = activated(z, KIND)[0]
            for o in range(O):
                result[o] += w2[g, o, h] * a
        for o in range(O):
            y[g, o, p] = result[o]

    @wp.kernel(enable_backward=False, module=module, grid_stride=False)
    def backward(
        x: wp.array3d[float],
        w1: wp.array3d[float],
        b1: wp.array2d[float],
        w2: wp.array3d[float],
        grad_y: wp.array3d[float],
        blocks: int,
        grad_x: wp.array3d[float],
        rows: wp.array[Row],
    ):
        """Threads beyond the last point take part with zeros: sums over a block need all of them."""
        thread = wp.tid()
        block = thread // BLOCK
        g = block // blocks
        first = (block % blocks) * SPAN + thread % BLOCK
        points = x.shape[2]
        xs = Xs()
        gys = Ys()
        gxs = Xs()
        for k in range(K):
            p = first + k * BLOCK
            if p < points:
                for i in range(I):
                    xs[k, i] = x[g, i, p]
                for o in range(O):
                    gys[k, o] = grad_y[g, o, p]
        for h in range(b1.shape[1]):
            row = Row()
            for k in range(K):
                z = b1[g, h]
                for i in range(I):
                    z += w1[g, h, i] * xs[k, i]
                value = activated(z, KIND)
                delta = float(0.0)
                for o in range(O):
                    delta += w2[g, o, h] * gys[k, o]
                    row[I + 1 + o] += value[0] * gys[k, o]
                delta *= value[1]
                for i in range(I):
                    row[i] += delta * xs[k, i]
                    gxs[k, i] += delta * w1[g, h, i]
                row[I] += delta
            whole = wp.tile_sum(wp.tile(row, preserve_type=True))
            wp.tile_atomic_add(rows, whole, offset=block * b1.shape[1] + h)
        for k in range(K):
            p = first + k * BLOCK
            if p < points:
                for i in range(I):
                    grad_x[g, i, p] = gxs[k, i]

    return forward, backward
