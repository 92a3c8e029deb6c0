# SPDX-License-Identifier: GPL-3.0-or-later
"""Scaffold-GS's backbone: being written."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from ..scene.camera import Camera
from .backbone import Attributes, Backbone, Splats, Start


@dataclass(frozen=True, kw_only=True)
class AnchorsConfig:
    """Sizes of the backbone."""

    offsets: int = 10


class Anchors(Backbone):
    """Placeholder until the backbone is there."""

    def __init__(self, config: AnchorsConfig, attributes: Attributes) -> None:
        self.config, self.attributes = config, attributes
        self.parameters = {}
        self.networks = nn.ModuleDict()

    @property
    def positions(self) -> torch.Tensor:
        return self.parameters["anchors"]

    def place(self, positions: np.ndarray, log_radiance: np.ndarray, start: Start) -> None:
        raise NotImplementedError

    def splats(self, camera: Camera, sh_degree: int) -> Splats:
        raise NotImplementedError

    def fixed(self, cameras: Sequence[Camera]) -> Backbone:
        raise NotImplementedError
