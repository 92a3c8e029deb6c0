# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of ``transforms.json``, nerfstudio's and instant-ngp's: a frame is a view at one exposure.

Frames of one camera that are named ``<pose>_<k>`` and have an ``exposure_time`` each, no two the same, are
the bracket of one view.

Poses are camera to world with OpenGL axes, kept as they are; intrinsics stand once or in each frame, with a
lens's distortion as OpenCV numbers it. Sources: nerfstudio's documentation, "Data conventions"; instant-ngp's
"Tips for training NeRF models".
"""

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge.colmap import ALL_AROUND, panorama
from ...bridge.colmap_files import NO_DISTORTION
from ...bridge.data_set import plain_name, scene_name
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError
from ...bridge.limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT
from ...bridge.regular import regular_file
from .camera import Camera
from .checks import MAKE_AGAIN, exposure, number, path_inside, read_json, require, rigid_pose
from .exposures import exposures_from_exif
from .info import read_anchor, read_info
from .lens import RealCamera
from .picture_files import picture_there, reduced_folder
from .points import read_points
from .poses import (
    SUFFIXES,
    PictureFile,
    Pose,
    Views,
    at_size_of_pictures,
    bracket_name,
    check_numbers,
    masks_in_words,
    numbered,
    sizes_of,
    skipped_in_words,
    split_somehow,
)
from .resize import WIDEST, Reduction
from .scene import Points, Scene

NAME = "nerfstudio"
LOOKS_FOR = "transforms.json"
#: What a ``file_path`` may lack.
LACKING = ("", *SUFFIXES, *(suffix.upper() for suffix in SUFFIXES))
#: Camera models of straight lines, or lines bent by OpenCV's k and p; each may have any of these.
PERSPECTIVE = ("PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "PERSPECTIVE")
#: Models by the angle from the axis, with k1 to k4.
FISHEYE = ("OPENCV_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
#: The numbers of each of COLMAP's models after focal lengths and principal point, as this format names them.
OPENCV = ("k1", "k2", "p1", "p2")
FULL_OPENCV = (*OPENCV, "k3", "k4", "k5", "k6")
OPENCV_FISHEYE = ("k1", "k2", "k3", "k4")

#: What to do where only some pictures tell their exposure.
SAY_EXPOSURES = (
    f"Give each frame in {LOOKS_FOR} an 'exposure_time' in seconds; or use pictures that still have the "
    "camera's EXIF data, or none of it."
)
OTHER_MODELS = (
    f"Of this format {', '.join((*PERSPECTIVE, *FISHEYE))} are read; a folder of COLMAP's (images/ and "
    "sparse/0) may have any of its models."
)


def is_mine(root: Path) -> bool:
    """Whether ``root`` looks like this layout."""
    return (root / LOOKS_FOR).exists()


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder.

    ``downscale``: None halves pictures until no side of the largest is longer than 1600, as nerfstudio does.
    Frames without a picture are left out and counted. Raises ``FileMissingError``, ``FileDamagedError``,
    ``DataMismatchError`` or ``BadValueError``, each naming the file, the entry and the remedy.
    """
    path = root / LOOKS_FOR
    return scene_of(root, path, read_json(path), downscale)


def scene_of(root: Path, path: Path, content: dict[str, Any], downscale: float | None) -> Scene:
    """As ``read_scene``, of what ``path`` holds; the first of the scene's messages tells its split."""
    listed = _frames(root, path, content)
    sizes, faults = sizes_of(file for file, _ in listed)
    skipped = skipped_in_words("frames", len(listed), faults, root, len(sizes) / len(listed))
    # Each keeps its place among all that are listed: a picture that turns up changes nobody's number.
    frames = {order: frame for order, frame in enumerate(listed) if frame[0] in sizes}
    seconds, told = _exposures(path, list(frames.values()))
    reduced = {}
    poses = []
    for (order, (file, frame)), time in zip(frames.items(), seconds, strict=True):
        if time is None:
            continue
        name = file.relative_to(root).as_posix().rsplit(".", 1)[0]
        where = f"frame '{name:.80}'"
        given = content | frame
        instead, factor = _reduced(root, path, frame["file_path"])
        reduced |= instead
        camera = stated_camera(path, where, given, (factor * sizes[file][0], factor * sizes[file][1]))
        mask = _mask(root, path, where, frame)
        pictures = {0: PictureFile(file, time, mask)}
        pose = Pose(name, order, camera, pictures, lens=stated_lens(path, where, given, camera))
        poses.append(at_size_of_pictures(pose, sizes, path))
    if all("exposure_time" in frame for _, frame in frames.values()):
        poses = _bracketed(poses)
    train, validation, test, rule = _split(root, path, content, numbered(root, poses))
    check_numbers(train, "training", path)
    check_numbers(validation, "validation", path)
    check_numbers(test, "test", path)
    longest = max(max(pose.camera.width, pose.camera.height) for pose in poses)
    reduction = Reduction(_published_factor(longest) if downscale is None else downscale)
    views = Views(root, poses, reduction)
    small = (f"pictures from {there}/, for there is no {folder}/" for folder, there in reduced.items())
    info = read_info(root)
    return Scene(
        root=root,
        name=scene_name(root, info),
        train=views.of(train),
        test=views.of(test),
        lit=[],
        points=_points(root, path, content),
        response_anchor=read_anchor(root, info, otherwise=None),
        info=info,
        layout=NAME,
        messages=(rule, *skipped, *small, *views.messages, told, *masks_in_words(poses)),
        validation=views.of(validation),
    )


