# SPDX-License-Identifier: GPL-3.0-or-later
"""A neural radiance field in the logarithm (HDR-NeRF, Huang et al. 2022), and how rays see it.

The network of NeRF (Mildenhall et al. 2020, section 3 and appendix A): density from the position, colour from
the position and the direction of sight; the colour is ln radiance, without an activation.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import nn

from ...backend.bounds import FromZero, Size, SizeFromZero

#: The last sample of a ray reaches this far (NeRF): whatever has a density there is opaque.
BEYOND = 1e10
#: Added to the coarse weights, so that importance sampling visits everything (NeRF).
LEAST_WEIGHT = 1e-5


@dataclass(frozen=True, kw_only=True)
class FieldConfig:
    """The size of a field; the defaults are NeRF's and HDR-NeRF's."""

    #: Layers before the density, and their width.
    depth: Size = 8
    width: Size = 256
    #: The encoded position enters once more behind this layer (from 0); at depth − 1 or more: nowhere.
    skip: FromZero = 4
    #: Width of the layer that sees the direction.
    view_width: Size = 128
    #: Octaves of the encodings of position and direction.
    position_octaves: SizeFromZero = 10
    direction_octaves: SizeFromZero = 4
    #: First weights of the layers with a ReLU: torch's own for a linear layer, as in HDR-NeRF, which let a
    #: signal fade from layer to layer, or He's (2015), which do not: short trainings need that.
    first_weights: Literal["torch", "he"] = "torch"


def positional_encoding(x: torch.Tensor, octaves: int) -> torch.Tensor:
    """``[…, 3]`` → ``[…, 3 + 6 octaves]``: x, sin x, cos x, sin 2x, cos 2x, sin 4x … (NeRF, eq. 4).

    The raw input comes first; there is no factor π, as in the implementations that HDR-NeRF builds on.
    """
    if not octaves:
        return x
    factors = 2.0 ** torch.arange(octaves, dtype=x.dtype, device=x.device)
    angles = x[..., None, :] * factors[:, None]  # […, L, 3]
    waves = torch.stack([angles.sin(), angles.cos()], dim=-2)  # […, L, 2, 3]
    return torch.cat([x, waves.flatten(-3)], dim=-1)


class Field(nn.Module):
    """σ(x) before its ReLU, and ln e(x, d)."""

    def __init__(self, config: FieldConfig) -> None:
        super().__init__()
        self.config = config
        position, direction = 3 + 6 * config.position_octaves, 3 + 6 * config.direction_octaves
        widths = [
            position if i == 0 else config.width + (position if i == config.skip + 1 else 0)
            for i in range(config.depth)
        ]
        self.layers = nn.ModuleList(nn.Linear(width, config.width) for width in widths)
        self.density = nn.Linear(config.width, 1)
        self.feature = nn.Linear(config.width, config.width)
        self.view = nn.Linear(config.width + direction, config.view_width)
        self.log_radiance = nn.Linear(config.view_width, 3)
        if config.first_weights == "he":
            for weight, bias in ((each.weight, each.bias) for each in (*self.linear_layers, self.view)):
                nn.init.kaiming_uniform_(weight, nonlinearity="relu")
                nn.init.zeros_(bias)

    @property
    def linear_layers(self) -> list[nn.Linear]:
        """Those before the density."""
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]

    def trunk(self, points: torch.Tensor) -> torch.Tensor:
        """``[P, 3]`` → ``[P, width]``."""
        encoded = positional_encoding(points, self.config.position_octaves)
        hidden = encoded
        for i, layer in enumerate(self.layers):
            if i == self.config.skip + 1:
                hidden = torch.cat([encoded, hidden], dim=1)
            hidden = layer(hidden).relu_()
        return hidden

    def forward(self, points: torch.Tensor, views: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Density before its ReLU ``[R, S]`` and ln radiance ``[R, S, 3]``.

        ``points`` ``[R, S, 3]``, ``views`` ``[R, 3]``: one direction for all samples of a ray.
        """
        rays, samples = points.shape[:2]
        hidden = self.trunk(points.reshape(-1, 3))
        density = self.density(hidden)
        # Nothing bends between the feature and the next layer, so both are one matrix; what that layer makes
        # of the direction is the same for a whole ray. The same function, a fifth less work.
        by_feature, by_direction = self.view.weight.split(
            [self.config.width, self.view.in_features - self.config.width], dim=1
        )
        offset = torch.addmm(self.view.bias, self.feature.bias[None], by_feature.T)
        encoded = positional_encoding(views, self.config.direction_octaves)
        seen = (encoded @ by_direction.T + offset)[:, None]
        product = (hidden @ (by_feature @ self.feature.weight).T).view(rays, samples, -1)
        colours = self.log_radiance((product + seen).relu_())
        return density.view(rays, samples), colours

    def densities(self, points: torch.Tensor) -> torch.Tensor:
        """The density alone, before its ReLU: ``[R, S, 3]`` → ``[R, S]``."""
        return self.density(self.trunk(points.reshape(-1, 3))).view(points.shape[:2])


