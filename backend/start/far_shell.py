# SPDX-License-Identifier: GPL-3.0-or-later
"""A place for what is seen only far away: points on a sphere around everything, where no nearer ones are.

Sky, hills and what lies behind a window have neither matches nor parallax, so that first points miss
them. Gaussians that start near would have to explain them, as haze before the cameras. Points far away are
where such light comes from: ordinary points, whose Gaussians are learned, exported and drawn as all others.
"""

from collections.abc import Sequence

import numpy as np

from ..scene.camera import Camera
from ..scene.scene import View
from .initialise import scene_extent

#: The sphere's radius: so many extents of the cameras, and so many times as far as nearly all points are.
EXTENTS, BEYOND, NEARLY_ALL = 20.0, 3.0, 0.95
#: A picture is divided into so many cells a side; one is covered where a point is in it or beside it.
CELLS = 24
#: Nothing is added where points leave less than this share of the pictures uncovered, on average.
LEAST_UNCOVERED = 0.05
#: A direction is far away where this share of the views that look there have no point there.
AGREEMENT = 0.7
#: Directions on the whole sphere, and points that are added at most.
DIRECTIONS, MOST_POINTS = 40_000, 6_000


def far_points(points: np.ndarray, views: Sequence[View]) -> np.ndarray:
    """``[M, 3]`` metres: what to add to the first ``points`` ``[P, 3]``; none where these cover all."""
    empty = [_uncovered(points, view.camera) for view in views]
    if np.mean(empty) < LEAST_UNCOVERED:
        return np.zeros((0, 3))
    centre = np.mean([view.camera.position for view in views], axis=0)
    reached = float(np.quantile(np.linalg.norm(points - centre, axis=1), NEARLY_ALL))
    radius = max(EXTENTS * scene_extent(list(views)), BEYOND * reached)
    sphere = centre + radius * _directions(DIRECTIONS)
    seen, far = np.zeros(len(sphere)), np.zeros(len(sphere))
    for view, is_empty in zip(views, empty, strict=True):
        which, row, column = _cells(sphere, view.camera)
        seen[which] += 1.0
        far[which] += is_empty[row, column]
    chosen = np.flatnonzero((seen > 0) & (far >= AGREEMENT * seen))
    if len(chosen) > MOST_POINTS:  # evenly: neighbours on the spiral are neighbours in height
        chosen = chosen[np.linspace(0, len(chosen) - 1, MOST_POINTS).astype(int)]
    return sphere[chosen]


def _directions(count: int) -> np.ndarray:
    """``[count, 3]`` unit vectors spread evenly over the sphere: a golden spiral."""
    step = np.arange(count)
    height = 1.0 - (2.0 * step + 1.0) / count
    angle = step * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.sqrt(1.0 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=1)


def _cells(points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which points ``[P, 3]`` are in the picture, and the row and column of their cells, all ``[M]``."""
    inside = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    before = inside[:, 2] > 1e-6
    depth = np.where(before, inside[:, 2], 1.0)
    column = np.floor((camera.fx * inside[:, 0] / depth + camera.cx) / camera.width * CELLS)
    row = np.floor((camera.fy * inside[:, 1] / depth + camera.cy) / camera.height * CELLS)
    which = np.flatnonzero(before & (row >= 0) & (row < CELLS) & (column >= 0) & (column < CELLS))
    return which, row[which].astype(int), column[which].astype(int)


def _uncovered(points: np.ndarray, camera: Camera) -> np.ndarray:
    """``[CELLS, CELLS]`` bool: where no point is in the cell or beside it."""
    _, row, column = _cells(points, camera)
    covered = np.zeros((CELLS + 2, CELLS + 2), dtype=bool)
    for i in (0, 1, 2):
        for j in (0, 1, 2):
            covered[row + i, column + j] = True
    return ~covered[1:-1, 1:-1]
