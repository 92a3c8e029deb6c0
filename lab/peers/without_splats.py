# SPDX-License-Identifier: GPL-3.0-or-later
"""How a method that draws no splats answers when asked for them."""

from collections.abc import Sequence
from typing import NoReturn

import numpy as np
import torch
from torch import nn

from ...backend.methods.base import Method, MethodConfig, MethodSetup
from ...backend.model.backbone import Backbone, Splats, Start
from ...backend.rasterize import Rasterization
from ...backend.scene.camera import Camera
from ...bridge.errors import BadValueError


def refuse(method: str) -> NoReturn:
    """Raises ``BadValueError``: ``method`` has no splats."""
    raise BadValueError(
        f"{method} has no Gaussians",
        "Render pictures of it by physhdr render; the other methods can be exported and previewed.",
    )


class NoSplats(Backbone):
    """The backbone of nothing, of a ``method`` by that name."""

    def __init__(self, method: str) -> None:
        self.method = method
        self.parameters = {}
        self.networks = nn.ModuleDict()
        self._positions = torch.zeros(0, 3)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        return {}

    @property
    def positions(self) -> torch.Tensor:
        return self._positions

    def to_device(self, device: torch.device) -> None:
        self._positions = self._positions.to(device)

    def place(self, positions: np.ndarray, log_radiance: np.ndarray, start: Start) -> None:
        refuse(self.method)

    def splats(self, camera: Camera, sh_degree: int) -> Splats:
        refuse(self.method)

    def fixed(self, cameras: Sequence[Camera]) -> Backbone:
        refuse(self.method)


class WithoutSplats(Method):
    """A method that makes its pictures in another way, in ``hdr_at`` and ``ldr_at``."""

    def __init__(self, config: MethodConfig, setup: MethodSetup) -> None:
        super().__init__(config, NoSplats(config.name), setup)
        self._name = config.name

    @property
    def lights_apart(self) -> tuple[str, ...]:
        return ()

    def surface_splats(self, camera: Camera) -> None:
        return None

    def parts_beyond(
        self, camera: Camera, place: Sequence[float], near: float
    ) -> tuple[torch.Tensor, torch.Tensor, int]:
        """All of its radiance: it sees something in every direction."""
        picture = self.hdr(camera)
        return picture[None], torch.ones_like(picture[0]), 0

    def radiance_of(self, splats: Splats, levels: tuple[float, ...] | None) -> torch.Tensor:
        refuse(self._name)

    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        refuse(self._name)
