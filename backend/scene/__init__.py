# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets: one reader per layout on disk, all returning the same ``Scene``."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...bridge.errors import FileMissingError
from . import hdr_nerf_syn
from .camera import Camera
from .scene import Points, Scene, View

__all__ = ["READERS", "Camera", "Points", "Reader", "Scene", "View", "read_scene"]


@dataclass(frozen=True)
class Reader:
    """A layout: its name, the file that gives it away, whether a folder is of it, how it is read."""

    name: str
    looks_for: str
    is_mine: Callable[[Path], bool]
    read_scene: Callable[[Path], Scene]


#: Every layout that is understood, in the order in which they are tried. A new one is one file and one line.
READERS = (Reader(hdr_nerf_syn.NAME, hdr_nerf_syn.LOOKS_FOR, hdr_nerf_syn.is_mine, hdr_nerf_syn.read_scene),)


def read_scene(root: Path | str) -> Scene:
    """Read a data set, whichever of the known layouts it has.

    Raises ``FileMissingError`` if the folder is not there or has none of the layouts, and what the layout's
    reader raises.
    """
    root = Path(root)
    remedy = "Give the folder of a data set; 'python synth/make_scene.py -- --out FOLDER' makes one."
    if not root.exists():
        raise FileMissingError(f"the data set folder {root} does not exist", remedy)
    if not root.is_dir():
        raise FileMissingError(f"{root} is a file, not the folder of a data set", remedy)
    for reader in READERS:
        if reader.is_mine(root):
            return reader.read_scene(root)
    looked_for = "; ".join(f"{reader.looks_for} ({reader.name})" for reader in READERS)
    state = "is empty" if not any(root.iterdir()) else "is not a data set"
    raise FileMissingError(f"{root} {state}: looked for {looked_for}", remedy)
