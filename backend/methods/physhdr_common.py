# SPDX-License-Identifier: GPL-3.0-or-later
"""What every form of PhysHDR-GS has: light that is a factor of its own, the response, the losses.

Each Gaussian has a reflectance H_r and an ambient illumination L_a. Composed they are its radiance
c = g(L_a, H_r); under another light ĉ = g(φ(L_a, l), H_r), relit to the level l. ``physhdr.py`` draws one of
the two (presets ``default`` and ``baseline``); the paper draws both (lab/peers/paper.py).
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, TypeVar

import torch
from torch import nn

from ...bridge.errors import BadValueError
from ..bounds import FromZero
from ..kernels.ahead import Needs
from ..kernels.plain import can_fuse
from ..kernels.ssim import SsimTarget
from ..model.backbone import Attributes, Backbone, Splats
from ..model.radiance import AdditiveModulator, ProductComposer
from ..model.tone_mapper import KnownResponse, Response, ToneMapper, ToneMapperConfig
from ..scene.camera import Camera
from ..shell import option
from .base import (
    Batch,
    Drawn,
    Exposed,
    Method,
    MethodConfig,
    MethodSetup,
    Outcome,
    Recording,
    Traits,
    mean_terms,
)
from .losses import LossConfig, compared, reconstruction_loss

#: What a form draws.
D = TypeVar("D", bound=Drawn)


@dataclass(frozen=True, kw_only=True)
class PhysHDRConfig(MethodConfig):
    """What the method is made of. The defaults are the preset ``default``; see docs/method.md for the why."""

    name: ClassVar[str] = "physhdr"

    #: Draw ĉ, which light turns. Without, c is drawn, and a lighting level only scales.
    illumination_branch: bool = True
    #: Highest degree of the spherical harmonics, 0 to 3.
    sh_degree: FromZero = 3
    tone_mapper: ToneMapperConfig = field(default_factory=ToneMapperConfig)
    loss: LossConfig = field(default_factory=LossConfig)

    def __post_init__(self) -> None:
        if not 0 <= self.sh_degree <= 3:
            raise BadValueError(f"{option('method.sh_degree')} must be from 0 to 3, got {self.sh_degree}")

    @property
    def traits(self) -> Traits:
        return Traits(light="view" if self.illumination_branch else "exposure", effects=True)

    @property
    def channels(self) -> int:
        """How many channels are drawn: a radiance, and the context of local curves."""
        return 3 + (self.tone_mapper.context_size if self.tone_mapper.local else 0)

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        if len(lights) > 1 and not self.has_light_share:
            raise BadValueError(
                f"{self.name}, with these settings, knows one light, the data have {', '.join(lights)}",
                "Train by the preset default, or without the lit views.",
            )
        return Attributes(
            sh_degree=self.sh_degree,
            context_size=self.tone_mapper.context_size if self.tone_mapper.local else 0,
            lights=len(lights) if self.has_light_share else 0,
        )

    @property
    def has_light_share(self) -> bool:
        """Whether each Gaussian learns which share of its radiance each light causes."""
        return self.illumination_branch

    def kernels_needed(self) -> Needs:
        return Needs(
            channels=tuple(sorted({3, self.channels})),  # three: the view that is shown
            activations=(self.tone_mapper.activation,),
            local_branches=(1,) if self.tone_mapper.local else (),
        )


@dataclass(frozen=True)
class Developed:
    """One drawn view as a camera records it.

    ``exposed``: what the response sees, I_HDR · t ``[3, H, W]`` (or Î · t where only the GI branch is drawn).
    ``relit``: Î_HDR, only with both branches. ``ldr``: the prediction. ``supervised``: every LDR image that
    L_rec compares with the picture. ``global_ldr``: the prediction by the global curves alone.
    """

    exposed: torch.Tensor
    relit: torch.Tensor | None
    ldr: torch.Tensor
    supervised: list[torch.Tensor]
    global_ldr: torch.Tensor


class PhysHDRMethod(Method, Generic[D]):
    """A backbone, g, φ and a response; subclasses say what is drawn (``D``) and how it is developed.

    ``setup.lights``: names of the lights that have levels; ``BadValueError`` where the settings know one.
    """

    def __init__(self, config: PhysHDRConfig, backbone: Backbone, setup: MethodSetup) -> None:
        super().__init__(config, backbone, setup)
        self.config = config
        self.composer, self.modulator = self.new_networks()
        self.tone_mapper = self.new_response(setup)

    def new_networks(self) -> tuple[nn.Module, nn.Module]:
        """The composer g and the modulator φ."""
        return ProductComposer(self.log_radiance_range), AdditiveModulator()

    def new_response(self, setup: MethodSetup) -> Response:
        """The response that is learned, or the known one where no picture's has to be."""
        if self.config.tone_mapper.local:
            setup.refuse_known("PhysHDR with local curves")
        known = setup.responses == "known"
        return KnownResponse() if known else ToneMapper(self.config.tone_mapper, setup.anchor)

    @property
    def can_relight(self) -> bool:
        return self.config.illumination_branch

    # -- radiance of the splats ------------------------------------------------------------------------

    def log_modulated_illumination(self, splats: Splats, levels: tuple[float, ...]) -> torch.Tensor:
        """ln L̂_a = ln φ(L_a, l) (eq. 10), ``[M, 1 or 3]``."""
        return self.modulator(splats.log_illumination, levels, splats.light_share)

    def radiance_of(self, splats: Splats, levels: tuple[float, ...] | None) -> torch.Tensor:
        """c (eq. 8), or ĉ when levels are given."""
        log_illumination = splats.log_illumination
        if levels is not None:
            log_illumination = self.log_modulated_illumination(splats, levels)
        return self.composer(log_illumination, splats.log_reflectance)

    # -- training --------------------------------------------------------------------------------------

    @abstractmethod
    def draw(self, camera: Camera, levels: tuple[float, ...], exposure: float, watch: bool = False) -> D:
        """Draw a view under ``levels``, all that is wanted of it in one pass. ``watch``: for growth.

        ``exposure`` (seconds) counts where it is the method's lighting level, and nowhere else.
        """

    @abstractmethod
    def develop_bracket(self, drawn: D, taken: Sequence[Exposed]) -> list[Developed]:
        """What each of some pictures records of a drawn view."""

    def develop(self, drawn: D, exposure: float) -> Developed:
        """What a camera with ``exposure`` (seconds) and the method's response records."""
        return self.develop_bracket(drawn, [Exposed(exposure=exposure)])[0]

    def photographed_at(
        self, camera: Camera, taken: Sequence[Exposed], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        if not self.can_relight:  # where a level only scales
            taken = [replace(each, exposure=each.exposure * levels[0]) for each in taken]
        taken = [
            replace(each, effect=None if each.effect is None else each.effect.to(self.device))
            for each in taken
        ]
        return [developed.ldr for developed in self.developed_at(camera, taken, levels)]

    def developed_at(
        self, camera: Camera, taken: Sequence[Exposed], levels: tuple[float, ...]
    ) -> list[Developed]:
        """What pictures of a view record under ``levels``; several only of ``Traits.brackets_at_once``."""
        return self.develop_bracket(self.draw(camera, levels, taken[0].exposure), taken)

    def training_outcome(self, batch: Batch) -> Outcome:
        drawn = self.draw(batch.camera, batch.levels, batch.recordings[0].exposure, watch=True)
        terms = self.bracket_terms(drawn, batch.recordings)
        if terms is None:
            developed = self.develop_bracket(drawn, batch.recordings)
            each = [
                self.losses(one, recording.picture, recording.mask)
                for one, recording in zip(developed, batch.recordings, strict=True)
            ]
            terms = mean_terms(each)
        return Outcome(terms | self.backbone_terms(drawn.splats), drawn)

    def bracket_terms(self, drawn: D, recordings: Sequence[Recording]) -> dict[str, torch.Tensor] | None:
        """The mean of the ``losses`` of all recordings at once; None where they must be taken one by one."""
        return None

    def losses(
        self, developed: Developed, picture: torch.Tensor, mask: torch.Tensor | None = None
    ) -> dict[str, torch.Tensor]:
        """The weighted terms of L_total (eq. 19) for a picture's values ``[3, H, W]``; sum them.

        ``mask``: which of its pixels are compared, ``[H, W]`` bool; None: all.
        """
        loss, target = self.config.loss, compared(picture, mask)
        ssim_target = SsimTarget(target) if can_fuse(target) else None
        images = [compared(image, mask) for image in developed.supervised]
        if ssim_target is None:  # in one pass: on a card each of its own would cost the host as much
            several = reconstruction_loss(torch.cat(images), torch.cat([target] * len(images)), loss)
            terms = {"rec": len(images) * several}
        else:
            each = [reconstruction_loss(image, target, loss, ssim_target) for image in images]
            terms = {"rec": torch.stack(each).sum()}
        return terms | self.further_terms(developed, target, mask, ssim_target) | self.unit_term()

    def further_terms(
        self,
        developed: Developed,
        target: torch.Tensor,
        mask: torch.Tensor | None,
        ssim_target: SsimTarget | None,
    ) -> dict[str, torch.Tensor]:
        """Weighted terms beside L_rec and L_unit; ``target`` and ``ssim_target``: of the compared pixels."""
        return {}

    def unit_term(self) -> dict[str, torch.Tensor]:
        """L_unit, weighted, where the loss has it."""
        weight, response = self.config.loss.unit_weight, self.tone_mapper
        if not (weight and isinstance(response, ToneMapper) and response.anchor):
            return {}
        return {"unit": weight * response.unit_exposure_error()}
