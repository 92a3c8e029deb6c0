# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorted pictures: what a pinhole camera at the same place would have taken, possibly smaller.

pycolmap knows what a lens does to a ray; the resampling is ours (lab/notebook.md has both measured).
"""

import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812

from ...bridge.colmap import ALL_AROUND, panorama
from ...bridge.colmap_files import SparseCamera
from ...bridge.errors import BadValueError, FileMissingError
from ..shell import pip_install
from .encoding import Encoding
from .resize import Reduction

#: A pinhole's picture reaches so far from its axis at most, to each side: 55°, whose tangent this is. At 90°
#: a picture would be infinite; at 55° a fisheye's pixels are stretched three times outwards.
WIDEST_TANGENT = math.tan(math.radians(55.0))
#: Directions in which a lens is followed from the middle of its picture outwards, and steps in each.
DIRECTIONS, STEPS = 360, 128
#: Where a lens maps a step outwards on less than this share of what it is in the middle, it folds back.
LEAST_GROWTH = 0.05
#: Pixels beyond the photo's edge that count as on it: rounding.
ON_EDGE = 1e-6
#: Points along each side of a picture at which it is checked to be full.
EDGE_POINTS = 257
#: A lens that loses more of its picture than this, or shows so much more, is rejected.
SMALLEST_SHARE = 0.25
#: Pictures of photos of one size whose sides differ by no more than this share get the smallest's size.
ALIKE = 0.02
#: Samples that are taken at once: bounds the memory, whatever a photo's size.
STRIP = 1 << 20

#: The remedy for an impossible lens.
NOT_CREDIBLE = (
    "Few photos, or photos of a plane, tell little of a lens: --camera SIMPLE_RADIAL asks less of them. "
    "Numbers from elsewhere may be of another camera."
)


def require_pycolmap(wanted: str = "'physhdr prepare' finds the cameras") -> ModuleType:
    """pycolmap, or ``FileMissingError`` that says what it is ``wanted`` for and how to install it."""
    try:
        import pycolmap
    except ImportError as error:
        raise FileMissingError(
            f"{wanted} with pycolmap, which is not installed ({error})",
            f"Install it: {pip_install('pycolmap')}",
        ) from error
    return pycolmap


@dataclass(frozen=True)
class RealCamera(SparseCamera):
    """A camera as COLMAP describes it, with what pycolmap knows of it."""

    @classmethod
    def of(cls, camera: SparseCamera | None) -> "RealCamera | None":
        """The same camera; None of None."""
        return None if camera is None else cls(camera.model, camera.width, camera.height, camera.params)

    def resized(self, width: int, height: int) -> "RealCamera":
        """The same camera with photos of another size and the same shape. Needs pycolmap."""
        if (width, height) == (self.width, self.height):
            return self
        camera = self.pycolmaps()
        camera.rescale(width, height)
        return RealCamera(self.model, width, height, tuple(camera.params.tolist()))

    def pycolmaps(self) -> Any:
        """pycolmap's camera; raises ``FileMissingError`` where pycolmap is not installed."""
        pycolmap = require_pycolmap(f"pictures of a lens ({self.model}) are undistorted")
        return pycolmap.Camera(
            model=self.model, width=self.width, height=self.height, params=list(self.params)
        )

    def in_words(self) -> str:
        return f"{self.model} {', '.join(f'{value:.6g}' for value in self.params)}"


