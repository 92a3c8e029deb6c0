# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's cameras and pictures, binary and text (its documentation, "Output Format").

A file's counts are believed only as far as the file is long: nothing is allocated for a count before that.
"""

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from .affine import matrices_of
from .axes import camera_to_world_opengl
from .colmap import BY_NAME, MODELS, panorama
from .data_set import plain_name
from .errors import FileDamagedError
from .limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT, check_position
from .regular import read_bytes, read_text, regular_file

#: Bytes of a file; images.bin of ten thousand pictures with ten thousand keypoints each has 2.4e9.
LARGEST_FILE = 1 << 34
RUN_AGAIN = "Copy the model again, or run COLMAP again."

#: How many things follow; a camera: number, model, width, height; a picture: number, quaternion wxyz,
#: translation, camera's number.
COUNT, CAMERA, IMAGE = struct.Struct("<Q"), struct.Struct("<iiQQ"), struct.Struct("<i7di")
_OBSERVATION = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<i8")])
_LONGEST_NAME = 4096
#: Models whose lines are straight where their distortions are 0. Others bend lines whatever they hold.
PINHOLE_LIKE = (
    *("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"),
    *("SIMPLE_DIVISION", "DIVISION"),
)
#: A distortion below this moves no pixel of a 10000-pixel picture by more than about a hundredth.
NO_DISTORTION = 1e-6


@dataclass(frozen=True)
class SparseCamera:
    """A camera as COLMAP describes it: its model, the size of its photos and ``params``, pixels."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    def intrinsics(self, folder: Path, number: int) -> tuple[float, float, float, float]:
        """``fx, fy, cx, cy`` in pixels; raises ``BadValueError`` where they are absurd, or there are none.

        ``folder``: the model's, and ``number``: the camera's in it, for messages.
        """
        focal_lengths = BY_NAME[self.model].focal_lengths
        if not focal_lengths:
            raise panorama(f"{folder}: camera {number}")
        fx, fy = self.params[0], self.params[focal_lengths - 1]
        cx, cy = self.params[focal_lengths : focal_lengths + 2]
        for focal in (fx, fy):
            FOCAL_LENGTH.check(focal, f"{folder}: the focal length of camera {number}")
        for coordinate in (cx, cy):
            PRINCIPAL_POINT.check(coordinate, f"{folder}: the principal point of camera {number}")
        return fx, fy, cx, cy

    @property
    def is_pinhole(self) -> bool:
        """Whether straight lines are straight in its photos."""
        if self.model not in PINHOLE_LIKE:
            return False
        distortions = self.params[BY_NAME[self.model].focal_lengths + 2 :]
        return all(abs(value) <= NO_DISTORTION for value in distortions)


@dataclass(frozen=True, eq=False)
class SparseImage:
    """A registered picture: ``world_to_camera`` ``[4, 4]`` float64, OpenCV axes; ``observed``: its points."""

    name: str
    camera: int
    world_to_camera: np.ndarray
    observed: int

    @property
    def camera_to_world(self) -> np.ndarray:
        """``[4, 4]`` float64, OpenGL axes."""
        return camera_to_world_opengl(self.world_to_camera)

    @property
    def place(self) -> np.ndarray:
        """``[3]`` float64: where it was taken."""
        return self.camera_to_world[:3, 3]


def form_of(model: Path) -> str:
    """In which form a model's files are: ``bin``, also where both are there, or ``txt``."""
    return "bin" if (model / "images.bin").exists() else "txt"


def read_cameras(model: Path) -> dict[int, SparseCamera]:
    """The cameras by their numbers. Raises ``FileMissingError``, and ``FileDamagedError`` that names byte or
    line."""
    path = regular_file(model / f"cameras.{form_of(model)}", RUN_AGAIN)
    return _cameras_bin(path) if path.suffix == ".bin" else _cameras_txt(path)


def read_images(model: Path) -> list[SparseImage]:
    """Every picture that was placed, in the file's order. Raises what ``read_cameras`` raises, and
    ``BadValueError`` for a place that is too far away."""
    path = regular_file(model / f"images.{form_of(model)}", RUN_AGAIN)
    return _images_bin(path) if path.suffix == ".bin" else _images_txt(path)


# ---- what both forms share: values that mean something -------------------------------------------------


def _camera_of(path: Path, where: str, model: str, width: int, height: int, params) -> SparseCamera:
    if not (0 < width <= LARGEST_SIDE and 0 < height <= LARGEST_SIDE) or not all(map(math.isfinite, params)):
        raise FileDamagedError(
            f"{path}: {where} is {width}×{height} with parameters {list(params)}", RUN_AGAIN
        )
    return SparseCamera(model, width, height, tuple(params))


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
    return SparseImage(plain_name(name), camera, matrix, observed)


# ---- binary --------------------------------------------------------------------------------------------


class BinaryFile:
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
        (count,) = self.take(COUNT)
        if count * smallest > len(self.data) - self.at:
            self.at -= COUNT.size
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


def _cameras_bin(path: Path) -> dict[int, SparseCamera]:
    file, cameras = BinaryFile(path), {}
    for _ in range(file.count(CAMERA.size)):
        number, model, width, height = file.take(CAMERA)
        if model not in MODELS:
            file.damaged(f"camera {number} is of model number {model}, which is unknown")
        name, numbers, _ = MODELS[model]
        params = file.take(struct.Struct(f"<{numbers}d"))
        cameras[number] = _camera_of(path, f"camera {number}", name, width, height, params)
    file.end()
    return cameras


def _images_bin(path: Path) -> list[SparseImage]:
    file, images = BinaryFile(path), []
    for _ in range(file.count(IMAGE.size + 1 + COUNT.size)):
        number, *pose, camera = file.take(IMAGE)
        name = file.text()
        count = file.count(_OBSERVATION.itemsize)
        start = file.skip(count * _OBSERVATION.itemsize)
        points = np.frombuffer(file.data, _OBSERVATION, count, start)["point"]
        images.append(
            _image_of(path, f"picture {number}", pose, camera, name, int(np.count_nonzero(points >= 0)))
        )
    file.end()
    return images


# ---- text ----------------------------------------------------------------------------------------------


def lines_in(path: Path) -> list[tuple[int, str]]:
    """(line number, line) of all that is no comment; empty lines stay: a picture may have no points."""
    text = read_text(path, RUN_AGAIN, LARGEST_FILE)
    lines = [(k, line.strip()) for k, line in enumerate(text.split("\n"), start=1)]
    return [(k, line) for k, line in lines if not line.startswith("#")]


def bad_line(path: Path, line_number: int, line: str) -> FileDamagedError:
    """The error for a line that cannot be read."""
    return FileDamagedError(f"{path}: line {line_number} means nothing: {line[:80]!r}", RUN_AGAIN)


def _cameras_txt(path: Path) -> dict[int, SparseCamera]:
    cameras = {}
    for k, line in lines_in(path):
        if not line:
            continue
        try:
            number, model, width, height, *params = line.split()
            values = [float(value) for value in params]
            if model not in BY_NAME or len(values) != BY_NAME[model].numbers:
                raise ValueError
            cameras[int(number)] = _camera_of(path, f"line {k}", model, int(width), int(height), values)
        except ValueError as error:
            raise bad_line(path, k, line) from error
    return cameras


def _images_txt(path: Path) -> list[SparseImage]:
    """Two lines a picture: the pose and the name, then ``x y point`` for each observation, maybe none."""
    lines = lines_in(path)
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
            raise bad_line(path, k, line) from error
        at += 2
    return images
