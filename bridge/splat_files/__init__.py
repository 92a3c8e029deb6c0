# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers and writers of other programs' files of Gaussians, in Python alone, so that Blender has them, too."""

from pathlib import Path

from .cloud import UP, SplatCloud, Up, turned
from .spz import write_spz

__all__ = ["UP", "SplatCloud", "Up", "read_splat_file", "turned", "write_spz"]


def read_splat_file(path: Path) -> SplatCloud:
    """Read a file of Gaussians of any kind that Python alone can read, in its own axes.

    Raises ``FileMissingError``, ``FileDamagedError`` and ``BadValueError``, also for the formats that need
    the backend, with the way to convert them.
    """
    raise NotImplementedError
