# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about scenes that cannot be learned from: too near, from one place, or at one exposure."""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...bridge.errors import BadValueError
from ...bridge.splatting import NEAR_PLANE
from .camera import Camera
from .scene import Scene

#: Share of the points that cameras see which may lie before the near plane: without a warning (a few strays
#: stand in front of a lens), and without an error.
FEW_BEFORE, MOST_BEFORE = 0.01, 0.5
#: Depths are sampled: from so many cameras, of so many points, evenly chosen.
CAMERAS_SAMPLED, POINTS_SAMPLED = 32, 4096
#: Degrees across the wider side of a picture. Beyond, the focal length is likely not in pixels.
WIDEST, NARROWEST = 160.0, 0.1


def with_warnings(scene: Scene) -> Scene:
    """The scene, with warnings among its messages of what cannot be learned from it.

    Raises ``BadValueError`` where most of its points are too near to be rendered.
    """
    cameras = [view.camera for view in scene.train]
    warnings = [_one_place(cameras), _odd_lens(cameras), _one_exposure(scene)]
    if scene.points is not None:
        warnings.append(too_near(scene.root, scene.points.positions, cameras))
    return dataclasses.replace(scene, messages=(*scene.messages, *filter(None, warnings)))


def too_near(root: Path, positions: np.ndarray, cameras: Sequence[Camera]) -> str:
    """A warning about points ``[P, 3]`` before the near plane of ``cameras``; empty where there are few.

    Raises ``BadValueError`` where most of those that are seen are.
    """
    depths = _depths(positions, cameras)
    share = float((depths < NEAR_PLANE).mean()) if len(depths) else 0.0
    if share <= FEW_BEFORE:
        return ""
    middle = float(np.median(depths))
    what = (
        f"{share:.0%} of the points are nearer than {NEAR_PLANE:g} m to the cameras that see them (half of "
        f"them within {middle:.2g} m): nothing so near is drawn"
    )
    factor = 10.0 ** math.ceil(-math.log10(middle)) if 0.0 < middle < 1.0 else 10.0
    remedy = f"Make the data set larger: multiply all positions, of cameras and of points, by {factor:g}."
    if share > MOST_BEFORE:
        raise BadValueError(f"{root}: {what}", remedy)
    return f"{what}. {remedy}"


def _depths(positions: np.ndarray, cameras: Sequence[Camera]) -> np.ndarray:
    """``[D]`` metres, of points before the cameras whose pictures they are in."""
    points = positions[:: max(1, len(positions) // POINTS_SAMPLED)]
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    found = [np.empty(0)]
    for camera in cameras[:: max(1, len(cameras) // CAMERAS_SAMPLED)]:
        x, y, z = (homogeneous @ camera.world_to_camera.T)[:, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):  # beside the camera, not before it
            across = (camera.fx * x / z + camera.cx) / camera.width
            down = (camera.fy * y / z + camera.cy) / camera.height
        found.append(z[(z > 0.0) & (np.abs(across - 0.5) <= 0.5) & (np.abs(down - 0.5) <= 0.5)])
    return np.concatenate(found)


def _one_place(cameras: Sequence[Camera]) -> str:
    spread = float(np.ptp([camera.position for camera in cameras], axis=0).max()) if cameras else math.inf
    if len(cameras) < 2 or spread > NEAR_PLANE:
        return ""
    return (
        f"all {len(cameras)} training cameras are within {spread:.2g} m: if that is one place, nothing tells "
        "how far away anything is; if not, multiply all positions, because nothing within "
        f"{NEAR_PLANE:g} m is drawn"
    )


def _odd_lens(cameras: Sequence[Camera]) -> str:
    for camera in cameras:
        angle = math.degrees(2.0 * math.atan(max(camera.width / camera.fx, camera.height / camera.fy) / 2.0))
        if not NARROWEST <= angle <= WIDEST:
            return (
                f"a focal length of {camera.fx:.4g} pixels in a picture of {camera.width}×{camera.height} "
                f"sees {angle:.3g} degrees: is it given in pixels?"
            )
    return ""


def _one_exposure(scene: Scene) -> str:
    """Only for pictures that clip: a picture of radiance holds more than one exposure's range."""
    seconds = {each for view in scene.train for each in view.exposures}
    if len(seconds) != 1 or not all(encoding.clips for view in scene.train for encoding in view.encodings):
        return ""
    return (
        f"one exposure ({seconds.pop():.4g} s) for all pictures: there is no dynamic range to learn from "
        "beyond that of a single picture"
    )
