# SPDX-License-Identifier: GPL-3.0-or-later
"""SPZ, Niantic's compressed Gaussians: versions 2 to 4 are read, 3 and 4 written.

After the header come six blocks, each of all Gaussians: positions, opacities, colours, scales, rotations,
higher SH. Versions 1 to 3 are one gzip stream, version 4 has a plain header and one zstd stream a block.

- position: signed integers of 24 bits, of which the header tells how many are behind the point
- opacity: a byte, 0…1
- colour: bytes of ½ + 0.15 sh_0
- scale: bytes of 16 (ln standard deviation + 10)
- rotation: version 2: x, y, z in bytes from −1 to 1, w is positive. Later: a word with which of x, y, z, w is
  the largest in the highest 2 bits, then for the others in their order a sign and 9 bits of the magnitude up
  to 1/√2
- SH: bytes of 128 (sh + 1), coefficient by coefficient, each red, green, blue

The format's axes are Y up (right, up, backward), whoever turned the Gaussians; version 4 may name others.
"""

import gzip
import importlib
import io
import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..atomic import atomic_path
from ..axes import Up
from ..errors import BadValueError, FileDamagedError
from ..regular import regular_file
from .cloud import UP, SplatCloud
from .compressed_ply import with_largest
from .usable import ANTIALIASED_NOTE

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
#: Of versions 1 to 3: magic, version, Gaussians, SH degree, bits behind the point, flags, a byte of nothing.
HEADER = struct.Struct("<4sIIBBBB")
#: Of version 4 likewise, then the number of streams, where their table is, and 12 bytes of nothing.
HEADER_4 = struct.Struct("<4sIIBBBBI12x")
#: Sizes of a stream, compressed and not.
_STREAM = struct.Struct("<QQ")
#: Flags: it was trained with compensation of opacity; records of other makers follow the header.
_ANTIALIASED, _EXTENDED = 1, 2
#: Record (its number and size) that names the axes, by the numbers in ``_AXES``.
_RECORD = struct.Struct("<II")
_COORDINATE_SYSTEM = 0xADBE0003
#: Of the axes that can be named (1 is left-down-back, and so on) those that a turn makes into ours.
_AXES: dict[int, Up] = {4: "y", 6: "colmap", 12: "z"}

#: Coefficients of SH degree 0 to 4 beyond the first, and how many of them are kept.
_HIGHER = (0, 3, 8, 15, 24)
_KEPT = 15
COLOUR_SCALE = 0.15
#: Bits behind the point, at most: 24 bits then reach 1 m in steps of 0.12 µm. The other writers always have
#: 12: steps of 0.24 mm, whatever the scene's size. All readers take them from the header.
FRACTIONAL_BITS = 23
#: ln σ of bytes 0 and 255, and the largest SH that bytes reach: of the colour, and of the others.
_LOG_SCALES = (-10.0, 255.0 / 16.0 - 10.0)
_LARGEST_SH = (0.5 / COLOUR_SCALE, 1.0)
#: Steps of SH in a byte's 128 a unit: 5 bits in band 1, 4 in the others, as the format's own writer.
_SH_STEPS = (8, 16)
_LARGEST_WORD = (1 << 9) - 1
#: A file unpacks to this many bytes, or this many times its own; real ones to 2 to 20 times. What claims more
#: is a bomb.
ALWAYS_UNPACKED, LARGEST_RATIO = 1 << 26, 50
#: Bytes that may follow the blocks of versions 1 to 3, or stand before those of 4: records of other makers.
_LARGEST_TAIL = 1 << 20
#: Of 1 to 22: a million Gaussians take seconds.
_ZSTD_LEVEL = 12
_REMEDY = "Copy or convert it again: it may be cut off."


