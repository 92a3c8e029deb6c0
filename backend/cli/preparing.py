# SPDX-License-Identifier: GPL-3.0-or-later
"""Options shared by all kinds of ``physhdr prepare``: what to read and where to write."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from ...bridge.errors import BadValueError


@dataclass(frozen=True, kw_only=True)
class Preparing:
    """What to prepare, and where to."""

    #: Folder of the photos (JPEG, HEIC, PNG, TIFF or raw files, with brackets or without), or of a data set.
    source: tyro.conf.Positional[Path]
    #: Folder of the data set to make; same as --out.
    target: tyro.conf.Positional[Path | None] = None
    #: Folder of the data set to make; of --triangulate the PLY, by default points3d_sfm.ply in the data set.
    out: Path | None = None

    @property
    def destination(self) -> Path | None:
        """Where to write, None if not given; raises ``BadValueError`` if given twice."""
        place = self.out or self.target
        if (self.target or place) != place:
            raise BadValueError(
                f"two places to write were given: {self.target} and {self.out}", "Leave one of them out."
            )
        return place

    @property
    def folder(self) -> Path:
        """The folder to make; raises ``BadValueError``."""
        place = self.destination
        if place is None:
            raise BadValueError(
                "no folder was given for the data set",
                "Give one: physhdr prepare SOURCE DATA, or --out DATA.",
            )
        return place
