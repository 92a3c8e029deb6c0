# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's cameras and pictures, binary and text (its documentation, "Output Format"), without the trainer.

What a panel and Blender's cameras need: where each picture was taken, and through what. No bpy.
"""

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...bridge import colmap, data_set
from ...bridge.affine import matrices_of
from ...bridge.axes import camera_to_world_opengl
from ...bridge.errors import BadValueError
from ...bridge.limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT
from ...bridge.regular import damaged_where_it_fails, read_bytes, read_text

COPY_AGAIN = "Copy the data set again, or make it again."
#: Bytes of the file of pictures, which has their keypoints.
LARGEST_MODEL = 1 << 34
_COUNT, _IMAGE, _OBSERVATION = struct.Struct("<Q"), struct.Struct("<i7di"), 24
_CAMERA = struct.Struct("<iiQQ")
#: Those whose lines are straight where all numbers are told.
_PINHOLES = ("SIMPLE_PINHOLE", "PINHOLE")


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera as far as it is a pinhole: pixels. ``bends``: its lines are not straight."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    bends: bool


@dataclass(frozen=True, eq=False)
class Placed:
    """A picture that was placed: ``camera_to_world`` ``[4, 4]`` float64, OpenGL axes; ``observed``: how many
    points of structure from motion it shows."""

    name: str
    camera: int
    camera_to_world: np.ndarray
    observed: int

    @property
    def place(self) -> np.ndarray:
        """``[3]`` float64: where it was taken."""
        return self.camera_to_world[:3, 3]


def pose_of(name: str) -> str:
    """The pose of a bracket's picture: ``train_03_2.jpg`` → ``train_03``."""
    return re.sub(r"_\d+$", "", Path(name).stem)


def read_placed(model: Path) -> list[Placed]:
    """Every picture that was placed, in the file's order. Raises the errors of ``bridge.errors``."""
    binary = (model / "images.bin").exists()
    return list(_images_binary(model / "images.bin") if binary else _images_text(model / "images.txt"))


def read_lenses(model: Path) -> dict[int, Lens]:
    """The cameras by their numbers. Raises ``FileMissingError``, ``FileDamagedError``, and ``BadValueError``
    for numbers that no camera has, and for panoramas."""
    binary = (model / "images.bin").exists()
    return dict(_cameras_binary(model / "cameras.bin") if binary else _cameras_text(model / "cameras.txt"))


def _images_binary(path: Path) -> Iterator[Placed]:
    content = read_bytes(path, COPY_AGAIN, LARGEST_MODEL)
    with damaged_where_it_fails(f"{path} is damaged", COPY_AGAIN):
        (count,) = _COUNT.unpack_from(content, 0)
        at = _COUNT.size
        for _ in range(count):
            _, *pose, camera = _IMAGE.unpack_from(content, at)
            end = content.index(b"\0", at + _IMAGE.size)
            name = content[at + _IMAGE.size : end].decode("utf-8")
            (listed,) = _COUNT.unpack_from(content, end + 1)
            at = end + 1 + _COUNT.size
            if listed * _OBSERVATION > len(content) - at:
                raise ValueError("it ends too early")
            points = np.frombuffer(content, "<i8", 3 * listed, at)[2::3]
            at += listed * _OBSERVATION
            yield _placed(name, camera, pose, int(np.count_nonzero(points >= 0)))


def _images_text(path: Path) -> Iterator[Placed]:
    lines = [line for line in read_text(path, COPY_AGAIN).splitlines() if not line.startswith("#")]
    with damaged_where_it_fails(f"{path} is damaged", COPY_AGAIN):
        for line, keypoints in zip(lines[::2], [*lines[1::2], ""], strict=False):
            if words := line.split(maxsplit=9):
                observed = sum(int(point) >= 0 for point in keypoints.split()[2::3])
                yield _placed(words[9], int(words[8]), [float(word) for word in words[1:8]], observed)


def _placed(name: str, camera: int, pose: list[float], observed: int) -> Placed:
    """Of a world-to-camera quaternion (wxyz) and translation in OpenCV's axes."""
    quaternion = np.array(pose[:4]) / math.hypot(*pose[:4])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = matrices_of(quaternion[None])[0]
    world_to_camera[:3, 3] = pose[4:]
    matrix = camera_to_world_opengl(world_to_camera)
    if not np.isfinite(matrix).all():
        raise ValueError("a camera's pose is not finite")
    return Placed(data_set.plain_name(name), camera, matrix, observed)


def _cameras_binary(path: Path) -> Iterator[tuple[int, Lens]]:
    content = read_bytes(path, COPY_AGAIN, LARGEST_MODEL)
    with damaged_where_it_fails(f"{path} is damaged", COPY_AGAIN):
        (count,) = _COUNT.unpack_from(content, 0)
        at = _COUNT.size
        for _ in range(count):
            number, model, width, height = _CAMERA.unpack_from(content, at)
            name, numbers, _ = colmap.MODELS[model]
            values = struct.unpack_from(f"<{numbers}d", content, at + _CAMERA.size)
            at += _CAMERA.size + 8 * numbers
            yield number, _lens(path, number, name, width, height, values)


def _cameras_text(path: Path) -> Iterator[tuple[int, Lens]]:
    text = read_text(path, COPY_AGAIN)
    with damaged_where_it_fails(f"{path} is damaged", COPY_AGAIN):
        for words in (line.split() for line in text.splitlines() if not line.startswith("#")):
            if words:
                values = tuple(float(word) for word in words[4:])
                yield int(words[0]), _lens(path, words[0], words[1], int(words[2]), int(words[3]), values)


def _lens(path: Path, number: int | str, model: str, width: int, height: int, values: tuple) -> Lens:
    _, numbers, focal_lengths = colmap.BY_NAME[model]
    if len(values) != numbers or not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE):
        raise ValueError(f"camera {number} is {width}×{height} with {len(values)} numbers")
    if not focal_lengths:
        raise BadValueError(
            f"{path}: camera {number} is a panorama, which is not a camera with a focal length",
            "Cut it into views of pinhole cameras.",
        )
    fx, fy = values[0], values[focal_lengths - 1]
    cx, cy = values[focal_lengths : focal_lengths + 2]
    for focal in (fx, fy):
        FOCAL_LENGTH.check(focal, f"{path}: the focal length of camera {number}")
    for coordinate in (cx, cy):
        PRINCIPAL_POINT.check(coordinate, f"{path}: the principal point of camera {number}")
    return Lens(width, height, fx, fy, cx, cy, model not in _PINHOLES and any(values[focal_lengths + 2 :]))
