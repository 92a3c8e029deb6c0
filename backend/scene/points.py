# SPDX-License-Identifier: GPL-3.0-or-later
"""First points from a PLY, as structure from motion or our own renders give them."""

from pathlib import Path

import numpy as np
import plyfile

from ...bridge.errors import FileDamagedError
from .scene import Points


def read_points(path: Path) -> Points:
    """The points of a PLY with ``x y z`` and ``red green blue`` (uchar, or float in 0…1).

    Raises ``FileDamagedError`` (not a PLY, truncated, columns missing, no points, NaN).
    """
    remedy = (
        "Make the data set again, write the points as docs/formats.md says, or delete the file: training "
        "then starts from random points."
    )
    try:
        vertex = plyfile.PlyData.read(str(path))["vertex"]
        positions = np.stack([np.asarray(vertex[axis], np.float32) for axis in "xyz"], axis=-1)
        channels = [np.asarray(vertex[name]) for name in ("red", "green", "blue")]
    except (
        plyfile.PlyParseError,
        ValueError,
        KeyError,
        OSError,
        EOFError,
        MemoryError,
        OverflowError,
    ) as error:
        why = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FileDamagedError(f"{path} is not a readable point cloud ({why})", remedy) from error
    colours = np.stack([_unit_range(channel) for channel in channels], axis=-1)
    if len(positions) == 0:
        raise FileDamagedError(f"{path} holds no points", remedy)
    if not (np.isfinite(positions).all() and np.isfinite(colours).all()):
        raise FileDamagedError(f"{path} holds NaN or infinity", remedy)
    return Points(positions, np.clip(colours, 0.0, 1.0))


def _unit_range(channel: np.ndarray) -> np.ndarray:
    """A colour channel as float32 in 0…1: bytes are divided by 255, floats are taken as they are."""
    scale = 255.0 if np.issubdtype(channel.dtype, np.integer) else 1.0
    return (channel / scale).astype(np.float32)
