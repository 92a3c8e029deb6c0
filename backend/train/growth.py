# SPDX-License-Identifier: GPL-3.0-or-later
"""How primitives are added and removed while a method trains: one contract, one strategy a backbone."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

import torch

from ...bridge.errors import PhysHDRError
from ..methods.base import Drawn
from ..model.backbone import BackboneConfig
from ..scene.camera import Camera
from ..scene.resident import camera_tensors


class NoGaussiansLeftError(PhysHDRError):
    """Pruning would remove all there are."""


class Growth(ABC):
    """A strategy with its statistics, bound to a method and its optimiser (``growing.py`` calls it)."""

    @abstractmethod
    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        """Take in a view after the backward pass of ``iteration`` (counted from 0)."""

    @abstractmethod
    def control(self, iteration: int) -> None:
        """Grow and prune if it is due after ``iteration`` iterations (counted from 1)."""

    @abstractmethod
    def tensors(self) -> dict[str, torch.Tensor]:
        """Everything that resuming needs, by name."""

    @abstractmethod
    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Take back what ``tensors`` gave."""


def gradient_scaling(deviation: torch.Tensor, strength: float) -> torch.Tensor:
    """s_a = s · σ(|L_a − L̂_a|) + 1 (eq. 17), ``[M]``."""
    return strength * deviation.sigmoid() + 1.0


def gradient_norm(
    screen_gradient: torch.Tensor, drawn: Drawn, camera: Camera, config: BackboneConfig
) -> torch.Tensor:
    """Of one view's screen gradient ``[M, 2]`` (per pixel): its norm in NDC times s_a, ``[M]``."""
    to_ndc = camera_tensors(camera, screen_gradient).half_size
    norm = torch.linalg.vector_norm(screen_gradient * to_ndc, dim=1)
    if config.scaling_strength and drawn.illumination_deviation is not None:
        norm = norm * gradient_scaling(drawn.illumination_deviation, config.scaling_strength)
    return norm