@dataclass(frozen=True)
class _Header:
    """What a header says."""

    version: int
    count: int
    degree: int
    fractional_bits: int
    is_antialiased: bool

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of each block."""
        rotation = 3 if self.version == 2 else 4
        return tuple(self.count * each for each in (9, 1, 3, 3, rotation, 3 * _HIGHER[self.degree]))


def read_spz(path: Path) -> SplatCloud:
    """Read an SPZ of version 2, 3 or 4, in its own axes.

    Raises ``FileMissingError``, ``FileDamagedError`` where it is damaged, claims more than it holds or is of
    another version, ``BadValueError`` where version 4 needs a Python that knows zstd.
    """
    regular_file(path, _REMEDY)
    with _readable(path), path.open("rb") as file:
        start = file.read(HEADER_4.size)
        file.seek(0)
        if start.startswith(GZIP):
            return _read_gzip(path, file)
        return _read_streams(path, file, start)


def write_spz(path: Path, cloud: SplatCloud, version: int) -> tuple[str, ...]:
    """Write ``cloud`` as SPZ of ``version`` 3 or 4, atomically, in the axes that it has.

    SPZ's own are Y up: turning is the caller's (``cloud.turned``). SH are kept in 5 bits (band 1) and 4 bits
    of −1…1, as by the format's own writer, and positions in the finest steps that reach all of them. Returns
    sentences for the user about what the bytes do not reach. Raises ``BadValueError`` where the version is
    another, a position is beyond what 24 bits hold or version 4 lacks zstd, and ``OutputError``.
    """
    if version not in (3, 4):
        raise BadValueError(f"SPZ of version {version} is not written", "Versions 3 and 4 are.")
    if not cloud.count:
        raise BadValueError("SPZ: there are no Gaussians to write", "Choose another file.")
    bits = _bits_for(cloud.position)
    degree = _HIGHER.index(cloud.colour_sh.shape[1] - 1)
    blocks = _blocks(cloud, bits)
    if version == 4:
        compress = _zstd("write").compress
        streams = [(compress(block), len(block)) for block in blocks if block]
        header = HEADER_4.pack(MAGIC, 4, cloud.count, degree, bits, 0, len(streams), HEADER_4.size)
        parts = [header, *(_STREAM.pack(len(packed), size) for packed, size in streams)]
        parts += [packed for packed, _ in streams]
    else:
        header = HEADER.pack(MAGIC, 3, cloud.count, degree, bits, 0, 0)
        # No time of writing: the same Gaussians give the same bytes.
        parts = [gzip.compress(b"".join([header, *blocks]), 6, mtime=0)]
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"".join(parts))
    return _clipped(cloud)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise FileDamagedError(f"{path} cannot be read: {error.strerror or error}", _REMEDY) from error


def _read_gzip(path: Path, file: BinaryIO) -> SplatCloud:
    size = path.stat().st_size
    unpacked = gzip.GzipFile(fileobj=file)
    try:
        header = _checked_header(path, HEADER.unpack(_exactly(unpacked, HEADER.size)), (2, 3))
        _check_size(path, header, size)
        blocks = [_exactly(unpacked, each) for each in header.sizes]
        if len(unpacked.read(_LARGEST_TAIL + 1)) > _LARGEST_TAIL:
            raise FileDamagedError(f"{path} has data after its {header.count} Gaussians", _REMEDY)
    except (EOFError, zlib.error, gzip.BadGzipFile, struct.error) as error:
        raise FileDamagedError(f"{path} is not a whole SPZ ({error})", _REMEDY) from error
    return _cloud(header, blocks, UP["spz"])


def _read_streams(path: Path, file: BinaryIO, start: bytes) -> SplatCloud:
    if not start.startswith(MAGIC) or len(start) < HEADER_4.size:
        raise FileDamagedError(f"{path} is not an SPZ: it begins neither with NGSP nor as gzip", _REMEDY)
    *front, stream_count, table = HEADER_4.unpack(start)
    header = _checked_header(path, (*front, 0), (4,))
    size = path.stat().st_size
    _check_size(path, header, size)
    wanted = [each for each in header.sizes if each]
    if stream_count != len(wanted) or not HEADER_4.size <= table <= min(size, _LARGEST_TAIL):
        raise FileDamagedError(f"{path}: an SPZ of {stream_count} streams, not {len(wanted)}", _REMEDY)
    up = _named_up(path, file.read(table)[HEADER_4.size :] if front[-1] & _EXTENDED else b"")
    file.seek(table)
    sizes = list(
        _STREAM.iter_unpack(file.read(_STREAM.size * stream_count).ljust(_STREAM.size * stream_count))
    )
    zstd, blocks = _zstd("read"), []
    for (packed, unpacked), expected in zip(sizes, wanted, strict=True):
        raw = file.read(packed) if packed <= size else b""
        if unpacked != expected or len(raw) != packed:
            raise FileDamagedError(
                f"{path}: a stream of {len(raw)} bytes that claims {packed}, and {unpacked} for {expected}",
                _REMEDY,
            )
        block = zstd.decompress(raw, expected)
        if block is None or len(block) != expected:
            raise FileDamagedError(f"{path}: a stream that is not {expected} bytes of zstd", _REMEDY)
        blocks.append(block)
    blocks += [b""] * (6 - len(blocks))
    return _cloud(header, blocks, up)


def _checked_header(path: Path, header: tuple[Any, ...], versions: tuple[int, ...]) -> _Header:
    magic, version, count, degree, bits, flags, *_ = header
    if magic != MAGIC:
        raise FileDamagedError(f"{path} is not an SPZ: its header does not begin with NGSP", _REMEDY)
    if version not in versions:
        raise FileDamagedError(
            f"{path} is an SPZ of version {version}", "Versions 2, 3 and 4 are read: save it as one of these."
        )
    if degree >= len(_HIGHER) or bits > 23 or not count:
        what = "no Gaussians" if not count else f"SH degree {degree} and {bits} bits behind the point"
        raise FileDamagedError(f"{path} is an SPZ of {what}", _REMEDY)
    return _Header(version, count, degree, bits, bool(flags & _ANTIALIASED))


def _check_size(path: Path, header: _Header, size: int) -> None:
    """Raises where the header claims more than a file of ``size`` bytes can hold: before memory is taken."""
    claimed = sum(header.sizes)
    if claimed > max(ALWAYS_UNPACKED, LARGEST_RATIO * size):
        raise FileDamagedError(
            f"{path} claims {header.count} Gaussians, {claimed} bytes, in {size}: it is damaged, or a bomb",
            _REMEDY,
        )


def _exactly(file: Any, size: int) -> bytes:
    """``size`` bytes of a stream; raises ``EOFError`` where it has fewer."""
    parts = []
    while size and (part := file.read(min(size, 1 << 24))):
        parts.append(part)
        size -= len(part)
    if size:
        raise EOFError(f"{size} bytes are missing")
    return b"".join(parts)


def _named_up(path: Path, records: bytes) -> Up:
    """Which way is up by the record that names the axes, or the format's own."""
    place = 0
    while place + _RECORD.size <= len(records):
        kind, size = _RECORD.unpack_from(records, place)
        content = records[place + _RECORD.size : place + _RECORD.size + size]
        place += _RECORD.size + size
        if kind == _COORDINATE_SYSTEM and len(content) >= 4:
            (number,) = struct.unpack_from("<I", content)
            if number and number not in _AXES:
                raise FileDamagedError(
                    f"{path} names axes of its own (number {number}), which are not read",
                    "Save it in the format's own axes (right, up, back).",
                )
            return _AXES.get(number, UP["spz"])
    return UP["spz"]


