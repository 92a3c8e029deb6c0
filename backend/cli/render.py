# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render``: chooses the kind of picture, video or panorama; each has its own module."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import torch
import tyro

from ...bridge.errors import BadValueError
from ...bridge.signals import caught, interrupt
from ..evaluate.video import ANIMATION, CONTAINERS
from .options import build_kind, is_folder
from .output import run_and_report
from .panorama import Panorama, PlaceOptions
from .picture import SUFFIXES, Confidence, Picture, PictureOptions, Views
from .rendering import CameraOptions, LookOptions, Rendering
from .video import Video, VideoOptions


@dataclass(frozen=True, kw_only=True)
class Render(Rendering):
    """Render a trained run: a picture, a sequence, a video, all test views, or the light at a place.

    The name of --out sets the kind; options without effect are refused.
    """

    #: Render every view of a split at every exposure, and its radiance, for physhdr evaluate --pictures.
    split: Literal["test", "val"] | None = None
    #: Render how likely the radiance is right: --out as .exr (0 to 1), and a .png with colours and a legend
    #: next to it; with --at in all directions. docs/light.md
    confidence: bool = False
    camera: Annotated[CameraOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=CameraOptions)
    look: Annotated[LookOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LookOptions)
    picture: Annotated[PictureOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PictureOptions)
    video: Annotated[VideoOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=VideoOptions)
    place: Annotated[PlaceOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PlaceOptions)

    def run(self) -> int:
        with caught(interrupt), torch.no_grad():
            return run_and_report(lambda: self.kind().work(), self.json)

    def kind(self) -> Picture | Views | Confidence | Video | Panorama:
        """The requested kind; raises ``BadValueError`` for an option that it does not read."""
        suffixes = {out.suffix.lower() for out in self.out if not is_folder(out)}
        if self.confidence:
            return build_kind(Confidence, self, "a picture of the confidence", "confidence")
        if self.split is not None:
            return build_kind(Views, self, "all views of a --split")
        if self.place.at:
            if suffixes & {*SUFFIXES, *CONTAINERS, ANIMATION}:
                raise BadValueError(
                    f"the light at a place is a folder of panoramas, not {self.out[0].name}",
                    "Give a folder, or add --confidence.",
                )
            return build_kind(Panorama, self, "the light at a place")
        if suffixes & {*SUFFIXES}:
            return build_kind(Picture, self, "a picture")
        return build_kind(Video, self, "a video")
