# SPDX-License-Identifier: GPL-3.0-or-later
"""PhysHDR-GS on either backbone: the forward pass and the losses, as the paper states them.

Each Gaussian has a reflectance H_r and an ambient illumination L_a. The image-exposure (IE) branch renders
c = g(L_a, H_r) and multiplies the picture by the exposure t; the Gaussian-illumination (GI) branch renders
ĉ = g(φ(L_a, l), H_r), relit to the level l. A tone mapper turns both into LDR and fuses them crosswise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch

from ...bridge.errors import BadValueError
from ...bridge.lights import AMBIENT, Levels, as_levels, check_lights
from ..kernels.ahead import COMPOSER, FUSION, MODULATOR, Needs
from ..kernels.plain import can_fuse
from ..kernels.ssim import SsimTarget
from ..model.backbone import Attributes, Backbone, Splats
from ..model.radiance import AdditiveModulator, LearnedComposer, LearnedModulator, ProductComposer
from ..model.tone_mapper import ToneMapper, ToneMapperConfig
from ..rasterize import Implementation, Rasterization
from ..scene.camera import Camera
from ..train.losses import LossConfig, consistency_loss, reconstruction_loss
from .base import Drawn, Outcome, Shot, SplattingMethod, is_standard, mean_terms


@dataclass(frozen=True, kw_only=True)
class PhysHDRConfig:
    """What the method is made of. The defaults are the preset ``default``; see docs/method.md for the why."""

    #: Which branches are rendered. One branch costs three channels, both cost six (and the context).
    branches: Literal["both", "image-exposure", "illumination"] = "illumination"
    #: l: the exposure of the picture (the paper) or the lighting level that the data give for the view.
    lighting_level: Literal["exposure", "view"] = "view"
    #: g: the physical product L_a · H_r, or the product times what a network learns (the paper).
    composer: Literal["product", "learned"] = "product"
    #: φ: additive (each light has a share of each Gaussian's), or a network (the paper).
    modulator: Literal["additive", "learned"] = "additive"
    composer_hidden: int = 64
    sh_degree: int = 3
    #: f_mix stays at its start (a plain mean) for this share of the training (the paper: 10 k of 30 k).
    mix_frozen_until: float = 1.0 / 3.0
    #: I_LDR: the mean of the two fused images, or their sum as eq. 14 has it (which cannot fit; method.md).
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

    @property
    def channels(self) -> int:
        """How many channels one pass draws."""
        context = self.tone_mapper.context_size if self.tone_mapper.local else 0
        return (6 if self.branches == "both" else 3) + context

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        """What the backbone's splats must carry, where ``lights`` have levels."""
        return Attributes(
            sh_degree=self.sh_degree,
            context_size=self.tone_mapper.context_size if self.tone_mapper.local else 0,
            lights=len(lights) if self.has_light_share else 0,
        )

    @property
    def has_light_share(self) -> bool:
        """Whether each Gaussian learns which share of its radiance each light causes."""
        return self.modulator == "additive" and self.branches != "image-exposure"


@dataclass(frozen=True)
class DrawnLight(Drawn):
    """One pass: I_HDR ``[3, H, W]``, Î_HDR and the context feature ``[K, H, W]``, where they are drawn."""

    image_exposure: torch.Tensor | None = None
    illumination: torch.Tensor | None = None
    context: torch.Tensor | None = None
    levels: tuple[float, ...] = (1.0,)


@dataclass(frozen=True)
class Picture:
    """One drawn view as a camera records it.

    ``exposed``: what the response sees, I_HDR · t ``[3, H, W]`` (or Î · t where only the GI branch is drawn).
    ``relit``: Î_HDR, only with both branches. ``ldr``: the prediction. ``supervised``: every LDR image that
    L_rec compares with the picture.
    """

    exposed: torch.Tensor
    relit: torch.Tensor | None
    ldr: torch.Tensor
    supervised: list[torch.Tensor]
    global_ldr: torch.Tensor


