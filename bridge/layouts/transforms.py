# SPDX-License-Identifier: GPL-3.0-or-later
"""``transforms.json`` and its kin: frames, where their pictures are, and the cameras that they state.

Poses are camera to world with OpenGL axes; intrinsics stand once or in each frame, with a lens's distortion
as OpenCV numbers it. Sources: nerfstudio's documentation, "Data conventions"; instant-ngp's "Tips for
training NeRF models".
"""

import math
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import data_set
from ..colmap import ALL_AROUND, panorama
from ..colmap_files import NO_DISTORTION, SparseCamera
from ..data_set import plain_name
from ..errors import BadValueError, DataMismatchError, FileDamagedError
from ..limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT, is_number
from .checks import MAKE_AGAIN, number, path_inside, require, rigid_pose
from .picture_files import SUFFIXES, picture_there, reduced_folder

TRANSFORMS_FILE = "transforms.json"
#: The lists of pictures by the split that they are. That of validation comes last: it is left out where it
#: repeats another.
SPLIT_LISTS = {
    data_set.TRAIN: "train_filenames",
    data_set.TEST: "test_filenames",
    data_set.VALIDATION: "val_filenames",
}
#: Suffixes that a ``file_path`` may lack.
LACKING = ("", *SUFFIXES, *(suffix.upper() for suffix in SUFFIXES))
#: Where HDR-NeRF-Syn's files state all of these, intrinsics in pixels count. HDR-NeRF reads only
#: ``camera_angle_x``: what stands beside it may be left from other pictures, and pixels mean nothing without
#: the size of their picture.
IN_PIXELS = ("w", "h", "fl_x")
#: Camera models of straight lines, or lines bent by OpenCV's k and p; each may have any of these.
PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "PERSPECTIVE")
#: Models by the angle from the axis, with k1 to k4.
FISHEYE = ("OPENCV_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
#: The numbers of each of COLMAP's models after focal lengths and principal point, as this format names them.
OPENCV = ("k1", "k2", "p1", "p2")
FULL_OPENCV = (*OPENCV, "k3", "k4", "k5", "k6")
OPENCV_FISHEYE = ("k1", "k2", "k3", "k4")

OTHER_MODELS = (
    f"This format supports {', '.join((*PERSPECTIVE, *FISHEYE))}; a COLMAP folder (images/ and sparse/0) may "
    "have any of its models."
)


class Pinhole(NamedTuple):
    """A camera: ``[4, 4]`` float64, rigid, looks down −Z, +Y up; its picture's size and intrinsics in pixels.

    The centre of the top left pixel is at (0.5, 0.5).
    """

    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


def frames_of(path: Path, content: dict[str, Any], fewest: int = 1) -> list[tuple[str, dict[str, Any]]]:
    """Each frame's ``file_path`` and its entry, in the file's order.

    Raises ``FileDamagedError`` that names the frame, or where there are less than ``fewest``.
    """
    entries = require(path, content, "frames")
    if not isinstance(entries, list) or len(entries) < fewest:
        raise FileDamagedError(f"{path}: 'frames' must be a list with at least one frame", MAKE_AGAIN)
    frames = []
    for order, entry in enumerate(entries):
        where = f"{path}: frame {order}"
        if not isinstance(entry, dict):
            raise FileDamagedError(f"{where} is not an object: {entry!r:.80}", MAKE_AGAIN)
        name = require(path, entry, "file_path", f": frame {order}")
        if not isinstance(name, str):
            raise FileDamagedError(f"{where}: 'file_path' is {name!r:.80}, not a text", MAKE_AGAIN)
        frames.append((name, entry))
    return frames


# ---- pictures ------------------------------------------------------------------------------------------


def file_inside(root: Path, path: Path, name: str) -> Path:
    """A file that the data set names. Programs write absolute paths and ``..``, too: where these end in it.

    Raises ``BadValueError`` where they end elsewhere: only what lies in the data set's folder is opened.
    """
    whole = os.path.normpath(os.path.join(os.path.abspath(root), plain_name(name)))
    behind_links = os.path.join(os.path.realpath(os.path.dirname(whole)), os.path.basename(whole))
    real = os.path.realpath(root)
    for file, base in ((whole, os.path.abspath(root)), (whole, real), (behind_links, real)):
        if os.path.normcase(file).startswith(os.path.normcase(os.path.join(base, ""))):
            name = os.path.relpath(file, base)
            break
    try:
        return path_inside(root, name, path)
    except BadValueError as error:
        raise BadValueError(
            error.message,
            f"Move {path.name} to a folder that holds that file, too, and name it from there, without '..'.",
        ) from error


def picture_of(root: Path, path: Path, name: str) -> Path:
    """A frame's picture, whose suffix may be missing or in other case: .JPG for .jpg.

    Where its folder is missing, the one in the folder of reduced pictures: ``images_4`` for ``images``.
    """
    file = file_inside(root, path, name)
    folder, *rest = file.relative_to(root).parts
    reduced = reduced_folder(root / folder) if rest else None
    place = reduced[0].joinpath(*rest) if reduced else file
    candidates = (place.with_name(place.name + suffix) for suffix in LACKING)
    # Path.is_file raises where a name is too long; the reader of pictures then says so.
    found = next((candidate for candidate in candidates if os.path.isfile(candidate)), picture_there(place))
    return found if os.path.isfile(found) else file


def reduction_of(root: Path, path: Path, name: str) -> tuple[dict[str, str], int]:
    """Where a frame's picture is a reduced one: the named folder and theirs, and how many times smaller."""
    folder, *rest = file_inside(root, path, name).relative_to(root).parts
    found = reduced_folder(root / folder) if rest else None
    return ({folder: found[0].name}, found[1]) if found else ({}, 1)


# ---- cameras -------------------------------------------------------------------------------------------


def stated_camera(path: Path, where: str, given: dict[str, Any], stored: tuple[int, int]) -> Pinhole:
    """The camera of a frame at the size that is stated; ``given``: the frame's entries over the file's.

    ``stored``: the picture's size as it was when the cameras were found, where none is stated. Raises
    ``FileDamagedError``, ``DataMismatchError`` and ``BadValueError`` with ``path``, ``where`` and the entry.
    """
    matrix = require(path, given, "transform_matrix", f": {where}")
    pose = rigid_pose(path, matrix, where.removeprefix("frame "))
    size = [number(path, given.get(key, stored[k]), f"{where}: '{key}'") for k, key in enumerate("wh")]
    width, height = (round(min(max(value, 0.0), 2.0 * LARGEST_SIDE)) for value in size)
    sides = range(1, LARGEST_SIDE + 1)
    if width not in sides or height not in sides:
        raise DataMismatchError(
            f"{path}: {where} is said to be {size[0]:g}×{size[1]:g} pixels",
            "Fix 'w' and 'h', or remove them.",
        )
    fx = _focal(path, where, given, "x", width)
    fy = _focal(path, where, given, "y", height) or fx
    fx = fx or fy
    if fx is None or fy is None:
        raise FileDamagedError(
            f"{path}: {where} has no focal length", "Add fl_x (pixels) or camera_angle_x (radians)."
        )
    cx, cy = (
        PRINCIPAL_POINT.check(
            number(path, given.get(key, 0.5 * side), f"{where}: '{key}'"), f"{path}: {where}: '{key}'"
        )
        for key, side in (("cx", width), ("cy", height))
    )
    return Pinhole(pose, width, height, fx, fy, cx, cy)


def stated_lens(path: Path, where: str, given: dict[str, Any], camera: Pinhole) -> SparseCamera | None:
    """What bends straight lines in a frame's picture; None where nothing does.

    Raises ``BadValueError`` for a model that this format has no numbers for, and for a lone k4: OpenCV
    divides by what it is a part of, nerfstudio multiplies.
    """
    model = given.get("camera_model", "OPENCV")
    if model == ALL_AROUND:
        raise panorama(f"{path}: {where}")
    fisheye = bool(given.get("is_fisheye")) or model in FISHEYE
    if not fisheye and model not in PERSPECTIVE:
        raise BadValueError(f"{path}: {where} has the camera model {model!r:.80}", OTHER_MODELS)
    values = {
        key: number(path, given.get(key, 0.0), f"{where}: '{key}'") for key in (*FULL_OPENCV, *OPENCV_FISHEYE)
    }
    bends = {key for key, value in values.items() if abs(value) > NO_DISTORTION}
    if fisheye:
        kind, names = "OPENCV_FISHEYE", OPENCV_FISHEYE
    elif bends <= set(OPENCV):
        kind, names = "OPENCV", OPENCV
    else:
        kind, names = "FULL_OPENCV", FULL_OPENCV
        if "k4" in bends and model != "FULL_OPENCV" and not {"k5", "k6"} & set(given):
            raise BadValueError(
                f"{path}: {where} has the distortion k4 = {values['k4']:g} without k5 and k6: programs "
                "differ in what it means",
                "Write k5 and k6 (0) beside it where it is OpenCV's; else undistort the pictures first.",
            )
    focal_lengths_and_middle = (camera.fx, camera.fy, camera.cx, camera.cy)
    params = (*focal_lengths_and_middle, *(values[name] for name in names))
    real = SparseCamera(kind, camera.width, camera.height, params)
    return None if real.is_pinhole else real


def _focal(path: Path, where: str, given: dict[str, Any], axis: str, side: int) -> float | None:
    """A focal length in pixels, from itself or the field of view; None where the file has neither."""
    if f"fl_{axis}" in given:
        focal = number(path, given[f"fl_{axis}"], f"{where}: 'fl_{axis}'")
        return FOCAL_LENGTH.check(focal, f"{path}: {where}: 'fl_{axis}'")
    if f"camera_angle_{axis}" not in given:
        return None
    angle = number(path, given[f"camera_angle_{axis}"], f"{where}: 'camera_angle_{axis}'")
    if not (0.0 < angle < math.pi and math.tan(0.5 * angle) > 0.0):  # the least numbers halve to 0
        raise BadValueError(
            f"{path}: {where}: 'camera_angle_{axis}' is {angle:g}", "Fix it: radians, between 0 and π."
        )
    focal = 0.5 * side / math.tan(0.5 * angle)
    return FOCAL_LENGTH.check(
        focal, f"{path}: {where}: the focal length of 'camera_angle_{axis}' = {angle:g}"
    )


def own_camera(
    path: Path, where: str, given: dict[str, Any], stored: tuple[int, int]
) -> tuple[Pinhole, SparseCamera | None]:
    """The camera of a frame of HDR-NeRF-Syn's files, and its lens where that bends straight lines.

    With all of ``IN_PIXELS``, as in ``transforms.json``. Else ``camera_angle_x`` is the width's, and the
    principal point is the middle of the picture ``stored``, whatever else is stated.
    """
    stated = {key: value for key, value in given.items() if value is not None}
    if not all(is_number(stated.get(key)) for key in IN_PIXELS):
        alone = {key: given[key] for key in ("camera_angle_x", "transform_matrix") if key in given}
        return stated_camera(path, where, alone, stored), None
    camera = stated_camera(path, where, stated, stored)
    return camera, stated_lens(path, where, stated, camera)