@dataclass(frozen=True, eq=False)
class Lens:
    """The pinhole camera that replaces a real one (``source``, pycolmap's), in pixels.

    Each of its pixels is the mean of ``over``² samples of the photo. ``cut``: the share of the photo that its
    picture does not show.
    """

    source: Any
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    over: int
    cut: float = 0.0

    @cached_property
    def key(self) -> Hashable:
        """Equal for lenses that treat photos alike."""
        real = (self.source.model_name, self.source.width, self.source.height, *self.source.params.tolist())
        return (*real, self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.over)

    def picture(self, codes: np.ndarray, radiance: Encoding | None = None) -> np.ndarray:
        """``[h, w, 3]`` codes as this camera would have taken them: the mean code over each pixel's area.

        ``codes``: the photo's, ``[H, W, 3]`` uint8 or uint16, which stays. ``radiance``: how they stand for
        radiance, of which the mean is taken then.
        """
        height, width, channels = codes.shape
        largest = float(np.iinfo(codes.dtype).max)
        out = np.empty((self.height, self.width, channels), codes.dtype)
        for rows, places in self._strips():
            # Only the rows that this strip needs become floats, and two more on both sides.
            first = max(math.floor(float(places[..., 1].min()) - 0.5) - 2, 0)
            last = min(math.floor(float(places[..., 1].max()) - 0.5) + 4, height)
            photo = torch.from_numpy(codes[first:last].astype(np.float32)).permute(2, 0, 1)[None]
            grid = (2.0 * (places - (0.0, first)) / (width, last - first) - 1.0).astype(np.float32)
            taken = F.grid_sample(
                photo,
                torch.from_numpy(grid)[None],
                mode="bicubic",
                padding_mode="border",
                align_corners=False,
            )
            taken.clamp_(0.0, largest)
            if radiance is None or self.over == 1:
                mean = F.avg_pool2d(taken, self.over)[0].permute(1, 2, 0)
                out[rows] = mean.round().numpy()
                continue
            exposed = torch.from_numpy(radiance.decode(taken.numpy() / radiance.unit(codes.dtype)))
            out[rows] = radiance.codes(F.avg_pool2d(exposed, self.over)[0].permute(1, 2, 0).numpy())
        return out

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """``[h, w]`` bool of ``[H, W]`` bool: True where everything that contributes to a pixel was True."""
        height, width = mask.shape
        padded = np.pad(mask, (1, 2), mode="edge")
        wide = padded[:-3] & padded[1:-2] & padded[2:-1] & padded[3:]
        whole = wide[:, :-3] & wide[:, 1:-2] & wide[:, 2:-1] & wide[:, 3:]  # of the 4×4 of a bicubic sample
        out = np.empty((self.height, self.width), bool)
        for rows, places in self._strips():
            columns = np.floor(places[..., 0] - 0.5).astype(np.int64).clip(0, width - 1)
            lines = np.floor(places[..., 1] - 0.5).astype(np.int64).clip(0, height - 1)
            samples = whole[lines, columns].reshape(-1, self.over, self.width, self.over)
            out[rows] = samples.all(axis=(1, 3))
        return out

    def straightened(self, keypoints: np.ndarray) -> np.ndarray:
        """Where places ``[M, 2]`` in the photo (pixels) are in this camera's picture."""
        if not len(keypoints):
            return keypoints
        return self.source.cam_from_img(keypoints) * (self.fx, self.fy) + (self.cx, self.cy)

    def _strips(self) -> Iterator[tuple[slice, np.ndarray]]:
        """Rows of the picture, and ``[over·rows, over·width, 2]``: where in the photo their samples are."""
        columns = ((np.arange(self.over * self.width) + 0.5) / self.over - self.cx) / self.fx
        lines = ((np.arange(self.over * self.height) + 0.5) / self.over - self.cy) / self.fy
        step = max(1, STRIP // (len(columns) * self.over))
        for start in range(0, self.height, step):
            rows = slice(start, min(start + step, self.height))
            y = lines[rows.start * self.over : rows.stop * self.over]
            rays = np.ones((len(y), len(columns), 3))
            rays[..., 0], rays[..., 1] = columns, y[:, None]
            places = np.asarray(self.source.img_from_cam(rays.reshape(-1, 3)))
            yield rows, places.reshape(len(y), len(columns), 2)


@dataclass(frozen=True)
class Reduced:
    """Stands in for a lens where other pictures of the data set have one: reduces only."""

    reduction: Reduction

    @property
    def key(self) -> Hashable:
        return self.reduction.factor, self.reduction.filter

    def picture(self, codes: np.ndarray, radiance: Encoding | None = None) -> np.ndarray:
        return self.reduction.picture(codes, radiance)

    def mask(self, mask: np.ndarray) -> np.ndarray:
        return self.reduction.mask(mask)


def lenses_by_size(cameras: Mapping[Any, Any], scale: float) -> dict[Any, Lens]:
    """A pinhole camera for each of pycolmap's; raises as ``make_lens``.

    Pictures are of one size where photos are, and pictures differ by ``ALIKE`` at most.
    Cameras that were estimated for each photo separately differ that much.
    """
    lenses = {key: make_lens(camera, scale) for key, camera in cameras.items()}
    left = set(cameras)
    while left:
        first = min(left, key=lambda key: (lenses[key].width, lenses[key].height))
        one, photo = lenses[first], (cameras[first].width, cameras[first].height)
        alike = {
            key
            for key in left
            if (cameras[key].width, cameras[key].height) == photo
            and lenses[key].width <= one.width * (1.0 + ALIKE)
            and abs(lenses[key].height - one.height) <= one.height * ALIKE
        }
        lenses |= _of_one_size({key: lenses[key] for key in alike})
        left -= alike
    return lenses


def _of_one_size(lenses: dict[Any, Lens]) -> dict[Any, Lens]:
    width = min(lens.width for lens in lenses.values())
    height = min(lens.height for lens in lenses.values())
    return {key: _cropped(lens, width, height) for key, lens in lenses.items()}


def _cropped(lens: Lens, width: int, height: int) -> Lens:
    cx, cy = lens.cx - 0.5 * (lens.width - width), lens.cy - 0.5 * (lens.height - height)
    return replace(lens, width=width, height=height, cx=cx, cy=cy)


def make_lens(camera: Any, scale: float) -> Lens:
    """The pinhole camera for pycolmap's ``camera``: its focal length times ``scale`` ≤ 1, no blank pixels.

    It shows the largest upright rectangle about the optical axis that the photo fills, and no more than
    ``WIDEST_TANGENT`` to each side. Raises ``BadValueError`` where the distortion is implausible.
    """
    if camera.model_name == ALL_AROUND:
        raise panorama("the camera")
    with np.errstate(all="ignore"):  # numbers of no lens at all are among what is tried
        found = _inside(camera) if camera.width > 0 and camera.height > 0 else None
    if found is None:
        raise _not_credible(camera)
    left, top, right, bottom = found
    fx, fy = camera.focal_length_x, camera.focal_length_y
    full = (right - left) * fx, (bottom - top) * fy
    share = full[0] * full[1] / (camera.width * camera.height)
    if not (full[0] > 1.0 and full[1] > 1.0 and SMALLEST_SHARE < share < 1.0 / SMALLEST_SHARE):
        raise _not_credible(camera)
    width, height = (max(1, math.floor(side * scale + 1e-6)) for side in full)
    # Whole pixels: what is left of the rectangle goes at both edges alike.
    fx, fy = fx * scale, fy * scale
    cx = 0.5 * (width - (left + right) * fx)
    cy = 0.5 * (height - (top + bottom) * fy)
    over = math.ceil(1.0 / scale - 1e-6)
    x, y = np.asarray(camera.img_from_cam(_sides(left, top, right, bottom))).T
    shown = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))  # the area within: the shoelace formula
    cut = max(0.0, 1.0 - shown / (camera.width * camera.height))
    return Lens(camera, width, height, fx, fy, cx, cy, over, cut)


