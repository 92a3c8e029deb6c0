# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of a rendered pose (``passes/test_003.exr``): light groups, depth, normal, object index."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from ...bridge.errors import FileDamagedError, FileMissingError
from ..scene.pictures import MAX_PIXELS, MAX_PIXELS_PER_BYTE


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """``{"ambient.R": [H, W] float32, …, "depth.V": …}``: every channel of an OpenEXR file by its name.

    Raises ``FileMissingError``; ``FileDamagedError`` if it is no OpenEXR, truncated, or claims more pixels
    than the file can hold.
    """
    path = Path(path)
    if not path.is_file():
        raise FileMissingError(f"{path} is missing", "Make the data set again: only what is missing is made.")
    header = _opened(path, header_only=True).header
    window = header.get("dataWindow")
    if window is None:
        raise _damaged(path, "its header has no data window")
    (x0, y0), (x1, y1) = np.asarray(window[0]).tolist(), np.asarray(window[1]).tolist()
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if width < 1 or height < 1 or width * height > min(MAX_PIXELS, path.stat().st_size * MAX_PIXELS_PER_BYTE):
        raise _damaged(path, f"it claims {width}×{height} pixels in {path.stat().st_size} bytes")
    channels = _opened(path, header_only=False).channels
    names = {channel.name for channel in header.get("channels", [])}
    if not names or names != set(channels):
        raise _damaged(path, "it is truncated: channels are missing")
    planes = {name: np.asarray(channel.pixels, np.float32) for name, channel in channels.items()}
    for name, plane in planes.items():
        if plane.shape != (height, width):
            raise _damaged(path, f"channel {name} is {plane.shape}, the header says {(height, width)}")
    return planes


def _opened(path: Path, header_only: bool) -> Any:
    """The only part of the file."""
    try:
        parts = OpenEXR.File(str(path), separate_channels=True, header_only=header_only).parts
    except Exception as error:  # the binding documents no class: each one means that the file is damaged
        raise _damaged(path, str(error)) from error
    if len(parts) != 1:  # none is what a damaged file may come back as, without an exception
        raise _damaged(path, f"it holds {len(parts)} pictures")
    return parts[0]


def _damaged(path: Path, why: str) -> FileDamagedError:
    return FileDamagedError(
        f"{path} is not a readable OpenEXR picture: {why}",
        "Delete it and make the data set again (only what is missing is rendered), or copy it again.",
    )
