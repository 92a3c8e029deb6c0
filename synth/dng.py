# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw files: what a sensor counted, as a DNG that LibRaw and raw converters read (Adobe, DNG 1.4).

The camera is one of our own. Its sensor has the primaries of Rec.709, but less of red and blue than of green,
as sensors have; a white surface in daylight (D65) so gives ``DAYLIGHT``, and is white again where a converter
divides by what ``AsShotNeutral`` says.
"""

from fractions import Fraction

import numpy as np

from . import tiff
from .tiff import Signed, Tags

#: What the sensor makes of white light: of its channels, green is the largest.
DAYLIGHT = np.array([0.5, 1.0, 0.65])
#: Codes of a pixel without light, and of a full one.
BLACK, WHITE = 512, 16383
#: CIE XYZ (D65, Y = 1 for white) → linear Rec.709 (IEC 61966-2-1).
XYZ_TO_RGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)
#: Red, green, green, blue, from the upper left corner: the channel of each pixel of a block of 2 × 2.
MOSAIC = np.array([[0, 1], [1, 2]])

DNG_VERSION, DNG_BACKWARD, UNIQUE_MODEL = 50706, 50707, 50708
BLACK_LEVEL, WHITE_LEVEL, COLOR_MATRIX, NEUTRAL, ILLUMINANT = 50714, 50717, 50721, 50728, 50778
CFA_SIZE, CFA_PATTERN, CFA_COLOURS, CFA_LAYOUT, NOISE_PROFILE = 33421, 33422, 50710, 50711, 51041
SUBFILE_TYPE = 254
CFA, LINEAR_RAW = 32803, 34892
D65 = 21


def mosaic(counted: np.ndarray) -> np.ndarray:
    """[H, W] of [H, W, 3]: of each pixel the one channel that its filter lets pass."""
    height, width = counted.shape[:2]
    rows, columns = np.mgrid[:height, :width] % 2
    return np.take_along_axis(counted, MOSAIC[rows, columns][..., None], -1)[..., 0]


def codes(counted: np.ndarray) -> np.ndarray:
    """uint16 of what the sensor counted, 1 where it is full; below black there is noise alone."""
    levels = BLACK + counted * (WHITE - BLACK)
    return np.clip(np.floor(levels + 0.5), 0, WHITE).astype(np.uint16)


def encode(
    counted: np.ndarray, balance: np.ndarray, tags: Tags, exif: Tags, noise: tuple[float, float] | None = None
) -> bytes:
    """The file of [H, W, 3] (demosaiced, "linear raw") or [H, W] (``mosaic``), 1 where the sensor is full.

    ``balance``: gains [3] by which the camera's own white balance is off, 1 where it is right; ``tags`` and
    ``exif``: who took it, and how. ``noise``: (a, b) where the variance of what was counted, n, is a n + b.
    """
    neutral = DAYLIGHT / balance
    matrix = DAYLIGHT[:, None] * XYZ_TO_RGB
    linear = counted.ndim == 3
    every: dict[int, tiff.Value] = {
        **tags,
        SUBFILE_TYPE: 0,
        DNG_VERSION: bytes([1, 4, 0, 0]),
        DNG_BACKWARD: bytes([1, 3 if linear else 1, 0, 0]),
        UNIQUE_MODEL: f"{tags[tiff.MAKE]} {tags[tiff.MODEL]}",
        tiff.PHOTOMETRIC: LINEAR_RAW if linear else CFA,
        BLACK_LEVEL: (BLACK,) * (3 if linear else 1),
        WHITE_LEVEL: (WHITE,) * (3 if linear else 1),
        COLOR_MATRIX: _matrix(matrix),
        NEUTRAL: tuple(Fraction(round(float(value) * tiff.MILLION), tiff.MILLION) for value in neutral),
        ILLUMINANT: D65,
    }
    if not linear:
        every |= {CFA_SIZE: (2, 2), CFA_PATTERN: bytes(MOSAIC.ravel().tolist())}
        every |= {CFA_COLOURS: bytes([0, 1, 2]), CFA_LAYOUT: 1}
    if noise is not None:
        every[NOISE_PROFILE] = (float(noise[0]), float(noise[1])) * 3
    return tiff.picture(codes(counted), every, exif)


def _matrix(values: np.ndarray) -> tuple[Signed, ...]:
    return tuple(tiff.signed(float(value)) for value in values.ravel())
