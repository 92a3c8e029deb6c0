# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians of a scene file, placed by its nodes, as one cloud."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...bridge.affine import transform_gaussians
from ...bridge.errors import BadValueError, FileDamagedError
from ...bridge.spherical_harmonics import rotated
from ...bridge.splat_files import SplatCloud
from ...bridge.splat_files.usable import ABSURD

#: What is turned by less keeps its SH as they are.
NO_TURN = 1e-7
#: Columns of a node's matrix are perpendicular to this.
SHEAR = 1e-4
#: How many Gaussians a file may make by repeating its own, and how many times what it holds.
FREE, MOST_TIMES = 1_000_000, 8


def moved(path: Path, cloud: SplatCloud, matrix: np.ndarray) -> SplatCloud:
    """``cloud`` under a node's ``matrix`` ``[4, 4]``: places, ellipsoids and colours.

    Degenerate ellipsoids (without axes) get NaN as their scale: they are ignored later.

    Raises ``FileDamagedError`` where the matrix is flat or not finite, ``BadValueError`` where it shears or
    mirrors, under which colours are not known.
    """
    if np.array_equal(matrix, np.eye(4)):
        return cloud
    linear = np.asarray(matrix, np.float64)[:3, :3]
    sane = (cloud.scale >= 0.0) & (cloud.scale <= ABSURD)
    usable = np.asarray(np.isfinite(cloud.rotation).all(axis=1) & sane.all(axis=1))
    size = np.where(usable[:, None], cloud.scale, np.float32(1.0))
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            placed = transform_gaussians(matrix, cloud.position, _unit(cloud.rotation), size)
    except BadValueError as error:
        raise FileDamagedError(
            f"{path}: a node's matrix is flat or not finite", "Give it a scale other than 0 along every axis."
        ) from error
    turn = linear / np.linalg.norm(linear, axis=0)
    if np.abs(turn @ turn.T - np.eye(3)).max() > SHEAR or np.linalg.det(turn) < 0.0:
        raise BadValueError(
            f"{path}: a node shears or mirrors its Gaussians", "Apply its transformation before exporting."
        )
    position, rotation, scale = placed
    scale[~usable] = np.nan
    sh = cloud.colour_sh
    if np.abs(turn - np.eye(3)).max() > NO_TURN:
        sh = rotated(sh, turn)
    return replace(cloud, position=position, rotation=rotation, scale=scale, colour_sh=sh)


def joined(path: Path, clouds: Sequence[SplatCloud], stored: int) -> SplatCloud:
    """All Gaussians as one cloud, of the highest degree among them.

    ``stored``: how many different ones the file holds. Raises ``BadValueError`` where it repeats them beyond
    what anybody would render.
    """
    total = sum(cloud.count for cloud in clouds)
    if total > max(FREE, MOST_TIMES * stored):
        raise BadValueError(
            f"{path} repeats its {stored} Gaussians until they are {total}", "Remove repetitions."
        )
    if len(clouds) == 1:
        return clouds[0]
    most = max(cloud.colour_sh.shape[1] for cloud in clouds)
    sh = [np.pad(c.colour_sh, ((0, 0), (0, most - c.colour_sh.shape[1]), (0, 0))) for c in clouds]
    arrays = ("position", "rotation", "scale", "opacity")
    all_of = {name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in arrays}
    return replace(clouds[0], colour_sh=np.concatenate(sh), **all_of)


def _unit(rotation: np.ndarray) -> np.ndarray:
    """Quaternions of length 1; one without a length turns nothing."""
    rotation = rotation.astype(np.float64)  # in which no square of a float32 overflows
    with np.errstate(divide="ignore", invalid="ignore"):
        length = np.linalg.norm(rotation, axis=1, keepdims=True)
        return np.where(length > 0.0, rotation / length, [1.0, 0.0, 0.0, 0.0])
