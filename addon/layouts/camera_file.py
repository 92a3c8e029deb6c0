# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of a data set, of any layout that is trained from (docs/formats.md), without the trainer's
readers: where each picture was taken, and through what. No bpy.

Pictures are not opened but for the size in their headers. What the trainer does to pictures (makes them
smaller, straightens what a lens bends) is not done here: a camera sees what its photo shows.
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge import data_set
from ...bridge.axes import camera_to_world_from_llff
from ...bridge.colmap import find_model
from ...bridge.colmap_files import SparseImage, read_cameras, read_images
from ...bridge.errors import BadValueError, FileDamagedError, FileMissingError
from ...bridge.limits import FOCAL_LENGTH, LARGEST_SIDE, PRINCIPAL_POINT, check_position, is_number
from ...bridge.regular import damaged_where_it_fails, read_json_object
from .captures import (
    COPY_AGAIN,
    LOOKED_FOR,
    NERF_FILE,
    NERFSTUDIO_FILE,
    REAL_FILE,
    SUFFIXES,
    frames_of,
    nerf_files,
    pose_of,
    real_rows,
    split_of,
)
from .picture_size import picture_size

#: Where nothing says what a view is for: the trainer then chooses.
VIEWS = "views"
#: Bends of a lens that are smaller count as none.
_NO_DISTORTION = 1e-12
_DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
#: Of a rotation's columns: how far from unit and square they may be, as the trainer has it.
_RIGID = 1e-3


@dataclass(frozen=True, eq=False)
class Pose:
    """``camera_to_world``: ``[4, 4]`` in Blender's axes; ``angle_x``: radians; ``name``: the frame's file."""

    camera_to_world: np.ndarray
    angle_x: float
    name: str


@dataclass(frozen=True, eq=False)
class Frame:
    """A camera of a data set.

    ``name``: as the data set calls it, without suffix. ``split``: ``train``, ``test`` …, or ``VIEWS``.
    ``camera_to_world``: ``[4, 4]`` float64, rigid, looks down −Z, +Y up. Of its full-size picture: ``width``,
    ``height``, and ``fx, fy, cx, cy`` in pixels; the centre of the top left pixel is at (0.5, 0.5).
    """

    name: str
    split: str
    camera_to_world: np.ndarray
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@dataclass(frozen=True, eq=False)
class Frames:
    """The cameras of a data set, and sentences about what they are not."""

    frames: tuple[Frame, ...]
    notes: tuple[str, ...] = field(default=())


def read_pose(path: Path, index: int) -> Pose:
    """Pose ``index`` of a transforms file. Raises the errors of ``bridge.errors`` with the path."""
    if not path.exists():
        raise FileMissingError(f"there is no camera file {path}", "Give a transforms_*.json.")
    content = read_json_object(path, "Make the data set again.")
    with damaged_where_it_fails(f"{path}: camera {index} cannot be read", "Make the data set again."):
        frames, angle_x = list(content["frames"]), float(content["camera_angle_x"])
        if not 0 <= index < len(frames):
            raise BadValueError(f"{path} has no camera {index}", f"Choose one from 0 to {len(frames) - 1}.")
        matrix = np.array(frames[index]["transform_matrix"], float)
        name = str(frames[index].get("file_path", index))
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or not 0.0 < angle_x < np.pi:
        raise BadValueError(
            f"{path}: camera {index} is not a finite 4×4 pose with an angle in (0, π)",
            "Fix the file or make the data set again.",
        )
    check_position(matrix[:3, 3], f"{path}: camera {index}")
    return Pose(matrix, angle_x, name)


def read_frames(root: Path) -> Frames:
    """The cameras of the data set in a folder, in the order of splits and then of the files.

    Raises ``FileMissingError`` where the folder has no layout that is known, or no camera; and
    ``FileDamagedError`` or ``BadValueError``, each with the file.
    """
    model = find_model(root)
    if data_set.is_layout(root):
        found = Frames(tuple(_of_ours(root)))
    elif (root / REAL_FILE).exists() and model is None:
        found = Frames(tuple(_of_real(root)))
    elif model is not None:
        found = _of_colmap(root, model)
    elif (root / NERF_FILE).exists():
        found = _of_nerf(root)
    elif (root / NERFSTUDIO_FILE).exists():
        found = _of_nerfstudio(root)
    else:
        raise FileMissingError(
            f"{root} is no data set: there is no {NERF_FILE}, no {LOOKED_FOR}",
            "Choose the folder that the model was trained from.",
        )
    if not found.frames:
        raise FileMissingError(f"{root} has no camera whose picture's size is known", COPY_AGAIN)
    return found


