# SPDX-License-Identifier: GPL-3.0-or-later
"""What a camera wrote about a picture (EXIF), for data sets and for photos to be prepared.

Pillow parses the tags: OpenImageIO 3.2 reports none of a PNG. What they mean together (APEX values, ISO
beyond 65535) neither says.
"""

import math
import os
import statistics
import struct
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image, PngImagePlugin

from ...bridge.errors import PhysHDRError
from ...bridge.regular import damaged_where_it_fails
from .pictures import READABLE, kind_of, open_with_pillow

#: How a picture is to be turned: values under which width and height change places.
LYING = (5, 6, 7, 8)
#: What DCF calls Adobe RGB where EXIF leaves the colour space open; some write 2 for that, too.
ADOBE_RGB_INDEX, ADOBE_RGB_SPACE, SRGB_SPACE = "R03", 2, 1
#: Above this ISO its old tag holds 65535, and the index tag the value (EXIF 2.3).
LARGEST_ISO = 65534
#: No APEX value of a time or an aperture is beyond.
LARGEST_APEX = 40.0

#: Bytes of a PNG's signature, of a chunk's checksum, and of a text's keyword at most (PNG, 5.2, 5.3, 11.3.3).
PNG_SIGNATURE, CHECKSUM, LONGEST_KEYWORD = 8, 4, 79
#: Texts of a PNG in which there may be EXIF or an orientation.
EXIF_TEXTS = (b"Raw profile type exif", b"XML:com.adobe.xmp")
#: Chunks of a PNG that are looked at: writers make one of each 8 KB or more.
MOST_CHUNKS = 1 << 18
#: TIFF's tag of the places of the pictures inside.
SUB_DIRECTORIES = 330
#: What Pillow raises where a file's tags are damaged.
UNREADABLE = (
    *(OSError, SyntaxError, ValueError, KeyError, TypeError, IndexError, OverflowError, struct.error),
)

#: Tags by number.
Tags = Mapping[int, Any]


@dataclass(frozen=True)
class Exif:
    """What a camera wrote of a picture's exposure; None where it did not. ``time``: seconds.

    ``bias``: the photographer's exposure compensation, stops. ``brightness``: APEX's Bv, log2 of what
    the camera metered.
    """

    time: float | None = None
    iso: float | None = None
    f_number: float | None = None
    bias: float | None = None
    brightness: float | None = None


@dataclass(frozen=True)
class ComparableExposures:
    """``seconds`` for each picture, at ISO 100 and at ``f_number``, the pictures' median (None: unstated)."""

    seconds: list[float]
    f_number: float | None


def comparable(pictures: Sequence[Exif]) -> ComparableExposures:
    """time × ISO / 100 × (F_median / F)² for each picture: equal radiance then gives equal exposure.

    Every picture must state its time. An ISO or an aperture that no picture states (a manual lens) is the
    same for all and cancels; callers check that all state it or none.
    """
    f_numbers = [picture.f_number for picture in pictures if picture.f_number is not None]
    median = statistics.median(f_numbers) if f_numbers else None
    seconds = []
    for picture in pictures:
        assert picture.time is not None
        gain = (picture.iso or 100.0) / 100.0
        if median is not None and picture.f_number is not None:
            ratio = median / picture.f_number
            gain *= ratio * ratio  # infinite where ** would raise; callers refuse that
        seconds.append(picture.time * gain)
    return ComparableExposures(seconds, median)


def read_exif(path: Path) -> Exif:
    """A picture's EXIF; all None where it has none, or what it has cannot be read."""
    return exposure_of(tags_of_file(path))


def tags_of_file(path: Path) -> Tags:
    """The EXIF tags of a picture of any kind; {} where it has none, or they cannot be read."""
    try:
        kind = kind_of(path)
        with damaged_where_it_fails(str(path)):
            if kind == "TIFF":
                return tags_of_tiff(path)
            if kind in READABLE:
                with open_with_pillow(path, READABLE) as picture:
                    return tags_of(picture)
    except PhysHDRError:
        pass  # the reader of pictures reports what is wrong with the file
    return {}


def tags_of(picture: Image.Image) -> Tags:
    """The EXIF tags of an open picture; {} where they are damaged: callers report what they lack."""
    try:
        return _all_of(_exif_of(picture))
    except UNREADABLE:
        return {}


def _exif_of(picture: Image.Image) -> Image.Exif:
    """Pillow's EXIF. A PNG without EXIF before its pixels Pillow would decode whole, to look behind them."""
    if (
        isinstance(picture, PngImagePlugin.PngImageFile)
        and "exif" not in picture.info
        and picture.filename
        and not _is_behind_pixels(picture.filename)
    ):
        return Image.Image.getexif(picture)
    return picture.getexif()


