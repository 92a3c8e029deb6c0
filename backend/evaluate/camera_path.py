# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of cameras for videos: smoothly through the cameras of a data set, or around their centre.

Also the cameras and light levels of a file's frames (``camera_file.py``).
"""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from ...bridge.errors import BadValueError
from ...bridge.shots import Shot, Shots
from ..scene.camera import Camera

#: Two poses nearer than this share of the cameras' extent are one stop of a path.
SAME_STOP = 1e-4
#: Radius of an orbit in standard deviations of the cameras; √2 is that of an even ring.
ORBIT_REACH = np.sqrt(2.0)
#: Below this the optical axes are too parallel to meet (a mean squared sine).
AXES_MEET = 2e-3
#: Distance of the focus for parallel axes, in extents of the cameras.
FAR = 3.0


def spline_path(cameras: Sequence[Camera], frames: int, closed: bool = False) -> list[Camera]:
    """``frames`` cameras at even speed along a cubic spline through the positions, rotations slerped.

    The cameras are visited along a short path, not in the order of their names, which jumps from row to row
    of a rig. ``closed``: back to the first one, for a looped video. Size and lens are the first camera's.
    Raises ``BadValueError`` for no cameras or fewer than two frames.
    """
    _require(cameras, frames)
    positions = np.array([camera.position for camera in cameras])
    rotations = np.array([camera.camera_to_world[:3, :3] for camera in cameras])
    extent = _extent(positions)
    order = _short_way(_distances(positions, rotations, extent))
    positions, rotations = positions[order], rotations[order]
    if closed:
        positions, rotations = np.r_[positions, positions[:1]], np.r_[rotations, rotations[:1]]
    metres = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    turns = Rotation.from_matrix(rotations[:-1].transpose(0, 2, 1) @ rotations[1:]).magnitude()
    steps = np.hypot(metres, extent * turns)
    distinct = np.r_[True, steps > SAME_STOP * extent]
    at = np.r_[0.0, np.cumsum(steps)][distinct]
    positions, rotations = positions[distinct], rotations[distinct]
    if len(positions) < 2:
        return [cameras[order[0]]] * frames
    if closed:
        positions[-1] = positions[0]
    spline = CubicSpline(at, positions, bc_type="periodic" if closed and len(at) > 2 else "not-a-knot")
    turn = Slerp(at, Rotation.from_matrix(rotations))
    # ``at`` measures distance and turn between stops, so even steps of it are an even speed.
    times = np.linspace(at[0], at[-1], frames, endpoint=not closed)
    return [_posed(cameras[0], spline(t), turn(t).as_matrix()) for t in times]


def orbit_path(cameras: Sequence[Camera], frames: int) -> list[Camera]:
    """``frames`` cameras on a closed ellipse among the given ones, looking at their common focus.

    The ellipse lies along the two main directions in which the positions spread: around an object that the
    cameras surround, in front of a scene that they face. Raises as ``spline_path``.
    """
    _require(cameras, frames)
    positions = np.array([camera.position for camera in cameras])
    centre, focus = positions.mean(axis=0), focus_of(cameras)
    _, _, directions = np.linalg.svd(positions - centre, full_matrices=True)
    reach = ORBIT_REACH * ((positions - centre) @ directions.T).std(axis=0)
    up = np.mean([camera.camera_to_world[:3, 1] for camera in cameras], axis=0)
    path = []
    for angle in np.linspace(0.0, 2.0 * np.pi, frames, endpoint=False):
        offset = np.cos(angle) * reach[0] * directions[0] + np.sin(angle) * reach[1] * directions[1]
        position = centre + offset
        path.append(_posed(cameras[0], position, _looking(position, focus, up)))
    return path


def camera_of(shot: Shot, shots: Shots, width: int | None = None) -> Camera:
    """The camera of one of ``shots``' frames, resized to ``width`` if given."""
    size = shots.width, shots.height
    camera = Camera(shot.camera_to_world, *size, shot.fx, shot.fy, shot.cx, shot.cy)
    return camera if width is None else camera.resized(width)


