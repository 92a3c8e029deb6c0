# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes of a rendered pose (``passes/test_003.exr``): light groups, depth, normal, object index."""

from pathlib import Path

import numpy as np

from ..scene.pictures import read_exr_channels


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """``{"ambient.R": [H, W] float32, …, "depth.V": …}``: every channel of an OpenEXR file by its name.

    Raises ``FileMissingError``; ``FileDamagedError`` if it is not OpenEXR, truncated, deep, or claims more
    pixels than the file can hold.
    """
    return read_exr_channels(Path(path), "Make the data set again, which only makes what is missing.")
