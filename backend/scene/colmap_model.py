# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP's sparse models, read and written: cameras and pictures (``bridge.colmap_files``), and points."""

import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from ...bridge.affine import quaternions_of
from ...bridge.atomic import atomic_path
from ...bridge.colmap import MODELS, models_in, picture_count
from ...bridge.colmap_files import (
    CAMERA,
    COUNT,
    IMAGE,
    RUN_AGAIN,
    BinaryFile,
    SparseImage,
    bad_line,
    form_of,
    lines_in,
    read_cameras,
    read_images,
)
from ...bridge.errors import DataMismatchError, FileDamagedError
from .camera import Camera
from .lens import RealCamera
from .points import STRUCTURE_FROM_MOTION, are_near
from .scene import Points

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
        fx, fy, cx, cy = real.intrinsics(self.folder, image.camera)
        return Camera(image.camera_to_world, real.width, real.height, fx, fy, cx, cy)

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


def other_model_messages(model: Path) -> tuple[str, ...]:
    """A message on the models beside the one that is read; () without any."""
    others = (
        [folder for folder in models_in(model.parent) if folder != model] if model.name.isdecimal() else []
    )
    if not others:
        return ()
    name = model.parent.name
    names = ", ".join(f"{name}/{folder.name} of {picture_count(folder)}" for folder in others)
    return (
        f"{name}/{model.name}, which has the most pictures ({picture_count(model)}), is used, and not "
        f"{names}: models of other parts of the pictures, which COLMAP could not put together",
    )


def read_model(folder: Path) -> SparseModel:
    """Read a model, binary where both forms are there; pictures sorted by name.

    Raises ``FileMissingError``, ``FileDamagedError`` (each naming the file, and the byte or line), and
    ``DataMismatchError`` if two pictures have one name.
    """
    kind = form_of(folder)
    cameras = {number: RealCamera(**asdict(camera)) for number, camera in read_cameras(folder).items()}
    images = read_images(folder)
    path = folder / f"points3D.{kind}"
    points = (_points_bin(path) if kind == "bin" else _points_txt(path)) if path.exists() else None
    if not images:
        raise FileDamagedError(f"{folder / f'images.{kind}'} holds no pictures", RUN_AGAIN)
    images.sort(key=lambda image: image.name)
    for one, other in pairwise(images):
        if one.name == other.name:
            message = f"{folder / f'images.{kind}'} holds the picture '{one.name}' twice"
            raise DataMismatchError(message, RUN_AGAIN)
    return SparseModel(folder, cameras, images, points)


def _points_of(path: Path, positions: np.ndarray, colours: np.ndarray) -> Points | None:
    if len(positions) == 0:
        return None
    if not np.isfinite(positions).all():
        raise FileDamagedError(f"{path} holds NaN or infinity", RUN_AGAIN)
    near = are_near(path, positions)
    shades = (colours[near] / 255.0).astype(np.float32)
    ignored = int(np.count_nonzero(~near))
    return Points(positions[near].astype(np.float32), shades, STRUCTURE_FROM_MOTION, ignored=ignored)


def _points_bin(path: Path) -> Points | None:
    file = BinaryFile(path)
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


def _points_txt(path: Path) -> Points | None:
    rows = []
    for k, line in lines_in(path):
        if not line:
            continue
        parts = line.split(maxsplit=7)
        try:
            rows.append([float(value) for value in parts[1:7]])
            if len(rows[-1]) != 6 or not all(0.0 <= value <= 255.0 for value in rows[-1][3:]):
                raise ValueError
        except ValueError as error:
            raise bad_line(path, k, line) from error
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return _points_of(path, table[:, :3], table[:, 3:])


def write_pinholes(folder: Path, cameras: Mapping[str, Camera], points: Points | None) -> None:
    """Write a binary model of pinhole cameras by their pictures' names, numbered from 1 in that order.

    Equal lenses are one camera. Points have no tracks: nothing tells which pictures show them. Raises
    ``OutputError``.
    """
    lenses: dict[tuple[int, int, float, float, float, float], int] = {}
    images = bytearray(COUNT.pack(len(cameras)))
    for number, (name, camera) in enumerate(cameras.items(), start=1):
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        pose = camera.world_to_camera
        which = lenses.setdefault(lens, len(lenses) + 1)
        images += IMAGE.pack(number, *quaternions_of(pose[None, :3, :3])[0], *pose[:3, 3], which)
        images += name.encode() + b"\0" + COUNT.pack(0)
    pinhole = next(number for number, model in MODELS.items() if model.name == "PINHOLE")
    packed = bytearray(COUNT.pack(len(lenses)))
    for (width, height, *params), number in lenses.items():
        packed += CAMERA.pack(number, pinhole, width, height) + struct.pack("<4d", *params)
    positions, colours = (np.zeros((0, 3)),) * 2 if points is None else (points.positions, points.colours)
    table = np.zeros(len(positions), _POINT_ROW)
    table["number"], table["error"] = np.arange(1, len(positions) + 1), 1.0
    table["position"], table["colour"] = positions, np.rint(255.0 * colours)
    files = {"cameras": packed, "images": images, "points3D": COUNT.pack(len(table)) + table.tobytes()}
    for name, content in files.items():
        with atomic_path(folder / f"{name}.bin") as temporary:
            temporary.write_bytes(content)
