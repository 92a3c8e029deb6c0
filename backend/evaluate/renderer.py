# SPDX-License-Identifier: GPL-3.0-or-later
"""The interface that evaluation needs of a model."""

from collections.abc import Iterable, Sequence
from typing import Protocol

import torch

from ...bridge.lights import Levels
from ..scene.camera import Camera
from ..scene.scene import Scene
from .panorama import LitSplats


class Renderer(Protocol):
    """A model to evaluate, of any method. ``lights``: those it has levels for.

    A subclass must define ``lights``, ``hdr`` and ``ldr``; the rest has defaults.
    """

    lights: tuple[str, ...]

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks for every report."""
        return ()

    @property
    def can_relight(self) -> bool:
        """Whether a lighting level does more than scale."""
        return True

    @property
    def learns_response(self) -> bool:
        """Whether ``response_curve`` was learned: given ones are not checked."""
        return True

    def hdr(self, camera: Camera, lighting_level: Levels | None = None) -> torch.Tensor:
        """``[3, H, W]`` scene-linear radiance at ``lighting_level``: the first light's, or one per light.

        None: under the standard light.
        """
        ...

    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels | None = None) -> torch.Tensor:
        """``[3, H, W]`` in 0…1: the camera's picture at ``exposure`` seconds."""
        ...

    def ldr_bracket(
        self, camera: Camera, exposures: Sequence[float], lighting_level: Levels | None = None
    ) -> Iterable[torch.Tensor]:
        """``ldr`` at each exposure: all at once if that is cheaper, else one by one."""
        at = () if lighting_level is None else (lighting_level,)
        return (self.ldr(camera, exposure, *at) for exposure in exposures)

    def photographed(
        self,
        camera: Camera,
        exposures: Sequence[float],
        effects: Sequence[torch.Tensor],
        lighting_level: Levels | None = None,
    ) -> Iterable[torch.Tensor]:
        """``ldr_bracket`` with the light first multiplied by an effect each, ``[1 or 3, H, W]``.

        Only called for methods that learn such effects of a camera.
        """
        raise NotImplementedError

    def surface_splats(self, camera: Camera) -> LitSplats | None:
        """What it draws ``camera``'s picture from, whose surface is measured; None: not from splats."""
        return None

    def response_curve(self) -> tuple[torch.Tensor, torch.Tensor] | None:
        """ln(exposure × radiance) ``[M]`` and LDR ``[M, 3]``; None without a single global curve."""
        return None


def standard_of(renderer: Renderer, scene: Scene) -> tuple[float, ...]:
    """Levels of the renderer's lights in the scene's standard views: all at 1 where it has others."""
    return scene.standard_levels if renderer.lights == scene.lights else tuple(1.0 for _ in renderer.lights)