def _not_credible(camera: Any) -> BadValueError:
    return BadValueError(
        f"the estimated lens is implausible: {camera.model_name} {camera.params_to_string()} of photos "
        f"of {camera.width}×{camera.height}",
        NOT_CREDIBLE,
    )


def _sides(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    """``[4 · EDGE_POINTS, 3]``: points on the plane z = 1 along a rectangle's sides, once around."""
    along = np.linspace(0.0, 1.0, EDGE_POINTS)
    x, y = left + (right - left) * along, top + (bottom - top) * along
    around = [(x, np.full_like(x, top)), (np.full_like(y, right), y)]
    around += [(x[::-1], np.full_like(x, bottom)), (np.full_like(y, left), y[::-1])]
    x, y = (np.concatenate(each) for each in zip(*around, strict=True))
    return np.stack([x, y, np.ones_like(x)], axis=1)


def _inside(camera: Any) -> tuple[float, float, float, float] | None:
    """An upright rectangle on the plane z = 1 that the photo fills: left, top, right, bottom; None: none.

    The lens is followed from its axis outwards in every direction, up to where it leaves the photo, folds
    back or comes to ``WIDEST_TANGENT``: only forwards, because where a lens maps nothing there is no inverse.
    """
    size = np.array([camera.width, camera.height], np.float64)
    focal = np.array([camera.focal_length_x, camera.focal_length_y])
    if not (np.isfinite(camera.params).all() and (focal > 0.0).all()):
        return None
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    outward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    farthest = min(math.sqrt(2.0) * WIDEST_TANGENT, 3.0 * float((size / focal).max()))
    step = farthest / STEPS
    tiny = 1e-3 * step

    def good(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Whether points ``[..., 2]`` of the plane, met in these directions, are in the picture."""
        rays = np.ones((2, *points.shape[:-1], 3))
        rays[0, ..., :2], rays[1, ..., :2] = points, points + tiny * directions
        here, next_to = np.asarray(camera.img_from_cam(rays.reshape(-1, 3))).reshape(*rays.shape[:-1], 2)
        grows = ((next_to - here) * directions * focal).sum(axis=-1)
        grows /= tiny * ((directions * focal) ** 2).sum(axis=-1)
        on_photo = ((here >= -ON_EDGE) & (here <= size + ON_EDGE)).all(axis=-1)
        return on_photo & (grows > LEAST_GROWTH) & (np.abs(points) <= WIDEST_TANGENT).all(axis=-1)

    reach = step * np.arange(STEPS + 1)
    path = outward[:, None] * reach[:, None]
    there = good(path, np.broadcast_to(outward[:, None], path.shape))
    if not there[:, 0].all():
        return None
    there[:, -1] = False
    low = reach[there.argmin(axis=1) - 1]
    high = low + step
    for _ in range(60):
        middle = 0.5 * (low + high)
        is_good = good(middle[:, None] * outward, outward)
        low, high = np.where(is_good, middle, low), np.where(is_good, high, middle)
    edge, beyond = low[:, None] * outward, high[:, None] * outward
    rays = np.concatenate([beyond, np.ones((DIRECTIONS, 1))], axis=1)
    x, y = np.asarray(camera.img_from_cam(rays)).T

    def least(is_over: np.ndarray, coordinate: np.ndarray) -> float:
        """How far one may go to a side: to the nearest place where the photo ends at that side."""
        return float(np.abs(coordinate[is_over]).min(initial=WIDEST_TANGENT))

    sides = np.array(
        [
            -least(x < -ON_EDGE, edge[:, 0]),
            -least(y < -ON_EDGE, edge[:, 1]),
            least(x > size[0] + ON_EDGE, edge[:, 0]),
            least(y > size[1] + ON_EDGE, edge[:, 1]),
        ]
    )

    def fills(share: float) -> bool:
        points = _sides(*(share * sides))[:, :2]
        return bool(good(points, points / np.linalg.norm(points, axis=1, keepdims=True)).all())

    # Corners lie between the directions that were followed, and where a lens folds back there is no side at
    # all: what is left to do is to make the rectangle smaller as it is.
    share, too_much = (1.0, 1.0) if fills(1.0 - 1e-12) else (0.0, 1.0)
    while too_much - share > 1e-7:
        middle = 0.5 * (share + too_much)
        share, too_much = (middle, too_much) if fills(middle) else (share, middle)
    left, top, right, bottom = (share * sides).tolist()
    return left, top, right, bottom
