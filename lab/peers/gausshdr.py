# SPDX-License-Identifier: GPL-3.0-or-later
"""GaussHDR on either backbone: local tone mapping of splats and of pixels, fused by their uncertainties.

Every splat has ln e and a context feature; one tone mapper, with a local correction and an uncertainty, is
used twice. **3-D**: on each splat, whose LDR colour and uncertainty are drawn. **2-D**: on each pixel of the
drawn radiance and context. One pass of the rasteriser draws all that both need, a small one the uncertainty,
whose likelihood then teaches nothing else. The facts are those of the released code, which has Scaffold-GS's
backbone only; lab/peers.md names what its paper has otherwise.
"""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import nn

from ...backend.bounds import FromZero
from ...backend.kernels.activations import DARKEST
from ...backend.kernels.ahead import Needs
from ...backend.kernels.local_curves import local_curves
from ...backend.kernels.plain import can_fuse
from ...backend.kernels.pointwise import log_of_exposure
from ...backend.kernels.ssim import SsimTarget, ssim_and_error, ssim_map
from ...backend.methods.base import Batch, Drawn, MethodConfig, MethodSetup, Outcome, Traits, UnlitMethod
from ...backend.methods.losses import compared
from ...backend.model.backbone import Attributes, Backbone, Splats
from ...backend.model.radiance import SmallNetwork
from ...backend.model.rates import Rate
from ...backend.model.tone_mapper import LOG_EPSILON, ToneMapper, ToneMapperConfig
from ...backend.rasterize import Rasterization
from ...backend.scene.camera import Camera
from ...backend.shell import option
from ...bridge.errors import BadValueError

#: Of the tone mapper with its uncertainty.
TONE_MAPPER_RATE = Rate(start=5e-4, final=5e-5, shape="exponential")


@dataclass(frozen=True, kw_only=True)
class GaussHDRConfig(MethodConfig):
    """What the method is made of: the released code's values."""

    name: ClassVar[str] = "gausshdr"

    #: Highest degree of the spherical harmonics, 0 to 3.
    sh_degree: FromZero = 3
    #: Softplus bends the global curve: by a remark in their code better for synthetic scenes on 3DGS; they
    #: use ReLU elsewhere. The local curves and the uncertainty are always of ReLU.
    tone_mapper: ToneMapperConfig = field(
        default_factory=lambda: ToneMapperConfig(
            anchored=False, initial_slope=None, local=True, warm_start_steps=1000
        )
    )
    #: ℓ: this weight for 1 − SSIM, the rest of 1 for the absolute difference.
    dssim_weight: float = 0.2
    #: Of both uncertainties' likelihoods (the code has 1, the paper reportedly ½).
    uncertainty_weight: float = 1.0
    #: Let the likelihood of the 3-D uncertainty move and fade the splats it is drawn with. The network's
    #: inputs are kept from learning of it; through the drawing it costs 4.7 dB (lab/notebook.md).
    uncertainty_moves_splats: bool = False
    #: No uncertainty is smaller.
    least_uncertainty: float = 0.1
    #: γ, of ℓ of the 2-D global picture, where the data name an anchor of the response (synthetic scenes) …
    global_weight_anchored: float = 0.5
    #: … and where they do not (real ones).
    global_weight: float = 0.2
    #: Of L_unit, where the data name an anchor.
    unit_weight: float = 0.5
    #: The share of the training in which global curves stand in for the local ones (the paper: 6 k of 30 k
    #: iterations; the code: none).
    global_until: float = 0.0

    def __post_init__(self) -> None:
        if not self.tone_mapper.local:
            raise BadValueError(
                "GaussHDR has local curves",
                "Leave method.tone_mapper.local true.",
            )
        if not 0 <= self.sh_degree <= 3:
            raise BadValueError(f"{option('method.sh_degree')} must be from 0 to 3, got {self.sh_degree}")
        if self.least_uncertainty <= 0.0:
            raise BadValueError(f"the least uncertainty must be above 0, got {self.least_uncertainty}")

    @property
    def traits(self) -> Traits:
        # The splats have another colour at each exposure.
        return Traits(brackets_at_once=False, develops_splats=True)

    @property
    def channels(self) -> int:
        """How many the pass draws: 3-D LDR, radiance, context, and uncertainty if it moves splats."""
        return 6 + self.tone_mapper.context_size + (3 if self.uncertainty_moves_splats else 0)

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        return Attributes(sh_degree=self.sh_degree, context_size=self.tone_mapper.context_size)

    def kernels_needed(self) -> Needs:
        return Needs(
            channels=tuple(sorted({3, self.channels})),  # three: uncertainty, and the view that is shown
            activations=(self.tone_mapper.activation,),
            local_branches=(1, 3),  # the curves of each channel; the uncertainty of all three
        )


