# SPDX-License-Identifier: GPL-3.0-or-later
"""How primitives are added and removed while a method trains: one contract, one strategy a backbone."""

from typing import Protocol

import torch

from ...bridge.errors import PhysHDRError
from ..methods.base import Drawn
from ..scene.camera import Camera


class NoGaussiansLeftError(PhysHDRError):
    """Pruning would remove all there are."""


class Growth(Protocol):
    """A strategy with its statistics, bound to a method and its optimiser."""

    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        """Take in a view after the backward pass of ``iteration`` (counted from 0)."""
        ...

    def control(self, iteration: int) -> None:
        """Grow and prune if it is due after ``iteration`` iterations (counted from 1)."""
        ...

    def tensors(self) -> dict[str, torch.Tensor]:
        """The statistics, for a checkpoint."""
        ...

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        """Take back what ``tensors`` gave."""
        ...


class NoGrowth:
    """Of methods that have no primitives."""

    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        pass

    def control(self, iteration: int) -> None:
        pass

    def tensors(self) -> dict[str, torch.Tensor]:
        return {}

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        pass
