# SPDX-License-Identifier: GPL-3.0-or-later
# pyright: reportInvalidTypeForm=false
"""``kernels.evaluate_sh`` in Warp: a thread a Gaussian; one launch forward, one backward.

The basis, its order and the gradient of the direction are those of ``kernels.spherical_harmonics``.
"""

from typing import Any

import torch

from ...rasterize.warp.arrays import Array, launch, wp
from ..constants import Y0, Y1, Y2, Y3

#: Coefficients beside the constant one: degrees 1 to 3.
BANDS = 15
_P, _Q, _R = Y2
_A, _B, _C, _D, _E = Y3
_MODULE = "physhdr_harmonics"

Basis = wp.types.vector(BANDS, wp.float32)


def evaluate_sh(
    dc: torch.Tensor,
    rest: torch.Tensor,
    means: torch.Tensor,
    viewpoint: torch.Tensor,
    degree: int,
    direction_gradient: bool = False,
) -> torch.Tensor:
    """As ``kernels.evaluate_sh``, degree 1 to 3: float32, ``viewpoint`` ``[3]`` on the same device."""
    return _Evaluate.apply(
        dc.reshape(-1, 3), rest, means if direction_gradient else means.detach(), viewpoint, degree
    )


class _Evaluate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, dc, rest, means, viewpoint, degree: int) -> torch.Tensor:
        dc, rest, means, viewpoint = (t.detach().contiguous() for t in (dc, rest, means, viewpoint))
        kept = (degree + 1) ** 2 - 1
        values = torch.empty_like(dc)
        arguments = [
            *(Array(dc, wp.vec3), Array(rest, wp.vec3), Array(means, wp.vec3), Array(viewpoint, wp.float32)),
            *(kept, Array(values, wp.vec3)),
        ]
        launch(_evaluate, len(dc), arguments, dc.device)
        ctx.kept = kept
        ctx.save_for_backward(rest, means, viewpoint)
        return values

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        rest, means, viewpoint = ctx.saved_tensors
        grad = grads[0].contiguous()
        grad_rest, grad_means = torch.empty_like(rest), torch.empty_like(means)
        arguments = [
            *(
                Array(grad, wp.vec3),
                Array(rest, wp.vec3),
                Array(means, wp.vec3),
                Array(viewpoint, wp.float32),
            ),
            *(ctx.kept, int(ctx.needs_input_grad[2]), Array(grad_rest, wp.vec3), Array(grad_means, wp.vec3)),
        ]
        launch(_evaluate_backward, len(means), arguments, grad.device)
        wanted = zip((Y0 * grad, grad_rest, grad_means), ctx.needs_input_grad, strict=False)
        return *(gradient if needed else None for gradient, needed in wanted), None, None


@wp.func
def basis_at(d: wp.vec3):
    """Y₁ … Y₁₅ of a unit vector."""
    x = d[0]
    y = d[1]
    z = d[2]
    xx = x * x
    yy = y * y
    zz = z * z
    return Basis(
        -Y1 * y, Y1 * z, -Y1 * x,
        _P * x * y, -_P * y * z, _Q * (2.0 * zz - xx - yy), -_P * x * z, _R * (xx - yy),
        -_A * y * (3.0 * xx - yy), _B * x * y * z, -_C * y * (4.0 * zz - xx - yy),
        _D * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), -_C * x * (4.0 * zz - xx - yy),
        _E * z * (xx - yy), -_A * x * (xx - 3.0 * yy),
    )  # fmt: skip


@wp.func
def slope_of(d: wp.vec3, w: Basis):
    """Σ_b w_b ∂Y_b/∂(x, y, z), as if x, y and z were free."""
    x = d[0]
    y = d[1]
    z = d[2]
    xx = x * x
    yy = y * y
    zz = z * z
    gx = -Y1 * w[2] + _P * (y * w[3] - z * w[6]) + 2.0 * x * (_R * w[7] - _Q * w[5])
    gy = -Y1 * w[0] + _P * (x * w[3] - z * w[4]) - 2.0 * y * (_R * w[7] + _Q * w[5])
    gz = Y1 * w[1] - _P * (y * w[4] + x * w[6]) + 4.0 * _Q * z * w[5]
    gx += 2.0 * x * (_C * y * w[10] - 3.0 * (_A * y * w[8] + _D * z * w[11]) + _E * z * w[13])
    gx += _B * y * z * w[9] - _C * (4.0 * zz - 3.0 * xx - yy) * w[12] - 3.0 * _A * (xx - yy) * w[14]
    gy += 2.0 * y * (_C * x * w[12] + 3.0 * (_A * x * w[14] - _D * z * w[11]) - _E * z * w[13])
    gy += _B * x * z * w[9] - _C * (4.0 * zz - xx - 3.0 * yy) * w[10] - 3.0 * _A * (xx - yy) * w[8]
    gz += _B * x * y * w[9] - 8.0 * _C * z * (y * w[10] + x * w[12])
    gz += 3.0 * _D * (2.0 * zz - xx - yy) * w[11] + _E * (xx - yy) * w[13]
    return wp.vec3(gx, gy, gz)


@wp.kernel(enable_backward=False, module=_MODULE)
def _evaluate(
    dc: wp.array[wp.vec3],
    rest: wp.array2d[wp.vec3],
    means: wp.array[wp.vec3],
    viewpoint: wp.array[float],
    kept: int,
    values: wp.array[wp.vec3],
):
    g = wp.tid()
    away = means[g] - wp.vec3(viewpoint[0], viewpoint[1], viewpoint[2])
    basis = basis_at(away / wp.max(wp.length(away), 1e-12))
    value = Y0 * dc[g]
    for b in range(BANDS):
        if b < kept:
            value += basis[b] * rest[g, b]
    values[g] = value


@wp.kernel(enable_backward=False, module=_MODULE)
def _evaluate_backward(
    grad: wp.array[wp.vec3],
    rest: wp.array2d[wp.vec3],
    means: wp.array[wp.vec3],
    viewpoint: wp.array[float],
    kept: int,
    direction: int,
    grad_rest: wp.array2d[wp.vec3],
    grad_means: wp.array[wp.vec3],
):
    """``grad_means`` are written where ``direction`` is not 0."""
    g = wp.tid()
    away = means[g] - wp.vec3(viewpoint[0], viewpoint[1], viewpoint[2])
    length = wp.length(away)
    d = away / wp.max(length, 1e-12)
    basis = basis_at(d)
    for b in range(BANDS):
        if b < kept:
            grad_rest[g, b] = basis[b] * grad[g]
    for b in range(kept, rest.shape[1]):
        grad_rest[g, b] = wp.vec3()
    if direction != 0:
        weights = Basis()
        for b in range(BANDS):
            if b < kept:
                weights[b] = wp.dot(rest[g, b], grad[g])
        slope = slope_of(d, weights)
        # At the viewpoint there is no direction; nothing is drawn there.
        if length > 1e-12:
            grad_means[g] = (slope - wp.dot(slope, d) * d) / length
        else:
            grad_means[g] = wp.vec3()
