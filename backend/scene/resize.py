# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures at less than their full size, and the cameras that belong to them.

Each published data set has the convention of the code that reads it: HDR-NeRF averages areas (OpenCV's
INTER_AREA, ImageMagick), the 3DGS lineage (HDR-GS, GaussHDR) resamples with Pillow's bicubic filter.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from PIL import Image

from ...bridge.errors import BadValueError
from .camera import Camera
from .pictures import read_picture

Filter = Literal["area", "bicubic"]

#: 3DGS's convention where no factor is given: wider pictures are reduced to this width, pixels.
WIDEST = 1600


@dataclass(frozen=True)
class Reduction:
    """Pictures ``factor`` times smaller on each side.

    ``area``: the mean of each block of pixels, where the size is a multiple of the factor (else bicubic).
    """

    factor: float = 1.0
    filter: Filter = "area"

    def __post_init__(self) -> None:
        if not (math.isfinite(self.factor) and self.factor >= 1.0):
            raise BadValueError(
                f"pictures cannot be reduced by {self.factor:g}",
                "Give a downscale of 1 or more: 2 is half the size.",
            )

    def size(self, width: int, height: int) -> tuple[int, int]:
        """The reduced size, rounded, at least one pixel."""
        return max(1, round(width / self.factor)), max(1, round(height / self.factor))

    def read(self, path: Path) -> np.ndarray:
        """``[h, w, 3]`` uint8: a picture from disk, reduced; raises what ``read_picture`` raises."""
        return self.picture(read_picture(path))

    def picture(self, picture: np.ndarray) -> np.ndarray:
        """``[H, W, 3]`` uint8 → ``[h, w, 3]`` uint8."""
        if self.factor == 1.0:
            return picture
        height, width = picture.shape[:2]
        image = Image.fromarray(picture)
        if self._averages(width, height):
            # Not resize(…, BOX): that rounds to 8 bits twice, a quarter of a code too bright on average.
            return np.array(image.reduce(round(self.factor)))
        # Pillow widens the filter with the factor, so that nothing aliases.
        return np.array(image.resize(self.size(width, height), Image.Resampling.BICUBIC))

    def _averages(self, width: int, height: int) -> bool:
        """Whether each pixel is the plain mean of a block: where blocks fill the picture."""
        return self.filter == "area" and width % self.factor == 0 and height % self.factor == 0

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


def capped(width: int) -> float:
    """3DGS's factor for pictures of this width: 1, or what makes them ``WIDEST`` wide."""
    return max(1.0, width / WIDEST)
