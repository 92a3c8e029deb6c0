# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rigs: each maps (u, v) in 0…1 to a camera that looks at the scene's target.

Poses are 4 × 4 camera-to-world matrices in Blender's world (metres); the camera looks down its −Z, +Y is up.
"""

import math
from collections.abc import Callable

import numpy as np

from .errors import OptionError, UnknownNameError
from .stage import WORLD_UP, CameraHints, RigPoses

GRID_ASPECT = 7 / 5  # columns over rows: 35 views are 5 × 7, as in HDR-NeRF's data


#: The rig of a user's scene that follows the camera's own animation (``user_camera.path``).
PATH = "path"


def look_at(
    position: np.ndarray, target: np.ndarray, up: tuple[float, float, float] = WORLD_UP
) -> np.ndarray:
    """Camera-to-world [4, 4] at ``position`` looking at ``target``, ``up`` upward in the picture."""
    back = position - target
    back = back / np.linalg.norm(back)
    right = np.cross(up, back)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, position
    return pose


def grid(hints: CameraHints, u: float, v: float) -> np.ndarray:
    """A flat grid that faces the scene: u to the right, v downward."""
    centre, target = np.array(hints.centre), np.array(hints.target)
    up = np.array(hints.up)
    back = look_at(centre, target, hints.up)[:3, 2]
    right = np.cross(up, back - up * (back @ up))
    right /= np.linalg.norm(right)
    offset = right * (u - 0.5) * hints.extent[0] + up * (0.5 - v) * hints.extent[1]
    return look_at(centre + offset, target, hints.up)


def hemisphere(hints: CameraHints, u: float, v: float) -> np.ndarray:
    """On a sphere about the target: u is azimuth, v elevation (0 the highest)."""
    target = np.array(hints.target)
    toward = np.array(hints.centre) - target
    azimuth = math.atan2(toward[1], toward[0]) + (u - 0.5) * hints.orbit_arc
    low, high = hints.elevation
    elevation = high + (low - high) * v
    direction = [
        math.cos(azimuth) * math.cos(elevation),
        math.sin(azimuth) * math.cos(elevation),
        math.sin(elevation),
    ]
    return look_at(target + hints.orbit_radius * np.array(direction), target)


def orbit(hints: CameraHints, u: float, v: float) -> np.ndarray:
    """On an arc about the target at the middle elevation; v does not matter."""
    return hemisphere(hints, u, 0.5)


RIGS: dict[str, Callable[[CameraHints, float, float], np.ndarray]] = {
    "grid": grid,
    "orbit": orbit,
    "hemisphere": hemisphere,
}


def poses(name: str, hints: CameraHints, views: int, lit_views: int, validation_views: int = 0) -> RigPoses:
    """The cameras of a rig: a grid split like a chess board into training and test, the rest between them.

    35 views are a 5 × 7 grid (18 training, 17 test). Other counts fill the grid nearest to that shape row by
    row. An orbit is one row. The lit views follow a low-discrepancy sequence over the same area, so that any
    run of them is spread out; the validation views follow one shifted by half of it, well within the gaps.

    Raises:
        UnknownNameError, OptionError
    """
    if name not in RIGS:
        raise UnknownNameError("camera rig", name, list(RIGS))
    if views < 2:
        raise OptionError(f"--views {views}: at least 2 are needed, one to train on and one to test")
    place = RIGS[name]
    rows = 1 if name == "orbit" else max(1, round(math.sqrt(views / GRID_ASPECT)))
    columns = math.ceil(views / rows)
    # A full circle's last column would be its first again.
    steps = columns if name != "grid" and hints.orbit_arc > 2 * math.pi - 1e-6 else columns - 1
    train, test = [], []
    for index in range(views):
        row, column = divmod(index, columns)
        u = column / steps if columns > 1 else 0.5
        v = row / (rows - 1) if rows > 1 else 0.5
        (train if (row + column) % 2 == 0 else test).append(place(hints, u, v))
    lit = [place(hints, *_spread(index, 0.5)) for index in range(lit_views)]
    validation = []
    for index in range(validation_views):
        u, v = _spread(index, 0.0)
        validation.append(place(hints, between(u, steps), between(v, rows - 1)))
    return RigPoses(train, test, lit, validation)


def _spread(index: int, start: float) -> tuple[float, float]:
    """Point ``index`` of the R2 low-discrepancy sequence (Roberts 2018) in the unit square from ``start``."""
    plastic = 1.32471795724474602596
    return (start + (index + 1) / plastic) % 1.0, (start + (index + 1) / plastic**2) % 1.0


def between(share: float, gaps: int) -> float:
    """``share`` in 0…1 of a way of so many equal gaps, moved into the middle half of the gap that it is in.

    So nobody stands where a gap ends, that is at a view that is trained from or tested.
    """
    if not gaps:
        return share
    gap = min(int(share * gaps), gaps - 1)
    return (gap + 0.25 + 0.5 * (share * gaps - gap)) / gaps


def spread_indices(total: int, wanted: int) -> list[int]:
    """``wanted`` distinct indices spread evenly over 0 … total − 1."""
    return [int((k + 0.5) * total / wanted) for k in range(wanted)]
