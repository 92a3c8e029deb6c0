# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures on disk: 8-bit PNG or JPEG, 32-bit float OpenEXR; read with suspicion and written atomically."""

import io
import threading
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import OpenEXR
from PIL import Image

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, OutputError
from ...bridge.limits import MAX_PIXELS, RADIANCE_MAX
from ...bridge.regular import damaged_where_it_fails, regular_file

#: A file of N bytes can hold at most this many pixels per byte. RLE, the weakest of EXR's codecs, reaches 64
#: on constant data and ZIP about 1000; a real render stays below 1. A 376-byte file that claims 16000×16000
#: makes the OpenEXR library (3.5) allocate 1.5 GB before it notices that the pixels are not there.
MAX_PIXELS_PER_BYTE = 1024
#: Nor more values of all channels. Measured on a constant picture of 2048×2048: DWAB 4015, ZIP 412, RLE 29.
MAX_VALUES_PER_BYTE = 4096
#: Pillow's modes that are 8 bits a channel (or fewer) and become RGB without loss.
EIGHT_BIT_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX")
#: Deflate, PNG's only codec, makes at most so many bytes of one: 258 of two bits, a longest match.
MAX_DEFLATE_RATIO = 1032
#: The fewest bits that a PNG's pixel of each mode has before deflate; its rows' filters only add to them, and
#: interlacing does, too. A pixel of "L" has 2 to 8, one of "P" 1 to 8.
PNG_BITS = {"1": 1, "L": 2, "LA": 16, "P": 1, "RGB": 24, "RGBA": 32}
#: Pillow's names of the formats that a data set's pictures may have.
READABLE = ("PNG", "JPEG")

#: Pixels of an EXR's tile, which may be larger than its picture: the library goes through all of it.
LARGEST_TILE = 1 << 24

T = TypeVar("T")

#: ``redirect_stdout`` puts another ``sys.stdout`` in place for all threads, and back what it has found.
_stdout_lock = threading.Lock()

_RESTORE = "Restore the file, or make the data set again: only what is missing is rendered."
_DELETE = "Delete it and make the data set again (only what is missing is rendered), or copy it again."


def picture_size(path: Path) -> tuple[int, int]:
    """``(width, height)`` in pixels of a PNG or JPEG from its header alone; raises as ``read_picture``."""
    return _open_picture(Path(path), READABLE, lambda picture: picture.size)


def read_picture(path: Path) -> np.ndarray:
    """``[H, W, 3]`` uint8 of a PNG or JPEG, display-referred, as it is stored.

    An alpha channel is ignored, never composited; EXIF's orientation is, too, as structure from motion
    ignores it. Raises ``FileMissingError``, ``FileDamagedError`` (neither of the two, truncated, more than
    8 bits a channel, no RGB, absurdly large).
    """
    return _open_picture(Path(path), READABLE, _as_rgb)


def read_png(path: Path) -> np.ndarray:
    """As ``read_picture``, PNG only."""
    return _open_picture(Path(path), ("PNG",), _as_rgb)


def _as_rgb(picture: Image.Image) -> np.ndarray:
    return np.array(picture.convert("RGB"))


def _open_picture(path: Path, formats: tuple[str, ...], look: Callable[[Image.Image], T]) -> T:
    """What ``look`` sees in a picture whose header can be believed."""
    regular_file(path, _RESTORE)
    kinds = " or ".join(formats)
    with damaged_where_it_fails(f"{path} is not a readable {kinds}", _DELETE), warnings.catch_warnings():
        # Pillow's own limit, at 89 million pixels, only warns; ours is below.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        with Image.open(path, formats=formats) as picture:
            width, height = picture.size
            if width * height > MAX_PIXELS:
                raise ValueError(f"it claims {width}×{height} pixels")
            if picture.mode not in EIGHT_BIT_MODES:
                raise FileDamagedError(
                    f"{path} is not an 8-bit colour {kinds} (Pillow's mode {picture.mode})",
                    "Save it again as 8-bit RGB or RGBA.",
                )
            size = path.stat().st_size
            if picture.format == "PNG" and width * height * PNG_BITS.get(picture.mode, 1) > (
                8 * MAX_DEFLATE_RATIO * size
            ):
                raise ValueError(f"it claims {width}×{height} pixels in {size} bytes")
            return look(picture)


def write_png(path: Path, picture: np.ndarray) -> None:
    """Write ``[H, W, 3]`` uint8 as PNG, atomically; raises ``OutputError`` or ``BadValueError``."""
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise BadValueError(f"a PNG is written from [H, W, 3] uint8, got {picture.shape} {picture.dtype}")
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")


