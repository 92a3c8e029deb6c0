# SPDX-License-Identifier: GPL-3.0-or-later
"""What both forms of PhysHDR-GS have: light that is a factor of its own, the response, the losses.

Each Gaussian has a reflectance H_r and an ambient illumination L_a. Composed they are its radiance
c = g(L_a, H_r); under another light ĉ = g(φ(L_a, l), H_r), relit to the level l. ``physhdr.py`` draws one of
the two (presets ``default`` and ``baseline``), ``physhdr_paper.py`` both, and fuses what a tone mapper makes
of them (``paper``).
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Generic, Literal, TypeVar

import torch

from ...bridge.errors import BadValueError
from ..kernels.activations import illumination_deviation as deviation_of
from ..kernels.ahead import COMPOSER, FUSION, MODULATOR, Needs
from ..kernels.plain import can_fuse
from ..kernels.ssim import SsimTarget
from ..model.backbone import Attributes, Backbone, Splats
from ..model.radiance import AdditiveModulator, LearnedComposer, LearnedModulator, ProductComposer
from ..model.tone_mapper import KnownResponse, ToneMapper, ToneMapperConfig
from ..scene.camera import Camera
from .base import (
    Batch,
    Drawn,
    Exposed,
    Facts,
    Method,
    MethodConfig,
    Outcome,
    Recording,
    Traits,
    mean_terms,
)
from .losses import LossConfig, compared, consistency_loss, reconstruction_loss

#: What a form draws.
D = TypeVar("D", bound=Drawn)


@dataclass(frozen=True, kw_only=True)
class PhysHDRConfig(MethodConfig):
    """What the method is made of. The defaults are the preset ``default``; see docs/method.md for the why."""

    name: ClassVar[str] = "physhdr"

    #: Which branches are rendered. One branch costs three channels, both cost six (and the context).
    branches: Literal["both", "image-exposure", "illumination"] = "illumination"
    #: l: the exposure of the picture (the paper) or the lighting level that the data give for the view.
    lighting_level: Literal["exposure", "view"] = "view"
    #: g: the physical product L_a · H_r, or the product times what a network learns (the paper).
    composer: Literal["product", "learned"] = "product"
    #: φ: additive (each light has a share of each Gaussian's), or a network (the paper).
    modulator: Literal["additive", "learned"] = "additive"
    composer_hidden: int = 64
    #: L_a: one number a Gaussian, or one a colour channel.
    illumination_channels: Literal[1, 3] = 1
    sh_degree: int = 3
    #: Positions learn from how H_r changes with the viewing direction, as in 3DGS's own program.
    direction_gradient: bool = False
    #: Of |L_a − L̂_a|, by which growth is scaled (a mean over the channels): as it stands, or of logarithms,
    #: which no factor common to all L_a changes.
    deviation_domain: Literal["linear", "log"] = "linear"
    #: Whose gradient to the screen positions growth reads: of all that is drawn, or of I_HDR alone, which is
    #: then a pass of its own in training (needs both branches).
    growth_gradient: Literal["all", "image-exposure"] = "all"
    #: f_mix stays at its start (a plain mean) for this share of the training (the paper: 10 k of 30 k).
    mix_frozen_until: float = 1.0 / 3.0
    #: I_LDR: the mean of the two fused images, or their sum as eq. 14 has it (which cannot fit; paper.md).
    aggregate: Literal["mean", "sum"] = "mean"
    #: I_GI: f_mix(Î_glo, I_loc), crosswise as its name has it, or f_mix(I_glo, I_loc), as eq. 13 is printed.
    illumination_fusion: Literal["crosswise", "literal"] = "crosswise"
    #: Add the global image to L_rec, so that L_unit binds the curve that is in use.
    global_supervision: float = 0.0
    tone_mapper: ToneMapperConfig = field(default_factory=ToneMapperConfig)
    loss: LossConfig = field(default_factory=LossConfig)

    def __post_init__(self) -> None:
        if self.tone_mapper.mix and not (self.tone_mapper.local and self.branches == "both"):
            raise BadValueError(
                "f_mix fuses global and local images of both branches",
                "Set --method.branches both and --method.tone-mapper.local, or leave mix off.",
            )
        if self.branches == "image-exposure" and self.lighting_level == "view":
            raise BadValueError(
                "the image-exposure branch alone has no lighting level",
                "Set --method.lighting-level exposure, or --method.branches both or illumination.",
            )
        if self.branches == "illumination" and self.lighting_level == "exposure":
            raise BadValueError(
                "the illumination branch alone has no radiance that is the same at every exposure",
                "Set --method.lighting-level view, or --method.branches both.",
            )
        if not 0 <= self.sh_degree <= 3:
            raise BadValueError(f"the SH degree must be 0 to 3, got {self.sh_degree}")

        if self.growth_gradient == "image-exposure" and self.branches != "both":
            raise BadValueError(
                "one branch alone is drawn, and its gradient is all that growth can read",
                "Leave out --method.growth-gradient, or set --method.branches both.",
            )
        # Its g reads one ln L̂_a a Gaussian; and where it reads three, no exported file could keep what g
        # makes of each light's share.
        if self.composer == "learned" and self.has_light_share:
            raise BadValueError(
                "the learned composer cannot follow the additive modulator, which lights each colour channel "
                "by itself",
                "Set --method.modulator learned, or --method.composer product.",
            )

    @property
    def traits(self) -> Traits:
        draws_anew = self.lighting_level == "exposure" and self.can_relight
        return Traits(light=self.lighting_level, brackets_at_once=not draws_anew, effects=True)

    @property
    def can_relight(self) -> bool:
        """Whether there is an illumination branch; without one a lighting level only scales."""
        return self.branches != "image-exposure"

    @property
    def channels(self) -> int:
        """How many channels are drawn, all in one pass where ``growth_gradient`` does not say otherwise."""
        context = self.tone_mapper.context_size if self.tone_mapper.local else 0
        return (6 if self.branches == "both" else 3) + context

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        if len(lights) > 1 and not self.has_light_share:
            raise BadValueError(
                f"the {self.modulator} modulator knows one light, the data have {', '.join(lights)}",
                "Set --method.modulator additive, or train without the lit views.",
            )
        return Attributes(
            sh_degree=self.sh_degree,
            context_size=self.tone_mapper.context_size if self.tone_mapper.local else 0,
            lights=len(lights) if self.has_light_share else 0,
            illumination_channels=self.illumination_channels,
            direction_gradient=self.direction_gradient,
        )

    @property
    def has_light_share(self) -> bool:
        """Whether each Gaussian learns which share of its radiance each light causes."""
        return self.modulator == "additive" and self.can_relight

    def kernels_needed(self) -> Needs:
        more = self.illumination_channels - 1  # of L_a, than the one that these are named for
        wanted = [
            ((COMPOSER[0] + more, COMPOSER[1]), self.composer == "learned"),
            ((MODULATOR[0] + more, MODULATOR[1] + more), self.modulator == "learned" and self.can_relight),
            (FUSION, self.tone_mapper.mix),
        ]
        drawn = {3, self.channels}  # three: the view that is shown
        if self.growth_gradient == "image-exposure":
            drawn.add(self.channels - 3)
        return Needs(
            channels=tuple(sorted(drawn)),
            networks=tuple(shape for shape, is_wanted in wanted if is_wanted),
            activations=(self.tone_mapper.activation,),
            local_branches=(2 if self.branches == "both" else 1,) if self.tone_mapper.local else (),
            blur=self.branches == "both" and self.loss.consistency_weight > 0,
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
    """A backbone and three networks; subclasses say what is drawn (``D``) and how it is developed.

    ``facts.lights``: names of the lights that have levels. Only the additive modulator knows more than one:
    else ``BadValueError``.
    """

    def __init__(self, config: PhysHDRConfig, backbone: Backbone, facts: Facts) -> None:
        super().__init__(config, backbone, facts)
        self.config = config
        sizes = config.composer_hidden, config.illumination_channels
        bounds = facts.log_radiance_range
        self.composer = (
            ProductComposer(bounds) if config.composer == "product" else LearnedComposer(*sizes, bounds)
        )
        self.modulator = AdditiveModulator() if config.modulator == "additive" else LearnedModulator(*sizes)
        if config.branches == "both" or config.tone_mapper.local:
            facts.refuse_known("PhysHDR with both branches or local curves")
        known = facts.responses == "known"
        self.tone_mapper = KnownResponse() if known else ToneMapper(config.tone_mapper, facts.anchor)

    @property
    def can_relight(self) -> bool:
        return self.config.can_relight

    @property
    def composes_by_product(self) -> bool:
        return self.config.composer == "product"

    def network_groups(self) -> dict[str, list[torch.Tensor]]:
        radiance: list[torch.Tensor] = [*self.composer.parameters(), *self.modulator.parameters()]
        return {"radiance_networks": radiance} | super().network_groups()

    # -- radiance of the splats ------------------------------------------------------------------------

    def log_modulated_illumination(self, splats: Splats, levels: tuple[float, ...]) -> torch.Tensor:
        """ln L̂_a = ln φ(L_a, l) (eq. 10), ``[M, 1 or 3]``."""
        if isinstance(self.modulator, AdditiveModulator):
            assert splats.light_share is not None
            return self.modulator(splats.log_illumination, levels, splats.light_share)
        return self.modulator(splats.log_illumination, levels[0])

    def radiance_of(self, splats: Splats, levels: tuple[float, ...] | None) -> torch.Tensor:
        """c (eq. 8), or ĉ when levels are given."""
        log_illumination = splats.log_illumination
        if levels is not None:
            log_illumination = self.log_modulated_illumination(splats, levels)
        return self.composer(log_illumination, splats.log_reflectance)

    @torch.no_grad()
    def illumination_deviation(self, splats: Splats, log_relit: torch.Tensor) -> torch.Tensor:
        """|L_a − L̂_a| ``[M]``, which scales growth (eq. 17), from ln L̂_a."""
        return deviation_of(splats.log_illumination, log_relit, self.config.deviation_domain == "log")

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
        at_once = self.config.traits.brackets_at_once
        pictures = []
        for part in [taken] if at_once else [[each] for each in taken]:
            effects = [each.effect for each in part]
            part = [
                replace(each, effect=None if effect is None else effect.to(self.device))
                for each, effect in zip(part, effects, strict=True)
            ]
            pictures += [developed.ldr for developed in self.developed_at(camera, part, levels)]
        return pictures

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
        if self.config.global_supervision:
            terms["global"] = self.config.global_supervision * reconstruction_loss(
                compared(developed.global_ldr, mask), target, loss, ssim_target
            )
        if loss.consistency_weight and developed.relit is not None:
            terms["cons"] = loss.consistency_weight * consistency_loss(
                developed.exposed, developed.relit, loss
            )
        return terms | self.unit_term()

    def unit_term(self) -> dict[str, torch.Tensor]:
        """L_unit, weighted, where the loss has it."""
        weight, response = self.config.loss.unit_weight, self.tone_mapper
        if not (weight and isinstance(response, ToneMapper) and response.anchor):
            return {}
        return {"unit": weight * response.unit_exposure_error()}
