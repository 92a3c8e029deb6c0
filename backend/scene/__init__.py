# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets: one reader per layout on disk, all returning the same ``Scene``."""

from collections.abc import Callable
from pathlib import Path

from ...bridge import layouts
from ...bridge.errors import FileMissingError
from . import colmap, gausshdr, hdr_gs, hdr_nerf_real, hdr_nerf_syn, nerf, nerfstudio
from .camera import Camera
from .picture_encodings import with_encodings
from .plausible import with_warnings
from .points import with_point_message
from .scene import Points, Scene, View

__all__ = ["READERS", "Camera", "Points", "Scene", "View", "read_scene"]


#: The reader of each layout of ``bridge.layouts``, by its name: ``read_scene(root, downscale)``.
READERS: dict[str, Callable[[Path, float | None], Scene]] = {
    layouts.HDR_NERF_SYN.name: hdr_nerf_syn.read_scene,
    layouts.HDR_NERF_REAL.name: hdr_nerf_real.read_scene,
    layouts.GAUSSHDR.name: gausshdr.read_scene,
    layouts.HDR_GS.name: hdr_gs.read_scene,
    layouts.COLMAP.name: colmap.read_scene,
    layouts.NERF.name: nerf.read_scene,
    layouts.NERFSTUDIO.name: nerfstudio.read_scene,
}


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
    layout = layouts.layout_of(root)
    if layout is not None:
        scene = with_encodings(READERS[layout.name](root, downscale), color_space)
        return with_warnings(with_point_message(scene))
    state = "is empty" if not any(root.iterdir()) else "is not a data set"
    raise FileMissingError(f"{root} {state}: looked for {layouts.looked_for()}", remedy)
