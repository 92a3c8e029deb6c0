# SPDX-License-Identifier: GPL-3.0-or-later
"""PhysHDR-GS as the paper states it, with both branches and learned networks (lab/paper.md).

The image-exposure (IE) branch draws c = g(L_a, H_r) and multiplies the picture by the exposure t; the
Gaussian-illumination (GI) branch draws ĉ = g(φ(L_a, l), H_r), relit to the level l, which is the exposure
itself. Both share geometry, so that one pass of the rasteriser draws all of it. A tone mapper turns both into
LDR, globally and locally, and fuses them crosswise; L_cons holds the two radiances together.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import torch
from torch import nn

from ...backend.bounds import Size
from ...backend.kernels.activations import illumination_deviation
from ...backend.kernels.ahead import Needs
from ...backend.kernels.ssim import SsimTarget
from ...backend.methods.base import Drawn, Exposed, Method, MethodSetup, Traits, exposed_by, is_standard
from ...backend.methods.losses import compared, reconstruction_loss
from ...backend.methods.physhdr import DrawnRadiance, PhysHDR
from ...backend.methods.physhdr_common import D, Developed, PhysHDRConfig, PhysHDRMethod
from ...backend.model.backbone import Attributes, Backbone, Splats
from ...backend.model.tone_mapper import Response
from ...backend.rasterize import Rasterization
from ...backend.scene.camera import Camera
from ...bridge.errors import BadValueError
from .paper_losses import PaperLossConfig, consistency_loss
from .paper_networks import (
    COMPOSER,
    FUSION,
    MODULATOR,
    FusingToneMapper,
    LearnedComposer,
    LearnedModulator,
    PaperToneMapperConfig,
)


@dataclass(frozen=True, kw_only=True)
class PaperConfig(PhysHDRConfig):
    """What the method is made of, as published; lab/paper.md has what the paper leaves open.

    Without ``illumination_branch`` only the IE branch is drawn.
    """

    name: ClassVar[str] = "physhdr-paper"

    #: Hidden units of g and φ.
    composer_hidden: Size = 64
    #: L_a: one number a Gaussian, or one a colour channel.
    illumination_channels: Literal[1, 3] = 1
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
    #: I_LDR: the mean of the two fused images, or their sum as eq. 14 has it (it cannot fit: lab/paper.md).
    aggregate: Literal["mean", "sum"] = "mean"
    #: I_GI: f_mix(Î_glo, I_loc), crosswise as its name has it, or f_mix(I_glo, I_loc), as eq. 13 is printed.
    illumination_fusion: Literal["crosswise", "literal"] = "crosswise"
    #: Add the global image to L_rec, so that L_unit binds the curve that is in use.
    global_supervision: float = 0.0
    tone_mapper: PaperToneMapperConfig = field(default_factory=PaperToneMapperConfig)
    loss: PaperLossConfig = field(default_factory=PaperLossConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tone_mapper.mix and not (self.tone_mapper.local and self.illumination_branch):
            raise BadValueError(
                "f_mix fuses global and local images of both branches",
                "Give --set method.tone_mapper.mix=false, or leave both branches and the local curves on.",
            )
        if self.growth_gradient == "image-exposure" and not self.illumination_branch:
            raise BadValueError(
                "one branch alone is drawn, and its gradient is all that growth can read",
                "Leave out --set method.growth_gradient, or method.illumination_branch=false.",
            )

    @property
    def traits(self) -> Traits:
        # The GI branch is drawn anew at each exposure.
        return Traits(brackets_at_once=not self.illumination_branch, effects=True)

    @property
    def channels(self) -> int:
        """How many are drawn, all in one pass where ``growth_gradient`` does not say otherwise."""
        return super().channels + (3 if self.illumination_branch else 0)

    @property
    def has_light_share(self) -> bool:
        return False

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        return dataclasses.replace(
            super().attributes(lights),
            illumination_channels=self.illumination_channels,
            direction_gradient=self.direction_gradient,
        )

    def kernels_needed(self) -> Needs:
        more = self.illumination_channels - 1  # of L_a, than the one that these are named for
        wanted = [
            ((COMPOSER[0] + more, COMPOSER[1]), True),
            ((MODULATOR[0] + more, MODULATOR[1] + more), self.illumination_branch),
            (FUSION, self.tone_mapper.mix),
        ]
        apart = (self.channels - 3,) if self.growth_gradient == "image-exposure" else ()
        both = self.illumination_branch
        return super().kernels_needed() | Needs(
            channels=apart,
            networks=tuple(shape for shape, is_wanted in wanted if is_wanted),
            local_branches=(2,) if both and self.tone_mapper.local else (),
            blur=both and self.loss.consistency_weight > 0,
        )


@dataclass(frozen=True, kw_only=True)
class DrawnBranches(Drawn):
    """I_HDR and Î_HDR ``[3, H, W]``, the context feature ``[K, H, W]`` for local curves."""

    image_exposure: torch.Tensor
    illumination: torch.Tensor
    context: torch.Tensor | None


class LearnedMethod(PhysHDRMethod[D]):
    """The paper's g, φ, f and losses, whichever branches are drawn."""

    config: PaperConfig

    def new_networks(self) -> tuple[nn.Module, nn.Module]:
        sizes = self.config.composer_hidden, self.config.illumination_channels
        return LearnedComposer(*sizes, self.log_radiance_range), LearnedModulator(*sizes)

    def new_response(self, setup: MethodSetup) -> Response:
        setup.refuse_known("The paper's method")
        return FusingToneMapper(self.config.tone_mapper, setup.anchor)

    @property
    def curves(self) -> FusingToneMapper:
        assert isinstance(self.tone_mapper, FusingToneMapper)
        return self.tone_mapper

    @property
    def composes_by_product(self) -> bool:
        return False

    def network_groups(self) -> dict[str, list[torch.Tensor]]:
        radiance: list[torch.Tensor] = [*self.composer.parameters(), *self.modulator.parameters()]
        return {"radiance_networks": radiance} | super().network_groups()

    def log_modulated_illumination(self, splats: Splats, levels: tuple[float, ...]) -> torch.Tensor:
        return self.modulator(splats.log_illumination, levels[0])

    def further_terms(
        self,
        developed: Developed,
        target: torch.Tensor,
        mask: torch.Tensor | None,
        ssim_target: SsimTarget | None,
    ) -> dict[str, torch.Tensor]:
        """L_cons, and L_rec of the global image where it is asked for."""
        loss, terms = self.config.loss, {}
        if self.config.global_supervision:
            terms["global"] = self.config.global_supervision * reconstruction_loss(
                compared(developed.global_ldr, mask), target, loss, ssim_target
            )
        if loss.consistency_weight and developed.relit is not None:
            terms["cons"] = loss.consistency_weight * consistency_loss(
                developed.exposed, developed.relit, loss
            )
        return terms


