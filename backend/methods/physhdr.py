# SPDX-License-Identifier: GPL-3.0-or-later
"""PhysHDR-GS with one branch: what the presets ``default`` and ``baseline`` are.

``default`` draws ĉ = L_a (s·l + 1 − s) · H_r under each view's own lighting level l, multiplies the picture
by the exposure t and maps its tones. Light transport is linear in the light, so that nothing has to be
learned of it but the share s; and on views under the standard light, where l = 1, the paper's other branch
would be the same picture (docs/method.md). ``baseline`` draws c = L_a · H_r and knows of no light: the plain
yardstick, whose lighting level only scales.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ..kernels.activations import lit_colours
from ..kernels.bracket import can_compare_bracket
from ..kernels.plain import can_fuse
from ..model.backbone import Splats
from ..model.tone_mapper import ToneMapper
from ..rasterize import Rasterization
from ..scene.camera import Camera
from .base import Drawn, Exposed, Recording, exposed_by, is_standard
from .losses import compared, reconstruction_loss, weighted
from .physhdr_common import Developed, PhysHDRMethod


@dataclass(frozen=True, kw_only=True)
class DrawnRadiance(Drawn):
    """One pass: radiance ``[3, H, W]``, and the context feature ``[K, H, W]`` for local curves."""

    radiance: torch.Tensor
    context: torch.Tensor | None


class PhysHDR(PhysHDRMethod[DrawnRadiance]):
    """The method with the illumination branch alone, or with the image-exposure branch alone."""

    # -- training --------------------------------------------------------------------------------------

    def lit(self, splats: Splats, levels: tuple[float, ...]) -> tuple[torch.Tensor, torch.Tensor | None]:
        """What is drawn in training, ĉ (or c) ``[M, 3]``, and |L_a − L̂_a| ``[M]`` where light is a factor."""
        share = splats.light_share if self.can_relight else None
        arguments = splats.log_reflectance, splats.log_illumination, share, levels
        colours, deviation = lit_colours(*arguments, self.log_radiance_range)
        return colours, deviation if self.can_relight else None

    def draw(
        self, camera: Camera, levels: tuple[float, ...], exposure: float = 1.0, watch: bool = False
    ) -> DrawnRadiance:
        splats = self.backbone.splats(camera, self.active_sh_degree)
        colours, deviation = self.lit(splats, levels)
        channels = [colours]
        if self.config.tone_mapper.local:
            assert splats.context is not None
            channels.append(splats.context)
        offsets = self.watched(splats) if watch else None
        drawn = self.rasterize(splats, torch.cat(channels, dim=1), camera, screen_offsets=offsets)
        # Split, not sliced: the gradient of a slice is a whole picture of zeros with the slice in it.
        radiance, *context = drawn.image.split([colours.shape[1] for colours in channels])
        return DrawnRadiance(
            splats, drawn, offsets, deviation, radiance=radiance, context=context[0] if context else None
        )

    def develop_bracket(self, drawn: DrawnRadiance, taken: Sequence[Exposed]) -> list[Developed]:
        """Through the method's response in one go: of one drawing only the development differs.

        What has a known encoding is developed by that.
        """
        exposed = [exposed_by(drawn.radiance, each) for each in taken]
        learned = [k for k, each in enumerate(taken) if not each.encoding.is_known]
        found: dict[int, Developed] = {}
        if learned:
            together = torch.stack([exposed[k] for k in learned], dim=1)
            globals_, locals_ = self.tone_mapper.tone_map(together, drawn.context)
            shown = globals_ if locals_ is None else locals_
            parts = (part.unbind(1) for part in (together, shown, globals_))
            for k, radiance, ldr, glo in zip(learned, *parts, strict=True):
                found[k] = Developed(radiance, None, ldr, [ldr], glo)
        for k, each in enumerate(taken):
            if each.encoding.is_known:
                if isinstance(each, Recording):
                    ldr = each.encoding.towards(exposed[k], each.picture)
                else:
                    ldr = each.encoding.developed(exposed[k])
                found[k] = Developed(exposed[k], None, ldr, [ldr], ldr)
        return [found[k] for k in range(len(taken))]

    def bracket_terms(
        self, drawn: DrawnRadiance, recordings: Sequence[Recording]
    ) -> dict[str, torch.Tensor] | None:
        """By one kernel (``kernels.bracket``), where a learned global response alone develops.

        Where the CPU's kernels do not compute, in one pass over all pictures.
        """
        loss, response = self.config.loss, self.tone_mapper
        mine, common = type(self), PhysHDRMethod
        if mine.losses is not common.losses or mine.further_terms is not common.further_terms:
            return None  # a method that is made of this one, with terms of its own
        if any(each.encoding.is_known for each in recordings):
            return None
        if not can_fuse(drawn.radiance):
            return {"rec": self.difference(drawn, recordings)} | self.unit_term()
        if not isinstance(response, ToneMapper) or self.config.tone_mapper.local:
            return None
        if not can_compare_bracket(drawn.radiance):
            return None
        if any(each.effect is not None or each.mask is not None for each in recordings):
            return None
        targets = [each.ssim_target() for each in recordings]
        exposures = [each.exposure for each in recordings]
        errors = response.bracket_errors(drawn.radiance, exposures, targets, loss.pixel)
        if errors is None:
            return None
        similarity, pixel = errors
        return {"rec": weighted(similarity, pixel, loss).mean()} | self.unit_term()

    def difference(self, drawn: DrawnRadiance, recordings: Sequence[Recording]) -> torch.Tensor:
        """The mean reconstruction loss of all recordings, by operations on all of them at once.

        For a card, whose host needs as long to start an operation on one picture as on three.
        """
        exposed = torch.stack([exposed_by(drawn.radiance, each) for each in recordings], dim=1)
        globals_, locals_ = self.tone_mapper.tone_map(exposed, drawn.context)
        shown = globals_ if locals_ is None else locals_
        if any(each.mask is not None for each in recordings):
            parts = zip(shown.unbind(1), recordings, strict=True)
            shown = torch.stack([compared(part, each.mask) for part, each in parts], dim=1)
        pictures = torch.stack([compared(each.picture, each.mask) for each in recordings], dim=1)
        return reconstruction_loss(shown.flatten(0, 1), pictures.flatten(0, 1), self.config.loss)

    # -- use -------------------------------------------------------------------------------------------

    def ldr_at(self, camera: Camera, exposure: float, levels: tuple[float, ...]) -> torch.Tensor:
        if not self.can_relight:
            exposure = exposure * levels[0]
        return self.develop(self.draw(camera, levels), exposure).ldr

    def bracket_at(
        self, camera: Camera, exposures: Sequence[float], levels: tuple[float, ...]
    ) -> list[torch.Tensor]:
        if not (self.can_relight or is_standard(levels)):
            return super().bracket_at(camera, exposures, levels)
        taken = [Exposed(exposure=exposure) for exposure in exposures]
        return [developed.ldr for developed in self.develop_bracket(self.draw(camera, levels), taken)]

    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        nothing = drawn.image.new_zeros(3, 1, 1)
        context = drawn.image.new_zeros(self.config.tone_mapper.context_size, 1, 1)
        glo, loc = self.tone_mapper.tone_map(nothing, context)
        black = glo if loc is None else loc
        if loc is not None:  # the preview has no context
            return self.ldr_at(camera, exposure, levels), black
        return self.tone_mapper.tone_map(drawn.image * exposure, None)[0], black
