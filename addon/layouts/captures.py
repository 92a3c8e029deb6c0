# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures: the data sets that are not our renders, as far as a panel needs them, and any data set's cameras.

What the trainer's readers take (``backend/scene``) is told by the same files, in the same order. Poses and
exposures are read, and nothing of the pictures but headers. No bpy.
"""

import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...bridge import data_set
from ...bridge.colmap import find_model
from ...bridge.colmap_files import read_images
from ...bridge.errors import FileDamagedError, FileMissingError, PhysHDRError
from ...bridge.limits import EXPOSURE, is_number
from ...bridge.regular import damaged_where_it_fails, read_json_object, read_text, regular_file

COPY_AGAIN = "Copy the data set again, or make it again."
#: What gives each layout away, and what ``physhdr prepare`` leaves beside the second.
REAL_FILE, NERFSTUDIO_FILE, PICTURES = "poses_bounds_exps.npy", "transforms.json", "images"
LOOKED_FOR = f"{NERFSTUDIO_FILE}, no {REAL_FILE}, no {PICTURES}/ with COLMAP's sparse/0"
REAL_PICTURES = "input_images"
#: Of our layout, and where nothing tells of exposures (``data_set.is_layout``) of NeRF's synthetic scenes.
NERF_FILE = data_set.transforms_file(data_set.TRAIN)
#: Numbers of a row of LLFF's poses: 3 × 5, two bounds, and HDR-NeRF's exposure.
COLUMNS = 18
#: What a frame's ``file_path`` may lack.
SUFFIXES = ("", ".png", ".jpg", ".jpeg", ".JPG", ".PNG")
NERF = "NeRF's synthetic scenes"
_COUNT = struct.Struct("<Q")


@dataclass(frozen=True, eq=False)
class Capture:
    """What a capture's files say.

    ``poses``: a name and ``[3]`` float64, the camera's place, for each that was placed. ``pictures``: the
    exposure of each picture, seconds; where nothing states it (EXIF may, which only the trainer reads) None.
    ``missing``: pictures that are named and not there. ``points``: of structure from motion, if any.
    ``stated``: poses of each split, where a file of its own lists them.
    """

    layout: str
    poses: dict[str, np.ndarray]
    pictures: dict[Path, float | None] = field(default_factory=dict)
    missing: tuple[str, ...] = ()
    points: int | None = None
    prepared: bool = False
    stated: dict[str, int] | None = None

    @property
    def splits(self) -> dict[str, int] | None:
        """Poses of each split, where files or all names say so; else the trainer chooses."""
        if self.stated is not None:
            return self.stated
        named = [split_of(name) for name in self.poses]
        if any(split is None for split in named):
            return None
        return {split: named.count(split) for split in (data_set.TRAIN, data_set.TEST)}

    @property
    def places(self) -> np.ndarray:
        """``[N, 3]`` float64: where the cameras were, in the world of the capture."""
        return np.array(list(self.poses.values())).reshape(-1, 3)


def read_capture(folder: Path) -> Capture | None:
    """The capture in a folder; None where it has none of the layouts. Raises the errors of ``bridge``."""
    model = find_model(folder)
    if (folder / REAL_FILE).exists():
        return _of_real(folder, model)
    if model is not None and (folder / PICTURES).is_dir():
        return _of_colmap(folder, model)
    if (folder / NERF_FILE).exists():
        return _of_nerf(folder)
    return _of_nerfstudio(folder) if (folder / NERFSTUDIO_FILE).exists() else None


def camera_places(folder: Path) -> np.ndarray:
    """``[N, 3]`` float64: where the cameras of any data set were, those of its extra views left out.

    Raises ``FileMissingError`` where the folder has no cameras, and what reading them raises.
    """
    if (folder / NERF_FILE).exists() and (data_set.is_layout(folder) or find_model(folder) is None):
        frames = [
            entry
            for split in (data_set.TRAIN, data_set.TEST)
            if (path := folder / data_set.transforms_file(split)).exists()
            for entry in frames_of(path, read_json_object(path, COPY_AGAIN))
        ]
        return np.array([_place(folder, entry) for entry in frames]).reshape(-1, 3)
    capture = read_capture(folder)
    if capture is None or not capture.poses:
        raise FileMissingError(f"{folder} has no cameras", "Choose the data set that the model was made of.")
    return capture.places


def split_of(name: str) -> str | None:
    """``train`` or ``test``, where a name has one of them as a word."""
    words = set(re.split(r"[^a-z]+", name.lower())) & {data_set.TRAIN, data_set.TEST}
    return words.pop() if len(words) == 1 else None


def _known(seconds: Any) -> float | None:
    return float(seconds) if is_number(seconds) and seconds in EXPOSURE else None


# ---- COLMAP, and what physhdr prepare writes ---------------------------------------------------------------


def _of_colmap(root: Path, model: Path) -> Capture:
    listed = {placed.name: placed.place for placed in read_images(model)}
    stated: dict[str, float | None] = {}
    if (root / data_set.EXPOSURE_FILE).exists():
        for name, seconds in read_json_object(root / data_set.EXPOSURE_FILE, COPY_AGAIN).items():
            stated[data_set.plain_name(name).removeprefix(f"{PICTURES}/")] = _known(seconds)
    poses = {pose_of(name) if stated else name: at for name, at in listed.items()}
    # Pictures of a bracket of which the model has one are told by the exposure file alone.
    names = [name for name in stated if pose_of(name) in poses] or list(listed)
    return Capture(
        "GaussHDR" if stated and all(map(split_of, stated)) else "COLMAP",
        poses,
        {root / PICTURES / name: stated.get(name) for name in names},
        tuple(name for name in names if not os.path.isfile(root / PICTURES / name)),
        _point_count(model),
        (root / data_set.CAPTURE_FILE).is_file(),
    )


def _point_count(model: Path) -> int | None:
    """How many points structure from motion found; None where its file cannot tell."""
    try:
        if (model / "points3D.bin").exists():
            with open(regular_file(model / "points3D.bin"), "rb") as file:
                return int(_COUNT.unpack(file.read(_COUNT.size))[0])
        lines = read_text(model / "points3D.txt").splitlines()
    except (OSError, PhysHDRError, struct.error):
        return None
    return sum(1 for line in lines if line and not line.startswith("#"))


# ---- transforms.json of nerfstudio and instant-ngp, and NeRF's synthetic scenes ----------------------------


def _of_nerfstudio(root: Path) -> Capture:
    return _listed_in(root, root / NERFSTUDIO_FILE, "transforms.json")


def _of_nerf(root: Path) -> Capture:
    """A file for each split, as ``transforms.json`` is: test views, or where there are none validation's."""
    parts = {split: _listed_in(root, path, NERF) for split, path in nerf_files(root).items()}
    return Capture(
        NERF,
        {name: place for part in parts.values() for name, place in part.poses.items()},
        {file: seconds for part in parts.values() for file, seconds in part.pictures.items()},
        tuple(name for part in parts.values() for name in part.missing),
        stated={data_set.TEST: 0} | {split: len(part.poses) for split, part in parts.items()},
    )


