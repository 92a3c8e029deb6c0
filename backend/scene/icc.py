# SPDX-License-Identifier: GPL-3.0-or-later
"""ICC profiles of pictures: codes of their primaries become codes of sRGB's, in which all is trained.

By hand, because Pillow's ImageCms gives no tone curves and converts 8 bits only; OpenImageIO converts none.
Cameras that are set to Adobe RGB often say so in EXIF alone: that counts as its profile.

Supported are profiles of three primaries with a curve each, as cameras, phones and raw converters embed
them (Display P3, Adobe RGB, ProPhoto; ICC.1:2022, 8.3, 10.6 and 10.18). Codes are decoded by the curves,
converted to Rec.709's primaries, white to white, and encoded by the sRGB curve: any curve would do, because a
camera's response is learned. From wider primaries what clipped still clips: each row of the matrix adds up to
1 and has one positive number.
"""

import hashlib
import struct
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from ...bridge.errors import BadValueError, PhysHDRError
from ...bridge.regular import damaged_where_it_fails
from ...bridge.srgb import to_srgb
from .color_space import BRADFORD, D65, SPACES, Chromaticities
from .exif import is_adobe_rgb, tags_of_file, tags_of_tiff
from .pictures import READABLE, kind_of, open_with_pillow

#: TIFF's tag of a profile.
TIFF_TAG = 34675
#: The connection space's white (ICC.1:2022, 7.2.16).
D50 = np.array([0.9642, 1.0, 0.8249])
#: Primaries whose matrix is so near to sRGB's (of 1, linear) are sRGB's: pictures stay as they are.
ALIKE = 0.01
#: Colorants that add up to another white by more than this are of no profile that means three primaries.
WHITE_TOLERANCE = 0.05
#: Tags of a profile, and bytes of the name, at most.
MOST_TAGS, LONGEST_NAME = 256, 60
#: Parameters of each kind of parametric curve: g, a, b, c, d, e, f (10.18, table 68).
PARAMETERS = (1, 3, 4, 5, 7)
#: Steps of linear light between codes of 8 bits: 20 in the darkest code.
STEPS = 1 << 16
#: Pixels that are converted at once: their values stay in a processor's cache. A million take thrice as long.
BLOCK = 1 << 16


def profile_bytes(path: Path) -> bytes | None:
    """The profile in a PNG, JPEG or TIFF of colours; None without one, or where it cannot be read."""
    try:
        kind = kind_of(path)
        with damaged_where_it_fails(str(path)):
            if kind == "TIFF":
                found = tags_of_tiff(path).get(TIFF_TAG)
            elif kind in READABLE:
                with open_with_pillow(path, READABLE) as picture:
                    found = picture.info.get("icc_profile")
            else:
                return None
    except PhysHDRError:
        return None  # the reader of pictures says what is wrong with the file
    return found if isinstance(found, bytes) and found and found[16:20] != b"GRAY" else None


