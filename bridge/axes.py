# SPDX-License-Identifier: GPL-3.0-or-later
"""The one place where coordinate conventions are converted.

World space is Blender's everywhere: metres, Z up. A camera in Blender (and in NeRF's
``transforms.json``) looks down its −Z with +Y up ("OpenGL axes"). Rasterisers work in
"OpenCV axes": +Z forward, +Y down; COLMAP writes those. LLFF (``poses_bounds.npy``) has a
camera's axes as down, right, backwards. Only cameras are turned: the world of photographs
stays as structure from motion left it. Rotations are quaternions in wxyz order, as Blender
and 3DGS files store them. What other programs take for up is turned here, too.
"""

from typing import Literal

import numpy as np

#: Which way is up: Blender's Z; Y with Z backward, as glTF and most web viewers; or COLMAP's (Y down, Z
#: forward), as 3DGS writes what was trained from COLMAP's cameras.
Up = Literal["z", "y", "colmap"]

#: Turns camera coordinates from OpenGL axes into OpenCV axes (its own inverse).
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


def world_to_camera_opencv(camera_to_world: np.ndarray) -> np.ndarray:
    """The 4×4 world-to-camera matrix in OpenCV axes of a 4×4 camera-to-world matrix in OpenGL axes.

    ``camera_to_world`` must be rigid (orthonormal rotation): its inverse is taken as such.
    """
    rotation = camera_to_world[:3, :3]
    inverse = np.eye(4)
    inverse[:3, :3] = rotation.T
    inverse[:3, 3] = -rotation.T @ camera_to_world[:3, 3]
    return OPENGL_TO_OPENCV @ inverse


def camera_to_world_opengl(world_to_camera: np.ndarray) -> np.ndarray:
    """The 4×4 camera-to-world matrix in OpenGL axes of a rigid 4×4 world-to-camera matrix in OpenCV axes.

    The inverse of ``world_to_camera_opencv``; what COLMAP writes as a quaternion and a translation.
    """
    rotation = world_to_camera[:3, :3]
    inverse = np.eye(4)
    inverse[:3, :3] = rotation.T
    inverse[:3, 3] = -rotation.T @ world_to_camera[:3, 3]
    return inverse @ OPENGL_TO_OPENCV


def camera_to_world_from_llff(pose: np.ndarray) -> np.ndarray:
    """The 4×4 camera-to-world matrix in OpenGL axes of LLFF's 3×4 ``[down, right, backwards, position]``."""
    matrix = np.eye(4)
    matrix[:3] = np.stack([pose[:, 1], -pose[:, 0], pose[:, 2], pose[:, 3]], axis=1)
    return matrix


#: Columns: where Blender's X, Y and Z go in axes with another up (``Up``).
_FROM_Z = {
    "z": np.eye(3),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "colmap": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
}


def turn_of_up(there: Up, here: Up) -> np.ndarray:
    """The rotation ``[3, 3]`` that takes a point of axes with the up ``there`` into those with ``here``."""
    return _FROM_Z[here] @ _FROM_Z[there].T
