# SPDX-License-Identifier: GPL-3.0-or-later
"""Which Gaussians of a file can be drawn: those whose values are numbers, and not absurd ones."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import BadValueError
from ..limits import FARTHEST, check_position
from .cloud import SplatCloud

#: No colour or parameter of a Gaussian is larger; squares and sums of such are still finite in float32.
ABSURD = 1e15


def usable(
    path: Path,
    position: np.ndarray,
    rotation: np.ndarray,
    scale: np.ndarray,
    opacity: np.ndarray,
    others: Iterable[np.ndarray],
) -> np.ndarray:
    """``[N]``: which Gaussians have no NaN, infinite or absurd value. Arrays as in ``SplatCloud``.

    ``others``: columns ``[N]`` of colours and parameters that are used, too. An opacity of 0 or 1 and a scale
    of 0 are values like any. Raises ``BadValueError`` where there are no Gaussians, none is usable, or all of
    them are in the coordinates of a map; ``path`` is for the message.
    """
    if not len(position):
        raise BadValueError(f"{path} has no Gaussians", "Choose another file.")
    most = np.zeros(len(position), np.float32)
    near = np.ones(len(position), bool)
    with np.errstate(invalid="ignore", over="ignore"):
        for column in others:
            np.maximum(most, np.abs(column), out=most)  # NaN stays
        for axis in range(3):
            near &= np.abs(position[:, axis]) <= FARTHEST
            np.maximum(most, np.abs(position[:, axis]), out=most)
        fine = (most <= ABSURD) & (opacity >= 0.0) & (opacity <= 1.0)
        for axis in range(3):
            fine &= (scale[:, axis] >= 0.0) & (scale[:, axis] <= FARTHEST)
        length = np.einsum("ni,ni->n", rotation, rotation, dtype=np.float64)
        fine &= (length > 1e-12) & (length <= ABSURD**2)
    if fine.any() and not (fine & near).any():
        check_position(position[int(np.argmax(fine))].tolist(), f"{path}: its first Gaussian")
    fine &= near
    require_one(path, fine)
    return fine


def require_one(path: Path, fine: np.ndarray) -> None:
    """Raises ``BadValueError`` where none of ``fine`` ``[N]`` is true."""
    if not fine.any():
        raise BadValueError(
            f"{path}: every Gaussian has NaN, infinite or absurd values",
            "Export or convert it again; after a training that diverged, from an earlier checkpoint.",
        )


def only_usable(path: Path, cloud: SplatCloud) -> tuple[SplatCloud, int]:
    """The ``usable`` Gaussians of ``cloud``, their quaternions of length 1, and how many were left out.

    Raises what ``usable`` raises.
    """
    colours = (cloud.colour_sh[:, k, c] for k in range(cloud.colour_sh.shape[1]) for c in range(3))
    fine = usable(path, cloud.position, cloud.rotation, cloud.scale, cloud.opacity, colours)
    left_out = int(fine.size - np.count_nonzero(fine))
    if left_out:
        cloud = taken(cloud, fine)
    lengths = np.linalg.norm(cloud.rotation, axis=1, keepdims=True)
    return replace(cloud, rotation=cloud.rotation / lengths), left_out


def taken(cloud: SplatCloud, which: np.ndarray) -> SplatCloud:
    """The Gaussians of ``cloud`` that ``which``, a mask or indices, takes."""
    return replace(
        cloud,
        position=cloud.position[which],
        rotation=cloud.rotation[which],
        scale=cloud.scale[which],
        opacity=cloud.opacity[which],
        colour_sh=cloud.colour_sh[which],
    )


#: Of files that say that the compensation for a smallest size on the screen belongs to their opacity.
ANTIALIASED_NOTE = "It was trained with compensation of opacity (antialiased), which we do not draw."


def left_out_note(count: int) -> str:
    """A note for the user about Gaussians that were left out."""
    return f"{count} Gaussians with NaN, infinite or absurd values were left out."
