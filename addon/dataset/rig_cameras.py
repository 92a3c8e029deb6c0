# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the cameras of a data set of the open scene would stand, and the lines that show them."""

from dataclasses import dataclass
from types import SimpleNamespace

import bpy
import numpy as np

from ...synth import rig, user_camera
from ...synth.blender import camera_of, evaluated
from ...synth.rays import Rays
from . import dataset_command

#: So many cameras of a kind are drawn at most, evenly chosen.
MOST = 400
#: The depth of a drawn camera, as a share of the distance to what the rig looks at.
DEPTH = 0.06
#: Corners of a picture, counterclockwise from the upper right, in halves of its size.
_CORNERS = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
#: Over the upper edge: which way is up. In halves of the picture's height.
_TIP = np.array([(0.0, 1.5)])
#: Ends of the lines: the eye is 0, the corners 1 … 4, the tip 5.
_LINES = np.array([(0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1), (1, 5), (2, 5)])


@dataclass(frozen=True, eq=False)
class RigCameras:
    """The cameras of a data set: camera to world ``[N, 4, 4]`` of each split, in Blender's axes."""

    train: np.ndarray
    test: np.ndarray
    lit: np.ndarray
    #: Horizontal field of view in radians, and height over width.
    angle_x: float
    aspect: float
    #: Metres from the user's camera to what the rig looks at.
    distance: float


def of(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, chosen: SimpleNamespace) -> RigCameras:
    """The cameras that synth would take, by its own code; the scene stays as it is. Not from a draw handler:
    of the camera's animation another scene is made for a moment.

    Raises ``PhysHDRError`` where there can be none.
    """
    camera = user_camera.checked(scene)
    options = dataset_command.camera_options(chosen, scene)
    centre = user_camera.pose(camera.evaluated_get(evaluated(layer)))
    distance = options.rig_distance
    if distance is None:
        size = options.resolution
        distance, _ = user_camera.target_distance(camera, centre, Rays(scene, layer), size)
    if options.camera_rig == rig.PATH:
        poses = user_camera.path(scene, camera, options, aside=True)
    else:
        hints = user_camera.hints(camera, centre, distance, options)
        poses = rig.poses(options.camera_rig, hints, options.views, options.lit_views)
    width, height = options.resolution
    return RigCameras(
        *(np.array(each, np.float64).reshape(-1, 4, 4) for each in (poses.train, poses.test, poses.lit)),
        angle_x=user_camera.angle_x(camera_of(camera), options.resolution),
        aspect=height / width,
        distance=distance,
    )


def frustums(poses: np.ndarray, angle_x: float, aspect: float, depth: float) -> np.ndarray:
    """``[N, 10, 2, 3]``: the ends of the lines that draw cameras ``[N, 4, 4]``: four from the eye to the
    corners of the picture at ``depth`` metres, its four edges, and two to a tip above it.

    ``angle_x``: horizontal field of view in radians; ``aspect``: height over width.
    """
    half = np.tan(angle_x / 2.0) * depth
    plane = np.concatenate([_CORNERS, _TIP]) * [half, half * aspect]
    ends = np.zeros((len(plane) + 1, 3))
    ends[1:, :2], ends[1:, 2] = plane, -depth  # a camera looks down its −Z
    placed = np.einsum("nij,kj->nki", poses[:, :3, :3], ends) + poses[:, None, :3, 3]
    return placed[:, _LINES]


def thinned(poses: np.ndarray, most: int = MOST) -> np.ndarray:
    """At most so many of ``[N, 4, 4]``, evenly chosen."""
    return poses if len(poses) <= most else poses[rig.spread_indices(len(poses), most)]
