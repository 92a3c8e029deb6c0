# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files of a data set's folder are pictures, by their names alone."""

from pathlib import Path

from .poses import SUFFIXES


def pictures_in(folder: Path) -> list[str]:
    """Names of the pictures in a folder and in those within, with forward slashes, in the order of names.

    What begins with a dot is none: macOS leaves ``._a.jpg`` beside ``a.jpg`` on other systems' disks.
    """
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    return sorted(path.as_posix() for path in found if not any(part.startswith(".") for part in path.parts))