def _published_factor(longest: int) -> float:
    factor = 1.0
    while longest / factor > WIDEST:
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


def _inside(root: Path, path: Path, name: str) -> Path:
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


def _picture(root: Path, path: Path, name: str) -> Path:
    """A frame's picture, whose suffix may have been left out, or be written otherwise: .JPG for .jpg.

    Where its folder is not there, the one in the folder of reduced ones: ``images_4`` for ``images``.
    """
    file = _inside(root, path, name)
    folder, *rest = file.relative_to(root).parts
    reduced = reduced_folder(root / folder) if rest else None
    place = reduced[0].joinpath(*rest) if reduced else file
    candidates = (place.with_name(place.name + suffix) for suffix in LACKING)
    # Path.is_file raises where a name is too long; the reader of pictures then says so.
    found = next((candidate for candidate in candidates if os.path.isfile(candidate)), picture_there(place))
    return found if os.path.isfile(found) else file


def _reduced(root: Path, path: Path, name: str) -> tuple[dict[str, str], int]:
    """Where a frame's picture is one of reduced ones: the named folder and theirs, and how much smaller."""
    folder, *rest = _inside(root, path, name).relative_to(root).parts
    found = reduced_folder(root / folder) if rest else None
    return ({folder: found[0].name}, found[1]) if found else ({}, 1)


