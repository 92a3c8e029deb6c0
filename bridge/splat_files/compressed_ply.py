# SPDX-License-Identifier: GPL-3.0-or-later
"""PlayCanvas' compressed PLY, as SuperSplat and splat-transform write it.

An element ``chunk`` has the bounds of each 256 Gaussians: position, ln scale and, in newer files, colour. An
element ``vertex`` has four words a Gaussian, the highest bits first:

- ``packed_position``: x, y, z in 11, 10 and 11 bits between the bounds
- ``packed_scale``: ln of the standard deviations, likewise
- ``packed_rotation``: which of w, x, y, z is the largest, in 2 bits, then the others in 10 bits from −1/√2 to
  1/√2; the largest is positive
- ``packed_color``: red, green, blue (between the bounds, or from 0 to 1) and opacity in 8 bits each; these
  are display colours, ½ + SH_C0·sh_0

An element ``sh`` has ``f_rest_*``, channel by channel, in bytes: 256 steps over −4 … 4.
"""

from pathlib import Path

import numpy as np

from ..errors import FileDamagedError
from ..gaussian_ply import REST_COUNTS, SH_C0
from ..ply import Ply
from .cloud import UP, SplatCloud

#: Gaussians of a chunk.
CHUNK = 256
#: Bits of x, y and z.
_BITS = (11, 10, 11)
#: Half the range of the higher coefficients.
_SH_RANGE = np.float32(4.0)
_REMEDY = "Save or convert it again: it may be cut off."


def cloud_of_compressed(path: Path, ply: Ply) -> SplatCloud:
    """The Gaussians of an opened PLY in the compressed layout; ``path`` is for messages.

    Raises ``FileDamagedError`` where a column is missing or too short.
    """
    chunks, packed, sh = (ply.elements.get(name) for name in ("chunk", "vertex", "sh"))
    if chunks is None or packed is None:
        raise FileDamagedError(f"{path}: a compressed PLY without its chunks or Gaussians", _REMEDY)
    count = len(packed)
    if len(chunks) * CHUNK < count or (sh is not None and len(sh) != count):
        raise FileDamagedError(
            f"{path}: {count} Gaussians with {len(chunks)} chunks of {CHUNK}"
            + (f" and {len(sh)} rows of SH" if sh is not None else ""),
            _REMEDY,
        )
    which = np.arange(count) // CHUNK

    def words(name: str) -> np.ndarray:
        return _column(path, packed, name, "ui").astype(np.uint32)

    def bounded(share: np.ndarray, quantity: str) -> np.ndarray:
        """Between the chunk's bounds of ``quantity``, in float64: they may be any numbers."""
        low, high = (
            _column(path, chunks, f"{end}_{quantity}", "f").astype(np.float64)[which]
            for end in ("min", "max")
        )
        with np.errstate(invalid="ignore", over="ignore"):
            return (low * (1.0 - share) + high * share).astype(np.float32)

    position, scale = (
        np.stack(
            [
                bounded(share, f"{what}{axis}")
                for axis, share in zip("xyz", _shares(words(f"packed_{name}"), _BITS), strict=True)
            ],
            axis=1,
        )
        for what, name in (("", "position"), ("scale_", "scale"))
    )
    *rgb, opacity = _shares(words("packed_color"), (8, 8, 8, 8))
    if "min_r" in (chunks.dtype.names or ()):
        rgb = [bounded(share, channel) for channel, share in zip("rgb", rgb, strict=True)]
    planes = _higher(path, sh, count)
    for channel, colour in enumerate(rgb):
        planes[0, channel] = (colour - 0.5) / SH_C0
    with np.errstate(over="ignore"):
        scale = np.exp(scale)
    return SplatCloud(
        position=position,
        rotation=_rotation(words("packed_rotation")),
        scale=scale,
        opacity=opacity.astype(np.float32),
        colour_sh=planes.transpose(2, 0, 1),
        up=UP["compressed-ply"],
    )


def _column(path: Path, table: np.ndarray, name: str, kinds: str) -> np.ndarray:
    """A column of an element, whose numbers are of ``kinds`` (of numpy: u, i, f)."""
    if name not in (table.dtype.names or ()):
        raise FileDamagedError(f"{path}: a compressed PLY without a column {name}", _REMEDY)
    column = table[name]
    if column.dtype.kind not in kinds:
        raise FileDamagedError(f"{path}: a compressed PLY whose {name} is {column.dtype}", _REMEDY)
    return column


def _shares(words: np.ndarray, bits: tuple[int, ...]) -> list[np.ndarray]:
    """The numbers of ``bits`` in each word, the highest first, as 0…1."""
    shares, shift = [], 32
    for width in bits:
        shift -= width
        largest = (1 << width) - 1
        shares.append(((words >> np.uint32(shift)) & np.uint32(largest)) / largest)
    return shares


def _rotation(words: np.ndarray) -> np.ndarray:
    """Quaternions ``[N, 4]``, wxyz."""
    _, *others = _shares(words, (2, 10, 10, 10))
    return with_largest((words >> np.uint32(30)).astype(np.intp), (np.stack(others, axis=1) - 0.5) * 2.0**0.5)


def with_largest(largest: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Unit vectors ``[N, 4]`` (float32) of which component ``largest`` ``[N]`` is positive and follows from
    the ``others`` ``[N, 3]``, in their order."""
    full = np.empty((len(others), 4), np.float32)
    rest = np.sqrt(np.maximum(0.0, 1.0 - np.square(others).sum(axis=1)))
    for index in range(4):
        mine = largest == index
        full[mine] = np.insert(others[mine], index, rest[mine], axis=1)
    return full


def _higher(path: Path, sh: np.ndarray | None, count: int) -> np.ndarray:
    """Planes ``[K, 3, N]`` of SH, of which the first is still to be filled."""
    if sh is None:
        return np.empty((1, 3, count), np.float32)
    columns = sum(name.startswith("f_rest_") for name in sh.dtype.names or ())
    if columns not in REST_COUNTS:
        raise FileDamagedError(f"{path}: a compressed PLY with {columns} columns of SH", _REMEDY)
    rest = columns // 3
    planes = np.empty((rest + 1, 3, count), np.float32)
    for channel in range(3):
        for k in range(rest):
            byte = _column(path, sh, f"f_rest_{channel * rest + k}", "u").astype(np.float32)
            share = (byte + np.float32(0.5)) / np.float32(256.0)
            share[byte == 0.0], share[byte == 255.0] = 0.0, 1.0
            planes[k + 1, channel] = (2.0 * share - 1.0) * _SH_RANGE
    return planes
