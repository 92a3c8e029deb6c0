# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader of HDR-NeRF-Real's layout, which is LLFF's with exposures (https://github.com/xhuangcv/hdr-nerf,
https://github.com/Fyusion/LLFF).

``input_images/<pose>_<k>.jpg`` and ``poses_bounds_exps.npy`` with a row of 18 numbers a picture, in the order
of names: a 3×5 matrix (LLFF's axes, position, then height, width, focal length), nearest and farthest depth,
exposure in seconds. Where ``sparse/0`` is there too, as HDR-GS adds it, its cameras and points are used.
"""

import re
from pathlib import Path

import numpy as np

from ...bridge.colmap import find_model
from ...bridge.data_set import scene_name
from ...bridge.errors import DataMismatchError
from ...bridge.layouts import HDR_NERF_REAL
from ...bridge.layouts.llff import PICTURES, POSES_FILE, middle_row, picture_names, pinhole_of, read_rows
from .camera import Camera
from .colmap_model import other_model_messages, read_model
from .info import read_anchor, read_info
from .poses import PictureFile, Pose, Views, check_numbers, fitted, missing_message, one_size
from .resize import Reduction
from .scene import Points, Scene

#: The reduction of HDR-NeRF: 3216×2136 to 804×534.
PUBLISHED_FACTOR = 4.0


def read_scene(root: Path, downscale: float | None = None) -> Scene:
    """Read a data set folder.

    Even poses are for training, odd ones for testing. ``downscale``: None is 4. Pictures that somebody has
    reduced already (``input_images_4/*.png``, as HDR-NeRF does by ImageMagick) are used where they are there.
    Raises ``FileMissingError``, ``FileDamagedError``, ``DataMismatchError`` or ``BadValueError``, each
    naming the file, the entry and the remedy.
    """
    factor = PUBLISHED_FACTOR if downscale is None else downscale
    reduction = Reduction(factor)
    ready = root / f"{PICTURES}_{factor:g}"
    folder = ready if factor > 1.0 and ready.is_dir() else root / PICTURES
    if folder is ready:
        reduction = Reduction()
    names = picture_names(folder)
    rows = read_rows(root / POSES_FILE, folder, names)
    size = one_size([folder / name for name in names.values()])
    poses, bracket_messages = _poses(root / POSES_FILE, names, rows, folder, size)
    check_numbers(poses, "all", folder)
    if all(pose.index % 2 for pose in poses):
        raise DataMismatchError(
            f"{folder} has no pose for training: those are the even ones, and it has {poses[0].name} …",
            "Copy the even poses too, 000_0.jpg and so on.",
        )
    model_folder, points, model_messages = find_model(root), None, ()
    if model_folder is not None:
        poses, points, model_messages = _with_model(model_folder, poses, size)

    info = read_info(root)
    made = Views(root, poses, reduction)
    views = made.of(poses)
    messages = [
        "split as HDR-NeRF: even poses are for training, odd ones for testing",
        f"pictures from {folder.name}/; {made.messages[0]}",
        *made.messages[1:],
        f"exposures from {POSES_FILE}",
        missing_message(poses),
        *bracket_messages,
        *model_messages,
    ]
    return Scene(
        root=root,
        name=scene_name(root, info),
        train=[view for view in views if view.index % 2 == 0],
        test=[view for view in views if view.index % 2 == 1],
        lit=[],
        points=points,
        response_anchor=read_anchor(root, info, otherwise=None),
        info=info,
        layout=HDR_NERF_REAL.name,
        messages=tuple(message for message in messages if message),
    )


def _poses(
    path: Path, names: dict[tuple[int, int], str], rows: np.ndarray, folder: Path, size: tuple[int, int]
) -> tuple[list[Pose], list[str]]:
    """The poses, each with the camera of its bracket's middle picture; messages."""
    order = {key: row for row, key in enumerate(names)}
    poses = []
    farthest = 0.0
    for number in dict.fromkeys(pose for pose, _ in names):
        places = [k for pose, k in names if pose == number]
        stated = pinhole_of(path, number, middle_row(names, rows, number))
        camera = fitted(Camera(*stated), size, path, folder / names[number, places[0]])
        pictures = {
            k: PictureFile(folder / names[number, k], float(rows[order[number, k], 17]))
            for k in sorted(places)
        }
        for k in places:
            other = rows[order[number, k], :15].reshape(3, 5)[:, 3]
            farthest = max(farthest, float(np.linalg.norm(other - camera.position)))
        poses.append(Pose(f"{number:03d}", number, camera, pictures))
    if farthest > 0.0:
        message = (
            f"cameras of one bracket are up to {farthest:.2g} units apart: each view takes the middle one"
        )
        return poses, [message]
    return poses, []


def _with_model(
    folder: Path, poses: list[Pose], size: tuple[int, int]
) -> tuple[list[Pose], Points | None, tuple[str, ...]]:
    """The poses with COLMAP's cameras; those that it lacks are ignored and named."""
    model = read_model(folder)
    cameras = {}
    for image in model.images:
        digits = re.match(r"(\d+)_\d\.", Path(image.name).name)
        if digits is not None:
            cameras.setdefault(int(digits.group(1)), (model.camera(image), model.lens(image)))
    found = [pose for pose in poses if pose.index in cameras]
    if not any(pose.index % 2 == 0 for pose in found):
        raise DataMismatchError(
            f"{folder} has no picture of a training pose (it has {model.images[0].name} …)",
            f"It must name pictures as {PICTURES}/ does, 000_0.jpg; or remove sparse/ to use {POSES_FILE}.",
        )
    placed = []
    for pose in found:
        camera, lens = cameras[pose.index]
        lens = None if lens is None else lens.resized(*size)
        camera = fitted(camera, size, folder, next(iter(pose.pictures.values())).path)
        placed.append(Pose(pose.name, pose.index, camera, pose.pictures, lens=lens))
    message = (
        f"cameras and points from {folder.relative_to(folder.parents[1]).as_posix()}, as HDR-GS has them"
    )
    lost = ", ".join(pose.name for pose in poses if pose.index not in cameras)
    return (
        placed,
        model.points,
        (
            message,
            *other_model_messages(folder),
            *([f"ignoring poses that it lacks: {lost}"] if lost else []),
        ),
    )
