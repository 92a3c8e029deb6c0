# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets: one reader per layout on disk, all returning the same ``Scene``."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ...bridge.errors import FileMissingError
from . import colmap, gausshdr, hdr_gs, hdr_nerf_real, hdr_nerf_syn, nerf, nerfstudio
from .camera import Camera
from .meaning import with_meaning
from .plausible import with_warnings
from .points import with_words_of_points
from .scene import Points, Scene, View

__all__ = ["READERS", "Camera", "Points", "Reader", "Scene", "View", "read_scene"]


@dataclass(frozen=True)
class Reader:
    """A layout: its name, the file that gives it away, whether a folder is of it, how it is read.

    ``read_scene(root, downscale)``: as the function of this module, of a folder that is of this layout.
    """

    name: str
    looks_for: str
    is_mine: Callable[[Path], bool]
    read_scene: Callable[[Path, float | None], Scene]


#: Every layout that is understood, in the order in which they are tried. A new one is one file and one line.
READERS = tuple(
    Reader(module.NAME, module.LOOKS_FOR, module.is_mine, module.read_scene)
    for module in (hdr_nerf_syn, hdr_nerf_real, gausshdr, hdr_gs, colmap, nerf, nerfstudio)
)


def read_scene(root: Path | str, downscale: float | None = None, color_space: str | None = None) -> Scene:
    """Read a data set, whichever of the known layouts it has.

    ``downscale``: how many times smaller on each side pictures become when they are decoded; None is the
    layout's published convention (docs/formats.md), and 1 for our own data sets. ``color_space``: of pictures
    that hold radiance (OpenEXR, .hdr); None is what each file says.

    Raises ``FileMissingError`` if the folder is not there or has none of the layouts, and what the layout's
    reader raises.
    """
    root = Path(root)
    remedy = (
        "Give the folder of a data set (docs/formats.md). Of photos, 'physhdr prepare PHOTOS FOLDER' makes "
        "one; 'python synth/make_scene.py -- --out FOLDER' renders one."
    )
    if not root.exists():
        raise FileMissingError(f"the data set folder {root} does not exist", remedy)
    if not root.is_dir():
        raise FileMissingError(f"{root} is a file, not the folder of a data set", remedy)
    for reader in READERS:
        if reader.is_mine(root):
            scene = with_meaning(reader.read_scene(root, downscale), color_space)
            return with_warnings(with_words_of_points(scene))
    looked_for = "; ".join(f"{reader.looks_for} ({reader.name})" for reader in READERS)
    state = "is empty" if not any(root.iterdir()) else "is not a data set"
    raise FileMissingError(f"{root} {state}: looked for {looked_for}", remedy)