def _mask(root: Path, path: Path, where: str, frame: dict[str, Any]) -> Path | None:
    """A frame's mask; raises ``FileMissingError`` where it names one that is not there."""
    name = frame.get("mask_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise BadValueError(f"{path}: {where}: 'mask_path' is {name!r:.80}, not a text", "Fix or remove it.")
    remedy = f"Put it there, or remove 'mask_path' of {where}: then all of its picture is compared."
    return regular_file(_inside(root, path, name), remedy)


def stated_camera(path: Path, where: str, given: dict[str, Any], stored: tuple[int, int]) -> Camera:
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
    return Camera(pose, width, height, fx, fy, cx, cy)


def stated_lens(path: Path, where: str, given: dict[str, Any], camera: Camera) -> RealCamera | None:
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
    real = RealCamera(kind, camera.width, camera.height, params)
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


def _exposures(
    path: Path, frames: Sequence[tuple[Path, dict[str, Any]]]
) -> tuple[Sequence[float | None], str]:
    """Seconds for each frame, and where they are from: ``exposure_time``, EXIF, or 1 s for all.

    None: not known; the words count these.
    """
    known = ["exposure_time" in frame for _, frame in frames]
    if any(known):
        if not all(known):
            raise DataMismatchError(
                f"{path}: frame '{frames[known.index(False)][0].name}' has no 'exposure_time', others have",
                "Give each frame one, or none.",
            )
        seconds = [exposure(path, frame["exposure_time"], file.name) for file, frame in frames]
        return seconds, f"exposures from 'exposure_time' in {LOOKS_FOR}"
    from_exif = exposures_from_exif([file for file, _ in frames], SAY_EXPOSURES)
    if from_exif is not None:
        return from_exif
    return [1.0] * len(frames), "no exposures are known: taken as one exposure of 1 s for all pictures"


def _split(
    root: Path, path: Path, content: dict[str, Any], poses: list[Pose]
) -> tuple[list[Pose], list[Pose], list[Pose], str]:
    """Training, validation and test as ``train_filenames``, ``val_filenames`` and ``test_filenames`` say.

    Validation views that are trained from or are test views, which nerfstudio allows, are no such split.
    Without a list of test views those of validation are the test. Without one of training views, which
    nerfstudio refuses, all frames that no other list has are trained on; without any list, by name or order.
    """
    lists = _lists(root, path, content)
    if "train_filenames" not in lists and not any(lists.values()):
        train, test, rule = split_somehow(poses)
        return train, [], test, rule
    other = "test_filenames" if lists.get("test_filenames") else "val_filenames"
    test = [pose for pose in poses if _is_in(pose, lists.get(other, set()))]
    train = _train(path, lists, poses)
    both = {pose.name for pose in train} & {pose.name for pose in test}
    if both:
        raise DataMismatchError(
            f"{path}: '{min(both)}' is in 'train_filenames' and in '{other}'", "Remove it from one of them."
        )
    validation = []
    if other == "test_filenames":
        validation = [pose for pose in poses if _is_in(pose, lists.get("val_filenames", set()))]
        if {pose.name for pose in validation} & {pose.name for pose in (*train, *test)}:
            validation = []
    if "train_filenames" not in lists:
        told = " and ".join(key for key, names in lists.items() if names)
        rule = (
            f"split as {told} say: the other {len(train)} frames are trained on, for no list says which are"
        )
        return train, validation, test, rule
    lists_told = f"train_filenames{', val_filenames' if validation else ''} and {other}"
    rest = len(poses) - len(train) - len(validation) - len(test)
    none_of_them = "none of them" if validation else "neither"
    rule = f"split as {lists_told} say" + (f"; {rest} frames are in {none_of_them}" if rest else "")
    return train, validation, test, rule


def _lists(root: Path, path: Path, content: dict[str, Any]) -> dict[str, set[Path]]:
    """The pictures that each list of a split has; only of lists that are there."""
    lists = {}
    for key in ("train_filenames", "val_filenames", "test_filenames"):
        names = content.get(key)
        if names is None:
            continue
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise BadValueError(f"{path}: '{key}' is not a list of file names", "Fix it, or remove it.")
        lists[key] = {_picture(root, path, plain_name(name)) for name in names}
    return lists


def _train(path: Path, lists: dict[str, set[Path]], poses: list[Pose]) -> list[Pose]:
    """The training poses; raises ``DataMismatchError`` where there are none, or a lone list has no frame."""
    if "train_filenames" in lists:
        train = [pose for pose in poses if _is_in(pose, lists["train_filenames"])]
        if train:
            return train
        raise DataMismatchError(f"{path}: no frame is in 'train_filenames'", "Fix that list, or remove it.")
    for key, names in lists.items():
        if names and not any(_is_in(pose, names) for pose in poses):
            raise DataMismatchError(f"{path}: no frame is in '{key}'", "Fix that list, or remove it.")
    train = [pose for pose in poses if not any(_is_in(pose, names) for names in lists.values())]
    if not train:
        told = " and ".join(f"'{key}'" for key, names in lists.items() if names)
        raise DataMismatchError(
            f"{path}: no frame is left for training: all are in {told}",
            "Fix these lists, or remove them.",
        )
    return train


def _is_in(pose: Pose, listed: set[Path]) -> bool:
    return any(picture.path in listed for picture in pose.pictures.values())


def _bracketed(poses: Sequence[Pose]) -> list[Pose]:
    """Poses of one picture each → brackets where names, cameras and exposures say so; else as they are."""
    groups: dict[str, dict[int, Pose]] = {}
    for pose in poses:
        parts = bracket_name(pose.pictures[0].path.name)
        if parts is None:
            return list(poses)
        base = f"{pose.name.rpartition('_')[0]}"
        groups.setdefault(base, {})[parts[1]] = pose
    if sum(map(len, groups.values())) < len(poses) or not all(
        _is_bracket(list(group.values())) for group in groups.values()
    ):
        return list(poses)
    if all(len(group) == 1 for group in groups.values()):
        return list(poses)
    first = min(min(group) for group in groups.values())
    return [
        replace(
            next(iter(group.values())),
            name=name,
            pictures={k - first: group[k].pictures[0] for k in sorted(group)},
        )
        for name, group in groups.items()
    ]


def _is_bracket(poses: Sequence[Pose]) -> bool:
    """Whether pictures are of one camera, at exposures of which no two are the same."""
    first = poses[0]
    seconds = {pose.pictures[0].seconds for pose in poses}
    return len(seconds) == len(poses) and all(
        np.array_equal(pose.camera.camera_to_world, first.camera.camera_to_world)
        and _pinhole(pose.camera) == _pinhole(first.camera)
        and pose.lens == first.lens
        and pose.pictures[0].orientation == first.pictures[0].orientation
        for pose in poses[1:]
    )


def _pinhole(camera: Camera) -> tuple[float, ...]:
    return (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)


def _points(root: Path, path: Path, content: dict[str, Any]) -> Points | None:
    name = content.get("ply_file_path")
    if name is None:
        return None
    if not isinstance(name, str):
        raise BadValueError(f"{path}: 'ply_file_path' is {name!r:.80}, not a text", "Fix it, or remove it.")
    remedy = (
        f"Copy it there, or remove 'ply_file_path' from {path.name}: first points are then made by stereo."
    )
    return read_points(regular_file(_inside(root, path, name), remedy))