# ---- our layout, HDR-NeRF-Syn's ----------------------------------------------------------------------------


def _of_ours(root: Path) -> Iterator[Frame]:
    stated = data_set.read_info(root, COPY_AGAIN).get("resolution")
    for split in data_set.splits_there(root):
        path = root / data_set.transforms_file(split)
        if not path.exists():
            continue
        content = read_json_object(path, COPY_AGAIN)
        size: Sequence[Any] | None = stated if isinstance(stated, list) and len(stated) == 2 else None
        for entry in frames_of(path, content):
            stem = data_set.stem_of(str(entry.get("file_path", "")))
            size = size or picture_size(root / data_set.picture_file(stem, 0))
            if size is None:
                continue
            yield _frame(path, stem, split, {"w": size[0], "h": size[1], **content, **entry})


# ---- transforms.json of nerfstudio and instant-ngp, and NeRF's synthetic scenes ----------------------------


def _of_nerfstudio(root: Path) -> Frames:
    path = root / NERFSTUDIO_FILE
    content = read_json_object(path, COPY_AGAIN)
    splits = _stated_splits(content)
    # As the trainer has it: where only frames that are held out are listed, it trains on the others.
    unlisted = data_set.TRAIN if splits and content.get("train_filenames") is None else VIEWS
    found = _listed_in(root, path, content, splits, unlisted)
    return found if splits else Frames(tuple(_split_by_name(found.frames)), found.notes)


def _of_nerf(root: Path) -> Frames:
    """A file for each split, as ``transforms.json`` is."""
    every = []
    for split, path in nerf_files(root).items():
        content = read_json_object(path, COPY_AGAIN)
        names = (str(entry.get("file_path", "")) for entry in frames_of(path, content))
        every.append(_listed_in(root, path, content, {data_set.plain_name(name): split for name in names}))
    return Frames(
        tuple(frame for part in every for frame in part.frames),
        tuple(note for part in every for note in part.notes),
    )


def _listed_in(
    root: Path, path: Path, content: dict[str, Any], splits: dict[str, str], unlisted: str = VIEWS
) -> Frames:
    """The cameras of one file. ``splits``: of pictures, by name; ``unlisted``: that of the others."""
    entries = frames_of(path, content)
    frames, bent, sizeless = [], 0, 0
    for entry in entries:
        name = data_set.plain_name(str(entry.get("file_path", "")))
        given = {**content, **entry}
        if "w" not in given or "h" not in given:
            sizes = (picture_size(root / (name + end)) for end in SUFFIXES)
            size = next((size for size in sizes if size), None)
            if size is None:
                sizeless += 1
                continue
            given |= {"w": size[0], "h": size[1]}
        if given.get("camera_model") == "EQUIRECTANGULAR":
            raise BadValueError(
                f"{path}: '{name:.80}' is a panorama, which is not a camera with a focal length",
                "Cut it into views of pinhole cameras.",
            )
        values = [given.get(key, 0.0) for key in _DISTORTION]
        bent += any(not is_number(value) or abs(value) > _NO_DISTORTION for value in values)
        split = splits.get(name, unlisted)
        frames.append(_frame(path, _without_suffix(name), split, given))
    return Frames(tuple(frames), (*_of_bent(bent, len(entries)), *_of_sizeless(sizeless)))


def _stated_splits(content: dict[str, Any]) -> dict[str, str]:
    """The split of each picture that nerfstudio's lists name."""
    keys = {
        "train_filenames": data_set.TRAIN,
        "val_filenames": data_set.VALIDATION,
        "test_filenames": data_set.TEST,
    }
    return {
        data_set.plain_name(name): split
        for key, split in keys.items()
        if isinstance(names := content.get(key), list)
        for name in names
        if isinstance(name, str)
    }


def _of_sizeless(count: int) -> tuple[str, ...]:
    return (f"{count} cameras are left out: nothing tells the size of their pictures.",) if count else ()


# ---- COLMAP, GaussHDR, HDR-GS, and what physhdr prepare writes ---------------------------------------------


def _of_colmap(root: Path, model: Path) -> Frames:
    cameras = read_cameras(model)
    bracketed = any((root / name).exists() for name in (data_set.EXPOSURE_FILE, REAL_FILE))
    # A bracket is one camera: as the trainer has it, that of the picture which shows the most points.
    best: dict[str, SparseImage] = {}
    for placed in sorted(read_images(model), key=lambda placed: placed.name):
        name = pose_of(placed.name) if bracketed else _without_suffix(placed.name)
        if name not in best or placed.observed > best[name].observed:
            best[name] = placed
    frames = []
    for name, placed in best.items():
        camera = cameras.get(placed.camera)
        if camera is None:
            told = f"{model}: '{placed.name}' has camera {placed.camera}, which is not there"
            raise FileDamagedError(told, COPY_AGAIN)
        intrinsics = camera.intrinsics(model, placed.camera)
        frames.append(Frame(name, VIEWS, placed.camera_to_world, camera.width, camera.height, *intrinsics))
    bent = sum(not cameras[placed.camera].is_pinhole for placed in best.values())
    return Frames(tuple(_split_by_name(frames)), _of_bent(bent, len(frames)))


