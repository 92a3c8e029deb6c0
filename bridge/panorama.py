# SPDX-License-Identifier: GPL-3.0-or-later
"""The light at a place, from all directions: equirectangular pictures as Blender's world takes them.

Row 0 is straight up (+Z), the last straight down; the middle column is +X and longitudes fall to the right:
+Y is a quarter of the width from the left, −Y three quarters. That is what Cycles' environment texture reads,
and what its panoramic camera draws that stands upright and looks along +X; a test holds both to this.
"""

import math

import numpy as np

#: A camera's Euler angles (XYZ) with which Blender's panoramic camera draws such a picture.
PANORAMIC_CAMERA_TURN = (0.5 * math.pi, 0.0, -0.5 * math.pi)
#: Where a model's Gaussians are left out that are too near to a place: nearer than this share of the median
#: distance of all of them …
NEAR_SHARE = 0.02
#: … or around it: so many of its standard deviations reach from a Gaussian's centre to the place.
INSIDE = 2.0


def directions(width: int, column: float = 0.5, row: float = 0.5) -> np.ndarray:
    """``[width / 2, width, 3]`` unit vectors of a panorama's pixels; float64.

    ``column``, ``row``: where in its pixel each is taken, 0…1 from the left and from the top.
    """
    height = width // 2
    longitude = math.pi * (1.0 - 2.0 * (np.arange(width) + column) / width)
    latitude = math.pi * (0.5 - (np.arange(height) + row) / height)
    level = np.cos(latitude)[:, None]
    up = np.broadcast_to(np.sin(latitude)[:, None], (height, width))
    return np.stack([level * np.cos(longitude), level * np.sin(longitude), up], axis=-1)


def coordinates(vectors: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Column and row, in pixels from the top left corner, of directions ``[…, 3]`` of any length."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    column = (0.5 - np.arctan2(y, x) / (2.0 * math.pi)) * width
    row = (0.5 - np.arctan2(z, np.hypot(x, y)) / math.pi) * (width // 2)
    return column, row


def solid_angles(width: int) -> np.ndarray:
    """``[width / 2]`` sr: the solid angle of a pixel of each row; times ``width`` they add up to 4π."""
    edges = np.sin(math.pi * (0.5 - np.arange(width // 2 + 1) / (width // 2)))
    return (edges[:-1] - edges[1:]) * (2.0 * math.pi / width)


def unseen_share(alpha: np.ndarray) -> float:
    """The share of the sphere that nothing covers, of coverage ``[H, W]`` in 0…1."""
    return float((solid_angles(alpha.shape[1])[:, None] * (1.0 - alpha)).sum() / (4.0 * math.pi))


def near_distance(positions: np.ndarray, at: np.ndarray) -> float:
    """How near Gaussians at ``positions`` ``[N, 3]`` may be to a place ``[3]``: ``NEAR_SHARE`` says it."""
    if not len(positions):
        return 0.0
    return NEAR_SHARE * float(np.median(np.linalg.norm(positions - np.asarray(at), axis=1)))


def too_near(
    positions: np.ndarray, rotations: np.ndarray, scales: np.ndarray, at: np.ndarray, near: float
) -> np.ndarray:
    """``[N]`` bool: Gaussians whose centre is nearer to ``at`` than ``near``, or that lie around it.

    ``rotations`` ``[N, 4]`` wxyz of any length, ``scales`` ``[N, 3]`` standard deviations. Drawn from there
    they would hide everything, and no camera has seen them from inside.
    """
    offset = np.asarray(at, np.float64) - positions
    distance = np.linalg.norm(offset, axis=1)
    chosen = distance < near
    # No Gaussian is larger than its largest deviation: the others need no rotation.
    candidates = np.flatnonzero(~chosen & (distance < INSIDE * scales.max(axis=1, initial=0.0)))
    if candidates.size:
        own = _rotated_back(offset[candidates], np.asarray(rotations[candidates], np.float64))
        deviations = own / np.maximum(scales[candidates], 1e-12)
        chosen[candidates] = np.linalg.norm(deviations, axis=1) < INSIDE
    return chosen


def _rotated_back(vectors: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """Vectors ``[N, 3]`` in the axes of what quaternions ``[N, 4]`` (wxyz) turn."""
    quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    w, axis = quaternions[:, :1], -quaternions[:, 1:]
    across = 2.0 * np.cross(axis, vectors)
    return vectors + w * across + np.cross(axis, across)
