# SPDX-License-Identifier: GPL-3.0-or-later
"""Growing and pruning of Scaffold-GS's anchors: being written."""

import torch

from ..methods.base import Drawn, SplattingMethod
from ..scene.camera import Camera
from .optimisers import Optimiser


class AnchorGrowth:
    """The strategy bound to one training (``growth.Growth``)."""

    def __init__(
        self, method: SplattingMethod, optimiser: Optimiser, iterations: int, seed: tuple[int, ...]
    ) -> None:
        raise NotImplementedError

    def observe(self, drawn: Drawn, camera: Camera, iteration: int) -> None:
        raise NotImplementedError

    def control(self, iteration: int) -> None:
        raise NotImplementedError

    def tensors(self) -> dict[str, torch.Tensor]:
        raise NotImplementedError

    def restore(self, tensors: dict[str, torch.Tensor]) -> None:
        raise NotImplementedError
