# SPDX-License-Identifier: GPL-3.0-or-later
"""TIFF's tags and pictures as bytes: what EXIF, 16-bit TIFF and DNG are made of (TIFF 6.0; DNG 1.4).

Little-endian, one strip, no compression. A number that has to be a fraction is written as one: ``Fraction``s
are rationals, ``Signed`` ones with a sign, ints are short where they fit, else long, floats are doubles.
"""

import struct
from collections.abc import Mapping
from fractions import Fraction

import numpy as np

#: Sizes of TIFF's types in bytes, and how struct writes them.
BYTE, ASCII, SHORT, LONG, RATIONAL, UNDEFINED, SRATIONAL, DOUBLE = 1, 2, 3, 4, 5, 7, 10, 12
FORMATS = {BYTE: "B", SHORT: "H", LONG: "I", DOUBLE: "d"}
LARGEST_SHORT, LARGEST_LONG = 0xFFFF, 0xFFFFFFFF
#: Denominator of a signed fraction: a matrix' entries are good to a millionth.
MILLION = 1_000_000

# Tags, by the names of TIFF 6.0 and EXIF 2.3.
WIDTH, HEIGHT, BITS, COMPRESSION, PHOTOMETRIC = 256, 257, 258, 259, 262
MAKE, MODEL, STRIP_OFFSETS, ORIENTATION, CHANNELS = 271, 272, 273, 274, 277
ROWS_PER_STRIP, STRIP_BYTES, PLANAR, MOMENT = 278, 279, 284, 306
EXIF_DIRECTORY, EXPOSURE_TIME, F_NUMBER, ISO, EXIF_VERSION = 34665, 33434, 33437, 34855, 36864
TAKEN, EXPOSURE_BIAS, FOCAL_35MM = 36867, 37380, 41989
RGB = 2
SINGLE_STRIP_TAG = {STRIP_OFFSETS: 8}


class Signed(Fraction):
    """A fraction that may be below 0."""


Value = str | bytes | int | float | Fraction | tuple[int, ...] | tuple[float, ...] | tuple[Fraction, ...]
Tags = Mapping[int, Value]


def picture(pixels: np.ndarray, tags: Tags, exif: Tags) -> bytes:
    """A TIFF of pixels [height, width] or [height, width, channels] uint16, with further ``tags``."""
    height, width = pixels.shape[:2]
    channels = pixels.shape[2] if pixels.ndim == 3 else 1
    strip = np.ascontiguousarray(pixels, "<u2").tobytes()
    every = {
        WIDTH: width,
        HEIGHT: height,
        BITS: (16,) * channels,
        COMPRESSION: 1,
        CHANNELS: channels,
        ROWS_PER_STRIP: height,
        STRIP_BYTES: len(strip),
        PLANAR: 1,
        **tags,
        **SINGLE_STRIP_TAG,
    }
    return _file(every, exif, strip)


def exif_block(tags: Tags, exif: Tags) -> bytes:
    """What a JPEG's APP1 holds behind its ``Exif`` mark: tags of the first directory, and EXIF's own."""
    return _file(dict(tags), exif, b"")


def _file(tags: dict[int, Value], exif: Tags, strip: bytes) -> bytes:
    """Header, strip, EXIF's directory, then the first one, that names the place of both."""
    head = 8 + len(strip) + len(strip) % 2
    inner = _directory(exif, head)
    first = _directory({**tags, EXIF_DIRECTORY: head}, head + len(inner))
    return struct.pack("<2sHI", b"II", 42, head + len(inner)) + strip + bytes(len(strip) % 2) + inner + first


def _directory(tags: Tags, at: int) -> bytes:
    """A directory that begins ``at`` this byte of the file, the long values behind it."""
    entries, rest = b"", b""
    behind = at + 2 + 12 * len(tags) + 4
    for tag in sorted(tags):
        kind, count, data = _packed(tag, tags[tag])
        if len(data) > 4:
            rest += bytes(len(rest) % 2)
            place = struct.pack("<I", behind + len(rest))
            rest += data
        else:
            place = data.ljust(4, b"\0")
        entries += struct.pack("<HHI", tag, kind, count) + place
    rest += bytes(len(rest) % 2)
    return struct.pack("<H", len(tags)) + entries + bytes(4) + rest


def _packed(tag: int, value: Value) -> tuple[int, int, bytes]:
    """TIFF's type, the count and the bytes of a value."""
    if isinstance(value, str):
        data = value.encode("ascii") + b"\0"
        return ASCII, len(data), data
    if isinstance(value, bytes):
        return (UNDEFINED if tag == EXIF_VERSION else BYTE), len(value), value
    values = value if isinstance(value, tuple) else (value,)
    if isinstance(values[0], Signed):
        return SRATIONAL, len(values), b"".join(_fraction(each, "<2i") for each in values)
    if isinstance(values[0], Fraction):
        return RATIONAL, len(values), b"".join(_fraction(each, "<2I") for each in values)
    if isinstance(values[0], float):
        kind = DOUBLE
    else:
        kind = LONG if tag in (EXIF_DIRECTORY, *SINGLE_STRIP_TAG) or max(values) > LARGEST_SHORT else SHORT
    return kind, len(values), struct.pack(f"<{len(values)}{FORMATS[kind]}", *values)


def _fraction(value: object, form: str) -> bytes:
    assert isinstance(value, Fraction)
    return struct.pack(form, value.numerator, value.denominator)


def fraction(value: float) -> Fraction:
    """A positive number as a fraction that fits into TIFF's, good to a part in a million.

    Of small numbers, such as the times of exposures, the inverse is what is limited.
    """
    if value >= 1.0:
        return Fraction(value).limit_denominator(min(MILLION, int(LARGEST_LONG / value)))
    return 1 / Fraction(1.0 / value).limit_denominator(
        max(1, int(LARGEST_LONG * value)) if value < 1e-3 else MILLION
    )


def signed(value: float) -> Signed:
    """A number within ±2000 to a millionth."""
    return Signed(round(value * MILLION), MILLION)
