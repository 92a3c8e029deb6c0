# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes HEIC without loss: codes are stored as they are (no YCbCr, no subsampling), by x265."""

from pathlib import Path
from typing import Any

import numpy as np
import pillow_heif


def write_heic(path: Path, codes: np.ndarray, bits: int = 8, tile_size: int = 0, **info: Any) -> Path:
    """``[H, W, 3]`` codes of 8, 10 or 12 bits; ``info``: ``exif`` (bytes), ``icc_profile``, ``xmp``.

    ``nclx``: primaries and transfer (ITU-T H.273). EXIF's orientation becomes the file's own, too; the
    codes are as stored, not upright. ``others``: more pictures in the file, of which this is the primary one.
    ``tile_size``: of the squares that phones store a photo in; 0: none.
    """
    deep = bits > 8
    height, width, _ = codes.shape
    mode = f"RGB;{bits}" if deep else "RGB"
    file = pillow_heif.HeifFile()
    others = info.pop("others", ())
    for each in (*others, codes):
        file.add_frombytes(mode, (width, height), each.astype("<u2" if deep else np.uint8).tobytes())
    options: dict[str, Any] = {
        "quality": -1,
        "chroma": 444,
        "matrix_coefficients": 0,
        "primary_index": len(others),
    }
    nclx = info.pop("nclx", None)
    if nclx is not None:
        options |= {"color_primaries": nclx[0], "transfer_characteristics": nclx[1]}
    if "icc_profile" in info:
        options["save_nclx_profile"] = False
    file[len(others)].info.update(info)
    file.save(path, tile_size=tile_size, **options)
    return path
