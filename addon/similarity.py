# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a capture stands in the scene: maps that move, turn and scale alike along all axes. numpy alone.

Structure from motion knows neither a metre nor the floor. Each of the maps here is what must still be done to
a capture as it stands; where it stands right already, it does nothing, so that setting something twice is
setting it once. All scale about the world's origin: the floor at z = 0 stays the floor.
"""

import numpy as np

from ..bridge.affine import SIMILARITY_TOLERANCE
from ..bridge.errors import BadValueError, DataMismatchError

#: Points that are nearer to each other than this share of their distance from the origin are one point.
APART = 1e-6
#: Three points span a plane where the sine of the largest angle between their sides is above this.
SLIMMEST = 1e-3
#: A model is flat where its smallest scale is below this share of its largest: Blender keeps float32.
FLATTEST = 1e-6
MIRRORED_OR_FLAT = ("the model is mirrored or flat", "Undo that: give it one scale above 0.")


def scale_of(matrix: np.ndarray) -> float:
    """How many times larger a similarity ``[4, 4]`` makes things.

    Raises ``DataMismatchError`` where it is none: sheared, mirrored, or scaled differently along its axes.
    """
    linear = np.asarray(matrix, np.float64)[:3, :3]
    determinant = np.linalg.det(linear)
    scale = float(np.cbrt(determinant))
    if not np.isfinite(matrix).all() or determinant <= 0.0:
        raise DataMismatchError(*MIRRORED_OR_FLAT)
    # Blender keeps angles and scales as float32: a few 1e-7.
    if np.abs(linear.T @ linear / scale**2 - np.eye(3)).max() > SIMILARITY_TOLERANCE:
        raise DataMismatchError(
            "the model is scaled differently along its axes", "Give it the same scale along X, Y and Z."
        )
    return scale


def inverse_of(matrix: np.ndarray) -> np.ndarray:
    """``[4, 4]``: from the world into a model that stands at ``matrix``, mirrored or scaled differently along
    its axes too. Raises ``DataMismatchError`` where it is flat."""
    if np.isfinite(matrix).all():
        scales = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        if scales[2] > FLATTEST * scales[0]:
            return np.linalg.inv(matrix)
    raise DataMismatchError(*MIRRORED_OR_FLAT)


def scaled_to(first: np.ndarray, second: np.ndarray, distance: float) -> np.ndarray:
    """``[4, 4]``: makes two points ``[3]`` lie ``distance`` metres apart.

    Raises ``BadValueError`` where they are one point, or the distance is none.
    """
    measured = float(np.linalg.norm(second - first))
    if measured <= APART * max(1.0, float(np.abs(first).max())):
        raise BadValueError("the two points are one point", "Choose two that lie well apart.")
    return scaled(distance / measured)


def scaled(factor: float) -> np.ndarray:
    """``[4, 4]``: larger by ``factor``, about the origin. Raises ``BadValueError``."""
    if not (np.isfinite(factor) and factor > 0.0):
        raise BadValueError(f"a capture cannot be made {factor:g} times as large", "Give a length above 0.")
    return np.diag([factor, factor, factor, 1.0])


def floor_to_ground(points: np.ndarray, above: np.ndarray) -> np.ndarray:
    """``[4, 4]``: makes the plane through three points ``[3, 3]`` z = 0, with ``above`` ``[3]`` over it.

    The smallest turn that does, about the points' middle: the capture stays where it is, and keeps its
    heading. Raises ``BadValueError`` where the points lie on a line.
    """
    sides = points[1:] - points[0]
    normal = np.cross(sides[0], sides[1])
    lengths = np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1)
    if not np.linalg.norm(normal) > SLIMMEST * np.sort(lengths)[1:].prod():
        raise BadValueError("the three points lie on a line", "Choose three corners of the floor.")
    normal /= np.linalg.norm(normal)
    middle = points.mean(axis=0)
    if normal @ (above - middle) < 0.0:
        normal = -normal
    matrix = np.eye(4)
    matrix[:3, :3] = _turn_to_z(normal)
    matrix[:3, 3] = middle - matrix[:3, :3] @ middle
    matrix[2, 3] -= middle[2]
    return matrix


def _turn_to_z(normal: np.ndarray) -> np.ndarray:
    """``[3, 3]``: the smallest rotation that takes a unit vector to +Z (Rodrigues, without the angle)."""
    x, y, z = normal
    level = x * x + y * y
    if z < 0.0 and level < 1e-30:  # straight down: half a turn, about any level axis
        return np.diag([1.0, -1.0, -1.0])
    beyond = level / (1.0 - z) if z < 0.0 else 1.0 + z  # 1 + z, without the cancellation near −1
    return np.array(
        [
            [1.0 - x * x / beyond, -x * y / beyond, -x],
            [-x * y / beyond, 1.0 - y * y / beyond, -y],
            [x, y, z],
        ]
    )


def raised(by: float) -> np.ndarray:
    """``[4, 4]``: ``by`` metres up."""
    matrix = np.eye(4)
    matrix[2, 3] = by
    return matrix


def apply(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points ``[N, 3]`` under ``[4, 4]``."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def into_capture(to_world: np.ndarray, camera_to_world: np.ndarray) -> np.ndarray:
    """``[4, 4]``, rigid: where a camera of the world is in a capture that stands at ``to_world``.

    It sees there what it sees in the world, ``scale_of(to_world)`` times smaller.
    """
    return _moved(np.linalg.inv(to_world), camera_to_world)


def out_of_capture(to_world: np.ndarray, camera_in_capture: np.ndarray) -> np.ndarray:
    """The inverse of ``into_capture``."""
    return _moved(to_world, camera_in_capture)


def _moved(matrix: np.ndarray, pose: np.ndarray) -> np.ndarray:
    moved = matrix @ pose
    moved[:3, :3] /= np.cbrt(np.linalg.det(matrix[:3, :3]))  # a camera itself has no size
    return moved
