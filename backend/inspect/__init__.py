# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports the content of a data set's folder, and everything missing or damaged.

The reader (``backend/scene``) stops at the first fault, as training must. Here each file is checked by
itself, and finally the reader is called.
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
    """Check every file of a data set, in any layout.

    ``downscale``, ``color_space``: as for training (``read_scene``).
    A damaged data set raises no errors; they are part of the result.
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
    """Add the error that training would raise, unless it names one of the ``faulty`` files."""
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