class PaperImageExposure(LearnedMethod[DrawnRadiance], PhysHDR):
    """The IE branch alone."""

    def lit(self, splats: Splats, levels: tuple[float, ...]) -> tuple[torch.Tensor, torch.Tensor | None]:
        return self.composer(splats.log_illumination, splats.log_reflectance), None


class PaperPhysHDR(LearnedMethod[DrawnBranches]):
    """Both branches."""

    def follow_schedule(self, iteration: int, iterations: int, sh_degree_every: int) -> None:
        super().follow_schedule(iteration, iterations, sh_degree_every)
        if self.config.tone_mapper.mix:
            learning = iteration >= self.config.mix_frozen_until * iterations
            self.curves.fusion.requires_grad_(learning)

    # -- training --------------------------------------------------------------------------------------

    @torch.no_grad()
    def illumination_deviation(self, splats: Splats, log_relit: torch.Tensor) -> torch.Tensor:
        """|L_a − L̂_a| ``[M]``, which scales growth (eq. 17), from ln L̂_a."""
        if self.config.deviation_domain == "log":
            return (splats.log_illumination - log_relit).abs().mean(dim=1)
        return illumination_deviation(splats.log_illumination, log_relit)

    def draw(
        self, camera: Camera, levels: tuple[float, ...], exposure: float, watch: bool = False
    ) -> DrawnBranches:
        splats = self.backbone.splats(camera, self.active_sh_degree)
        channels = [self.composer(splats.log_illumination, splats.log_reflectance)]  # c, eq. 8
        log_relit = self.log_modulated_illumination(splats, (exposure,))  # ln L̂_a, eq. 10
        channels.append(self.composer(log_relit, splats.log_reflectance))  # ĉ
        if self.config.tone_mapper.local:
            assert splats.context is not None
            channels.append(splats.context)
        offsets = self.watched(splats) if watch else None
        sizes = [colours.shape[1] for colours in channels]
        # Split, not sliced: the gradient of a slice is a whole picture of zeros with the slice in it.
        if watch and self.config.growth_gradient == "image-exposure":
            # Two passes, of which growth watches the first alone; all else learns from both.
            drawn = self.rasterize(splats, channels[0], camera, screen_offsets=offsets)
            others = self.rasterize(splats, torch.cat(channels[1:], dim=1), camera).image
            exposed, relit, *context = (drawn.image, *others.split(sizes[1:]))
        else:
            # One pass for everything: both branches share the geometry.
            drawn = self.rasterize(splats, torch.cat(channels, dim=1), camera, screen_offsets=offsets)
            exposed, relit, *context = drawn.image.split(sizes)
        return DrawnBranches(
            splats,
            drawn,
            offsets,
            self.illumination_deviation(splats, log_relit),
            image_exposure=exposed,
            illumination=relit,
            context=context[0] if context else None,
        )

    def develop_bracket(self, drawn: DrawnBranches, taken: Sequence[Exposed]) -> list[Developed]:
        return [self._developed(drawn, each) for each in taken]

    def _developed(self, drawn: DrawnBranches, taken: Exposed) -> Developed:
        relit = drawn.illumination if taken.effect is None else drawn.illumination * taken.effect
        return self._fused(exposed_by(drawn.image_exposure, taken), relit, drawn.context)

    def _fused(self, exposed: torch.Tensor, relit: torch.Tensor, context: torch.Tensor | None) -> Developed:
        """Tone-map both branches ``[3, H, W]`` and fuse them crosswise (eq. 12–14)."""
        globals_, locals_ = self.tone_mapper.tone_map(torch.stack([exposed, relit], dim=1), context)
        # Crosswise: each branch's global image with the other's local one. Eq. 13 lacks its hats; GI is the
        # GI branch's global with the IE branch's local image.
        firsts, others = globals_, (globals_ if locals_ is None else locals_).flip(1)
        if self.config.illumination_fusion == "literal":
            firsts = globals_[:, :1].expand_as(globals_)
        mix = self.config.tone_mapper.mix
        fused = self.curves.mix(firsts, others) if mix else 0.5 * (firsts + others)  # eq. 12, 13
        ldr_ig, ldr_gi = fused.unbind(1)
        ldr = ldr_ig + ldr_gi
        if self.config.aggregate == "mean":
            ldr = 0.5 * ldr
        return Developed(exposed, relit, ldr, [ldr, ldr_ig, ldr_gi], globals_[:, 0])

    # -- use -------------------------------------------------------------------------------------------

    def ldr_at(self, camera: Camera, exposure: float, levels: tuple[float, ...]) -> torch.Tensor:
        return self.developed_at(camera, [Exposed(exposure=exposure)], levels)[0].ldr

    def photographed_at(
        self, camera: Camera, taken: Sequence[Exposed], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        pictures = []
        for each in taken:
            pictures += super().photographed_at(camera, [each], levels)
        return pictures

    def developed_at(
        self, camera: Camera, taken: Sequence[Exposed], levels: tuple[float, ...]
    ) -> list[Developed]:
        """As l = t, another level scales what the IE branch sees, and the GI branch sees level times t."""
        if is_standard(levels):
            return super().developed_at(camera, taken, levels)
        return [self._relit(camera, each, levels) for each in taken]

    def _relit(self, camera: Camera, taken: Exposed, levels: tuple[float, ...]) -> Developed:
        splats = self.backbone.splats(camera, self.active_sh_degree)
        colours = [self.radiance_of(splats, (levels[0] * t,)) for t in (1.0, taken.exposure)]
        if self.config.tone_mapper.local:
            assert splats.context is not None
            colours.append(splats.context)
        drawn = self.rasterize(splats, torch.cat(colours, dim=1), camera).image
        context = drawn[6:] if self.config.tone_mapper.local else None
        relit = drawn[3:6] if taken.effect is None else drawn[3:6] * taken.effect
        return self._fused(exposed_by(drawn[:3], taken), relit, context)

    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        nothing = drawn.image.new_zeros(3, 1, 1)
        context = drawn.image.new_zeros(self.config.tone_mapper.context_size, 1, 1)
        return self.ldr_at(camera, exposure, levels), self._fused(nothing, nothing, context).ldr


def new_paper(config: PaperConfig, backbone: Backbone, setup: MethodSetup) -> Method:
    """The method with the branches that ``config`` has."""
    return (PaperPhysHDR if config.illumination_branch else PaperImageExposure)(config, backbone, setup)