def nerf_files(root: Path) -> dict[str, Path]:
    """The files of NeRF's synthetic scenes that are there, by the split that the trainer makes of them."""
    every = (data_set.TRAIN, data_set.TEST, data_set.VALIDATION)
    there = {split: path for split in every if (path := root / data_set.transforms_file(split)).exists()}
    if data_set.TEST not in there and data_set.VALIDATION in there:
        there[data_set.TEST] = there.pop(data_set.VALIDATION)
    return there


def _listed_in(root: Path, path: Path, layout: str) -> Capture:
    poses, pictures, missing = {}, {}, []
    for entry in frames_of(path, read_json_object(path, COPY_AGAIN)):
        name = data_set.plain_name(str(entry.get("file_path", "")))
        file = next((root / (name + end) for end in SUFFIXES if os.path.isfile(root / (name + end))), None)
        if file is None:  # the trainer leaves such frames out, too
            missing.append(name)
            continue
        poses[name] = _place(path, entry)
        pictures[file] = _known(entry.get("exposure_time"))
    return Capture(layout, poses, pictures, tuple(missing))


def frames_of(path: Path, content: dict[str, Any]) -> list[dict[str, Any]]:
    frames = content.get("frames")
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames) or not frames:
        raise FileDamagedError(f"{path} has no list 'frames'", COPY_AGAIN)
    return frames


def _place(path: Path, frame: dict[str, Any]) -> np.ndarray:
    """Where a frame's camera is: the last column of its pose."""
    with damaged_where_it_fails(f"{path}: a frame has no 4×4 'transform_matrix' of numbers", COPY_AGAIN):
        place = np.array(frame["transform_matrix"], float)[:3, 3]
        if place.shape != (3,) or not np.isfinite(place).all():
            raise ValueError("it is not finite")
    return place


# ---- HDR-NeRF-Real -----------------------------------------------------------------------------------------


def _of_real(root: Path, model: Path | None) -> Capture:
    """LLFF's poses, or those of COLMAP's ``model`` beside them: the trainer takes that where it is there."""
    rows = list(real_rows(root))
    # LLFF: [down, right, backwards, place, size] of each picture; those of a bracket have one place.
    poses = {pose_of(file.name): row[:15].reshape(3, 5)[:, 3] for file, row in rows}
    seconds = {file: _known(float(row[17])) for file, row in rows}
    if model is None:
        return Capture("HDR-NeRF-Real", poses, seconds)
    listed = sorted(read_images(model), key=lambda placed: placed.name, reverse=True)
    poses = {pose_of(placed.name): placed.place for placed in listed}
    return Capture("HDR-NeRF-Real", poses, seconds, points=_point_count(model))


def pose_of(name: str) -> str:
    """The pose of a bracket's picture: ``train_03_2.jpg`` → ``train_03``."""
    return re.sub(r"_\d+$", "", Path(name).stem)


def real_rows(root: Path) -> Iterator[tuple[Path, np.ndarray]]:
    """Each picture of HDR-NeRF-Real with its ``[18]`` numbers, float64."""
    path = regular_file(root / REAL_FILE, COPY_AGAIN)
    with damaged_where_it_fails(f"{path} is not a readable array", COPY_AGAIN):
        rows = np.array(np.load(path, mmap_mode="r", allow_pickle=False), np.float64)
    if rows.ndim != 2 or rows.shape[1] != COLUMNS or not np.isfinite(rows).all():
        raise FileDamagedError(f"{path} is not a table of poses, bounds and exposures", COPY_AGAIN)
    folder = root / REAL_PICTURES
    files = sorted(file for file in folder.glob("*") if file.suffix.lower() in SUFFIXES)
    yield from zip(files, rows, strict=False)