def _is_behind_pixels(path: str | bytes) -> bool:
    """Whether a PNG has EXIF or XMP behind its pixels, as far as its chunks are undamaged."""
    pixels = False
    with open(path, "rb") as file:
        file.seek(PNG_SIGNATURE)
        for _ in range(MOST_CHUNKS):
            length, kind = struct.unpack(">I4s", file.read(8).ljust(8, b"\0"))
            if kind in (b"IEND", bytes(4)):
                break
            start = b""
            if kind == b"IDAT":
                pixels = True
            elif pixels and kind == b"eXIf":
                return True
            elif pixels and kind in (b"tEXt", b"zTXt", b"iTXt"):
                start = file.read(min(length, LONGEST_KEYWORD + 1))
                if start.partition(b"\0")[0] in EXIF_TEXTS:
                    return True
            file.seek(length - len(start) + CHECKSUM, os.SEEK_CUR)
    return False


def tags_of_exif(block: bytes) -> Tags:
    """The tags of a block of EXIF, as other files than Pillow's hold one; {} where it is damaged or empty."""
    exif = Image.Exif()
    try:
        exif.load(block)
        return _all_of(exif)
    except UNREADABLE:
        return {}


def tags_of_tiff(path: Path) -> Tags:
    """The tags of a file that is built like a TIFF, as most cameras' raw files are; {} of any other.

    Those of the pictures inside (a DNG has its raw one there, beside a preview) fill up what the first
    directory lacks.
    """
    exif = Image.Exif()
    tags: dict[int, Any] = {}
    try:
        with open(path, "rb") as file:
            exif.load_from_fp(file)
            tags = {**_all_of(exif)}
            for offset in _numbers(tags.get(SUB_DIRECTORIES)):
                exif.load_from_fp(file, offset)
                tags = {**exif, **tags}
    except UNREADABLE:
        pass  # what was read until then
    return tags


def _numbers(value: Any) -> tuple[int, ...]:
    return tuple(value) if isinstance(value, tuple | list) else () if value is None else (value,)


def _all_of(exif: Image.Exif) -> Tags:
    tags = {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}
    with suppress(*UNREADABLE):  # an exposure is worth more than a colour space
        tags |= exif.get_ifd(ExifTags.IFD.Interop)
    return tags


def exposure_of(tags: Tags) -> Exif:
    """Time, ISO and aperture; the APEX values count where a camera gives only these."""
    return Exif(
        positive(tags, ExifTags.Base.ExposureTime) or _apex(tags, ExifTags.Base.ShutterSpeedValue, -1.0),
        _iso(tags),
        positive(tags, ExifTags.Base.FNumber) or _apex(tags, ExifTags.Base.ApertureValue, 0.5),
        _stops(tags, ExifTags.Base.ExposureBiasValue),
        _stops(tags, ExifTags.Base.BrightnessValue),
    )


def orientation_of(tags: Tags) -> int:
    """How a picture is to be turned by what its camera wrote, 1 to 8; 1 where nothing is written."""
    value = tags.get(ExifTags.Base.Orientation)
    return value if isinstance(value, int) and 1 <= value <= 8 else 1


def is_adobe_rgb(tags: Tags) -> bool:
    """Whether a camera was set to Adobe RGB: many embed no profile then (DCF 2.0; CIPA DC-008, annex E)."""
    space = tags.get(ExifTags.Base.ColorSpace)
    if space in (ADOBE_RGB_SPACE, SRGB_SPACE):
        return space == ADOBE_RGB_SPACE
    return str(tags.get(ExifTags.Base.InteropIndex, "")).strip(" \0") == ADOBE_RGB_INDEX


def positive(tags: Tags, tag: int) -> float | None:
    """A tag as a number; None where it is missing, 0 (a lens without contacts has F 0) or nonsense."""
    number = _number(tags, tag)
    return number if number is not None and number > 0.0 else None


def _number(tags: Tags, tag: int) -> float | None:
    value = tags.get(tag)
    if isinstance(value, tuple | list) and value:  # ISO may be a list of one
        value = value[0]
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _apex(tags: Tags, tag: int, power: float) -> float | None:
    """Time = 2^−Tv, F = 2^(Av/2) (EXIF 2.3, annex C)."""
    value = _number(tags, tag)
    return None if value is None or abs(value) > LARGEST_APEX else 2.0 ** (power * value)


def _stops(tags: Tags, tag: int) -> float | None:
    """A difference or a brightness in stops; EXIF's "unknown" is −1 as an unsigned number: far beyond."""
    value = _number(tags, tag)
    return None if value is None or abs(value) > LARGEST_APEX else value


def _iso(tags: Tags) -> float | None:
    iso = positive(tags, ExifTags.Base.ISOSpeedRatings)
    if iso is None or iso > LARGEST_ISO:
        return positive(tags, ExifTags.Base.RecommendedExposureIndex) or iso
    return iso
