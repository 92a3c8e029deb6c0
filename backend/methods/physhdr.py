# SPDX-License-Identifier: GPL-3.0-or-later
"""PhysHDR-GS on the 3DGS backbone: the forward pass and the losses, as the paper states them.

Each Gaussian has a reflectance H_r and an ambient illumination L_a. The image-exposure (IE) branch renders
c = g(L_a, H_r) and multiplies the picture by the exposure t; the Gaussian-illumination (GI) branch renders
ĉ = g(φ(L_a, l), H_r), relit to the level l. A tone mapper turns both into LDR and fuses them crosswise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import nn

from ...bridge.errors import BadValueError
from ...bridge.lights import AMBIENT, Levels, as_levels, check_lights
from ..device import use_whole_float32
from ..kernels.plain import can_fuse
from ..kernels.ssim import SsimTarget
from ..model.gaussians import Gaussians
from ..model.radiance import AdditiveModulator, LearnedComposer, LearnedModulator, ProductComposer
from ..model.tone_mapper import ToneMapper, ToneMapperConfig
from ..rasterize import Implementation, Rasterization, rasterize
from ..resident import camera_tensors
from ..scene.camera import Camera
from ..train.losses import LossConfig, consistency_loss, reconstruction_loss


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
        if not 0 <= self.sh_degree <= 3:
            raise BadValueError(f"the SH degree must be 0 to 3, got {self.sh_degree}")

    @property
    def channels(self) -> int:
        """How many channels one pass draws."""
        context = self.tone_mapper.context_size if self.tone_mapper.local else 0
        return (6 if self.branches == "both" else 3) + context

    @property
    def has_light_share(self) -> bool:
        """Whether each Gaussian learns which share of its radiance each light causes."""
        return self.modulator == "additive" and self.branches != "image-exposure"


@dataclass(frozen=True)
class Rendering:
    """One training view: scene-linear images, LDR images, and what densification reads.

    ``exposed``: what the response sees, I_HDR · t ``[3, H, W]`` (or Î · t where only the GI branch is drawn).
    ``relit``: Î_HDR, only with both branches. ``ldr``: the prediction. ``supervised``: every LDR image that
    L_rec compares with the picture. ``illumination_deviation``: |L_a − L̂_a| ``[N]``.
    """

    exposed: torch.Tensor
    relit: torch.Tensor | None
    ldr: torch.Tensor
    supervised: list[torch.Tensor]
    global_ldr: torch.Tensor
    illumination_deviation: torch.Tensor | None
    rasterization: Rasterization


def is_standard(levels: Sequence[float]) -> bool:
    """Whether every light is as it was captured."""
    return all(level == 1.0 for level in levels)


class PhysHDR(nn.Module):
    """The method: Gaussians and three networks. ``config`` alone decides what it computes.

    ``lights``: names of the lights that have levels; wherever a level is taken, a plain number is the first
    one's. Only the additive modulator knows more than one: else ``BadValueError``.
    """

    def __init__(
        self,
        config: PhysHDRConfig,
        gaussians: Gaussians,
        anchor: tuple[float, float] | None,
        implementation: Implementation = "auto",
        lights: tuple[str, ...] = (AMBIENT,),
    ) -> None:
        super().__init__()
        if len(lights) > 1 and not config.has_light_share:
            raise BadValueError(
                f"the {config.modulator} modulator knows one light, the data have {', '.join(lights)}",
                "Set --method.modulator additive, or train without the lit views.",
            )
        self.config = config
        self.lights = check_lights(lights, "the method")
        self.gaussians = gaussians
        self.implementation: Implementation = implementation
        hidden = config.composer_hidden
        self.composer = ProductComposer() if config.composer == "product" else LearnedComposer(hidden)
        self.modulator = AdditiveModulator() if config.modulator == "additive" else LearnedModulator(hidden)
        self.tone_mapper = ToneMapper(config.tone_mapper, anchor)
        #: SH coefficients above this degree are not used yet (3DGS's schedule raises it).
        self.active_sh_degree = config.sh_degree

    def to_device(self, device: torch.device) -> None:
        """Move Gaussians and networks; an optimiser must be made after this."""
        if device.type == "cuda":
            use_whole_float32()
        self.to(device)
        parameters = self.gaussians.parameters
        for name, tensor in parameters.items():
            parameters[name] = tensor.detach().to(device).requires_grad_()

    # -- radiance of the Gaussians -------------------------------------------------------------------

    def _viewpoint(self, camera: Camera) -> torch.Tensor:
        return camera_tensors(camera, self.gaussians.means).position

    def log_modulated_illumination(self, level: Levels) -> torch.Tensor:
        """ln L̂_a = ln φ(L_a, l) (eq. 10), ``[N, 1 or 3]``."""
        levels = as_levels(level, self.lights)
        if isinstance(self.modulator, AdditiveModulator):
            return self.modulator(self.gaussians.log_illumination, levels, self.gaussians.light_share)
        return self.modulator(self.gaussians.log_illumination, levels[0])

    def radiance(self, viewpoint: torch.Tensor, level: Levels | None) -> torch.Tensor:
        """Scene-linear radiance ``[N, 3]`` toward ``viewpoint``: c (eq. 8), or ĉ when a level is given."""
        log_reflectance = self.gaussians.log_reflectance(viewpoint, self.active_sh_degree)
        if level is None:
            log_illumination = self.gaussians.log_illumination
        else:
            log_illumination = self.log_modulated_illumination(level)
        return self.composer(log_illumination, log_reflectance)

    # -- training --------------------------------------------------------------------------------------

    def render(
        self,
        camera: Camera,
        exposure: float,
        view_level: Levels = 1.0,
        screen_offsets: torch.Tensor | None = None,
    ) -> Rendering:
        """Render a view as a camera with ``exposure`` seconds would record it under ``view_level``."""
        config, gaussians = self.config, self.gaussians
        view_levels = as_levels(view_level, self.lights)
        by_exposure = config.lighting_level == "exposure"
        level = exposure if by_exposure else view_levels
        viewpoint = self._viewpoint(camera)
        log_reflectance = gaussians.log_reflectance(viewpoint, self.active_sh_degree)

        channels, log_relit = [], None
        if config.branches != "illumination":
            channels.append(self.composer(gaussians.log_illumination, log_reflectance))  # c, eq. 8
        if config.branches != "image-exposure":
            log_relit = self.log_modulated_illumination(level)  # ln L̂_a, eq. 10
            channels.append(self.composer(log_relit, log_reflectance))  # ĉ
        if config.tone_mapper.local:
            channels.append(gaussians.context)
        # One pass for everything: both branches share the geometry.
        drawn = self._rasterize(torch.cat(channels, dim=1), camera, screen_offsets)
        # Split, not sliced: the gradient of a slice is a whole picture of zeros with the slice in it.
        images = list(drawn.image.split([colours.shape[1] for colours in channels]))
        context = images.pop() if config.tone_mapper.local else None

        if config.branches == "both":
            exposed, relit = images[0] * exposure, images[1]
            if not by_exposure:
                # l says how the scene was lit, not how it was exposed: both branches need the exposure,
                # and a view under other light can only be explained by the GI branch.
                relit = relit * exposure
                exposed = exposed if is_standard(view_levels) else relit
            ldr, supervised, glo = self._fuse(exposed, relit, context)
        else:
            exposed, relit = images[0], None
            if config.branches == "image-exposure" or not by_exposure:
                exposed = exposed * exposure
            glo, loc = self.tone_mapper.tone_map(exposed, context)
            ldr = glo if loc is None else loc
            supervised = [ldr]

        deviation = None
        if log_relit is not None:
            with torch.no_grad():
                deviation = (gaussians.log_illumination.exp() - log_relit.exp()).abs().mean(dim=1)
        return Rendering(exposed, relit, ldr, supervised, glo, deviation, drawn)

    def _fuse(
        self, exposed: torch.Tensor, relit: torch.Tensor, context: torch.Tensor | None
    ) -> tuple[torch.Tensor, list[torch.Tensor], torch.Tensor]:
        """Tone-map both branches and fuse them crosswise (eq. 12–14)."""
        globals_, locals_ = self.tone_mapper.tone_map(torch.stack([exposed, relit], dim=1), context)
        # Crosswise: each branch's global image with the other's local one. Eq. 13 lacks its hats; GI is the
        # GI branch's global with the IE branch's local image.
        others = (globals_ if locals_ is None else locals_).flip(1)
        if self.config.tone_mapper.mix:
            fused = self.tone_mapper.mix(globals_, others)  # eq. 12, 13
        else:
            fused = 0.5 * (globals_ + others)
        ldr_ig, ldr_gi = fused.unbind(1)
        glo = globals_[:, 0]
        ldr = ldr_ig + ldr_gi
        if self.config.aggregate == "mean":
            ldr = 0.5 * ldr
        return ldr, [ldr, ldr_ig, ldr_gi], glo

    def losses(self, rendering: Rendering, picture: torch.Tensor) -> dict[str, torch.Tensor]:
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
    def hdr(self, camera: Camera, lighting_level: Levels = 1.0) -> torch.Tensor:
        """Scene-linear radiance ``[3, H, W]``: I_HDR, or Î_HDR where a lighting level is not 1."""
        return self._rasterize(self._seen_radiance(camera, lighting_level), camera).image

    @torch.no_grad()
    def preview(self, camera: Camera, lighting_level: Levels = 1.0) -> Rasterization:
        """The radiance of ``hdr`` with alpha and depth (metres along the camera's axis), in one pass."""
        return self._rasterize(self._seen_radiance(camera, lighting_level), camera, with_depth=True)

    @torch.no_grad()
    def preview_ldr(
        self, drawn: Rasterization, camera: Camera, exposure: float, lighting_level: Levels = 1.0
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The picture of ``ldr``, from what ``preview`` drew where that suffices, and the camera's black.

        ``[3, H, W]``, and ``[3, 1, 1]``: what the tone mapper makes of a pixel where nothing is.
        """
        config = self.config
        nothing = drawn.image.new_zeros(3, 1, 1)
        context = drawn.image.new_zeros(config.tone_mapper.context_size, 1, 1)
        if config.branches == "both":
            return self.ldr(camera, exposure, lighting_level), self._fuse(nothing, nothing, context)[0]
        glo, loc = self.tone_mapper.tone_map(nothing, context)
        black = glo if loc is None else loc
        scales_with_exposure = config.branches == "image-exposure" or config.lighting_level == "view"
        if config.tone_mapper.local or not scales_with_exposure:
            return self.ldr(camera, exposure, lighting_level), black
        return self.tone_mapper.tone_map(drawn.image * exposure, None)[0], black

    def _seen_radiance(self, camera: Camera, lighting_level: Levels) -> torch.Tensor:
        """``[N, 3]`` toward the camera; without an illumination branch the level scales all of it."""
        levels = as_levels(lighting_level, self.lights)
        standard = is_standard(levels)
        colours = self.radiance(
            self._viewpoint(camera), levels if self.can_relight and not standard else None
        )
        return colours if self.can_relight or standard else colours * levels[0]

    @torch.no_grad()
    def ldr(self, camera: Camera, exposure: float, lighting_level: Levels = 1.0) -> torch.Tensor:
        """The picture ``[3, H, W]`` in [0, 1] that a camera with ``exposure`` seconds would record.

        The paper ties l to the exposure; under another lighting level its image-exposure branch sees the
        relit radiance times t, and its illumination branch the level times t.
        """
        levels = as_levels(lighting_level, self.lights)
        if self.config.lighting_level == "view" or is_standard(levels):
            return self.render(camera, exposure, levels).ldr
        if self.config.branches == "image-exposure":
            return self.render(camera, exposure * levels[0]).ldr
        viewpoint = self._viewpoint(camera)
        colours = [self.radiance(viewpoint, (levels[0] * t, *levels[1:])) for t in (1.0, exposure)]
        if self.config.tone_mapper.local:
            colours.append(self.gaussians.context)
        drawn = self._rasterize(torch.cat(colours, dim=1), camera).image
        context = drawn[6:] if self.config.tone_mapper.local else None
        return self._fuse(drawn[:3] * exposure, drawn[3:6], context)[0]

    @property
    def can_relight(self) -> bool:
        """Whether there is an illumination branch; without one a lighting level only scales."""
        return self.config.branches != "image-exposure"

    def _rasterize(
        self,
        colours: torch.Tensor,
        camera: Camera,
        screen_offsets: torch.Tensor | None = None,
        with_depth: bool = False,
    ) -> Rasterization:
        g = self.gaussians
        return rasterize(
            g.means,
            g.quaternions,
            g.scales,
            g.opacities,
            colours,
            camera,
            screen_offsets=screen_offsets,
            with_depth=with_depth,
            implementation=self.implementation,
        )
