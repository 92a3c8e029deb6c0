# SPDX-License-Identifier: GPL-3.0-or-later
"""What photos see of points: which codes, and where in the picture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..scene.camera import Camera
from ..scene.scene import View

#: Points in a cell of the picture, by which others are hidden that are so much farther.
POINTS_A_CELL, HIDDEN_FROM = 4.0, 1.1
#: Codes between these show how much light there was.
TELLING = (0.03, 0.97)


@dataclass(frozen=True)
class Observations:
    """One for each channel of a point in a photo, all ``[N]``: which ones, and what was seen there.

    ``rho``: tan²θ of the angle to the axis, 1 at the lens's reach; ``code`` in 0…1; ``log_time``: ln seconds.
    """

    point: np.ndarray
    photo: np.ndarray
    place: np.ndarray
    channel: np.ndarray
    lens: np.ndarray
    rho: np.ndarray
    code: np.ndarray
    #: ln(exposure × radiance), where the encoding is known, else NaN.
    known: np.ndarray
    log_time: np.ndarray


def projected(points: np.ndarray, view: View, reach: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points ``[P, 3]`` are in the frame ``[M]``, where ``[M, 2]`` (x, y in pixels' centres), their ρ.

    What lies beyond the outermost centres of pixels is not in it: it could not be interpolated.
    """
    camera = view.camera
    inside = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    before = inside[:, 2] > 1e-6
    tangent = inside[:, :2] / np.where(before, inside[:, 2], 1.0)[:, None]
    at = tangent * [camera.fx, camera.fy] + [camera.cx - 0.5, camera.cy - 0.5]
    which = np.flatnonzero(
        before & (at >= 0).all(axis=1) & (at < [camera.width - 1, camera.height - 1]).all(1)
    )
    return which, at[which], np.square(tangent[which]).sum(axis=1) / reach


def _unhidden(at: np.ndarray, depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Which of the points at ``at`` ``[M, 2]`` (pixels) have none much nearer beside them, ``[M]`` bool.

    A surface is only known by its points: the picture is divided into cells that have a few each.
    """
    cell = math.sqrt(camera.width * camera.height * POINTS_A_CELL / max(len(at), 1))
    column, row = (at // cell).astype(int).T
    width, height = int(camera.width // cell) + 3, int(camera.height // cell) + 3
    nearest = np.full((height, width), np.inf)  # with a border
    np.minimum.at(nearest, (row + 1, column + 1), depth)
    around = [nearest[1 + j : height - 1 + j, 1 + i : width - 1 + i] for j in (-1, 0, 1) for i in (-1, 0, 1)]
    return depth < HIDDEN_FROM * np.min(around, axis=0)[row, column]


def in_sight(
    points: np.ndarray, chosen: np.ndarray, view: View, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the ``chosen`` points ``[P]`` bool those that the view sees, as ``projected`` gives them.

    All points ``[P, 3]`` may hide others, whether they are chosen or not.
    """
    which, at, rho = projected(points, view, reach)
    depth = points[which] @ view.camera.world_to_camera[2, :3] + view.camera.world_to_camera[2, 3]
    used = chosen[which] & _unhidden(at, depth, view.camera)
    return which[used], at[used], rho[used]


def observations(
    points: np.ndarray,
    chosen: np.ndarray,
    views: Sequence[View],
    exposures: Sequence[tuple[int, ...]],
    lens: Sequence[int],
    reach: Sequence[float],
) -> tuple[Observations, Observations]:
    """What shows how much light there was, and what is brighter, up to white."""
    columns: tuple[list[tuple[np.ndarray, ...]], ...] = ([], [])
    photo = 0
    for place, (view, indices) in enumerate(zip(views, exposures, strict=True)):
        which, at, rho = in_sight(points, chosen, view, reach[lens[place]])
        x, y = at.T
        left, top = np.floor(x).astype(int), np.floor(y).astype(int)
        right_share, bottom_share = (x - left)[:, None], (y - top)[:, None]
        for k in indices:
            picture, encoding, mask = view.image(k), view.encodings[k], view.mask(k)
            corners = [picture[top + j, left + i] for j in (0, 1) for i in (0, 1)]
            unit = encoding.unit(picture.dtype)
            upper, lower = (a + (b * 1.0 - a) * right_share for a, b in (corners[:2], corners[2:]))
            code = (upper + (lower - upper) * bottom_share) / unit
            tells = code > TELLING[0]
            if encoding.clips:
                tells &= code < TELLING[1]
            bright = (code >= TELLING[1]) & encoding.clips
            if mask is not None:
                compared = np.all([mask[top + j, left + i] for j in (0, 1) for i in (0, 1)], axis=0)[:, None]
                tells, bright = tells & compared, bright & compared
            for chosen_codes, column in zip((tells, bright), columns, strict=True):
                row, channel = np.nonzero(chosen_codes)
                values = code[row, channel]
                known = encoding.decode(values) if encoding.is_known else np.full(len(values), math.nan)
                same = np.ones(len(values), dtype=int)
                column.append(
                    (
                        *(which[row], same * photo, same * place, channel, same * lens[place]),
                        *(rho[row], values, np.log(known), same * math.log(view.exposures[k])),
                    )
                )
            photo += 1
    telling, bright = (
        Observations(*(np.concatenate(each) for each in zip(*column, strict=True))) for column in columns
    )
    return telling, bright
