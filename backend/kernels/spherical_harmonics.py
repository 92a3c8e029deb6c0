# SPDX-License-Identifier: GPL-3.0-or-later
"""View-dependent values from real spherical harmonics, degree 0 to 3, and their gradient.

value = Σ_b Y_b(d) k_b with d the direction from the viewpoint to the Gaussian; constants and signs as in
3DGS. Linear in the coefficients, so the backward pass is ∂L/∂k_b = Y_b(d) ∂L/∂value.

The direction is taken as constant, so that no gradient reaches the means through it, unless
``direction_gradient`` asks for that (3DGS's own program passes it). Of v = mean − viewpoint and d = v / |v|,

    ∂L/∂mean = (g − (g·d) d) / |v|,   g = Σ_b (k_b · ∂L/∂value) ∂Y_b/∂d
"""

from typing import Any

import numpy as np
import torch
from numba import njit

from ..simd import kernel, run_ranges
from .constants import Y0, Y1, Y2, Y3
from .plain import can_fuse, card_takes


def evaluate_sh(
    dc: torch.Tensor,
    rest: torch.Tensor,
    means: torch.Tensor,
    viewpoint: torch.Tensor,
    degree: int,
    direction_gradient: bool = False,
) -> torch.Tensor:
    """``dc`` ``[N, 3]`` (or ``[N, 1, 3]``), ``rest`` ``[N, ≥ (degree + 1)² − 1, 3]``, → ``[N, 3]``.

    ``means`` ``[N, 3]``, ``viewpoint`` ``[3]``: metres, in the world. Float32 is fused, on the CPU and by
    Warp; anything else goes to ``evaluate_sh_reference``. ``direction_gradient``: ``means`` receive a
    gradient.
    """
    dc = dc.reshape(-1, 3)
    if degree == 0:
        return Y0 * dc
    if card_takes(dc, rest) and len(dc):
        from .card.harmonics import evaluate_sh as on_card

        return on_card(dc, rest, means, viewpoint, degree, direction_gradient)
    if not can_fuse(dc):
        return evaluate_sh_reference(dc, rest, means, viewpoint, degree, direction_gradient)
    return _Evaluate.apply(dc, rest, means if direction_gradient else means.detach(), viewpoint, degree)


def evaluate_sh_reference(
    dc: torch.Tensor,
    rest: torch.Tensor,
    means: torch.Tensor,
    viewpoint: torch.Tensor,
    degree: int,
    direction_gradient: bool = False,
) -> torch.Tensor:
    """The same in plain torch, for any dtype and device."""
    means = means if direction_gradient else means.detach()
    x, y, z = torch.nn.functional.normalize(means - viewpoint, dim=1).unbind(1)
    basis = [-Y1 * y, Y1 * z, -Y1 * x]
    if degree > 1:
        basis += [Y2[0] * x * y, -Y2[0] * y * z, Y2[1] * (2 * z * z - x * x - y * y)]
        basis += [-Y2[0] * x * z, Y2[2] * (x * x - y * y)]
    if degree > 2:
        basis += [
            -Y3[0] * y * (3 * x * x - y * y),
            Y3[1] * x * y * z,
            -Y3[2] * y * (4 * z * z - x * x - y * y),
        ]
        basis += [Y3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y), -Y3[2] * x * (4 * z * z - x * x - y * y)]
        basis += [Y3[4] * z * (x * x - y * y), -Y3[0] * x * (x * x - 3 * y * y)]
    stacked = torch.stack(basis[: (degree + 1) ** 2 - 1], dim=1)
    return Y0 * dc.reshape(-1, 3) + torch.einsum("nk,nkc->nc", stacked, rest[:, : stacked.shape[1]])


class _Evaluate(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, dc, rest, means, viewpoint, degree: int) -> torch.Tensor:
        means, viewpoint = means.detach().contiguous().numpy(), viewpoint.detach().to(torch.float32).numpy()
        result = torch.empty(dc.shape)
        kept = (degree + 1) ** 2 - 1
        flat = rest.detach().contiguous().numpy()
        run_ranges(
            _evaluate,
            dc.shape[0],
            dc.detach().contiguous().numpy(),
            flat,
            means,
            viewpoint,
            kept,
            result.numpy(),
        )
        ctx.directions = (means, viewpoint, kept, rest.shape)
        # The coefficients are read again for the gradient of the direction alone.
        ctx.coefficients = flat if ctx.needs_input_grad[2] else np.empty((0, 0, 3), np.float32)
        return result

    @staticmethod
    def backward(ctx: Any, *grads: Any):
        (grad,) = grads
        means, viewpoint, kept, shape = ctx.directions
        _, rest_wanted, means_wanted, *_ = ctx.needs_input_grad
        grad_rest = torch.empty(shape if rest_wanted else (0, 0, 3))
        grad_means = torch.empty(shape[0] if means_wanted else 0, 3)
        if rest_wanted or means_wanted:
            arrays = grad.contiguous().numpy(), ctx.coefficients, means, viewpoint, kept
            run_ranges(_evaluate_backward, shape[0], *arrays, grad_rest.numpy(), grad_means.numpy())
        return (
            *(Y0 * grad, grad_rest if rest_wanted else None, grad_means if means_wanted else None),
            *(None, None),
        )


