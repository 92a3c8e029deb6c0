# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare``: a data set of photos, points for a data set, or one for other programs."""

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from ...bridge.errors import BadValueError
from ...bridge.signals import caught, interrupt
from .given import of_kind
from .layout import LayOut, LayoutOptions
from .photos import PhotoOptions, Photos
from .preparing import Preparing
from .told import answered
from .triangulate import PointOptions, Triangulate


@dataclass(frozen=True, kw_only=True)
class Prepare(Preparing):
    """Make a data set from photos: exposures, cameras (COLMAP), pictures without distortion.

    With --triangulate, find points for a data set; with --layout, write one for other programs. An option
    that has no effect on that is refused.
    """

    #: Make the pictures smaller by this factor; default: 1, of --layout as training reads the data set.
    downscale: float | None = None
    #: Replace a data set, or points, that this command made before.
    overwrite: bool = False
    #: Threads for COLMAP; default: all cores.
    threads: int = -1
    #: Say everything as JSON, an object a line: progress, and at the end the result or the error.
    json: bool = False
    photos: Annotated[PhotoOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PhotoOptions)
    points: Annotated[PointOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PointOptions)
    others: Annotated[LayoutOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LayoutOptions)

    def run(self) -> int:
        with caught(interrupt):
            return answered(lambda: self.kind().work(), self.json)

    def kind(self) -> Photos | Triangulate | LayOut:
        """What is asked for; raises ``BadValueError`` for an option that it does not read."""
        if self.points.triangulate and self.others.layout:
            raise BadValueError("--triangulate and --layout make two things", "Call for one after the other.")
        if self.points.triangulate:
            return of_kind(Triangulate, self, "the points of a data set")
        if self.others.layout:
            return of_kind(LayOut, self, "a data set for other programs")
        return of_kind(Photos, self, "a data set of photos")