def levels_of(shot: Shot, lights: Sequence[str], standard: Sequence[float]) -> tuple[float, ...]:
    """A level for each of the model's lights, by default ``standard``.

    Raises ``BadValueError`` where a frame has more.
    """
    if len(shot.levels) > len(lights):
        raise BadValueError(
            f"a frame has {len(shot.levels)} lights, the model has {len(lights)}: {', '.join(lights)}",
            "Write the file again with this run's model selected.",
        )
    return (*shot.levels, *standard[len(shot.levels) :])


def focus_of(cameras: Sequence[Camera]) -> np.ndarray:
    """``[3]``: the point nearest to all optical axes; straight ahead where they are parallel or diverge."""
    positions = np.array([camera.position for camera in cameras])
    forward = np.array([-camera.camera_to_world[:3, 2] for camera in cameras])
    across = np.eye(3) - forward[:, :, None] * forward[:, None, :]  # what is left of a vector off the axis
    system = across.mean(axis=0)
    if len(cameras) > 1 and np.linalg.eigvalsh(system)[0] > AXES_MEET:
        focus = np.linalg.solve(system, np.einsum("nij,nj->i", across, positions) / len(cameras))
        if (np.einsum("ni,ni->n", focus - positions, forward) > 0.0).mean() > 0.5:
            return focus
    return positions.mean(axis=0) + FAR * _extent(positions) * _unit(forward.mean(axis=0))


def _require(cameras: Sequence[Camera], frames: int) -> None:
    if not cameras:
        raise BadValueError("a path needs at least one camera", "Give a data set with training views.")
    if frames < 2:
        raise BadValueError(f"a video needs at least 2 frames, got {frames}", "Raise --seconds or --fps.")


def _extent(positions: np.ndarray) -> float:
    """The largest distance of a position from their mean, metres; 1 for cameras all in one place."""
    return float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).max()) or 1.0


def _distances(positions: np.ndarray, rotations: np.ndarray, extent: float) -> np.ndarray:
    """``[N, N]``: how far apart poses are: metres and turns, a radian counting as the cameras' extent."""
    cosine = 0.5 * (np.einsum("iab,jab->ij", rotations, rotations) - 1.0)
    turn = extent * np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.hypot(np.linalg.norm(positions[:, None] - positions[None], axis=2), turn)


def _short_way(distances: np.ndarray) -> list[int]:
    """An order of all stops along a short open path: nearest neighbours, improved by 2-opt."""
    way = [0]
    left = set(range(1, len(distances)))
    while left:
        way.append(min(left, key=lambda i: distances[way[-1], i]))
        left.remove(way[-1])
    improved = True
    while improved:
        improved = False
        for i in range(len(way) - 1):
            for j in range(i + 1, len(way)):
                # Reverse way[i..j]; at an end of the path there is no edge.
                before = distances[way[i - 1], way[i]] if i else 0.0
                before += distances[way[j], way[j + 1]] if j + 1 < len(way) else 0.0
                after = distances[way[i - 1], way[j]] if i else 0.0
                after += distances[way[i], way[j + 1]] if j + 1 < len(way) else 0.0
                if after < before - 1e-12:
                    way[i : j + 1] = way[i : j + 1][::-1]
                    improved = True
    return way


def _posed(like: Camera, position: np.ndarray, rotation: np.ndarray) -> Camera:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    return Camera(pose, like.width, like.height, like.fx, like.fy, like.cx, like.cy)


def _looking(position: np.ndarray, focus: np.ndarray, up: np.ndarray) -> np.ndarray:
    """``[3, 3]`` camera to world, OpenGL axes: −Z toward ``focus``, +Y as near to ``up`` as that allows."""
    back = _unit(position - focus)
    right = np.cross(up, back)
    if np.linalg.norm(right) < 1e-6:  # looking straight along up
        right = np.cross(np.eye(3)[np.abs(back).argmin()], back)
    right = _unit(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-12)