class PhysHDR(SplattingMethod):
    """The method: a backbone and three networks. ``config`` alone decides what it computes.

    ``lights``: names of the lights that have levels; wherever a level is taken, a plain number is the first
    one's. Only the additive modulator knows more than one: else ``BadValueError``.
    """

    def __init__(
        self,
        config: PhysHDRConfig,
        backbone: Backbone,
        anchor: tuple[float, float] | None,
        implementation: Implementation = "auto",
        lights: tuple[str, ...] = (AMBIENT,),
    ) -> None:
        if len(lights) > 1 and not config.has_light_share:
            raise BadValueError(
                f"the {config.modulator} modulator knows one light, the data have {', '.join(lights)}",
                "Set --method.modulator additive, or train without the lit views.",
            )
        self.config = config
        super().__init__(backbone, implementation)
        self.lights = check_lights(lights, "the method")
        hidden = config.composer_hidden
        self.composer = ProductComposer() if config.composer == "product" else LearnedComposer(hidden)
        self.modulator = AdditiveModulator() if config.modulator == "additive" else LearnedModulator(hidden)
        self.tone_mapper = ToneMapper(config.tone_mapper, anchor)

    @property
    def sh_degree(self) -> int:
        return self.config.sh_degree

    @property
    def can_relight(self) -> bool:
        """Whether there is an illumination branch; without one a lighting level only scales."""
        return self.config.branches != "image-exposure"

    @property
    def composes_by_product(self) -> bool:
        return self.config.composer == "product"

    @property
    def has_light_share(self) -> bool:
        return self.config.has_light_share

    def network_groups(self) -> dict[str, list[torch.Tensor]]:
        radiance: list[torch.Tensor] = [*self.composer.parameters(), *self.modulator.parameters()]
        return {"radiance_networks": radiance} | super().network_groups()

    def follow_schedule(self, iteration: int, iterations: int, sh_degree_every: int) -> None:
        super().follow_schedule(iteration, iterations, sh_degree_every)
        if self.config.tone_mapper.mix:
            learning = iteration >= self.config.mix_frozen_until * iterations
            self.tone_mapper.fusion.requires_grad_(learning)

    # -- radiance of the splats ------------------------------------------------------------------------

    def log_modulated_illumination(self, splats: Splats, level: Levels) -> torch.Tensor:
        """ln L̂_a = ln φ(L_a, l) (eq. 10), ``[M, 1 or 3]``."""
        levels = as_levels(level, self.lights)
        if isinstance(self.modulator, AdditiveModulator):
            assert splats.light_share is not None
            return self.modulator(splats.log_illumination, levels, splats.light_share)
        return self.modulator(splats.log_illumination, levels[0])

    def radiance_of(self, splats: Splats, levels: Levels | None) -> torch.Tensor:
        """c (eq. 8), or ĉ when levels are given; ĉ of level 1 where c is never drawn."""
        log_illumination = splats.log_illumination
        if levels is None and self.config.branches == "illumination" and self.config.modulator == "learned":
            levels = 1.0  # at which the additive modulator is the identity, and a network need not be
        if levels is not None:
            log_illumination = self.log_modulated_illumination(splats, levels)
        return self.composer(log_illumination, splats.log_reflectance)

    # -- training --------------------------------------------------------------------------------------

    def draw(
        self, camera: Camera, view_level: Levels = 1.0, exposure: float | None = None, watch: bool = False
    ) -> DrawnLight:
        """Draw a view under ``view_level``: all that needs no exposure, in one pass.

        ``exposure`` (seconds): needed where the method takes it for the level l (the paper). ``watch``: for
        growth.
        """
        config = self.config
        view_levels = as_levels(view_level, self.lights)
        by_exposure = config.lighting_level == "exposure"
        splats = self.backbone.splats(camera, self.active_sh_degree)

        channels, log_relit = [], None
        if config.branches != "illumination":
            channels.append(self.composer(splats.log_illumination, splats.log_reflectance))  # c, eq. 8
        if config.branches != "image-exposure":
            if not by_exposure:
                level = view_levels
            elif exposure is not None:
                level = exposure
            else:
                raise BadValueError("the illumination branch of this method needs the exposure")
            log_relit = self.log_modulated_illumination(splats, level)
            channels.append(self.composer(log_relit, splats.log_reflectance))  # ĉ, with ln L̂_a of eq. 10
        if config.tone_mapper.local:
            assert splats.context is not None
            channels.append(splats.context)
        # One pass for everything: both branches share the geometry.
        offsets = self.watched(splats) if watch else None
        drawn = self.rasterize(splats, torch.cat(channels, dim=1), camera, screen_offsets=offsets)
        # Split, not sliced: the gradient of a slice is a whole picture of zeros with the slice in it.
        images = list(drawn.image.split([colours.shape[1] for colours in channels]))

        deviation = None
        if log_relit is not None:
            with torch.no_grad():
                deviation = (splats.log_illumination.exp() - log_relit.exp()).abs().mean(dim=1)
        return DrawnLight(
            splats,
            drawn,
            offsets,
            deviation,
            image_exposure=images.pop(0) if config.branches != "illumination" else None,
            illumination=images.pop(0) if config.branches != "image-exposure" else None,
            context=images.pop(0) if config.tone_mapper.local else None,
            levels=view_levels,
        )

    def develop(self, drawn: DrawnLight, exposure: float) -> Picture:
        """What a camera with ``exposure`` seconds records of a drawn view."""
        by_exposure = self.config.lighting_level == "exposure"
        if self.config.branches == "both":
            assert drawn.image_exposure is not None and drawn.illumination is not None
            exposed, relit = drawn.image_exposure * exposure, drawn.illumination
            if not by_exposure:
                # l says how the scene was lit, not how it was exposed: both branches need the exposure,
                # and a view under other light can only be explained by the GI branch.
                relit = relit * exposure
                exposed = exposed if is_standard(drawn.levels) else relit
            ldr, supervised, glo = self._fuse(exposed, relit, drawn.context)
            return Picture(exposed, relit, ldr, supervised, glo)
        return self._develop_one_branch(drawn, [exposure])[0]

    def _develop_one_branch(self, drawn: DrawnLight, exposures: Sequence[float]) -> list[Picture]:
        """What each of ``exposures`` records where one branch is drawn: tone-mapped in one go."""
        image = drawn.image_exposure if drawn.illumination is None else drawn.illumination
        assert image is not None
        scales = drawn.illumination is None or self.config.lighting_level == "view"
        exposed = torch.stack([image * exposure if scales else image for exposure in exposures], dim=1)
        globals_, locals_ = self.tone_mapper.tone_map(exposed, drawn.context)
        shown = globals_ if locals_ is None else locals_
        return [
            Picture(radiance, None, ldr, [ldr], glo)
            for radiance, ldr, glo in zip(exposed.unbind(1), shown.unbind(1), globals_.unbind(1), strict=True)
        ]

    def develop_bracket(self, drawn: DrawnLight, exposures: Sequence[float]) -> list[Picture]:
        """``develop`` for each of ``exposures`` (seconds) of a bracket."""
        if self.config.branches == "both":
            return [self.develop(drawn, exposure) for exposure in exposures]
        return self._develop_one_branch(drawn, exposures)

    def _fuse(
        self, exposed: torch.Tensor, relit: torch.Tensor, context: torch.Tensor | None
    ) -> tuple[torch.Tensor, list[torch.Tensor], torch.Tensor]:
        """Tone-map both branches and fuse them crosswise (eq. 12–14)."""
        globals_, locals_ = self.tone_mapper.tone_map(torch.stack([exposed, relit], dim=1), context)
        # Crosswise: each branch's global image with the other's local one. Eq. 13 lacks its hats; GI is the
        # GI branch's global with the IE branch's local image.
        firsts, others = globals_, (globals_ if locals_ is None else locals_).flip(1)
        if self.config.illumination_fusion == "literal":
            firsts = globals_[:, :1].expand_as(globals_)
        if self.config.tone_mapper.mix:
            fused = self.tone_mapper.mix(firsts, others)  # eq. 12, 13
        else:
            fused = 0.5 * (firsts + others)
        ldr_ig, ldr_gi = fused.unbind(1)
        glo = globals_[:, 0]
        ldr = ldr_ig + ldr_gi
        if self.config.aggregate == "mean":
            ldr = 0.5 * ldr
        return ldr, [ldr, ldr_ig, ldr_gi], glo

    def training_outcome(self, shot: Shot) -> Outcome:
        is_bracket = len(shot.exposures) > 1
        if is_bracket and self.config.lighting_level == "exposure" and self.can_relight:
            raise BadValueError(
                "with l = t every exposure is another drawing, so a bracket cannot be drawn at once",
                "Set --supervision one, or --method.lighting-level view.",
            )
        drawn = self.draw(shot.camera, shot.levels, shot.exposures[0], watch=True)
        each = [
            self.losses(rendering, picture)
            for rendering, picture in zip(
                self.develop_bracket(drawn, shot.exposures), shot.pictures, strict=True
            )
        ]
        return Outcome(mean_terms(each) | self.backbone_terms(drawn.splats), drawn)

    def losses(self, rendering: Picture, picture: torch.Tensor) -> dict[str, torch.Tensor]:
        """The weighted terms of L_total (eq. 19) for a picture ``[3, H, W]`` in [0, 1]; sum them."""
        loss = self.config.loss
        ssim_target = SsimTarget(picture) if can_fuse(picture) else None
        terms = {
            "rec": torch.stack(
                [reconstruction_loss(image, picture, loss, ssim_target) for image in rendering.supervised]
            ).sum()
        }
        if self.config.global_supervision:
            terms["global"] = self.config.global_supervision * reconstruction_loss(
                rendering.global_ldr, picture, loss, ssim_target
            )
        if loss.consistency_weight and rendering.relit is not None:
            terms["cons"] = loss.consistency_weight * consistency_loss(
                rendering.exposed, rendering.relit, loss
            )
        if loss.unit_weight and self.tone_mapper.anchor is not None:
            terms["unit"] = loss.unit_weight * self.tone_mapper.unit_exposure_error()
        return terms

    # -- use --------------------------------------------------------------------------------------------

    @torch.no_grad()
    def preview_ldr(
        self, drawn: Rasterization, camera: Camera, exposure: float, lighting_level: Levels = 1.0
    ) -> tuple[torch.Tensor, torch.Tensor]:
        config = self.config
        nothing = drawn.image.new_zeros(3, 1, 1)
        context = drawn.image.new_zeros(config.tone_mapper.context_size, 1, 1)
        if config.branches == "both":
            return self.ldr(camera, exposure, lighting_level), self._fuse(nothing, nothing, context)[0]
        glo, loc = self.tone_mapper.tone_map(nothing, context)
        black = glo if loc is None else loc
        if config.tone_mapper.local or not self._exposure_only_scales:
            return self.ldr(camera, exposure, lighting_level), black
        return self.tone_mapper.tone_map(drawn.image * exposure, None)[0], black

    @property
    def _exposure_only_scales(self) -> bool:
        """Whether what is drawn is the same at every exposure."""
        return not self.can_relight or self.config.lighting_level == "view"

    @torch.no_grad()
    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels = 1.0) -> torch.Tensor:
        """As ``Method.ldr``.

        The paper ties l to the exposure; under another lighting level its image-exposure branch sees the
        relit radiance times t, and its illumination branch the level times t.
        """
        levels: tuple[float, ...] = as_levels(lighting_level, self.lights)
        if self.config.lighting_level == "view" or is_standard(levels):
            return self.develop(self.draw(camera, levels, exposure), exposure).ldr
        if self.config.branches == "image-exposure":
            return self.develop(self.draw(camera), exposure * levels[0]).ldr
        splats = self.backbone.splats(camera, self.active_sh_degree)
        colours = [self.radiance_of(splats, (levels[0] * t, *levels[1:])) for t in (1.0, exposure)]
        if self.config.tone_mapper.local:
            assert splats.context is not None
            colours.append(splats.context)
        drawn = self.rasterize(splats, torch.cat(colours, dim=1), camera).image
        context = drawn[6:] if self.config.tone_mapper.local else None
        return self._fuse(drawn[:3] * exposure, drawn[3:6], context)[0]

    @torch.no_grad()
    def ldr_bracket(
        self, camera: Camera, exposures: Sequence[float], lighting_level: Levels = 1.0
    ) -> list[torch.Tensor]:
        levels = as_levels(lighting_level, self.lights)
        if not self._exposure_only_scales or not (self.can_relight or is_standard(levels)):
            return super().ldr_bracket(camera, exposures, lighting_level)
        drawn = self.draw(camera, levels)
        return [rendering.ldr for rendering in self.develop_bracket(drawn, exposures)]


def kernels_needed(config: PhysHDRConfig) -> Needs:
    """The CPU kernels that training this method calls."""
    wanted = {
        COMPOSER: config.composer == "learned",
        MODULATOR: config.modulator == "learned" and config.branches != "image-exposure",
        FUSION: config.tone_mapper.mix,
    }
    local = (2 if config.branches == "both" else 1,) if config.tone_mapper.local else ()
    return Needs(
        channels=tuple(sorted({3, config.channels})),  # three: the view that is shown
        networks=tuple(shape for shape, is_wanted in wanted.items() if is_wanted),
        activations=(config.tone_mapper.activation,),
        local_branches=local,
        blur=config.branches == "both" and config.loss.consistency_weight > 0,
    )
