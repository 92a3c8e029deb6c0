# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a training's pictures were taken from: ``cameras.json``, in the form that 3DGS's programs read, and
the same list in a model file.

A list of objects: ``id``, ``img_name``, ``width`` and ``height`` in pixels, ``position`` of the camera,
``rotation`` from the camera's axes (right, down, forward) to the world's, row by row, ``fx`` and ``fy`` in
pixels. Ours also have ``cx``, ``cy`` and ``pose``: ``given``, as the data set has it, or ``learned``, as
training has found it.
"""

import json
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .atomic import atomic_path
from .axes import OPENGL_TO_OPENCV
from .errors import BadValueError, FileDamagedError, OutputError, PhysHDRError
from .limits import FARTHEST, LARGEST_SIDE, check_position
from .regular import read_json

GIVEN, LEARNED = "given", "learned"
REMEDY = "Delete it, and export the run again; without it the data set's own poses are taken."
#: Of a rotation's columns: how far from unit and square they may be.
RIGID = 1e-3
#: The most cameras in a model file, evenly chosen: enough to look around in it.
LISTED_MOST = 500
#: Significant digits there.
DIGITS = 7


@dataclass(frozen=True, eq=False)
class ListedCamera:
    """A camera of the list.

    ``camera_to_world``: ``[4, 4]`` float64, rigid, looks down −Z, +Y up. ``fx, fy, cx, cy``: pixels of a
    picture of ``width`` × ``height``. ``is_learned``: whether training has moved it.
    """

    name: str
    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    is_learned: bool = False


def camera_text(cameras: Sequence[ListedCamera]) -> str:
    """The list as JSON in one line, for a model file; a subset where there are many cameras."""
    step = -(-len(cameras) // LISTED_MOST) or 1
    return json.dumps(
        [_short(_entry(*each)) for each in list(enumerate(cameras))[::step]], separators=(",", ":")
    )


def _short(value: Any) -> Any:
    """What ``_entry`` gives, in fewer digits."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: _short(each) for key, each in value.items()}
    return [_short(each) for each in value] if isinstance(value, list) else value


def cameras_of(content: Any, path: Path, remedy: str) -> tuple[ListedCamera, ...]:
    """The cameras of a list that was read from ``path``; raises ``FileDamagedError``, with that remedy."""
    if not _is_ours(content):
        raise FileDamagedError(f"{path}: PhysHDR did not write its list of cameras", remedy)
    return tuple(_camera(each, path, remedy) for each in content)


def _camera(each: dict[str, Any], path: Path, remedy: str) -> ListedCamera:
    name, pose = _name(each, path, remedy), _pose(each, path, remedy)
    size: list[Any] = [each.get(key) for key in ("width", "height")]
    lens: list[Any] = [each.get(key) for key in ("fx", "fy", "cx", "cy")]
    if not all(type(value) is int and 0 < value <= LARGEST_SIDE for value in size):
        raise FileDamagedError(f"{path}: camera {name}: its picture has no size", remedy)
    if (
        not all(type(value) in (int, float) and abs(value) <= FARTHEST for value in lens)
        or min(lens[:2]) <= 0.0
    ):
        raise FileDamagedError(f"{path}: camera {name}: it has no focal length", remedy)
    return ListedCamera(name, pose, *size, *map(float, lens), is_learned=each["pose"] == LEARNED)


def moved(cameras: Sequence[ListedCamera], matrix: np.ndarray) -> tuple[ListedCamera, ...]:
    """The cameras moved, turned and scaled with a scene by ``matrix`` ``[4, 4]``: they stay rigid."""
    turn = matrix[:3, :3] / np.cbrt(np.linalg.det(matrix[:3, :3]))
    poses = [matrix @ each.camera_to_world for each in cameras]
    for pose, each in zip(poses, cameras, strict=True):
        pose[:3, :3] = turn @ each.camera_to_world[:3, :3]
    return tuple(replace(each, camera_to_world=pose) for each, pose in zip(cameras, poses, strict=True))


def write_camera_list(path: Path, cameras: Sequence[ListedCamera]) -> None:
    """Write the file in one step; raises ``OutputError``, also where another program's is there."""
    content = [_entry(number, camera) for number, camera in enumerate(cameras)]
    with atomic_path(path, check=refuse_others) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _entry(number: int, camera: ListedCamera) -> dict[str, Any]:
    pose = camera.camera_to_world @ OPENGL_TO_OPENCV
    return {
        "id": number,
        "img_name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "position": pose[:3, 3].tolist(),
        "rotation": pose[:3, :3].tolist(),
        "fy": camera.fy,
        "fx": camera.fx,
        "cx": camera.cx,
        "cy": camera.cy,
        "pose": LEARNED if camera.is_learned else GIVEN,
    }


def refuse_others(path: Path) -> None:
    """Raises ``OutputError`` where a file is there that is not ours: 3DGS's own has the same name."""
    if not (path.exists() or path.is_symlink()):
        return
    with suppress(PhysHDRError):
        if _is_ours(read_json(path)):
            return
    raise OutputError(f"{path} exists, and PhysHDR did not write it", "Name another folder, or move it away.")


def _is_ours(content: Any) -> bool:
    return isinstance(content, list) and all(
        isinstance(each, dict) and each.get("pose") in (GIVEN, LEARNED) for each in content
    )


def read_learned_poses(path: Path) -> dict[str, np.ndarray]:
    """By name, ``[4, 4]`` camera to world (looks down −Z, +Y up) of those cameras that training has moved.

    Empty where there is no file, or another program's. Raises ``FileDamagedError`` and ``BadValueError``.
    """
    if not path.exists():
        return {}
    content = read_json(path, REMEDY)
    if not _is_ours(content):
        return {}
    return {_name(each, path): _pose(each, path) for each in content if each["pose"] == LEARNED}


def _name(each: dict[str, Any], path: Path, remedy: str = REMEDY) -> str:
    name = each.get("img_name")
    if not isinstance(name, str) or not name:
        raise FileDamagedError(f"{path}: a camera has no img_name", remedy)
    return name


def _pose(each: dict[str, Any], path: Path, remedy: str = REMEDY) -> np.ndarray:
    where = f"{path}: camera {_name(each, path, remedy)}"
    pose = np.eye(4)
    for key, shape, part in (("position", (3,), np.s_[:3, 3]), ("rotation", (3, 3), np.s_[:3, :3])):
        found = np.empty(0)
        with suppress(ValueError):  # rows of different lengths
            found = np.array(each.get(key))
        if found.shape != shape or found.dtype.kind not in "iuf" or not np.isfinite(found).all():
            raise FileDamagedError(f"{where}: {key} is not {'×'.join(map(str, shape))} numbers", remedy)
        pose[part] = found
    try:
        check_position(pose[:3, 3], f"{where}: it")
    except BadValueError as error:
        raise FileDamagedError(error.message, remedy) from error
    rotation = pose[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > RIGID or np.linalg.det(rotation) < 0.0:
        raise FileDamagedError(f"{where}: rotation is not a rotation", remedy)
    return pose @ OPENGL_TO_OPENCV
