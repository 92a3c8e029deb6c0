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

from ...bridge.axes import camera_to_world_from_llff
from ...bridge.colmap import find_model
from ...bridge.data_set import scene_name
from ...bridge.errors import BadValueError, DataMismatchError, FileDamagedError, FileMissingError
from ...bridge.limits import EXPOSURE, FOCAL_LENGTH, LARGEST_SIDE, check_position
from ...bridge.regular import damaged_where_it_fails, regular_file
from .camera import Camera
from .checks import is_rotation
from .colmap_model import other_models_in_words, read_model
from .info import read_anchor, read_info
from .poses import PictureFile, Pose, Views, bracket_name, check_numbers, fitted, missing_in_words, one_size
from .resize import Reduction
from .scene import Points, Scene

NAME = "HDR-NeRF-Real"
LOOKS_FOR = "poses_bounds_exps.npy"
PICTURES = "input_images"
#: The reduction of HDR-NeRF: 3216×2136 to 804×534.
PUBLISHED_FACTOR = 4.0
COLUMNS = 18

COPY_AGAIN = "Copy the data set again."


def is_mine(root: Path) -> bool:
    """Whether ``root`` looks like this layout."""
    return (root / LOOKS_FOR).exists()


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
    names = _picture_names(folder)
    rows = _read_rows(root / LOOKS_FOR, folder, names)
    size = one_size([folder / name for name in names.values()])
    poses, bracket_messages = _poses(root / LOOKS_FOR, names, rows, folder, size)
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
        f"exposures from {LOOKS_FOR}",
        missing_in_words(poses),
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
        layout=NAME,
        messages=tuple(message for message in messages if message),
    )


def _picture_names(folder: Path) -> dict[tuple[int, int], str]:
    """``{(pose, place in the bracket): file name}`` in the order of names, which is that of the rows."""
    if not folder.is_dir():
        raise FileMissingError(f"{folder} is missing", COPY_AGAIN)
    names: dict[tuple[int, int], str] = {}
    for path in sorted(folder.iterdir()):
        # macOS leaves ._003_1.jpg beside 003_1.jpg on other systems' disks.
        if path.suffix.lower() not in (".jpg", ".jpeg", ".png") or path.name.startswith("."):
            continue
        parts = bracket_name(path.name)
        if parts is None or not parts[0].isdigit():
            raise DataMismatchError(
                f"{path} is not named <pose>_<exposure>, as 003_1.jpg", "Rename it, or move it away."
            )
        if (key := (int(parts[0]), parts[1])) in names:
            raise DataMismatchError(f"{path} and {names[key]} are the same exposure of one pose", COPY_AGAIN)
        names[key] = path.name
    if not names:
        raise FileMissingError(f"{folder} holds no pictures", COPY_AGAIN)
    return names


def _read_rows(path: Path, folder: Path, names: dict[tuple[int, int], str]) -> np.ndarray:
    """``[pictures, 18]`` float64, finite."""
    regular_file(path, COPY_AGAIN)
    with damaged_where_it_fails(f"{path} is not a readable array", COPY_AGAIN):
        # Mapped, not read: a header that claims more than the file holds is refused, nothing is allocated.
        rows = np.array(np.load(path, mmap_mode="r", allow_pickle=False), dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != COLUMNS:
        raise FileDamagedError(
            f"{path} has the shape {rows.shape}, not one row of {COLUMNS} a picture", COPY_AGAIN
        )
    if len(rows) != len(names):
        raise DataMismatchError(
            f"{path} has {len(rows)} rows, {folder.name}/ has {len(names)} pictures",
            "There must be a row for each picture, in the order of names: copy what is missing again.",
        )
    if not np.isfinite(rows).all():
        row = int(np.argwhere(~np.isfinite(rows))[0][0])
        raise BadValueError(f"{path}: row {row} holds NaN or infinity", COPY_AGAIN)
    for row, seconds in enumerate(rows[:, 17].tolist()):
        EXPOSURE.check(seconds, f"{path}: the exposure of row {row}")
    return rows


def _poses(
    path: Path, names: dict[tuple[int, int], str], rows: np.ndarray, folder: Path, size: tuple[int, int]
) -> tuple[list[Pose], list[str]]:
    """The poses, each with the camera of its bracket's middle picture; messages."""
    order = {key: row for row, key in enumerate(names)}
    poses = []
    farthest = 0.0
    for number in dict.fromkeys(pose for pose, _ in names):
        places = [k for pose, k in names if pose == number]
        middle = rows[order[number, places[len(places) // 2]]]
        camera = fitted(_camera(path, number, middle), size, path, folder / names[number, places[0]])
        pictures = {
            k: PictureFile(folder / names[number, k], float(rows[order[number, k], 17]))
            for k in sorted(places)
        }
        for k in places:
            other = rows[order[number, k], :15].reshape(3, 5)[:, 3]
            farthest = max(farthest, float(np.linalg.norm(other - camera.position)))
        poses.append(Pose(f"{number:03d}", number, camera, pictures))
    if farthest > 0.0:
        told = f"cameras of one bracket are up to {farthest:.2g} units apart: each view takes the middle one"
        return poses, [told]
    return poses, []


def _camera(path: Path, number: int, row: np.ndarray) -> Camera:
    """The camera of a row, at the size that the row tells."""
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    pose = camera_to_world_from_llff(matrix[:, :4])
    if not is_rotation(pose[:3, :3]):
        raise BadValueError(f"{path}: pose {number} is not a rotation: {pose[:3, :3].tolist()}", COPY_AGAIN)
    check_position(pose[:3, 3], f"{path}: the camera of pose {number}")
    if not (1.0 <= width <= LARGEST_SIDE and 1.0 <= height <= LARGEST_SIDE and focal in FOCAL_LENGTH):
        raise BadValueError(
            f"{path}: pose {number} has {width:g}×{height:g} pixels, focal length {focal:g}", COPY_AGAIN
        )
    return Camera(pose, round(width), round(height), focal, focal, 0.5 * round(width), 0.5 * round(height))


def _with_model(
    folder: Path, poses: list[Pose], size: tuple[int, int]
) -> tuple[list[Pose], Points | None, tuple[str, ...]]:
    """The poses with COLMAP's cameras; those that it has not found are left out, and named."""
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
            f"It must name pictures as {PICTURES}/ does, 000_0.jpg; or remove sparse/ to use {LOOKS_FOR}.",
        )
    placed = []
    for pose in found:
        camera, lens = cameras[pose.index]
        lens = None if lens is None else lens.resized(*size)
        camera = fitted(camera, size, folder, next(iter(pose.pictures.values())).path)
        placed.append(Pose(pose.name, pose.index, camera, pose.pictures, lens=lens))
    told = f"cameras and points from {folder.relative_to(folder.parents[1]).as_posix()}, as HDR-GS has them"
    lost = ", ".join(pose.name for pose in poses if pose.index not in cameras)
    return (
        placed,
        model.points,
        (
            told,
            *other_models_in_words(folder),
            *([f"poses that it does not have are left out: {lost}"] if lost else []),
        ),
    )
