# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's cameras, images and points, binary and text (its documentation, "Output Format").

A file's counts are believed only as far as the file is long: nothing is allocated for a count before that.
"""

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

import numpy as np

from ...bridge.affine import matrices_of, quaternions_of
from ...bridge.atomic import atomic_path
from ...bridge.axes import camera_to_world_opengl
from ...bridge.colmap import BY_NAME, MODELS, models_in, picture_count
from ...bridge.errors import DataMismatchError, FileDamagedError
from ...bridge.limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT, check_position
from ...bridge.regular import read_bytes, read_text, regular_file
from .camera import Camera
from .lens import RealCamera, panorama
from .points import STRUCTURE_FROM_MOTION, are_near
from .scene import Points

#: Bytes of a file; images.bin of ten thousand pictures with ten thousand keypoints each has 2.4e9.
LARGEST_FILE = 1 << 34
RUN_AGAIN = "Copy the model again, or run COLMAP again."


@dataclass(frozen=True, eq=False)
class SparseImage:
    """A registered picture: ``world_to_camera`` ``[4, 4]`` float64, OpenCV axes; ``observed``: its points."""

    name: str
    camera: int
    world_to_camera: np.ndarray
    observed: int


@dataclass(frozen=True, eq=False)
class SparseModel:
    """What structure from motion found. ``points``: None where there are none."""

    folder: Path
    cameras: dict[int, RealCamera]
    images: list[SparseImage]
    points: Points | None

    def camera(self, image: SparseImage) -> Camera:
        """The camera of a picture at the size that COLMAP saw, as far as it is a pinhole.

        Raises ``DataMismatchError`` if the model has no such camera, ``BadValueError`` for absurd numbers.
        """
        real = self._real(image)
        fx, fy, cx, cy = _intrinsics(self.folder, image.camera, real)
        pose = camera_to_world_opengl(image.world_to_camera)
        return Camera(pose, real.width, real.height, fx, fy, cx, cy)

    def lens(self, image: SparseImage) -> RealCamera | None:
        """What bends straight lines in a picture; None where nothing does. Raises as ``camera``."""
        real = self._real(image)
        return None if real.is_pinhole else real

    def _real(self, image: SparseImage) -> RealCamera:
        if image.camera not in self.cameras:
            raise DataMismatchError(
                f"{self.folder}: picture '{image.name}' has camera {image.camera}, which is not there",
                RUN_AGAIN,
            )
        return self.cameras[image.camera]


def other_models_in_words(model: Path) -> tuple[str, ...]:
    """What is said of the models beside the one that is read; () without any."""
    others = (
        [folder for folder in models_in(model.parent) if folder != model] if model.name.isdecimal() else []
    )
    if not others:
        return ()
    name = model.parent.name
    told = ", ".join(f"{name}/{folder.name} of {picture_count(folder)}" for folder in others)
    return (
        f"{name}/{model.name}, which has the most pictures ({picture_count(model)}), is used, and not "
        f"{told}: models of other parts of the pictures, which COLMAP could not put together",
    )


def read_model(folder: Path) -> SparseModel:
    """Read a model, binary where both forms are there; pictures sorted by name.

    Raises ``FileMissingError``, ``FileDamagedError`` (each naming the file, and the byte or line), and
    ``DataMismatchError`` if two pictures have one name.
    """
    kind = "bin" if (folder / "images.bin").exists() else "txt"
    paths = {name: folder / f"{name}.{kind}" for name in ("cameras", "images", "points3D")}
    for name in ("cameras", "images"):
        regular_file(paths[name], RUN_AGAIN)
    if kind == "bin":
        cameras, images = _cameras_bin(paths["cameras"]), _images_bin(paths["images"])
        points = _points_bin(paths["points3D"]) if paths["points3D"].exists() else None
    else:
        cameras, images = _cameras_txt(paths["cameras"]), _images_txt(paths["images"])
        points = _points_txt(paths["points3D"]) if paths["points3D"].exists() else None
    if not images:
        raise FileDamagedError(f"{paths['images']} holds no pictures", RUN_AGAIN)
    images.sort(key=lambda image: image.name)
    for one, other in pairwise(images):
        if one.name == other.name:
            raise DataMismatchError(f"{paths['images']} holds the picture '{one.name}' twice", RUN_AGAIN)
    return SparseModel(folder, cameras, images, points)


def _intrinsics(folder: Path, number: int, camera: RealCamera) -> tuple[float, float, float, float]:
    """``fx, fy, cx, cy`` in pixels; raises ``BadValueError`` where they are absurd, or there are none."""
    focal_lengths = BY_NAME[camera.model].focal_lengths
    if not focal_lengths:
        raise panorama(f"{folder}: camera {number}")
    fx, fy = camera.params[0], camera.params[focal_lengths - 1]
    cx, cy = camera.params[focal_lengths : focal_lengths + 2]
    for focal in (fx, fy):
        FOCAL_LENGTH.check(focal, f"{folder}: the focal length of camera {number}")
    for coordinate in (cx, cy):
        PRINCIPAL_POINT.check(coordinate, f"{folder}: the principal point of camera {number}")
    return fx, fy, cx, cy


# ---- what both forms share: values that mean something -------------------------------------------------


def _camera_of(path: Path, where: str, model: str, width: int, height: int, params) -> RealCamera:
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE) or not all(map(math.isfinite, params)):
        raise FileDamagedError(
            f"{path}: {where} is {width}×{height} with parameters {list(params)}", RUN_AGAIN
        )
    return RealCamera(model, width, height, tuple(params))


def _image_of(path: Path, where: str, pose, camera: int, name: str, observed: int) -> SparseImage:
    """``pose``: quaternion wxyz, then translation."""
    values = np.array(pose, dtype=np.float64)
    length = math.hypot(*values[:4])
    if not np.isfinite(values).all() or not 0.5 < length < 2.0:
        raise FileDamagedError(f"{path}: {where} ('{name}') has the pose {values.tolist()}", RUN_AGAIN)
    matrix = np.eye(4)
    matrix[:3, :3] = matrices_of(values[None, :4] / length)[0]
    matrix[:3, 3] = values[4:]
    with np.errstate(over="ignore"):
        check_position(-matrix[:3, :3].T @ values[4:], f"{path}: the camera of {where} ('{name}')")
    return SparseImage(name.replace("\\", "/"), camera, matrix, observed)


def _points_of(path: Path, positions: np.ndarray, colours: np.ndarray) -> Points | None:
    if len(positions) == 0:
        return None
    if not np.isfinite(positions).all():
        raise FileDamagedError(f"{path} holds NaN or infinity", RUN_AGAIN)
    near = are_near(path, positions)
    shades = (colours[near] / 255.0).astype(np.float32)
    left_out = int(np.count_nonzero(~near))
    return Points(positions[near].astype(np.float32), shades, STRUCTURE_FROM_MOTION, left_out=left_out)


# ---- binary --------------------------------------------------------------------------------------------


class _Bytes:
    """A little-endian file, read from its beginning to its end."""

    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        self.data = read_bytes(path, RUN_AGAIN, LARGEST_FILE)

    def damaged(self, why: str) -> NoReturn:
        raise FileDamagedError(f"{self.path} is damaged at byte {self.at}: {why}", RUN_AGAIN)

    def take(self, layout: struct.Struct) -> tuple:
        if self.at + layout.size > len(self.data):
            self.damaged("it ends too early")
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def count(self, smallest: int) -> int:
        """A number of things of at least ``smallest`` bytes each, for which the file must have room."""
        (count,) = self.take(_COUNT)
        if count * smallest > len(self.data) - self.at:
            self.at -= _COUNT.size
            self.damaged(f"it claims {count} entries, for which it is too short")
        return count

    def text(self) -> str:
        """A text that ends with a zero byte."""
        end = self.data.find(b"\0", self.at, self.at + _LONGEST_NAME)
        if end < 0:
            self.damaged("a name has no end")
        raw = self.data[self.at : end]
        try:
            text = raw.decode("utf-8")
        except UnicodeDecodeError:
            self.damaged("a name is not text")
        self.at = end + 1
        return text

    def skip(self, size: int) -> int:
        """Leave ``size`` bytes out; where they begin."""
        start, self.at = self.at, self.at + size
        return start

    def end(self) -> None:
        if self.at != len(self.data):
            self.damaged(f"{len(self.data) - self.at} bytes are left over")


_COUNT = struct.Struct("<Q")
_LONGEST_NAME = 4096
_CAMERA = struct.Struct("<iiQQ")
#: Number, quaternion wxyz, translation, camera's number.
_IMAGE = struct.Struct("<i7di")
_OBSERVATION = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<i8")])
#: Number, position, colour, error, length of the track.
_POINT = struct.Struct("<Q3d3BdQ")
_TRACK_ELEMENT = 8
#: The same as rows of a table, for points without tracks.
_POINT_ROW = np.dtype(
    [
        ("number", "<u8"),
        ("position", "<f8", 3),
        ("colour", "u1", 3),
        ("error", "<f8"),
        ("track", "<u8"),
    ]
)


def _cameras_bin(path: Path) -> dict[int, RealCamera]:
    file, cameras = _Bytes(path), {}
    for _ in range(file.count(_CAMERA.size)):
        number, model, width, height = file.take(_CAMERA)
        if model not in MODELS:
            file.damaged(f"camera {number} is of model number {model}, which is unknown")
        name, numbers, _ = MODELS[model]
        params = file.take(struct.Struct(f"<{numbers}d"))
        cameras[number] = _camera_of(path, f"camera {number}", name, width, height, params)
    file.end()
    return cameras


def _images_bin(path: Path) -> list[SparseImage]:
    file, images = _Bytes(path), []
    for _ in range(file.count(_IMAGE.size + 1 + _COUNT.size)):
        number, *pose, camera = file.take(_IMAGE)
        name = file.text()
        count = file.count(_OBSERVATION.itemsize)
        start = file.skip(count * _OBSERVATION.itemsize)
        points = np.frombuffer(file.data, _OBSERVATION, count, start)["point"]
        images.append(
            _image_of(path, f"picture {number}", pose, camera, name, int(np.count_nonzero(points >= 0)))
        )
    file.end()
    return images


def _points_bin(path: Path) -> Points | None:
    file = _Bytes(path)
    count = file.count(_POINT.size)
    positions, colours = np.empty((count, 3)), np.empty((count, 3), np.uint8)
    for i in range(count):
        _, *values, _, track = file.take(_POINT)
        positions[i], colours[i] = values[:3], values[3:]
        if track * _TRACK_ELEMENT > len(file.data) - file.at:
            file.damaged(f"a point claims a track of {track} pictures")
        file.skip(track * _TRACK_ELEMENT)
    file.end()
    return _points_of(path, positions, colours)


def write_pinholes(folder: Path, cameras: Mapping[str, Camera], points: Points | None) -> None:
    """Write a binary model of pinhole cameras by their pictures' names, numbered from 1 in that order.

    Equal lenses are one camera. Points have no tracks: nothing tells which pictures show them. Raises
    ``OutputError``.
    """
    lenses: dict[tuple[int, int, float, float, float, float], int] = {}
    images = bytearray(_COUNT.pack(len(cameras)))
    for number, (name, camera) in enumerate(cameras.items(), start=1):
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        pose = camera.world_to_camera
        which = lenses.setdefault(lens, len(lenses) + 1)
        images += _IMAGE.pack(number, *quaternions_of(pose[None, :3, :3])[0], *pose[:3, 3], which)
        images += name.encode() + b"\0" + _COUNT.pack(0)
    pinhole = next(number for number, model in MODELS.items() if model.name == "PINHOLE")
    packed = bytearray(_COUNT.pack(len(lenses)))
    for (width, height, *params), number in lenses.items():
        packed += _CAMERA.pack(number, pinhole, width, height) + struct.pack("<4d", *params)
    positions, colours = (np.zeros((0, 3)),) * 2 if points is None else (points.positions, points.colours)
    table = np.zeros(len(positions), _POINT_ROW)
    table["number"], table["error"] = np.arange(1, len(positions) + 1), 1.0
    table["position"], table["colour"] = positions, np.rint(255.0 * colours)
    files = {"cameras": packed, "images": images, "points3D": _COUNT.pack(len(table)) + table.tobytes()}
    for name, content in files.items():
        with atomic_path(folder / f"{name}.bin") as temporary:
            temporary.write_bytes(content)


# ---- text ----------------------------------------------------------------------------------------------


def _lines(path: Path) -> list[tuple[int, str]]:
    """(line number, line) of all that is no comment; empty lines stay, for a picture may have no points."""
    text = read_text(path, RUN_AGAIN, LARGEST_FILE)
    lines = [(k, line.strip()) for k, line in enumerate(text.split("\n"), start=1)]
    return [(k, line) for k, line in lines if not line.startswith("#")]


def _bad_line(path: Path, line_number: int, line: str) -> FileDamagedError:
    return FileDamagedError(f"{path}: line {line_number} means nothing: {line[:80]!r}", RUN_AGAIN)


def _cameras_txt(path: Path) -> dict[int, RealCamera]:
    cameras = {}
    for k, line in _lines(path):
        if not line:
            continue
        try:
            number, model, width, height, *params = line.split()
            values = [float(value) for value in params]
            if model not in BY_NAME or len(values) != BY_NAME[model].numbers:
                raise ValueError
            cameras[int(number)] = _camera_of(path, f"line {k}", model, int(width), int(height), values)
        except ValueError as error:
            raise _bad_line(path, k, line) from error
    return cameras


def _images_txt(path: Path) -> list[SparseImage]:
    """Two lines a picture: the pose and the name, then ``x y point`` for each observation, maybe none."""
    lines = _lines(path)
    images = []
    at = 0
    while at < len(lines):
        k, line = lines[at]
        if not line:
            at += 1
            continue
        parts = line.split(maxsplit=9)
        observations = lines[at + 1][1].split() if at + 1 < len(lines) else []
        try:
            number, *pose, camera, name = parts
            values = [float(value) for value in pose]
            if len(values) != 7 or len(observations) % 3:
                raise ValueError
            observed = sum(int(point) >= 0 for point in observations[2::3])
            images.append(_image_of(path, f"picture {int(number)}", values, int(camera), name, observed))
        except ValueError as error:
            raise _bad_line(path, k, line) from error
        at += 2
    return images


def _points_txt(path: Path) -> Points | None:
    rows = []
    for k, line in _lines(path):
        if not line:
            continue
        parts = line.split(maxsplit=7)
        try:
            rows.append([float(value) for value in parts[1:7]])
            if len(rows[-1]) != 6 or not all(0.0 <= value <= 255.0 for value in rows[-1][3:]):
                raise ValueError
        except ValueError as error:
            raise _bad_line(path, k, line) from error
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return _points_of(path, table[:, :3], table[:, 3:])
