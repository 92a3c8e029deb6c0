# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' files of Gaussians, read and written in Python alone, so that Blender has it, too."""

from .cloud import UP, SplatCloud, turned
from .reading import FORMATS, SUFFIXES, Format, format_of, read_splat_file
from .spz import write_spz

__all__ = [
    "FORMATS",
    "SUFFIXES",
    "UP",
    "Format",
    "SplatCloud",
    "format_of",
    "read_splat_file",
    "turned",
    "write_spz",
]
