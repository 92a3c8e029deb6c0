# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a photographer with a camera in hand stands: to and fro about what is looked at, never quite level.

The places lie where the scene's hemisphere rig may put cameras, so that nobody stands in a wall.
"""

import math

import numpy as np

from . import rig
from .stage import CameraHints

#: So many times across the arc, each time a little lower.
SWEEPS = 3
#: Of the way to what is looked at, the largest step towards it.
NEARER = 0.15
#: Standard deviations in degrees of where the camera points, and of its horizon.
AIM, ROLL = 3.0, 2.0
#: Of the arc and of the range of heights, the standard deviation of a place.
UNSTEADY = 0.01


def places(hints: CameraHints, count: int, seed: int) -> list[np.ndarray]:
    """Camera-to-world [4, 4] of ``count`` places in the order of the walk; one seed gives one walk."""
    dice = np.random.default_rng([seed, 0x3A1F])
    found = []
    for k in range(count):
        way = SWEEPS * k / max(1, count - 1)
        across = way % 2.0
        u = across if across <= 1.0 else 2.0 - across
        u, v = np.clip([u, way / SWEEPS] + dice.normal(0.0, UNSTEADY, 2), 0.0, 1.0)
        pose = rig.hemisphere(hints, float(u), float(v))
        target = np.array(hints.target)
        pose[:3, 3] += dice.uniform(0.0, NEARER) * (target - pose[:3, 3])
        yaw, pitch = np.radians(dice.normal(0.0, AIM, 2))
        found.append(pose @ _turn(1, yaw) @ _turn(0, pitch) @ _turn(2, math.radians(dice.normal(0.0, ROLL))))
    return found


def _turn(axis: int, angle: float) -> np.ndarray:
    """[4, 4] about one of the camera's own axes."""
    turned = np.eye(4)
    a, b = (axis + 1) % 3, (axis + 2) % 3
    turned[a, a] = turned[b, b] = math.cos(angle)
    turned[b, a], turned[a, b] = math.sin(angle), -math.sin(angle)
    return turned
