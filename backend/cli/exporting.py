# SPDX-License-Identifier: GPL-3.0-or-later
"""Options shared by all kinds of ``physhdr export``. Does not import torch, which files do not need."""

from dataclasses import dataclass
from pathlib import Path

import tyro

#: Suffixes of a web page in one file.
PAGE = (".html", ".htm")


@dataclass(frozen=True, kw_only=True)
class Exporting:
    """What to export, and where to."""

    #: Folder of the run, or a file of Gaussians; for a web page, an exported model file.
    source: tyro.conf.Positional[Path]
    #: A file, whose suffix sets its type (.html: a web page), or a folder; default: the run's own.
    out: tyro.conf.Positional[Path | None] = None
    #: The data set of a run, if it has moved since training.
    data: Path | None = None
    #: Write progress and the result or error as JSON, one object per line.
    json: bool = False


@dataclass(frozen=True, kw_only=True)
class BakedLook:
    """Light and exposure of display colours, or of the radiance in USD. Not for web pages."""

    #: Exposure in EV (log2 of seconds) of display colours (default: the middle exposure), or of the radiance
    #: in USD (default 0: unchanged).
    exposure_ev: float | None = None
    #: Level of the first light, the ambient one if that has levels.
    lighting_level: float | None = None
    #: Lights by name: NAME=VALUE …; the others are as in the standard photos (mostly 1).
    lighting_levels: tuple[str, ...] = ()
    #: Convert each colour by itself instead of fitting colours to images from the training cameras (or
    #: --cameras): faster, but they blend to different, mostly darker images. docs/other-programs.md
    quick: bool = False
