# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""``kernels.ssim_map`` in Warp: two passes over the picture forward, two backward.

As tensor operations SSIM is some sixty launches over five blurred pictures each way. The mathematics stand in
``kernels.ssim``: the window, C₁ and C₂, zeros beyond the border, and p, q, r of the backward pass.
"""

from functools import cache
from typing import Any

import torch

from ...rasterize.warp.arrays import Array, launch, wp
from ..constants import SSIM_C1 as C1
from ..constants import SSIM_C2 as C2
from ..constants import SSIM_TAPS as TAPS
from ..constants import ssim_window

_R = TAPS // 2
_MODULE = "physhdr_similarity"

Five = wp.types.vector(5, wp.float32)


def ssim_map(prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """S of every pixel ``[C, H, W]``, float32; differentiable in ``prediction`` alone."""
    return _Similarity.apply(prediction, target.detach())


@cache
def _window_on(device: torch.device) -> torch.Tensor:
    """Kept, because a copy to a card makes the host wait for the card."""
    return torch.from_numpy(ssim_window()).to(device, torch.float32)


class _Similarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, prediction: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        x, y = prediction.detach().contiguous(), target.contiguous()
        window = _window_on(x.device)
        along = x.new_empty(*x.shape, 5)
        arguments = [Array(t, wp.float32) for t in (x, y, window)]
        launch(_along_rows, x.shape, [*arguments, Array(along, Five)], x.device)
        similarity, slopes = torch.empty_like(x), x.new_empty(*x.shape, 3)
        launch(
            _down_columns,
            x.shape,
            [
                *(Array(along, Five), Array(window, wp.float32)),
                *(Array(similarity, wp.float32), Array(slopes, wp.vec3)),
            ],
            x.device,
        )
        ctx.save_for_backward(x, y, slopes)
        return similarity

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        x, y, slopes = ctx.saved_tensors
        window = Array(_window_on(x.device), wp.float32)
        along, grad_x = torch.empty_like(slopes), torch.empty_like(x)
        arguments = [Array(slopes, wp.vec3), Array(grads[0].contiguous(), wp.float32), window]
        launch(_along_rows_backward, x.shape, [*arguments, Array(along, wp.vec3)], x.device)
        arguments = [Array(along, wp.vec3), Array(x, wp.float32), Array(y, wp.float32), window]
        launch(_down_columns_backward, x.shape, [*arguments, Array(grad_x, wp.float32)], x.device)
        return grad_x, None


@wp.kernel(enable_backward=False, module=_MODULE)
def _along_rows(x: wp.array3d[float], y: wp.array3d[float], window: wp.array[float], along: wp.array3d[Five]):
    """x, y, x², y² and xy, blurred along the rows."""
    c, i, j = wp.tid()
    total = Five()
    for k in range(TAPS):
        at = j + k - _R
        if at >= 0 and at < x.shape[2]:
            a = x[c, i, at]
            b = y[c, i, at]
            total += window[k] * Five(a, b, a * a, b * b, a * b)
    along[c, i, j] = total


@wp.kernel(enable_backward=False, module=_MODULE)
def _down_columns(
    along: wp.array3d[Five],
    window: wp.array[float],
    similarity: wp.array3d[float],
    slopes: wp.array3d[wp.vec3],
):
    """S, and its slopes p, q and r in 𝒢x, 𝒢x² and 𝒢xy."""
    c, i, j = wp.tid()
    m = Five()
    for k in range(TAPS):
        at = i + k - _R
        if at >= 0 and at < along.shape[1]:
            m += window[k] * along[c, at, j]
    a1 = 2.0 * m[0] * m[1] + C1
    a2 = 2.0 * (m[4] - m[0] * m[1]) + C2
    b1 = m[0] * m[0] + m[1] * m[1] + C1
    b2 = m[2] - m[0] * m[0] + m[3] - m[1] * m[1] + C2
    inverse = 1.0 / (b1 * b2)
    s = a1 * a2 * inverse
    similarity[c, i, j] = s
    p = 2.0 * m[1] * (a2 - a1) * inverse - 2.0 * m[0] * s * (1.0 / b1 - 1.0 / b2)
    slopes[c, i, j] = wp.vec3(p, -s / b2, 2.0 * a1 * inverse)


@wp.kernel(enable_backward=False, module=_MODULE)
def _along_rows_backward(
    slopes: wp.array3d[wp.vec3],
    grad: wp.array3d[float],
    window: wp.array[float],
    along: wp.array3d[wp.vec3],
):
    """The slopes times ∂L/∂S, blurred along the rows."""
    c, i, j = wp.tid()
    total = wp.vec3()
    for k in range(TAPS):
        at = j + k - _R
        if at >= 0 and at < grad.shape[2]:
            total += window[k] * grad[c, i, at] * slopes[c, i, at]
    along[c, i, j] = total


@wp.kernel(enable_backward=False, module=_MODULE)
def _down_columns_backward(
    along: wp.array3d[wp.vec3],
    x: wp.array3d[float],
    y: wp.array3d[float],
    window: wp.array[float],
    grad_x: wp.array3d[float],
):
    """∂L/∂x = 𝒢p + 2x 𝒢q + y 𝒢r."""
    c, i, j = wp.tid()
    total = wp.vec3()
    for k in range(TAPS):
        at = i + k - _R
        if at >= 0 and at < along.shape[1]:
            total += window[k] * along[c, at, j]
    grad_x[c, i, j] = total[0] + 2.0 * x[c, i, j] * total[1] + y[c, i, j] * total[2]
