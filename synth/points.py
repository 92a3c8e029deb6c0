# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on visible surfaces, as from structure from motion: exact ray hits of the training cameras."""

from collections.abc import Sequence

import numpy as np
from mathutils import Vector

from . import in_views
from .rays import Rays
from .stage import CameraHints, Stage

WANTED = 18_000

_PLY_TYPE = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")]
    + [(name, "u1") for name in ("red", "green", "blue")]
)


def cast(stage: Stage, poses: list[np.ndarray], pictures: Sequence[np.ndarray], seed: int) -> np.ndarray:
    """Surface points seen from ``poses``, coloured from ``pictures`` ([height, width, 3] uint8, one a pose).

    Rays go through a jittered raster of pixel positions; a ray that meets only sky between the camera's
    clipping distances gives no point.

    Returns:
        Structured array of the PLY's columns: position (metres), normal toward the camera, colour.
    """
    dice = np.random.default_rng(seed)
    height, width = pictures[0].shape[:2]
    a_view = min(WANTED / len(poses), width * height)  # rays
    columns = max(1, round((a_view * width / height) ** 0.5))
    rows = max(1, round(a_view / columns))
    found = []
    with in_views.shaped(stage.scene, stage.view_layer):
        rays = Rays(stage.scene, stage.view_layer)
        for pose, picture in zip(poses, pictures, strict=True):
            found += _met(rays, stage.cameras, pose, picture, dice.random((rows, columns, 2)))
    return np.array(found, _PLY_TYPE)


def _met(
    rays: Rays, lens: CameraHints, pose: np.ndarray, picture: np.ndarray, jitter: np.ndarray
) -> list[tuple[float, ...]]:
    """The points of one view, a ray for each of ``jitter`` ([rows, columns, 2], 0 … 1)."""
    (height, width), (rows, columns) = picture.shape[:2], jitter.shape[:2]
    half = np.tan(lens.angle_x / 2)
    x = (np.arange(columns)[None, :] + jitter[..., 0]) * width / columns
    y = (np.arange(rows)[:, None] + jitter[..., 1]) * height / rows
    camera = np.stack(
        [(2 * x / width - 1) * half, (1 - 2 * y / height) * half * height / width, -np.ones_like(x)], -1
    )
    lengths = np.linalg.norm(camera, axis=-1, keepdims=True)
    directions = (camera / lengths) @ pose[:3, :3].T
    limits = lengths * lens.clip  # which are metres along the axis
    origin = Vector(pose[:3, 3].tolist())
    found = []
    for direction, (nearest, farthest), px, py in zip(
        directions.reshape(-1, 3), limits.reshape(-1, 2).tolist(), x.flat, y.flat, strict=True
    ):
        way = Vector(direction)
        hit = rays.first(origin, way, nearest, farthest)
        if hit:
            place, normal = hit
            normal = -normal if normal.dot(way) > 0 else normal
            colour = picture[min(int(py), height - 1), min(int(px), width - 1)]
            found.append((*place, *normal, *colour.tolist()))
    return found


def encode(points: np.ndarray) -> bytes:
    """The binary little-endian PLY of an array that ``cast`` made."""
    lines = ["ply", "format binary_little_endian 1.0", "comment surface points by ray casting, PhysHDR synth"]
    lines.append(f"element vertex {len(points)}")
    for name in _PLY_TYPE.names or ():
        lines.append(f"property {'uchar' if _PLY_TYPE[name].kind == 'u' else 'float'} {name}")
    return ("\n".join([*lines, "end_header"]) + "\n").encode("ascii") + points.tobytes()