def _cloud(header: _Header, blocks: list[bytes], up: Up) -> SplatCloud:
    count = header.count
    position, opacity, colour, scale, rotation, sh = (np.frombuffer(block, np.uint8) for block in blocks)
    triples = position.reshape(count, 3, 3).astype(np.int32)
    fixed = triples[..., 0] | triples[..., 1] << 8 | triples[..., 2] << 16
    fixed = (fixed ^ 0x800000) - 0x800000  # the 24th bit is the sign
    higher = _HIGHER[header.degree]
    kept = min(higher, _KEPT)
    notes = ["Of its SH degree 4 the highest band was left out."] if higher > kept else []
    notes += [ANTIALIASED_NOTE] if header.is_antialiased else []
    planes = np.empty((kept + 1, 3, count), np.float32)
    planes[0] = (colour.reshape(count, 3).T / np.float32(255.0) - np.float32(0.5)) / np.float32(COLOUR_SCALE)
    coefficients = sh.reshape(count, higher, 3)
    for k in range(kept):
        planes[k + 1] = (coefficients[:, k].T.astype(np.float32) - 128.0) / np.float32(128.0)
    return SplatCloud(
        position=fixed.astype(np.float32) / np.float32(1 << header.fractional_bits),
        rotation=_first_three(rotation) if header.version == 2 else _smallest_three(rotation),
        scale=np.exp(scale.reshape(count, 3) / np.float32(16.0) - np.float32(10.0)),
        opacity=opacity / np.float32(255.0),
        colour_sh=planes.transpose(2, 0, 1),
        notes=tuple(notes),
        up=up,
    )


