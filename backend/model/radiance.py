# SPDX-License-Identifier: GPL-3.0-or-later
"""From reflectance and illumination to radiance: the composer g (eq. 8) and the modulator φ (eq. 10).

Both work on logarithms, where a product is a sum and every radiance is positive. A network's last layer
starts at zero, so that training starts from the physical product and learns only what it misses.
"""

from collections.abc import Sequence

import torch
from torch import nn

from ..kernels.activations import (
    DARKEST,
    LOG_RADIANCE_RANGE,
    modulated_illumination,
    radiance_of_logarithm,
)
from ..kernels.mlp import small_mlp


class SmallNetwork(nn.Module):
    """One hidden ReLU layer, ``[I, P]`` → ``[O, P]``, the last layer zero at the start."""

    def __init__(self, inputs: int, hidden: int, outputs: int) -> None:
        super().__init__()
        layer = nn.Linear(inputs, hidden)  # for torch's own initial values
        self.w1 = nn.Parameter(layer.weight.detach().clone())
        self.b1 = nn.Parameter(layer.bias.detach().clone())
        self.w2 = nn.Parameter(torch.zeros(outputs, hidden))
        self.b2 = nn.Parameter(torch.zeros(outputs))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return small_mlp(x, self.w1, self.b1, self.w2, self.b2, "relu")


class ProductComposer(nn.Module):
    """c = L_a · H_r: eq. 5 with the emission absorbed. No parameters; exactly linear in light.

    ``bounds``: of ln c.
    """

    def __init__(self, bounds: tuple[float, float] = LOG_RADIANCE_RANGE) -> None:
        super().__init__()
        self.bounds = bounds

    def forward(self, log_illumination: torch.Tensor, log_reflectance: torch.Tensor) -> torch.Tensor:
        """ln L_a ``[N, 1 or 3]``, ln H_r ``[N, 3]`` → radiance c ``[N, 3]``."""
        return radiance_of_logarithm(log_illumination + log_reflectance, self.bounds)


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


class AdditiveModulator(nn.Module):
    """L̂_a = L_a · (1 + Σ_k s_k (l_k − 1)): light transport is linear in each light, and k causes a share s_k.

    With one light L_a · (s·l + 1 − s). Where every level is 1 it is the identity; between and beyond trained
    levels it cannot misbehave.
    """

    def forward(
        self, log_illumination: torch.Tensor, lighting_levels: Sequence[float], light_share: torch.Tensor
    ) -> torch.Tensor:
        """ln L_a ``[N, 1 or 3]``, C levels l, s ``[N, C, 3]`` → ln L̂_a ``[N, 3]``."""
        return modulated_illumination(log_illumination, lighting_levels, light_share)


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
