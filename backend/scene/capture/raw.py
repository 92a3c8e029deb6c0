# SPDX-License-Identifier: GPL-3.0-or-later
"""Raw files developed without a look (LibRaw, through rawpy): scene-linear pictures that clip at exactly 1.

A sensor counts light, so its response is known: black level off, divided by the white level, times the white
balance. Where the file tells that the sensor is full below that level, what is full becomes 1 all the same.
rawpy is optional (the extra ``prepare``) and is imported only here.
"""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from ....bridge.errors import FileDamagedError, FileMissingError, PhysHDRError
from ...shell import pip_install
from ..exif import LYING, Exif, Tags, exposure_of, tags_of_tiff
from .noise import BRIGHTEST, Noise, planes_of_mosaic
from .remedies import COPY_AGAIN

#: What LibRaw opens, by suffix: https://www.libraw.org/supported-cameras
SUFFIXES = (
    *(".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".gpr", ".iiq", ".kdc", ".mef"),
    *(".mos", ".mrw", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw"),
    ".x3f",
)
#: The code of 16 bits at which the sensor is full.
FULL = 65535
#: No sensor is full so far below its white level: a file that tells less counts in another unit.
LEAST_FULL = 0.5
#: EXIF's orientation by LibRaw's: 180°, 90° against and with the clock; any other is upright.
ORIENTATIONS = {3: 3, 5: 8, 6: 6}
#: DNG 1.4: (slope, offset) of the noise's variance, once for all channels or for each.
NOISE_PROFILE = 51041


def require_rawpy() -> ModuleType:
    """rawpy, or ``FileMissingError`` that says how to install it."""
    try:
        import rawpy
    except ImportError as error:
        raise FileMissingError(
            f"raw files are developed with rawpy, which is not installed ({error})",
            f"Install it: {pip_install('rawpy')}",
        ) from error
    return rawpy


@dataclass(frozen=True)
class RawHeader:
    """What a raw file tells without its pixels. ``width, height``: upright. ``focal``: length, millimetres.

    ``orientation``: how it is stored, as in EXIF. ``white_balance``: factors of red, green and blue, the
    smallest 1. ``noise``: where the file tells it.
    """

    width: int
    height: int
    orientation: int
    exif: Exif
    tags: Tags
    taken: datetime | None
    focal: float | None
    white_balance: tuple[float, float, float]
    noise: Noise | None


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """rawpy's file; what LibRaw raises of it becomes ``FileDamagedError``."""
    rawpy = require_rawpy()
    try:
        with rawpy.imread(str(path)) as raw:
            yield raw
    except PhysHDRError:
        raise
    except MemoryError:
        raise
    except (rawpy.LibRawError, rawpy.NotSupportedError, OSError, ValueError) as error:
        said = error.args[0] if error.args else error
        said = said.decode(errors="replace") if isinstance(said, bytes) else said
        raise FileDamagedError(
            f"{path} is not a raw file that LibRaw can read: {said}", COPY_AGAIN
        ) from error


def read_header(path: Path) -> RawHeader:
    """What the file tells, without developing it.

    Raises ``FileDamagedError`` (also for sensors that do not see red, green and blue) and
    ``FileMissingError`` without rawpy.
    """
    with opened(path) as raw:
        if raw.num_colors != 3:
            raise FileDamagedError(
                f"{path} is of a sensor with {raw.num_colors} colours: red, green and blue are wanted",
                "Develop it to 16-bit TIFF.",
            )
        sizes, other = raw.sizes, raw.other
        width, height = sizes.width, sizes.height
        orientation = ORIENTATIONS.get(sizes.flip, 1)
        if orientation in LYING:
            width, height = height, width
        tags = tags_of_tiff(path)
        told = exposure_of(tags)
        exif = Exif(
            told.time or (float(other.shutter_speed) or None),
            told.iso or (float(other.iso_speed) or None),
            told.f_number or (float(other.aperture) or None),
            told.bias,
            told.brightness,
        )
        taken = other.timestamp if other.timestamp.year > 1990 else None
        focal = float(other.focal_length)
        focal = focal if math.isfinite(focal) and focal > 0.0 else None
        white_balance, noise = _white_balance(raw), _noise_profile(tags)
        return RawHeader(width, height, orientation, exif, tags, taken, focal, white_balance, noise)


def _white_balance(raw: Any) -> tuple[float, float, float]:
    """The camera's own, or daylight's where it tells none."""
    for told in (raw.camera_whitebalance, raw.daylight_whitebalance):
        factors = np.array(told[:3], float)
        if np.isfinite(factors).all() and (factors > 0.0).all():
            red, green, blue = (factors / factors.min()).tolist()
            return red, green, blue
    return 1.0, 1.0, 1.0


def common_white_balance(headers: Sequence[tuple[float, float, float]]) -> int:
    """Which file's white balance is the middle one: all are developed with that one."""
    logs = np.log(np.array(headers))
    return int(np.abs(logs - np.median(logs, axis=0)).sum(axis=1).argmin())


@dataclass(frozen=True, eq=False)
class Developed:
    """``picture`` ``[H, W, 3]`` float32, upright: Linear Rec.709, 0…1, clipped at 1.

    ``partly`` ``[H, W]`` bool: where some channels of the sensor are full and others are not, so that the
    colour is wrong.
    """

    picture: np.ndarray
    partly: np.ndarray


def develop(path: Path, white_balance: Sequence[float], half: bool = False) -> Developed:
    """A raw file without a look.

    ``white_balance``: factors, the smallest 1, so that each channel that the sensor clips is 1 before the
    colours are converted, and white after. ``half``: two by two photosites make a pixel. Raises
    ``FileDamagedError``.
    """
    with opened(path) as raw:
        picture = _balanced(raw, white_balance, half)
        full = picture >= 1.0 - 1.5 / FULL
        partly = np.asarray(full.any(axis=2) & ~full.all(axis=2))
        return Developed(coloured(picture, to_rec709(raw)), partly)


def _balanced(raw: Any, white_balance: Sequence[float], half: bool) -> np.ndarray:
    """``[H, W, 3]`` float32, 0…1: linear values of the camera's own primaries."""
    rawpy = require_rawpy()
    balance, share = np.array(white_balance, np.float32), _full_share(raw)
    if raw.raw_type == rawpy.RawType.Stack:
        picture = _full_is_one(_scaled(raw, balance), balance, share)
        return _halved(picture) if half else picture
    codes = raw.postprocess(
        demosaic_algorithm=rawpy.DemosaicAlgorithm.AHD,
        half_size=half,
        user_wb=[white_balance[0], white_balance[1], white_balance[2], white_balance[1]],
        output_color=rawpy.ColorSpace.raw,
        output_bps=16,
        gamma=(1.0, 1.0),
        no_auto_bright=True,
        adjust_maximum_thr=0.0,  # else the brightest pixel counts as white where it is near
        highlight_mode=rawpy.HighlightMode.Clip,
    )
    return _full_is_one(codes.astype(np.float32) / FULL, balance, share)


def _full_share(raw: Any) -> float:
    """Where the sensor is full between black (0) and white level (1), as far as the file tells it.

    LibRaw's white level is a table's, and too high for some cameras or at some ISO (rawpy #122, rawtoaces
    #320). It stays what all is divided by, so that photos of several ISO can be compared.
    """
    told = [float(level) for level in raw.camera_white_level_per_channel or () if level > 0]
    black, white = float(max(raw.black_level_per_channel)), float(raw.white_level)
    share = (min(told) - black) / (white - black) if told and white > black else 1.0
    return share if LEAST_FULL <= share < 1.0 else 1.0


def _full_is_one(picture: np.ndarray, white_balance: np.ndarray, share: float) -> np.ndarray:
    """``[H, W, 3]`` with 1 where the sensor is full: at ``share``, times the channel's white balance."""
    if share == 1.0:
        return picture
    limits = (white_balance / white_balance.min() * share).clip(max=1.0) - 2.0 / FULL
    return np.where(picture >= limits, np.float32(1.0), picture)


def _scaled(raw: Any, white_balance: np.ndarray) -> np.ndarray:
    """A linear DNG, which has all three colours at each pixel.

    Not by LibRaw, which takes a black level of three numbers off and still divides by the white level
    alone (0.22): white would not be white.
    """
    black = np.array(raw.black_level_per_channel[:3], np.float32)
    values = (raw.raw_image_visible[..., :3].astype(np.float32) - black) / (raw.white_level - black)
    values = (values * (white_balance / white_balance.min())).clip(0.0, 1.0)
    turns = {3: 2, 5: 1, 6: 3}.get(raw.sizes.flip, 0)  # LibRaw's: 180°, 90° against and with the clock
    return np.ascontiguousarray(np.rot90(values, turns))


def _halved(picture: np.ndarray) -> np.ndarray:
    height, width = (side // 2 * 2 for side in picture.shape[:2])
    return picture[:height, :width].reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))


def to_rec709(raw: Any) -> np.ndarray:
    """``[3, 3]``: the camera's primaries, white balanced, to Linear Rec.709; white stays white."""
    matrix = np.array(raw.color_matrix, np.float64)[:, :3]
    sums = matrix.sum(axis=1, keepdims=True)
    if not np.isfinite(matrix).all() or (np.abs(sums) < 1e-3).any():
        return np.eye(3)  # a file that tells no matrix: its colours are taken as they are
    return matrix / sums


def coloured(picture: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """A picture of the camera's primaries in Linear Rec.709, clipped to 0…1; where all are 1 they stay 1."""
    return (picture @ matrix.T.astype(np.float32)).clip(0.0, 1.0)


def _noise_profile(tags: Tags) -> Noise | None:
    """DNG's NoiseProfile, of green where each channel has its own; its unit of signal is ours."""
    try:
        numbers = [float(number) for number in tags[NOISE_PROFILE]]
    except (KeyError, TypeError, ValueError):
        return None
    if len(numbers) not in (2, 6) or not np.isfinite(numbers).all() or min(numbers) < 0.0:
        return None
    slope, offset = numbers[:2] if len(numbers) == 2 else numbers[2:4]
    return Noise(slope, offset)


def photosites(path: Path) -> list[np.ndarray]:
    """What the sensor saw, 0…1 between black and white level, a picture ``[h, w]`` for each of its colours.

    1 where it is nearly full, too, if it is full below white level: of what is cut off there nothing is told.
    [] of files that are not a mosaic any more: their noise was smoothed. Raises ``FileDamagedError``.
    """
    rawpy = require_rawpy()
    with opened(path) as raw:
        if raw.raw_type != rawpy.RawType.Flat or raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
            return []
        black = np.array(raw.black_level_per_channel, np.float32)[raw.raw_pattern]
        planes = planes_of_mosaic(raw.raw_image_visible, black, float(raw.white_level))
        if (share := _full_share(raw)) == 1.0:
            return planes
        return [np.where(plane >= BRIGHTEST * share, np.float32(1.0), plane) for plane in planes]