def _first_three(raw: np.ndarray) -> np.ndarray:
    """Quaternions ``[N, 4]``, wxyz, of x, y, z in bytes."""
    xyz = raw.reshape(-1, 3) / np.float32(127.5) - np.float32(1.0)
    w = np.sqrt(np.maximum(np.float32(0.0), 1.0 - np.square(xyz).sum(axis=1)))
    return np.column_stack([w, xyz])


def _smallest_three(raw: np.ndarray) -> np.ndarray:
    """Quaternions ``[N, 4]``, wxyz, of words with a sign and 9 bits for each but the largest of xyzw."""
    words = raw.reshape(-1, 4).copy().view("<u4")[:, 0]
    parts = np.stack([(words >> shift) & 0x3FF for shift in (20, 10, 0)], axis=1).astype(np.int32)
    values = (parts & _LARGEST_WORD) * (0.5**0.5 / _LARGEST_WORD)
    xyzw = with_largest((words >> 30).astype(np.intp), np.where(parts > _LARGEST_WORD, -values, values))
    return np.roll(xyzw, 1, axis=1)


def _bits_for(position: np.ndarray) -> int:
    """Bits behind the point: as many as the farthest position leaves of 24 with a sign."""
    farthest = float(np.abs(position).max(initial=0.0))
    bits = FRACTIONAL_BITS
    while bits and farthest * (1 << bits) >= (1 << 23) - 1:
        bits -= 1
    if not farthest < (1 << 23) - 1:
        raise BadValueError(f"SPZ: a position of {farthest:g} does not fit its 24 bits", "Move it nearer.")
    return bits


def _clipped(cloud: SplatCloud) -> tuple[str, ...]:
    """A sentence about Gaussians beyond what bytes hold by more than they are rounded; none where none is."""
    low, high = (math.exp(end + side / 32.0) for end, side in zip(_LOG_SCALES, (-1.0, 1.0), strict=True))
    scale = int(np.count_nonzero(((cloud.scale < low) | (cloud.scale > high)).any(axis=1)))
    largest = np.abs(cloud.colour_sh).max(axis=2)
    beyond = largest > np.where(np.arange(largest.shape[1]), _LARGEST_SH[1], _LARGEST_SH[0])
    sh = int(np.count_nonzero(beyond.any(axis=1)))
    clipped = [f"the σ of {scale} Gaussians (it holds 45 µm to 379 m)"] if scale else []
    clipped += [f"the SH of {sh} (it holds colours of −0.44 to 1.44, and higher SH of −1 to 1)"] if sh else []
    return (f"SPZ clipped {' and '.join(clipped)}.",) if clipped else ()


