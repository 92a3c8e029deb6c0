# SPDX-License-Identifier: GPL-3.0-or-later
"""Reduced pictures and their cameras.

Each published data set has the convention of the code that reads it: HDR-NeRF averages areas (OpenCV's
INTER_AREA, ImageMagick), the 3DGS lineage (HDR-GS, GaussHDR) resamples with Pillow's bicubic filter.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from PIL import Image

from ...bridge.errors import BadValueError
from .camera import Camera
from .encoding import Encoding

Filter = Literal["area", "bicubic"]

#: 3DGS's convention where no factor is given: wider pictures are reduced to this width, pixels.
WIDEST = 1600


@dataclass(frozen=True)
class Reduction:
    """Pictures ``factor`` times smaller on each side.

    ``area``: the mean of each block of pixels, where the size is a multiple of the factor (else bicubic).
    ``done``: sources give pictures at this size already.
    """

    factor: float = 1.0
    filter: Filter = "area"
    done: bool = False

    def __post_init__(self) -> None:
        if not (math.isfinite(self.factor) and self.factor >= 1.0):
            raise BadValueError(
                f"pictures cannot be reduced by {self.factor:g}",
                "Give a downscale of 1 or more: 2 is half the size.",
            )

    def size(self, width: int, height: int) -> tuple[int, int]:
        """The reduced size, rounded, at least one pixel."""
        return max(1, round(width / self.factor)), max(1, round(height / self.factor))

    def picture(self, picture: np.ndarray, radiance: Encoding | None = None) -> np.ndarray:
        """``[H, W, 3]`` uint8 or uint16 → ``[h, w, 3]`` of the same type.

        ``radiance``: how codes stand for radiance, of which the mean is taken then, and not that of its
        logarithm: as a smaller camera would.
        """
        if self.factor == 1.0 or self.done:
            return picture
        if radiance is not None:
            return radiance.codes(self.linear(radiance.exposed(picture)).clip(0.0))
        height, width = picture.shape[:2]
        if picture.dtype != np.uint8:  # Pillow has no colour of 16 bits
            largest = float(np.iinfo(picture.dtype).max)
            return np.floor(self.linear(picture).clip(0.0, largest) + 0.5).astype(picture.dtype)
        image = Image.fromarray(picture)
        if self._averages(width, height):
            # Not resize(…, BOX): that rounds to 8 bits twice, a quarter of a code too bright on average.
            return np.array(image.reduce(round(self.factor)))
        # Pillow widens the filter with the factor, so that nothing aliases.
        return np.array(image.resize(self.size(width, height), Image.Resampling.BICUBIC))

    def linear(self, values: np.ndarray) -> np.ndarray:
        """``[H, W, 3]`` of any numbers → ``[h, w, 3]`` float64, not rounded."""
        height, width = values.shape[:2]
        if self.factor == 1.0 or self.done:
            return values.astype(np.float64)
        small = self.size(width, height)
        if self._averages(width, height):
            block = round(self.factor)
            blocks = values.reshape(small[1], block, small[0], block, 3)
            return blocks.mean(axis=(1, 3), dtype=np.float64)
        planes = (Image.fromarray(values[..., k].astype(np.float32)) for k in range(3))
        resized = (np.array(plane.resize(small, Image.Resampling.BICUBIC)) for plane in planes)
        return np.stack(list(resized), axis=-1).astype(np.float64)

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """``[H, W]`` bool → ``[h, w]`` bool: True where all that a pixel is made of was True."""
        if self.factor == 1.0 or self.done:
            return mask
        height, width = mask.shape
        averages = self._averages(width, height)
        columns, rows = (
            _windows(side, small, averages)
            for side, small in zip((width, height), self.size(width, height), strict=True)
        )
        # What is masked in each rectangle that begins in the corner.
        masked = np.pad(np.cumsum(np.cumsum(~mask, axis=0), axis=1), ((1, 0), (1, 0)))
        (left, right), (top, bottom) = columns, (rows[0][:, None], rows[1][:, None])
        within = masked[bottom, right] - masked[top, right] - masked[bottom, left] + masked[top, left]
        return within == 0

    def _averages(self, width: int, height: int) -> bool:
        """Whether each pixel is the plain mean of a block: where blocks fill the picture."""
        blocks = float(self.factor).is_integer() and width % self.factor == 0 and height % self.factor == 0
        return self.filter == "area" and blocks

    def camera(self, camera: Camera) -> Camera:
        """The camera of the reduced picture: the same view."""
        return camera if self.factor == 1.0 else camera.resized(*self.size(camera.width, camera.height))

    def in_words(self, width: int, height: int) -> str:
        """What happens to pictures of this size, for ``Scene.messages``."""
        if self.factor == 1.0:
            return f"pictures are used as they are, {width}×{height}"
        small = self.size(width, height)
        how = "area average" if self._averages(width, height) else "bicubic"
        return f"pictures are reduced by {self.factor:g}, {width}×{height} to {small[0]}×{small[1]} ({how})"


def _windows(side: int, small: int, averages: bool) -> tuple[np.ndarray, np.ndarray]:
    """The first pixel of those that each reduced one is made of along a side, and the first after them."""
    scale = side / small
    middle = (np.arange(small) + 0.5) * scale
    support = 0.5 * scale if averages else 2.0 * scale  # Pillow's bicubic filter, widened
    first, after = (np.floor(middle + sign * support + 0.5).astype(np.int64) for sign in (-1, 1))
    return first.clip(0, side), after.clip(0, side)


def is_shaped(size: tuple[int, int], like: tuple[int, int]) -> bool:
    """Whether two sizes are of one shape, to a pixel's rounding."""
    return abs(like[1] * size[0] - size[1] * like[0]) <= max(like[0], size[0])


def capped(width: int) -> float:
    """3DGS's factor for pictures of this width: 1, or what makes them ``WIDEST`` wide."""
    return max(1.0, width / WIDEST)
