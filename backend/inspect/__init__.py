# SPDX-License-Identifier: GPL-3.0-or-later
"""What is in a data set's folder: a list of everything, with all that is missing or damaged.

The reader (``backend/scene``) stops at the first fault, as training must. Here each file is looked at by
itself, and then the reader has the last word.
"""

from pathlib import Path

from ...bridge.errors import PhysHDRError
from ...bridge.layouts import HDR_NERF_SYN, layout_of
from ...bridge.regular import resolved
from ..scene import Scene, read_scene
from .any_layout import look_at_scene
from .findings import Inspection
from .own_layout import look_at_folder

__all__ = ["inspect"]


def inspect(root: Path, downscale: float | None = None, color_space: str | None = None) -> Inspection:
    """Look at every file of a data set, in whichever layout.

    ``downscale``, ``color_space``: as training would read it (``read_scene``).
    Raises nothing that a damaged data set could cause.
    """
    root = Path(root)
    found = Inspection(str(root), scene=resolved(root).name)
    if layout_of(root) is HDR_NERF_SYN:
        faulty = look_at_folder(root, found)
        _ask_the_reader(root, downscale, color_space, found, faulty)
    elif scene := _ask_the_reader(root, downscale, color_space, found, set()):
        look_at_scene(scene, found)
    return found


def _ask_the_reader(
    root: Path, downscale: float | None, color_space: str | None, found: Inspection, faulty: set[Path]
) -> Scene | None:
    """What training would say, unless it has been said of one of the ``faulty`` files already."""
    try:
        scene = read_scene(root, downscale, color_space)
    except PhysHDRError as error:
        if not any(str(path) in error.message for path in faulty):
            found.add_fault(error.message, error.hint)
        return None
    sizes = sorted(
        ((view.camera.width, view.camera.height) for view in scene.train), key=lambda size: size[0] * size[1]
    )
    found.layout, found.messages = scene.layout, list(scene.messages)
    found.resolution, found.resolutions = sizes[(len(sizes) - 1) // 2], len(set(sizes))
    if scene.points is not None:
        found.points, found.points_origin = len(scene.points.positions), scene.points.origin
    return scene
