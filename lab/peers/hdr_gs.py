# SPDX-License-Identifier: GPL-3.0-or-later
"""HDR-GS on either backbone: a global response applied to every splat, whose LDR colours are drawn.

Each splat has ln e; its LDR colour at exposure t is f(ln e + ln t), f a network for each colour channel. HDR
pictures draw e itself. Nothing fixes the absolute scale (their code has L_unit switched off), so that HDR
figures mean something only when ``scale aligned``.

Their published figures come from training on the true HDR pictures. Here that is off; it needs a switch
and the path of the truth, and is reported at every start and in every report.
"""

import functools
import math
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

import torch
from torch.nn import functional

from ...backend.bounds import FromZero
from ...backend.kernels.activations import DARKEST
from ...backend.kernels.ahead import Needs
from ...backend.kernels.ssim import ssim_and_error
from ...backend.methods.base import (
    Batch,
    Drawn,
    MethodConfig,
    MethodSetup,
    Outcome,
    Traits,
    UnlitMethod,
    mean_terms,
)
from ...backend.methods.losses import compared
from ...backend.model.backbone import Attributes, Backbone, Splats
from ...backend.model.rates import Rate
from ...backend.model.tone_mapper import ToneMapper, ToneMapperConfig
from ...backend.rasterize import Rasterization
from ...backend.scene.camera import Camera
from ...backend.scene.source import exr_rec709
from ...backend.shell import option
from ...bridge.data_set import truth_file
from ...bridge.errors import BadValueError, FileMissingError

#: Their code makes a schedule for it that is never stepped.
TONE_MAPPER_RATE = Rate(start=5e-4)

#: Of the μ-law of their HDR loss, whose truth is rounded to so many steps.
MU, STEPS = 5000.0, 255.0


@dataclass(frozen=True, kw_only=True)
class HDRGSConfig(MethodConfig):
    """What the method is made of: one set of values for all scenes (theirs differ from scene to scene)."""

    name: ClassVar[str] = "hdr-gs"

    #: Highest degree of the spherical harmonics, 0 to 3.
    sh_degree: FromZero = 3
    tone_mapper: ToneMapperConfig = field(
        default_factory=lambda: ToneMapperConfig(
            hidden=128, activation="relu", anchored=False, initial_slope=None
        )
    )
    #: The weight of 1 − SSIM, the rest of 1 is that of the absolute difference.
    dssim_weight: float = 0.2
    #: ln e at the start: the colours of the data set's points as they are (theirs; where points have none:
    #: merged), or radiance merged from the brackets.
    initial_radiance: Literal["points", "merged"] = "points"
    #: Train with the true HDR pictures in ``hdr_truth`` (a folder of hdr_000.exr …), as the original does on
    #: synthetic scenes. What is trained so cannot be compared with methods that see pictures alone.
    hdr_supervision: bool = False
    hdr_truth: str = ""
    #: Of the HDR loss.
    hdr_weight: float = 0.6

    def __post_init__(self) -> None:
        if self.tone_mapper.local:
            raise BadValueError(
                "HDR-GS has one global curve a channel", "Leave method.tone_mapper.local false."
            )
        if not 0 <= self.sh_degree <= 3:
            raise BadValueError(f"{option('method.sh_degree')} must be from 0 to 3, got {self.sh_degree}")
        if self.hdr_supervision != bool(self.hdr_truth):
            raise BadValueError(
                "training with true HDR pictures is off unless it is asked for twice",
                "Give both --set method.hdr_supervision=true --set method.hdr_truth=FOLDER, or neither.",
            )

    @property
    def traits(self) -> Traits:
        # Of a view at half its size the true HDR picture is not known.
        return Traits(
            half_sizes=not self.hdr_supervision,
            initial_radiance=self.initial_radiance,
            develops_splats=True,
        )

    def attributes(self, lights: tuple[str, ...]) -> Attributes:
        return Attributes(sh_degree=self.sh_degree)

    def kernels_needed(self) -> Needs:
        return Needs(channels=(3,), activations=(self.tone_mapper.activation,))


