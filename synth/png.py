# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes and reads 8-bit RGBA PNG without colour management: code values in, the same code values on disk."""

import struct
import zlib
from pathlib import Path

import numpy as np

from . import folder
from .errors import DamagedFileError

#: Of 8 bits, and of 16.
LARGEST_CODE, LARGEST_CODE_16 = 255, 65535
SIGNATURE = b"\x89PNG\r\n\x1a\n"


def quantise(code: np.ndarray, largest: int = LARGEST_CODE) -> np.ndarray:
    """Code values 0…1 → 0…255, to the nearest; ``LARGEST_CODE_16``: 0…65535."""
    kind = np.uint8 if largest == LARGEST_CODE else np.uint16
    return np.floor(np.clip(code, 0.0, 1.0) * float(largest) + 0.5).astype(kind)


def encode(image: np.ndarray) -> bytes:
    """PNG file of an image [height, width, 3] uint8, opaque."""
    height, width, _ = image.shape
    rows = np.zeros((height, 1 + 4 * width), np.uint8)  # filter type 0 before each row
    rows[:, 1:] = np.dstack([image, np.full((height, width, 1), 255, np.uint8)]).reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return (
        SIGNATURE
        + _chunk(b"IHDR", header)
        + _chunk(b"IDAT", zlib.compress(rows.tobytes(), 9))
        + _chunk(b"IEND", b"")
    )


def read(path: Path) -> np.ndarray:
    """Image [height, width, 3] uint8 of a file that ``encode`` made.

    Raises:
        DamagedFileError: the file is not there, not whole, or not of this kind.
    """
    data = folder.read(path)
    try:
        return _decode(data)
    except Exception as error:  # whatever fails on the bytes says that they are damaged
        raise DamagedFileError(
            f"'{path}' is damaged ({error!s:.200}): delete it and run again to make it anew"
        ) from error


def _decode(data: bytes) -> np.ndarray:
    """Raises whatever fails on damaged bytes."""
    width, height = struct.unpack_from(">II", data, 16)
    (size,) = struct.unpack_from(">I", data, 33)
    rows = np.frombuffer(zlib.decompress(data[41 : 41 + size]), np.uint8).reshape(height, 1 + 4 * width)
    return rows[:, 1:].reshape(height, width, 4)[..., :3]


def _chunk(kind: bytes, payload: bytes) -> bytes:
    return struct.pack(">I", len(payload)) + kind + payload + struct.pack(">I", zlib.crc32(kind + payload))
