# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of cameras from files: Blender's (``bridge/shots.py``), nerfstudio's viewer's, or a USD camera's.

Sources: nerfstudio's documentation and its ``cameras/camera_paths.py`` ("camera_path", vertical field of view
in degrees, poses as in ``transforms.json``); OpenUSD's ``UsdGeomCamera`` (aperture and focal length in one
unit, looks down −Z with +Y up; the stage's ``upAxis`` and ``metersPerUnit``).
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.axes import Up, turn_of_up
from ...bridge.errors import BadValueError, FileDamagedError
from ...bridge.layouts.checks import is_rotation, number, rigid_pose
from ...bridge.limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT, check_position
from ...bridge.regular import damaged_where_it_fails, read_json_object, regular_file
from ...bridge.shots import FORMAT, MOST_FRAMES, Shot, Shots, read_shots
from ..formats.apart import apart
from ..formats.usd_stage import camera_of
from ..optional import needed
from ..scene.camera import Camera

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
KINDS = (
    f"Give a file of Blender's panel ({FORMAT}), nerfstudio's camera path (JSON), or a USD stage with a "
    "camera; import Alembic cameras into Blender first."
)
#: Remedies for invalid files.
SPACE = "Give the dataparser_transforms.json that nerfstudio writes next to a training's config.yml."
POSES = "It stores what ns-process-data did to the cameras: give the run's data set with --data."
APERTURE = "Fix that camera's sensor (its film's size), and export it again."
#: Frame rate of nerfstudio's camera paths that state none.
NERFSTUDIO_FPS = 24.0
#: A USD camera whose axes differ in length by more than this share must have orthogonal ones.
SHEAR = 1e-4


def read_camera_file(
    path: Path,
    like: Camera,
    prim: str | None = None,
    space: Path | None = None,
    fewest: int = 1,
    poses: Path | None = None,
) -> Shots:
    """The frames of a file of any of the kinds. ``like``: its width is used for files that state none.

    ``prim``: which of a stage's cameras, by path or name. ``space``: nerfstudio's
    ``dataparser_transforms.json`` of the training whose viewer made the path, whose transform is undone.
    ``poses``: the ``transforms.json`` that our world comes from, if any. Raises ``FileMissingError``,
    ``FileDamagedError`` or ``BadValueError`` naming the file, ``PackageMissingError`` if a USD stage needs
    usd-core.
    """
    path = regular_file(Path(path), KINDS)
    is_usd = path.suffix.lower() in USD_SUFFIXES
    if prim is not None and not is_usd:
        raise BadValueError(f"{path} has no prims: --camera-prim is for USD", "Leave it out.")
    if is_usd:
        _refuse_space(space)
        return _require_count(path, _usd(path, like, prim), fewest)
    content = read_json_object(path, KINDS)
    if content.get("format") == FORMAT:
        _refuse_space(space)
        shots = read_shots(path, fewest)
        for index, shot in enumerate(shots.frames):
            rigid_pose(path, shot.camera_to_world, str(index))
        return shots
    if "camera_path" not in content:
        raise FileDamagedError(f"{path} is not a known kind of camera path", KINDS)
    return _require_count(path, _nerfstudio(path, content, _world_of(space, poses)), fewest)


def _refuse_space(space: Path | None) -> None:
    if space is not None:
        raise BadValueError("--camera-space only works with nerfstudio's paths", "Leave it out.")


def _require_count(path: Path, shots: Shots, fewest: int) -> Shots:
    if not fewest <= len(shots.frames) <= MOST_FRAMES:
        raise BadValueError(
            f"{path} has {len(shots.frames)} frames: it must have from {fewest} to {MOST_FRAMES}",
            "Make the path again with as many.",
        )
    return shots


# ---- nerfstudio ----------------------------------------------------------------------------------------