@njit(error_model="numpy")
def _basis(means, viewpoint, i, basis):
    """Y₁ … of the direction to Gaussian i (all fifteen: cheaper than to ask which are needed)."""
    x, y, z = means[i, 0] - viewpoint[0], means[i, 1] - viewpoint[1], means[i, 2] - viewpoint[2]
    scale = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-12))
    x, y, z = x * scale, y * scale, z * scale
    xx, yy, zz = x * x, y * y, z * z
    f = np.float32
    basis[0], basis[1], basis[2] = -f(Y1) * y, f(Y1) * z, -f(Y1) * x
    basis[3], basis[4], basis[5] = f(Y2[0]) * x * y, -f(Y2[0]) * y * z, f(Y2[1]) * (f(2) * zz - xx - yy)
    basis[6], basis[7] = -f(Y2[0]) * x * z, f(Y2[2]) * (xx - yy)
    basis[8], basis[9] = -f(Y3[0]) * y * (f(3) * xx - yy), f(Y3[1]) * x * y * z
    basis[10], basis[12] = -f(Y3[2]) * y * (f(4) * zz - xx - yy), -f(Y3[2]) * x * (f(4) * zz - xx - yy)
    basis[11] = f(Y3[3]) * z * (f(2) * zz - f(3) * xx - f(3) * yy)
    basis[13], basis[14] = f(Y3[4]) * z * (xx - yy), -f(Y3[0]) * x * (xx - f(3) * yy)


@njit(error_model="numpy")
def _direction_gradient(x, y, z, w):
    """Σ_b w_b ∂Y_b/∂(x, y, z) of the fifteen polynomials of ``_basis``, as if x, y and z were free."""
    f = np.float32
    xx, yy, zz = x * x, y * y, z * z
    a, b, c, d, e = f(Y3[0]), f(Y3[1]), f(Y3[2]), f(Y3[3]), f(Y3[4])
    p, q, r = f(Y2[0]), f(Y2[1]), f(Y2[2])
    gx = -f(Y1) * w[2] + p * (y * w[3] - z * w[6]) + f(2) * x * (r * w[7] - q * w[5])
    gy = -f(Y1) * w[0] + p * (x * w[3] - z * w[4]) - f(2) * y * (r * w[7] + q * w[5])
    gz = f(Y1) * w[1] - p * (y * w[4] + x * w[6]) + f(4) * q * z * w[5]
    gx += f(2) * x * (c * y * w[10] - f(3) * (a * y * w[8] + d * z * w[11]) + e * z * w[13])
    gx += b * y * z * w[9] - c * (f(4) * zz - f(3) * xx - yy) * w[12] - f(3) * a * (xx - yy) * w[14]
    gy += f(2) * y * (c * x * w[12] + f(3) * (a * x * w[14] - d * z * w[11]) - e * z * w[13])
    gy += b * x * z * w[9] - c * (f(4) * zz - xx - f(3) * yy) * w[10] - f(3) * a * (xx - yy) * w[8]
    gz += b * x * y * w[9] - f(8) * c * z * (y * w[10] + x * w[12])
    gz += f(3) * d * (f(2) * zz - xx - yy) * w[11] + e * (xx - yy) * w[13]
    return gx, gy, gz


@kernel
def _evaluate(first, last, dc, rest, means, viewpoint, kept, result):
    basis = np.empty(15, np.float32)
    for i in range(first, last):
        _basis(means, viewpoint, i, basis)
        r, g, b = np.float32(Y0) * dc[i, 0], np.float32(Y0) * dc[i, 1], np.float32(Y0) * dc[i, 2]
        for k in range(kept):
            r += basis[k] * rest[i, k, 0]
            g += basis[k] * rest[i, k, 1]
            b += basis[k] * rest[i, k, 2]
        result[i, 0], result[i, 1], result[i, 2] = r, g, b


@kernel
def _evaluate_backward(first, last, grad, rest, means, viewpoint, kept, grad_rest, grad_means):
    """Of ``grad_rest`` and ``grad_means`` those that have rows."""
    basis = np.empty(15, np.float32)
    if grad_rest.shape[0]:
        for i in range(first, last):
            _basis(means, viewpoint, i, basis)
            for k in range(kept):
                for c in range(3):
                    grad_rest[i, k, c] = basis[k] * grad[i, c]
            grad_rest[i, kept:] = 0.0
    if grad_means.shape[0]:
        weights = np.zeros(15, np.float32)
        for i in range(first, last):
            for k in range(kept):
                weights[k] = (
                    rest[i, k, 0] * grad[i, 0] + rest[i, k, 1] * grad[i, 1] + rest[i, k, 2] * grad[i, 2]
                )
            x, y, z = means[i, 0] - viewpoint[0], means[i, 1] - viewpoint[1], means[i, 2] - viewpoint[2]
            length = np.sqrt(x * x + y * y + z * z)
            # At the viewpoint there is no direction; nothing is drawn there.
            scale = np.float32(1.0) / length if length > np.float32(1e-12) else np.float32(0.0)
            x, y, z = x * scale, y * scale, z * scale
            gx, gy, gz = _direction_gradient(x, y, z, weights)
            along = gx * x + gy * y + gz * z
            grad_means[i, 0] = (gx - along * x) * scale
            grad_means[i, 1] = (gy - along * y) * scale
            grad_means[i, 2] = (gz - along * z) * scale