class Uncertainty(nn.Module):
    """u = max(softplus(network(x, context)), ``least``): one network for all channels, which learns no input.

    The code makes three networks and asks only the red channel's.
    """

    def __init__(self, config: ToneMapperConfig, least: float) -> None:
        super().__init__()
        self.network = SmallNetwork(1 + config.context_size, config.hidden, 1)
        self.least = least

    def forward(self, log_exposure: torch.Tensor, context: torch.Tensor) -> torch.Tensor:
        """``log_exposure`` ``[3, …]``, ``context`` ``[K, …]`` → u ``[3, …]``."""
        n = self.network
        # The three channels are like three branches that share a context.
        x = log_exposure.detach().reshape(1, 3, -1)
        features = context.detach().reshape(context.shape[0], -1)
        u = local_curves(x, features, n.w1[None], n.b1[None], n.w2, n.b2)
        return nn.functional.softplus(u).clamp_min(self.least).reshape(log_exposure.shape)


def held(splats: Splats) -> Splats:
    """The same splats, whose shape and opacity learn nothing from what is drawn with them."""
    shape = {name: getattr(splats, name).detach() for name in ("means", "quaternions", "scales", "opacities")}
    return dataclasses.replace(splats, **shape)


@dataclass(frozen=True)
class Half:
    """The LDR picture of one of the two ways, and its uncertainty, both ``[3, H, W]``."""

    ldr: torch.Tensor
    uncertainty: torch.Tensor


@dataclass(frozen=True)
class DrawnPicture(Drawn):
    """One pass and what a camera records of it: by the 3-D and by the 2-D way, and fused.

    ``weight`` ``[3, H, W]``: of the 3-D way. ``global_2d``: the 2-D way without local correction.
    """

    in_3d: Half | None = None
    in_2d: Half | None = None
    global_2d: torch.Tensor | None = None
    weight: torch.Tensor | None = None

    @property
    def ldr(self) -> torch.Tensor:
        """The picture that is reported."""
        assert self.in_3d is not None and self.in_2d is not None and self.weight is not None
        return torch.lerp(self.in_2d.ldr, self.in_3d.ldr, self.weight)