def _blocks(cloud: SplatCloud, bits: int) -> list[bytes]:
    """The six blocks, in the file's order."""
    fixed = np.rint(cloud.position.astype(np.float64) * (1 << bits)).astype("<i4")
    position = np.ascontiguousarray(fixed).view(np.uint8).reshape(-1, 3, 4)[..., :3]
    with np.errstate(divide="ignore"):
        log_scale = np.log(cloud.scale)  # of a flat one −∞, which the smallest byte stands for
    sh = cloud.colour_sh
    higher = [_sh_bytes(sh[:, k], _SH_STEPS[k > 3]) for k in range(1, sh.shape[1])]
    blocks = (
        position,
        _bytes(cloud.opacity * 255.0),
        _bytes(sh[:, 0] * (COLOUR_SCALE * 255.0) + 127.5),
        _bytes((log_scale + 10.0) * 16.0),
        _words(cloud.rotation),
        np.stack(higher, axis=1) if higher else np.empty(0, np.uint8),
    )
    return [np.ascontiguousarray(block).tobytes() for block in blocks]


def _bytes(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0.0, 255.0).astype(np.uint8)


def _sh_bytes(values: np.ndarray, step: int) -> np.ndarray:
    """Bytes of 128 (sh + 1) that are multiples of ``step``, as near as possible."""
    stepped = np.rint((values * 128.0 + 128.0) / step) * step
    return np.clip(stepped, 0.0, 255.0).astype(np.uint8)


def _words(rotation: np.ndarray) -> np.ndarray:
    """Words ``[N]`` of quaternions ``[N, 4]``, wxyz."""
    xyzw = np.roll(rotation.astype(np.float64), -1, axis=1)
    xyzw /= np.linalg.norm(xyzw, axis=1, keepdims=True)
    largest = np.argmax(np.abs(xyzw), axis=1)
    rows = np.arange(len(xyzw))
    xyzw *= np.where(xyzw[rows, largest] < 0.0, -1.0, 1.0)[:, None]
    words = largest.astype("<u4")
    # The three others in their order: where the largest is before, the next one.
    for index in range(3):
        value = xyzw[rows, index + (largest <= index)]
        magnitude = np.minimum(np.rint(np.abs(value) * (_LARGEST_WORD * 2.0**0.5)), _LARGEST_WORD)
        words = words << 10 | ((value < 0.0).astype("<u4") << 9) | magnitude.astype("<u4")
    return words.astype("<u4")


@dataclass(frozen=True)
class _Zstd:
    """``compress(bytes)``; ``decompress(bytes, most)``: what they unpack to, at most one byte more than
    ``most``, or ``None`` where they are no zstd."""

    compress: Callable[[bytes], bytes]
    decompress: Callable[[bytes, int], bytes | None]


def _zstd(doing: str) -> _Zstd:
    """Python's own zstd (3.14) or the package ``zstandard``; raises ``BadValueError`` where neither is."""
    for name, make in (("compression.zstd", _of_python), ("zstandard", _of_package)):
        try:
            return make(importlib.import_module(name))
        except ImportError:
            continue
    verb, remedy = {
        "read": ("read", "Convert it where it is: physhdr export IN OUT.ply"),
        "write": ("written", "Write version 3, or install it: pip install zstandard"),
    }[doing]
    raise BadValueError(
        f"SPZ of version 4 is compressed with zstd, without which it cannot be {verb}: "
        "this Python has neither compression.zstd (3.14) nor the package zstandard",
        remedy,
    )


def _of_python(module: Any) -> _Zstd:
    def decompress(raw: bytes, most: int) -> bytes | None:
        try:
            return module.ZstdDecompressor().decompress(raw, max_length=most + 1)
        except (module.ZstdError, EOFError):
            return None

    return _Zstd(lambda raw: module.compress(raw, level=_ZSTD_LEVEL), decompress)


def _of_package(module: Any) -> _Zstd:
    def decompress(raw: bytes, most: int) -> bytes | None:
        try:
            with module.ZstdDecompressor().stream_reader(io.BytesIO(raw)) as stream:
                return _up_to(stream, most + 1)
        except module.ZstdError:
            return None

    return _Zstd(module.ZstdCompressor(level=_ZSTD_LEVEL).compress, decompress)


def _up_to(file: Any, most: int) -> bytes:
    parts = []
    while most and (part := file.read(min(most, 1 << 24))):
        parts.append(part)
        most -= len(part)
    return b"".join(parts)
