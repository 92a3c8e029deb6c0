# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of nerfstudio's ``transforms.json``: pinhole cameras, one exposure a view.

Poses are camera to world with OpenGL axes, kept as they are; intrinsics stand once or in each frame.
Source: nerfstudio's documentation, "Data conventions".
"""

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...bridge.data_set import plain_name, scene_name
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT
from .camera import Camera
from .checks import MAKE_AGAIN, exposure, number, path_inside, read_json, require, rigid_pose
from .exposures import exposures_from_exif
from .info import read_anchor, read_info
from .pictures import picture_size
from .points import read_points
from .poses import PictureFile, Pose, check_numbers, numbered, one_size, split_somehow
from .resize import WIDEST, Reduction
from .scene import PictureCache, Points, Scene

NAME = "nerfstudio"
LOOKS_FOR = "transforms.json"
#: What a ``file_path`` may lack.
SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".JPG", ".PNG")
#: Camera models that are pinholes where their distortion is 0.
PINHOLE_LIKE = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV")
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
#: As for COLMAP's models: moves no pixel of a large picture by more than about a hundredth.
NO_DISTORTION = 1e-6

UNDISTORT = "Undistort the pictures first, for example by 'physhdr prepare' from the original photographs."


def is_mine(root: Path) -> bool:
    """Whether ``root`` looks like this layout."""
    return (root / LOOKS_FOR).exists()


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder.

    ``downscale``: None halves pictures until no side is longer than 1600, as nerfstudio does. Raises
    ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``, each naming the
    file, the entry and the remedy.
    """
    path = root / LOOKS_FOR
    content = read_json(path)
    frames = _frames(root, path, content)
    size = one_size([file for file, _ in frames])
    seconds, told = _exposures(path, frames)
    poses = []
    for order, (file, frame) in enumerate(frames):
        name = file.relative_to(root).as_posix().rsplit(".", 1)[0]
        camera = _camera(path, f"frame '{name:.80}'", content | frame, file)
        poses.append(Pose(name, order, camera, {0: PictureFile(file, seconds[order])}))
    train, test, rule = _split(root, path, content, numbered(root, poses))
    check_numbers(train, "training", path)
    check_numbers(test, "test", path)
    reduction = Reduction(_published_factor(*size) if downscale is None else downscale)
    cache = PictureCache(reduction=reduction)
    info = read_info(root)
    return Scene(
        root=root,
        name=scene_name(root, info),
        train=[pose.view(reduction, cache) for pose in train],
        test=[pose.view(reduction, cache) for pose in test],
        lit=[],
        points=_points(root, path, content),
        response_anchor=read_anchor(root, info, otherwise=None),
        info=info,
        layout=NAME,
        messages=(rule, reduction.in_words(*size), told),
    )


def _published_factor(width: int, height: int) -> float:
    factor = 1.0
    while max(width, height) / factor > WIDEST:
        factor *= 2.0
    return factor


def _frames(root: Path, path: Path, content: dict[str, Any]) -> list[tuple[Path, dict[str, Any]]]:
    """Each frame's picture and what the file says of it, sorted by the picture's name."""
    entries = require(path, content, "frames")
    if not isinstance(entries, list) or not entries:
        raise FileDamagedError(f"{path}: 'frames' must be a list with at least one frame", MAKE_AGAIN)
    frames: dict[Path, dict[str, Any]] = {}
    for order, entry in enumerate(entries):
        if not isinstance(entry, dict):
            raise FileDamagedError(
                f"{path}: frame {order} is a {type(entry).__name__}, not an object", MAKE_AGAIN
            )
        name = require(path, entry, "file_path", f": frame {order}")
        if not isinstance(name, str):
            raise FileDamagedError(
                f"{path}: frame {order}: 'file_path' is {name!r:.80}, not a text", MAKE_AGAIN
            )
        file = _picture(root, path, name)
        if file in frames:
            raise DataMismatchError(
                f"{path}: two frames have the picture '{name:.80}'", "Remove one of them."
            )
        frames[file] = entry
    return sorted(frames.items())


def _picture(root: Path, path: Path, name: str) -> Path:
    """A frame's picture, whose suffix may have been left out."""
    file = path_inside(root, name, path)
    candidates = (file.with_name(file.name + suffix) for suffix in SUFFIXES)
    # Path.is_file raises where a name is too long; the reader of pictures then says so.
    return next((candidate for candidate in candidates if os.path.isfile(candidate)), file)