class HDRGS(UnlitMethod):
    """The method: a backbone and a global tone mapper."""

    def __init__(self, config: HDRGSConfig, backbone: Backbone, setup: MethodSetup) -> None:
        super().__init__(config, backbone, setup)
        self.config = config
        setup.refuse_known("HDR-GS")
        self.tone_mapper = ToneMapper(config.tone_mapper, setup.anchor)

    @property
    def remarks(self) -> tuple[str, ...]:
        if not self.config.hdr_supervision:
            return ()
        return (
            f"Trained with HDR ground truth from {self.config.hdr_truth}: these figures cannot be compared "
            "with those of methods that see pictures alone.",
        )

    @property
    def first_response(self) -> ToneMapper:
        """f where it is warm-started; else ``default``'s at its start: a random one knows no pictures."""
        if self.config.tone_mapper.warm_start_steps:
            return self.curves
        with torch.random.fork_rng(devices=[]):  # what is drawn here is nobody's
            return ToneMapper(ToneMapperConfig(anchored=False), None)

    def prepare(self, seed: int) -> None:
        super().prepare(seed)
        for remark in self.remarks:
            warnings.warn(remark, stacklevel=2)

    def rates(self) -> dict[str, Rate]:
        return super().rates() | {"tone_mapper": TONE_MAPPER_RATE}

    # -- the forward pass --------------------------------------------------------------------------------

    def colours(self, splats: Splats, exposure: float) -> torch.Tensor:
        """LDR colours ``[M, 3]`` in (0, 1) at ``exposure`` seconds."""
        log_exposure = (self.log_radiance(splats) + math.log(exposure)).T.contiguous()
        return self.curves.response(log_exposure).T

    # -- training ----------------------------------------------------------------------------------------

    def training_outcome(self, batch: Batch) -> Outcome:
        """One drawing of LDR colours for each exposure of the batch; growth watches them, and nothing else.

        The radiance is drawn for the HDR loss alone, apart, so that growth does not see its gradient.
        """
        splats = self.backbone.splats(batch.camera, self.active_sh_degree)
        offsets, each, drawn = self.watched(splats), [], None
        for recording in batch.recordings:
            colours = self.colours(splats, recording.exposure)
            drawn = self.rasterize(splats, colours, batch.camera, screen_offsets=offsets)
            image, picture = (compared(p, recording.mask) for p in (drawn.image, recording.picture))
            each.append({"rec": self.difference(image, picture)})
        assert drawn is not None
        terms = mean_terms(each) | self.backbone_terms(splats)
        if self.config.hdr_supervision:
            hdr = self.rasterize(splats, self.radiance_of(splats, None), batch.camera).image
            truth = compressed_truth(Path(self.config.hdr_truth), batch.index, *hdr.shape[1:])
            terms["hdr"] = self.config.hdr_weight * self.difference(compressed(hdr), truth.to(hdr))
        return Outcome(terms, Drawn(splats, drawn, offsets))

    def difference(self, image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        """(1 − λ) · mean |x − y| + λ (1 − SSIM) of pictures ``[3, H, W]``."""
        similarity, pixel = ssim_and_error(image, target, "l1")
        part = self.config.dssim_weight
        return (1.0 - part) * pixel + part * (1.0 - similarity)

    # -- use ---------------------------------------------------------------------------------------------

    def ldr_at(self, camera: Camera, exposure: float, levels: tuple[float, ...]) -> torch.Tensor:
        """A level scales the radiance, as an exposure does."""
        splats = self.backbone.splats(camera, self.active_sh_degree)
        return self.rasterize(splats, self.colours(splats, exposure * max(levels[0], DARKEST)), camera).image

    def preview_ldr_at(
        self, drawn: Rasterization, camera: Camera, exposure: float, levels: tuple[float, ...]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        # Colours are blended after the response: where nothing is, nothing is added.
        return self.ldr_at(camera, exposure, levels), drawn.image.new_zeros(3, 1, 1)


# ---- HDR supervision: the original's, and no part of a benchmark -------------------------------------------


def compressed(radiance: torch.Tensor) -> torch.Tensor:
    """μ-law of a picture ``[3, H, W]`` over its own largest value: ln(1 + μ x) / ln(1 + μ)."""
    relative = radiance.clamp_min(0.0) / radiance.max().clamp_min(DARKEST)
    return torch.log1p(MU * relative) / math.log1p(MU)


@functools.lru_cache(maxsize=256)
def compressed_truth(folder: Path, index: int, height: int, width: int) -> torch.Tensor:
    """``compressed`` true radiance ``[3, H, W]`` of a pose, rounded to 8 bit; raises ``FileMissingError``."""
    path = folder / truth_file(index)
    if not path.is_file():
        raise FileMissingError(
            f"there is no true HDR picture {path}",
            "Name the folder of train_hdr's EXR files by --set method.hdr_truth, or leave supervision off.",
        )
    radiance = torch.from_numpy(exr_rec709(path).copy()).permute(2, 0, 1).float()
    reduced = functional.interpolate(radiance[None], (height, width), mode="area")[0]
    return (compressed(reduced) * STEPS).round() / STEPS
