# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way is up: nobody tells structure from motion, but photographers hold their cameras level."""

from collections.abc import Sequence

import numpy as np

#: How much the mean of the cameras' own "up" counts beside their horizons: about a roll of 4° (squared
#: radians), so that it decides only where all cameras look the same way and horizons leave the tilt open.
MEAN_UP_WEIGHT = 5e-3


def up_direction(rotations: Sequence[np.ndarray]) -> np.ndarray:
    """Unit vector ``[3]`` of the world, given each camera's world-to-camera rotation in OpenCV axes.

    A camera that is held level has its picture's horizontal axis r at right angles to the vertical u,
    however it is tilted, so u minimises mean (r·u)² − w (m·u)², where m is the mean of the cameras' upward
    axes, which also decides the sign.
    """
    right = np.array([rotation[0] for rotation in rotations])
    mean_up = -np.mean([rotation[1] for rotation in rotations], axis=0)
    form = right.T @ right / len(right) - MEAN_UP_WEIGHT * np.outer(mean_up, mean_up)
    up = np.linalg.eigh(form)[1][:, 0]
    return up if up @ mean_up >= 0.0 else -up


def rotation_to_z(up: np.ndarray) -> np.ndarray:
    """The smallest rotation ``[3, 3]`` that takes the unit vector ``up`` to +Z (Rodrigues' formula)."""
    cosine = float(up[2])
    if cosine < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])  # upside down: any axis of the plane does
    cross = np.array([[0.0, 0.0, -up[0]], [0.0, 0.0, -up[1]], [up[0], up[1], 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + cosine)
