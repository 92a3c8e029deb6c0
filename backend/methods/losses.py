# SPDX-License-Identifier: GPL-3.0-or-later
"""The loss terms, each a function of images ``[3, H, W]``."""

from dataclasses import dataclass
from typing import Literal

import torch

from ...bridge.errors import BadValueError
from ..kernels.blur import gaussian_blur
from ..kernels.ssim import PixelError, SsimTarget, ssim_and_error


@dataclass(frozen=True, kw_only=True)
class LossConfig:
    """Weights and forms of the loss. The defaults are those of the preset ``default``; see docs/method.md."""

    #: Pixel term of L_rec: the paper states MSE (eq. 15); L1 is what 3DGS uses.
    pixel: PixelError = "l1"
    #: γ, the weight of the pixel term …
    pixel_weight: float = 0.7
    #: … and that of 1 − SSIM.
    dssim_weight: float = 0.3
    #: λ2, the weight of L_cons (needs both branches).
    consistency_weight: float = 0.0
    #: Compare radiance, or ln(1 + radiance): the linear form drags the absolute scale (lab/notebook.md).
    consistency_domain: Literal["linear", "log"] = "log"
    #: The branch that L_cons takes as it is, so that the other alone follows; none: both move.
    consistency_stop_gradient: Literal["none", "image-exposure", "illumination"] = "none"
    #: The blur 𝒢 of L_cons: width in pixels (odd) and σ.
    blur_size: int = 11
    blur_sigma: float = 3.0
    #: λ3, the weight of L_unit; used only where the data name an anchor.
    unit_weight: float = 0.0

    def __post_init__(self) -> None:
        if self.consistency_weight and self.blur_size % 2 == 0:
            raise BadValueError(f"the blur of L_cons must be an odd number of pixels, got {self.blur_size}")


def reconstruction_loss(
    prediction: torch.Tensor,
    target: torch.Tensor,
    config: LossConfig,
    ssim_target: SsimTarget | None = None,
) -> torch.Tensor:
    """One summand of L_rec (eq. 15): γ · pixel term + weight · (1 − SSIM).

    ``ssim_target``: what SSIM needs of ``target``, where several predictions are compared with it. Of masked
    pictures both are given as ``compared`` makes them.
    """
    return weighted(*ssim_and_error(prediction, ssim_target or target, config.pixel), config)


def weighted(similarity: torch.Tensor, pixel: torch.Tensor, config: LossConfig) -> torch.Tensor:
    """``reconstruction_loss`` of what SSIM and the pixel term have found, of any shape."""
    return config.pixel_weight * pixel + config.dssim_weight * (1.0 - similarity)


def compared(image: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
    """What a loss sees of an image ``[C, H, W]``, of which ``mask`` ``[H, W]`` is True where it is compared.

    Elsewhere prediction and target are both 0, as SSIM has it beyond a picture's edge: such a pixel has no
    error of its own, and its gradient is exactly 0. Every mean is still over all pixels, so that a compared
    pixel weighs the same in every view, and growth, which reads gradients, needs to know nothing of masks.
    """
    return image if mask is None else torch.where(mask, image, 0.0)


def consistency_loss(exposed: torch.Tensor, relit: torch.Tensor, config: LossConfig) -> torch.Tensor:
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
