# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures without distortion: what a pinhole camera at the same place would have taken, or smaller."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812

from .structure import CAPTURE_REMEDY, StructureError

#: Points along each edge of a picture, by which the largest upright rectangle inside is found.
EDGE_POINTS = 257
#: A lens that loses more of its picture than this is not believed.
SMALLEST_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Lens:
    """The pinhole camera that takes the place of a real one, in pixels, and how its pixels are looked up.

    ``grid``: ``[over·height, over·width, 2]`` float32, the place in the photo of each of ``over``² samples in
    every pixel, −1…1 from edge to edge.
    """

    source: Any
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    over: int
    grid: torch.Tensor

    def picture(self, photo: np.ndarray) -> np.ndarray:
        """``[H, W, 3]`` uint8 as this camera would have taken it: the mean code over each pixel's area."""
        codes = torch.from_numpy(photo.astype(np.float32)).permute(2, 0, 1)[None]
        taken = F.grid_sample(
            codes, self.grid[None], mode="bicubic", padding_mode="border", align_corners=False
        )
        mean = F.avg_pool2d(taken.clamp(0.0, 255.0), self.over)
        return mean[0].permute(1, 2, 0).round().to(torch.uint8).numpy()

    def straightened(self, keypoints: np.ndarray) -> np.ndarray:
        """Where places ``[M, 2]`` in the photo (pixels) are in this camera's picture."""
        if not len(keypoints):
            return keypoints
        return self.source.cam_from_img(keypoints) * (self.fx, self.fy) + (self.cx, self.cy)


def make_lens(camera: Any, scale: float) -> Lens:
    """The pinhole camera for pycolmap's ``camera``: its focal length times ``scale`` ≤ 1, no blank pixels.

    Raises ``StructureError`` where the distortion is beyond belief.
    """
    left, top, right, bottom = _inside(camera)
    fx, fy = camera.focal_length_x, camera.focal_length_y
    full = (right - left) * fx, (bottom - top) * fy
    share = full[0] * full[1] / (camera.width * camera.height)
    if not (full[0] > 1.0 and full[1] > 1.0 and SMALLEST_SHARE < share < 1.0 / SMALLEST_SHARE):
        raise StructureError(
            f"the lens that was found is not credible: {camera.model_name} {camera.params_to_string()}",
            CAPTURE_REMEDY,
        )
    width, height = (max(1, math.floor(side * scale + 1e-6)) for side in full)
    # Whole pixels: what is left of the rectangle goes at both edges alike.
    fx, fy = fx * scale, fy * scale
    cx = 0.5 * (width - (left + right) * fx)
    cy = 0.5 * (height - (top + bottom) * fy)
    over = math.ceil(1.0 / scale - 1e-6)
    columns = ((np.arange(over * width) + 0.5) / over - cx) / fx
    rows = ((np.arange(over * height) + 0.5) / over - cy) / fy
    grid = np.empty((over * height, over * width, 2), np.float32)
    for k, row in enumerate(rows):
        rays = np.stack([columns, np.full_like(columns, row), np.ones_like(columns)], axis=1)
        grid[k] = 2.0 * camera.img_from_cam(rays) / (camera.width, camera.height) - 1.0
    return Lens(camera, width, height, fx, fy, cx, cy, over, torch.from_numpy(grid))


def _inside(camera: Any) -> tuple[float, float, float, float]:
    """An upright rectangle on the plane z = 1 that the whole photo covers: left, top, right, bottom."""
    along = np.linspace(0.0, 1.0, EDGE_POINTS)
    zero, one = np.zeros_like(along), np.ones_like(along)

    def on_plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        rays = camera.cam_from_img(np.stack([x * camera.width, y * camera.height], axis=1))
        return np.asarray(rays)

    return (
        float(on_plane(zero, along)[:, 0].max()),
        float(on_plane(along, zero)[:, 1].max()),
        float(on_plane(one, along)[:, 0].min()),
        float(on_plane(along, one)[:, 1].min()),
    )
