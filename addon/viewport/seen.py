# SPDX-License-Identifier: GPL-3.0-or-later
"""What training's cameras have seen: beyond it a model is a guess, and its large Gaussians flare.

A point was seen where it is within the picture of any of them; nothing is known here of what hides it. The
overlay's shader asks that of every pixel of a picture, by its depth, and dims what nobody has seen. Seen from
a training camera's place every pixel is in its own picture: nothing changes there.
"""

from collections.abc import Sequence

import numpy as np

from ...bridge.axes import OPENGL_TO_OPENCV, world_to_camera_opencv
from ...bridge.camera_list import ListedCamera
from .camera import ViewCamera

#: Places in a picture, of its half width or height: up to where it is seen for certain, and from where on a
#: point is not seen at all.
INSIDE, OUTSIDE = 1.02, 1.2
#: What is left of the light that nobody has seen.
LEAST = 0.05
#: Of so many cameras, those that look most as the view does, the shader asks whether they saw a pixel.
MOST = 64


def frustums(cameras: Sequence[ListedCamera]) -> np.ndarray:
    """``[K, 3, 4]`` float64: each maps a point (x, y, z, 1) of the cameras' space to (u·w, v·w, w), ``w`` in
    front of the camera, ``u`` and ``v`` from −1 to 1 inside its picture."""
    found = np.empty((len(cameras), 3, 4))
    for rows, each in zip(found, cameras, strict=True):
        across, down = 2.0 / each.width, 2.0 / each.height
        lens = np.array(
            [
                [across * each.fx, 0.0, across * each.cx - 1.0, 0.0],
                [0.0, down * each.fy, down * each.cy - 1.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ]
        )
        rows[:] = lens @ world_to_camera_opencv(each.camera_to_world)
    return found


def of_object(rows: np.ndarray, matrix_world: np.ndarray) -> np.ndarray:
    """Frustums ``[K, 3, 4]`` of an object's own space, for points of the world."""
    return rows @ np.linalg.inv(matrix_world)


def texels(rows: np.ndarray, camera: ViewCamera) -> np.ndarray:
    """Frustums of the world as the shader has them: ``[K, 3, 4]`` float32, for points in the space of
    ``camera`` (right, down, forward); ``MOST`` at most, those first that look most as it does."""
    here = rows @ camera.camera_to_world @ OPENGL_TO_OPENCV
    forward = here[:, 2, :3] / np.linalg.norm(here[:, 2, :3], axis=1, keepdims=True)
    away = np.linalg.norm(np.linalg.solve(here[:, :, :3], here[:, :, 3:])[..., 0], axis=1)
    order = np.argsort(away * (2.0 - forward[:, 2]), kind="stable")
    return here[order[:MOST]].astype(np.float32)
