# SPDX-License-Identifier: GPL-3.0-or-later
"""What evaluation wants of a model."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import torch

from ...bridge.lights import Levels
from ..scene.camera import Camera


class Renderer(Protocol):
    """What is evaluated: a trained model, whichever the method. ``lights``: those it has levels for.

    A subclass must have ``lights``, ``hdr`` and ``ldr``; what else there is may stay as it is here.
    """

    lights: tuple[str, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What every report must say of it."""
        return ()

    @property
    def can_relight(self) -> bool:
        """Whether a lighting level does more than scale."""
        return True

    @property
    def learns_response(self) -> bool:
        """Whether ``response_curve``, where it is known, was learned: given ones are not checked."""
        return True

    def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
        """``[3, H, W]`` scene-linear radiance at ``lighting_level``: the first light's, or one a light."""
        ...

    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels = 1.0) -> torch.Tensor:
        """``[3, H, W]`` in 0…1: the picture that the camera would take at ``exposure`` seconds."""
        ...

    def ldr_bracket(
        self, camera: Camera, exposures: Sequence[float], lighting_level: Levels = 1.0
    ) -> Iterable[torch.Tensor]:
        """What ``ldr`` gives at each exposure: all at once where that costs less, else one by one."""
        return (self.ldr(camera, exposure, lighting_level) for exposure in exposures)

    def photographed(
        self,
        camera: Camera,
        exposures: Sequence[float],
        effects: Sequence[torch.Tensor],
        lighting_level: Levels = 1.0,
    ) -> Iterable[torch.Tensor]:
        """``ldr_bracket`` where the light is multiplied by an effect each, ``[1 or 3, H, W]``, at first.

        Asked of methods alone that learn such effects of a camera.
        """
        raise NotImplementedError

    def response_curve(self) -> tuple[torch.Tensor, torch.Tensor] | None:
        """ln(exposure × radiance) ``[M]`` and LDR ``[M, 3]``; None where one global curve is not known."""
        return None