def _camera(path: Path, where: str, given: dict[str, Any], file: Path) -> Camera:
    """The camera of a frame at the size of its picture; ``given``: the frame's entries over the file's."""
    model = given.get("camera_model", "OPENCV")
    if model not in PINHOLE_LIKE or given.get("is_fisheye"):
        raise BadValueError(
            f"{path}: {where} has the camera model {model!r:.80}, which is no pinhole", UNDISTORT
        )
    for key in DISTORTION:
        if abs(number(path, given.get(key, 0.0), f"{where}: '{key}'")) > NO_DISTORTION:
            raise BadValueError(
                f"{path}: {where} has the distortion {key} = {given[key]:g}: pictures of it are bent",
                UNDISTORT,
            )
    pose = rigid_pose(path, require(path, given, "transform_matrix", f": {where}"), where)
    actual = picture_size(file)
    size = [number(path, given.get(key, actual[k]), f"{where}: '{key}'") for k, key in enumerate("wh")]
    width, height = (round(min(max(value, 0.0), 2.0 * LARGEST_SIDE)) for value in size)
    sides = range(1, LARGEST_SIDE + 1)
    if (
        width not in sides
        or height not in sides
        or abs(height * actual[0] - actual[1] * width) > max(width, actual[0])
    ):
        raise DataMismatchError(
            f"{path}: {where} is said to be {width}×{height}, {file} is {actual[0]}×{actual[1]}: another "
            "shape",
            "Use the pictures that the cameras were found with, neither cropped nor turned.",
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
    camera = Camera(pose, width, height, fx, fy, cx, cy)
    return camera if (width, height) == actual else camera.resized(*actual)


def _focal(path: Path, where: str, given: dict[str, Any], axis: str, side: int) -> float | None:
    """A focal length in pixels, from itself or the field of view; None where the file has neither."""
    if f"fl_{axis}" in given:
        focal = number(path, given[f"fl_{axis}"], f"{where}: 'fl_{axis}'")
        return FOCAL_LENGTH.check(focal, f"{path}: {where}: 'fl_{axis}'")
    if f"camera_angle_{axis}" not in given:
        return None
    angle = number(path, given[f"camera_angle_{axis}"], f"{where}: 'camera_angle_{axis}'")
    if not 0.0 < angle < math.pi:
        raise BadValueError(
            f"{path}: {where}: 'camera_angle_{axis}' is {angle:g}", "Mend it: radians, between 0 and π."
        )
    focal = 0.5 * side / math.tan(0.5 * angle)
    return FOCAL_LENGTH.check(
        focal, f"{path}: {where}: the focal length of 'camera_angle_{axis}' = {angle:g}"
    )


def _exposures(path: Path, frames: Sequence[tuple[Path, dict[str, Any]]]) -> tuple[list[float], str]:
    """Seconds for each frame, and where they are from: ``exposure_time``, EXIF, or 1 s for all."""
    known = ["exposure_time" in frame for _, frame in frames]
    if any(known):
        if not all(known):
            raise DataMismatchError(
                f"{path}: frame '{frames[known.index(False)][0].name}' has no 'exposure_time', others have",
                "Give each frame one, or none.",
            )
        seconds = [exposure(path, frame["exposure_time"], file.name) for file, frame in frames]
        return seconds, f"exposures from 'exposure_time' in {LOOKS_FOR}"
    from_exif = exposures_from_exif([file for file, _ in frames])
    if from_exif is not None:
        return from_exif
    return [1.0] * len(frames), "no exposures are known: taken as one exposure of 1 s for all pictures"


def _split(
    root: Path, path: Path, content: dict[str, Any], poses: list[Pose]
) -> tuple[list[Pose], list[Pose], str]:
    """As ``train_filenames`` and ``test_filenames`` (or ``val_filenames``) say, else by name or order."""
    lists = {}
    for key in ("train_filenames", "val_filenames", "test_filenames"):
        names = content.get(key)
        if names is None:
            continue
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise BadValueError(f"{path}: '{key}' is no list of file names", "Mend it, or remove it.")
        lists[key] = {_picture(root, path, plain_name(name)) for name in names}
    if "train_filenames" not in lists:
        return split_somehow(poses)
    other = "test_filenames" if lists.get("test_filenames") else "val_filenames"
    train = [pose for pose in poses if pose.pictures[0].path in lists["train_filenames"]]
    test = [pose for pose in poses if pose.pictures[0].path in lists.get(other, set())]
    if not train:
        raise DataMismatchError(f"{path}: no frame is in 'train_filenames'", "Mend that list, or remove it.")
    both = {pose.name for pose in train} & {pose.name for pose in test}
    if both:
        raise DataMismatchError(
            f"{path}: '{min(both)}' is in 'train_filenames' and in '{other}'", "Remove it from one of them."
        )
    rest = len(poses) - len(train) - len(test)
    rule = f"split as train_filenames and {other} say" + (f"; {rest} frames are in neither" if rest else "")
    return train, test, rule


def _points(root: Path, path: Path, content: dict[str, Any]) -> Points | None:
    name = content.get("ply_file_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise BadValueError(f"{path}: 'ply_file_path' is {name!r:.80}, not a text", "Mend it, or remove it.")
    return read_points(path_inside(root, name, path))
