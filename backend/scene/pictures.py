# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures on disk: 8-bit PNG or JPEG, 32-bit float OpenEXR; read with suspicion and written atomically."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import OpenEXR
from PIL import Image

from ...bridge.atomic import atomic_path
from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError, OutputError

#: No picture of ours is larger; a header that claims more is damaged or hostile.
MAX_PIXELS = 1 << 27
#: A file of N bytes can hold at most this many pixels per byte. RLE, the weakest of EXR's codecs, reaches 64
#: on constant data and ZIP about 1000; a real render stays below 1. A 376-byte file that claims 16000×16000
#: would make the OpenEXR library allocate 1.5 GB (shared/data.md).
MAX_PIXELS_PER_BYTE = 1024
#: Pillow's modes that are 8 bits a channel (or fewer) and become RGB without loss.
EIGHT_BIT_MODES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX")
#: Pillow's names of the formats that a data set's pictures may have.
READABLE = ("PNG", "JPEG")

T = TypeVar("T")


def _require_file(path: Path) -> None:
    if not path.is_file():
        raise FileMissingError(
            f"{path} is missing",
            "Restore the file, or make the data set again: only what is missing is rendered.",
        )


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
    _require_file(path)
    kinds = " or ".join(formats)
    try:
        with warnings.catch_warnings():
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
                return look(picture)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise FileDamagedError(
            f"{path} is not a readable {kinds} ({error})",
            "Delete it and make the data set again (only what is missing is rendered), or copy it again.",
        ) from error


def write_png(path: Path, picture: np.ndarray) -> None:
    """Write ``[H, W, 3]`` uint8 as PNG, atomically; raises ``OutputError`` or ``BadValueError``."""
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise BadValueError(f"a PNG is written from [H, W, 3] uint8, got {picture.shape} {picture.dtype}")
    with atomic_path(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")


def _damaged_exr(path: Path, why: str) -> FileDamagedError:
    return FileDamagedError(
        f"{path} is not a readable OpenEXR picture: {why}",
        "Delete it and make the data set again (only what is missing is rendered), or copy it again.",
    )


def _open_exr(path: Path, header_only: bool) -> Any:
    try:
        return OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
    except Exception as error:  # the binding documents no class: each one means that the file is damaged
        raise _damaged_exr(path, str(error)) from error


def _check_exr_header(path: Path) -> tuple[int, int]:
    """``(width, height)``, believed only if the file is large enough to hold them."""
    file = _open_exr(path, header_only=True)
    if len(file.parts) == 0:  # what a damaged file may come back as, without an exception
        raise _damaged_exr(path, "it holds no picture")
    header = file.parts[0].header
    window = header.get("dataWindow")
    if window is None:
        raise _damaged_exr(path, "its header has no data window")
    (x0, y0), (x1, y1) = np.asarray(window[0]).tolist(), np.asarray(window[1]).tolist()
    width, height = x1 - x0 + 1, y1 - y0 + 1
    most = min(MAX_PIXELS, path.stat().st_size * MAX_PIXELS_PER_BYTE)
    if width < 1 or height < 1 or width * height > most:
        raise _damaged_exr(path, f"it claims {width}×{height} pixels in {path.stat().st_size} bytes")
    names = {channel.name for channel in header.get("channels", [])}
    if not {"R", "G", "B"} <= names:
        raise _damaged_exr(path, f"it has no channels R, G, B but {sorted(names)}")
    return width, height


def read_exr(path: Path) -> np.ndarray:
    """``[H, W, 3]`` float32, scene-linear radiance; channels other than R, G, B are ignored.

    Raises ``FileMissingError``; ``FileDamagedError`` if it is no OpenEXR, truncated, its header claims more
    than the file can hold, or a channel is missing; ``BadValueError`` if a value is NaN or infinite.
    """
    path = Path(path)
    _require_file(path)
    width, height = _check_exr_header(path)
    file = _open_exr(path, header_only=False)
    if len(file.parts) == 0:
        raise _damaged_exr(path, "it is truncated: it holds no picture")
    channels = file.parts[0].channels
    if not {"R", "G", "B"} <= set(channels):
        raise _damaged_exr(path, "it is truncated: channels are missing")
    planes = [np.asarray(channels[name].pixels) for name in "RGB"]
    for plane in planes:
        if plane.shape != (height, width):
            raise _damaged_exr(path, f"a channel is {plane.shape}, the header says {(height, width)}")
    radiance = np.stack(planes, axis=-1).astype(np.float32)
    if not np.isfinite(radiance).all():
        row, column = np.argwhere(~np.isfinite(radiance))[0][:2]
        raise BadValueError(
            f"{path} holds NaN or infinity, first at row {row}, column {column}",
            "Render it again; a renderer that writes NaN has a broken material or light.",
        )
    return radiance


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
