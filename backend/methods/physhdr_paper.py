# SPDX-License-Identifier: GPL-3.0-or-later
"""PhysHDR-GS with both branches, as the paper states it: what the preset ``paper`` is.

The image-exposure (IE) branch draws c = g(L_a, H_r) and multiplies the picture by the exposure t; the
Gaussian-illumination (GI) branch draws ĉ = g(φ(L_a, l), H_r), relit to the level l, which in the paper is the
exposure itself. Both share geometry, so that one pass of the rasteriser draws all of it. A tone mapper turns
both into LDR, globally and locally, and fuses them crosswise; L_cons holds the two radiances together.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ..rasterize import Rasterization
from ..scene.camera import Camera
from .base import Drawn, Exposed, exposed_by, is_standard
from .physhdr_common import Developed, PhysHDRMethod


@dataclass(frozen=True, kw_only=True)
class DrawnBranches(Drawn):
    """I_HDR and Î_HDR ``[3, H, W]``, the context feature ``[K, H, W]`` for local curves.

    ``levels``: of the lights, as the view has them.
    """

    image_exposure: torch.Tensor
    illumination: torch.Tensor
    context: torch.Tensor | None
    levels: tuple[float, ...]


class PaperPhysHDR(PhysHDRMethod[DrawnBranches]):
    """The method with both branches."""

    @property
    def level_is_exposure(self) -> bool:
        """Whether l = t (the paper); else l is the lighting level that the data give for the view."""
        return self.config.lighting_level == "exposure"

    def follow_schedule(self, iteration: int, iterations: int, sh_degree_every: int) -> None:
        super().follow_schedule(iteration, iterations, sh_degree_every)
        if self.config.tone_mapper.mix:
            learning = iteration >= self.config.mix_frozen_until * iterations
            self.curves.fusion.requires_grad_(learning)

    # -- training --------------------------------------------------------------------------------------

    def draw(
        self, camera: Camera, levels: tuple[float, ...], exposure: float, watch: bool = False
    ) -> DrawnBranches:
        splats = self.backbone.splats(camera, self.active_sh_degree)
        channels = [self.composer(splats.log_illumination, splats.log_reflectance)]  # c, eq. 8
        level = (exposure, *levels[1:]) if self.level_is_exposure else levels
        log_relit = self.log_modulated_illumination(splats, level)  # ln L̂_a, eq. 10
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
            levels=levels,
        )

    def develop_bracket(self, drawn: DrawnBranches, taken: Sequence[Exposed]) -> list[Developed]:
        return [self._developed(drawn, each) for each in taken]

    def _developed(self, drawn: DrawnBranches, taken: Exposed) -> Developed:
        exposed, relit = exposed_by(drawn.image_exposure, taken), drawn.illumination
        if not self.level_is_exposure:
            # l says how the scene was lit, not how it was exposed: both branches need the exposure, and a
            # view under other light can only be explained by the GI branch.
            relit = exposed_by(relit, taken)
            exposed = exposed if is_standard(drawn.levels) else relit
        elif taken.effect is not None:
            relit = relit * taken.effect
        return self._fused(exposed, relit, drawn.context)

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

    def developed_at(
        self, camera: Camera, taken: Sequence[Exposed], levels: tuple[float, ...]
    ) -> list[Developed]:
        """Where l = t, another level scales what the IE branch sees, and the GI branch sees level times t."""
        if not self.level_is_exposure or is_standard(levels):
            return super().developed_at(camera, taken, levels)
        return [self._relit(camera, each, levels) for each in taken]

    def _relit(self, camera: Camera, taken: Exposed, levels: tuple[float, ...]) -> Developed:
        splats = self.backbone.splats(camera, self.active_sh_degree)
        colours = [self.radiance_of(splats, (levels[0] * t, *levels[1:])) for t in (1.0, taken.exposure)]
        if self.config.tone_mapper.local:
            assert splats.context is not None
            colours.append(splats.context)
        drawn = self.rasterize(splats, torch.cat(colours, dim=1), camera).image
        context = drawn[6:] if self.config.tone_mapper.local else None
        relit = drawn[3:6] if taken.effect is None else drawn[3:6] * taken.effect
        return self._fused(exposed_by(drawn[:3], taken), relit, context)

    def bracket_at(
        self, camera: Camera, exposures: Sequence[float], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        if self.level_is_exposure:
            return super().bracket_at(camera, exposures, levels)
        drawn = self.draw(camera, levels, exposures[0])
        taken = [Exposed(exposure=exposure) for exposure in exposures]
        return [developed.ldr for developed in self.develop_bracket(drawn, taken)]

    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        nothing = drawn.image.new_zeros(3, 1, 1)
        context = drawn.image.new_zeros(self.config.tone_mapper.context_size, 1, 1)
        return self.ldr_at(camera, exposure, levels), self._fused(nothing, nothing, context).ldr
