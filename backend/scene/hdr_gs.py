# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of HDR-GS's packaging of HDR-NeRF-Syn (https://github.com/caiyuanhao1998/HDR-GS).

``images/<pose>_<k>.png``, ``exr/<pose>.exr`` and ``sparse/0`` of COLMAP with one picture a pose. It has no
file of exposures (HDR-GS has five numbers in its code, wrong for some scenes): ``exposure.json`` must be
added.
"""

from pathlib import Path

from ...bridge.layouts import HDR_GS
from ...bridge.layouts.picture_files import PICTURES
from .colmap import read_poses, scene_of
from .info import ORIGINAL_ANCHOR
from .poses import check_numbers
from .scene import Scene


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder. Nothing of the true radiance is opened.

    Split as HDR-GS's: names in the order of text (0, 10, 11, … 1, 20, …), the first of each two poses is for
    training. ``downscale``: None leaves pictures as they are up to 3DGS's limit of the width. Raises what the
    reader of COLMAP's folders raises.
    """
    found = read_poses(root, root / PICTURES)
    poses = sorted(found.poses, key=lambda pose: pose.name)
    check_numbers(poses, "all", root / PICTURES)  # their truth is in one folder
    rule = "split as HDR-GS: poses in the order of their names as text, every second one is for testing"
    return scene_of(
        found,
        (poses[::2], poses[1::2], rule),
        layout=HDR_GS.name,
        anchor=ORIGINAL_ANCHOR,
        downscale=downscale,
    )
