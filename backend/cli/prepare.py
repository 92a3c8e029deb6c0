# SPDX-License-Identifier: GPL-3.0-or-later
"""``physhdr prepare``: makes a data set from photos, points for a data set, or a copy for other programs."""

from dataclasses import dataclass, field
from typing import Annotated

import tyro

from ...bridge.errors import BadValueError
from ...bridge.signals import caught, interrupt
from .layout import LayOut, LayoutOptions
from .options import build_kind
from .output import run_and_report
from .photos import PhotoOptions, Photos
from .preparing import Preparing
from .triangulate import PointOptions, Triangulate


@dataclass(frozen=True, kw_only=True)
class Prepare(Preparing):
    """Make a data set from photos: exposures, cameras (COLMAP), undistorted pictures.

    With --triangulate, find points for a data set; with --layout, convert one for other programs. Options
    without effect are refused.
    """

    #: Reduce the pictures by this factor; default: 1, with --layout as training reads the data set.
    downscale: float | None = None
    #: Replace a data set, or points, that this command made before.
    overwrite: bool = False
    #: Threads for COLMAP; default: all cores.
    threads: int = -1
    #: Write progress and the result or error as JSON, one object per line.
    json: bool = False
    photos: Annotated[PhotoOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PhotoOptions)
    points: Annotated[PointOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PointOptions)
    others: Annotated[LayoutOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LayoutOptions)

    def run(self) -> int:
        with caught(interrupt):
            return run_and_report(lambda: self.kind().work(), self.json)

    def kind(self) -> Photos | Triangulate | LayOut:
        """The requested kind; raises ``BadValueError`` for an option that it does not read."""
        if self.points.triangulate and self.others.layout:
            raise BadValueError("--triangulate and --layout exclude each other", "Run them one by one.")
        if self.points.triangulate:
            return build_kind(Triangulate, self, "the points of a data set")
        if self.others.layout:
            return build_kind(LayOut, self, "a data set for other programs")
        return build_kind(Photos, self, "a data set of photos")