def stratified(rays: int, samples: int, jitter: torch.Tensor) -> torch.Tensor:
    """``[R, S]`` rising t in [0, 1] (NeRF, eq. 2); ``jitter`` ``[R or 1, S]`` in [0, 1), ½ without chance.

    NeRF jitters between the midpoints of ``samples`` even positions, ends included; so does this.
    """
    even = torch.linspace(0.0, 1.0, samples, dtype=jitter.dtype, device=jitter.device)
    between = 0.5 * (even[1:] + even[:-1])
    lower, upper = torch.cat([even[:1], between]), torch.cat([between, even[-1:]])
    return (lower + (upper - lower) * jitter).expand(rays, samples)


def ray_weights(density: torch.Tensor, t: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """How much each sample is seen, ``[R, S]``: w = T (1 − exp(−ReLU(σ) δ)), T = exp(−Σ before), NeRF eq. 3.

    ``density`` before its ReLU and ``t``, both ``[R, S]``; ``directions`` ``[R, 3]`` are as long as t from 0
    to 1 is in space.
    """
    steps = torch.cat([t[:, 1:] - t[:, :-1], torch.full_like(t[:, :1], BEYOND)], dim=1)
    depths = density.relu() * steps * directions.norm(dim=1, keepdim=True)  # optical
    before = depths[:, :-1].cumsum(dim=1)
    passing = torch.cat([torch.ones_like(t[:, :1]), (-before).exp()], dim=1)
    return passing * -torch.expm1(-depths)


def importance_samples(t: torch.Tensor, weights: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    """t where the weights are, ``[R, F]``: their inverse cumulative distribution at ``u`` ``[R or 1, F]``.

    Between the midpoints of ``t`` ``[R, S]`` the density is constant and as large as the weight of the sample
    between them; the first and the last sample have no bin (NeRF, section 5.2).
    """
    edges = 0.5 * (t[:, 1:] + t[:, :-1])  # [R, S − 1]
    mass = weights[:, 1:-1] + LEAST_WEIGHT
    cumulative = (mass / mass.sum(dim=1, keepdim=True)).cumsum(dim=1)
    cumulative = torch.cat([torch.zeros_like(cumulative[:, :1]), cumulative], dim=1)
    u = u.expand(t.shape[0], -1).contiguous()
    above = torch.searchsorted(cumulative, u, right=True).clamp(1, edges.shape[1] - 1)
    low, high = cumulative.gather(1, above - 1), cumulative.gather(1, above)
    share = ((u - low) / (high - low).clamp_min(1e-12)).clamp(0.0, 1.0)
    start, end = edges.gather(1, above - 1), edges.gather(1, above)
    return start + share * (end - start)
