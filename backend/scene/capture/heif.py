# SPDX-License-Identifier: GPL-3.0-or-later
"""HEIC, HEIF and AVIF: what phones write instead of JPEG, and cameras for their ten bits.

pillow-heif (libheif) decodes HEVC; it is optional (the extra ``prepare``) and is imported only here. AVIF is
decoded by Pillow, at 8 bits. Of several pictures in a file the primary one is the photo; depths, gain maps
and thumbnails beside it are not looked at.
"""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from PIL import features

from ....bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ....bridge.limits import MAX_PIXELS
from ....bridge.regular import damaged_where_it_fails, read_bytes
from ...shell import pip_install
from ..code_points import HDR_CURVES, profile_of_code_points
from ..exif import Tags, tags_of_exif
from ..icc import Profile, profile_of_bytes
from ..pictures import AVIF_BRANDS, HEIF_BRANDS
from .heif_boxes import av1_bits, check_complete, code_points, read_items
from .remedies import COPY_AGAIN

Kind = Literal["HEIC", "AVIF"]

#: As cameras and other programs call them: Apple and Samsung, the standard, Canon and Sony.
SUFFIXES = (".heic", ".heif", ".hif", ".avif")
#: A file is read whole; 200 million pixels of a phone have 50 million bytes at most.
LARGEST_FILE = 1 << 28
#: Bytes of a file's beginning in which it says what it is, at most.
START = 256


def require_pillow_heif() -> ModuleType:
    """pillow-heif, or ``FileMissingError`` that says how to install it."""
    try:
        import pillow_heif
    except ImportError as error:
        raise FileMissingError(
            f"HEIC photos are read with pillow-heif, which is not installed ({error})",
            f"Install it: {pip_install('pillow-heif')}",
        ) from error
    options = pillow_heif.options
    options.THUMBNAILS = options.DEPTH_IMAGES = options.AUX_IMAGES = False
    return pillow_heif


def require_avif() -> None:
    """Raises ``FileMissingError`` where Pillow was built without AVIF, as it was before version 11.3."""
    if not features.check("avif"):
        raise FileMissingError(
            "AVIF photos are read with Pillow, and the one that is installed cannot",
            f"Install a newer one: {pip_install('pillow', upgrade=True)}",
        )


def kind_of_heif(path: Path) -> Kind | None:
    """By its first bytes, whatever it is called; None where it is neither, or cannot be read."""
    try:
        with open(path, "rb") as file:
            start = file.read(START)
    except OSError:
        return None  # whoever reads it says what is wrong
    if start[4:8] != b"ftyp":
        return None
    end = min(int.from_bytes(start[:4], "big"), len(start))
    brands = {start[at : at + 4] for at in (8, *range(16, end, 4))}
    return "AVIF" if brands & AVIF_BRANDS else "HEIC" if brands & HEIF_BRANDS else None


@dataclass(frozen=True)
class Header:
    """What a HEIC tells without its pixels. ``width, height``: upright. ``deep``: its codes need 16 bits.

    ``xmp``: b"" without. ``profile``: from whose primaries it is converted; None where it is sRGB, or cannot
    be, and ``unconverted`` says why.
    """

    width: int
    height: int
    deep: bool
    tags: Tags
    xmp: bytes
    profile: Profile | None
    unconverted: str


def read_header(path: Path) -> Header:
    """Raises ``FileDamagedError`` (also for more pixels than are read), ``FileMissingError`` (no library)."""
    with damaged_where_it_fails(f"{path} is not a readable photo", COPY_AGAIN):
        picture = _opened(path)
        info, (width, height) = picture.info, picture.size
        if not (width > 0 and height > 0):
            raise ValueError(f"it claims {width}×{height} pixels")
        bits = int(info["bit_depth"])
        tags, xmp = tags_of_exif(info.get("exif") or b""), info.get("xmp") or b""
        icc, told = info.get("icc_profile"), info.get("nclx_profile") or {}
    if width * height > MAX_PIXELS:
        raise FileDamagedError(
            f"{path} has more pixels than are read ({width}×{height})",
            f"Take photos of {MAX_PIXELS // 10**6} million pixels at most, or make them smaller, keeping "
            "EXIF.",
        )
    transfer = 0 if icc else told.get("transfer_characteristics", 0)
    profile, unconverted = profile_of_bytes(icc) if icc else (None, "")
    if not icc and told:
        profile = _profile(path, told["color_primaries"], transfer)
    deep = bits > 8 or (profile is not None and transfer in HDR_CURVES)
    return Header(width, height, deep, tags, xmp, profile, unconverted)


def read_codes(path: Path, width: int, height: int) -> np.ndarray:
    """``[H, W, 3]``, upright as libheif turns it: uint8, or of more bits uint16, white to white.

    ``width, height``: as the header said. Raises ``FileDamagedError``.
    """
    with damaged_where_it_fails(f"{path} is not a readable photo", COPY_AGAIN):
        picture = _opened(path)
        codes = np.asarray(picture)
        codes = codes[..., None] if codes.ndim == 2 else codes
        if codes.shape[:2] != (height, width):
            size = f"{codes.shape[1]}×{codes.shape[0]}"
            raise ValueError(f"it is {size}, not {width}×{height} as its header says")
        codes = codes[..., :3] if codes.shape[2] >= 3 else np.repeat(codes[..., :1], 3, axis=2)
        if codes.dtype == np.uint8:
            return np.ascontiguousarray(codes)
        largest = (1 << int(picture.info["bit_depth"])) - 1
        return _spread(codes, largest)


def avif_profile(path: Path) -> Profile | None:
    """By an AVIF's code points, where it has any (an ICC profile goes before, which Pillow tells).

    Raises ``FileDamagedError``, also where 8 bits a channel are not all that it has.
    """
    with damaged_where_it_fails(f"{path} is not a readable photo", COPY_AGAIN):
        content = read_bytes(path, COPY_AGAIN, LARGEST_FILE)
        items = read_items(content)
        check_complete(content, items)
        bits, told = av1_bits(items), code_points(items)
    if bits > 8 or (told is not None and told[1] in HDR_CURVES):
        raise FileDamagedError(
            f"{path} is an AVIF of {bits} bits a channel, of which only 8 would be read",
            "Save it as HEIC, or as PNG or TIFF of 16 bits, keeping EXIF.",
        )
    return None if told is None else _profile(path, *told)


def _opened(path: Path) -> Any:
    """pillow-heif's file, of which nothing is decoded yet; raises whatever the library does."""
    library = require_pillow_heif()
    content = read_bytes(path, COPY_AGAIN, LARGEST_FILE)
    check_complete(content, read_items(content))
    # Not by its own way to 16 bits, which leaves the lowest empty, so that white would not be white.
    return library.open_heif(content, convert_hdr_to_8bit=False, hdr_to_16bit=False)


def _profile(path: Path, primaries: int, transfer: int) -> Profile | None:
    try:
        return profile_of_code_points(primaries, transfer)
    except BadValueError as error:
        raise FileDamagedError(f"{path} cannot be converted: {error.message}", error.hint) from error


def _spread(codes: np.ndarray, largest: int) -> np.ndarray:
    """Codes 0…``largest`` over all of uint16, white to white."""
    table = np.rint(np.arange(largest + 1) * (65535.0 / largest)).astype(np.uint16)
    return table[np.minimum(codes, largest)]