def read_exr(path: Path) -> np.ndarray:
    """``[H, W, 3]`` float32, scene-linear radiance; channels other than R, G, B are ignored.

    Raises ``FileMissingError``; ``FileDamagedError`` if it is no OpenEXR, truncated, its header claims more
    than the file can hold, or a channel is missing; ``BadValueError`` if a value is NaN, infinite or absurd.
    """
    path = Path(path)
    planes = read_exr_channels(path, _RESTORE, ("R", "G", "B"))
    radiance = np.stack([planes[name] for name in "RGB"], axis=-1)
    if not np.isfinite(radiance).all():
        row, column = np.argwhere(~np.isfinite(radiance))[0][:2]
        raise BadValueError(
            f"{path} holds NaN or infinity, first at row {row}, column {column}",
            "Render it again; a renderer that writes NaN has a broken material or light.",
        )
    largest = float(np.abs(radiance).max())
    if largest > RADIANCE_MAX:
        raise BadValueError(
            f"{path} holds the radiance {largest:g}: no more than {RADIANCE_MAX:g} is possible",
            "Render it again; the sun's disc has 2e7.",
        )
    return radiance


def read_exr_channels(path: Path, remedy: str, wanted: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """Channels of an OpenEXR file by name, each ``[H, W]`` float32, as they are.

    ``wanted``: of its first part; without them all channels of its only part. ``remedy``: the hint where the
    file is not there. Raises ``FileMissingError``; ``FileDamagedError`` if it is no OpenEXR, truncated, deep,
    claims more than the file can hold, or lacks a channel.
    """
    regular_file(path, remedy)
    parts = _exr_parts(path, header_only=True)
    if len(parts) != 1 and not (parts and wanted):  # none is what a damaged file may come back as
        raise _damaged_exr(path, f"it holds {len(parts)} pictures")
    claims = [_exr_claim(path, part.header) for part in parts]
    size = path.stat().st_size
    for width, height, names in claims:
        most = min(MAX_PIXELS, size * MAX_PIXELS_PER_BYTE, size * MAX_VALUES_PER_BYTE // max(len(names), 1))
        if width < 1 or height < 1 or width * height > most:
            claim = f"it claims {width}×{height} pixels of {len(names)} channels in {size} bytes"
            raise _damaged_exr(path, claim)
    width, height, names = claims[0]
    if not names or not set(wanted) <= set(names):
        raise _damaged_exr(path, f"it has no channels {', '.join(wanted)} but {sorted(names)}")
    parts = _exr_parts(path, header_only=False)
    if len(parts) != len(claims) or set(parts[0].channels) != set(names):
        raise _damaged_exr(path, "it is truncated: channels are missing")
    planes = {}
    for name in wanted or names:
        with damaged_where_it_fails(f"{path} is not a readable OpenEXR picture: channel {name}", _DELETE):
            planes[name] = np.asarray(parts[0].channels[name].pixels).astype(np.float32)
        if planes[name].shape != (height, width):
            shape = planes[name].shape
            raise _damaged_exr(path, f"channel {name} is {shape}, the header says {(height, width)}")
    return planes


def _exr_parts(path: Path, header_only: bool) -> list[Any]:
    """The parts of a file; one that cannot be read is without its channels.

    The binding warns of that in Python's stdout, where what a program tells other programs goes; the error
    that comes of it says as much.
    """
    with (
        damaged_where_it_fails(f"{path} is not a readable OpenEXR picture", _DELETE),
        _stdout_lock,
        redirect_stdout(io.StringIO()),
    ):
        return list(OpenEXR.File(str(path), separate_channels=True, header_only=header_only).parts)


def _exr_claim(path: Path, header: dict[str, Any]) -> tuple[int, int, list[str]]:
    """Width, height and channels that a part's header tells of."""
    with damaged_where_it_fails(
        f"{path} is not a readable OpenEXR picture: its header means nothing", _DELETE
    ):
        if header.get("type") in (OpenEXR.deepscanline, OpenEXR.deeptile):
            raise ValueError("it is deep, with any number of values a pixel")
        tile = header.get("tiles")
        if tile is not None and tile.xSize * tile.ySize > LARGEST_TILE:
            raise ValueError(f"a tile of {tile.xSize}×{tile.ySize} pixels")
        (x0, y0), (x1, y1) = (np.asarray(corner).tolist() for corner in header["dataWindow"])
        return x1 - x0 + 1, y1 - y0 + 1, [channel.name for channel in header.get("channels", [])]


def _damaged_exr(path: Path, why: str) -> FileDamagedError:
    return FileDamagedError(f"{path} is not a readable OpenEXR picture: {why}", _DELETE)


def write_exr(path: Path, radiance: np.ndarray, attributes: dict[str, str] | None = None) -> None:
    """Write ``[H, W, 3]`` scene-linear radiance as 32-bit float RGB (ZIP), atomically.

    ``attributes`` go into the header as strings. Raises ``OutputError`` or ``BadValueError``.
    """
    if radiance.ndim != 3 or radiance.shape[2] != 3:
        raise BadValueError(f"an EXR is written from [H, W, 3], got {radiance.shape}")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(attributes or {})}
    pixels = np.ascontiguousarray(radiance, dtype=np.float32)
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, {"RGB": pixels}).write(str(temporary))
        except RuntimeError as error:  # how the binding says that the disk is full
            raise OutputError(f"cannot write {path}: {error}", "Check the disk's free space.") from error
