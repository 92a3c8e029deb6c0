# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads and writes OpenEXR files of float or half channels: one part, scan lines, ZIP (or read: none).

Its own reader, because Blender's returns zeros for the missing half of a truncated file and applies colour
management; here a file is either whole and exact, or ``DamagedFileError``. Its own writer, because Blender
notes render times in its files, and the same picture has to give the same bytes.
Format: https://openexr.com/en/latest/OpenEXRFileLayout.html
"""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from . import folder
from .errors import DamagedFileError, NotFiniteError

MAGIC = 20000630
LINES_PER_BLOCK = {0: 1, 2: 1, 3: 16}  # none, ZIPS, ZIP
ZIP = 3
#: Kind of channel → how its numbers lie in the file.
HALF, FLOAT = 1, 2
TYPES = {HALF: np.dtype("<f2"), FLOAT: np.dtype("<f4")}
#: What is farther from 0 is infinite as a half float.
LARGEST_HALF = 65504.0
LARGEST_SIDE = 16384
LONG_NAMES = 0x400
SHORT_NAME = 31
LEVEL = 4  # OpenEXR's own default; measured: 9 takes five times as long for a file 2 % smaller
LEAST_SIZE = 9


def read(path: Path) -> np.ndarray:
    """Radiance [height, width, 3] float32, top row first, of a picture with the channels R, G, B.

    Raises:
        DamagedFileError: the file is not whole, or holds other channels.
        NotFiniteError: it has values that are not finite.
    """
    channels, _ = read_channels(path)
    if not {"R", "G", "B"} <= channels.keys():
        raise DamagedFileError(
            f"'{path}' is damaged (channels {sorted(channels)} hold no RGB): "
            "delete it and run again to make it anew"
        )
    return np.stack([channels[name] for name in "RGB"], -1)


def read_channels(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """All channels by name, each [height, width] float32, top row first, and the header's texts.

    Raises:
        DamagedFileError: the file is not whole, or not of this kind.
        NotFiniteError: it has values that are not finite.
    """
    data = folder.read(path)
    try:
        channels, texts = _decode(data)
    except Exception as error:  # whatever fails on the bytes says that they are damaged
        raise DamagedFileError(
            f"'{path}' is damaged ({error}): delete it and run again to make it anew"
        ) from error
    if not all(np.isfinite(plane).all() for plane in channels.values()):
        raise NotFiniteError(f"'{path}' holds values that are not finite: delete it and run again")
    return channels, texts


def encode_rgb(
    image: np.ndarray, texts: Mapping[str, str] | None = None, kind: int = FLOAT, level: int = LEVEL
) -> bytes:
    """EXR file of a picture [height, width, 3], scene-linear Rec.709."""
    return encode({name: image[..., k] for k, name in enumerate("RGB")}, texts, kind, level)


def encode(
    channels: Mapping[str, np.ndarray],
    texts: Mapping[str, str] | None = None,
    kind: int = FLOAT,
    level: int = LEVEL,
) -> bytes:
    """EXR file of channels [height, width] by name, and of further texts for its header.

    ``kind``: ``HALF`` rounds to 11 bits; nothing may be beyond ``LARGEST_HALF``. ``level``: zlib's.
    """
    names = sorted(channels)
    height, width = channels[names[0]].shape
    planes = np.stack(
        [np.asarray(channels[name], TYPES[kind]) for name in names], 1
    )  # [height, channels, width]
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    entries = [name.encode() + struct.pack("<xiIii", kind, 0, 1, 1) for name in names]
    attributes = {
        "channels": ("chlist", b"".join(entries) + b"\0"),
        "chromaticities": (
            "chromaticities",
            struct.pack("<8f", 0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
        ),
        "compression": ("compression", bytes([ZIP])),
        "dataWindow": ("box2i", window),
        "displayWindow": ("box2i", window),
        "lineOrder": ("lineOrder", b"\0"),
        "pixelAspectRatio": ("float", struct.pack("<f", 1.0)),
        "screenWindowCenter": ("v2f", struct.pack("<2f", 0.0, 0.0)),
        "screenWindowWidth": ("float", struct.pack("<f", 1.0)),
    }
    attributes |= {name: ("string", text.encode()) for name, text in (texts or {}).items()}
    long = any(len(name.encode()) > SHORT_NAME for name in [*names, *attributes])
    head = struct.pack("<II", MAGIC, 2 | (LONG_NAMES if long else 0))
    for name, (sort, value) in sorted(attributes.items()):
        head += name.encode() + b"\0" + sort.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    step = LINES_PER_BLOCK[ZIP]
    blocks = []
    for line in range(0, height, step):
        raw = planes[line : line + step].tobytes()
        packed = _zip(raw, level)
        packed = packed if len(packed) < len(raw) else raw
        blocks.append(struct.pack("<ii", line, len(packed)) + packed)
    sizes = [len(block) for block in blocks[:-1]]
    first = len(head) + 8 * len(blocks)
    offsets = np.cumsum([first, *sizes]).astype("<u8").tobytes()
    return head + offsets + b"".join(blocks)


def _decode(data: bytes) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    magic, version = struct.unpack_from("<II", data, 0)
    if magic != MAGIC or version & 0xFF != 2 or version & 0x1A00:
        raise ValueError("not a single-part scan-line OpenEXR file")
    header, at = _header(data, 8)
    compression = header["compression"][1][0]
    if compression not in LINES_PER_BLOCK:
        raise ValueError(f"compression {compression} is not ZIP")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"][1])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
        raise ValueError(f"size {width} × {height}")
    names, stored = _channels(header["channels"][1])
    step = LINES_PER_BLOCK[compression]
    blocks = -(-height // step)
    # What is claimed must be there before memory is taken for it: deflate shrinks to a thousandth at most.
    if height * width * len(names) * stored.itemsize > 1100 * len(data):
        raise ValueError("too short for its size")
    planes = np.empty((height, len(names), width), np.float32)
    missing = set(range(0, height, step))  # lines at which a block begins
    for (offset,) in struct.iter_unpack("<Q", data[at : at + 8 * blocks]):
        if offset + 8 > len(data):
            raise ValueError("ends early")
        line, size = struct.unpack_from("<ii", data, offset)
        packed = data[offset + 8 : offset + 8 + size]
        if len(packed) != size or line - y0 not in missing:
            raise ValueError("ends early, or has lines twice")
        missing.remove(line - y0)
        rows = planes[line - y0 : line - y0 + step]
        length = rows.size * stored.itemsize
        raw = packed if size == length else _unzip(packed, length)
        rows[:] = np.frombuffer(raw, stored).reshape(rows.shape)
    if missing:
        raise ValueError("ends early")
    texts = {
        name: value.decode("utf-8", "replace") for name, (kind, value) in header.items() if kind == "string"
    }
    return {name: planes[:, k].copy() for k, name in enumerate(names)}, texts


def _header(data: bytes, at: int) -> tuple[dict[str, tuple[str, bytes]], int]:
    """Attributes by name as (type, value), and where the offset table starts."""
    attributes = {}
    while data[at]:
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", data, type_end + 1)
        if not 0 <= size <= len(data):
            raise ValueError("an attribute of an impossible size")
        kind = data[name_end + 1 : type_end].decode("latin-1")
        attributes[data[at:name_end].decode("latin-1")] = (kind, data[type_end + 5 : type_end + 5 + size])
        at = type_end + 5 + size
    return attributes, at + 1


def _channels(data: bytes) -> tuple[list[str], np.dtype]:
    """Names, and how the numbers of all of them lie in the file."""
    names, kinds, at = [], set(), 0
    while data[at]:
        end = data.index(b"\0", at)
        kind, _, x_sampling, y_sampling = struct.unpack_from("<iIii", data, end + 1)
        if kind not in TYPES or (x_sampling, y_sampling) != (1, 1):
            raise ValueError("a channel is neither float nor half")
        names.append(data[at:end].decode("utf-8"))
        kinds.add(kind)
        at = end + 17
    if len(kinds) != 1:
        raise ValueError("its channels are of several kinds")
    return names, TYPES[kinds.pop()]


def _zip(raw: bytes, level: int) -> bytes:
    """OpenEXR's ZIP: even bytes, then odd ones, each as the difference to the one before, deflated."""
    flat = np.frombuffer(raw, np.uint8)
    halves = np.concatenate([flat[0::2], flat[1::2]])
    delta = halves.copy()
    delta[1:] -= halves[:-1]
    delta[1:] += 128
    return zlib.compress(delta.tobytes(), level)


def _unzip(packed: bytes, size: int) -> bytes:
    # Not more than is wanted: a block of a megabyte may unpack to a gigabyte. A byte too many shows it.
    unpacking = zlib.decompressobj()
    flat = np.frombuffer(unpacking.decompress(packed, size + 1), np.uint8)
    if not unpacking.eof or flat.size != size:
        raise ValueError("block of the wrong size")
    delta = flat.astype(np.int64)
    delta[1:] -= 128
    predicted = np.cumsum(delta).astype(np.uint8)
    half = (size + 1) // 2
    out = np.empty(size, np.uint8)
    out[0::2], out[1::2] = predicted[:half], predicted[half:]
    return out.tobytes()