def _nerfstudio(path: Path, content: dict[str, Any], world: tuple[np.ndarray, float]) -> Shots:
    """``camera_path`` of the viewer's *Export Camera Path* (as for ``ns-render camera-path``)."""
    kind = content.get("camera_type", "perspective")
    if kind != "perspective":
        raise BadValueError(
            f"{path} has the camera type {kind!r:.40}: only perspective ones are supported",
            "Make the path with a perspective camera; for panoramas use physhdr render --at.",
        )
    sides = []
    for key in ("render_width", "render_height"):
        side = number(path, content.get(key), key)
        if side != int(side) or not 0 < side <= LARGEST_SIDE:
            raise BadValueError(
                f"{path}: '{key}' is {side:g}", f"It must be from 1 to {LARGEST_SIDE} pixels."
            )
        sides.append(int(side))
    width, height = sides
    fps = number(path, content.get("fps", NERFSTUDIO_FPS), "fps")
    if not 0.0 < fps <= 240.0:
        raise BadValueError(f"{path}: 'fps' is {fps:g}", "It must be above 0 and at most 240.")
    rows = content["camera_path"]
    if not isinstance(rows, list):
        raise FileDamagedError(f"{path}: 'camera_path' is not a list of frames", KINDS)
    linear, scale = world
    frames = []
    for index, row in enumerate(rows):
        if not isinstance(row, dict):
            raise FileDamagedError(f"{path}: frame {index} is not an object", KINDS)
        pose = rigid_pose(path, _square(row.get("camera_to_world")), str(index))
        # x' = scale · (linear x): poses of the file are in that space.
        with np.errstate(over="ignore", invalid="ignore"):
            pose[:3, 3] /= scale
            pose = np.linalg.inv(linear) @ pose
        check_position(pose[:3, 3], f"{path}: the camera of frame {index} in the world before training")
        angle = number(path, row.get("fov"), f"frame {index}: 'fov'")
        slope = math.tan(math.radians(0.5 * angle))
        if not (0.0 < angle < 180.0 and slope > 0.0):  # the least numbers halve to 0
            raise BadValueError(f"{path}: frame {index}: 'fov' is {angle:g}", "Degrees, between 0 and 180.")
        focal = 0.5 * height / slope
        FOCAL_LENGTH.check(focal, f"{path}: the focal length of frame {index}")
        frames.append(Shot(pose, focal, focal, 0.5 * width, 0.5 * height))
    return Shots(width, height, fps, frames)


def _square(values: Any) -> Any:
    """A list of 16 numbers, row by row, as a 4×4 matrix; anything else unchanged."""
    if isinstance(values, list) and len(values) == 16:
        return [values[at : at + 4] for at in range(0, 16, 4)]
    return values


def _world_of(space: Path | None, poses: Path | None) -> tuple[np.ndarray, float]:
    """``[4, 4]`` and a factor: x' = factor · (matrix x), from our world to that of a nerfstudio training.

    The training records everything done since the cameras were found. The part done by ns-process-data,
    ``applied_…``, is already in the poses of ``transforms.json``: our world is the one after it.
    """
    if space is None:
        return np.eye(4), 1.0
    content = read_json_object(Path(space), SPACE)
    matrix, scale = _similarity(Path(space), content, "transform", "scale", SPACE)
    if poses is None:
        return matrix, scale
    before = {"applied_transform": np.eye(4)[:3].tolist(), "applied_scale": 1.0}
    before |= read_json_object(poses, POSES)
    applied, applied_scale = _similarity(poses, before, "applied_transform", "applied_scale", POSES)
    return matrix @ np.linalg.inv(applied), scale / applied_scale


def _similarity(
    path: Path, content: dict[str, Any], transform: str, factor: str, remedy: str
) -> tuple[np.ndarray, float]:
    """A rotation and translation ``[4, 4]`` and a scale of ``content``, by their names there."""
    scale = number(path, content.get(factor), factor)
    matrix = np.eye(4)
    with damaged_where_it_fails(f"{path} has no '{transform}' of 3×4 numbers", remedy):
        matrix[:3] = np.asarray(content[transform], np.float64).reshape(-1, 4)[:3]
    if not (scale > 0.0 and np.isfinite(matrix).all() and is_rotation(matrix[:3, :3])):
        raise BadValueError(
            f"{path}: '{transform}' is not a rotation and translation, or '{factor}' is not above 0",
            remedy,
        )
    return matrix, scale


