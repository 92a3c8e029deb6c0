# SPDX-License-Identifier: GPL-3.0-or-later
"""Gaussians under an affine map: where they go, and which ellipsoids they become."""

import numpy as np

from .errors import BadValueError

#: A map whose columns are orthogonal and of equal length to this (relative) is a similarity.
SIMILARITY_TOLERANCE = 1e-5
#: The flattest map that is allowed: |det| over the cube of its largest column's length.
FLATTEST = 1e-9


def transform_gaussians(
    matrix: np.ndarray, position: np.ndarray, rotation: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions ``[N, 3]``, rotations ``[N, 4]`` (wxyz, unit), scales ``[N, 3]`` under ``matrix`` ``[4, 4]``.

    The covariance becomes A Σ Aᵀ. Moving, turning and uniform scaling keep each Gaussian's axes; with any
    other map they are found anew. Raises ``BadValueError`` where the map is flat or not finite.
    """
    matrix = np.asarray(matrix, np.float64)
    linear, offset = matrix[:3, :3], matrix[:3, 3]
    size = np.linalg.norm(linear, axis=0).max()
    if not (np.isfinite(matrix).all() and abs(np.linalg.det(linear)) > FLATTEST * size**3 > 0.0):
        raise BadValueError(
            "the object's matrix is flat or not finite", "Give it a scale other than 0 along every axis."
        )
    moved = (position @ linear.T + offset).astype(np.float32)
    rotation = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
    gram = linear.T @ linear
    factor = float(np.sqrt(np.trace(gram) / 3.0))
    close = np.abs(gram / factor**2 - np.eye(3)).max() < SIMILARITY_TOLERANCE
    if close and np.linalg.det(linear) > 0.0:
        turn = quaternions_of((linear / factor)[None])[0]
        return moved, multiply(turn, rotation).astype(np.float32), (scale * factor).astype(np.float32)
    axes, lengths, _ = np.linalg.svd(linear @ (matrices_of(rotation) * scale[:, None, :]))
    axes[np.linalg.det(axes) < 0.0, :, 2] *= -1.0
    return moved, quaternions_of(axes).astype(np.float32), lengths.astype(np.float32)


def multiply(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The quaternion (wxyz) ``left`` ``[4]`` after each of ``right`` ``[N, 4]``."""
    w, x, y, z = left
    product = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return right @ product.T


def matrices_of(quaternions: np.ndarray) -> np.ndarray:
    """``[N, 3, 3]`` rotations of unit quaternions ``[N, 4]``."""
    w, x, y, z = np.asarray(quaternions, np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def quaternions_of(rotations: np.ndarray) -> np.ndarray:
    """Unit quaternions ``[N, 4]`` of rotations ``[N, 3, 3]``, from each one's largest component."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotations.transpose(1, 2, 0)
    # 4 q qᵀ; every row is a multiple of q, the one with the largest diagonal the most precise.
    outer = np.array(
        [
            [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
        ]
    ).transpose(2, 0, 1)
    best = np.argmax(np.einsum("nii->ni", outer), axis=1)
    quaternions = outer[np.arange(len(outer)), best]
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """The unit quaternion wxyz, w ≥ 0, of a rotation ``[3, 3]``."""
    quaternion = quaternions_of(np.asarray(rotation, np.float64)[None])[0]
    return quaternion if quaternion[0] >= 0.0 else -quaternion
