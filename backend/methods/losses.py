# SPDX-License-Identifier: GPL-3.0-or-later
"""The loss terms, each a function of images ``[3, H, W]``."""

from dataclasses import dataclass

import torch

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
    #: λ3, the weight of L_unit; used only where the data name an anchor.
    unit_weight: float = 0.0


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