# ---- USD -----------------------------------------------------------------------------------------------


def _usd(path: Path, like: Camera, prim: str | None) -> Shots:
    """A stage's camera at each of its time codes; once if it has no range of them."""
    needed("pxr", "usd-core", f"{path.name}: a USD camera")
    found, arrays = apart(path, camera_of, str(path), prim, MOST_FRAMES, KINDS)
    to_world = _blender_world(path, found["up"], found["metres"])
    for wide, high in arrays["lenses"][:, :2]:
        if not all(math.isfinite(side) and side > 0.0 for side in (wide, high)):
            raise BadValueError(f"{path}: {found['path']} has an aperture of {wide:g}×{high:g}", APERTURE)
    wide, high = map(float, arrays["lenses"][0, :2])
    width, height = like.width, max(1.0, like.width * high / wide)
    if height > LARGEST_SIDE:
        raise BadValueError(
            f"{path}: an aperture of {wide:g}×{high:g} gives {height:g} rows of pixels", APERTURE
        )
    for time, perspective in zip(arrays["times"], found["perspective"], strict=True):
        if not perspective:
            raise BadValueError(
                f"{path}: the camera is orthographic at {time:g}", "Make it a perspective one."
            )
    frames = [
        _usd_shot(path, float(time), to_world @ pose, lens.tolist(), width, round(height))
        for time, pose, lens in zip(arrays["times"], arrays["poses"], arrays["lenses"], strict=True)
    ]
    fps = found["fps"]
    return Shots(width, round(height), fps if 0.0 < fps <= 240.0 else NERFSTUDIO_FPS, frames)


def _blender_world(path: Path, up: Up, metres: float) -> np.ndarray:
    """``[4, 4]``: the stage's space → Blender's, metres and +Z up."""
    if not (math.isfinite(metres) and metres > 0.0):
        raise BadValueError(f"{path}: 'metersPerUnit' is {metres:g}", "It must be above 0.")
    matrix = np.diag([metres, metres, metres, 1.0])
    matrix[:3, :3] = turn_of_up(up, "z") * metres
    return matrix


def _usd_shot(
    path: Path, time: float, pose: np.ndarray, lens: Sequence[float], width: int, height: int
) -> Shot:
    """One time's camera; ``pose``: to Blender's world, ``lens``: as ``camera_of`` has it."""
    lengths = np.linalg.norm(pose[:3, :3], axis=0)
    if not (np.isfinite(pose).all() and lengths.min() > 0.0):
        raise BadValueError(
            f"{path}: the camera's matrix at {time:g} is flat or not finite",
            "Give it and its parents a scale other than 0 along every axis.",
        )
    pose[:3, :3] /= lengths  # a camera's own scale does not change its image
    if np.ptp(lengths) > SHEAR * lengths.max() and not is_rotation(pose[:3, :3]):
        raise BadValueError(f"{path}: the camera is sheared at {time:g}", "Unparent it, or apply the scale.")
    pose = rigid_pose(path, pose, f"{time:g}")
    wide, high, right, upward, focal_length = lens
    fx, fy = width * focal_length / wide, height * focal_length / high
    for focal in (fx, fy):
        FOCAL_LENGTH.check(focal, f"{path}: the focal length at {time:g}")
    # The offset moves the window, so the axis meets the image on the other side of the centre.
    cx = width * (0.5 - right / wide)
    cy = height * (0.5 + upward / high)
    for centre in (cx, cy):
        PRINCIPAL_POINT.check(centre, f"{path}: the principal point at {time:g}")
    return Shot(pose, fx, fy, cx, cy)
