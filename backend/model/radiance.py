# SPDX-License-Identifier: GPL-3.0-or-later
"""From reflectance and illumination to radiance: the composer g (eq. 8) and the modulator φ (eq. 10).

Both work on logarithms, where a product is a sum and every radiance is positive. A network's last layer
starts at zero, so that training starts from the physical product and learns only what it misses.
"""

import torch
from torch import nn

from ..kernels.mlp import small_mlp
from .gaussians import LOG_RADIANCE_RANGE

#: The least that modulation leaves of an illumination.
DARKEST = 1e-6


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
    """c = L_a · H_r: eq. 5 with the emission absorbed. No parameters; exactly linear in light."""

    def forward(self, log_illumination: torch.Tensor, log_reflectance: torch.Tensor) -> torch.Tensor:
        """ln L_a ``[N, 1 or 3]``, ln H_r ``[N, 3]`` → radiance c ``[N, 3]``."""
        return (log_illumination + log_reflectance).clamp(*LOG_RADIANCE_RANGE).exp()


class LearnedComposer(nn.Module):
    """The paper's g: ln c = ln L_a + ln H_r + MLP(ln L_a, ln H_r)."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.network = SmallNetwork(4, hidden, 3)

    def forward(self, log_illumination: torch.Tensor, log_reflectance: torch.Tensor) -> torch.Tensor:
        """ln L_a ``[N, 1]``, ln H_r ``[N, 3]`` → radiance c ``[N, 3]``."""
        inputs = torch.cat([log_illumination, log_reflectance], dim=1)
        residual = self.network(inputs.T.contiguous()).T
        return (log_illumination + log_reflectance + residual).clamp(*LOG_RADIANCE_RANGE).exp()


class AdditiveModulator(nn.Module):
    """L̂_a = L_a · (s·l + 1 − s): light transport is linear in each light, and a share s is ambient.

    At l = 1 it is the identity; between and beyond trained levels it cannot misbehave.
    """

    def forward(
        self, log_illumination: torch.Tensor, lighting_level: float, ambient_share: torch.Tensor
    ) -> torch.Tensor:
        """ln L_a ``[N, 1]``, s ``[N, 3]`` → ln L̂_a ``[N, 3]``."""
        # At l = 0 and s = 1 nothing is left, and its logarithm would have no gradient.
        change = (ambient_share * (lighting_level - 1.0)).clamp_min(DARKEST - 1.0)
        return log_illumination + torch.log1p(change)


class LearnedModulator(nn.Module):
    """The paper's φ: ln L̂_a = ln L_a + ln l + MLP(ln L_a, ln l). Starts as a plain scaling by l."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.network = SmallNetwork(2, hidden, 1)

    def forward(
        self, log_illumination: torch.Tensor, lighting_level: float, ambient_share: torch.Tensor | None = None
    ) -> torch.Tensor:
        """ln L_a ``[N, 1]`` → ln L̂_a ``[N, 1]``."""
        # In float32 as the Gaussians are, but on the host: a copy to the card would make it wait.
        log_level = torch.tensor(lighting_level).log().item()
        inputs = torch.cat([log_illumination, torch.full_like(log_illumination, log_level)], dim=1)
        return log_illumination + log_level + self.network(inputs.T.contiguous()).T
