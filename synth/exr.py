# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the OpenEXR files that Blender writes for us: one part, scan lines, ZIP or none, float RGB.

Its own reader, because Blender's returns zeros for the missing half of a truncated file and applies colour
management; here a file is either whole and exact, or ``DamagedFileError``.
Format: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path

import numpy as np

from .errors import DamagedFileError, NotFiniteError

MAGIC = 20000630
LINES_PER_BLOCK = {0: 1, 2: 1, 3: 16}  # none, ZIPS, ZIP
FLOAT = 2
LARGEST_SIDE = 16384


def read(path: Path) -> np.ndarray:
    """Radiance [height, width, 3] float32, top row first.

    Raises:
        DamagedFileError: the file is not whole, holds other channels, or has values that are not finite.
    """
    try:
        image = _decode(path.read_bytes())
    except OSError as error:
        raise DamagedFileError(f"cannot read '{path}': {error.strerror or error}") from error
    except (ValueError, KeyError, IndexError, struct.error, zlib.error) as error:
        raise DamagedFileError(
            f"'{path}' is damaged ({error}): delete it and run again to render it anew"
        ) from error
    if not np.isfinite(image).all():
        raise NotFiniteError(f"'{path}' holds values that are not finite: delete it and run again")
    return image


def without_times(data: bytes) -> bytes:
    """The file with zeros for the digits of the times that Cycles notes in its header.

    They are the only thing that differs between two renders of one picture.
    """
    made = bytearray(data)
    at = 8
    while data[at]:
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        start = type_end + 5
        if data[at:name_end].startswith(b"cycles.") and data[at:name_end].endswith(b"_time"):
            made[start : start + size] = re.sub(rb"\d", b"0", data[start : start + size])
        at = start + size
    return bytes(made)


def _decode(data: bytes) -> np.ndarray:
    magic, version = struct.unpack_from("<II", data, 0)
    if magic != MAGIC or version & 0xFF != 2 or version & 0x1A00:
        raise ValueError("not a single-part scan-line OpenEXR file")
    header, at = _header(data, 8)
    compression = header["compression"][0]
    if compression not in LINES_PER_BLOCK:
        raise ValueError(f"compression {compression} is not ZIP")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
        raise ValueError(f"size {width} × {height}")
    channels = _channels(header["channels"])
    if not {"R", "G", "B"} <= set(channels):
        raise ValueError(f"channels {channels} hold no RGB")
    step = LINES_PER_BLOCK[compression]
    planes = np.empty((height, len(channels), width), np.float32)
    for (offset,) in struct.iter_unpack("<Q", data[at : at + 8 * -(-height // step)]):
        line, size = struct.unpack_from("<ii", data, offset)
        packed = data[offset + 8 : offset + 8 + size]
        rows = planes[line - y0 : line - y0 + step]
        if len(packed) != size or not len(rows):
            raise ValueError("ends early")
        raw = packed if size == rows.nbytes else _unzip(packed, rows.nbytes)
        rows[:] = np.frombuffer(raw, "<f4").reshape(rows.shape)
    return np.ascontiguousarray(planes[:, [channels.index(name) for name in "RGB"]].transpose(0, 2, 1))


def _header(data: bytes, at: int) -> tuple[dict[str, bytes], int]:
    """Attributes by name, and where the offset table starts."""
    attributes = {}
    while data[at]:
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        attributes[data[at:name_end].decode("latin-1")] = data[type_end + 5 : type_end + 5 + size]
        at = type_end + 5 + size
    return attributes, at + 1


def _channels(data: bytes) -> list[str]:
    names, at = [], 0
    while data[at]:
        end = data.index(b"\0", at)
        kind, _, x_sampling, y_sampling = struct.unpack_from("<iIii", data, end + 1)
        if (kind, x_sampling, y_sampling) != (FLOAT, 1, 1):
            raise ValueError("a channel is not 32-bit float")
        names.append(data[at:end].decode("latin-1"))
        at = end + 17
    return names


def _unzip(packed: bytes, size: int) -> bytes:
    """OpenEXR's ZIP: deflate, then a delta predictor, then the two halves of the bytes interleaved."""
    flat = np.frombuffer(zlib.decompress(packed), np.uint8)
    if flat.size != size:
        raise ValueError("block of the wrong size")
    delta = flat.astype(np.int64)
    delta[1:] -= 128
    predicted = np.cumsum(delta).astype(np.uint8)
    half = (size + 1) // 2
    out = np.empty(size, np.uint8)
    out[0::2], out[1::2] = predicted[:half], predicted[half:]
    return out.tobytes()
