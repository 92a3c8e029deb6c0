# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's loss: L_rec and L_unit with its weights, and L_cons (eq. 16)."""

from dataclasses import dataclass
from typing import Literal

import torch

from ...backend.kernels.blur import gaussian_blur
from ...backend.kernels.ssim import PixelError
from ...backend.methods.losses import LossConfig
from ...bridge.errors import BadValueError


@dataclass(frozen=True, kw_only=True)
class PaperLossConfig(LossConfig):
    """Weights and forms of the loss as published; lab/paper.md has what the paper leaves open."""

    pixel: PixelError = "mse"
    pixel_weight: float = 0.2
    dssim_weight: float = 1.0
    unit_weight: float = 0.5
    #: λ2, the weight of L_cons (needs both branches).
    consistency_weight: float = 0.5
    #: Compare radiance, or ln(1 + radiance): the linear form drags the absolute scale (lab/notebook.md).
    consistency_domain: Literal["linear", "log"] = "linear"
    #: The branch that L_cons takes as it is, so that the other alone follows; none: both move.
    consistency_stop_gradient: Literal["none", "image-exposure", "illumination"] = "none"
    #: The blur 𝒢 of L_cons: width in pixels (odd) and σ.
    blur_size: int = 11
    blur_sigma: float = 3.0

    def __post_init__(self) -> None:
        if self.consistency_weight and self.blur_size % 2 == 0:
            raise BadValueError(f"the blur of L_cons must be an odd number of pixels, got {self.blur_size}")


def consistency_loss(exposed: torch.Tensor, relit: torch.Tensor, config: PaperLossConfig) -> torch.Tensor:
    """L_cons (eq. 16): mean |𝒢(I_HDR · t) − 𝒢(Î_HDR)|.

    Both branches receive a gradient, but for the one that ``consistency_stop_gradient`` names.
    """
    if config.consistency_stop_gradient == "image-exposure":
        exposed = exposed.detach()
    elif config.consistency_stop_gradient == "illumination":
        relit = relit.detach()
    pair = torch.cat([exposed, relit])
    if config.consistency_domain == "log":
        pair = pair.clamp_min(0.0).log1p()
    blurred = gaussian_blur(pair, config.blur_size, config.blur_sigma)
    blurred_exposed, blurred_relit = blurred.chunk(2)
    return (blurred_exposed - blurred_relit).abs().mean()
