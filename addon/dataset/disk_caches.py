# SPDX-License-Identifier: GPL-3.0-or-later
"""Point caches that lie beside the .blend file, for a copy of it that lies elsewhere.

Blender looks for them in a folder beside the file that is open, named as that file is. Of all else that is
baked to a disk (liquids, simulation nodes) the file has the path, which saving the copy makes fit.
"""

import os
import shutil
from contextlib import suppress
from pathlib import Path

import bpy


def bring(copy: Path) -> None:
    """Put the open file's caches beside a copy of it: a folder of links, or of copies where none can be made.

    Links to the files, not one to their folder: whoever removes the copy's folder, as Blender does when it
    ends, and whoever simulates anew, for which Blender removes a file before it writes it, removes links.

    Raises ``OSError``, as where a copy does not fit on the disk.
    """
    if not bpy.data.filepath:
        return
    folder = _folder(Path(bpy.data.filepath).absolute())
    if folder.is_dir():
        place = _folder(copy)
        place.mkdir()
        for file in folder.iterdir():
            if file.is_file():
                _link(file, place / file.name)


def _folder(file: Path) -> Path:
    return file.with_name(f"blendcache_{file.stem}")


def _link(file: Path, place: Path) -> None:
    """A link, for which Windows wants a right; else a second name of the file, if both are on one disk."""
    for make in (os.symlink, os.link):
        with suppress(OSError):
            make(file, place)
            return
    shutil.copyfile(file, place)