@dataclass(frozen=True)
class Curve:
    """From codes to linear light, both 0…1: a ``table`` of equal steps, or ``kind`` 0 to 4 by ``numbers``."""

    table: np.ndarray | None
    kind: int = 0
    numbers: tuple[float, ...] = (1.0,)

    def linear(self, codes: np.ndarray) -> np.ndarray:
        """float64, clipped to 0…1; of a table as it has them."""
        if self.table is not None:
            return np.interp(codes, np.linspace(0.0, 1.0, len(self.table)), self.table)
        g, a, b, c, d, e, f = (*self.numbers, *(1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)[len(self.numbers) :])
        if self.kind == 0:
            a, b, c, d, e, f = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
        elif self.kind in (1, 2):  # c is what is added everywhere
            d, e, f, c = -b / a, c, c, 0.0
        with np.errstate(all="ignore"):  # of numbers that no curve has
            power = np.maximum(a * codes + b, 0.0) ** g + e
        return np.nan_to_num(np.where(codes >= d, power, c * codes + f)).clip(0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Profile:
    """``matrix`` ``[3, 3]``: linear values of its primaries → Linear Rec.709; ``curves``: of its channels.

    ``key``: equal for equal profiles. ``name``: as it calls itself.
    """

    name: str
    key: str
    matrix: np.ndarray
    curves: tuple[Curve, Curve, Curve]

    @property
    def is_srgb(self) -> bool:
        """Whether its primaries are those of sRGB; its curve may be another."""
        return bool(np.abs(self.matrix - np.eye(3)).max() <= ALIKE)

    def to_srgb(self, codes: np.ndarray) -> np.ndarray:
        """``[H, W, 3]`` uint8 or uint16 codes → sRGB's, of the same type; colours outside are clipped."""
        tables = self._tables(codes.dtype)
        flat = codes.reshape(-1, 3)
        converted = np.empty_like(flat)
        matrix = self.matrix.astype(np.float32)
        for start in range(0, len(flat), BLOCK):
            block = flat[start : start + BLOCK]
            planes = [table[block[:, k]] for k, table in enumerate(tables)]
            for k, row in enumerate(matrix):
                # Not as a product of matrices, for which BLAS wakes all cores that others work on.
                linear = (planes[0] * row[0] + planes[1] * row[1] + planes[2] * row[2]).clip(0.0, 1.0)
                if codes.dtype == np.uint8:
                    encoded = _ENCODED[np.rint(linear * (STEPS - 1)).astype(np.uint16)]
                else:
                    encoded = np.rint(to_srgb(linear) * 65535.0)
                converted[start : start + BLOCK, k] = encoded
        return converted.reshape(codes.shape)

    def _tables(self, dtype: np.dtype) -> tuple[np.ndarray, ...]:
        """Linear light of every code, float32, for each channel."""
        return self._of_eight_bits if dtype == np.uint8 else self._of_sixteen_bits

    @cached_property
    def _of_eight_bits(self) -> tuple[np.ndarray, ...]:
        return tuple(curve.linear(np.linspace(0.0, 1.0, 1 << 8)).astype(np.float32) for curve in self.curves)

    @cached_property
    def _of_sixteen_bits(self) -> tuple[np.ndarray, ...]:
        return tuple(curve.linear(np.linspace(0.0, 1.0, 1 << 16)).astype(np.float32) for curve in self.curves)


_ENCODED = np.rint(to_srgb(np.linspace(0.0, 1.0, STEPS)) * 255.0).astype(np.uint8)


def profile_of(path: Path) -> tuple[Profile | None, str]:
    """The profile that a picture has to be converted by; None where it is sRGB, or cannot be converted.

    And why it cannot be, with the remedy; "" where there is nothing to say.
    """
    raw = profile_bytes(path)
    return (profile_by_exif(path), "") if raw is None else profile_of_bytes(raw)


def profile_by_exif(path: Path) -> Profile | None:
    """What a picture without a profile has to be converted by; None where it is sRGB or says nothing."""
    return _adobe_rgb() if is_adobe_rgb(tags_of_file(path)) else None


@cache
def _adobe_rgb() -> Profile:
    """Adobe RGB (1998), 4.3.1 and 4.3.4: its primaries, and the power 563/256."""
    matrix = Chromaticities((0.64, 0.33), (0.21, 0.71), (0.15, 0.06), D65).to_rec709()
    curve = Curve(None, 0, (563.0 / 256.0,))
    return Profile(
        "Adobe RGB (1998)", "Adobe RGB by EXIF", matrix / matrix.sum(axis=1)[:, None], (curve, curve, curve)
    )


def profile_of_bytes(raw: bytes) -> tuple[Profile | None, str]:
    """As ``profile_of``, of a profile's bytes; one of grey says nothing of colours."""
    if raw[16:20] == b"GRAY":
        return None, ""
    try:
        profile = read_profile(raw)
    except BadValueError as error:
        return None, f"{error.message}. {error.hint}"
    return None if profile.is_srgb else profile, ""


def read_profile(raw: bytes) -> Profile:
    """A profile of three primaries; raises ``BadValueError``, naming it, for all others."""
    name = "without a name"
    try:
        tags = _tags(raw)
        name = _name(tags.get(b"desc", b"")) or name
        if raw[16:20] != b"RGB " or raw[20:24] != b"XYZ ":
            raise ValueError("it is not RGB")
        columns = np.stack([_colorant(tags[tag]) for tag in (b"rXYZ", b"gXYZ", b"bXYZ")], axis=1)
        curves = (_curve(tags[b"rTRC"]), _curve(tags[b"gTRC"]), _curve(tags[b"bTRC"]))
        matrix = np.linalg.inv(_rec709_at_d50()) @ columns
        white = matrix.sum(axis=1)
        if not np.isfinite(matrix).all() or np.abs(white - 1.0).max() > WHITE_TOLERANCE:
            raise ValueError("its colorants do not add up to white")
        if abs(np.linalg.det(matrix)) < 1e-3:
            raise ValueError("its colorants are not primaries")
    except (struct.error, KeyError, ValueError, IndexError, ZeroDivisionError) as error:
        why = f"it has no {error.args[0].decode('latin-1')}" if isinstance(error, KeyError) else str(error)
        raise BadValueError(
            f"the ICC profile '{name}' does not hold three primaries with a curve each: {why}",
            "Convert the pictures to sRGB, keeping EXIF.",
        ) from error
    return Profile(name, hashlib.sha256(raw).hexdigest()[:16], matrix / white[:, None], curves)


def _rec709_at_d50() -> np.ndarray:
    """``[3, 3]``: Linear Rec.709 → XYZ with white adapted to D50, as profiles have it."""
    to_xyz = SPACES["rec709"].to_xyz()
    here, there = BRADFORD @ to_xyz @ np.ones(3), BRADFORD @ D50
    return np.linalg.inv(BRADFORD) @ np.diag(there / here) @ BRADFORD @ to_xyz


def _tags(raw: bytes) -> dict[bytes, bytes]:
    """A profile's tags (7.3); raises ``ValueError`` or ``struct.error`` where it is none."""
    if raw[36:40] != b"acsp":
        raise ValueError("it is not an ICC profile")
    (count,) = struct.unpack_from(">I", raw, 128)
    if count > MOST_TAGS:
        raise ValueError(f"it claims {count} tags")
    tags = {}
    for k in range(count):
        sign, offset, size = struct.unpack_from(">4sII", raw, 132 + 12 * k)
        tags[sign] = raw[offset : offset + size]
    return tags


def _colorant(tag: bytes) -> np.ndarray:
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536.0


def _curve(tag: bytes) -> Curve:
    """A ``curv`` or a ``para``; raises ``ValueError`` or ``struct.error`` for what is neither."""
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        values = np.frombuffer(tag[12 : 12 + 2 * count], ">u2").astype(np.float64)
        if len(values) != count:
            raise ValueError("a curve is truncated")
        if count == 1:
            return Curve(None, 0, (float(values[0]) / 256.0,))
        return Curve(values / 65535.0) if count else Curve(None)
    if tag[:4] != b"para":
        raise ValueError(f"a curve is of the type {tag[:4].decode('latin-1')!r}")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind >= len(PARAMETERS):
        raise ValueError(f"a curve is of the kind {kind}")
    numbers = tuple(n / 65536.0 for n in struct.unpack_from(f">{PARAMETERS[kind]}i", tag, 12))
    if kind in (1, 2) and numbers[1] == 0.0:
        raise ValueError("a curve is constant")
    return Curve(None, kind, numbers)


def _name(tag: bytes) -> str:
    """What a ``desc`` says: ASCII, or the first of an ``mluc``'s languages."""
    if tag[:4] == b"desc":
        (count,) = struct.unpack_from(">I", tag, 8)
        text = tag[12 : 12 + min(count, LONGEST_NAME)].decode("latin-1")
    elif tag[:4] == b"mluc":
        size, offset = struct.unpack_from(">II", tag, 20)
        text = tag[offset : offset + min(size, 2 * LONGEST_NAME)].decode("utf-16-be", "replace")
    else:
        return ""
    return "".join(letter for letter in text.split("\0")[0] if letter.isprintable()).strip()
