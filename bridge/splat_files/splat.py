# SPDX-License-Identifier: GPL-3.0-or-later
"""``.splat`` (antimatter15): 32 bytes a Gaussian and nothing else, without higher SH.

Position and standard deviations in float32, red, green, blue and opacity in bytes of 0…1, and w, x, y, z in
bytes of 128 (q + 1).
"""

from pathlib import Path

import numpy as np

from ..errors import FileDamagedError
from ..gaussian_ply import SH_C0
from ..regular import damaged_where_it_fails, regular_file
from .cloud import UP, SplatCloud

RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
#: Of the first Gaussians this share must have numbers that can be a Gaussian's: the format has no mark.
_PLAUSIBLE = 0.5
_LOOKED_AT = 4096
_REMEDY = "Copy or convert it again: it may be cut off."


def read_splat(path: Path) -> SplatCloud:
    """Read a ``.splat``, in its own axes; raises ``FileMissingError`` and ``FileDamagedError``."""
    regular_file(path, _REMEDY)
    size = path.stat().st_size
    if not size or size % RECORD.itemsize:
        raise FileDamagedError(
            f"{path}: a .splat has 32 bytes a Gaussian, and this has {size} bytes", _REMEDY
        )
    with damaged_where_it_fails(f"{path} cannot be read", _REMEDY):
        records = np.fromfile(path, RECORD)
    first = records[:_LOOKED_AT]
    with np.errstate(invalid="ignore"):
        fine = (np.abs(first["position"]) < 1e9).all(axis=1) & (first["scale"] >= 0.0).all(axis=1)
        fine &= (first["scale"] < 1e9).all(axis=1)
    if fine.mean() < _PLAUSIBLE:
        raise FileDamagedError(f"{path} is not a .splat: most of its Gaussians are not numbers", _REMEDY)
    rgba = records["rgba"].astype(np.float32) / np.float32(255.0)
    colour = (rgba[:, :3] - np.float32(0.5)) / np.float32(SH_C0)
    rotation = (records["rotation"].astype(np.float32) - np.float32(128.0)) / np.float32(128.0)
    rotation[~rotation.any(axis=1)] = (1.0, 0.0, 0.0, 0.0)
    return SplatCloud(
        position=records["position"].astype(np.float32),
        rotation=rotation,
        scale=records["scale"].astype(np.float32),
        opacity=rgba[:, 3],
        colour_sh=colour[:, None],
        up=UP["splat"],
    )
