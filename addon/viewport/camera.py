# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera of a 3D view as a pinhole in pixels: what rasterisers want.

Blender gives two matrices for a region: ``view_matrix`` (world to camera, looks down −Z) and
``window_matrix`` (camera to clip space). The second holds everything about the picture: focal length,
lens shift, the camera view's frame, zoom and offset. So nothing else has to be asked.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ...bridge.axes import OPENGL_TO_OPENCV, world_to_camera_opencv

if TYPE_CHECKING:
    import bpy
    import mathutils

    #: 4×4, row by row.
    Rows = Sequence[Sequence[float]] | np.ndarray | mathutils.Matrix

ORTHOGRAPHIC_HINT = (
    "The view is orthographic; the backend draws perspective only. Press numpad 5, or look through a "
    "perspective camera."
)


#: A view that turns by more (here 30°), or moves by more of the distance to what it shows, has jumped.
JUMP_COSINE, JUMP_SHARE = math.sqrt(0.75), 0.5


@dataclass(frozen=True, eq=False)
class ViewCamera:
    """A pinhole (or orthographic) camera: pose in Blender's world, intrinsics in pixels.

    ``camera_to_world``: ``[4, 4]`` float64, rigid; looks down −Z, +Y up. ``fx, fy, cx, cy``: pixels; the
    centre of the top left pixel is at (0.5, 0.5). With ``is_orthographic``, ``fx`` and ``fy`` are pixels
    per metre, and no rasteriser of the backend can draw it (``ORTHOGRAPHIC_HINT`` says so to people).
    """

    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    is_orthographic: bool = False

    @property
    def world_to_camera(self) -> np.ndarray:
        """``[4, 4]`` float64, OpenCV axes (+Z forward, +Y down): what rasterisers use."""
        return world_to_camera_opencv(self.camera_to_world)

    @property
    def key(self) -> tuple[bytes, tuple[float, ...]]:
        """Equal for cameras that give the same picture; hashable."""
        intrinsics = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.is_orthographic)
        return self.camera_to_world.tobytes(), intrinsics

    def resized(self, width: int, height: int) -> "ViewCamera":
        """The same view on another number of pixels (at least 1 by 1); they need not stay square."""
        width, height = max(1, width), max(1, height)
        x, y = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * x,
            fy=self.fy * y,
            cx=self.cx * x,
            cy=self.cy * y,
        )

    def scaled(self, factor: float) -> "ViewCamera":
        """The same view with ``factor`` times as many pixels along each side."""
        return self.resized(round(self.width * factor), round(self.height * factor))

    def within(self, side: int, pixels: int) -> "ViewCamera":
        """The same view on so many pixels at most, ``side`` along each side and ``pixels`` in all."""
        fits = min(side / max(self.width, self.height), math.sqrt(pixels / (self.width * self.height)))
        # Rounded down: not one pixel more.
        return self if fits >= 1.0 else self.resized(int(self.width * fits), int(self.height * fits))

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels ``[N, 2]`` (x right, y down) and depths ``[N]`` in metres of world points ``[N, 3]``."""
        view = self.world_to_camera
        in_camera = points @ view[:3, :3].T + view[:3, 3]
        depth = in_camera[:, 2]
        on_plane = in_camera[:, :2] if self.is_orthographic else in_camera[:, :2] / depth[:, None]
        return on_plane * (self.fx, self.fy) + (self.cx, self.cy), depth


def from_matrices(
    view_matrix: "Rows",
    window_matrix: "Rows",
    width: int,
    height: int,
) -> ViewCamera:
    """The camera of a region of ``width`` by ``height`` pixels with these 4×4 matrices (rows).

    ``view_matrix`` must be rigid, as Blender's are. A point (X, Y, −d) in the camera's space is at
    x = (m00 X/d − m02 + 1) · width/2 from the left, y the same from the bottom.
    """
    view = np.array(view_matrix, np.float64)
    window = np.array(window_matrix, np.float64)
    camera_to_world = np.eye(4)
    # Blender's matrices are float32: rigid to 1e-7, and readers check for 1e-3.
    camera_to_world[:3, :3] = view[:3, :3].T
    camera_to_world[:3, 3] = -view[:3, :3].T @ view[:3, 3]
    is_orthographic = window[3, 3] != 0.0
    # Where the optical axis meets the picture, in clip space, y up.
    axis_x, axis_y = (window[0, 3], window[1, 3]) if is_orthographic else (-window[0, 2], -window[1, 2])
    return ViewCamera(
        camera_to_world,
        width,
        height,
        fx=0.5 * width * window[0, 0],
        fy=0.5 * height * window[1, 1],
        cx=0.5 * width * (1.0 + axis_x),
        cy=0.5 * height * (1.0 - axis_y),
        is_orthographic=bool(is_orthographic),
    )


def of_region(region: "bpy.types.Region", rv3d: "bpy.types.RegionView3D") -> ViewCamera:
    """The camera through which a 3D view's region is seen: user view or camera view alike."""
    return from_matrices(rv3d.view_matrix, rv3d.window_matrix, region.width, region.height)


def object_to_camera(camera: ViewCamera, matrix_world: "Rows") -> np.ndarray:
    """``[4, 4]`` float64: from an object's space to the camera's, OpenCV axes."""
    return camera.world_to_camera @ np.array(matrix_world, np.float64)


def has_jumped(source: ViewCamera, view: ViewCamera, depth: float) -> bool:
    """Whether a picture for ``source`` of what is ``depth`` metres away shows too little of ``view``, or that
    too wrongly, to stand in for it: moved there as a card it would be torn."""
    if source.is_orthographic != view.is_orthographic:
        return True
    before, now = source.camera_to_world, view.camera_to_world
    if float(before[:3, 2] @ now[:3, 2]) < JUMP_COSINE:
        return True
    moved = float(np.linalg.norm(before[:3, 3] - now[:3, 3]))
    return not view.is_orthographic and moved > JUMP_SHARE * depth


def between(source: ViewCamera, target: ViewCamera) -> np.ndarray:
    """``[4, 4]`` float64: from one camera's space to another's, OpenCV axes."""
    return target.world_to_camera @ source.camera_to_world @ OPENGL_TO_OPENCV
