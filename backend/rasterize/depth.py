# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a ray meets a Gaussian: at its greatest density along the ray.

With a Gaussian at m (in the camera) of covariance Σ, the density along the ray t d falls with
(t d − m)ᵀ Σ⁻¹ (t d − m), which is least at t = dᵀ Σ⁻¹ m / dᵀ Σ⁻¹ d. Of a flat Gaussian that is its plane, so
that a floor of large ones is flat, and no staircase of their centres.
"""

import torch

from ..scene.camera import Camera
from .reference import rotation_matrices

#: As many standard deviations along the axis a ray meets a Gaussian before or behind its centre, at most: a
#: pixel that only the low-pass filter reaches is beside it.
FARTHEST = 3.0
#: Σ⁻¹ of what is thinner than this share of its longest axis has too few digits in float64.
THINNEST = 1e-4


def depth_of(
    gaussian: torch.Tensor,
    means: torch.Tensor,
    quaternions: torch.Tensor,
    scales: torch.Tensor,
    camera: Camera,
) -> torch.Tensor:
    """``[H, W]``: the depth (metres along the axis) at which each pixel meets its ``gaussian`` ``[H, W]``.

    0 where that is −1. Other arguments as of ``rasterize``.
    """
    dtype = means.dtype
    y, x = torch.nonzero(gaussian >= 0, as_tuple=True)
    which = gaussian[y, x]
    view = camera.view_matrix(means.double())
    means, quaternions, scales = (each.double()[which] for each in (means, quaternions, scales))
    own = means @ view[:3, :3].T + view[:3, 3]
    ray = torch.stack([(x + 0.5 - camera.cx) / camera.fx, (y + 0.5 - camera.cy) / camera.fy], dim=1)
    ray = torch.cat([ray, torch.ones_like(ray[:, :1])], dim=1).to(own.dtype)
    axes = view[:3, :3] @ rotation_matrices(quaternions)
    scales = torch.maximum(scales, THINNEST * scales.amax(dim=1, keepdim=True))
    along = torch.einsum("nik,ni->nk", axes, ray) / scales
    centre = torch.einsum("nik,ni->nk", axes, own) / scales
    met = (along * centre).sum(dim=1) / along.square().sum(dim=1)
    reach = FARTHEST * (axes[:, 2] * scales).norm(dim=1)
    found = means.new_zeros(gaussian.shape)
    found[y, x] = torch.minimum(torch.maximum(met, own[:, 2] - reach), own[:, 2] + reach)
    return found.to(dtype)