def _of_bent(count: int, of: int) -> tuple[str, ...]:
    if not count:
        return ()
    whose = "The lens bends" if count == of else f"The lenses of {count} cameras bend"
    return (
        f"{whose} straight lines, Blender's cameras do not: they show a little more or less than photos.",
    )


# ---- HDR-NeRF-Real: LLFF's poses ---------------------------------------------------------------------------


def _of_real(root: Path) -> Iterator[Frame]:
    path = root / REAL_FILE
    done = set()
    for file, row in real_rows(root):
        name = pose_of(file.name)
        if name in done:
            continue
        done.add(name)
        llff = row[:15].reshape(3, 5)
        height, width, focal = llff[:, 4]
        given = {"w": width, "h": height, "fl_x": focal}
        matrix = camera_to_world_from_llff(llff)
        # "even poses train, odd ones test"
        split = data_set.TRAIN if len(done) % 2 else data_set.TEST
        yield _frame(path, name, split, {**given, "transform_matrix": matrix.tolist()})


# ---- what they share ---------------------------------------------------------------------------------------


def _frame(path: Path, name: str, split: str, given: dict[str, Any]) -> Frame:
    """Of a frame's entries over the file's, in nerfstudio's names. Raises ``FileDamagedError`` and
    ``BadValueError`` with the file and the frame."""
    where = f"{path}: '{name:.80}'"
    with damaged_where_it_fails(f"{where} has no 4×4 'transform_matrix' of numbers", COPY_AGAIN):
        matrix = np.array(given["transform_matrix"], np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError("it is not finite")
    rotation = matrix[:3, :3]
    if not np.allclose(rotation.T @ rotation, np.eye(3), atol=_RIGID):
        raise BadValueError(
            f"{where}: its pose is not a rotation and a place", "Remove scale and shear from it."
        )
    check_position(matrix[:3, 3], where)
    width, height = (_number(where, given, key) for key in "wh")
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise BadValueError(f"{where} is said to be {width:g}×{height:g} pixels", "Fix 'w' and 'h'.")
    fx, fy = _focal(where, given, "x", width), _focal(where, given, "y", height)
    fx, fy = fx or fy, fy or fx
    if fx is None or fy is None:
        raise FileDamagedError(
            f"{where} has no focal length", "Add fl_x (pixels) or camera_angle_x (radians)."
        )
    cx, cy = (
        PRINCIPAL_POINT.check(_number(where, {key: 0.5 * side, **given}, key), f"{where}: '{key}'")
        for key, side in (("cx", width), ("cy", height))
    )
    return Frame(name, split, matrix, round(width), round(height), fx, fy, cx, cy)


def _number(where: str, given: dict[str, Any], key: str) -> float:
    value = given[key]
    if not is_number(value):
        raise BadValueError(f"{where}: '{key}' is {value!r:.80}, no number", "Fix it in that file.")
    return float(value)


def _focal(where: str, given: dict[str, Any], axis: str, side: float) -> float | None:
    """Pixels, from the focal length itself or the field of view; None where there is neither."""
    if f"fl_{axis}" in given:
        return FOCAL_LENGTH.check(_number(where, given, f"fl_{axis}"), f"{where}: 'fl_{axis}'")
    key = f"camera_angle_{axis}"
    if key not in given:
        return None
    angle = _number(where, given, key)
    if not 0.0 < angle < math.pi:
        raise BadValueError(f"{where}: '{key}' is {angle:g}", "Fix it: radians, between 0 and π.")
    return FOCAL_LENGTH.check(0.5 * side / math.tan(0.5 * angle), f"{where}: the focal length of '{key}'")


def _split_by_name(frames: Sequence[Frame]) -> list[Frame]:
    """``train`` and ``test`` where all names say so, as the trainer has it; else all are ``VIEWS``."""
    said = [split_of(frame.name) for frame in frames]
    splits = [split for split in said if split is not None]
    if len(splits) < len(frames):
        return list(frames)
    return [dataclasses.replace(frame, split=split) for frame, split in zip(frames, splits, strict=True)]


def _without_suffix(name: str) -> str:
    return name.rsplit(".", 1)[0] if Path(name).suffix else name