class GaussHDR(UnlitMethod):
    """The method: a backbone, a tone mapper and the network of its uncertainty."""

    def __init__(self, config: GaussHDRConfig, backbone: Backbone, setup: MethodSetup) -> None:
        super().__init__(config, backbone, setup)
        self.config = config
        setup.refuse_known("GaussHDR")
        self.tone_mapper = ToneMapper(config.tone_mapper, setup.anchor)
        self.uncertainty = Uncertainty(config.tone_mapper, config.least_uncertainty)
        self.uses_local = True

    def network_groups(self) -> dict[str, list[torch.Tensor]]:
        groups = super().network_groups()
        return groups | {"tone_mapper": [*groups["tone_mapper"], *self.uncertainty.parameters()]}

    def rates(self) -> dict[str, Rate]:
        return super().rates() | {"tone_mapper": TONE_MAPPER_RATE}

    def follow_schedule(self, iteration: int, iterations: int, sh_degree_every: int) -> None:
        super().follow_schedule(iteration, iterations, sh_degree_every)
        self.uses_local = iteration >= self.config.global_until * iterations

    # -- the forward pass --------------------------------------------------------------------------------

    def respond(
        self, log_exposure: torch.Tensor, context: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """The tone mapper of both ways: global and local LDR, and u.

        ``log_exposure`` ``[3, 1, M]`` of splats or ``[3, H, W]`` of pixels, ``context`` ``[K, M]`` or
        ``[K, H, W]``. The local one is clip(global + Δ − ½, 0, 1).
        """
        glo, loc = self.curves.tone_map_log(log_exposure, context)
        assert loc is not None
        return glo, loc if self.uses_local else glo, self.uncertainty(log_exposure, context)

    def draw(self, camera: Camera, exposure: float, watch: bool = False) -> DrawnPicture:
        """What a camera with ``exposure`` seconds records. ``watch``: for growth."""
        splats = self.backbone.splats(camera, self.active_sh_degree)
        assert splats.context is not None
        log_radiance = self.log_radiance(splats)
        log_exposure = (log_radiance + math.log(exposure)).T.contiguous()[:, None]
        _, colours, uncertainty = self.respond(log_exposure, splats.context.T.contiguous())
        # The code draws the splats' global LDR as well, which nothing uses.
        channels = [colours[:, 0].T, log_radiance.exp(), splats.context]
        if self.config.uncertainty_moves_splats:
            channels.append(uncertainty[:, 0].T)
        offsets = self.watched(splats) if watch else None
        drawn = self.rasterize(splats, torch.cat(channels, dim=1), camera, screen_offsets=offsets)
        # Split, not sliced: the gradient of a slice is a whole picture of zeros with the slice in it.
        ldr_3d, radiance, context, *rest = drawn.image.split([c.shape[1] for c in channels])
        uncertainty_3d = rest[0] if rest else self.rasterize(held(splats), uncertainty[:, 0].T, camera).image
        in_3d, in_2d, global_2d, weight = self.develop(ldr_3d, uncertainty_3d, radiance, context, exposure)
        return DrawnPicture(
            splats, drawn, offsets, in_3d=in_3d, in_2d=in_2d, global_2d=global_2d, weight=weight
        )

    def develop(
        self,
        ldr_3d: torch.Tensor,
        uncertainty_3d: torch.Tensor,
        radiance: torch.Tensor,
        context: torch.Tensor,
        exposure: float,
    ) -> tuple[Half, Half, torch.Tensor, torch.Tensor]:
        """The drawn channels ``[…, H, W]`` → both ways, the 2-D global picture, and the 3-D way's weight.

        Each way weighs as much as the other one is uncertain: (u₂² I₃ + u₃² I₂) / (u₂² + u₃²), where the
        weight itself learns nothing.
        """
        least = self.config.least_uncertainty
        global_2d, ldr_2d, uncertainty_2d = self.respond(
            log_of_exposure(radiance * exposure, LOG_EPSILON), context
        )
        in_3d = Half(ldr_3d, uncertainty_3d.clamp_min(least))
        in_2d = Half(ldr_2d, uncertainty_2d)
        with torch.no_grad():
            square_3d, square_2d = in_3d.uncertainty.square(), in_2d.uncertainty.square()
            weight = square_2d / (square_2d + square_3d)
        return in_3d, in_2d, global_2d, weight

    # -- training ----------------------------------------------------------------------------------------

    def training_outcome(self, batch: Batch) -> Outcome:
        (recording,) = batch.recordings
        drawn = self.draw(batch.camera, recording.exposure, watch=True)
        terms = self.losses(drawn, recording.picture, recording.mask)
        return Outcome(terms | self.backbone_terms(drawn.splats), drawn)

    def losses(
        self, drawn: DrawnPicture, picture: torch.Tensor, mask: torch.Tensor | None = None
    ) -> dict[str, torch.Tensor]:
        """The weighted terms of the loss for a picture ``[3, H, W]`` in [0, 1]; their sum is minimised.

        ``mask``: which of its pixels are compared, ``[H, W]`` bool; None: all.

        ``rec``: mean of w ℓ₃ + (1 − w) ℓ₂. ``uncertainty``: Σ over both ways of mean D / 2u² + ½ ln u, a
        likelihood of D = 1 − SSIM, through which D learns nothing. ``global``: ℓ of the 2-D global picture.
        """
        config, anchor = self.config, self.curves.anchor
        assert drawn.in_3d is not None and drawn.in_2d is not None
        assert drawn.global_2d is not None and drawn.weight is not None
        picture = compared(picture, mask)
        target = SsimTarget(picture) if can_fuse(picture) else picture
        part, pixel_part = config.dssim_weight, 1.0 - config.dssim_weight
        rec, likelihoods = [], []
        for half, weight in ((drawn.in_3d, drawn.weight), (drawn.in_2d, 1.0 - drawn.weight)):
            image, u = compared(half.ldr, mask), half.uncertainty
            dissimilarity = 1.0 - ssim_map(image, target)
            error = pixel_part * (image - picture).abs() + part * dissimilarity
            rec.append((weight * error).mean())
            likelihood = dissimilarity.detach() / (2.0 * u * u) + 0.5 * u.log()
            likelihoods.append(compared(likelihood, mask).mean())
        similarity, pixel = ssim_and_error(compared(drawn.global_2d, mask), target, "l1")
        gamma = config.global_weight if anchor is None else config.global_weight_anchored
        terms = {
            "rec": rec[0] + rec[1],
            "uncertainty": config.uncertainty_weight * (likelihoods[0] + likelihoods[1]),
            "global": gamma * (pixel_part * pixel + part * (1.0 - similarity)),
        }
        if anchor is not None and config.unit_weight:
            terms["unit"] = config.unit_weight * self.curves.unit_exposure_error()
        return terms

    # -- use ---------------------------------------------------------------------------------------------

    def ldr_at(self, camera: Camera, exposure: float, levels: tuple[float, ...]) -> torch.Tensor:
        """A level scales the radiance, as an exposure does."""
        return self.draw(camera, exposure * max(levels[0], DARKEST)).ldr

    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        nothing = drawn.image.new_zeros(3, 1, 1)
        context = drawn.image.new_zeros(self.config.tone_mapper.context_size, 1, 1)
        in_3d, in_2d, _, weight = self.develop(nothing, nothing, nothing, context, exposure)
        return self.ldr_at(camera, exposure, levels), torch.lerp(in_2d.ldr, in_3d.ldr, weight)
