# SPDX-License-Identifier: GPL-3.0-or-later
"""A pinhole camera in Blender's world."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ...bridge.axes import world_to_camera_opencv
from ...bridge.errors import BadValueError
from ...bridge.limits import MAX_PIXELS


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera: pose in Blender's world, intrinsics in pixels.

    ``camera_to_world``: ``[4, 4]`` float64, OpenGL axes (looks down −Z, +Y up).
    ``fx, fy, cx, cy``: pixels; the centre of the top left pixel is at (0.5, 0.5).
    """

    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        pose = self.camera_to_world
        if pose.shape != (4, 4) or not np.isfinite(pose).all():
            raise BadValueError(
                f"a camera pose must be a finite 4×4 matrix, got shape {pose.shape}: {pose.tolist()}",
                "Fix 'transform_matrix' in the data set's transforms file.",
            )
        rotation = pose[:3, :3]
        if not np.allclose(rotation.T @ rotation, np.eye(3), atol=1e-3):
            raise BadValueError(
                f"a camera pose must be a rotation and a translation, got {rotation.tolist()}",
                "Remove scale and shear from 'transform_matrix'.",
            )

    @classmethod
    def from_field_of_view(
        cls, camera_to_world: np.ndarray, width: int, height: int, angle_x: float
    ) -> "Camera":
        """A camera with square pixels, a centred principal point and ``angle_x`` radians of width."""
        if not (0.0 < angle_x < math.pi and math.tan(0.5 * angle_x) > 0.0):  # the least numbers halve to 0
            raise BadValueError(f"the horizontal field of view must be in (0, π) radians, got {angle_x}")
        focal = 0.5 * width / math.tan(0.5 * angle_x)
        return cls(camera_to_world, width, height, focal, focal, 0.5 * width, 0.5 * height)

    def resized(self, width: int, height: int | None = None) -> "Camera":
        """The same view with ``width`` pixels across; the height follows the aspect unless it is given."""
        if width < 1 or (height is not None and height < 1):
            raise BadValueError(f"a picture must be at least 1 pixel wide and high, got {width}×{height}")
        if height is None:
            height = max(1, round(width * self.height / self.width))
            if width * height > MAX_PIXELS:
                raise BadValueError(
                    f"a picture of {width}×{height} pixels is too large",
                    f"It may have {MAX_PIXELS // 10**6} million: give a smaller width.",
                )
        x, y = width / self.width, height / self.height
        return Camera(self.camera_to_world, width, height, self.fx * x, self.fy * y, self.cx * x, self.cy * y)

    @cached_property
    def world_to_camera(self) -> np.ndarray:
        """``[4, 4]`` float64, OpenCV axes (+Z forward, +Y down): what rasterisers use."""
        return world_to_camera_opencv(self.camera_to_world)

    @property
    def position(self) -> np.ndarray:
        """``[3]`` float64: the centre of projection in the world, metres."""
        return self.camera_to_world[:3, 3]

    def view_matrix(self, like: torch.Tensor) -> torch.Tensor:
        """``world_to_camera`` as a tensor with the dtype and device of ``like``."""
        return torch.as_tensor(self.world_to_camera, dtype=like.dtype, device=like.device)
