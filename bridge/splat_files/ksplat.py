# SPDX-License-Identifier: GPL-3.0-or-later
"""``.ksplat`` (GaussianSplats3D): version 0.1, compression levels 0 to 2, SH degree 0 to 2.

A header of 4,096 bytes, a header of 1,024 bytes for each section, then the sections: sizes of the partly
filled buckets, the buckets' centres, the Gaussians. A Gaussian is its position, standard deviations,
rotation (wxyz), red, green, blue and opacity in bytes, and SH, each band red, green, blue.

Level 0 has float32 throughout. Levels 1 and 2 have half floats, positions of 16 bits about the centre of the
bucket, and level 2 SH in bytes between the header's bounds. The first buckets are full, the others have the
sizes that are stated.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ..errors import FileDamagedError
from ..gaussian_ply import SH_C0
from ..regular import regular_file
from .cloud import UP, SplatCloud

HEADER_SIZE, SECTION_SIZE = 4096, 1024
#: Version (2 bytes), sections at most, sections, Gaussians at most, Gaussians, level, the scene's centre, the
#: bounds of SH of level 2.
_HEADER = struct.Struct("<BB2xIIIIH2x3fff")
#: Gaussians, Gaussians at most, Gaussians of a full bucket, buckets, width of a bucket, bytes of a centre,
#: half the steps across a bucket, bytes of the section, full buckets, others, SH degree.
_SECTION = struct.Struct("<IIIIfH2xIIIIH")
#: Number type of the floats and of SH, by level.
_FLOATS, _SH = ("<f4", "<f2", "<f2"), ("<f4", "<f2", "u1")
#: Half the steps across a bucket, and the bounds of SH, where the file says 0.
_RANGE, _SH_BOUND = 32767, 1.5
#: SH coefficients beyond the first, by degree; the format's own writer knows no higher degree than 2.
_HIGHER = (0, 3, 8, 15)
_REMEDY = "Copy or convert it again: it may be cut off."


@dataclass(frozen=True)
class _Section:
    """What a section's header says, and where it begins in the file."""

    count: int
    room: int
    bucket_size: int
    buckets: int
    bucket_width: float
    half_steps: int
    full: int
    partial: int
    degree: int
    start: int
    record: np.dtype

    @property
    def bucket_bytes(self) -> int:
        return 4 * self.partial + 12 * self.buckets

    @property
    def bytes(self) -> int:
        return self.bucket_bytes + self.room * self.record.itemsize


def read_ksplat(path: Path) -> SplatCloud:
    """Read a ``.ksplat``, in its own axes; raises ``FileMissingError`` and ``FileDamagedError``."""
    regular_file(path, _REMEDY)
    try:
        with path.open("rb") as file:
            return _read(path, file, path.stat().st_size)
    except OSError as error:
        raise FileDamagedError(f"{path} cannot be read: {error.strerror or error}", _REMEDY) from error


def is_ksplat(start: bytes) -> bool:
    """Whether a file that begins with ``start`` is of the version that is read: it has no mark."""
    return len(start) >= _HEADER.size and start[:4] == b"\0\1\0\0"


