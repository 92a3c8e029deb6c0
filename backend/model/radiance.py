# SPDX-License-Identifier: GPL-3.0-or-later
"""From reflectance and illumination to radiance: the composer g (eq. 8) and the modulator φ (eq. 10).

Both work on logarithms, where a product is a sum and every radiance is positive.
"""

from collections.abc import Sequence

import torch
from torch import nn

from ..kernels.activations import (
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
