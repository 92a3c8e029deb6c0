# SPDX-License-Identifier: GPL-3.0-or-later
"""What all kinds of ``physhdr export`` share: their options. Without torch, which a file needs none of."""

from dataclasses import dataclass
from pathlib import Path

import tyro

#: Suffixes of a web page in one file.
PAGE = (".html", ".htm")


@dataclass(frozen=True, kw_only=True)
class Exporting:
    """What is exported, and where to."""

    #: Folder of the run, or a file of Gaussians, for a web page a model file that was exported.
    source: tyro.conf.Positional[Path]
    #: A file, whose suffix decides (.html: a web page), or a folder; default: the run's own.
    out: tyro.conf.Positional[Path | None] = None
    #: The data set of a run, where it has moved since training.
    data: Path | None = None
    #: Say how far it is, and the result or the error, as JSON, an object a line.
    json: bool = False


@dataclass(frozen=True, kw_only=True)
class BakedLook:
    """Of all but web pages: what display colours, or the radiance of USD, are made with."""

    #: Exposure in EV (log2 of seconds) of a model's look (default: of the middle exposure), or of the
    #: radiance in USD (default 0: it is written as it is).
    exposure_ev: float | None = None
    #: Level of the first light, the ambient one wherever that has levels.
    lighting_level: float = 1.0
    #: Lights by name: NAME=VALUE …; those not named are at 1.
    lighting_levels: tuple[str, ...] = ()
    #: Convert colours one by one, at once, instead of fitting them to pictures from the training cameras (or
    #: --cameras): they then blend to other pictures, mostly too dark. docs/other-programs.md
    quick: bool = False
