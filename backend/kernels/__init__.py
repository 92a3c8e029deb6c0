# SPDX-License-Identifier: GPL-3.0-or-later
"""The costly small parts of an iteration, fused: SSIM, blur, networks, spherical harmonics.

Each function is differentiable, has a plain-torch twin (``…_reference``: the oracle of the tests), and
goes to it by itself for tensors that are not float32 on the CPU, and inside ``plain_torch()``.
"""

from .blur import gaussian_blur, gaussian_blur_reference
from .local_curves import local_curves, local_curves_reference
from .mlp import Activation, curve_mlp, curve_mlp_reference, small_mlp, small_mlp_reference
from .plain import can_fuse, plain_torch
from .spherical_harmonics import evaluate_sh, evaluate_sh_reference
from .ssim import (
    PixelError,
    SsimTarget,
    ssim,
    ssim_and_error,
    ssim_map,
    ssim_map_reference,
    ssim_reference,
)

__all__ = [
    "Activation",
    "PixelError",
    "SsimTarget",
    "can_fuse",
    "curve_mlp",
    "curve_mlp_reference",
    "evaluate_sh",
    "evaluate_sh_reference",
    "gaussian_blur",
    "gaussian_blur_reference",
    "local_curves",
    "local_curves_reference",
    "plain_torch",
    "small_mlp",
    "small_mlp_reference",
    "ssim",
    "ssim_and_error",
    "ssim_map",
    "ssim_map_reference",
    "ssim_reference",
]
