# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures without distortion: what a pinhole camera at the same place would have taken, or smaller."""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812

from ...bridge.errors import BadValueError, FileMissingError

#: Points along each edge of a picture, by which the largest upright rectangle inside is found.
EDGE_POINTS = 257
#: A lens that loses more of its picture than this is not believed.
SMALLEST_SHARE = 0.25


#: What to do with pictures of a lens that is no lens.
NOT_CREDIBLE = (
    "Few photos, or photos of a plane, tell little of a lens: --camera SIMPLE_RADIAL asks less of them. "
    "Numbers from elsewhere may be of another camera."
)


def require_pycolmap(wanted: str = "'physhdr prepare' finds the cameras") -> ModuleType:
    """pycolmap, or ``FileMissingError`` that says what is ``wanted`` of it and how to install it."""
    try:
        import pycolmap
    except ImportError as error:
        raise FileMissingError(
            f"{wanted} with pycolmap, which is not installed ({error})",
            f"Install it: {sys.executable} -m pip install pycolmap",
        ) from error
    return pycolmap


@dataclass(frozen=True, eq=False)
class Lens:
    """The pinhole camera that takes the place of a real one (``source``, pycolmap's), in pixels.

    Each of its pixels is the mean of ``over``² samples of the photo.
    """

    source: Any
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    over: int

    def picture(self, photo: np.ndarray) -> np.ndarray:
        """``[H, W, 3]`` uint8 as this camera would have taken it: the mean code over each pixel's area."""
        codes = torch.from_numpy(photo.astype(np.float32)).permute(2, 0, 1)[None]
        taken = F.grid_sample(
            codes, _places(self)[None], mode="bicubic", padding_mode="border", align_corners=False
        )
        mean = F.avg_pool2d(taken.clamp(0.0, 255.0), self.over)
        return mean[0].permute(1, 2, 0).round().to(torch.uint8).numpy()

    def straightened(self, keypoints: np.ndarray) -> np.ndarray:
        """Where places ``[M, 2]`` in the photo (pixels) are in this camera's picture."""
        if not len(keypoints):
            return keypoints
        return self.source.cam_from_img(keypoints) * (self.fx, self.fy) + (self.cx, self.cy)


def make_lenses(cameras: Mapping[int, Any], scale: float) -> dict[int, Lens]:
    """A pinhole camera for each of pycolmap's, all with pictures of one size; raises as ``make_lens``."""
    lenses = {number: make_lens(camera, scale) for number, camera in cameras.items()}
    width = min(lens.width for lens in lenses.values())
    height = min(lens.height for lens in lenses.values())
    return {number: _cropped(lens, width, height) for number, lens in lenses.items()}


def _cropped(lens: Lens, width: int, height: int) -> Lens:
    cx, cy = lens.cx - 0.5 * (lens.width - width), lens.cy - 0.5 * (lens.height - height)
    return replace(lens, width=width, height=height, cx=cx, cy=cy)


def make_lens(camera: Any, scale: float) -> Lens:
    """The pinhole camera for pycolmap's ``camera``: its focal length times ``scale`` ≤ 1, no blank pixels.

    Raises ``BadValueError`` where the distortion is beyond belief.
    """
    left, top, right, bottom = _inside(camera)
    fx, fy = camera.focal_length_x, camera.focal_length_y
    full = (right - left) * fx, (bottom - top) * fy
    share = full[0] * full[1] / (camera.width * camera.height)
    if not (full[0] > 1.0 and full[1] > 1.0 and SMALLEST_SHARE < share < 1.0 / SMALLEST_SHARE):
        raise BadValueError(
            f"the lens that was found is not credible: {camera.model_name} {camera.params_to_string()}",
            NOT_CREDIBLE,
        )
    width, height = (max(1, math.floor(side * scale + 1e-6)) for side in full)
    # Whole pixels: what is left of the rectangle goes at both edges alike.
    fx, fy = fx * scale, fy * scale
    cx = 0.5 * (width - (left + right) * fx)
    cy = 0.5 * (height - (top + bottom) * fy)
    over = math.ceil(1.0 / scale - 1e-6)
    return Lens(camera, width, height, fx, fy, cx, cy, over)


@lru_cache(maxsize=1)  # of many cameras each is used for its own pictures, one after the other
def _places(lens: Lens) -> torch.Tensor:
    """``[over·height, over·width, 2]`` float32: where in the photo each sample is, −1…1 from edge to edge."""
    columns = ((np.arange(lens.over * lens.width) + 0.5) / lens.over - lens.cx) / lens.fx
    rows = ((np.arange(lens.over * lens.height) + 0.5) / lens.over - lens.cy) / lens.fy
    places = np.empty((len(rows), len(columns), 2), np.float32)
    for k, row in enumerate(rows):
        rays = np.stack([columns, np.full_like(columns, row), np.ones_like(columns)], axis=1)
        places[k] = 2.0 * lens.source.img_from_cam(rays) / (lens.source.width, lens.source.height) - 1.0
    return torch.from_numpy(places)


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
