# SPDX-License-Identifier: GPL-3.0-or-later
"""A standard 3DGS PLY as a ``SplatCloud``: natural values of its logarithms and logits."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..axes import Up
from ..display import FITTED_COMMENT
from ..gaussian_ply import EXTRA_PREFIX, UP_WORDS, GaussianPly
from .cloud import UP, SplatCloud

#: Column of Mip-Splatting's 3D smoothing filter: a standard deviation.
FILTER = "filter_3D"
#: nerfstudio's comment line by which a PLY says that Z is up. (Brush writes "Vertical axis: y" of every
#: scene, whichever way up it is.)
_Z_UP = re.compile(r"vertical axis: z\b", re.IGNORECASE)
#: Ours, where another up was asked for (``gaussian_ply.UP_WORDS``).
_Y_UP = re.compile(r"space: .*\bY up\b")


def cloud_of_ply(ply: GaussianPly) -> SplatCloud:
    """The Gaussians of a PLY as they are, damaged ones too; quaternions of any length.

    A logit of ±∞ is an opacity of 1 or 0, a logarithm of −∞ a scale of 0. Of Mip-Splatting, whose 3D filter
    stands beside, they are as it draws them.
    """
    shape, notes = shape_of(ply.columns), ()
    if FILTER in ply.columns:
        shape |= _smoothed(shape["scale"], shape["opacity"], ply.columns[FILTER])
        notes = (f"Its {FILTER} (Mip-Splatting's) is part of its scales and opacities here.",)
    is_fitted = FITTED_COMMENT in ply.comments
    colour_sh = _colour_sh(ply.columns)
    return SplatCloud(**shape, colour_sh=colour_sh, notes=notes, up=up_of(ply), is_fitted=is_fitted)


def shape_of(columns: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """``position``, ``rotation``, ``scale`` and ``opacity`` of ``SplatCloud`` from the standard columns."""

    def stack(name: str, count: int) -> np.ndarray:
        return np.stack([columns[f"{name}_{index}"] for index in range(count)], axis=1)

    with np.errstate(over="ignore"):  # what becomes infinite is left out
        scale = np.exp(stack("scale", 3))
    return {
        "position": np.stack([columns[axis] for axis in "xyz"], axis=1),
        "rotation": stack("rot", 4),
        "scale": scale,
        "opacity": sigmoid(columns["opacity"]),
    }


def _smoothed(scale: np.ndarray, opacity: np.ndarray, wide: np.ndarray) -> dict[str, np.ndarray]:
    """Mip-Splatting's 3D smoothing filter: each Gaussian convolved with a round one of deviation ``wide``.

    The paper's equation 9: Σ + wide²·1 in place of Σ, and the opacity times √(|Σ| / |Σ + wide²·1|).
    """
    fused = np.hypot(scale, wide[:, None])
    with np.errstate(invalid="ignore"):  # ∞ / ∞: left out for its scale
        share = np.divide(scale, fused, out=np.ones_like(scale), where=fused > 0.0)
    return {"scale": fused, "opacity": opacity * share.prod(axis=1)}


def up_of(ply: GaussianPly) -> Up:
    """Which way is up, by what the PLY says of itself, or else by convention."""
    if any(_Y_UP.match(line) for line in ply.comments):
        return "y"
    for line in ply.comments:
        if _Z_UP.search(line):
            return "z"
        for up, words in UP_WORDS.items():
            if line.startswith(f"space: metres, {words}"):
                return up
    # Only a lossless PLY that lost its comments has nothing but its columns.
    return "z" if any(name.startswith(EXTRA_PREFIX) for name in ply.columns) else UP["ply"]


def sigmoid(logit: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(−``logit``)), float32; tanh neither overflows nor needs float64."""
    return np.float32(0.5) * (np.float32(1.0) + np.tanh(np.float32(0.5) * logit))


def _colour_sh(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """``[N, K, 3]``: a view of planes ``[K, 3, N]``, so that working through it reads memory in order."""
    rest = sum(name.startswith("f_rest_") for name in columns) // 3
    planes = np.empty((rest + 1, 3, len(columns["x"])), np.float32)
    for channel in range(3):
        planes[0, channel] = columns[f"f_dc_{channel}"]
        for k in range(rest):
            planes[k + 1, channel] = columns[f"f_rest_{channel * rest + k}"]
    return planes.transpose(2, 0, 1)