def _read(path: Path, file: BinaryIO, size: int) -> SplatCloud:
    header = file.read(HEADER_SIZE)
    if len(header) < HEADER_SIZE or not is_ksplat(header):
        raise FileDamagedError(f"{path} is not a .ksplat of version 0.1", _REMEDY)
    _, _, most, _, _, count, level, _, _, _, low, high = _HEADER.unpack_from(header)
    if level > 2 or HEADER_SIZE + most * SECTION_SIZE > size:
        raise FileDamagedError(f"{path}: a .ksplat of level {level} with {most} sections", _REMEDY)
    sections, start = [], HEADER_SIZE + most * SECTION_SIZE
    for _ in range(most):
        section = _section(path, file.read(SECTION_SIZE), level, start)
        start += section.bytes
        sections.append(section)
    if start > size or not (total := sum(each.count for each in sections)):
        raise FileDamagedError(f"{path}: a .ksplat of {size} bytes whose sections need {start}", _REMEDY)
    if total != count:
        raise FileDamagedError(f"{path}: a .ksplat of {count} Gaussians whose sections have {total}", _REMEDY)
    bounds = (low or -_SH_BOUND, high or _SH_BOUND)
    degree = max(each.degree for each in sections if each.count)
    planes = np.zeros((1 + _HIGHER[degree], 3, total), np.float32)
    parts: dict[str, list[np.ndarray]] = {"position": [], "rotation": [], "scale": [], "opacity": []}
    first = 0
    for section in sections:
        file.seek(section.start)
        raw = file.read(section.bucket_bytes + section.count * section.record.itemsize)
        records: np.ndarray[Any, Any] = np.frombuffer(
            raw, section.record, section.count, section.bucket_bytes
        )
        parts["position"].append(_positions(path, section, records, raw, level))
        for name in ("rotation", "scale"):
            parts[name].append(records[name].astype(np.float32))
        rgba = records["rgba"].astype(np.float32) / np.float32(255.0)
        parts["opacity"].append(rgba[:, 3])
        here = slice(first, first + section.count)
        planes[0, :, here] = (rgba[:, :3].T - np.float32(0.5)) / np.float32(SH_C0)
        _fill_higher(planes[:, :, here], section, records, level, bounds)
        first += section.count
    whole: dict[str, Any] = {name: np.concatenate(each) for name, each in parts.items()}
    return SplatCloud(**whole, colour_sh=planes.transpose(2, 0, 1), up=UP["ksplat"])


def _section(path: Path, header: bytes, level: int, start: int) -> _Section:
    count, room, bucket_size, buckets, width, centre, half_steps, _, full, partial, degree = (
        _SECTION.unpack_from(header)
    )
    wrong = count > room or degree >= len(_HIGHER)
    if level and count:
        wrong |= centre != 12 or full + partial != buckets or not buckets or not np.isfinite(width)
        wrong |= full * bucket_size > count
    if wrong:
        raise FileDamagedError(f"{path}: a section of a .ksplat that contradicts itself", _REMEDY)
    floats = _FLOATS[level]
    record = np.dtype(
        [
            ("position", "<u2" if level else "<f4", 3),
            ("scale", floats, 3),
            ("rotation", floats, 4),
            ("rgba", "u1", 4),
            ("sh", _SH[level], 3 * _HIGHER[degree]),
        ]
    )
    if not level:
        buckets = full = partial = 0
    half_steps = half_steps or _RANGE
    return _Section(
        count, room, bucket_size, buckets, width, half_steps, full, partial, degree, start, record
    )


def _positions(
    path: Path, section: _Section, records: np.ndarray[Any, Any], raw: bytes, level: int
) -> np.ndarray:
    if not level or not section.count:
        return records["position"].astype(np.float32)
    sizes = np.frombuffer(raw, "<u4", section.partial).astype(np.int64)
    centres = np.frombuffer(raw, "<f4", 3 * section.buckets, 4 * section.partial).reshape(-1, 3)
    ends = np.cumsum(np.concatenate([np.full(section.full, section.bucket_size, np.int64), sizes]))
    if ends[-1] < section.count:
        raise FileDamagedError(f"{path}: a .ksplat whose buckets lack Gaussians", _REMEDY)
    bucket = np.searchsorted(ends, np.arange(section.count), side="right")
    step = 0.5 * section.bucket_width / section.half_steps
    offset = (records["position"].astype(np.float64) - section.half_steps) * step
    with np.errstate(invalid="ignore", over="ignore"):
        return (offset + centres[bucket]).astype(np.float32)


def _fill_higher(
    planes: np.ndarray,
    section: _Section,
    records: np.ndarray[Any, Any],
    level: int,
    bounds: tuple[float, float],
) -> None:
    """The higher SH of a section's ``records`` into ``planes`` ``[K, 3, n]``."""
    sh = records["sh"].astype(np.float32)
    if level == 2:
        sh = bounds[0] + sh * np.float32((bounds[1] - bounds[0]) / 255.0)
    first = 0
    for band in range(1, section.degree + 1):
        width = 2 * band + 1
        mine = sh[:, 3 * first : 3 * (first + width)].reshape(-1, 3, width)
        planes[1 + first : 1 + first + width] = mine.transpose(2, 1, 0)
        first += width
