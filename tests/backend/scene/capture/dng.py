# SPDX-License-Identifier: GPL-3.0-or-later
"""DNG files, written by tifffile: what a sensor saw, mosaic or linear, and what converters need to know."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tifffile

#: XYZ (D65) to Linear Rec.709 (IEC 61966-2-1): a camera whose primaries are those of Rec.709.
XYZ_TO_REC709 = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def _fractions(values: np.ndarray | Sequence[float], whole: int = 1_000_000) -> list[int]:
    return [number for value in np.ravel(values) for number in (round(float(value) * whole), whole)]


def mosaic(picture: np.ndarray) -> np.ndarray:
    """What a sensor with red at the upper left sees of ``[H, W, 3]``."""
    seen = picture[..., 1].copy()
    seen[0::2, 0::2] = picture[0::2, 0::2, 0]
    seen[1::2, 1::2] = picture[1::2, 1::2, 2]
    return seen


def write_dng(
    path: Path,
    codes: np.ndarray,
    black: int,
    white: int,
    neutral: Sequence[float] = (1.0, 1.0, 1.0),
    seconds: float | None = None,
    iso: int | None = None,
    noise: Sequence[float] = (),
    orientation: int = 1,
    camera_from_xyz: np.ndarray = XYZ_TO_REC709,
    taken: str = "",
) -> None:
    """``codes``: uint16 ``[H, W]`` of a mosaic, or ``[H, W, 3]``. ``neutral``: what it sees of white."""
    is_mosaic = codes.ndim == 2
    count = 4 if is_mosaic else 3
    tags: list[tuple] = [
        (271, "s", 0, "Room", True),
        (272, "s", 0, "Raw", True),
        (274, "H", 1, orientation, True),
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50708, "s", 0, "Room Raw", True),
        (50713, "H", 2, (2, 2) if is_mosaic else (1, 1), True),  # BlackLevelRepeatDim
        (50714, "I", count, (black,) * count, True),
        (50717, "I", 1 if is_mosaic else 3, white if is_mosaic else (white,) * 3, True),
        (50721, "2i", 9, _fractions(camera_from_xyz), True),  # ColorMatrix1
        (50728, "2I", 3, _fractions(neutral), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    if is_mosaic:
        tags += [(33421, "H", 2, (2, 2), True), (33422, "B", 4, (0, 1, 1, 2), True)]
    if seconds is not None:
        tags.append((33434, "2I", 1, _fractions([seconds]), True))
    if iso is not None:
        tags.append((34855, "H", 1, iso, True))
    if taken:
        tags.append((36867, "s", 0, taken, True))
    if noise:
        tags.append((51041, "d", len(noise), tuple(noise), True))
    photometric = 32803 if is_mosaic else 34892
    tifffile.imwrite(path, codes, photometric=photometric, extratags=tags, metadata=None, software=None)
