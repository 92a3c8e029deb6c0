# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's networks: g (eq. 8), φ (eq. 10) and f_mix (eq. 12, 13).

g and φ work on logarithms, where a product is a sum and every radiance is positive. A network's last layer
starts at zero, so that training starts from the physical product and learns only what it misses.
"""

from dataclasses import dataclass

import torch
from torch import nn

from ...backend.bounds import FromZero
from ...backend.kernels.activations import DARKEST, LOG_RADIANCE_RANGE, radiance_of_logarithm
from ...backend.kernels.pointwise import blend
from ...backend.model.radiance import SmallNetwork
from ...backend.model.tone_mapper import ToneMapper, ToneMapperConfig

#: Inputs and outputs of the networks at one L_a a Gaussian.
COMPOSER, MODULATOR, FUSION = (4, 3), (2, 1), (6, 3)


class LearnedComposer(nn.Module):
    """The paper's g: ln c = ln L_a + ln H_r + MLP(ln L_a, ln H_r).

    ``channels``: of L_a; ``bounds``: of ln c.
    """

    def __init__(
        self, hidden: int, channels: int = 1, bounds: tuple[float, float] = LOG_RADIANCE_RANGE
    ) -> None:
        super().__init__()
        self.bounds = bounds
        self.network = SmallNetwork(channels + 3, hidden, 3)

    def forward(self, log_illumination: torch.Tensor, log_reflectance: torch.Tensor) -> torch.Tensor:
        """ln L_a ``[N, channels]``, ln H_r ``[N, 3]`` → radiance c ``[N, 3]``."""
        inputs = torch.cat([log_illumination, log_reflectance], dim=1)
        residual = self.network(inputs.T.contiguous()).T
        return radiance_of_logarithm(log_illumination + log_reflectance + residual, self.bounds)


class LearnedModulator(nn.Module):
    """The paper's φ: ln L̂_a = ln L_a + ln l + MLP(ln L_a, ln l). Starts as a plain scaling by l.

    ``channels``: of L_a, which the network sees together.
    """

    def __init__(self, hidden: int, channels: int = 1) -> None:
        super().__init__()
        self.network = SmallNetwork(channels + 1, hidden, channels)

    def forward(self, log_illumination: torch.Tensor, lighting_level: float) -> torch.Tensor:
        """ln L_a → ln L̂_a, both ``[N, channels]``; a level of 0 is taken as ``DARKEST``."""
        # In float32 as the Gaussians are, but on the host: a copy to the card would make it wait.
        log_level = torch.tensor(max(lighting_level, DARKEST)).log().item()
        levels = torch.full_like(log_illumination[:, :1], log_level)
        inputs = torch.cat([log_illumination, levels], dim=1)
        return log_illumination + log_level + self.network(inputs.T.contiguous()).T


@dataclass(frozen=True, kw_only=True)
class PaperToneMapperConfig(ToneMapperConfig):
    """f_tm and f_mix as published."""

    anchored: bool = False
    initial_slope: float | None = None
    local: bool = True
    #: Fuse the branches by f_mix (needs local curves and both branches), else by a plain mean.
    mix: bool = True
    warm_start_steps: FromZero = 1000


class FusingToneMapper(ToneMapper):
    """f = (f_tm, f_mix)."""

    def __init__(self, config: PaperToneMapperConfig, anchor: tuple[float, float] | None) -> None:
        super().__init__(config, anchor)
        if config.mix:
            self.fusion = SmallNetwork(6, config.hidden, 3)

    def mix(self, glo: torch.Tensor, loc: torch.Tensor) -> torch.Tensor:
        """f_mix: fuse global and local LDR images ``[3, …, H, W]`` by a learned weight in [0, 1]."""
        pair = torch.cat([glo, loc]).reshape(6, -1)
        return blend(glo, loc, self.fusion(pair).reshape(glo.shape))
