# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a data set's pictures are, by the names of files and folders alone."""

import os
import re
from pathlib import Path

from .poses import SUFFIXES


def pictures_in(folder: Path) -> list[str]:
    """Names of the pictures in a folder and in those within, with forward slashes, in the order of names.

    What begins with a dot is none: macOS leaves ``._a.jpg`` beside ``a.jpg`` on other systems' disks.
    """
    found = (path.relative_to(folder) for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    return sorted(path.as_posix() for path in found if not any(part.startswith(".") for part in path.parts))


def picture_there(path: Path) -> Path:
    """``path``; where it is not there, the file that is, named so but for ``.JPG`` in place of ``.jpg``."""
    if os.path.isfile(path):  # Path.is_file raises where a name is too long
        return path
    suffix = path.suffix.upper() if path.suffix == path.suffix.lower() else path.suffix.lower()
    other = path.with_name(path.name.removesuffix(path.suffix) + suffix)
    return other if os.path.isfile(other) else path


def reduced_folder(folder: Path) -> tuple[Path, int] | None:
    """``images_4``, and its 4, where ``images`` is not there: the least reduced; None where there is none.

    So published captures come that somebody has kept the small pictures of: 3DGS, nerfstudio and Mip-NeRF
    360 name them by their reduction.
    """
    if os.path.isdir(folder) or not os.path.isdir(folder.parent):
        return None
    named = (
        (re.fullmatch(rf"{re.escape(folder.name)}_(\d+)", path.name), path)
        for path in folder.parent.iterdir()
    )
    found = sorted((int(parts.group(1)), path) for parts, path in named if parts and path.is_dir())
    return (found[0][1], found[0][0]) if found and found[0][0] > 0 else None
