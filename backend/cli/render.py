# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr render``: which kind of picture, video or panorama is asked for; each has a module of its own."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

import torch
import tyro

from ...bridge.errors import BadValueError
from ...bridge.signals import caught, interrupt
from ..evaluate.video import ANIMATION, CONTAINERS
from .given import is_folder, of_kind
from .panorama import Panorama, PlaceOptions
from .picture import SUFFIXES, Confidence, Picture, PictureOptions, Views
from .rendering import CameraOptions, LookOptions, Rendering
from .told import answered
from .video import Video, VideoOptions


@dataclass(frozen=True, kw_only=True)
class Render(Rendering):
    """Render a trained run: a picture, a sequence, a video, all test views, or the light at a place.

    The name of --out decides what; an option that has no effect on that is refused.
    """

    #: A folder of every view of a split at every exposure, and its radiance, as physhdr evaluate --pictures
    #: takes them.
    split: Literal["test", "val"] | None = None
    #: How likely the radiance is right, instead of the radiance: --out as .exr (0 to 1) and beside it a .png
    #: with colours and a legend; with --at in all directions. docs/light.md
    confidence: bool = False
    camera: Annotated[CameraOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=CameraOptions)
    look: Annotated[LookOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LookOptions)
    picture: Annotated[PictureOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PictureOptions)
    video: Annotated[VideoOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=VideoOptions)
    place: Annotated[PlaceOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PlaceOptions)

    def run(self) -> int:
        with caught(interrupt), torch.no_grad():
            return answered(lambda: self.kind().work(), self.json)

    def kind(self) -> Picture | Views | Confidence | Video | Panorama:
        """What is asked for; raises ``BadValueError`` for an option that it does not read."""
        suffixes = {out.suffix.lower() for out in self.out if not is_folder(out)}
        if self.confidence:
            return of_kind(Confidence, self, "a picture of the confidence", "confidence")
        if self.split is not None:
            return of_kind(Views, self, "all views of a --split")
        if self.place.at:
            if suffixes & {*SUFFIXES, *CONTAINERS, ANIMATION}:
                raise BadValueError(
                    f"the light at a place is a folder of panoramas, not {self.out[0].name}",
                    "Name a folder, or add --confidence.",
                )
            return of_kind(Panorama, self, "the light at a place")
        if suffixes & {*SUFFIXES}:
            return of_kind(Picture, self, "a picture")
        return of_kind(Video, self, "a video")
